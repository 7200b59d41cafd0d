"""Structured parameters of Set_Prm (Prm_Structure in DPV1_Status_3): blocks, each with a head of four octets.

Layouts and numbers of types: docs/reference/protocol.md#structured-parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Final, NamedTuple

from msgspec import Struct

from dpstack.dp.pdu.layouts import DOUBLE_WORD, MAX_SLOT, OCTET, WORD, Layout
from dpstack.errors import ConfigError, PduError
from dpstack.text import octets_text

#: length, type, slot, specifier
BLOCK_HEAD: Final = 4
_MAX_BLOCK: Final = 234


class BlockType(IntEnum):
    """Types with a meaning of their own; 32 to 128 are the maker's."""

    PRM_CMD = 2
    DXB_LINKS = 3
    ISOCHRONOUS = 4
    F_PARAMETERS = 5
    DXB_SUBSCRIBERS = 7
    TIME_AR = 8
    USER_PRM = 0x81


#: as configurations have them
NAMES: Final = {int(one): one.name.lower() for one in BlockType}


class PrmCmd(NamedTuple):
    """A command to a redundant slave; its sequence number is in the specifier of the block's head, bits 7..3.

    ``function``: :class:`~dpstack.dp.pdu.alarm_blocks.PrmFunction`. ``properties``: bit 0 Primary Request for MS0 and
    MS1 is used, 1 start and stop of MS1 are used, 2 the address changes, 3 by 64. ``output_hold_time`` in 10 ms.
    """

    function: int = 0
    properties: int = 0
    output_hold_time: int = 0


class Isochronous(NamedTuple):
    """Isochronous mode. Bases of time in 1/12 us (375 to 12000), ``t_dp`` in the first, ``t_i``, ``t_o`` in the second.

    ``t_mapc`` in DP cycles 1..14; ``t_dx``, ``t_pll_w``, ``t_pll_d`` in 1/12 us.
    """

    version: int = 1
    t_base_dp: int = 1500
    t_dp: int = 1
    t_mapc: int = 1
    t_base_io: int = 1500
    t_i: int = 0
    t_o: int = 0
    t_dx: int = 0
    t_pll_w: int = 12
    t_pll_d: int = 0


class TimeAr(NamedTuple):
    """Clock synchronisation: how often, and the delay in s and 2^-32 s."""

    clock_sync_interval: int = 0
    cs_delay_seconds: int = 0
    cs_delay_fraction: int = 0


class DxbLink(NamedTuple):
    """The data of a subscriber: ``sample_length`` octets from ``sample_offset`` on of ``publisher``'s inputs."""

    publisher: int
    publisher_length: int
    sample_offset: int
    sample_length: int


class DxbSubscription(NamedTuple):
    """A link, and the slot and data area that its data go to."""

    publisher: int
    publisher_length: int
    sample_offset: int
    dest_slot: int
    offset_data_area: int
    sample_length: int


class DxbTable(NamedTuple):
    """A table of links or of subscriptions."""

    version: int
    entries: tuple[DxbLink, ...] | tuple[DxbSubscription, ...]


Content = PrmCmd | Isochronous | TimeAr | DxbTable

#: types that are one record
RECORDS: Final[Mapping[int, Layout[Any]]] = {
    BlockType.PRM_CMD: Layout("PrmCmd", PrmCmd, "function" / OCTET, "properties" / OCTET, "output_hold_time" / WORD),
    BlockType.ISOCHRONOUS: Layout(
        "IsoM parameters",
        Isochronous,
        "version" / OCTET,
        "t_base_dp" / DOUBLE_WORD,
        "t_dp" / WORD,
        "t_mapc" / OCTET,
        "t_base_io" / DOUBLE_WORD,
        "t_i" / WORD,
        "t_o" / WORD,
        "t_dx" / DOUBLE_WORD,
        "t_pll_w" / WORD,
        "t_pll_d" / WORD,
    ),
    BlockType.TIME_AR: Layout(
        "Time AR",
        TimeAr,
        "clock_sync_interval" / WORD,
        "cs_delay_seconds" / DOUBLE_WORD,
        "cs_delay_fraction" / DOUBLE_WORD,
    ),
}
#: types that are an octet of version and entries
TABLES: Final[Mapping[int, Layout[Any]]] = {
    BlockType.DXB_LINKS: Layout("DXB link", DxbLink, *(name / OCTET for name in DxbLink._fields)),
    BlockType.DXB_SUBSCRIBERS: Layout(
        "DXB subscription", DxbSubscription, *(name / OCTET for name in DxbSubscription._fields)
    ),
}


