"""The file of an acceptance report, made before listening begins, written at the end; the report of a running bus."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import to_builtins

from dpstack import __version__
from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.live import slave_plant
from dpstack.api.bus.picture import picture_of
from dpstack.api.config.config import Config
from dpstack.api.control.tap_feed import TapFeed
from dpstack.api.files import close_written, open_new
from dpstack.api.listen.inventory import Inventory
from dpstack.api.listen.own_tap import OwnTap
from dpstack.api.listen.plant_files import load_devices
from dpstack.capture.timing import TAP, LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.monitor.exchanges import Batch
from dpstack.monitor.monitor import Monitor
from dpstack.monitor.report import Report
from dpstack.monitor.run_sections import RunSlave
from dpstack.monitor.schedule import ScheduleRecorder
from dpstack.ports.adapters import list_adapters
from dpstack.ports.base import VIRTUAL
from dpstack.trace import Event

if TYPE_CHECKING:
    from dpstack.api.slave.slave import Slave
    from dpstack.plant.items import SlaveValues

#: a remark of a report
SIMULATED: Final = "this bus was simulated by dpstack: there was no cable and no device"


class ReportFile:
    """The report of ``monitor`` in the file ``name``; give it each transmission with :meth:`add`, after the monitor.

    Entering makes the file. It raises UsageError if there is a file of that name already, unless it is empty, or
    if it cannot be made. A file in which nothing was written is removed at the end.
    """

    def __init__(self, name: str, monitor: Monitor) -> None:
        self.name = name
        self._path = Path(name)
        self._monitor = monitor
        self._recorder = ScheduleRecorder()
        self._fd = -1

    def __enter__(self) -> ReportFile:
        self._fd = open_new(self._path)
        return self

    def __exit__(self, *_: object) -> None:
        fd, self._fd = self._fd, -1
        close_written(fd, self._path)

    def add(self, one: Transmission) -> None:
        """Count ``one``, and record it if it belongs to a rotation that the report may show."""
        self._monitor.add(one)
        self._recorder.add(one)

    def add_all(self, transmissions: Batch) -> None:
        """The same for many."""
        self._monitor.add_all(transmissions)
        for one in transmissions:
            self._recorder.add(one)

    def write(
        self,
        summary: Mapping[str, object],
        line: Mapping[str, object],
        parameters: Mapping[str, object] | None = None,
        remarks: Sequence[str] = (),
        slaves: Sequence[RunSlave] = (),
    ) -> str | None:
        """Write the report of ``summary``; the others as :class:`Report` has them.

        Returns None, or one line that says why it could not be written: nothing is in the file then.
        """
        monitor = self._monitor
        report = Report(
            summary=summary,
            counters=monitor.counters,
            begun_ns=monitor.begun_ns,
            version=__version__,
            made=datetime.now(UTC),
            changes=list(monitor.time_line),
            changes_left_out=monitor.left_out,
            rotation=self._recorder.typical(),
            line=line,
            parameters=parameters or {},
            remarks=remarks,
            slaves=slaves,
        )
        octets = memoryview(report.html().encode("utf-8", "backslashreplace"))
        try:
            while octets:
                octets = octets[os.write(self._fd, octets) :]
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, 0)
            return f"{self.name}: the report cannot be written ({error.strerror or error}); make room there"
        return None


class RunReport:
    """The report of a bus that this program runs: its own tap, counted in short steps beside the bus.

    Entering makes the file, as :class:`ReportFile` does. Then :meth:`begin`, :meth:`opened` once the bus is open,
    :meth:`look` and :meth:`rest` at the end of the run, :meth:`end`, :meth:`write`.
    """

    def __init__(self, name: str, config: Config) -> None:
        self._monitor = Monitor(LineTiming(TAP, None), devices=load_devices(config, None))
        self._file = ReportFile(name, self._monitor)
        self._tap: OwnTap | None = None
        self._bus: Bus | None = None
        self._clock_ns = time.time_ns() - time.monotonic_ns()
        self._ended_ns = 0
        self._inventory: Inventory | None = None
        self._pictures: list[tuple[Slave, SlaveValues]] = []

    def __enter__(self) -> RunReport:
        self._file.__enter__()
        return self

    def __exit__(self, *why: object) -> None:
        self.end()
        self._file.__exit__(*why)

    def begin(self, bus: Bus, feed: TapFeed) -> None:
        """Listen to ``bus`` through ``feed``; at any time, also before the bus is open."""
        self._bus = bus
        self._tap = OwnTap(feed, bus.config.port, self._file.add, self._on_event)
        self._tap.begin()

    def opened(self) -> None:
        """The bus is open: its slaves are asked for their I&M0."""
        assert self._bus is not None
        self._inventory = Inventory(self._bus)
        self._inventory.begin()

    def look(self) -> None:
        """Take state and values of all slaves: the run is at its end, and the bus is not."""
        assert self._bus is not None
        core = core_of(self._bus)
        self._pictures = [(slave, picture_of(core, slave)) for slave in self._bus.slaves]

    async def rest(self) -> None:
        """Wait for the I&M0 of slaves that were not asked yet, a bounded time."""
        assert self._inventory is not None
        await self._inventory.rest()

    def end(self) -> None:
        """Listen no longer: the ordered end of the bus is no part of the report."""
        if self._tap is not None and not self._ended_ns:
            self._ended_ns = time.time_ns()
            self._tap.end()
            if self._inventory is not None:
                self._inventory.end()

    def write(self) -> str | None:
        """Count what still waits, and write the report. Returns why that failed, else None."""
        tap, bus = self._tap, self._bus
        assert tap is not None
        assert bus is not None
        tap.rest()
        self._monitor.timing = tap.timing
        lines = {
            **port_lines(core_of(bus).runtime.port_name),
            "Listened": f"through the dpstack run that is master {bus.params.address} of this bus",
            "Driver": bus.driver,
        }
        remarks = [SIMULATED] if bus.config.port == VIRTUAL else []
        if tap.lost:
            remarks.append(
                f"{tap.lost} pieces of octets were lost, as this computer could not keep up: counts are too low"
            )
        if not core_of(bus).runtime.paced:
            remarks.append("no wire gave the octets their time here: the times are this computer's, not a bus's")
        parameters = bus.plan.as_dict()["parameters"]
        assert isinstance(parameters, dict)
        return self._file.write(self._monitor.summary(self._ended_ns), lines, parameters, remarks, self._slaves())

    def _slaves(self) -> list[RunSlave]:
        inventory, bus = self._inventory, self._bus
        if inventory is None or bus is None:
            return []
        return [
            RunSlave(
                address=slave.address,
                name=slave.name,
                plant=slave_plant(core_of(bus), slave),
                quality=None if bus.config.bus.read_only else to_builtins(values.quality),
                doubts=to_builtins(values.doubts or ()),
                im0=inventory.im0(slave),
                no_im=inventory.why_not(slave),
            )
            for slave, values in self._pictures
        ]

    def _on_event(self, event: Event) -> None:
        self._monitor.gap(event.t_ns + self._clock_ns, event.text)


def port_lines(port: str) -> dict[str, object]:
    """Port and adapter for the report, as far as the operating system names it."""
    lines: dict[str, object] = {"Port": port}
    try:
        path = os.path.realpath(port)
        adapters = [one for one in list_adapters() if os.path.realpath(one.path) == path]
    except OSError:
        adapters = []
    if adapters:
        found = adapters[0]
        lines["Adapter"] = " ".join(filter(None, (found.chip, f"(driver {found.driver})" if found.driver else "")))
        if found.by_id:
            lines["Lasting path of the adapter"] = found.by_id
    return lines
