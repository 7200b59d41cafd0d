"""Counters that begin again at the end of their range, such as the position of an encoder, and named values of them."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from dpstack.dp.process_data import Field
from dpstack.dp.process_image import Value


class Counter(NamedTuple):
    """The counts of a counter with ``range`` values, 1 or more: 0, 1 .. range - 1, 0 ..."""

    range: int
    #: shown in the other direction
    backwards: bool = False
    #: the upper half of the range is shown as negative counts
    signed: bool = False

    def shown(self, counts: int) -> int:
        """The number for people of the ``counts`` in the octets."""
        found = (-counts if self.backwards else counts) % self.range
        return found - self.range if self.signed and found >= (self.range + 1) // 2 else found

    def counts(self, shown: int) -> int:
        """The counts in the octets of a number for people. Raises ValueError with the limits."""
        low = -(self.range // 2) if self.signed else 0
        if not low <= shown < low + self.range:
            raise ValueError(f"{shown} is outside {low}..{low + self.range - 1}")
        return (-shown if self.backwards else shown) % self.range

    def distance(self, one: int, other: int) -> int:
        """The shorter way between two counts."""
        way = (one - other) % self.range
        return min(way, self.range - way)


_NO_COUNTER: Final = Counter(1)


@dataclass(frozen=True, slots=True)
class CountedField(Field):
    """A named value of a counter, most significant octet first. ``turn``: only what is left by so many counts, an
    angle; 0: all counts."""

    counter: Counter = _NO_COUNTER
    turn: float = 0

    @property
    def speaks_for_itself(self) -> bool:
        """Counts beyond the range have no turns and no angle."""
        return self.is_scaled

    def get(self, octets: bytes) -> Value:
        """The value in ``octets``; counts beyond the range as they are, or as no number if the value has a scale."""
        own = int.from_bytes(octets[self.octet : self.octet + self.length], "big") >> (self.bit or 0)
        counts = own & ((1 << self.width) - 1)
        if counts >= self.counter.range:
            return math.nan if self.is_scaled else counts
        shown: float = self.counter.shown(counts)
        if self.turn:
            shown %= self.turn
        return self._scaled(shown) if self.is_scaled else shown


def counted(found: Field, counter: Counter, turn: float = 0) -> CountedField:
    """``found`` as a value of ``counter``."""
    given = {one.name: getattr(found, one.name) for one in dataclasses.fields(Field) if one.init}
    return CountedField(**given, counter=counter, turn=turn)
