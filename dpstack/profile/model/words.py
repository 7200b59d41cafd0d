"""Words of process data declared as data: named bits, and scaled fields with unit and range."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from msgspec import Struct


class Word(Struct, frozen=True):
    """A 16-bit word of named bits, e.g. a control or a status word. ``bits``: name -> bit number 0..15."""

    #: name for messages
    name: str
    bits: Mapping[str, int]

    def __post_init__(self) -> None:
        numbers = list(self.bits.values())
        if any(not 0 <= bit <= 15 for bit in numbers) or len(set(numbers)) != len(numbers):
            raise ValueError(f"word {self.name}: bit numbers must be 0..15, each once")

    def mask(self, *names: str) -> int:
        """The word with exactly the named bits set."""
        value = 0
        for name in names:
            value |= 1 << self.bits[name]
        return value

    def is_set(self, value: int, name: str) -> bool:
        """Whether the named bit is set in ``value``; False if the word has no such bit."""
        return name in self.bits and bool(value >> self.bits[name] & 1)

    def names(self, value: int) -> tuple[str, ...]:
        """The names of the bits set in ``value``, lowest bit first; unnamed bits are left out."""
        return tuple(name for name, bit in sorted(self.bits.items(), key=lambda item: item[1]) if value >> bit & 1)


class Scale(Struct, frozen=True):
    """A signed field of ``bits`` where ``full`` is ``span`` of ``unit`` (default: 0x4000 = 1.0 of the reference).

    The range is what the octets can hold: -200 % .. +199.99 % for N2.
    """

    #: name of the field, for messages
    name: str
    #: count that stands for ``span``
    full: int = 0x4000
    #: value at ``full``, in ``unit``
    span: float = 1.0
    #: unit of the value; empty for a part of the reference
    unit: str = ""
    #: width of the signed field
    bits: int = 16

    def encode(self, value: float) -> int:
        """``value`` as the unsigned integer, two's complement. Raises ValueError with the possible range."""
        half = 1 << self.bits - 1
        counts = value / self.span * self.full
        try:
            raw = round(counts)
        except (ValueError, OverflowError):  # no number, or infinite
            raw = half
        if not -half <= raw < half:
            low, high = self.limits
            unit = f" {self.unit}" if self.unit else ""
            raise ValueError(f"{self.name} {value:g}{unit} is outside {low:g}..{high:.5g}{unit}")
        return raw & (half << 1) - 1

    def nearest(self, value: float) -> int:
        """``value`` as :meth:`encode` has it, or the end of the range that it is beyond."""
        counts = value / self.span * self.full
        half = 1 << self.bits - 1
        if -half <= counts < half - 1:
            return round(counts) & (half << 1) - 1
        low, high = self.limits
        return self.encode(min(max(value, low), high))

    def decode(self, word: int) -> float:
        """The value of an unsigned integer of ``bits``."""
        half = 1 << self.bits - 1
        return ((word ^ half) - half) * self.span / self.full

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest value it can hold."""
        half = 1 << self.bits - 1
        return -half * self.span / self.full, (half - 1) * self.span / self.full


#: PROFIdrive's N2: 0x4000 = 100 % of the reference.
SPEED: Final = Scale("speed")


def signed16(word: int) -> int:
    """A 16-bit word as two's complement."""
    return (word ^ 0x8000) - 0x8000
