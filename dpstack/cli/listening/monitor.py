"""``dpstack monitor``: judges a bus by listening, live or from a capture file. Never sends."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
from datetime import UTC, datetime
from time import monotonic_ns, time_ns
from typing import Final

from dpstack.api.bus.events_json import PortBack, PortLost
from dpstack.api.config.bus import AUTO
from dpstack.api.config.config import load_config
from dpstack.api.listen.listening import PORT_LOSSES, Line, Listening, OctetsLost
from dpstack.api.listen.plant_files import load_devices, load_thresholds
from dpstack.api.listen.report_file import ReportFile, port_lines
from dpstack.capture.pcapng import Interface
from dpstack.capture.timing import ADAPTER, FILE, LineTiming
from dpstack.cli import options
from dpstack.cli.listening.monitor_view import LiveView, event_line, show_summary
from dpstack.cli.listening.source_file import transmissions_of
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.nonblocking_stdout import run_unhurried
from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal
from dpstack.errors import CaptureFileError, PortError, UsageError
from dpstack.monitor.monitor import Happening, Monitor
from dpstack.monitor.verdicts import CRITICAL
from dpstack.trace import Event
from dpstack.units import NS_PER_S, baud_text

#: pause before the next look for a program that holds the port, in s
_AGAIN_S: Final = 0.5
_TICK_S: Final = 0.5
#: octets of a tap or an adapter are no later
_LATE_NS: Final = NS_PER_S
_CONVERTER: Final = (
    "nothing is sent, but opening a port may switch RTS for an instant: a converter that takes its direction from RTS "
    "drives the bus for that time"
)


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack monitor --port /dev/ttyUSB0; dpstack monitor bus.pcapng --gsd plant/gsd; "
        "dpstack monitor --port /dev/ttyUSB0 --config plant.toml --seconds 600 --json"
    )
    parser.value("file", "FILE", "a capture file (pcapng), in place of --port", nargs="?")
    parser.value("--port", "P", "the port; also one that a run, sim or segment holds")
    parser.value(
        "--baud", "B|auto", 'rate in bit/s; "auto" (default): finds it', type=options.baud_or_auto, default=AUTO
    )
    parser.value("--config", "CONFIG", "configuration file: names of the slaves, their GSD files, T_SL")
    parser.value("--gsd", "DIR", "folder of GSD files: models and diagnosis texts by ident number")
    parser.value("--thresholds", "FILE", "TOML file with other thresholds, see docs/monitor.md")
    parser.value("--seconds", "S", "end after so many seconds", type=options.seconds)
    parser.value("--report", "FILE.html", "write an acceptance report, a new file; see docs/monitor.md")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 where the verdict on the bus is critical, the file cannot be read to its end, or the port failed."""
    if (args.file is None) == (args.port is None):
        raise UsageError("monitor: give either a capture file or --port, for instance --port /dev/ttyUSB0")
    config = None if args.config is None else load_config(args.config)
    devices = load_devices(config, args.gsd, output.warn)
    thresholds = None if args.thresholds is None else load_thresholds(args.thresholds)
    live = args.file is None
    begun_ns = time_ns() if live else None
    monitor = Monitor(LineTiming(FILE, None), devices=devices, thresholds=thresholds, begun_ns=begun_ns)
    report = None if args.report is None else ReportFile(args.report, monitor)
    with report or contextlib.nullcontext():
        if live:
            return run_unhurried(_Live(args, monitor, report).run(), json=args.json)
        return _FromFile(args, monitor, report).run()


def _write(report: ReportFile | None, summary: dict[str, object], line: dict[str, object], *, json: bool) -> None:
    """Write the report, if there is to be one; a failure is a warning."""
    if report is None:
        return
    why = report.write(summary, line)
    if why is not None:
        output.warn(why)
    elif not json:
        output.line(f"report: {report.name}")


