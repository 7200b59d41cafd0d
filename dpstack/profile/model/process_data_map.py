"""Process data maps: the fields in a drive's inputs and outputs beside control word and set point, in their order.

Notation, fields and storage of a map belong to the drive. The checks of maps and values are the same for all drives:
:class:`~dpstack.profile.master.mapped_core.MappedCore`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol


class MappedField(Protocol):
    """A value of one or two words in the process data."""

    @property
    def key(self) -> int:
        """Number of the field in the drive."""

    @property
    def name(self) -> str: ...

    @property
    def octets(self) -> int:
        """2 or 4."""

    @property
    def neutral(self) -> bool:
        """Whether an output may be sent as 0 while there is no other value: 0 moves and changes nothing.

        A parameter that the drive keeps (a ramp time, a limit) is not neutral: 0 would be written to it.
        """

    def encode(self, value: float) -> int:
        """The integer on the wire. Raises ValueError with the range."""

    def decode(self, raw: int) -> int | float:
        """The value of an unsigned integer on the wire, in its unit."""


class DataMap(Protocol):
    """Fields in their order; as text the way users write them, empty without any."""

    @property
    def fields(self) -> Sequence[MappedField | None]:
        """None for a word that carries nothing."""


def used(codes: Sequence[int], room: int | None = None) -> tuple[int, ...]:
    """``codes`` without the empty ones at the end, of the first ``room`` words only."""
    found = tuple(codes if room is None else codes[:room])
    while found and not found[-1]:
        found = found[:-1]
    return found


def places(fields: Sequence[MappedField | None]) -> Iterator[tuple[int, MappedField]]:
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


def given(values: Sequence[str | None], fields: Sequence[MappedField | None]) -> dict[int, int]:
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


def find(fields: Sequence[MappedField | None], name: str | int) -> MappedField | None:
    """A field by its name (any case) or its key."""
    for field in fields:
        if field is not None and (field.key == name or field.name.lower() == str(name).strip().lower()):
            return field
    return None


def pack(fields: Sequence[MappedField | None], values: Mapping[int, int], words: int) -> list[int]:
    """So many words of the integers by key; 0 without one, and what does not fit is left out."""
    found = [0] * words
    for at, field in places(fields):
        raw = values.get(field.key, 0)
        halves = (raw >> 16 & 0xFFFF, raw & 0xFFFF) if field.octets == 4 else (raw & 0xFFFF,)
        if at + len(halves) <= words:
            found[at : at + len(halves)] = halves
    return found


def raws(fields: Sequence[MappedField | None], words: Sequence[int]) -> dict[int, int]:
    """The unsigned integers by key, as far as there are words."""
    found: dict[int, int] = {}
    for at, field in places(fields):
        size = field.octets // 2
        if at + size <= len(words):
            found[field.key] = words[at] if size == 1 else words[at] << 16 | words[at + 1]
    return found


def decoded(fields: Sequence[MappedField | None], words: Sequence[int]) -> dict[str, int | float]:
    """The values by name, in their units."""
    known = raws(fields, words)
    return {field.name: field.decode(known[field.key]) for _, field in places(fields) if field.key in known}
