"""The monitor at a port: listens, shows the bus as it is, and judges it at the end."""

from __future__ import annotations

import argparse
import asyncio
from datetime import UTC, datetime
from time import monotonic_ns, time_ns
from typing import Final

from dpstack.api.bus.events_json import PortBack, PortLost
from dpstack.api.config.bus import AUTO
from dpstack.api.listen.listening import PORT_LOSSES, ListenedLine, Listening, OctetsLost, keep_listening
from dpstack.api.listen.report_file import SIMULATED, ReportFile, port_lines
from dpstack.capture.timing import ADAPTER
from dpstack.cli.listening.monitor_view import LiveView, event_line, show_summary, write_report
from dpstack.cli.terminal import output
from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal
from dpstack.errors import PortError
from dpstack.monitor.monitor import Happening, Monitor
from dpstack.monitor.verdict import CRITICAL
from dpstack.trace import Event
from dpstack.units import NS_PER_S, baud_text

_TICK_S: Final = 0.5
#: octets of a tap or an adapter are no later
_LATE_NS: Final = NS_PER_S
_CONVERTER: Final = (
    "nothing is sent, but opening a port may switch RTS for an instant: a converter that takes its direction from RTS "
    "drives the bus for that time"
)


class LiveMonitor:
    """Judges the bus at a port."""

    def __init__(self, args: argparse.Namespace, monitor: Monitor, report: ReportFile | None) -> None:
        self._args = args
        self._report = report
        self._add = monitor.add if report is None else report.add
        self._json: bool = args.json
        self._monitor = monitor
        self._line: ListenedLine | None = None
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
            write_report(self._report, summary, self._about(self._line), json=self._json)
        if self._failure is not None:
            raise self._failure
        return int(summary["verdict"] == CRITICAL)

    def _about(self, line: ListenedLine) -> dict[str, object]:
        """The line for the report."""
        if line.program is not None:
            about = {"Port": line.port, "Listened": f"through the dpstack {line.program} that holds the port"}
            return {**about, "Simulated": SIMULATED} if line.exact or line.program == "segment" else {**about}
        return {**port_lines(line.port), "Listened": f"on the port itself, which wrote nothing; {_CONVERTER}"}

    async def _work(self) -> None:
        """Listen until the time is over. Raises PortError if the port cannot be listened to any more."""
        listening = asyncio.ensure_future(self._listen())
        watching = [asyncio.ensure_future(self._tick())]
        if self._view is not None:
            watching.append(asyncio.ensure_future(self._watch(self._view)))
        if self._args.seconds is not None:
            watching.append(asyncio.ensure_future(self._listened_for(self._args.seconds)))
        try:
            done, _ = await asyncio.wait([listening, *watching], return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            for task in (listening, *watching):
                task.cancel()
            await asyncio.gather(listening, *watching, return_exceptions=True)

    async def _listened_for(self, seconds: float) -> None:
        """Wait until the time is over. It begins when the port is open."""
        await self._begun.wait()
        await asyncio.sleep(seconds)

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
        """Report octets that the port has lost since the last look."""
        if self._listening is None:
            return
        before, self._port_damage = self._port_damage, self._listening.damage()
        lost = sum(self._port_damage.get(cause, 0) - before.get(cause, 0) for cause in PORT_LOSSES)
        if lost > 0:
            text = f"this computer read the port too late: {lost} octets were lost within the last {_TICK_S:g} s"
            self._monitor.gap(time_ns(), text)

    async def _listen(self) -> None:
        """Listen to the port; if a program that held it ends, wait until one is there again."""
        baud = None if self._args.baud == AUTO else self._args.baud
        await keep_listening(
            lambda own: Listening(self._args.port, baud, self._add, self._on_event, own=own),
            self._begin,
            self._interrupt,
        )

    def _interrupt(self, reason: str) -> None:
        self._listening = None
        self._monitor.lost(time_ns(), f"{reason}; waiting until a program holds the port again")

    def _begin(self, listening: Listening) -> None:
        self._listening, line = listening, listening.line
        again, self._line = self._line is not None, line
        self._monitor.timing = line.timing
        if again:
            self._monitor.back(time_ns(), f"the {line.program} on {line.port} is back")
            return
        self._monitor.begin(time_ns())
        if self._json:
            now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
            start = {"event": "start", "time": now, "port": line.port, "baud": line.baud, "source": line.source}
            output.json_line({**start, "program": line.program})
        elif self._view is None:
            through = f" through the {line.program} that holds it" if line.program else ""
            rate = "its rate is searched" if line.baud is None else baud_text(line.baud)
            output.line(f"listening on {line.port}{through}, {rate}; Ctrl-C ends", "bold")
        if line.program is None and line.source == ADAPTER:
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