class _FromFile:
    """Judges a capture file."""

    def __init__(self, args: argparse.Namespace, monitor: Monitor, report: ReportFile | None) -> None:
        self._report = report
        self._name: str = args.file
        self._json: bool = args.json
        self._baud = 0 if args.baud == AUTO else args.baud
        self._limit_ns = None if args.seconds is None else int(args.seconds * NS_PER_S)
        self._monitor = monitor
        self._port: str | None = None
        self._other_port = False
        self._left_out: set[str] = set()
        monitor.on_event = self._show

    def run(self) -> int:
        damage = None
        try:
            self._read()
        except CaptureFileError as error:
            damage = error
        summary = self._monitor.summary()
        if damage is not None and not summary["telegrams"]:
            raise damage
        if self._json:
            output.json_line(summary)
        else:
            show_summary(self._monitor.heard(), summary)
        _write(self._report, summary, {"Capture file": self._name}, json=self._json)
        if damage is not None:
            output.warn(str(damage))
        return 1 if damage is not None or summary["verdict"] == CRITICAL else 0

    def _read(self) -> None:
        monitor = self._monitor
        add = monitor.add if self._report is None else self._report.add
        end = None
        for one in transmissions_of(self._name, self._interface):
            if self._other_port:
                continue
            if not one.baud:
                one = one._replace(baud=self._baud or self._without_rate())
            if one.note and not one.damage:
                monitor.gap(one.t_ns or 0, one.note)
            add(one)
            if self._limit_ns is not None:
                if end is None:
                    end = (one.t_ns or 0) + self._limit_ns
                elif (one.t_ns or 0) >= end:
                    return

    def _without_rate(self) -> int:
        raise UsageError(
            f"{self._name}: the file does not say the rate of its bus; give it, for instance --baud 500000"
        )

    def _interface(self, interface: Interface) -> None:
        """The next transmissions are of this port: those of the first one are judged."""
        if self._port is None:
            self._port = interface.name
        self._other_port = interface.name != self._port
        if not self._other_port:
            self._monitor.timing = LineTiming.parse(interface.description)
        elif interface.name not in self._left_out:
            self._left_out.add(interface.name)
            output.warn(f"{self._name}: only the port {self._port!r} is judged; left out: {interface.name!r}")

    def _show(self, happening: Happening) -> None:
        if self._json:
            output.json_line(happening.as_dict(self._monitor.begun_ns))
        elif not happening.routine:
            event_line(happening, self._monitor.begun_ns)


