"""Places of the values in the octets of a configuration: names, types, status, words.

A module's data are parts of the profile's names in their order. Lengths and order: the makers' tables in
docs/reference/decisions/pa-cyclic.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from dpstack.devices.pa.model import PaFile, PaModule, PaSlot

#: position of a valve in POS_D, control of a totaliser in SET_TOT, its way of counting in MODE_TOT
_POSITION: Final = {0: "not initialised", 1: "closed", 2: "open", 3: "intermediate"}
_SET: Final = {0: "totalise", 1: "reset", 2: "preset"}
_MODE: Final = {0: "balanced", 1: "positive only", 2: "negative only", 3: "hold"}
#: octets by type
_OCTETS: Final = {"f32": 4, "u8": 1, "u16": 2, "i16": 2, "u24": 3, "u32": 4, "i32": 4}


class Part(NamedTuple):
    """A part of a module's data. ``suffix``: behind the name of the slot; ``status``: an octet with the status follows;
    ``has_unit``: its unit is that of the block."""

    name: str
    suffix: str
    type: str
    status: bool = False
    has_unit: bool = False
    words: Mapping[int, str] = {}

    @property
    def octets(self) -> int:
        return _OCTETS[self.type] + self.status


def _parts(*parts: Part) -> dict[str, Part]:
    plain = (Part(kind, "", kind, has_unit=True) for kind in _OCTETS)
    return {part.name: part for part in (*parts, *plain)}


#: parts of inputs and of outputs by name; those with the name of a type have no status
INPUTS: Final = _parts(
    Part("OUT", "", "f32", status=True, has_unit=True),
    Part("TOTAL", "", "f32", status=True, has_unit=True),
    Part("OUT_D", "", "u8", status=True),
    Part("READBACK", "_readback", "f32", status=True, has_unit=True),
    Part("POS_D", "_pos_d", "u8", status=True, words=_POSITION),
    Part("CHECKBACK", "_checkback", "u24"),
    Part("RCAS_OUT", "_rcas_out", "f32", status=True, has_unit=True),
    Part("READBACK_D", "_readback", "u8", status=True),
    Part("CHECKBACK_D", "_checkback", "u24"),
    Part("RCAS_OUT_D", "_rcas_out", "u8", status=True),
)
OUTPUTS: Final = _parts(
    Part("SP", "", "f32", status=True, has_unit=True),
    Part("RCAS_IN", "_rcas_in", "f32", status=True, has_unit=True),
    Part("SP_D", "", "u8", status=True),
    Part("RCAS_IN_D", "_rcas_in", "u8", status=True),
    Part("SET_TOT", "_set", "u8", words=_SET),
    Part("MODE_TOT", "_mode", "u8", words=_MODE),
    Part("DISPLAY_VALUE", "", "f32", status=True, has_unit=True),
    Part("CONTROL", "", "u8"),
)


class Place(NamedTuple):
    """A value in the octets of a configuration: its first octet is ``at``; its status follows it, if it has one."""

    name: str
    slot: PaSlot
    part: Part
    at: int

    @property
    def status_at(self) -> int:
        """The octet of its status."""
        return self.at + self.part.octets - 1

    @property
    def words(self) -> Mapping[int, str]:
        """The meaning of its numbers."""
        is_main = not self.part.suffix or self.part.name in ("READBACK_D", "RCAS_IN_D", "RCAS_OUT_D")
        return self.slot.words if is_main and self.part.type == "u8" else self.part.words


class Layout(NamedTuple):
    """The values of a configuration by name, in the order of their octets."""

    inputs: Mapping[str, Place]
    outputs: Mapping[str, Place]


def slots_of(file: PaFile, modules: Sequence[PaModule]) -> list[PaSlot]:
    """The slots of a configuration, one for each of ``modules``; those of a file without slots are named after their
    blocks."""
    if file.slots:
        return list(file.slots[: len(modules)])
    counted: dict[str, int] = {}
    found = []
    for number, module in enumerate(modules, 1):
        kind = module.block.lower() or "slot"
        counted[kind] = counted.get(kind, 0) + 1
        found.append(
            PaSlot(number=number, block=module.block, name=f"{kind}{counted[kind]}", block_slot=number, modules=())
        )
    return found


def layout_of(file: PaFile, modules: Sequence[PaModule]) -> Layout:
    """The values of a configuration of ``modules``, one for each slot."""
    inputs: dict[str, Place] = {}
    outputs: dict[str, Place] = {}
    ends = [0, 0]
    for slot, module in zip(slots_of(file, modules), modules, strict=True):
        for way, known, names, found in (
            (0, INPUTS, module.inputs, inputs),
            (1, OUTPUTS, module.outputs, outputs),
        ):
            for name in names:
                part = known[name]
                place = Place(_free_name(slot.name + part.suffix, inputs, outputs), slot, part, ends[way])
                found[place.name] = place
                ends[way] += part.octets
    return Layout(inputs, outputs)


def _free_name(wanted: str, *taken: Mapping[str, object]) -> str:
    """``wanted``, or with a number behind it if a value has this name."""
    number, name = 1, wanted
    while any(name in one for one in taken):
        number += 1
        name = f"{wanted}_{number}"
    return name


def fields_of(file: PaFile, layout: Layout, coding: str) -> tuple[dict[str, object], dict[str, object]]:
    """The named values of inputs and outputs as a plant file writes them."""
    inputs: dict[str, object] = {}
    for name, place in layout.inputs.items():
        if place.part.name == "CHECKBACK":
            for bit, number in file.checkback.items():
                inputs[f"{name}_{bit}"] = f"bool@{place.at + number // 8}.{number % 8}"
            continue
        status = {"status": f"u8@{place.status_at}", "quality": coding} if place.part.status else {}
        inputs[name] = _field(place) | status
    return inputs, {name: _field(place) for name, place in layout.outputs.items()}


def _field(place: Place) -> dict[str, object]:
    kind = "u24le" if place.part.type == "u24" and place.part.suffix else place.part.type  # bit 0 is in the first octet
    found: dict[str, object] = {"at": f"{kind}@{place.at}"}
    if place.words:
        found["words"] = {str(number): word for number, word in place.words.items()}
    if place.part.has_unit and place.slot.unit:
        found["unit"] = place.slot.unit
    return found


def unit_places(layout: Layout) -> Iterator[Place]:
    """The values whose unit is that of their block, inputs first."""
    yield from (one for one in (*layout.inputs.values(), *layout.outputs.values()) if one.part.has_unit)
