"""Wire logs in words: the log that a failing test and the referee of a simulated bus print."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from dpstack.capture.transmission import Transmission
from dpstack.decode.fields import Fields
from dpstack.decode.names import NO_NAMES, Names
from dpstack.decode.telegram import Explained, Explainer
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.trace import WireEntry
from dpstack.units import NS_PER_MS, NS_PER_S, NS_PER_US, ns_to_bits

#: a wire log shows this many octets of a transmission in full
SHOWN_OCTETS: Final = 32
#: this many telegrams in a row without anything new are one line
_FOLDED_FROM: Final = 3
#: values of a running drive, which change from telegram to telegram
_MEASURED: Final = frozenset({"speed", "current", "torque", "frequency_hz", "map", "text"})
#: the service of a poll of the GAP
_GAP_POLL: Final = "FDL_Status"
#: numbers of other telegrams in a remark
_NUMBER: Final = re.compile(r"\d+")
#: kind and stations of a telegram, and its service
_Place = tuple[object, ...]


def render(
    log: Iterable[WireEntry], baud: int, *, names: Names = NO_NAMES, last: int | None = None, number: int = 1
) -> str:
    """The decoded wire log, a line for each transmission: its number, start in us, gap before it in bit times, sender,
    octets in hex (long ones without their middle), description and its course. A negative gap is an overlap.

    ``last``: lines of the last transmissions only; those before them explain theirs. ``names``, ``number``: see
    :func:`render_changes`.
    """
    entries = list(log)
    explained = _explained(entries, baud, names, number)
    lines = [_Line(entry, one, one.text) for entry, one in zip(entries, explained, strict=True)]
    if last is not None:
        lines = lines[-last:] if last > 0 else []
    return "\n".join(_table(lines, baud, "us", NS_PER_US, 14))


def render_changes(
    log: Iterable[WireEntry], baud: int, *, names: Names = NO_NAMES, last: int = 40, number: int = 1
) -> str:
    """The last ``last`` lines of the wire log in which telegrams that say nothing new are one line.

    New is everything that differs from the telegram before of the same sort between the same stations: other outputs
    or inputs (for a drive: other bits or another set point, not its speed, current and torque), another diagnosis, an
    answer that is missing or comes back, a retry, damage, a remark. Polls of the GAP are new if an address begins or
    ceases to answer. ``names``: of stations and process data; ``number``: of the first transmission.
    """
    entries = list(log)
    explained = _explained(entries, baud, names, number)
    unanswered = {one.step.unanswered for one in explained}
    changes = _Changes()
    lines: list[_Line] = []
    same: list[_Line] = []
    for entry, one in zip(entries, explained, strict=True):
        is_last = one.number == number + len(entries) - 1
        is_unanswered = one.number in unanswered or (is_last and one.service == _GAP_POLL)
        one.step = one.step._replace(unanswered=None)  # the request itself says so here
        text = f"{one.text}{_values(one.fields)}" + ("; not answered" if is_unanswered else "")
        line = _Line(entry, one, text)
        if changes.is_new(line, is_unanswered=is_unanswered):
            lines += _folded(same)
            lines.append(line)
            same = []
        else:
            same.append(line)
    lines += _folded(same)
    return "\n".join(_table(lines[-last:] if last > 0 else [], baud, "s", NS_PER_S, 12))


def _explained(entries: Sequence[WireEntry], baud: int, names: Names, number: int) -> list[Explained]:
    explainer = Explainer(names)
    return [
        explainer.add(Transmission(entry.octets, entry.start_ns, baud), at) for at, entry in enumerate(entries, number)
    ]


class _Line(NamedTuple):
    """A transmission, or if ``one`` is None several that repeat what was there before, which end with ``entry``."""

    entry: WireEntry
    one: Explained | None
    text: str


class _Changes:
    """Says whether a telegram differs from the one before of the same sort between the same stations."""

    def __init__(self) -> None:
        self._last: dict[_Place, object] = {}

    def is_new(self, line: _Line, *, is_unanswered: bool) -> bool:
        entry, one = line.entry, line.one
        assert one is not None
        telegram, step = one.telegram, one.step
        if telegram is None:
            return True
        place = (telegram.kind, telegram.sa, telegram.da, telegram.is_request, one.service)
        if telegram.kind is Kind.SC and step.request is not None:
            place = (telegram.kind, step.request.da, step.request.sa, False, one.service)
        function = None if telegram.is_request else telegram.fc  # a request turns its frame count bit
        remarks = _NUMBER.sub("", "; ".join(step.remarks))
        retry = step.retry_of is not None
        said: object = (_content(one, telegram), function, one.error, entry.note, is_unanswered, retry, remarks)
        if one.service == _GAP_POLL and not step.remarks:
            said = is_unanswered
        before = self._last.get(place)
        self._last[place] = said
        if before is None and is_unanswered and one.service == _GAP_POLL:
            return False
        return said != before


def _content(one: Explained, telegram: Telegram) -> object:
    """The data unit; of a drive its words without the measured values, of an S7-200 all but the sequence number."""
    if "PPI_PDU" in one.fields:
        return {name: value for name, value in one.fields.items() if name != "Sequence"}
    drive = one.fields.get("drive")
    if not isinstance(drive, dict):
        return telegram.data
    return {name: value for name, value in drive.items() if name not in _MEASURED}


def _values(fields: Fields) -> str:
    """Named process data of a telegram."""
    named = [value for key in ("outputs", "inputs") if isinstance(value := fields.get(key), dict)]
    return "".join(f"; {name} {value}" for values in named for name, value in values.items())


def _folded(same: Sequence[_Line]) -> Sequence[_Line]:
    """One line for telegrams that say nothing new."""
    if len(same) < _FOLDED_FROM:
        return same
    counts: Counter[str] = Counter()
    for line in same:
        one = line.one
        telegram = None if one is None else one.telegram
        if one is None or telegram is None:
            continue
        if telegram.kind is Kind.SD4:
            counts["token"] += 1
        elif telegram.is_request:
            whom = "" if one.service == _GAP_POLL else f" to {one.receiver or telegram.da}"
            counts[f"{one.service}{whom}"] += 1
    parts = ", ".join(f"{count} {what}" for what, count in counts.items())
    ms = (same[-1].entry.end_ns - same[0].entry.start_ns) / NS_PER_MS
    return [_Line(same[-1].entry, None, f"{len(same)} telegrams in {ms:.1f} ms as before: {parts}")]


def _table(lines: Sequence[_Line], baud: int, unit: str, unit_ns: int, room: int) -> list[str]:
    """The lines with the times in ``unit``, in ``room`` characters."""
    shown = ["" if line.one is None else _hex(line.entry.octets) for line in lines]
    width = max((len(octets) for octets in shown), default=0)
    table = [f"{'no.':>5} {f'start {unit}':>{room}} {'gap bits':>9}  {'sender':<10} {'octets':<{width}}  telegram"]
    end: int | None = None
    for (entry, one, text), octets in zip(lines, shown, strict=True):
        if one is None:
            table.append(f"{'...':>5} {text}")
        else:
            gap = "" if end is None else str(ns_to_bits(entry.start_ns - end, baud))
            start = f"{entry.start_ns // unit_ns}.{entry.start_ns % unit_ns:0{len(str(unit_ns)) - 1}}"
            said = f"{text}  [{entry.note}]" if entry.note else text
            sender = entry.sender or "?"
            table.append(f"{one.number:>5} {start:>{room}} {gap:>9}  {sender:<10} {octets:<{width}}  {said}")
        end = entry.end_ns if end is None else max(end, entry.end_ns)
    return table


def _hex(octets: bytes) -> str:
    if len(octets) <= SHOWN_OCTETS:
        return octets.hex(" ")
    return f"{octets[: SHOWN_OCTETS - 8].hex(' ')} ... {octets[-4:].hex(' ')} ({len(octets)} octets)"
