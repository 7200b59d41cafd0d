"""The map of a slave: slot, module, direction, octets, channels; from identifier octets and, if known, its GSD file.

A slot is a module of the GSD file, or one identifier if no file is known. Slot numbers: identifier number + 1, or as
Modul_Offset of the file says. A channel is a place in the octets of a slot: number * width, counted in bits from the
lowest bit of the slot's first octet.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from enum import StrEnum
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from dpstack.dp.pdu.diag_blocks import FIRST_SLOT
from dpstack.gsd.identifiers import Identifier, parse_identifiers

if TYPE_CHECKING:
    from dpstack.gsd.diag_texts import DiagTexts

#: bits of a channel by the unit of its identifier, if the module's name says nothing: words are analogue channels,
#: single octets are eight bits each
_WORD: Final = 16
_BIT: Final = 1
#: octets of one identifier that is consistent as a whole are one value or several of unknown widths
_UNKNOWN: Final = 0
#: names of modules say more than the unit: "2 AI", "AO 4-20mA", "8DI/24V DC"; compiled with the first module
_ANALOGUE: Final = r"(?<![^\W\d_])A[IO](?![^\W\d_])|anal[oó]g"
_DIGITAL: Final = r"(?<![^\W\d_])D[IO](?![^\W\d_])|digital"
#: slave configurations whose maps are kept
_KEPT: Final = 256


class Direction(StrEnum):
    """Seen from the master."""

    INPUT = "input"
    OUTPUT = "output"


class Area(Struct, frozen=True):
    """The octets of one slot in one direction. ``at``: the first of them in the image; ``octets``: their number, 0
    without any; ``width``: bits of a channel, 0: not known."""

    at: int = 0
    octets: int = 0
    width: int = _UNKNOWN

    @property
    def channels(self) -> int:
        """Number of channels; 0 if their width is not known."""
        return 8 * self.octets // self.width if self.width else 0

    @property
    def mask(self) -> int:
        """Its bits in the whole image as one number, as :attr:`dpstack.dp.process_data.Field.mask`."""
        return ((1 << 8 * self.octets) - 1) << 8 * self.at

    def channel_mask(self, number: int, width: int) -> int:
        """The bits of a channel of ``width`` bits, as :attr:`mask`; 0 if the slot has no such channel."""
        if not width or (number + 1) * width > 8 * self.octets:
            return 0
        return ((1 << width) - 1) << (8 * self.at + number * width)

    @property
    def text(self) -> str:
        """The octets for people: ``1 to 4``."""
        return f"{self.at}" if self.octets == 1 else f"{self.at} to {self.at + self.octets - 1}"

    @property
    def channel_text(self) -> str:
        """Octets and channels for people: ``1 to 4, 2 channels``; empty without octets."""
        count = self.channels
        channels = f", {count} channel{'s' * (count != 1)}" if count else ""
        return f"{self.text}{channels}" if self.octets else ""


class Slot(Struct, frozen=True):
    """One slot. ``name``: of its module, empty if it is not known or the slot is empty; ``config``: its identifier
    octets."""

    number: int
    name: str
    config: bytes
    inputs: Area = Area()
    outputs: Area = Area()

    def area(self, direction: Direction) -> Area:
        return self.inputs if direction is Direction.INPUT else self.outputs

    @property
    def is_empty(self) -> bool:
        """Whether it has neither a module nor octets."""
        return not (self.name or self.inputs.octets or self.outputs.octets)

    @property
    def title(self) -> str:
        """Slot and module for people: ``slot 3 (2 AI)``."""
        return f"slot {self.number} ({self.name})" if self.name else f"slot {self.number}"

    @property
    def text(self) -> str:
        """One line for people: ``slot 3 "2 AI": inputs 1 to 4, 2 channels``."""
        places = [f"{direction}s {area.channel_text}" for direction, area in self.areas() if area.octets] or [
            "empty" if self.is_empty else "no process data"
        ]
        name = f' "{self.name}"' if self.name else ""
        return f"slot {self.number}{name}: {'; '.join(places)}"

    def areas(self) -> Iterator[tuple[Direction, Area]]:
        yield Direction.INPUT, self.inputs
        yield Direction.OUTPUT, self.outputs

    def as_dict(self) -> dict[str, object]:
        """Plain JSON data: numbers of octets, the first of them in the image, bits of a channel (0: not known)."""
        made: dict[str, object] = {"slot": self.number, "name": self.name, "config": self.config.hex()}
        for direction, area in self.areas():
            made |= {
                f"{direction}s": area.octets,
                f"{direction}_at": area.at,
                f"{direction}_width": area.width,
            }
        return made


class SlotMap(Struct, frozen=True):
    """All slots of a slave, in order."""

    slots: tuple[Slot, ...]

    def slot(self, number: int) -> Slot | None:
        """The slot with this number; None if the configuration has none."""
        first = self.slots[0].number if self.slots else 0
        return self.slots[number - first] if 0 <= number - first < len(self.slots) else None

    def at(self, direction: Direction, octet: int) -> Slot | None:
        """The slot that has ``octet`` of the image."""
        for slot in self.slots:
            area = slot.area(direction)
            if area.at <= octet < area.at + area.octets:
                return slot
        return None

    @property
    def range_text(self) -> str:
        """The slot numbers for people: ``slots 1 to 4``."""
        if not self.slots:
            return "no slots"
        first, last = self.slots[0].number, self.slots[-1].number
        return f"slot {first}" if first == last else f"slots {first} to {last}"


def slot_map(config: bytes, texts: DiagTexts | None = None) -> SlotMap:
    """The map of a slave with the identifier octets ``config``; ``texts`` of its GSD file know its modules.

    Raises ConfigError if the octets are no identifiers.
    """
    if texts is not None and texts.modules and b"".join(_octets_of(module) for module in texts.modules) == config:
        return map_of_modules(
            tuple((module.name if module else "", _octets_of(module)) for module in texts.modules), texts.first_slot
        )
    return map_of_modules(
        tuple(("", found.octets) for found in parse_identifiers(config)),
        FIRST_SLOT if texts is None else texts.first_slot,
    )


def _octets_of(module: object) -> bytes:
    found = getattr(module, "config", b"\0")
    assert isinstance(found, bytes)
    return found


@lru_cache(_KEPT)
def map_of_modules(modules: tuple[tuple[str, bytes], ...], first: int) -> SlotMap:
    """The map of modules with these names and identifier octets; ``first``: the number of the first slot. Raises
    ConfigError if octets are no identifiers."""
    slots: list[Slot] = []
    inputs = outputs = 0
    for number, (name, octets) in enumerate(modules, first):
        parts = parse_identifiers(octets)
        ins, outs = sum(part.inputs for part in parts), sum(part.outputs for part in parts)
        slots.append(
            Slot(
                number,
                name,
                octets,
                Area(inputs, ins, _width(name, [part for part in parts if part.inputs], Direction.INPUT)),
                Area(outputs, outs, _width(name, [part for part in parts if part.outputs], Direction.OUTPUT)),
            )
        )
        inputs, outputs = inputs + ins, outputs + outs
    return SlotMap(tuple(slots))


def _width(name: str, parts: Sequence[Identifier], direction: Direction) -> int:
    """Bits of a channel; 0 if nothing says them."""
    ins = direction is Direction.INPUT
    octets = sum(part.inputs if ins else part.outputs for part in parts)
    if not octets:
        return _UNKNOWN
    if re.search(_DIGITAL, name, re.IGNORECASE):
        return _BIT
    if re.search(_ANALOGUE, name, re.IGNORECASE) and octets % 2 == 0:
        return _WORD
    words = {part.input_words if ins else part.output_words for part in parts}
    if len(words) > 1:
        return _UNKNOWN
    if words.pop():
        return _WORD
    whole = any(part.input_consistent if ins else part.output_consistent for part in parts)
    return _UNKNOWN if whole and octets > 1 else _BIT
