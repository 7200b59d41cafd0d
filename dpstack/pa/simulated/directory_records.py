"""The records of a directory, in every convention of the field and with every lie of the tests."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Final

from msgspec import Struct

from dpstack.errors import UsageError
from dpstack.pa.blocks import FUNCTION, PHYSICAL, TRANSDUCER
from dpstack.pa.simulated.block import MAX_RECORD, Block

_ENTRY: Final = 4
_MOST: Final = MAX_RECORD // _ENTRY
_KINDS: Final = (PHYSICAL, TRANSDUCER, FUNCTION)
#: the index of the first block of a slot, of the transducer blocks, and of the first block in profile 2
_FIRST, _TRANSDUCERS, _PROFILE_2 = 16, 70, 14
#: the block stands so far behind its place in the directory, in one rack in the field
SHIFT: Final = 100
#: ways to lie in the directory
LIES: Final = ("outside", "circles", "lengths", "short record")


class Layout(Struct, frozen=True, kw_only=True):
    """Where the blocks and the directory of a device stand. Raises UsageError.

    ``profile``: 2, all in slot 1, or 3, the physical block in slot 0. ``numbering``: of the entries, ``on`` over the
    records or ``anew`` in each. ``directory_slot``: 0 or 1. ``is_shifted``: blocks stand 100 behind the index in the
    directory. ``records``: ``one`` with all entries, or ``several``.
    """

    profile: int = 3
    numbering: str = "on"
    directory_slot: int = 1
    is_shifted: bool = False
    records: str = "several"

    def __post_init__(self) -> None:
        known = (
            ("profile", self.profile, (2, 3)),
            ("numbering", self.numbering, ("on", "anew")),
            ("directory_slot", self.directory_slot, (0, 1)),
            ("records", self.records, ("one", "several")),
        )
        for name, value, choices in known:
            if value not in choices:
                raise UsageError(f"{name} = {value!r}: it is {' or '.join(map(str, choices))}")

    def place(self, blocks: Sequence[Block]) -> None:
        """Give each block its slot and index. Raises UsageError if they have no room."""
        shift = SHIFT if self.is_shifted else 0
        if self.profile == 3:
            for block in blocks:
                number = 0 if block.kind == PHYSICAL else block.wanted_slot or _number(blocks, block)
                block.slot, block.index = number, shift + (block.wanted_index or _FIRST)
                if block.kind == TRANSDUCER:
                    ends = [one.index + one.count for one in blocks[: blocks.index(block)] if one.slot == number]
                    block.index = max(shift + _TRANSDUCERS, *(end + 1 for end in ends), 0)
        else:
            at = shift + _PROFILE_2
            for block in blocks:
                block.slot, block.index = 1, at
                at += block.count + 1
        if any(block.index + block.count > 254 or block.slot > 254 for block in blocks):
            raise UsageError("the blocks have no room with this layout; leave shifted out, or take profile 3")

    def directory(self, blocks: Sequence[Block], lie: str = "") -> list[bytes]:
        """The records of the directory, from index 0."""
        kinds = [[block for block in blocks if block.kind == kind] for kind in _KINDS]
        shift = SHIFT if self.is_shifted else 0
        parts = [[(block.slot, block.index - shift, block.count) for block in kind] for kind in kinds]
        chunks = [*_chunks(parts, self.records)]
        listed = [*self._composite_list([len(part) for part in parts], chunks, lie)]
        records = [_entries([*listed, *chunks[0]]), *(_entries(chunk) for chunk in chunks[1:])]
        entries = len(listed) + sum(map(len, chunks))
        header = struct.pack(">6H", 0, 1, len(records), 60_000 if lie == "lengths" else entries, 1, len(listed))
        if lie == "short record":
            records[0] = records[0][:6]
        return [header, *records]

    def _composite_list(
        self, counts: Sequence[int], chunks: Sequence[Sequence[tuple[int, int, int]]], lie: str
    ) -> Iterator[tuple[int, int, int]]:
        """The entries of the composite list: record, number of the first entry, number of blocks."""
        first = 0
        for count in counts:
            record, before = 1, 0
            while first - before >= len(chunks[record - 1]) and record < len(chunks):
                before += len(chunks[record - 1])
                record += 1
            if self.numbering == "on":
                number = first + len(_KINDS) + 1
            else:
                number = first - before + 1 + (len(_KINDS) if record == 1 else 0)
            first += count
            if lie == "outside":
                record, number = 9, 200
            elif lie == "circles":
                record, number = 1, 1
            yield record, number, count


def _number(blocks: Sequence[Block], block: Block) -> int:
    return 1 + [one for one in blocks if one.kind == block.kind].index(block)


def _chunks(parts: Sequence[list[tuple[int, int, int]]], records: str) -> Iterator[list[tuple[int, int, int]]]:
    """The entries of the blocks by record; the first one leaves room for the composite list."""
    if records == "one":
        flat = [entry for part in parts for entry in part]
        room = _MOST - len(_KINDS)
        yield flat[:room]
        yield from (flat[at : at + _MOST] for at in range(room, len(flat), _MOST))
        return
    first, *others = parts
    yield first
    for part in others:
        yield from (part[at : at + _MOST] for at in range(0, len(part), _MOST))


def _entries(entries: Sequence[tuple[int, int, int]]) -> bytes:
    return b"".join(struct.pack(">BBH", *entry) for entry in entries)
