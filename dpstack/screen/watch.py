"""The watch table: the values of a plant that can be chosen, and the lines of those that are."""

from __future__ import annotations

from typing import Final, NamedTuple

from dpstack.plant.items import DoubtValues, FieldPlant, QualityValues
from dpstack.screen.lines import Line, cut_line, flowed, padded, piece, width_of
from dpstack.screen.overview import MARKS, field_text, percent, rank
from dpstack.screen.places import DIRECTIONS, INPUT, Place, channels_of, fields_of, place_of, slots_of
from dpstack.screen.rack import words
from dpstack.screen.view import View

#: quantities of a drive: key of its status, and whether it is a share of the rated one
_QUANTITIES: Final = {"speed": True, "setpoint": True, "frequency_hz": False, "current": True, "torque": True}
_NAMES: Final = {"setpoint": "set point", "frequency_hz": "frequency"}
#: a value that does not exist
_NOTHING: Final = "-"
#: rows at most
MOST: Final = 100


class Point(NamedTuple):
    """A value that can be watched: a named value (``field``), a quantity of a drive, or a channel of a slot. ``place``:
    None if the stream does not say it."""

    address: str
    label: str
    direction: str = INPUT
    field: FieldPlant | None = None
    quantity: str = ""
    place: Place | None = None
    slot: int | None = None
    channel: int | None = None

    def value(self, view: View) -> str:
        """The value with its unit; of a channel without a name nothing."""
        values = view.values(self.address)
        if self.field is not None:
            return field_text(self.field, values.fields)
        if self.quantity:
            number = None if values.drive is None else getattr(values.drive, self.quantity)
            is_share = _QUANTITIES[self.quantity]
            return percent(number) if is_share or number is None else f"{number:.2f} Hz"
        return ""

    def raw(self, view: View) -> str:
        """Its octets, or the number in its bits."""
        values = view.values(self.address)
        return (
            "" if self.place is None else self.place.raw(values.inputs if self.direction == INPUT else values.outputs)
        )

    def quality(self, view: View) -> QualityValues | DoubtValues | None:
        """Its quality; None: good."""
        if self.field is not None:
            return view.quality_of(self.address, self.field)
        if self.quantity:
            return view.quality(self.address)
        doubts = [
            one
            for one in view.values(self.address).doubts or ()
            if one.slot == self.slot and one.channel in (None, self.channel) and one.direction in (None, self.direction)
        ]
        return max([view.quality(self.address), *doubts], key=rank)

    def order(self, view: View) -> str:
        """The order that sets it: ``set`` an output, ``force`` an input of a simulated slave; empty: none."""
        plant = view.state.plant
        if self.field is None or plant is None or plant.read_only or view.slave_plant(self.address).drive is not None:
            return ""
        return "set" if self.direction != INPUT else "force" if plant.virtual else ""


def points_of(view: View) -> dict[str, Point]:
    """All values of the plant by an id of their own: named values and quantities first, then channels."""
    named: dict[str, Point] = {}
    channels: dict[str, Point] = {}
    for address in view.addresses():
        plant = view.slave_plant(address)
        name = view.name(address) or address
        for direction in DIRECTIONS:
            for field in fields_of(plant, direction):
                at = place_of(field)
                named[f"{address}.{field.name}"] = Point(address, f"{name}.{field.name}", direction, field, "", at)
            for slot, module in slots_of(plant):
                for number, place in enumerate(channels_of(module, direction)):
                    label = f"{name}: slot {slot} ({module.name or 'no name'}), {direction} channel {number}"
                    point = Point(address, label, direction, place=place, slot=slot, channel=number)
                    channels[f"{address}/{slot}/{direction}/{number}"] = point
        if plant.drive is not None:
            for quantity in _QUANTITIES:
                label = f"{name}: {_NAMES.get(quantity, quantity)}"
                named[f"{address}:{quantity}"] = Point(address, label, quantity=quantity)
    return {**named, **channels}


class _Widths(NamedTuple):
    label: int
    value: int
    raw: int

    @classmethod
    def fitting(cls, width: int) -> _Widths:
        return cls(width * 2 // 5, 12, 9) if width < 90 else cls(width * 3 // 10, 16, 14)


def watch_head(width: int) -> Line:
    c = _Widths.fitting(width)
    return [(f"  {padded('value', c.label)} {padded('reading', c.value)} {padded('octets', c.raw)} quality", "label")]


def watch_lines(view: View, point: Point, width: int) -> list[Line]:
    """Name, value with unit, raw octets, quality in words; a long name has a line of its own."""
    c = _Widths.fitting(width)
    told = point.quality(view)
    sign, how = MARKS.get("" if told is None else told.quality, ("", ""))
    style = "" if view.alive(point.address) else "stale"
    value = point.value(view)
    changed = not style and point.field is not None and view.just_changed(point.address, point.field.name)
    look = style or how or ("changed" if changed else "")
    head: Line = [(f"{sign or ' '} ", how), piece(point.label, style or "bold")]
    is_long = width_of(head) > 2 + c.label
    line: Line = [
        *([("  ", "")] if is_long else head[:1]),
        (padded("" if is_long else point.label, c.label) + " ", style or "bold"),
        (padded(sign + value if value else "", c.value) + " ", look),
        (padded(point.raw(view), c.raw) + " ", style),
    ]
    text: Line = [piece(words(told), how or "stale")] if told is not None else [("good", "good")]
    if told is None and value == _NOTHING:
        text = [("the slave does not give it", "stale")]
    return [*([cut_line(head, width)] if is_long else []), *flowed(line, [text], width, 4)]


def without_point(id_: str, width: int) -> list[Line]:
    """The line of a chosen value that the plant does not have any more."""
    return [
        [("  ", ""), (padded(id_, _Widths.fitting(width).label), "stale"), (" the plant has no such value", "stale")]
    ]


def choice_line(point: Point, *, chosen: bool) -> list[Line]:
    """A value that can be chosen."""
    place = "" if point.place is None else f"  octet {point.place.octet}"
    return [
        [(f"[{'x' if chosen else ' '}] ", "good" if chosen else ""), piece(point.label, "bold"), piece(place, "stale")]
    ]
