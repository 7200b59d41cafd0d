"""Lines of the page of one slave: all that is known about it, and the story why it is not in data exchange."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Final

from dpstack.plant.items import DrivePlant, DriveValues, LinkValues, SlavePlant, SlaveValues
from dpstack.screen.lines import Line, octets, piece, wrapped
from dpstack.screen.overview import MARKS, event_line, field_pieces, held_texts, marked, percent, shown
from dpstack.screen.rack import rack_lines, words
from dpstack.screen.view import View
from dpstack.text import octets_text
from dpstack.why.story import story_lines

#: events of the slave on its page
_EVENTS: Final = 100
_LABEL: Final = 14
_LINE: Final = 16  # octets in a line
_OF_CPU: Final = {"inputs": "values", "outputs": "can be written"}


def page(view: View, address: str, width: int, story: Mapping[str, Any] | str | None = None) -> list[Line]:
    """``story``: as `why --json`, or a text about it."""
    values = view.state.slaves.get(address)
    sign, style = view.mark(address)
    title = f"slave {address}  {view.name(address)}"
    lines: list[Line] = [[(f"{sign} ", style), piece(title, "bold"), piece(f"  {view.state_text(address)}", style)]]
    if values is None:
        return _fit([*lines, [("nothing is known about it yet", "stale")]], width)
    if not view.alive(address):
        age = view.age_s(address)
        since = "no inputs came yet" if age is None else f"the inputs are {age:.1f} s old"
        lines.append([("not alive: ", "bad"), (f"its values are not of this moment; {since}", "stale")])
    lines += _troubles(view, address)
    if story is not None:
        lines += [[], *_story_lines(story, width)]
    if values.drive is not None:
        lines += [[], *_drive("drive", view.slave_plant(address).drive, view, address, values.drive)]
    for name, drive in (values.drives or {}).items():
        lines += [[], *_drive(name, (view.slave_plant(address).drives or {}).get(name), view, address, drive)]
    rack, placed = rack_lines(view, address)
    if rack:
        lines += [[], _header("modules and channels"), *rack]
    lines += [[], *_values(view, address, placed)]
    if values.links:
        is_old = not view.alive(address)
        lines += [[], _header("links to publishers (DXB)"), *(_link(one, is_old=is_old) for one in values.links)]
    lines += [[], *_counters(values), [], *_identity(view.slave_plant(address), values)]
    events = view.events_of(address)[-_EVENTS:]
    if events:
        lines += [[], _header("last events"), *(event_line(event) for event in reversed(events))]
    return _fit(lines, width)


def _fit(lines: list[Line], width: int) -> list[Line]:
    return [part for line in lines for part in wrapped(line, width, indent=4)]


def _header(text: str) -> Line:
    return [(text, "label")]


def _row(name: str, text: object, style: str = "") -> Line:
    return [(f"{name:<{_LABEL}} ", "label"), piece(text, style)]


def _troubles(view: View, address: str) -> list[Line]:
    values = view.values(address)
    lines = []
    if values.fault is not None:
        lines.append(_row("fault", values.fault.text, "bad"))
    lines += _doubts(view, address)
    if values.diagnosis is not None:
        flags = ", ".join(flag.replace("_", " ") for flag in values.diagnosis.flags)
        lines.append(_row("diagnosis", flags or "no flags", "warn" if values.conspicuous else ""))
        lines += [_row("", text, "warn") for text in values.diagnosis.texts]
    if values.injected:
        lines.append(_row("simulated", ", ".join(values.injected), "warn"))
    return lines


def _doubts(view: View, address: str) -> list[Line]:
    """Each reason why values are bad or uncertain, once: the words of the fault, the place, since when."""
    values = view.values(address)
    told = {(one.quality, one.text): one.since for one in values.doubts or []}
    remedies = {one.text: one.remedy for one in values.doubts or []}
    for name, one in (("", values.quality), *(values.qualities or {}).items()):
        if one is not None and one.quality in MARKS and (one.quality, one.text) not in told:
            told[one.quality, f"{name}: {one.text}" if name else one.text] = one.since
    lines = []
    for (quality, text), since in told.items():
        sign, style = MARKS.get(quality, ("", "stale"))
        at = view.clock(since)
        lines.append([*_row(f"{sign or ' '} {'' if quality == 'good' else quality}", text, style),
                      piece(f"  since {at}" if at else "", "stale")])  # fmt: skip
        if remedies.get(text):
            lines.append(_row("", remedies[text], "stale"))
    return lines


def _values(view: View, address: str, placed: Collection[str]) -> list[Line]:
    """Octets, and the named values that have no place in the rack."""
    values, plant = view.values(address), view.slave_plant(address)
    style = "" if view.alive(address) else "stale"
    lines: list[Line] = []
    for direction, given, fields in (
        ("inputs", values.inputs, plant.inputs),
        ("outputs", values.outputs, plant.outputs),
    ):
        if plant.protocol:  # an S7-200 has named values only
            lines += [_row(_OF_CPU[direction], f"{len(fields)}", style)] if fields else []
        digits = given or ""
        mark = "  (old)" if style and digits else ""
        if not plant.protocol:
            lines.append(_row(direction, f"{octets_text(len(digits) // 2)}{mark}", style))
        lines += [
            [(f"  {at // 2:3} ", "stale"), piece(octets(digits[at : at + 2 * _LINE]), style)]
            for at in range(0, len(digits), 2 * _LINE)
        ]
        lines += [
            [("  ", ""), *field_pieces(view, address, field, style), piece(f"  {field.at}", "stale"),
             piece(f"  {words(view.quality_of(address, field))}", style)]
            for field in fields or [] if field.name not in placed
        ]  # fmt: skip
    if values.held is not None:
        lines.append(_row("withheld" if values.withheld else "not sent", octets(values.held), "warn"))
        lines += [[("  ", ""), piece(text, "stale")] for text in held_texts(plant, values)]
    return lines


def _link(link: LinkValues, *, is_old: bool) -> Line:
    """A link of a subscriber: its publisher, the octets, the output that they act as, whether they come."""
    style = "stale" if is_old or link.good is None else "good" if link.good else "bad"
    to = "" if link.to is None else f" to output octet {link.to}"
    name, state = f"{link.publisher} {link.name}: octets {link.octets}{to}: ", link.text + "  (old)" * is_old
    return [("  ", ""), piece(name), piece(state, style)]


def _drive(title: str, known: DrivePlant | None, view: View, address: str, drive: DriveValues) -> list[Line]:
    known = known or DrivePlant()
    style = "" if view.alive(address) else "stale"
    told = view.quality(address)
    lines = [
        _row(title, f"{known.profile or ''} {known.telegram or ''}"),
        _row("state", str(drive.state).replace("_", " "), style or ("good" if drive.running else "")),
        [*_row("speed", ""), *marked(percent(drive.speed), told, style or "bold")],
        _row("set point", percent(drive.setpoint), style),
    ]
    quantities = []
    if drive.frequency_hz is not None:
        quantities.append(("frequency", f"{drive.frequency_hz:.2f} Hz"))
    if drive.speed_rpm is not None:
        quantities.append(("revolutions", f"{drive.speed_rpm:.0f} rpm"))
    shares = ("current", drive.current), ("torque", drive.torque)
    quantities += [(name, percent(share)) for name, share in shares if share is not None]
    lines += [[*_row(name, ""), *marked(text, told, style)] for name, text in quantities]
    lines += [_row("fault", text, "bad") for text in drive.faults or []]
    lines += [_row("warning", text, "warn") for text in drive.warnings or []]
    lines.append(_row("bits", ", ".join(bit.replace("_", " ") for bit in drive.bits or []), style))
    lines.append(_row("settings", drive.settings))
    lines += [_row("", text, "warn") for text in drive.settings_texts or []]
    lines += [_row("notice", f"at {notice.t} s: {notice.text}") for notice in drive.notices or []]
    return lines


def _counters(values: SlaveValues) -> list[Line]:
    lines = [_row("exchanges", values.exchanges or 0), _row("telegrams", values.telegrams or 0)]
    for name, count in (
        ("retries", values.retries),
        ("time-outs", values.timeouts),
        ("late", values.late),
        ("wrong", values.wrong),
    ):
        lines.append(_row(name, count or 0, "warn" if count else ""))
    causes = ", ".join(f"{count} {cause.replace('_', ' ')}" for cause, count in (values.bad or {}).items())
    lines.append(_row("damaged", causes or 0, "warn" if values.bad else ""))
    if values.clock is not None:
        lines.append(_row("clock", values.clock.text, "" if values.clock.synchronised else "warn"))
    if values.alarms:
        lines.append(_row("alarms", ", ".join(f"{key} {shown(value)}" for key, value in values.alarms.items())))
    return lines


def _identity(plant: SlavePlant, values: SlaveValues) -> list[Line]:
    if plant.protocol:
        return [_row("device", plant.model or "not known")]
    watchdog = values.watchdog_ms or plant.watchdog_ms
    lines = [
        _row("device", f"{plant.vendor or ''} {plant.model or ''}".strip() or "not known"),
        _row("ident number", plant.ident or "not known"),
        _row("GSD file", plant.gsd or "none"),
        _row("watchdog", f"{watchdog:g} ms" if watchdog else "off: it keeps its outputs when the master stops",
             "" if watchdog else "warn"),
        _row("safe outputs", octets(plant.safe or "") or "none"),
        _row("groups", ", ".join(map(str, plant.groups or [])) or "none"),
        _row("DP-V1", "yes" if plant.dpv1 else "no"),
    ]  # fmt: skip
    if plant.every not in (None, 1):
        lines.append(_row("every", f"{plant.every} cycles"))
    return lines


# --- why --------------------------------------------------------------------------------------------------------------


def _story_lines(story: Mapping[str, Any] | str, width: int) -> list[Line]:
    """The lines of `dpstack why`, or a text in their place."""
    if isinstance(story, str):
        return [_header("why it is not in data exchange"), [("  ", ""), piece(story)]]
    lines = []
    for text in story_lines(dict(story), max(20, width - 2)):
        style = "good" if text.startswith("   + ") else "warn" if text.startswith("   - ") else ""
        lines.append([piece(text, "bold" if text[:1].isdigit() else style)])
    return lines
