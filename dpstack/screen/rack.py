"""Lines of the rack of a slave: slots with module names, channels with raw content, values and doubts."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from dpstack.plant.items import DoubtValues, FieldPlant, ModulePlant, QualityValues
from dpstack.screen.lines import Line, piece
from dpstack.screen.overview import MARKS, field_pieces, rank
from dpstack.screen.places import DIRECTIONS, INPUT, area_of, channels_of, fields_of, place_of, slots_of
from dpstack.screen.view import View

#: channels of fewer bits have a line each only with a name or a doubt
_WIDE: Final = 8

Told = QualityValues | DoubtValues


def rack_lines(view: View, address: str) -> tuple[list[Line], set[str]]:
    """The slots of a slave, and the names of the values in them."""
    plant = view.slave_plant(address)
    lines: list[Line] = []
    shown: set[str] = set()
    for slot, module in slots_of(plant):
        doubts = [one for one in view.values(address).doubts or [] if one.slot == slot]
        lines.append(_slot_line(slot, module, doubts))
        for direction in DIRECTIONS:
            more, names = _area_lines(view, address, module, direction, _of_direction(doubts, direction))
            lines += more
            shown |= names
    return lines, shown


def words(told: Told | None) -> str:
    """A quality in words: ``bad: line break: slot 3 (2 AI), input channel 0``; empty for good."""
    return "" if told is None else f"{told.quality}: {told.text}" if told.text else told.quality


def _of_direction(doubts: Iterable[DoubtValues], direction: str) -> list[DoubtValues]:
    return [one for one in doubts if one.direction in (None, direction)]


def _signed(told: Iterable[Told | None]) -> Line:
    """The mark of the worst of these in two cells."""
    worst = max(told, key=rank, default=None)
    sign, style = MARKS.get("" if worst is None else worst.quality, (" ", ""))
    return [(f"{sign} ", style)]


def _reason(told: Told) -> Line:
    return [piece(f"  {words(told)}", MARKS.get(told.quality, ("", "stale"))[1])]


def _slot_line(slot: int, module: ModulePlant, doubts: list[DoubtValues]) -> Line:
    size = f"{module.inputs or 0} in, {module.outputs or 0} out"
    line = [*_signed(doubts), (f"slot {slot}  ", "label"), piece(module.name or "no name", "bold")]
    line.append(piece(f"  {module.config or 'no identifier'}  {size}", "stale"))
    return line + [part for one in doubts if one.channel is None for part in _reason(one)]


def _area_lines(
    view: View, address: str, module: ModulePlant, direction: str, doubts: list[DoubtValues]
) -> tuple[list[Line], set[str]]:
    area = area_of(module, direction)
    if area is None:
        return [], set()
    values, plant = view.values(address), view.slave_plant(address)
    image = values.inputs if direction == INPUT else values.outputs
    channels = channels_of(module, direction)
    placed = [(one, place) for one in fields_of(plant, direction) if (place := place_of(one)) and place.shares(area)]
    style = "" if view.alive(address) else "stale"
    lines: list[Line] = []
    each = bool(channels) and channels[0].bits >= _WIDE and plant.drive is None
    if not each:
        raw = " ".join(one.raw(image) for one in channels) if channels and channels[0].bits == 1 else area.raw(image)
        lines.append([("    ", ""), (f"{direction}s ", "label"), piece(raw, style)])
    shown: set[str] = set()
    rows = enumerate(channels) if channels else [(None, area)]
    for number, place in rows:
        # a value stands at the first channel that it touches
        own = [field for field, at in placed if field.name not in shown and at.shares(place)]
        shown.update(field.name for field in own)
        of_channel = [one for one in doubts if number is not None and one.channel == number]
        if own or of_channel or each:
            lines += _channel_lines(view, address, direction, number, place.raw(image) if number is not None else "",
                                    own, of_channel, style)  # fmt: skip
    return lines, shown


def _channel_lines(
    view: View,
    address: str,
    direction: str,
    number: int | None,
    raw: str,
    own: list[FieldPlant],
    doubts: list[DoubtValues],
    style: str,
) -> list[Line]:
    told = [view.quality_of(address, one) for one in own]
    name = f"{direction} {number}" if number is not None else ""
    head: Line = [("  ", ""), *_signed([*told, *doubts]), (f"{name:<10}", "label"), piece(f"{raw:<5}", style)]
    lines = []
    for field, quality in zip(own, told, strict=True):
        line = [*head, ("  ", ""), *field_pieces(view, address, field, style)]
        lines.append([*line, *(_reason(quality) if quality is not None and rank(quality) else [])])
        head = [(" " * sum(len(text) for text, _ in head), "")]
    # the words of a channel stand once: beside its value, else at the channel
    others = [one for one in doubts if all(one.text != each.text for each in told if each is not None)]
    if others or not lines:
        lines.append([*head, *(part for one in others for part in _reason(one))])
    return lines
