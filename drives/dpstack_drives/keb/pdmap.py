"""The process data map: which parameter stands where, as records 6000h (inputs) and 6001h (outputs).

Passages: docs/reference/drives/keb-f5.md#process-data-map, docs/reference/drives/keb-f5.md#default-map.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import zip_longest
from typing import Final

from dpstack.profile import process_data_map
from dpstack_drives.keb import table as t

MapField = process_data_map.MapField
#: octets of one of the two blocks
BLOCK: Final = 8
#: subindex 1, then an index and a set for each of 8 octets
SUBINDEXES: Final = 1 + 2 * BLOCK
_LENGTH: Final = 1
_LONGEST: Final = 2 * BLOCK
#: never as outputs: oP.27 to oP.35
FORBIDDEN: Final = range(0x231B, 0x2324)


def Entry(index: int, long: bool = False, sets: int = 1) -> MapField:  # noqa: N802 - a kind of field
    """A parameter of the inverter by its index, word or long, and its sets; signed, as no manual of ours has types.

    Control word and set speed are neutral: 0 is none of either; all others are parameters.
    """
    bits = 32 if long else 16
    return MapField(
        key=index,
        name=t.name_of(index),
        octets=bits // 8,
        neutral=index in (t.CONTROL_WORD, t.SET_SPEED),
        low=-(1 << bits - 1),
        high=(1 << bits) - 1,
        signed=True,
        text=f"{index:04X}{':long' if long else ''}{f'@{sets}' if sets != 1 else ''}",
        wants=f"takes {bits}-bit integers",
        sets=sets,
    )


class PdMap(process_data_map.FieldMap, frozen=True):
    """The values of one direction in their order; the first 8 octets are block 1, what follows is block 2."""

    fields: tuple[MapField, ...] = ()

    @classmethod
    def parse(cls, text: str) -> PdMap:
        """``2032 2034``, ``202C:long 2033@1 sy.53``: indexes in hex or names. Raises ValueError."""
        return cls(tuple(field for field in _TABLE.parse(text).fields if field is not None))

    @classmethod
    def from_records(cls, values: Mapping[int, int], second: Mapping[int, int] | None = None) -> PdMap:
        """From the values of the subindexes of a record, and of that of block 2. Raises ValueError."""
        length = values.get(_LENGTH, 0)
        if not 0 <= length <= _LONGEST:
            raise ValueError(f"a process data length of {length} octets; 0..{_LONGEST} are possible")
        entries: list[MapField] = []
        for start, record in ((0, values), (BLOCK, second or {})):
            end = min(length - start, BLOCK)
            begins = [b for b in range(end) if record.get(2 + 2 * b)]
            for begin, nxt in zip_longest(begins, begins[1:], fillvalue=end):
                if nxt - begin not in (2, 4):
                    raise ValueError(f"a value of {nxt - begin} octets at octet {start + begin}; they have 2 or 4")
                entries.append(Entry(record[2 + 2 * begin], nxt - begin == 4, record.get(3 + 2 * begin, 0)))
            if end > 0 and begins[:1] != [0]:
                raise ValueError(f"no value begins at octet {start}")
        return cls(tuple(entries))

    @property
    def octets(self) -> int:
        """Length of the process data."""
        return sum(entry.octets for entry in self.fields)

    def places(self) -> Iterable[tuple[int, MapField]]:
        """Every value with the octet at which it begins."""
        at = 0
        for entry in self.fields:
            yield at, entry
            at += entry.octets

    def octet(self, index: int) -> int | None:
        """The octet at which a parameter begins, None if it is not mapped."""
        return next((at for at, entry in self.places() if entry.key == index), None)

    def block(self, number: int) -> tuple[MapField, ...]:
        """The values of block 0 or 1."""
        return tuple(entry for at, entry in self.places() if at // BLOCK == number)

    def records(self, block: int = 0) -> list[tuple[int, int]]:
        """Subindex and value of a block's record, all 17; of block 2 without the length, which is in block 1's."""
        values = dict.fromkeys(range(2, SUBINDEXES + 1), 0)
        if block == 0:
            values[_LENGTH] = self.octets
        for at, entry in self.places():
            if at // BLOCK == block:
                values[2 + 2 * (at % BLOCK)] = entry.key
                values[3 + 2 * (at % BLOCK)] = entry.sets
        return sorted(values.items())

    def cut(self, octets: int) -> PdMap:
        """The values that fit into so many octets."""
        return PdMap(tuple(entry for at, entry in self.places() if at + entry.octets <= octets))

    def put(self, values: Mapping[int, int], octets: int) -> bytes:
        """Process data of ``octets`` length; what has no value is 0. Each value's low bits count."""
        words = process_data_map.pack(self.fields, values, octets // 2)
        return b"".join(word.to_bytes(2, "big") for word in words).ljust(octets, b"\0")


def check(inputs: PdMap, outputs: PdMap) -> str | None:
    """Why a drive would not confirm its enable for these maps; None if they are right
    (docs/reference/drives/keb-f5.md#process-data-map)."""
    for name, one in (("inputs", inputs), ("outputs", outputs)):
        if one.octets > _LONGEST:
            return f"{name}: {one.octets} octets, the operator has at most {_LONGEST}"
        for at, entry in one.places():
            if not t.INVERTER.start <= entry.key < t.INVERTER.stop:
                return f"{name}: {entry.key:04X} is no parameter of the inverter (2000..5EFF)"
            if not 1 <= entry.sets <= 0xFF:
                return f"{name}: {entry.key:04X} has no set: give 1 (set 0) .. 255, a bit for each set"
            if entry.octets == 4 and entry.key in t.WORDS:
                return f"{name}: {t.name_of(entry.key)} is a word, not a long"
            if at // BLOCK != (at + entry.octets - 1) // BLOCK:
                return f"{name}: {entry.key:04X} crosses from block 1 into block 2 (8 octets each)"
            if one is outputs and entry.key in FORBIDDEN:
                return f"outputs: {t.name_of(entry.key)} cannot be process output data (oP.27 to oP.35 never)"
    for number in (0, 1):
        into, out = (tuple(e.octets == 4 for e in one.block(number)) for one in (inputs, outputs))
        for name, shape in (("inputs", into), ("outputs", out)):
            if list(shape) != sorted(shape, reverse=True):
                return f"{name}, block {number + 1}: the long value must be the first"
        if (len(set(into)) > 1 or len(set(out)) > 1) and into != out:
            return f"block {number + 1} mixes longs and words: inputs and outputs must have the same structure there"
    return None


def _entry(word: str) -> MapField:
    name, _, sets = word.partition("@")
    name, _, kind = name.partition(":")
    if kind not in ("", "long") or (sets and not sets.isdecimal()):
        raise ValueError(f"{word!r} is no mapped value; write 2033, 202C:long, sy.51 or 2303@1 (sets, a bit for each)")
    index = t.index_of(name)
    if index is None:
        try:
            index = int(name, 16)
        except ValueError:
            raise ValueError(f"{word!r}: {name!r} is neither an index in hex nor a parameter such as sy.51") from None
    return Entry(index, kind == "long", int(sets) if sets else 1)


_TABLE: Final = process_data_map.FieldTable(find=_entry, empty="")
#: docs/reference/drives/keb-f5.md#default-map, example 1
DEFAULT_INPUTS, DEFAULT_OUTPUTS = (PdMap(tuple(map(Entry, way.default))) for way in t.FILE.maps or ())
