"""The blocks of the extended diagnosis, read and made: device, identifier, channel related, revision.

Layouts: docs/reference/protocol.md#diagnosis-blocks.

The slave announces the length of each block, and the lengths may be wrong: a block that is longer than the rest is cut,
a block without octets ends the splitting. Both become a finding in words, never an exception. The application of a
slave builds its diagnosis from the same blocks.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from msgspec import Struct

from dpstack.errors import PduError
from dpstack.text import octets_text

_DEVICE, _IDENTIFIER, _CHANNEL, _REVISION = range(4)
_CHANNEL_LEN: Final = 3

#: the slot of the first module, which the wire calls 0, if no GSD file says Modul_Offset (DP-V1: slot 0 is the
#: station itself)
FIRST_SLOT: Final = 1

#: the sizes of channels by number, for people
SIZES: Final = ("unspecific", "bit", "2 bits", "4 bits", "byte", "word", "2 words", "reserved")
#: the errors of channel related diagnosis by number, for people
CHANNEL_ERRORS: Final = {
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


class Block(Struct, frozen=True):
    """One block; ``octets`` are all of it, header included."""

    octets: bytes


class DeviceBlock(Block, frozen=True):
    """Device related: ``data`` means what the device's maker says (in DP-V1 an alarm or status)."""

    @property
    def data(self) -> bytes:
        """The octets after the header."""
        return self.octets[1:]


class IdentifierBlock(Block, frozen=True):
    """Identifier (module) related: which modules have a diagnosis. Texts for people count slots, see FIRST_SLOT."""

    @property
    def modules(self) -> tuple[int, ...]:
        """Numbers of the faulty modules as on the wire, from 0 in the order of the configuration."""
        bits = int.from_bytes(self.octets[1:], "little")
        return tuple(n for n in range(bits.bit_length()) if bits >> n & 1)


class ChannelBlock(Block, frozen=True):
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
        """Slot and channel for people, with the name of its module if that is known."""
        direction = {(True, False): "input ", (False, True): "output ", (True, True): "in/output "}
        kind = direction.get((self.input, self.output), "")
        name = f" ({module_name})" if module_name else ""
        return f"slot {first_slot + self.identifier}{name}, {kind}channel {self.channel} ({SIZES[self.size]})"

    @property
    def cause(self) -> str:
        """The error for people; makers' own errors (16..31) by number."""
        return CHANNEL_ERRORS.get(self.error, f"error {self.error}")

    @property
    def text(self) -> str:
        return f"{self.place()}: {self.cause}"


def _parse_channel(octets: bytes) -> ChannelBlock:
    module, channel, error = octets
    return ChannelBlock(
        octets,
        identifier=module & 0x3F,
        input=bool(channel & 0x40),
        output=bool(channel & 0x80),
        channel=channel & 0x3F,
        size=error >> 5,
        error=error & 0x1F,
    )


class RevisionBlock(Block, frozen=True):
    """Revision number of the diagnosis, one octet."""

    revision: int


def split_blocks(ext: bytes) -> tuple[tuple[Block, ...], str | None]:
    """(blocks, finding): the extended diagnosis ``ext`` taken apart, and what is wrong with its lengths, or None.

    Octets are counted as in the whole diagnosis (the first of ``ext`` is octet 7).
    """
    blocks: list[Block] = []
    at = 0
    while at < len(ext):
        kind, value = divmod(ext[at], 1 << 6)
        announced = (value, value, _CHANNEL_LEN, 1)[kind]
        left = len(ext) - at
        if not announced:
            finding = f"octet {at + 7} announces a block without any octets, {octets_text(left)} left undecoded"
            return tuple(blocks), finding
        octets = ext[at : at + announced]
        if kind == _DEVICE:
            blocks.append(DeviceBlock(octets))
        elif kind == _IDENTIFIER:
            blocks.append(IdentifierBlock(octets))
        elif kind == _REVISION:
            blocks.append(RevisionBlock(octets, value))
        elif left >= _CHANNEL_LEN:
            blocks.append(_parse_channel(octets))
        if announced > left:
            return tuple(blocks), f"octet {at + 7} announces a block of {announced} octets, {left} are left"
        at += announced
    return tuple(blocks), None


