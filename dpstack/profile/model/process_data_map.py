"""Process data maps: the fields in a drive's inputs and outputs beside control word and set point, in their order.

The fields of a drive and how users write them are a :class:`FieldTable`, of a device file or of a drive's Python; where
the drive keeps its maps belongs to the drive. The checks of maps and values are the same for all drives:
:class:`~dpstack.profile.master.mapped_core.MappedCore`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final

from msgspec import Struct

from dpstack.profile.model.params import ParamSpec

#: the highest value of a word
_WORD: Final = 0xFFFF


class MapField(Struct, frozen=True, kw_only=True):
    """A value of one or two words: a parameter of the drive (``spec``), or a number of its own.

    On the wire stands value x ``per_unit``, with a sign if ``signed``. ``low`` and ``high`` are in ``unit``.
    """

    #: number of the field in the drive
    key: int
    name: str
    octets: int = 2
    #: 0 moves and changes nothing; False for a parameter that the drive keeps, and for a limit
    neutral: bool = True
    per_unit: float = 1
    low: float = 0
    high: float = _WORD
    unit: str = ""
    signed: bool = False
    #: the parameter whose type, scale and limits it has; None: those of this field
    spec: ParamSpec | None = None
    #: in the text of a map; "": by its name
    text: str = ""
    #: in messages; "": by its name
    label: str = ""
    #: what people read behind the range, see ``limit`` in device files
    limit: str = ""
    #: the whole numbers that it takes, for people; "": its range says it
    wants: str = ""
    #: why it cannot be written; "": it can
    read_only: str = ""
    #: the data sets in which it is written, bit n for set n
    sets: int = 1

    def encode(self, value: float) -> int:
        """The integer on the wire. Raises ValueError with the range."""
        what = self.label or self.name
        if self.read_only:
            raise ValueError(f"{what} {self.read_only}")
        if self.spec is not None:
            return self.spec.to_raw(value) & self._mask
        fits = math.isfinite(value) and self.low <= value <= self.high
        if not fits and not self.wants:
            unit = f" {self.unit}" if self.unit else ""
            high = f"{self.high:.0f}" if self.high == int(self.high) else f"{self.high:.5g}"
            limit = f" ({self.limit})" if self.limit else ""
            raise ValueError(f"{what} {value:g}{unit} is outside {self.low:g}..{high}{unit}{limit}")
        if not fits or (abs(self.per_unit) == 1 and value != int(value)):
            raise ValueError(f"{what} {self.wants or 'takes whole numbers'}, not {value:g}")
        return round(value * self.per_unit) & self._mask

    def decode(self, raw: int) -> int | float:
        """The value of an unsigned integer on the wire, in its unit."""
        if self.spec is not None:
            return self.spec.to_value(raw)
        half = self._mask + 1 >> 1
        raw = (raw ^ half) - half if self.signed else raw
        return raw if self.per_unit == 1 else raw / self.per_unit

    @property
    def _mask(self) -> int:
        return (1 << 8 * self.octets) - 1


class FieldMap(Struct, frozen=True):
    """Fields in their order, None for a word that carries nothing; as text the way users write them."""

    fields: tuple[MapField | None, ...] = ()
    #: in the text for a word that carries nothing
    empty: str = "-"

    def __str__(self) -> str:
        words = [self.empty if field is None else field.text or field.name for field in self.fields]
        return " ".join(words[: len(used(self.codes))])

    @property
    def codes(self) -> tuple[int, ...]:
        """The fields by their numbers in the drive, 0 for an empty word."""
        return tuple(0 if field is None else field.key for field in self.fields)

    def place(self, key: int) -> int | None:
        """The word at which a field begins; None if the map does not have it."""
        return next((at for at, field in places(self.fields) if field.key == key), None)


class FieldTable(Struct, frozen=True, kw_only=True):
    """The fields that a map may have one way, and how a user writes a map: their names or numbers in order."""

    #: those that the manual lists, by their number in the drive
    fields: Mapping[int, MapField] = {}
    #: words that a map has at most
    most: int = _WORD
    #: their names, for people, such as ``PZD2 to PZD12``
    places: str = ""
    #: a map always has ``most`` words
    padded: bool = False
    #: in the text for a word that carries nothing; "": each carries something
    empty: str = "-"
    #: what a field is called, for people, and many of them
    noun: str = "process data of the drive"
    nouns: str = "process data"
    #: how it is written, for people; "": by the nearest names
    hint: str = ""
    #: the outputs, which the drive is written
    outputs: bool = False
    #: what the drive does with an output that a map has twice
    twice: str = ""
    #: finds a field that is not in ``fields``, by a word of a map
    find: Callable[[str], MapField | None] | None = None
    #: and by its number in the drive
    by_code: Callable[[int], MapField] | None = None

    def of(self, codes: Iterable[int]) -> FieldMap:
        """The map with these numbers, as the drive has it."""
        return FieldMap(tuple(self._field(code) if code else None for code in codes), self.empty)

    def parse(self, text: str, room: int | None = None) -> FieldMap:
        """``room``: words of the telegram, where that has fewer. Raises ValueError with what to write."""
        words = text.replace(",", " ").split()
        if room is not None and len(words) > room:
            raise ValueError(f"{len(words)} {self.nouns}, the telegram has room for {room}")
        if len(words) > self.most:
            places = f" ({self.places})" if self.places else ""
            raise ValueError(f"{len(words)} {self.nouns}, there are {self.most}{places}")
        found: list[MapField | None] = []
        for word in words:
            field = self._named(word)
            if field is not None and self.outputs:
                if field.read_only:
                    raise ValueError(f"{field.name} {field.read_only}")
                if self.twice and field in found:
                    raise ValueError(f"{field.name} twice: {self.twice}")
            found.append(field)
        return FieldMap((*found, *(None,) * (self.most - len(found) if self.padded else 0)), self.empty)

    def _field(self, code: int) -> MapField:
        found = self.fields.get(code)
        if found is None:
            found = MapField(key=code, name=str(code)) if self.by_code is None else self.by_code(code)
        return found

    def _named(self, word: str) -> MapField | None:
        if word == self.empty:
            return None
        if self.find is not None:
            found = self.find(word)
        else:
            number = int(word) if word.isascii() and word.isdecimal() else None
            if number == 0:
                return None
            named = (one for one in self.fields.values() if one.key == number or one.name == word.lower())
            found = next(named, None)
        if found is None:
            hint = self.hint
            if not hint:
                names = [one.name for one in self.fields.values()]
                import difflib  # here, as most names are right

                near = difflib.get_close_matches(word.lower(), names, n=1)
                hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(names)}"
            raise ValueError(f"{word!r} is no {self.noun}; {hint}")
        return found


def used(codes: Sequence[int], room: int | None = None) -> tuple[int, ...]:
    """``codes`` without the empty ones at the end, of the first ``room`` words only."""
    found = tuple(codes if room is None else codes[:room])
    while found and not found[-1]:
        found = found[:-1]
    return found


def places(fields: Sequence[MapField | None]) -> Iterator[tuple[int, MapField]]:
    """Every field with the word at which it begins."""
    at = 0
    for field in fields:
        if field is None:
            at += 1
            continue
        yield at, field
        at += field.octets // 2


def split(text: str) -> tuple[str, tuple[str | None, ...]]:
    """``dr-04=2.5 dr-03``: the map alone, and what stands behind the ``=`` of each word of it."""
    words = [word.partition("=") for word in text.replace(",", " ").split()]
    return " ".join(name for name, _, _ in words), tuple(value if given else None for _, given, value in words)


def given(values: Sequence[str | None], fields: Sequence[MapField | None]) -> dict[int, int]:
    """The integers by key of what :func:`split` found behind the words of these fields. Raises ValueError."""
    found: dict[int, int] = {}
    for field, text in zip(fields, values, strict=False):
        if text is None:
            continue
        if field is None:
            raise ValueError(f"={text}: an empty word has no value")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError(f"{field.name}={text}: {text!r} is no number")
        found[field.key] = field.encode(value)
    return found


def find(fields: Sequence[MapField | None], name: str | int) -> MapField | None:
    """A field by its name (any case) or its key."""
    for field in fields:
        if field is not None and (field.key == name or field.name.lower() == str(name).strip().lower()):
            return field
    return None


def pack(fields: Sequence[MapField | None], values: Mapping[int, int], words: int) -> list[int]:
    """So many words of the integers by key; 0 without one, and what does not fit is left out."""
    found = [0] * words
    for at, field in places(fields):
        raw = values.get(field.key, 0)
        halves = (raw >> 16 & 0xFFFF, raw & 0xFFFF) if field.octets == 4 else (raw & 0xFFFF,)
        if at + len(halves) <= words:
            found[at : at + len(halves)] = halves
    return found


def raws(fields: Sequence[MapField | None], words: Sequence[int]) -> dict[int, int]:
    """The unsigned integers by key, as far as there are words."""
    found: dict[int, int] = {}
    for at, field in places(fields):
        size = field.octets // 2
        if at + size <= len(words):
            found[field.key] = words[at] if size == 1 else words[at] << 16 | words[at + 1]
    return found


def decoded(fields: Sequence[MapField | None], words: Sequence[int]) -> dict[str, int | float]:
    """The values by name, in their units."""
    known = raws(fields, words)
    return {field.name: field.decode(known[field.key]) for _, field in places(fields) if field.key in known}
