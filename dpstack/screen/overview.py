"""Lines of the first page: state of the bus, one line a slave, the last events. They fit into 40 cells and more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

from dpstack.plant.items import (
    ClockValues,
    DoubtValues,
    DriveValues,
    FieldPlant,
    Plant,
    QualityValues,
    Remark,
    SlavePlant,
    SlaveValues,
)
from dpstack.screen.lines import Line, Piece, cut, cut_line, flowed, octets, padded, piece, width_of, with_more
from dpstack.screen.view import View, clock_text
from dpstack.units import baud_text

_BARS: Final = "▁▂▃▄▅▆▇█"
_EVENT_STYLES: Final = {"warning": "warn", "error": "bad"}
#: mark and style of diagnoses and alarms that come and go
_CHANGES: Final = {
    "appears": ("+ appears:", ""),
    "gone": ("- gone:", "good"),
    "disappears": ("- gone:", "good"),
    "disappears_others": ("- gone, others stay:", ""),
}
_MODES: Final = {"operate": "good", "clear": "warn"}
_GAP: Final = 1
#: mark and style of values that are not good
MARKS: Final = {"bad": ("!", "bad"), "uncertain": ("?", "warn")}
#: order of values in a line: those that say most about a fault first
_RANKS: Final = {"bad": 2, "uncertain": 1}
#: cells of the last column from which on further lines of a slave stay in it; else they begin behind the address
_LEAST_BESIDE: Final = 24
_INDENT: Final = 6
#: longer than any line
_ENDLESS: Final = 1 << 20
#: a histogram with narrower classes is drawn as one bar
_LEAST_CLASS_US: Final = 1e-3
_EXCHANGE: Final = "data exchange"
#: before the first one
NO_PLANT: Final = Plant(slaves={})


# --- the bus ----------------------------------------------------------------------------------------------------------


def head(view: View, width: int, *, paused: str = "", note: str = "") -> list[Line]:
    """State of the bus; what is not as it should be, a line each; rotation time with histogram, counters."""
    told = [cut_line([one], width) for one in notices(view, paused=paused, note=note)]
    return [_title(view, width), *told, *_figures(view, width)]


def _title(view: View, width: int) -> Line:
    state = view.state
    plant, bus = state.plant or NO_PLANT, state.bus
    mode = bus.mode or "starting"
    clock = view.clock(state.t)
    where: Line = [
        piece(f" {mode.capitalize()} ", _mode_style(mode, plant) if view.fresh else "stale"),
        piece(f"{clock} ", "" if view.fresh else "stale"),
        piece(f"master {_or_unknown(plant.address)} on {_or_unknown(plant.port)}", "bold"),
        piece(f" at {baud_text(plant.baud)}" if plant.baud else ""),
        piece(", read-only" if plant.read_only else ""),
    ]
    others = [str(master) for master in bus.masters or [] if master != plant.address]
    if others:
        at = "master at address" if len(others) == 1 else "masters at addresses"
        where.append(piece(f", other {at} {', '.join(others)}"))
    return cut_line(where, width)


def _or_unknown(value: object) -> str:
    return "?" if value is None else str(value)


def _mode_style(mode: str, plant: Plant) -> str:
    return "" if plant.read_only else _MODES.get(mode, "bad")


def _figures(view: View, width: int) -> list[Line]:
    bus = view.state.bus
    style = "" if view.fresh else "stale"
    rotation = bus.rotation_us
    counters: Line = [piece(f"{bus.telegrams or 0} telegrams", style)]
    for name, count in (
        ("retries", bus.retries),
        ("time-outs", bus.timeouts),
        ("late answers", bus.late),
        ("stray", bus.stray),
        ("damaged", sum((bus.bad or {}).values())),
    ):
        counters.append(piece(f"  {count or 0} {name}", style or ("warn" if count else "")))
    clock = [] if bus.clock is None else [cut_line([_clock_piece(bus.clock, style)], width)]
    if rotation is None or not rotation.max:
        return [cut_line([("no rotation yet", "stale")], width), cut_line(counters, width), *clock]
    times = f"rotation {_us(rotation.p50)}, 99 % {_us(rotation.p99)}, longest {_us(rotation.max)}"
    first: Line = [piece(times, style)]
    classes = bus.histogram or []
    room = min(24, width - width_of(first) - 2)
    if classes and room >= 6:
        first += [("  ", ""), (bars(classes, room), style or "label")]
    return [cut_line(first, width), cut_line(counters, width), *clock]


def _clock_piece(clock: ClockValues, style: str) -> Piece:
    """The time on the bus in a line."""
    remark = clock.remark or Remark("the time is sent", "info")
    return piece(f"clock: {remark.text}", style or ("warn" if remark.severity == "warning" else ""))


def _us(us: float) -> str:
    return f"{us / 1000:.3g} ms" if us >= 1000 else f"{us:.0f} us"


def bars(classes: Sequence[Sequence[float]], room: int) -> str:
    """A histogram in at most ``room`` cells. A class with any count has at least the lowest bar; empty ones a blank."""
    limits = [limit for limit, _ in classes]
    low, high = limits[0], limits[-1]
    narrowest = min((b - a for a, b in pairwise(limits)), default=0)
    room = min(room, round((high - low) / narrowest) + 1) if narrowest > _LEAST_CLASS_US else 1
    counts = [0.0] * room
    for limit, count in classes:
        counts[0 if high <= low else min(room - 1, int((limit - low) / (high - low) * room))] += count
    most = max(counts) or 1
    return "".join(_BARS[min(7, int(8 * count / most))] if count else " " for count in counts)


def notices(view: View, *, paused: str = "", note: str = "") -> list[Piece]:
    """Reasons why the page is not the plant of this moment, and why the master holds outputs back."""
    state, found = view.state, []
    bus = state.bus
    if paused:
        found.append((f"PAUSED at {paused}: everything here is of that time; space goes on", "title"))
    if note:
        found.append((note, "warn"))
    if state.end is not None:
        found.append((f"ended: {state.end}", "bad"))
    elif view.silent_s >= SHOWN_SILENT_S:
        found.append((f"no values from the bus for {view.silent_s:.0f} s: nothing here is of this moment", "bad"))
    if view.process_silent:
        found.append(("the bus process is silent: nothing here is of this moment", "bad"))
    elif bus.stale and state.end is None:
        age = (bus.age_ms or 0) / 1000
        found.append((f"the counters are {age:.1f} s old: nothing here is of this moment", "bad"))
    if bus.in_ring is False and state.end is None:
        found.append(("this master is not in the token ring", "bad"))
    plant, held = state.plant or NO_PLANT, bus.clear
    name = plant.port if plant.ctl is None else plant.ctl
    if held is not None:
        found.append(
            (
                f"in Clear since {held.since} s: {held.because}; dpstack ctl {name} operate lets outputs out",
                "warn",
            )
        )
    elif bus.mode == "clear" and not plant.read_only:
        found.append((f"in Clear: no outputs go out; dpstack ctl {name} operate lets them out", "warn"))
    if state.lost:
        found.append((f"{state.lost} events did not get here", "warn"))
    return [piece(text, style) for text, style in found]


#: from here on the silence of `run` is shown; the values count as old a moment later
SHOWN_SILENT_S: Final = 1.5


# --- slaves -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Columns:
    """Widths of the table of slaves for ``width`` cells; 0: left out."""

    name: int
    state: int
    counters: int
    values: int

    @classmethod
    def fitting(cls, width: int) -> Columns:
        name = 10 if width < 60 else 14 if width < 80 else 18 if width < 120 else 24
        state = 9 if width < 60 else 13
        counters = 0 if width < 76 else 6
        fixed = 2 + 4 + name + _GAP + state + _GAP + 2 * (counters + _GAP if counters else 0)
        return cls(name, state, counters, max(0, width - fixed))


def slaves_head(width: int) -> Line:
    c = Columns.fitting(width)
    line: Line = [(f"  {'adr':>3} {padded('name', c.name)} {padded('state', c.state)} ", "label")]
    if c.counters:
        line.append((f"{padded('retry', c.counters, right=True)} {padded('late', c.counters, right=True)} ", "label"))
    return cut_line([*line, ("values", "label")], width)


def rooms(view: View, addresses: Sequence[str], width: int, height: int) -> list[int]:
    """Lines for each of these slaves: one, and the empty lines of the screen for slaves with a remark, errors first."""
    found = dict.fromkeys(addresses, 1)
    spare = height - len(found)
    for address in sorted(found, key=lambda one: view.values(one).level != "error"):
        if spare <= 0:
            break
        if view.remark(address)[0]:
            more = min(spare, len(slave_lines(view, address, width, height)) - 1)
            found[address] += more
            spare -= more
    return list(found.values())


def slave_lines(view: View, address: str, width: int, room: int = 1) -> list[Line]:
    """One slave in at most ``room`` lines: sign, address, name, state, repetitions, late answers, its remark, and its
    values beside it, those that are not good first if it has a remark."""
    c = Columns.fitting(width)
    head = _slave_head(view, address, c)
    remark, how = view.remark(address)
    values = view.values(address)
    groups = values_groups(view, address) if values.drive is None else drive_groups(view, address, values.drive)
    if not view.alive(address) and address in view.state.slaves:
        age = view.age_s(address)
        old = piece("old: " if age is None else f"old {age:.1f} s: ", "stale")
        groups = [[old, *group] for group in groups[:1]] + groups[1:] or [[old]]
    if not remark:
        return [cut_line(flowed(head, groups, _ENDLESS, 0)[0], width)]
    said: Line = [piece(remark, how)]
    if room == 1:
        least = width_of(groups[0]) if groups and values.fields else 0
        said = [(cut(*said[0][:1], max(c.values // 2 - 1, c.values - least - 2)), how)]
        return [cut_line(flowed(head, [said, *groups], _ENDLESS, 0)[0], width)]
    lines = flowed(head, [said, *groups], width, 0)
    if len(lines) == 1:
        return lines
    indent = width - c.values if c.values >= _LEAST_BESIDE else _INDENT
    lines = flowed(head, [said], width, indent)
    lines = lines if len(lines) < room else [*lines[: room - 2], with_more(lines[room - 2], width)]
    more, left = flowed([(" " * indent, "")], groups, width, indent), room - len(lines)
    return [*lines, *more] if len(more) <= left else [*lines, *more[: left - 1], with_more(more[left - 1], width)]


def _slave_head(view: View, address: str, c: Columns) -> Line:
    values = view.values(address)
    alive = view.alive(address)
    sign, style = view.mark(address)
    quiet = "" if alive else "stale"
    state = view.state_text(address)
    if c.state < len(_EXCHANGE):
        state = state.removeprefix("data ")
    how = style if sign == "!" else "bold" if alive else "stale"
    line: Line = [
        (f"{sign} ", style),
        (f"{padded(address, 3, right=True)} ", quiet),
        (padded(view.name(address), c.name) + " ", how),
        (padded(state, c.state) + " ", style if alive else "bad"),
    ]
    if c.counters:
        late = (values.late or 0) + (values.wrong or 0)
        for count in (values.retries or 0, late):
            line.append((padded(count, c.counters, right=True) + " ", quiet or ("warn" if count else "")))
    return line


def drive_groups(view: View, address: str, drive: DriveValues) -> list[Line]:
    """State, speed, set point and actual values of a drive, each marked if it is not good."""
    style = "" if view.alive(address) else "stale"
    told = view.quality(address)
    found: list[Line] = [
        [piece(str(drive.state).replace("_", " "), style or ("good" if drive.running else ""))],
        [*marked(percent(drive.speed), told, style or "bold"), piece(f" set {percent(drive.setpoint)}", style)],
    ]
    if drive.frequency_hz is not None:
        found.append(marked(f"{drive.frequency_hz:.1f} Hz", told, style))
    for name, share in (("current", drive.current), ("torque", drive.torque)):
        if share is not None:
            found.append([piece(f"{name} ", style), *marked(percent(share), told, style)])
    return found


def percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def values_groups(view: View, address: str) -> list[Line]:
    """Named values with units, those that are not good first; without names the octets."""
    values, plant = view.values(address), view.slave_plant(address)
    style = "" if view.alive(address) else "stale"
    found: list[tuple[int, Line]] = []
    for fields, given, label, bare in (
        (plant.inputs, values.inputs, "", "in "),
        (plant.outputs, values.outputs, "out ", "out "),
    ):
        named = [(view.quality(address, one.name), field_pieces(view, address, one, style)) for one in fields or []]
        named.sort(key=lambda one: rank(one[0]), reverse=True)
        for number, (told, pieces) in enumerate(named):
            before = [piece(label, style or "label")] if label and not number else []
            found.append((rank(told), [*before, *pieces]))
        if not fields and given:
            found.append((0, [(bare, style or "label"), piece(octets(given), style)]))
    found.sort(key=lambda one: one[0], reverse=True)
    groups = [group for _, group in found]
    if values.held is not None:
        text = ", ".join(held_texts(plant, values)) or octets(values.held)
        groups.append([("withheld: " if values.withheld else "not sent: ", "warn"), piece(text, "stale")])
    return groups


def rank(told: QualityValues | DoubtValues | None) -> int:
    """2 for bad, 1 for uncertain, 0 for the others."""
    return 0 if told is None else _RANKS.get(told.quality, 0)


def field_pieces(view: View, address: str, field: FieldPlant, style: str) -> Line:
    """``name value unit``; marked for a moment if the value has just changed, and always if it is not good."""
    name = field.name
    how = "changed" if not style and view.just_changed(address, name) else style
    text = field_text(field, view.values(address).fields)
    return [piece(f"{name} ", style or "label"), *marked(text, view.quality(address, name), how)]


def marked(text: str, told: QualityValues | None, style: str) -> Line:
    """A value with the mark of its quality in front, so that no end of a line separates them: ``!`` bad, ``?``
    uncertain. An old one is only grey."""
    sign, how = MARKS.get("" if told is None else told.quality, ("", ""))
    if not sign:
        return [piece(text, style)]
    return [piece(sign + text, how)] if style != "stale" else [(sign, how), piece(text, style)]


def field_text(field: FieldPlant, values: Mapping[str, object] | None) -> str:
    """The value of ``field`` for people, out of ``values``: ``3.4 bar``, ``1 (running)``."""
    value = (values or {}).get(field.name)
    word = field.word(value)
    return shown(value) + (f" {field.unit}" if field.unit else "") + (f" ({word})" if word else "")


def held_texts(plant: SlavePlant, values: SlaveValues) -> list[str]:
    """The outputs that the master does not send, by name: ``valve 1 (open)``."""
    fields, held = {one.name: one for one in plant.outputs or ()}, values.held_fields or {}
    return [f"{name} {field_text(fields.get(name) or FieldPlant(name=name, at=''), held)}" for name in held]


def shown(value: object) -> str:
    """A value for people: ``on``, ``3.4``, ``-``."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "-" if value is None else str(value)


# --- events -----------------------------------------------------------------------------------------------------------


def event_line(event: Mapping[str, Any]) -> Line:
    """Clock, mark of a diagnosis or an alarm that appears or is gone, text."""
    style = _EVENT_STYLES.get(str(event.get("severity")), "")
    change = str(event.get("change") or (event.get("specifier") if event.get("event") == "alarm" else ""))
    mark, how = _CHANGES.get(change, ("", ""))
    line = [piece(f"{clock_text(event)} ", "label"), piece(event.get("text", ""), style)]
    return [line[0], (f"{mark} ", style or how), line[1]] if mark else line