#: a header's six bits count the octets of its block, itself included
_MAX_BLOCK: Final = 63


class UserDiag(Struct, frozen=True):
    """The part of a slave's diagnosis that its application sets, as a whole.

    ``ext``: the octets after the six fixed ones.
    """

    ext: bytes = b""
    #: Ext_Diag: the octets report a fault (False: a mere message)
    fault: bool = False
    #: Stat_Diag: no valid data at present
    stat: bool = False
    #: Ext_Diag_Overflow: there is more diagnosis than fits
    overflow: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.ext, bytes):
            raise TypeError(f"the octets of a diagnosis are bytes, not {type(self.ext).__name__}")

    @classmethod
    def of(cls, *blocks: Block, fault: bool | None = None, stat: bool = False, overflow: bool = False) -> UserDiag:
        """From ``blocks``, in their order; ``fault`` None: if there are blocks."""
        ext = b"".join(block.octets for block in blocks)
        return cls(ext, bool(blocks) if fault is None else fault, stat, overflow)

    def limited(self, room: int) -> UserDiag:
        """The same in at most ``room`` octets of ``ext``: blocks that do not fit are left out, with ``overflow``.

        Octets that are no blocks are cut if the room ends.
        """
        if len(self.ext) <= room:
            return self
        blocks, finding = split_blocks(self.ext)
        kept = room if finding else 0
        for block in blocks if finding is None else ():
            if kept + len(block.octets) > room:
                break
            kept += len(block.octets)
        return UserDiag(self.ext[:kept], self.fault, self.stat, True)


#: nothing to report
NO_DIAG: Final = UserDiag()


def device_block(data: bytes) -> DeviceBlock:
    """A device related block of 1..62 octets that mean what the maker says (GSD: Unit_Diag_Bit). Raises PduError."""
    return DeviceBlock(_header(_DEVICE, len(data), "device related diagnosis") + data)


def identifier_block(faulty: Iterable[int], modules: int) -> IdentifierBlock:
    """An identifier related block: the numbers of the ``faulty`` ones of ``modules``, as on the wire: slot 1 is 0.

    Raises PduError.
    """
    bits = 0
    for number in faulty:
        if not 0 <= number < modules:
            raise PduError(
                f"identifier related diagnosis: module {number} of {modules}; the wire counts them from 0: the one in "
                f"slot 1 is 0"
            )
        bits |= 1 << number
    size = (modules + 7) // 8
    return IdentifierBlock(_header(_IDENTIFIER, size, "identifier related diagnosis") + bits.to_bytes(size, "little"))


def channel_block(
    identifier: int, channel: int, error: int, *, size: int = 0, input: bool = False, output: bool = False
) -> ChannelBlock:
    """A channel related block. ``identifier`` (the module as on the wire: slot 1 is 0) and ``channel`` 0..63; ``error``
    1..31 and ``size`` 0..7 as in docs/reference/protocol.md#diagnosis-blocks (1 short circuit, 6 line break ..., from
    16 on the maker's). Raises PduError.
    """
    for name, value, most in (
        ("identifier", identifier, 63),
        ("channel", channel, 63),
        ("size", size, 7),
        ("error", error, 31),
    ):
        if not 0 <= value <= most:
            raise PduError(f"channel related diagnosis: {name} = {value} does not fit its octets")
    octets = (_CHANNEL << 6 | identifier, output << 7 | input << 6 | channel, size << 5 | error)
    return ChannelBlock(bytes(octets), identifier, channel, input, output, size, error)


def revision_block(revision: int) -> RevisionBlock:
    """The revision of the diagnosis, 0..63. Raises PduError."""
    if not 0 <= revision <= _MAX_BLOCK:
        raise PduError(f"diagnosis block: value = {revision} does not fit its octets")
    return RevisionBlock(bytes((_REVISION << 6 | revision,)), revision)


def _header(kind: int, octets: int, what: str) -> bytes:
    if not 1 <= octets < _MAX_BLOCK:
        raise PduError(f"{what}: {octets} octets; 1..{_MAX_BLOCK - 1} are possible in a block")
    return bytes((kind << 6 | octets + 1,))
