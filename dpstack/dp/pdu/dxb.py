"""Data exchange broadcast (DXB, DP-V2): filters of a subscriber, and the link status message.

A publisher answers Data_Exchange to all stations; a subscriber takes octets out of that answer. Its links stand in a
block of Set_Prm: type 3 (link table, without a place for the octets), type 7 (subscriber table: slot and offset), or
SINAMICS's filter block E2 (offset in the set points). Decisions and sources: docs/reference/decisions/dxb.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import Final, NamedTuple

from dpstack.dp.pdu.prm_blocks import Link as Link
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.dp.pdu.prm_contents import BlockType, DxbLink, DxbSubscription, DxbTable
from dpstack.errors import PduError
from dpstack.fdl.telegram import MAX_DATA
from dpstack.params import MAX_STATION
from dpstack.text import octets_text

#: type of SINAMICS's filter block, and its version identifier
SINAMICS_FILTER: Final = 0xE2
#: links of one link status message: two octets each, 59 are possible
MAX_LINKS: Final = 29
_HEAD: Final = 2  # version identifier and number of links of a filter block
_LINK_HEAD: Final = 2  # publisher and its length
_TAP: Final = 3
_LINK_STATUS: Final = 0x80
_LINK_ERROR: Final = 0x40
_DATA_EXIST: Final = 0x01


def link_problem(links: Iterable[Link]) -> str | None:
    """Why ``links`` cannot be one filter, None if they can."""
    lengths: dict[int, int] = {}
    taken: dict[tuple[int | None, int], Link] = {}
    for number, link in enumerate(links, 1):
        where = f"link {number}"
        known = lengths.setdefault(link.publisher, link.publisher_length)
        if not 0 <= link.publisher <= MAX_STATION:
            return f"{where}: there is no publisher {link.publisher}: 0..{MAX_STATION}"
        if not 1 <= link.publisher_length <= MAX_DATA:
            return f"{where}: a publisher of {octets_text(link.publisher_length)}: 1..{MAX_DATA}"
        if known != link.publisher_length:
            return f"{where}: publisher {link.publisher} has {link.publisher_length} octets, above {known}"
        if not link.length or link.offset + link.length > link.publisher_length:
            end = link.offset + link.length
            return f"{where}: octets {link.offset}..{end - 1} of a publisher with {link.publisher_length}"
        if link.to is None:
            continue
        for at in range(link.to, link.to + link.length):
            first = taken.setdefault((link.slot, at), link)
            if first is not link:
                of = "" if link.slot is None else f" of slot {link.slot}"
                two = f"publishers {first.publisher} and {link.publisher}"
                return f"{where}: {two} both give output octet {at}{of}"
    return None


class DriveTap(NamedTuple):
    """``length`` octets from ``offset`` on of a publisher go to ``target`` in the set points of the subscriber."""

    offset: int
    target: int
    length: int


class DriveLink(NamedTuple):
    """The taps of one publisher with ``publisher_length`` octets of inputs."""

    publisher: int
    publisher_length: int
    taps: tuple[DriveTap, ...]


class DriveFilter(NamedTuple):
    """SINAMICS's filter block (type E2): links, each at an offset counted from the version identifier.

    Fields: SINAMICS S110 function manual 01/2011, p 605. Their widths are unverified (docs/reference/decisions/dxb.md).
    """

    links: tuple[DriveLink, ...]
    version: int = SINAMICS_FILTER

    @classmethod
    def parse(cls, data: bytes) -> DriveFilter:
        """Read the octets behind the head of the block. Raises PduError."""
        if len(data) < _HEAD or len(data) < _HEAD + data[1]:
            raise PduError(f"filter block: version, number of links and their offsets, there are {len(data)} octets")
        starts = [*data[_HEAD : _HEAD + data[1]], len(data)]
        links: list[DriveLink] = []
        for number, (start, end) in enumerate(pairwise(starts), 1):
            size = end - start
            if start < _HEAD + data[1] or end > len(data) or size < _LINK_HEAD or (size - _LINK_HEAD) % _TAP:
                raise PduError(f"filter block: link {number} from octet {start} to {end}: 2 octets and 3 for each tap")
            publisher, length = data[start : start + _LINK_HEAD]
            taps = range(start + _LINK_HEAD, end, _TAP)
            links.append(DriveLink(publisher, length, tuple(DriveTap(*data[at : at + _TAP]) for at in taps)))
        return cls(tuple(links), data[0])

    @property
    def data(self) -> bytes:
        """The octets behind the head of the block. Raises PduError if they do not fit."""
        bodies = [
            bytes((one.publisher, one.publisher_length)) + b"".join(bytes(tap) for tap in one.taps)
            for one in self.links
        ]
        at = _HEAD + len(bodies)
        starts = bytearray()
        for body in bodies:
            if at > 0xFF:
                raise PduError(f"filter block: link {len(starts) + 1} begins at octet {at}, 255 is the last offset")
            starts.append(at)
            at += len(body)
        return bytes((self.version, len(bodies))) + bytes(starts) + b"".join(bodies)


def filter_of(block: PrmBlock) -> DriveFilter | None:
    """The filter of a block of type E2; None for another block, and for octets of another maker's layout."""
    if block.type != SINAMICS_FILTER or block.data[:1] != bytes((SINAMICS_FILTER,)):
        return None
    try:
        return DriveFilter.parse(block.data)
    except PduError:
        return None


