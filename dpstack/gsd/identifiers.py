"""Identifier octets of Chk_Cfg and Get_Cfg: parser of the I/O configuration of a slave, general and special format.

Layouts: docs/reference/protocol.md#identifiers, docs/reference/protocol.md#special-identifiers.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from msgspec import Struct

from dpstack.errors import ConfigError

#: octets of one telegram's data, each way; and those that a Set_Prm can carry behind its seven fixed ones
MAX_IO: Final = 244
MAX_USER_PRM: Final = 237
#: an identifier of the general format has one of these bits
_GENERAL: Final = 0x30
#: low nibble of a special one in Chk_Cfg: no manufacturer octets follow, and none are compared
#: (docs/reference/protocol.md#special-identifiers)
_NOT_COMPARED: Final = 0x0F
#: configurations whose lengths are kept: the plan of a bus asks some 40 times for those of each slave
_KEPT_LENGTHS: Final = 256


class Identifier(Struct, frozen=True):
    """One identifier: data octets in each direction, consistency over the whole, manufacturer octets.

    ``inputs`` and ``outputs`` count octets as seen from the master (inputs come from the slave).
    """

    #: identifier as in Chk_Cfg
    octets: bytes
    #: octets of the inputs, seen from the master
    inputs: int
    #: octets of the outputs, seen from the master
    outputs: int
    #: the inputs are consistent as a whole, not by octet or word
    input_consistent: bool
    #: the outputs are consistent as a whole, not by octet or word
    output_consistent: bool
    #: manufacturer octets of the special format
    manufacturer: bytes = b""
    #: the inputs count words, not octets
    input_words: bool = False
    #: the outputs count words, not octets
    output_words: bool = False

    @property
    def empty(self) -> bool:
        """No inputs and no outputs: an empty slot."""
        return not self.inputs and not self.outputs


def parse_identifiers(config: bytes) -> list[Identifier]:
    """Split configuration octets into identifiers. Raises ConfigError naming the octet where it breaks."""
    found: list[Identifier] = []
    at = 0
    while at < len(config):
        found.append(_identifier(config, at))
        at += len(found[-1].octets)
    return found


@lru_cache(_KEPT_LENGTHS)
def io_lengths(config: bytes) -> tuple[int, int]:
    """(input octets, output octets) of a whole configuration. Raises ConfigError."""
    identifiers = parse_identifiers(config)
    return sum(found.inputs for found in identifiers), sum(found.outputs for found in identifiers)


def agree(real: bytes, asked: bytes) -> bool:
    """Whether Chk_Cfg's ``asked`` is the configuration ``real`` of a slave.

    Manufacturer octets must be equal, unless the master asks for no comparison (low nibble 15, none follow).
    """
    if real == asked:
        return True
    try:
        pairs = list(zip(parse_identifiers(real), parse_identifiers(asked), strict=True))
    except (ConfigError, ValueError):
        return False
    return all(
        ours.octets == theirs.octets
        or (
            not ours.octets[0] & _GENERAL
            and theirs.octets[0] == ours.octets[0] | _NOT_COMPARED
            and theirs.octets[1:] == ours.octets[1 : len(ours.octets) - len(ours.manufacturer)]
        )
        for ours, theirs in pairs
    )


def config_for(inputs: int, outputs: int) -> bytes:
    """Identifier octets of a simple slave with so many input and output octets, consistent octet by octet.

    Up to 16 octets go into one identifier of the general format. Raises ConfigError for more than 244 either way.
    """
    if not (0 <= inputs <= MAX_IO and 0 <= outputs <= MAX_IO):
        raise ConfigError(f"{inputs} input and {outputs} output octets; 0..{MAX_IO} each are possible")
    parts = [
        (mask, min(16, total - at)) for mask, total in ((0x10, inputs), (0x20, outputs)) for at in range(0, total, 16)
    ]
    return bytes(mask | size - 1 for mask, size in parts) or b"\x00"


def _identifier(config: bytes, start: int) -> Identifier:
    head, at = config[start], start + 1
    manufacturer = 0
    inputs = outputs = (0, False, False)
    if head & _GENERAL:
        length = _length(head & ~_GENERAL)
        inputs = length if head & 0x10 else inputs
        outputs = length if head & 0x20 else outputs
    else:
        announced = (head >> 7) + (head >> 6 & 1)
        lengths = [_length(octet) for octet in config[at : at + announced]]
        if len(lengths) < announced:
            raise ConfigError(f"identifier octet {start} ({head:#04x}) announces a length octet that is missing")
        at += announced
        if head & 0x40:  # output length first, then input length
            inputs = lengths.pop()
        if head & 0x80:
            outputs = lengths.pop()
        if head & 0x0F != _NOT_COMPARED:
            manufacturer = head & 0x0F
    if at + manufacturer > len(config):
        raise ConfigError(
            f"identifier octet {start} ({head:#04x}) announces {manufacturer} manufacturer octets, "
            f"{len(config) - at} are left"
        )
    end = at + manufacturer
    return Identifier(
        config[start:end], inputs[0], outputs[0], inputs[1], outputs[1], config[at:end], inputs[2], outputs[2]
    )


def _length(octet: int) -> tuple[int, bool, bool]:
    """(number of data octets, consistent over the whole, counted in words) of a length octet."""
    words = octet >> 6 & 1
    return ((octet & 0x3F) + 1) << words, bool(octet & 0x80), bool(words)
