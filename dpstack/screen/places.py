"""Places of named values and of channels in the octets of a slave, and the raw content there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final, NamedTuple

from dpstack.plant.items import FieldPlant, ModulePlant, SlavePlant
from dpstack.screen.lines import octets

INPUT: Final = "input"
OUTPUT: Final = "output"
DIRECTIONS: Final = (INPUT, OUTPUT)
#: octets of a slave
_MOST: Final = 244
_AT: Final = re.compile(r"(bool|bytes|[uif](\d{1,3})(?:le|ws)?)@(\d{1,4})(?:\.(\d))?(?::(\d{1,3}))?", re.ASCII)


class Place(NamedTuple):
    """``bits`` bits from the bit ``bit`` of the octet ``octet`` on, counted from its lowest bit."""

    octet: int
    bit: int
    bits: int

    @property
    def length(self) -> int:
        """Number of octets that it touches."""
        return max(1, -(-(self.bit + self.bits) // 8))

    def shares(self, other: Place) -> bool:
        """Whether they share bits; of places in more than one octet the octets count."""
        if self.length > 1 or other.length > 1:
            return self.octet < other.octet + other.length and other.octet < self.octet + self.length
        same = self.octet == other.octet
        return same and self.bit < other.bit + other.bits and other.bit < self.bit + self.bits

    def raw(self, digits: str | None) -> str:
        """Its content in an image of hex digits: octets, or the number in some bits of one octet. Empty if the image
        does not have it."""
        found = (digits or "")[2 * self.octet : 2 * (self.octet + self.length)]
        if len(found) < 2 * self.length:
            return ""
        if self.length > 1 or self.bits == 8:
            return octets(found)
        try:
            return str(int(found, 16) >> self.bit & ((1 << self.bits) - 1))
        except ValueError:
            return ""


def place_of(field: FieldPlant) -> Place | None:
    """The place of a named value; None if a newer version writes it in another way."""
    found = _AT.fullmatch(field.at.replace(" ", ""))
    if found is None:
        return None
    kind, width, octet, bit, length = found.groups()
    bits = 1 if kind == "bool" else 8 * int(length or 1) if kind == "bytes" else int(width)
    return Place(int(octet), int(bit or 0), bits)


def area_of(module: ModulePlant, direction: str) -> Place | None:
    """The octets of a slot; None if it has none in this direction, or the stream does not say where."""
    at, length = (module.input_at, module.inputs) if direction == INPUT else (module.output_at, module.outputs)
    if at is None or not isinstance(length, int) or not 0 < length <= _MOST or not 0 <= at <= _MOST:
        return None
    return Place(at, 0, 8 * length)


def channels_of(module: ModulePlant, direction: str) -> list[Place]:
    """The channels of a slot; empty if their width is not known."""
    area = area_of(module, direction)
    width = (module.input_width if direction == INPUT else module.output_width) or 0
    if area is None or width <= 0:
        return []
    starts = range(8 * area.octet, 8 * area.octet + area.bits - width + 1, width)
    return [Place(start // 8, start % 8, width) for start in starts]


def slots_of(plant: SlavePlant) -> Iterator[tuple[int, ModulePlant]]:
    """The modules with their slots; an older version does not number them."""
    for number, module in enumerate(plant.modules or [], 1):
        yield number if module.slot is None else module.slot, module


def fields_of(plant: SlavePlant, direction: str) -> list[FieldPlant]:
    """The named values of a direction."""
    return (plant.inputs if direction == INPUT else plant.outputs) or []