class _Live:
    """Judges the bus at a port."""

    def __init__(self, args: argparse.Namespace, monitor: Monitor, report: ReportFile | None) -> None:
        self._args = args
        self._report = report
        self._add = monitor.add if report is None else report.add
        self._json: bool = args.json
        self._monitor = monitor
        self._line: Line | None = None
        self._begun = asyncio.Event()
        self._port_damage: dict[str, int] = {}
        self._early: list[Event] = []  # before the start line
        self._listening: Listening | None = None  # while it is entered
        self._view = LiveView(monitor, args.port) if output.redraws() and not args.json else None
        self._failure: PortError | None = None
        self._clock_ns = time_ns() - monotonic_ns()
        monitor.on_event = self._show

    async def run(self) -> int:
        with StopSignal() as stop:
            try:
                await stop.or_done(self._work())
            except PortError as error:
                if self._line is None:  # it never began
                    raise
                self._failure = error
        if stop.hurried:
            return INTERRUPTED
        now = time_ns()
        summary = self._monitor.summary(now)
        if self._json:
            output.json_line(summary)
        else:
            if self._view is not None:
                self._view.show_time_line()
            show_summary(self._monitor.heard(now), summary)
        if self._line is not None:
            _write(self._report, summary, self._about(self._line), json=self._json)
        if self._failure is not None:
            raise self._failure
        return int(summary["verdict"] == CRITICAL)

    def _about(self, line: Line) -> dict[str, object]:
        """The line for the report."""
        if line.program is not None:
            return {"Port": line.port, "Listened": f"through the dpstack {line.program} that holds the port"}
        return {**port_lines(line.port), "Listened": f"on the port itself, which wrote nothing; {_CONVERTER}"}

    async def _work(self) -> None:
        """Listen until the time is over. Raises PortError where the port cannot be listened to any more."""
        listening = asyncio.ensure_future(self._listen())
        watching = [asyncio.ensure_future(self._tick())]
        if self._view is not None:
            watching.append(asyncio.ensure_future(self._watch(self._view)))
        try:
            await asyncio.wait([listening], timeout=self._args.seconds)
            if listening.done():
                listening.result()
        finally:
            for task in (listening, *watching):
                task.cancel()
            await asyncio.gather(listening, *watching, return_exceptions=True)

    async def _watch(self, view: LiveView) -> None:
        await self._begun.wait()  # what stands on the screen before stays readable
        await view.watch()

    async def _tick(self) -> None:
        """Let the monitor know that time passes, also on a silent line."""
        while True:
            await asyncio.sleep(_TICK_S)
            self._monitor.tick(time_ns() - _LATE_NS)
            self._look_at_port()

    def _look_at_port(self) -> None:
        """Tell octets that the port has lost since the last look."""
        if self._listening is None:
            return
        before, self._port_damage = self._port_damage, self._listening.damage()
        lost = sum(self._port_damage.get(cause, 0) - before.get(cause, 0) for cause in PORT_LOSSES)
        if lost > 0:
            text = f"this computer read the port too late: {lost} octets were lost within the last {_TICK_S:g} s"
            self._monitor.gap(time_ns(), text)

    async def _listen(self) -> None:
        """Listen to the port; where a program that held it ends, wait until one is there again."""
        baud = None if self._args.baud == AUTO else self._args.baud
        while True:
            self._listening = None
            listening = Listening(self._args.port, baud, self._add, self._on_event, own=self._line is None)
            try:
                async with listening:
                    self._listening = listening
                    self._begin(listening.line)
                    await listening.ended()
            except PortError as error:
                if self._line is None or self._line.program is None:
                    raise
                if self._listening is not None:
                    self._listening = None
                    self._monitor.lost(time_ns(), f"{error}; waiting until a program holds the port again")
            await asyncio.sleep(_AGAIN_S)

    def _begin(self, line: Line) -> None:
        again, self._line = self._line is not None, line
        self._monitor.timing = line.timing
        if again:
            self._monitor.back(time_ns(), f"the {line.program} on {line.port} is back")
            return
        if self._json:
            now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
            start = {"event": "start", "time": now, "port": line.port, "baud": line.baud, "source": line.source}
            output.json_line({**start, "program": line.program})
        elif self._view is None:
            through = f" through the {line.program} that holds it" if line.program else ""
            rate = "its rate is searched" if line.baud is None else baud_text(line.baud)
            output.line(f"listening on {line.port}{through}, {rate}; Ctrl-C ends", "bold")
        if line.program is None and line.source == ADAPTER and not self._json:
            output.warn(_CONVERTER)
        self._begun.set()
        early, self._early = self._early, []
        for event in early:
            self._on_event(event)

    def _on_event(self, event: Event) -> None:
        if self._line is None:
            self._early.append(event)
            return
        t_ns = event.t_ns + self._clock_ns
        match event:
            case OctetsLost():
                self._monitor.gap(t_ns, event.text)
            case PortLost():
                self._monitor.lost(t_ns, event.text)
            case PortBack():
                self._monitor.back(t_ns, event.text)
            case _:
                if self._listening is not None:
                    self._monitor.timing = self._listening.line.timing  # the rate is known now
                self._monitor.remark(t_ns, event.text)

    def _show(self, happening: Happening) -> None:
        if self._json:
            output.json_line(happening.as_dict(self._monitor.begun_ns))
        elif self._view is None and not happening.routine:
            event_line(happening, self._monitor.begun_ns)