class PrmBlock(Struct, frozen=True):
    """A block of structured parameters: ``type`` 0..255 (:class:`BlockType`), ``slot`` 0..254, ``data``.

    Raises ConfigError.
    """

    #: type, 0..255 (:class:`BlockType`)
    type: int
    #: slot, 0..254
    slot: int
    #: octets behind the head
    data: bytes
    #: last octet of the head, 0 except in PrmCmd (sequence number)
    specifier: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.type <= 255 or not 0 <= self.slot <= MAX_SLOT or not 0 <= self.specifier <= 255:
            raise ConfigError(
                f"parameter block of type {self.type} for slot {self.slot}: type and specifier 0..255, slot 0..254"
            )
        if len(self.data) > _MAX_BLOCK - BLOCK_HEAD:
            raise ConfigError(
                f"parameter block of type {self.type}: {len(self.data)} octets, {_MAX_BLOCK - BLOCK_HEAD} are possible"
            )

    @classmethod
    def of(cls, content: Content, slot: int = 0, *, kind: int | None = None, specifier: int = 0) -> PrmBlock:
        """A block of ``content``; ``kind``: of a table without entries. Raises PduError if a value does not fit."""
        number = _type_of(content) if kind is None else kind
        if isinstance(content, DxbTable):
            layout = TABLES[number]
            data = bytes((content.version & 0xFF,)) + b"".join(layout.build(one) for one in content.entries)
        else:
            data = RECORDS[number].build(content)
        return cls(number, slot, data, specifier)

    @property
    def octets(self) -> bytes:
        """Its head, whose length counts itself, and the data."""
        return bytes((BLOCK_HEAD + len(self.data), self.type, self.slot, self.specifier)) + self.data

    @property
    def title(self) -> str:
        """Its type for people: ``type 2 (prm_cmd)``."""
        name = NAMES.get(self.type)
        return f"type {self.type}" + (f" ({name})" if name else "")

    @property
    def content(self) -> Content | None:
        """The decoded data, None for types that are octets only. Raises PduError for an impossible length."""
        record, entry = RECORDS.get(self.type), TABLES.get(self.type)
        count = len(self.data)
        if record is not None:
            if count != record.size:
                raise PduError(f"{self.title} has {record.size} octets of data, there are {count}")
            content: Content = record.parse(self.data)
            return content
        if entry is None:
            return None
        size = entry.size
        if count % size != 1:
            raise PduError(
                f"{self.title} has a version and entries of {size} octets each, there are {octets_text(count)}"
            )
        return DxbTable(self.data[0], tuple(entry.parse(self.data[at : at + size]) for at in range(1, count, size)))


def _type_of(content: Content) -> int:
    """The number of its type. Raises PduError for a table without entries: it may be either."""
    kinds: Mapping[int, Layout[Any]] = RECORDS
    record: object = content
    if isinstance(content, DxbTable):
        if not content.entries:
            raise PduError("a table without entries: say kind=BlockType.DXB_LINKS or BlockType.DXB_SUBSCRIBERS")
        kinds, record = TABLES, content.entries[0]
    return next(kind for kind, layout in kinds.items() if layout.make is type(record))


def parse_blocks(octets: bytes, first: int = 1) -> tuple[PrmBlock, ...]:
    """The blocks that ``octets`` are; ``first``: the number of their first octet, for messages.

    Raises PduError naming block and octet if a length cannot be.
    """
    found: list[PrmBlock] = []
    at = 0
    while at < len(octets):
        where = f"octet {first + at}: parameter block {len(found) + 1}"
        left = len(octets) - at
        if left < BLOCK_HEAD:
            raise PduError(f"{where} has a head of {BLOCK_HEAD} octets, there are {left}")
        length, kind, slot, specifier = octets[at : at + BLOCK_HEAD]
        if not BLOCK_HEAD <= length <= left:
            raise PduError(
                f"{where} says it has {octets_text(length)}: a block has {BLOCK_HEAD} at least, and {left} are left"
            )
        try:
            block = PrmBlock(kind, slot, octets[at + BLOCK_HEAD : at + length], specifier)
            _ = block.content
        except (ConfigError, PduError) as error:
            raise PduError(f"{where}: {error}") from None
        found.append(block)
        at += length
    return tuple(found)