def links_of(blocks: Iterable[PrmBlock]) -> tuple[Link, ...]:
    """The links in ``blocks`` of structured parameters, in their order."""
    return tuple(link for block in blocks for link in _links_of_block(block))


def _links_of_block(block: PrmBlock) -> Iterator[Link]:
    table = filter_of(block)
    if table is not None:
        for one in table.links:
            for tap in one.taps:
                yield Link(one.publisher, one.publisher_length, tap.offset, tap.length, None, tap.target)
    elif block.type in (BlockType.DXB_LINKS, BlockType.DXB_SUBSCRIBERS):
        content = block.content
        for entry in content.entries if isinstance(content, DxbTable) else ():
            slot, to = (entry.dest_slot, entry.offset_data_area) if isinstance(entry, DxbSubscription) else (None, None)
            yield Link(entry.publisher, entry.publisher_length, entry.sample_offset, entry.sample_length, slot, to)


def block_of(links: Iterable[Link], *, sinamics: bool = False) -> PrmBlock:
    """The block of ``links``: a subscriber table if they have slots, else a link table, or SINAMICS's filter block.

    Raises PduError.
    """
    given = tuple(links)
    if sinamics:
        by_publisher: dict[tuple[int, int], list[DriveTap]] = {}
        for link in given:
            taps = by_publisher.setdefault((link.publisher, link.publisher_length), [])
            taps.append(DriveTap(link.offset, link.to or 0, link.length))
        table = DriveFilter(tuple(DriveLink(*key, tuple(taps)) for key, taps in by_publisher.items()))
        return PrmBlock(SINAMICS_FILTER, 0, table.data)
    if any(link.slot is not None for link in given):
        rows = tuple(
            DxbSubscription(
                link.publisher, link.publisher_length, link.offset, link.slot or 0, link.to or 0, link.length
            )
            for link in given
        )
        return PrmBlock.of(DxbTable(1, rows), kind=BlockType.DXB_SUBSCRIBERS)
    plain = tuple(DxbLink(link.publisher, link.publisher_length, link.offset, link.length) for link in given)
    return PrmBlock.of(DxbTable(1, plain), kind=BlockType.DXB_LINKS)


class LinkState(NamedTuple):
    """One link in a link status message (VPC3+C manual, p 61).

    ``status``: valid data came in the last monitoring time. ``error``: the last broadcast had another length than the
    filter says. ``exists``: valid data came in the monitoring time that runs.
    """

    publisher: int
    status: bool
    error: bool
    exists: bool

    @property
    def octets(self) -> bytes:
        """The two octets of the link."""
        flags = self.status * _LINK_STATUS | self.error * _LINK_ERROR | self.exists * _DATA_EXIST
        return bytes((self.publisher, flags))

    @property
    def words(self) -> str:
        """Its state for people."""
        if self.error:
            return "the broadcast has another length than the filter"
        if self.status:
            return "valid data"
        return "data begin to come" if self.exists else "no data"

    @property
    def text(self) -> str:
        """One line for people."""
        return f"publisher {self.publisher}: {self.words}"


def link_states(data: bytes) -> tuple[LinkState, ...]:
    """The links of a link status message from its data; empty if they are no pairs of octets."""
    if len(data) % 2:
        return ()
    return tuple(
        LinkState(data[at], *(bool(data[at + 1] & bit) for bit in (_LINK_STATUS, _LINK_ERROR, _DATA_EXIST)))
        for at in range(0, len(data), 2)
    )
