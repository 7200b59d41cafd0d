"""Lines of the page of one slave: all that is known about it, and the story why it is not in data exchange."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from dpstack.screen.lines import Line, piece, wrapped
from dpstack.screen.overview import event_line, field_pieces, octets, percent, shown
from dpstack.screen.view import View
from dpstack.text import octets_text
from dpstack.why.story import story_lines

#: events of the slave on its page
_EVENTS: Final = 100
_LABEL: Final = 14
_LINE: Final = 16  # octets in a line


def page(view: View, address: str, width: int, story: Mapping[str, Any] | str | None = None) -> list[Line]:
    """``story``: as `why --json`, or a text about it."""
    values, plant = view.state.slaves.get(address), view.slave_plant(address)
    sign, style = view.mark(address)
    title = f"slave {address}  {view.name(address)}"
    lines: list[Line] = [[(f"{sign} ", style), piece(title, "bold"), piece(f"  {view.state_text(address)}", style)]]
    if values is None:
        return _fit([*lines, [("nothing is known about it yet", "stale")]], width)
    if not view.alive(address):
        age = view.age_s(address)
        since = "there were none yet" if age is None else f"the inputs are {age:.1f} s old"
        lines.append([("not alive: ", "bad"), (f"its values are not of this moment; {since}", "stale")])
    lines += _troubles(view, address)
    if story is not None:
        lines += [[], *_told(story, width)]
    lines += [[], *_values(view, address)]
    if values.get("drive"):
        lines += [[], *_drive(view, address)]
    lines += [[], *_counters(values), [], *_identity(plant, values)]
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
    values = view.state.slaves[address]
    lines = []
    if values.get("fault"):
        lines.append(_row("fault", values["fault"].get("text"), "bad"))
    found = values.get("diagnosis")
    if found:
        flags = ", ".join(str(flag).replace("_", " ") for flag in found.get("flags", []))
        lines.append(_row("diagnosis", flags or "no flags", "warn" if values.get("conspicuous") else ""))
        lines += [_row("", text, "warn") for text in found.get("texts", [])]
    if values.get("alarms"):
        lines.append(_row("alarms", ", ".join(f"{key} {shown(value)}" for key, value in values["alarms"].items())))
    if values.get("injected"):
        lines.append(_row("simulated", ", ".join(map(str, values["injected"])), "warn"))
    return lines


def _values(view: View, address: str) -> list[Line]:
    values, plant = view.state.slaves[address], view.slave_plant(address)
    style = "" if view.alive(address) else "stale"
    lines: list[Line] = []
    for direction in ("inputs", "outputs"):
        digits = str(values.get(direction) or "")
        mark = "  (old)" if style and digits else ""
        lines.append(_row(direction, f"{octets_text(len(digits) // 2)}{mark}", style))
        lines += [
            [(f"  {at // 2:3} ", "stale"), piece(octets(digits[at : at + 2 * _LINE]), style)]
            for at in range(0, len(digits), 2 * _LINE)
        ]
        lines += [
            [("  ", ""), *field_pieces(view, address, field, style), piece(f"  {field['at']}", "stale")]
            for field in plant.get(direction) or []
        ]
    if values.get("held") is not None:
        lines.append(_row("not sent", octets(values["held"]), "warn"))
        held = values.get("held_fields") or {}
        lines += [[("  ", ""), piece(f"{name} {shown(value)}", "stale")] for name, value in held.items()]
    return lines


def _drive(view: View, address: str) -> list[Line]:
    drive: Mapping[str, Any] = view.state.slaves[address]["drive"]
    known = view.slave_plant(address).get("drive") or {}
    style = "" if view.alive(address) else "stale"
    lines = [
        _row("drive", f"{known.get('profile', '')} {known.get('telegram') or ''}"),
        _row("state", str(drive.get("state")).replace("_", " "), style or ("good" if drive.get("running") else "")),
        _row("speed", percent(drive.get("speed")), style or "bold"),
        _row("set point", percent(drive.get("setpoint")), style),
    ]
    if drive.get("frequency_hz") is not None:
        lines.append(_row("frequency", f"{drive['frequency_hz']:.2f} Hz", style))
    if known.get("reference_rpm") and drive.get("speed") is not None:
        lines.append(_row("revolutions", f"{drive['speed'] * known['reference_rpm']:.0f} rpm", style))
    lines += [_row(key, percent(drive[key]), style) for key in ("current", "torque") if drive.get(key) is not None]
    lines += [_row("fault", text, "bad") for text in drive.get("faults") or []]
    lines += [_row("warning", text, "warn") for text in drive.get("warnings") or []]
    lines.append(_row("bits", ", ".join(str(bit).replace("_", " ") for bit in drive.get("bits") or []), style))
    lines.append(_row("settings", drive.get("settings")))
    lines += [_row("", text, "warn") for text in drive.get("settings_texts") or []]
    lines += [_row("notice", f"at {notice['t']} s: {notice['text']}") for notice in drive.get("notices") or []]
    return lines


def _counters(values: Mapping[str, Any]) -> list[Line]:
    lines = [
        _row(name.replace("timeouts", "time-outs"), values.get(name) or 0, _count_style(name, values))
        for name in ("exchanges", "telegrams", "retries", "timeouts", "late", "wrong")
    ]
    bad = values.get("bad") or {}
    causes = ", ".join(f"{count} {cause.replace('_', ' ')}" for cause, count in bad.items())
    return [*lines, _row("damaged", causes or 0, "warn" if bad else "")]


def _count_style(name: str, values: Mapping[str, Any]) -> str:
    return "warn" if values.get(name) and name not in ("exchanges", "telegrams") else ""


def _identity(plant: Mapping[str, Any], values: Mapping[str, Any]) -> list[Line]:
    watchdog = values.get("watchdog_ms") or plant.get("watchdog_ms")
    lines = [
        _row("device", " ".join(str(plant.get(key) or "") for key in ("vendor", "model")).strip() or "not known"),
        _row("ident number", plant.get("ident") or "not known"),
        _row("GSD file", plant.get("gsd") or "none"),
        _row("watchdog", f"{watchdog} ms" if watchdog else "off: it keeps its outputs when the master stops",
             "" if watchdog else "warn"),
        _row("safe outputs", octets(str(plant.get("safe") or "")) or "none"),
        _row("groups", ", ".join(map(str, plant.get("groups") or [])) or "none"),
        _row("DP-V1", "yes" if plant.get("dpv1") else "no"),
    ]  # fmt: skip
    if plant.get("every", 1) != 1:
        lines.append(_row("every", f"{plant['every']} cycles"))
    for number, module in enumerate(plant.get("modules") or []):
        size = f"{module.get('inputs', 0)} in, {module.get('outputs', 0)} out"
        lines.append(_row(f"module {number + 1}", f"{module.get('name') or 'empty'}  {module.get('config')}  {size}"))
    return lines


# --- why --------------------------------------------------------------------------------------------------------------


def _told(story: Mapping[str, Any] | str, width: int) -> list[Line]:
    """The lines of `dpstack why`, or a text in their place."""
    if isinstance(story, str):
        return [_header("why it is not in data exchange"), [("  ", ""), piece(story)]]
    lines = []
    for text in story_lines(dict(story), max(20, width - 2)):
        style = "good" if text.startswith("   + ") else "warn" if text.startswith("   - ") else ""
        lines.append([piece(text, "bold" if text[:1].isdigit() else style)])
    return lines
