"""The monitor at a port: listens, shows the bus as it is, and judges it at the end."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Coroutine
from time import monotonic_ns, time_ns
from typing import Any, Final

from dpstack.api.bus.events_json import PortBack, PortLost
from dpstack.api.listen.listening import ListenedLine, OctetsLost
from dpstack.api.listen.report_file import SIMULATED, ReportFile, port_lines
from dpstack.capture.listener import OnTransmission
from dpstack.capture.timing import ADAPTER
from dpstack.cli.listening.monitor_view import LiveView, event_line, show_summary, write_report
from dpstack.cli.listening.port_listener import PortListener, start_json, start_text
from dpstack.cli.terminal import output
from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal, first_of
from dpstack.errors import PortError
from dpstack.monitor.monitor import Happening, Monitor
from dpstack.monitor.verdict import CRITICAL
from dpstack.trace import Event
from dpstack.units import NS_PER_S

_TICK_S: Final = 0.5
#: octets of a tap or an adapter are no later
_LATE_NS: Final = NS_PER_S
CONVERTER: Final = (
    "nothing is sent, but opening a port may switch RTS for an instant: a converter that takes its direction from RTS "
    "drives the bus for that time"
)


class MonitoredPort(PortListener):
    """Has ``monitor`` judge the bus at a port; ``add`` takes the transmissions. It shows nothing."""

    def __init__(self, args: argparse.Namespace, monitor: Monitor, add: OnTransmission) -> None:
        super().__init__(args)
        self._add = add
        self._monitor = monitor
        self._begun = asyncio.Event()
        self._clock_ns = time_ns() - monotonic_ns()

    @property
    def line(self) -> ListenedLine | None:
        """The line; None if it could not be listened to so far."""
        return self._line if self._listening is None else self._listening.line

    async def listen(self, seconds: float | None) -> None:
        """Listen until the time is over (None: without end), which begins when the port is open. Raises PortError if
        the port cannot be listened to any more, UsageError for a port without a wire."""
        await first_of(*self._works(seconds))

    def _works(self, seconds: float | None) -> list[Coroutine[Any, Any, None]]:
        works = [self._listen(self._add), self._tick()]
        return works if seconds is None else [*works, self._listened_for(seconds)]

    async def _listened_for(self, seconds: float) -> None:
        await self._begun.wait()
        await asyncio.sleep(seconds)

    async def _tick(self) -> None:
        """Let the monitor know that time passes, also on a silent line."""
        while True:
            await asyncio.sleep(_TICK_S)
            self._monitor.tick(time_ns() - _LATE_NS)
            self._look_at_port(_TICK_S)

    def _lost(self, text: str) -> None:
        self._monitor.gap(time_ns(), text)

    def _interrupted(self, reason: str) -> None:
        self._monitor.lost(time_ns(), f"{reason}; waiting until a program holds the port again")

    def _is_back(self, line: ListenedLine, text: str) -> None:
        self._monitor.timing = line.timing
        self._monitor.back(time_ns(), text)

    def _started(self, line: ListenedLine) -> None:
        self._monitor.timing = line.timing
        self._monitor.begin(time_ns())
        self._begun.set()

    def _on_event(self, event: Event) -> None:
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


class LiveMonitor(MonitoredPort):
    """The command at a port: shows the bus while it listens."""

    def __init__(self, args: argparse.Namespace, monitor: Monitor, report: ReportFile | None) -> None:
        super().__init__(args, monitor, monitor.add if report is None else report.add)
        self._report = report
        self._view = LiveView(monitor, args.port) if output.redraws() and not args.json else None
        self._failure: PortError | None = None
        monitor.on_event = self._show

    async def run(self) -> int:
        with StopSignal() as stop:
            try:
                await stop.or_done(self.listen(self._args.seconds))
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
        return {**port_lines(line.port), "Listened": f"on the port itself, which wrote nothing; {CONVERTER}"}

    def _works(self, seconds: float | None) -> list[Coroutine[Any, Any, None]]:
        works = super()._works(seconds)
        return works if self._view is None else [*works, self._watch(self._view)]

    async def _watch(self, view: LiveView) -> None:
        await self._begun.wait()  # what stands on the screen before stays readable
        await view.watch()

    def _started(self, line: ListenedLine) -> None:
        super()._started(line)
        if self._json:
            output.json_line(start_json(line))
        elif self._view is None:
            output.line(f"{start_text(line, 'its rate is searched')}; Ctrl-C ends", "bold")
        if line.program is None and line.source == ADAPTER:
            output.warn(CONVERTER)

    def _show(self, happening: Happening) -> None:
        if self._json:
            output.json_line(happening.as_dict(self._monitor.begun_ns))
        elif self._view is None and not happening.routine:
            event_line(happening, self._monitor.begun_ns)
