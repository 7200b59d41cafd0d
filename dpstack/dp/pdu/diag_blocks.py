"""The blocks of the extended diagnosis: device, identifier, channel related, revision (protocol facts B1).

Lengths in it come from the slave and may lie: a block that announces more than is left holds what is left, one that
announces nothing ends the splitting; both are a finding in words, never an exception.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.dp.pdu.layouts import BLOCK_HEADER, CHANNEL

_DEVICE, _IDENTIFIER, _CHANNEL, _REVISION = range(4)
_CHANNEL_LEN: Final = 3

#: the slot of the first module, which the wire calls 0, where no GSD file says Modul_Offset (DP-V1: slot 0 is the
#: station itself)
FIRST_SLOT: Final = 1

_SIZES: Final = ("unspecific", "bit", "2 bits", "4 bits", "byte", "word", "2 words", "reserved")
_ERRORS: Final = {
    1: "short circuit",
    2: "undervoltage",
    3: "overvoltage",
    4: "overload",
    5: "overtemperature",
    6: "line break",
    7: "upper limit exceeded",
    8: "lower limit exceeded",
    9: "error",
}


@dataclass(frozen=True, slots=True)
class Block:
    """One block; ``octets`` are all of it, header included."""

    octets: bytes


@dataclass(frozen=True, slots=True)
class DeviceBlock(Block):
    """Device related: ``data`` means what the device's maker says (in DP-V1 an alarm or status)."""

    @property
    def data(self) -> bytes:
        """The octets after the header."""
        return self.octets[1:]


@dataclass(frozen=True, slots=True)
class IdentifierBlock(Block):
    """Identifier (module) related: which modules have a diagnosis. Texts for people count slots, see FIRST_SLOT."""

    @property
    def modules(self) -> tuple[int, ...]:
        """Numbers of the faulty modules as on the wire, from 0 in the order of the configuration."""
        bits = int.from_bytes(self.octets[1:], "little")
        return tuple(n for n in range(bits.bit_length()) if bits >> n & 1)


@dataclass(frozen=True, slots=True)
class ChannelBlock(Block):
    """Channel related. ``identifier`` (module, from 0) and ``channel`` 0..63, ``size`` 0..7 and ``error`` 0..31 as on
    the wire. Texts for people count slots, see FIRST_SLOT.
    """

    identifier: int
    channel: int
    input: bool
    output: bool
    size: int
    error: int

    def place(self, module_name: str = "", first_slot: int = FIRST_SLOT) -> str:
        """Which channel of which slot, for people, with the name of its module where that is known."""
        direction = {(True, False): "input ", (False, True): "output ", (True, True): "in/output "}
        kind = direction.get((self.input, self.output), "")
        name = f" ({module_name})" if module_name else ""
        return f"slot {first_slot + self.identifier}{name}, {kind}channel {self.channel} ({_SIZES[self.size]})"

    @property
    def cause(self) -> str:
        """What is wrong, for people; makers' own errors (16..31) by number."""
        return _ERRORS.get(self.error, f"error {self.error}")

    @property
    def text(self) -> str:
        """Both in one line."""
        return f"{self.place()}: {self.cause}"


@dataclass(frozen=True, slots=True)
class RevisionBlock(Block):
    """Revision number of the diagnosis, one octet."""

    revision: int


def split_blocks(ext: bytes) -> tuple[tuple[Block, ...], str | None]:
    """(blocks, finding): the extended diagnosis ``ext`` taken apart, and what is wrong with its lengths, or None.

    Octets are counted as in the whole diagnosis (the first of ``ext`` is octet 7).
    """
    blocks: list[Block] = []
    at = 0
    while at < len(ext):
        kind, value = BLOCK_HEADER.parse(ext[at : at + 1])
        announced = (value, value, _CHANNEL_LEN, 1)[kind]
        left = len(ext) - at
        if not announced:
            return tuple(
                blocks
            ), f"octet {at + 7} announces a block without any octets, {left} octets are left undecoded"
        octets = ext[at : at + announced]
        if kind == _CHANNEL and left >= _CHANNEL_LEN:
            raw = CHANNEL.parse(octets)
            blocks.append(ChannelBlock(octets, raw.identifier, raw.channel, raw.input, raw.output, raw.size, raw.error))
        elif kind == _DEVICE:
            blocks.append(DeviceBlock(octets))
        elif kind == _IDENTIFIER:
            blocks.append(IdentifierBlock(octets))
        elif kind == _REVISION:
            blocks.append(RevisionBlock(octets, value))
        if announced > left:
            return tuple(blocks), f"octet {at + 7} announces a block of {announced} octets, {left} are left"
        at += announced
    return tuple(blocks), None
