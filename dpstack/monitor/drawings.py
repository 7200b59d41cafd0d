"""Drawings of the report as inline SVG: histogram, T_SDR of all stations, time line, schedule of one rotation.

Each drawing has a text alternative, and is readable without colours: shades, places and shapes differ as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from dpstack.monitor.markup import text
from dpstack.monitor.schedule import Rotation, Slot, Use
from dpstack.stats import Histogram
from dpstack.text import printable
from dpstack.units import NS_PER_US

_WIDTH: Final = 720
_BARS: Final = 40
#: above this multiple of the 99 % quantile the values share one bar
_FAR: Final = 2
#: the axis of a histogram spans at least this part of its highest value
_NARROW: Final = 10
#: telegrams in a strip of the schedule, and strips at most
_PER_STRIP: Final = 18
_MOST_STRIPS: Final = 12
_STRIP: Final = 96
_NAMES: Final = 138.0  # room for the name in front of a row
_LETTER: Final = 6.2  # width of a letter of 11 px
_FILL: Final = {Use.REQUEST: "request", Use.ANSWER: "answer", Use.TOKEN: "token", Use.DAMAGED: "damage"}
#: marks of the time line by the kind of change: shape, and its name in the legend
MARKS: Final[Mapping[str, tuple[str, str]]] = {
    "lost": ("M-5 -5H5L0 5Z", "left data exchange, or no longer answers"),
    "back": ("M-4.5 4.5H4.5L0 -4.5Z", "exchanges data again"),
    "diagnosis": ("M0 -6L6 0L0 6L-6 0Z", "new diagnosis"),
    "alarm": ("M-4.5 -4.5H4.5V4.5H-4.5Z", "alarm"),
    "joined": ("M-4 0H4M0 -4V4", "entered the token ring"),
    "left": ("M-4 -4L4 4M-4 4L4 -4", "dropped out of the token ring"),
    "mode": ("M0 -6V6", "change of mode"),
    "state": ("M-2 -6V6M2 -6V6", "another state"),
    "status_message": ("M-4.5 -3H4.5V3H-4.5Z", "status message"),
    "clock": ("M0 0V-5M0 0H4", "began to send the time"),
    "rate": ("M-5 0L0 -6M-5 0H5M5 0L0 6", "change of the rate"),
    "gap": ("M-5 -5V5M5 -5V5M-5 0H5", "a gap of the capture, or a notice of its source"),
}
_OTHER: Final = ("M-3 0A3 3 0 1 0 3 0A3 3 0 1 0 -3 0Z", "other")
_HOLLOW: Final = frozenset({"back", "alarm", "status_message"})


def microseconds(ns: float) -> str:
    """``ns`` in us, with three digits."""
    us = ns / NS_PER_US
    return f"{us:.0f}" if us >= 100 else f"{us:.3g}"


def _svg(width: float, height: float, words: str, body: Iterable[str], css: str = "") -> str:
    return (
        f'<svg class="{css}" viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{text(words)}">'
        f"<title>{text(words)}</title>{''.join(body)}</svg>"
    )


def _label(x: float, y: float, words: object, css: str = "", anchor: str = "middle") -> str:
    kind = f' class="{css}"' if css else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{kind}>{text(words)}</text>'


def _ticks(span: float, most: int) -> float:
    """A round step that divides ``span`` into at most ``most`` parts."""
    step = 1.0
    while span / step > most:
        step *= 10
    while span / step <= most / 10:
        step /= 10
    for part in (0.1, 0.2, 0.5):
        if span / (step * part) <= most:
            return step * part
    return step


def histogram(histogram: Histogram, name: str) -> str:
    """The histogram of durations as bars between the shortest and the longest; far outliers share the last bar."""
    low, high, far = histogram.min_ns, histogram.max_ns, 0
    p99 = histogram.quantile_ns(0.99)
    if high > _FAR * p99 > 0:
        high = p99 + max((p99 - low) // 4, p99 // 50, 1)
    least = max(high // _NARROW, 1)  # values are kept to 0.4 %: a narrower axis shows nothing
    if high - low < least:
        low, high = max(0, (low + high - least) // 2), (low + high + least) // 2
    counts = [0] * _BARS
    width = max(high - low, 1) / _BARS
    for value, count in histogram.values():
        if value > high:
            far += count
        else:
            counts[min(int((value - low) / width), _BARS - 1)] += count
    left, right, top, bottom = 44.0, 316.0, 8.0, 128.0
    step = (right - left) / (_BARS + (3 if far else 0))
    most = max(*counts, far, 1)
    body = [f'<path class="axis" d="M{left} {top}V{bottom}H{right}"/>', _label(left - 4, top + 8, most, anchor="end")]
    body.append(_label(left - 4, bottom, 0, anchor="end"))
    for place, count in enumerate(counts):
        body += _bar(left + place * step, step, bottom, count / most * (bottom - top), "bar") if count else []
    if far:
        body += _bar(right - 2 * step, 2 * step, bottom, far / most * (bottom - top), "answer")
        body.append(_label(right, bottom - 4 - far / most * (bottom - top), far, anchor="end"))
    edge = right - (3 * step if far else 0)
    for part in range(4 if not far else 3):
        x = left + (edge - left) * part / (3 if not far else 2.6)
        at = low + (high - low) * part / (3 if not far else 2.6)
        body.append(f'<path class="axis" d="M{x:.1f} {bottom}v4"/>')
        body.append(_label(x, bottom + 16, microseconds(at)))
    if far:
        body.append(_label(right, bottom + 16, f"> {microseconds(high)}", anchor="end"))
    body.append(_label((left + right) / 2, bottom + 32, "us"))
    words = f"Histogram of {name}: {histogram.count} values, {_spread(histogram)}"
    return _svg(340, 164, words, body, "histogram")


def _spread(histogram: Histogram) -> str:
    points = (histogram.min_ns, histogram.quantile_ns(0.5), histogram.quantile_ns(0.99), histogram.max_ns)
    low, half, most, high = map(microseconds, points)
    return f"{low} to {high} us, half of them up to {half} us, 99 % up to {most} us"


def _bar(x: float, width: float, bottom: float, height: float, css: str) -> list[str]:
    height = max(height, 1.0)
    return [
        f'<rect class="{css}" x="{x:.2f}" y="{bottom - height:.1f}" width="{max(width - 0.6, 0.5):.2f}" '
        f'height="{height:.1f}"/>'
    ]


def answer_times(stations: Sequence[tuple[str, Mapping[str, float], float | None]], unit: str) -> str:
    """T_SDR of all stations, a row each: name; min, p50, p99 and max; the limit (None: unknown). All in ``unit``."""
    row, top, left, right = 20.0, 8.0, 150.0, 700.0
    longest = max([float(times["max"]) for _, times, _ in stations] + [one for *_, one in stations if one] + [1.0])
    scale = (right - left) / (longest * 1.02)
    bottom = top + row * len(stations)
    body = [f'<path class="axis" d="M{left} {top}V{bottom}H{right}"/>']
    body += _axis(longest, unit, left, bottom, scale, top)
    for number, (name, times, limit) in enumerate(stations):
        y = top + row * (number + 0.5)
        low, half, most, high = (left + float(times[key]) * scale for key in ("min", "p50", "p99", "max"))
        body.append(_label(left - 6, y + 4, _short(name), anchor="end"))
        body.append(f'<path class="axis" d="M{low:.1f} {y}H{high:.1f}M{low:.1f} {y - 4}v8M{high:.1f} {y - 4}v8"/>')
        body.append(f'<rect class="answer" x="{low:.1f}" y="{y - 5}" width="{max(most - low, 1):.1f}" height="10"/>')
        body.append(f'<path class="mark" d="M{half:.1f} {y - 5}v10"/>')
        if limit:
            body.append(f'<path class="limit" d="M{left + limit * scale:.1f} {y - 9}v18"/>')
    words = "T_SDR of the stations: " + "; ".join(
        f"{name} {times['min']} to {times['max']} {unit}, 99 % up to {times['p99']} {unit}"
        + (f", limit {limit:g} {unit}" if limit else "")
        for name, times, limit in stations
    )
    return _svg(_WIDTH, bottom + 34, words, body, "wide")


def _axis(span: float, unit: str, left: float, bottom: float, scale: float, top: float | None = None) -> list[str]:
    step = _ticks(span, 8)
    body = []
    for number in range(int(span / step + 1e-9) + 1):
        x = left + number * step * scale
        body.append(f'<path class="axis" d="M{x:.1f} {bottom}v4"/>')
        if top is not None and number:
            body.append(f'<path class="grid" d="M{x:.1f} {top}V{bottom}"/>')
        body.append(_label(x, bottom + 15, f"{number * step:g}"))
    body.append(_label(left + span * scale, bottom + 29, unit, anchor="end"))
    return body


def _short(name: str) -> str:
    """``name``, cut to the room in front of a row."""
    name = printable(name)
    room = _NAMES
    for place, letter in enumerate(name):
        room -= 11.0 if letter in "MW@%" or not letter.isascii() else 8.5 if letter.isupper() or letter in "mw" else 6.6
        if room < 0:
            return name[: max(place - 1, 1)] + "…"
    return name


class Mark(NamedTuple):
    """A change on the time line. ``seconds`` since the begin; ``address``: None for the bus."""

    seconds: float
    kind: str
    address: int | None


def time_line(changes: Sequence[Mark], seconds: float, names: Mapping[int | None, str]) -> str:
    """The changes within ``seconds``, on one line for each station and one for the bus."""
    addresses = sorted({one.address for one in changes}, key=lambda address: -1 if address is None else address)
    row, top, left, right = 22.0, 8.0, 150.0, 700.0
    scale = (right - left) / max(seconds, 1e-6)
    bottom = top + row * len(addresses)
    body = _axis(seconds, "s", left, bottom, scale, top)
    places = {address: top + row * (number + 0.5) for number, address in enumerate(addresses)}
    for address, y in places.items():
        body.append(_label(left - 6, y + 4, _short(names[address]), anchor="end"))
        body.append(f'<path class="grid" d="M{left} {y}H{right}"/>')
        body += _absences(changes, address, left, y, scale, seconds)
    drawn = set()
    for seconds_at, kind, address in changes:
        x = left + min(max(seconds_at, 0.0), seconds) * scale
        place = (kind, address, round(x))
        if place in drawn:
            continue
        drawn.add(place)
        shape, _ = MARKS.get(kind, _OTHER)
        css = "hollow" if kind in _HOLLOW else "mark"
        body.append(f'<path class="{css}" transform="translate({x:.1f} {places[address]})" d="{shape}"/>')
    words = f"Time line of {len(changes)} changes in {seconds:g} s; the table below has them all"
    return _svg(_WIDTH, bottom + 34, words, body, "wide")


def _absences(
    changes: Sequence[Mark], address: int | None, left: float, y: float, scale: float, seconds: float
) -> list[str]:
    """Thick lines while a station exchanged no data."""
    body: list[str] = []
    gone: float | None = None
    for at, kind, where in [*changes, Mark(seconds, "back", address)]:
        if where != address:
            continue
        if kind == "lost" and gone is None:
            gone = at
        elif kind == "back" and gone is not None:
            width = max((at - gone) * scale, 1)
            body.append(
                f'<rect class="absent" x="{left + gone * scale:.1f}" y="{y - 3}" width="{width:.1f}" height="6"/>'
            )
            gone = None
    return body


def marks_legend(kinds: Iterable[str]) -> str:
    """The marks of :func:`time_line` with their names, for those of ``kinds``."""
    entries = []
    for kind in sorted(set(kinds), key=lambda kind: list(MARKS).index(kind) if kind in MARKS else len(MARKS)):
        shape, name = MARKS.get(kind, (_OTHER[0], kind))
        css = "hollow" if kind in _HOLLOW else "mark"
        entries.append(
            f'<svg class="sign" viewBox="-8 -8 16 16" aria-hidden="true"><path class="{css}" d="{shape}"/></svg>'
            f" {text(name)}"
        )
    return _legend(entries)


def _legend(entries: Iterable[str]) -> str:
    return '<ul class="legend">' + "".join(f"<li>{entry}</li>" for entry in entries) + "</ul>"


# --- the schedule -----------------------------------------------------------------------------------------------------


def schedule(rotation: Rotation, *, timed: bool) -> str:
    """One rotation to scale, in strips of equal time: masters above the line, answers below it.

    ``timed``: the port could time the silence between telegrams; otherwise they stand without it, one after the other.
    """
    slots = rotation.slots if timed else _without_idle(rotation.slots)
    duration = rotation.duration_ns if timed else max(1, sum(slot.duration_ns for slot in slots))
    strips = min(max(1, -(-len(slots) // _PER_STRIP)), _MOST_STRIPS)
    span = duration / strips
    left, right = 10.0, _WIDTH - 10.0
    scale = (right - left) / span
    body = [
        '<defs><pattern id="hatch" width="4" height="4" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
        '<rect width="4" height="4" fill="#fff"/><rect width="2" height="4" fill="#a00"/></pattern></defs>'
    ]
    for number in range(strips):
        body += _strip(slots, number * span, (number + 1) * span, left, scale, number * _STRIP)
    uses = ", ".join(f"{use.value} {microseconds(rotation.used_ns(use))} us" for use in Use if rotation.used_ns(use))
    idle = f", idle {microseconds(rotation.idle_ns)} us" if timed else ""
    words = (
        f"Schedule of one rotation of {microseconds(rotation.duration_ns)} us with {len(slots)} telegrams: "
        f"{uses}{idle}. The table below has each telegram."
    )
    return _svg(_WIDTH, strips * _STRIP, words, body, "wide")


def _without_idle(slots: Sequence[Slot]) -> tuple[Slot, ...]:
    placed = []
    at = 0
    for slot in slots:
        placed.append(slot._replace(start_ns=at, idle_ns=0))
        at += slot.duration_ns
    return tuple(placed)


def _strip(slots: Sequence[Slot], begin: float, end: float, left: float, scale: float, y: float) -> list[str]:
    """The part of the schedule from ``begin`` to ``end`` (ns) with its axis."""
    middle = y + 44.0
    body = [f'<path class="axis" d="M{left} {middle}H{left + (end - begin) * scale:.1f}"/>']
    free = {True: 0.0, False: 0.0}  # where the next label may stand, above and below
    for slot in slots:
        start, stop = max(slot.start_ns, begin), min(slot.start_ns + slot.duration_ns, end)
        if start >= stop:
            continue
        x, width = left + (start - begin) * scale, max((stop - start) * scale, 0.8)
        above = slot.use is not Use.ANSWER
        tall = slot.use in (Use.TOKEN, Use.DAMAGED)
        top, height = (middle - 22, 44) if tall else (middle - 22 if above else middle, 22)
        body.append(
            f'<rect class="{_FILL[slot.use]}" x="{x:.2f}" y="{top}" width="{width:.2f}" height="{height}">'
            f"<title>{text(slot_words(slot))}</title></rect>"
        )
        if slot.start_ns < begin:
            continue
        name = _slot_label(slot)
        at = x + width / 2
        half = len(name) * _LETTER / 2
        if at - half >= free[above]:
            body.append(_label(max(at, left + half), middle - 27 if above else middle + 33, name, "small"))
            free[above] = at + half + 2
    step = _ticks((end - begin) / NS_PER_US, 8) * NS_PER_US
    number = -(-begin // step)
    while number * step <= end + 1:
        x = left + (number * step - begin) * scale
        body.append(f'<path class="axis" d="M{x:.1f} {middle + 38}v4"/>')
        anchor = "start" if x < left + 12 else "end" if x > _WIDTH - 30 else "middle"
        body.append(_label(x, middle + 50, f"{number * step / NS_PER_US:g}", "faint", anchor))
        number += 1
    return body


def _slot_label(slot: Slot) -> str:
    match slot.use:
        case Use.TOKEN:
            return f"T{slot.da}"
        case Use.REQUEST:
            return "all" if slot.da == 127 else str(slot.da)
        case Use.ANSWER:
            return "?" if slot.sa is None else str(slot.sa)
    return "!"


def slot_words(slot: Slot) -> str:
    """A telegram of the schedule in words."""
    ways = [f"from {slot.sa}"] if slot.sa is not None else []
    ways += [f"to {'all' if slot.da == 127 else slot.da}"] if slot.da is not None else []
    return " ".join([slot.use.value, *ways, slot.text, f"{slot.size} octets, {microseconds(slot.duration_ns)} us"])


def schedule_legend() -> str:
    """The shades of :func:`schedule`."""
    shades = (
        ("request", "request of a master; the number is the station asked"),
        ("answer", "answer; the number is the station that answers"),
        ("token", "token (T) to a master"),
        ("damage", "damaged octets"),
    )
    return _legend(
        f'<svg class="sign" viewBox="0 0 16 16" aria-hidden="true"><rect class="{css}" x="1" y="2" width="14" '
        f'height="12"/></svg> {text(words)}'
        for css, words in shades
    )
