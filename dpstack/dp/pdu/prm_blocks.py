"""Structured parameters of Set_Prm (Prm_Structure in DPV1_Status_3): blocks, each with a head of four octets.

Layouts and numbers of types: docs/reference/protocol.md#structured-parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from dpstack.dp.pdu.layouts import MAX_SLOT
from dpstack.errors import ConfigError, PduError
from dpstack.text import octets_text

if TYPE_CHECKING:
    from dpstack.dp.pdu.prm_contents import Content

#: length, type, slot, specifier
BLOCK_HEAD: Final = 4
_MAX_BLOCK: Final = 234


class PrmBlock(Struct, frozen=True):
    """A block of structured parameters: ``type`` 0..255 (``BlockType``), ``slot`` 0..254, ``data``.

    Raises ConfigError.
    """

    #: type, 0..255 (``BlockType``)
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
        from dpstack.dp.pdu.prm_contents import RECORDS, TABLES, DxbTable, type_of

        number = type_of(content) if kind is None else kind
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
        from dpstack.dp.pdu.prm_contents import NAMES

        name = NAMES.get(self.type)
        return f"type {self.type}" + (f" ({name})" if name else "")

    @property
    def content(self) -> Content | None:
        """The decoded data, None for types that are octets only. Raises PduError for an impossible length."""
        from dpstack.dp.pdu.prm_contents import RECORDS, SHORTER, TABLES, DxbTable

        record, entry = RECORDS.get(self.type), TABLES.get(self.type)
        count = len(self.data)
        if record is not None:
            if count not in (record.size, SHORTER.get(self.type)):
                raise PduError(f"{self.title} has {record.size} octets of data, there are {count}")
            content: Content = record.parse(self.data.ljust(record.size, b"\0"))
            return content
        if entry is None:
            return None
        size = entry.size
        if count % size != 1:
            raise PduError(
                f"{self.title} has a version and entries of {size} octets each, there are {octets_text(count)}"
            )
        return DxbTable(self.data[0], tuple(entry.parse(self.data[at : at + size]) for at in range(1, count, size)))


class Link(Struct, frozen=True):
    """``length`` octets from ``offset`` on of the inputs of ``publisher``, which has ``publisher_length`` of them.

    ``slot``: the slot that they go to, None in a link table and in a filter block. ``to``: their place in the outputs
    of that slot, or in all outputs (filter block); None in a link table.
    """

    publisher: int
    publisher_length: int
    offset: int
    length: int
    slot: int | None = None
    to: int | None = None

    @property
    def text(self) -> str:
        """One line for people."""
        last = self.offset + self.length - 1
        octets = f"octet {self.offset}" if self.length == 1 else f"octets {self.offset}..{last}"
        where = "" if self.to is None else f" to output octet {self.to}"
        where += "" if self.slot is None else f" of slot {self.slot}"
        return f"{octets} of the {self.publisher_length} of publisher {self.publisher}{where}"


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
