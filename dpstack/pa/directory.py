"""The directory of a device (device management): header, composite list and the places of the blocks.

It stands in slot 1 (or 0) from index 0. A reader must take several conventions, see :func:`readings`. Sources:
docs/reference/decisions/pa.md.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from msgspec import Struct

from dpstack.errors import PduError
from dpstack.pa.blocks import FUNCTION, PHYSICAL, TRANSDUCER

#: kinds of the composite list in their order; a fourth is the link objects
KINDS: Final = (PHYSICAL, TRANSDUCER, FUNCTION)
HEADER_LENGTH: Final = 12
ENTRY_LENGTH: Final = 4
#: records with entries stand at the indices 1 to 13 (5.2.6.2 of the profile)
MOST_RECORDS: Final = 13
#: blocks of a device; what claims more is taken for damaged
MOST_BLOCKS: Final = 255


class Header(NamedTuple):
    """The header at index 0: six whole numbers."""

    directory_id: int
    revision: int
    #: further records with entries, from index 1
    records: int
    #: entries of all records, those of the composite list among them
    entries: int
    #: number of the first entry of the composite list
    first_list_entry: int
    #: entries of the composite list: physical, transducer, function blocks, and link objects if there are four
    list_entries: int

    @classmethod
    def parse(cls, octets: bytes) -> Header:
        """Raises :class:`~dpstack.errors.PduError` if the octets are no header of a directory."""
        if len(octets) < HEADER_LENGTH:
            raise PduError(f"the header of the directory has {len(octets)} octets, not {HEADER_LENGTH}")
        header = cls(*struct.unpack(">6H", octets[:HEADER_LENGTH]))
        if not 1 <= header.records <= MOST_RECORDS:
            raise PduError(f"the directory claims {header.records} records, not 1 to {MOST_RECORDS}")
        if not 2 <= header.list_entries <= 4:
            raise PduError(f"the directory claims {header.list_entries} kinds of blocks, not 2 to 4")
        if header.entries > MOST_BLOCKS + header.list_entries:
            raise PduError(f"the directory claims {header.entries} entries, more than {MOST_BLOCKS} blocks")
        return header


class Place(Struct, frozen=True):
    """The place of a block. ``number``: from 1 within its kind; ``parameters``: their count as the directory has it."""

    kind: int
    number: int
    slot: int
    index: int
    parameters: int


class ListEntry(NamedTuple):
    """An entry of the composite list: the first entry of a kind and the number of its blocks."""

    record: int
    entry: int
    blocks: int


def _entries(octets: bytes) -> list[tuple[int, int, int]]:
    whole = len(octets) // ENTRY_LENGTH * ENTRY_LENGTH
    return list(struct.iter_unpack(">BBH", octets[:whole]))


def composite_list(header: Header, records: Mapping[int, bytes]) -> list[ListEntry]:
    """The entries of the composite list, in the order of :data:`KINDS`.

    ``records``: octets by index, from 1 without a gap. Raises :class:`~dpstack.errors.PduError` if the list is cut
    short or claims too many blocks.
    """
    entries = _all_entries(records)[: header.list_entries]
    if len(entries) < header.list_entries:
        raise PduError(f"the directory ends within its list of blocks: {len(entries)} of {header.list_entries} entries")
    found = [ListEntry(*entry) for entry in entries][: len(KINDS)]
    if (blocks := sum(entry.blocks for entry in found)) > MOST_BLOCKS:
        raise PduError(f"the directory claims {blocks} blocks, more than {MOST_BLOCKS}")
    return found


def _all_entries(records: Mapping[int, bytes]) -> list[tuple[int, int, int]]:
    return [entry for index in sorted(records) for entry in _entries(records[index])]


def next_record(header: Header, records: Mapping[int, bytes]) -> int | None:
    """The index of the record that the reader still needs; None: it has all entries.

    Devices exist whose header counts fewer records than there are (OXYMAT 6: 1 of 3), so the entries decide. A record
    beyond the header's count may be refused; then the directory ends there.
    """
    index = len(records) + 1
    if index <= header.records or (len(_all_entries(records)) < header.entries and index <= MOST_RECORDS):
        return index
    return None


def readings(header: Header, records: Mapping[int, bytes]) -> Iterator[Sequence[Place]]:
    """The blocks of a directory under each convention that fits, the likeliest first.

    Numbers of entries run on over the records, as the profile says; or they start anew in each record, with or without
    the entries of the composite list. The block objects decide: the caller reads them and takes the first convention
    whose places hold blocks of the right kind. Raises :class:`~dpstack.errors.PduError` if the list is damaged or no
    convention gives places inside the directory.
    """
    wanted = composite_list(header, records)
    found = []
    for start in (_runs_on, _anew_in_record, _anew_after_list):
        places = _places(header, records, wanted, start)
        if places is not None and places not in found:
            found.append(places)
            yield places
    if not found:
        raise PduError("the directory points outside itself: its list names entries that its records do not have")


def _runs_on(header: Header, records: Mapping[int, bytes], entry: ListEntry) -> int:
    return entry.entry - header.first_list_entry


def _before(records: Mapping[int, bytes], index: int) -> int:
    return sum(len(records.get(at, b"")) // ENTRY_LENGTH for at in range(1, index))


def _anew_in_record(header: Header, records: Mapping[int, bytes], entry: ListEntry) -> int:
    return _before(records, entry.record) + entry.entry - 1


def _anew_after_list(header: Header, records: Mapping[int, bytes], entry: ListEntry) -> int:
    return _anew_in_record(header, records, entry) - header.list_entries


_Start = Callable[[Header, Mapping[int, bytes], ListEntry], int]


def _places(
    header: Header, records: Mapping[int, bytes], wanted: Sequence[ListEntry], start: _Start
) -> list[Place] | None:
    entries = _all_entries(records)
    places: list[Place] = []
    for kind, entry in zip(KINDS, wanted, strict=False):
        if not entry.blocks:
            continue
        first = start(header, records, entry)
        part = entries[first : first + entry.blocks] if first >= header.list_entries else []
        if len(part) < entry.blocks or any(not count for _, _, count in part):
            return None
        places += [Place(kind, number, *found) for number, found in enumerate(part, 1)]
    return places
