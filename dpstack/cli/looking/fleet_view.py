"""The segments of a broker: a table that is redrawn on a terminal, a line a change elsewhere, or JSON lines."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from datetime import datetime
from time import time
from typing import TYPE_CHECKING, Any, Final

from dpstack.boottime import boottime_s
from dpstack.cli.terminal import output
from dpstack.text import iso_time, printable, shortened

if TYPE_CHECKING:
    from dpstack.bridge.mqtt.fleet import Fleet, Segment
    from dpstack.bridge.mqtt.fleet_reader import FleetReader

#: by the state of a segment
_STYLES: Final = {
    "dead": "bold red",
    "silent": "bold red",
    "lost slaves": "red",
    "critical": "red",
    "unknown": "yellow",
    "warning": "yellow",
    "ended": "dim",
    "ok": "green",
}
_COLUMNS: Final = ("state", "group", "node", "lost slaves, reasons", "age")
#: columns of the names of a group and of a node
_MOST_NAME: Final = 28
#: columns of a table for the lost slaves and reasons of a segment; with less the segments stand below each other
_LEAST_REASON: Final = 24
_LONGEST_STATE: Final = "lost slaves"
_LONGEST_AGE: Final = "since 00:00:00"
#: lines for the lost slaves and reasons of a segment without a table
_MOST_REASON_LINES: Final = 3
#: segments that are named when the screen has ended
_LAST: Final = 20


class FleetView:
    """``redraws``: :meth:`watch` draws a table; else each change is a line. :meth:`begin` comes first."""

    def __init__(
        self, fleet: Fleet, place: str, *, json: bool, redraws: bool, expected: Sequence[tuple[str, str]] = ()
    ) -> None:
        self.redraws = redraws
        self._reader: FleetReader | None = None
        self._fleet = fleet
        self._place = place
        self._json = json
        self._expected = expected
        self._remark = f"connecting to {place}"

    def begin(self, reader: FleetReader) -> None:
        """Print the first line."""
        self._reader = reader
        if self._json:
            output.json_line({"event": "start", "time": iso_time(time()), "broker": self._place})
        elif not self.redraws:
            output.line(f"{self._remark}; Ctrl-C ends", "bold")

    def show(self, segment: Segment) -> None:
        """A segment has changed."""
        if self._json:
            output.json_line({"event": "segment", "time": iso_time(time()), **self._as_dict(segment)})
        elif not self.redraws:
            where, why = printable(f"{segment.group}/{segment.node}"), _why(segment)
            text = f"{_clock(time())}  {where}: {segment.state.value}{': ' if why else ''}{why}"
            output.line(f"{text}, since {_clock(_wall(segment.since))}", _STYLES[segment.state.value])

    def tell(self, text: str) -> None:
        """A remark about the broker."""
        self._remark = "" if text.startswith("connected") else text  # segments say more
        assert self._reader is not None
        if self._json:
            connected = self._reader.connected
            output.json_line({"event": "broker", "time": iso_time(time()), "connected": connected, "text": text})
        elif not self.redraws:
            output.warn(text)

    def end(self) -> bool:
        """Print the summary. Returns whether a segment is dead, silent, critical or missing, or none is there."""
        from dpstack.bridge.mqtt.fleet import BAD

        for one in self._fleet.tick(boottime_s()):
            self.show(one)
        states = {state.value.replace(" ", "_"): count for state, count in self._fleet.counts().items()}
        there = {(one.group, one.node) for one in self._fleet}
        missing = [printable(f"{group}/{node}") for group, node in self._expected if (group, node) not in there]
        found = any(one.state in BAD for one in self._fleet) or bool(missing) or not there
        if self._json:
            summary = {"event": "summary", "time": iso_time(time()), "segments": len(self._fleet), "states": states}
            output.json_line(summary | ({"missing": missing} if self._expected else {}) | self._losses())
            return found
        if self.redraws:
            bad = [one for one in self._fleet if one.state in BAD]
            if self._remark:
                output.line(self._remark)
            for one in bad[:_LAST]:
                where = printable(f"{one.group}/{one.node}")
                output.line(f"{where}: {one.state.value}: {_why(one)}", _STYLES[one.state.value])
            if len(bad) > _LAST:
                output.line(f"and {len(bad) - _LAST} more")
        for where in missing:
            output.line(
                f"{where}: missing: {self._place} has no status of it; does its run go, with [mqtt] to it?", "red"
            )
        output.line(self._counts())
        if not there and not missing and self._reader is not None and self._reader.connected:
            output.line(
                f"{self._place} has no status of any segment: each dpstack run with [mqtt] keeps one there", "red"
            )
        if troubles := self._troubles():
            output.line(troubles)
        return found

    async def watch(self) -> None:
        """Redraw the table until cancelled; then the terminal has its text of before again."""
        from dpstack.cli.terminal import drawing

        with output.guarded():
            await drawing.redrawn(self.picture)

    def picture(self) -> Any:
        """The table at this moment, no higher than the terminal: the worst segments if there is no room for all."""
        from rich.console import Console, Group

        from dpstack.cli.terminal import drawing

        self._fleet.tick(boottime_s())  # the computer may have slept since the last look at the time
        console = Console()
        bad = next((one.state.value for one in self._fleet), "unknown")
        head = [drawing.shown(f"{self._place}  {self._counts()}", f"bold {_STYLES[bad]}")]
        head += [drawing.shown(text, "yellow") for text in (self._remark, self._troubles()) if text]
        room = max(1, console.height - 1 - sum(len(console.render_lines(one)) for one in head))
        fleet = [one for one, _ in zip(self._fleet, range(room), strict=False)]
        if any(_reason_room(one, console.width) < _LEAST_REASON for one in fleet):
            return Group(*head, *self._narrow_list(console.width, room))
        while True:
            out = len(self._fleet) - len(fleet)
            rows = [self._row(one, console.width) for one in fleet]
            styles = [_STYLES[one.state.value] for one in fleet]
            table = drawing.rich_table(_left_out(out), _COLUMNS, rows, console.width, styles)
            over = len(console.render_lines(table)) - room
            if over <= 0 or len(fleet) <= 1:
                return Group(*head, *([table] if fleet else []))
            # a row has one line or more
            del fleet[-min(max(1, over // 2), len(fleet) - 1) :]

    def _narrow_list(self, width: int, room: int) -> list[Any]:
        """The segments below each other, for a window without room for a table: state and name of each, below it the
        lost slaves and reasons; at most ``room`` lines of ``width`` columns."""
        from dpstack.cli.terminal import drawing

        lines: list[Any] = []
        shown = 0
        for one in self._fleet:
            name = f"{shortened(printable(one.group), _MOST_NAME)}/{shortened(printable(one.node), _MOST_NAME)}"
            texts = textwrap.wrap(f"{one.state.value}  {name}  {_age(one)}", width, subsequent_indent="  ")
            if why := _why(one):
                texts += textwrap.wrap(
                    printable(why),
                    width,
                    initial_indent="  ",
                    subsequent_indent="  ",
                    max_lines=_MOST_REASON_LINES,
                    placeholder="...",
                )
            # one line is kept for the number of the others
            more = len(self._fleet) > shown + 1
            if lines and len(lines) + len(texts) + more > room:
                break
            lines += [drawing.shown(text, _STYLES[one.state.value]) for text in texts]
            shown += 1
        del lines[room:]
        if shown < len(self._fleet) and len(lines) < room:
            text = _left_out(len(self._fleet) - shown)
            # the reason is left out if it does not fit
            text = text if len(text) <= width else text.partition(":")[0]
            lines.append(drawing.shown(shortened(text, width), "bold"))
        return lines

    def _row(self, one: Segment, width: int) -> tuple[object, ...]:
        names = [shortened(printable(name), _MOST_NAME) for name in (one.group, one.node)]
        return (one.state.value, *names, shortened(_why(one), _reason_room(one, width)), _age(one))

    def _counts(self) -> str:
        states = ", ".join(f"{count} {state.value}" for state, count in self._fleet.counts().items())
        count = len(self._fleet)
        return f"{count} segment{'' if count == 1 else 's'}{': ' if states else ''}{states}"

    def _losses(self) -> dict[str, int]:
        assert self._reader is not None
        return {"left_out": self._fleet.left_out, "broken": self._fleet.broken, "lost": self._reader.lost}

    def _troubles(self) -> str:
        fleet, losses = self._fleet, self._losses()
        texts = []
        if losses["left_out"]:
            texts.append(f"{_messages(losses['left_out'])} of more than {fleet.most} segments left out")
        if losses["broken"]:
            texts.append(f"{_messages(losses['broken'])} without a valid status (the last: {fleet.why_broken})")
        if losses["lost"]:
            texts.append(f"{_messages(losses['lost'])} came faster than they could be read")
        return "; ".join(texts)

    def _as_dict(self, one: Segment) -> dict[str, object]:
        status = one.status
        return {
            "group": one.group,
            "node": one.node,
            "state": one.state.value.replace(" ", "_"),
            "since": iso_time(_wall(one.since)),
            "age_s": round(max(0.0, boottime_s() - one.heard), 1),
            "verdict": status.verdict,
            "reasons": one.reasons,
            "slaves": status.slaves,
            "lost": [{"address": slave.address, "name": slave.name, "state": slave.state} for slave in status.lost],
            "more_lost": status.more_lost,
            "versions": dict(status.versions),
        }


def _age(one: Segment) -> str:
    if one.state.value in ("dead", "silent", "ended"):
        return f"since {_clock(_wall(one.since))}"
    return f"{max(0.0, boottime_s() - one.heard):.0f} s"


def _reason_room(one: Segment, width: int) -> int:
    """Columns of a table of ``width`` that are left for lost slaves and reasons."""
    names = [shortened(printable(name), _MOST_NAME) for name in (one.group, one.node)]
    # all others, the borders, and a space on either side of each column
    return width - sum(map(len, (_LONGEST_STATE, *names, _LONGEST_AGE))) - 3 * len(_COLUMNS) - 1


def _messages(count: int) -> str:
    return f"{count} message{'' if count == 1 else 's'}"


def _left_out(count: int) -> str:
    more = f"{count} more segment{'' if count == 1 else 's'}"
    return f"{more}, none of them worse: the window is too small" if count else ""


def _why(one: Segment) -> str:
    """Lost slaves and reasons of a segment; of one that is gone, what it said last."""
    status = one.status
    texts = [f"{slave.name} ({slave.address}, {slave.state})" for slave in status.lost]
    if status.more_lost:
        texts.append(f"and {status.more_lost} more")
    lost = ", ".join(texts)
    return "; ".join(text for text in (lost, *one.reasons) if text)


def _wall(at: float) -> float:
    """A time of :func:`boottime_s` in s since 1970, by the clock of this computer."""
    return time() - (boottime_s() - at)


def _clock(seconds: float) -> str:
    """The time of day on this computer, in s since 1970; with the day if it is another one."""
    when = datetime.fromtimestamp(seconds).astimezone()
    today = datetime.fromtimestamp(time()).astimezone().date()
    return when.strftime("%H:%M:%S" if when.date() == today else "%Y-%m-%d %H:%M:%S")
