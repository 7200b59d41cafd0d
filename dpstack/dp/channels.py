"""The channels of a slave as fields with proposed names: for configurations that are written, and for the I/O list.

Bits are proposed as ``slot1_0``, ``slot1_1`` ..., words as ``slot3_ai0`` or ``slot3_ao0``, octets of unknown widths as
``slot5_in`` or ``slot5_out``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from msgspec import Struct

from dpstack.dp.process_data import Field
from dpstack.dp.slot_map import Area, Direction, Slot, SlotMap

#: the end of a name: of octets, of words, of bits in a slot that has bits in both directions
_ENDS = {Direction.INPUT: ("in", "ai", "_di"), Direction.OUTPUT: ("out", "ao", "_do")}


class Channel(Struct, frozen=True):
    """One channel. ``number``: in its slot, from 0; None: the octets of the slot, whose channels are not known.

    ``key``: its name without the number behind it if the channels of a slot are a list; else the name of ``field``.
    """

    slot: Slot
    direction: Direction
    number: int | None
    key: str
    field: Field

    def part(self, octet: int, octets: int) -> Channel:
        """Some of its octets, which are of unknown width."""
        return Channel(
            self.slot, self.direction, None, self.key, dataclasses.replace(self.field, octet=octet, length=octets)
        )


def channels(slots: SlotMap) -> Iterator[Channel]:
    """All channels, by slot, direction and number."""
    for slot in slots.slots:
        in_both = all(area.octets and area.width == 1 for _, area in slot.areas())
        for direction, area in slot.areas():
            if area.octets:
                yield from _of_area(slot, direction, area, in_both=in_both)


def _of_area(slot: Slot, direction: Direction, area: Area, *, in_both: bool) -> Iterator[Channel]:
    head, (octets, words, bits) = f"slot{slot.number}", _ENDS[direction]
    if not area.width:
        key = f"{head}_{octets}"
        yield Channel(slot, direction, None, key, Field(key, "bytes", area.at, area.octets))
        return
    for number in range(area.channels):
        at, bit = divmod(8 * area.at + number * area.width, 8)
        if area.width == 1:
            key = head + (bits if in_both else "")
            field = Field(f"{key}_{number}", "bool", at, 1, bit)
        else:
            key = f"{head}_{words}{number}"
            field = Field(key, "i16", at, 2)
        yield Channel(slot, direction, number, key, field)


def proposed_names(slots: SlotMap) -> dict[str, dict[str, str | list[str]]]:
    """The keys ``inputs`` and ``outputs`` of a slave with a name for each channel; a key without names is left out."""
    found: dict[str, dict[str, str | list[str]]] = {}
    for channel in channels(slots):
        names = found.setdefault(f"{channel.direction}s", {})
        if channel.key == channel.field.name:
            names[channel.key] = channel.field.spec
        else:
            places = names.setdefault(channel.key, [])
            assert isinstance(places, list)
            places.append(channel.field.spec)
    return found
