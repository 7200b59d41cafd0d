"""The monitored bus on a screen: a live list that is redrawn, lines of events, tables at the end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from time import time_ns
from typing import TYPE_CHECKING, Any, Final

from dpstack.cli.terminal import output
from dpstack.monitor.counters import State
from dpstack.monitor.monitor import Happening, Monitor
from dpstack.monitor.not_heard import verdict_text
from dpstack.monitor.summary import UNSEEN
from dpstack.monitor.verdict import CRITICAL, GOOD, UNKNOWN, WARNING
from dpstack.monitor.verdicts import Heard
from dpstack.units import NS_PER_S, baud_text

if TYPE_CHECKING:
    from dpstack.api.listen.report_file import ReportFile

STYLES: Final = {GOOD: "green", UNKNOWN: "", WARNING: "yellow", CRITICAL: "bold red"}
#: of events
_EVENT_STYLES: Final = {"lost": "red", "left": "red", "alarm": "yellow", "gap": "yellow"}
#: lines of events under the live list, at most
_EVENTS: Final = 10
#: lines of a table with one station, and of its title
_LEAST: Final = 9
#: of the time line, after the live list
_LAST: Final = 40
_COLUMNS: Final = ("address", "name", "state", "requests", "retries", "no answer", "damaged", "T_SDR us", "verdict")
#: in the live list of a narrow terminal, which the full table would fill with a few stations
_NARROW_COLUMNS: Final = ("address", "name", "retries", "verdict")
_NARROW: Final = 90
_LINKS: Final = ("subscriber", "octets", "state")
_MASTERS: Final = ("master", "mode", "token us", "rotation us", "hold us", "GAP polls", "drop-outs", "slaves")


def event_line(happening: Happening, begun_ns: int) -> None:
    """Print one event as a line."""
    output.line(_event(happening, begun_ns), _EVENT_STYLES.get(happening.kind, ""))


def _event(happening: Happening, begun_ns: int) -> str:
    return f"{max(0, happening.t_ns - begun_ns) / NS_PER_S:9.3f} s  {happening.text}"


def show_summary(heard: Heard, summary: Mapping[str, Any]) -> None:
    """Print the tables at the end, the verdicts with their reasons, and what cannot be seen by listening."""
    stations = summary["stations"]
    if stations:
        output.table("Stations", _COLUMNS, _rows(stations))
    if summary["masters"]:
        output.table("Masters", _MASTERS, [_master_row(*item) for item in summary["masters"].items()])
    if links := [*_links(stations)]:
        output.table("Links between slaves (data exchange broadcast)", _LINKS, links)
    output.line(_bus_line(summary))
    timing = _timing_line(summary)
    if timing:
        output.line(timing)
    for address, station in stations.items():
        for reason in station["reasons"]:
            if station["verdict"] in (WARNING, CRITICAL):
                text = f"{_role(station)} {_titled(address, station)}: {reason}"
                output.line(text, STYLES[station["verdict"]])
    output.line(f"verdict: {verdict_text(summary)}", STYLES[summary["verdict"]])
    for reason in summary["reasons"]:
        if not reason.startswith(("station ", "master ")):
            output.line(f"  {reason}", STYLES[summary["verdict"]])
    for text in summary["not_heard"]:
        output.line(f"not heard: {text}")
    output.line(f"listening cannot see: {'; '.join(UNSEEN)}")


def _links(stations: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[object, ...]]:
    """A row for each link of a subscriber."""
    for address, station in stations.items():
        for link in station.get("links", ()):
            yield (_titled(address, station), link["text"], link["state"] or "not reported")


def _lost_links(stations: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """A line for each link whose last message says that no valid data come."""
    for address, station in stations.items():
        for link in station.get("links", ()):
            if link["good"] is False:
                yield f"{_titled(address, station)}, {link['text']}: {link['state']}"


def _role(station: Mapping[str, Any]) -> str:
    return "master" if station["role"] == "master" else "station"


def _titled(address: str, station: Mapping[str, Any]) -> str:
    return f"{address} ({station['name']})" if station["name"] else address


def _rows(stations: Mapping[str, Mapping[str, Any]]) -> list[tuple[object, ...]]:
    return [_row(address, station) for address, station in stations.items()]


def _row(address: str, station: Mapping[str, Any]) -> tuple[object, ...]:
    name = station["name"] or station["model"] or station["ident"] or ""
    if station["role"] == "master":
        state = "master, silent" if station["state"] == State.OFFLINE else "master"
    else:
        state = station["state"].replace("_", " ")
    if state == State.UNKNOWN:
        state = "no master"
    tsdr = station["tsdr_us"]
    counts = (station["requests"], sum(station["retry_depth"]), station["no_answer"], station["damaged"])
    return (address, name, state, *counts, "-" if tsdr is None else f"{tsdr['p50']:g}", station["verdict"])


def _narrow_row(address: str, station: Mapping[str, Any]) -> tuple[object, ...]:
    name = station["name"] or ("master" if station["role"] == "master" else station["state"].replace("_", " "))
    return (address, name, sum(station["retry_depth"]), station["verdict"])


def _master_row(address: str, master: Mapping[str, Any]) -> tuple[object, ...]:
    slaves = ", ".join(map(str, master["slaves"])) or "none"
    shown = (("token_us", "mean"), ("rotation_us", "mean"), ("hold_us", "p50"))
    times = ["-" if master[of] is None else f"{master[of][key]:g}" for of, key in shown]
    mode = "silent" if master["silent"] else master["mode"]
    return (address, mode, *times, master["gap_polls"], master["drops"], slaves)


def _bus_line(summary: Mapping[str, Any]) -> str:
    rate = "rate not known" if summary["baud"] is None else baud_text(summary["baud"])
    damaged = ", ".join(f"{count} {cause}" for cause, count in summary["damaged"].items()) or "none"
    return (
        f"{rate}, {summary['seconds']:.1f} s, {summary['telegrams']} telegrams ({summary['telegrams_per_s']:g} a "
        f"second), load {summary['load']:.0%}, damaged: {damaged}"
    )


def _timing_line(summary: Mapping[str, Any]) -> str:
    timing = summary["timing"]
    resolution = timing["resolution_us"]
    if resolution is None:
        return "the file does not say how finely it is timed: times of single answers are not shown or judged"
    if resolution < 1:
        return ""
    return (
        f"times by the {timing['source']}, to {resolution:g} us; {timing['batched']:.0%} of the telegrams arrived "
        "together with others; finer figures are not shown or judged"
    )


class LiveView:
    """The live list of ``monitor`` on a terminal, on a screen of its own: every picture is drawn whole, so that nothing
    is left of the one before when the window changes its size."""

    def __init__(self, monitor: Monitor, port: str) -> None:
        self._monitor = monitor
        self._port = port

    def show_time_line(self) -> None:
        """Print the last entries of the time line as lines: they were on the live screen only."""
        for one in list(self._monitor.time_line)[-_LAST:]:
            event_line(one, self._monitor.begun_ns)

    async def watch(self) -> None:
        """Redraw the list until cancelled; then the terminal has its text of before again."""
        from dpstack.cli.terminal import drawing

        with output.guarded():
            await drawing.redrawn(lambda: self.picture(time_ns()))

    def picture(self, now_ns: int) -> Any:
        """The list at ``now_ns`` (ns since 1970), no higher than the terminal."""
        from rich.console import Console, Group

        from dpstack.cli.terminal import drawing

        monitor, console = self._monitor, Console()
        summary: Mapping[str, Any] = monitor.summary(now_ns)
        head = drawing.shown(
            f"{self._port}  {_bus_line(summary)}  verdict: {verdict_text(summary)}", STYLES[summary["verdict"]]
        )
        why = [drawing.shown(reason, STYLES[summary["verdict"]]) for reason in summary["reasons"][:3]]
        why += [drawing.shown(f"link: {lost}", STYLES[WARNING]) for lost in islice(_lost_links(summary["stations"]), 3)]
        events = [
            drawing.shown(_event(one, monitor.begun_ns), _EVENT_STYLES.get(one.kind, ""))
            for one in list(monitor.time_line)[-_EVENTS:]
        ]
        top: list[Any] = [head, *why]
        while len(top) > 1 and _height(console, top) > console.height - _LEAST:
            del top[-1]
        room = console.height - 1 - _height(console, top)
        stations = summary["stations"]
        table = _fitting(stations, console, max(4, room - min(len(events), 3)))
        room -= _height(console, [table])
        while events and _height(console, events) > room:
            del events[0]
        return Group(*top, table, *events)


def _height(console: Any, parts: Sequence[Any]) -> int:
    return sum(len(console.render_lines(part)) for part in parts)


def _fitting(stations: Mapping[str, Mapping[str, Any]], console: Any, room: int) -> Any:
    """The table of the stations in at most ``room`` lines; if they do not fit, the best ones are left out."""
    from dpstack.cli.terminal import drawing

    narrow = console.width < _NARROW
    columns = _NARROW_COLUMNS if narrow else _COLUMNS
    shown = dict(stations)
    order = (GOOD, UNKNOWN, WARNING, CRITICAL)
    leaving = sorted(stations, key=lambda address: (order.index(stations[address]["verdict"]), -int(address)))
    while True:
        out = len(stations) - len(shown)
        title = f"{out} more stations: the window is too small" if out else ""
        styles = [STYLES[station["verdict"]] for station in shown.values()]
        rows = [_narrow_row(*item) for item in shown.items()] if narrow else _rows(shown)
        table = drawing.rich_table(title, columns, rows, console.width, styles)
        over = len(console.render_lines(table)) - room
        if over <= 0 or len(shown) <= 1:
            return table
        for address in leaving[out : out + max(1, over // 2)]:
            if len(shown) > 1:
                del shown[address]


def write_report(
    report: ReportFile | None,
    summary: dict[str, object],
    line: dict[str, object],
    remarks: Sequence[str] = (),
    *,
    json: bool,
) -> None:
    """Write the report, if there is to be one; a failure is a warning."""
    if report is None:
        return
    why = report.write(summary, line, remarks=remarks)
    if why is not None:
        output.warn(why)
    elif not json:
        output.line(f"report: {report.name}")
