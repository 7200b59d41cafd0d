"""``bus.record()``: process data of each round into files. The bus only appends to a queue; a thread writes."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dpstack.api.bus.parts import BusBase
from dpstack.api.recording.record_file import RecordFile
from dpstack.api.recording.rotation import Rotation
from dpstack.api.recording.writer_thread import WriterThread
from dpstack.api.slave.slave import Slave
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import ModeChanged, SlaveDiagnosis, SlaveState, SlaveStateChanged
from dpstack.dpv1.master.alarm_orders import AlarmRaised
from dpstack.drivers.futures import wait_through_cancellation
from dpstack.drivers.snapshots import View
from dpstack.errors import UsageError
from dpstack.plant.quality import Quality
from dpstack.record.columns import Judged, Layout, RecordedSlave
from dpstack.record.rows import Sample
from dpstack.trace import Event, Severity
from dpstack.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from dpstack.api.ppi.polling import CpuPolling
    from dpstack.api.slave.drive import Drive

#: rounds that wait for the disk at most: 20 s of a cycle of 1 ms
MOST_WAITING: Final = 20_000
#: without a round for this long the values are not valid; then a row a second
_SILENT_NS: Final = 500 * NS_PER_MS
_LOOK_S: Final = 0.25
_ROW_NS: Final = NS_PER_S
#: a drive whose inputs and outputs stay the same is read this often
_DRIVE_NS: Final = 50 * NS_PER_MS
#: seconds to wait at the end for a disk that does not answer
_PATIENCE_S: Final = 5.0
_EXCHANGING: Final = SlaveState.DATA_EXCHANGE.value


class BusRecording:
    """A recording of a running bus, made by ``bus.record()``. It ends with :meth:`stop`, its block, or the bus."""

    #: lines about troubles, the latest last; those before the end of the bus are events, too
    troubles: list[str]

    def __init__(
        self,
        path: str | Path,
        *,
        on_change: bool = False,
        dead_band: float = 0.0,
        rotate: str | None = None,
        quality: bool = False,
    ) -> None:
        """Makes the file; :meth:`start` begins. Raises UsageError as ``bus.record()`` does."""
        if not 0 <= dead_band < float("inf"):
            raise UsageError(f"dead_band = {dead_band}; give a number of 0 or more, in the unit of the values")
        rotation = Rotation() if rotate is None else Rotation.parse(rotate)
        self._file = RecordFile(path, rotation, dead_band, self._tell)
        self._on_change = on_change
        self._quality = quality
        self._bus: BusBase | None = None
        self._view: View | None = None
        self._started_ns = 0
        #: the mode of the master, as its events have it
        self.mode = Mode.OFFLINE
        self._loop: asyncio.AbstractEventLoop | None = None
        self._writer: WriterThread[Sample] | None = None
        self._sources: list[_Source] = []
        self._cpus: list[_CpuSource] = []
        self._layout = Layout(())
        self._published = 0
        #: slaves that have announced a diagnosis, and those with news of theirs
        self._announced: frozenset[int] = frozenset()
        self._news: set[int] = set()
        self._missed = 0  # rounds that this process did not see
        self._lost = 0  # rounds that are missing before the next sample
        self._last_ns = 0  # the last sample, bus time
        self._is_silent = False
        self._watching = contextlib.ExitStack()
        self._timer: asyncio.TimerHandle | None = None
        self._stopping: asyncio.Task[None] | None = None
        self._hurried = False
        #: lines about troubles, the latest last; those before the end are events, too
        self.troubles = []

    async def __aenter__(self) -> BusRecording:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()

    @property
    def path(self) -> Path:
        """The path as given; of a rotated recording the name of the set."""
        return self._file.path

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files, the present one last."""
        return tuple(self._file.paths)

    @property
    def rows(self) -> int:
        """Rows in the files. The thread writes five times a second."""
        return self._file.rows_written

    @property
    def lost(self) -> int:
        """Rounds that are missing: this computer or its disk was too slow, or the disk was full."""
        return self._missed + self._file.rows_lost + (0 if self._writer is None else self._writer.lost)

    @property
    def is_over(self) -> bool:
        """True once :meth:`stop` has done all that it can."""
        return self._stopping is not None and self._stopping.done()

    def as_dict(self) -> dict[str, object]:
        """As in the summary of ``run --json``."""
        return {"files": [str(path) for path in self.paths], "rows": self.rows, "lost": self.lost}

    # --- from beginning to end ---
    def start(self, bus: BusBase) -> None:
        """Begin to record ``bus``. Raises UsageError for one that is not open, or read-only."""
        bus.check_open()
        if bus.view.read_only:
            raise UsageError("a read-only bus reads no process data: nothing can be recorded; leave read_only out")
        self._bus = bus
        self._view = bus.view
        self._started_ns = bus.started_ns
        self.mode = bus.mode
        self._loop = asyncio.get_running_loop()
        self._writer = WriterThread("recording", self._file, MOST_WAITING)
        self._set_layout(bus)
        cycle = bus.view.cycle
        self._published = 0 if cycle is None else cycle.published
        self._watching.enter_context(bus.rounds.watched(self._on_round))
        self._last_ns = bus.runtime.now()
        self._timer = self._loop.call_later(_LOOK_S, self._look)

    async def stop(self) -> None:
        """End the recording: the rest is written and the file closed. May be repeated.

        Waits for the disk, but at most 5 s for one that does not answer.
        """
        if self._bus is None:
            self.discard()
            return
        if self._stopping is None:
            self._stopping = asyncio.create_task(self._stop())
        await wait_through_cancellation(self._stopping)
        self._stopping.result()

    async def _stop(self) -> None:
        self._watching.close()
        if self._timer is not None:
            self._timer.cancel()
        writer = self._writer
        assert writer is not None
        writer.finish()
        loop, steps, idle = asyncio.get_running_loop(), -1, 0.0
        while not await loop.run_in_executor(None, writer.ended, _LOOK_S):
            idle = 0.0 if self._file.converting or writer.steps != steps else idle + _LOOK_S
            steps = writer.steps
            if idle >= _PATIENCE_S or self._hurried:
                text = "is still being written" if self._hurried else "the disk does not answer"
                self._trouble(f"{self._file.path}: {text}; the last rows may be missing")
                return

    def discard(self) -> None:
        """Remove the file of a recording that was never started."""
        if self._bus is None:
            self._file.close(0)

    def hurry(self) -> None:
        """Do not wait for the disk at the end."""
        self._hurried = True

    # --- samples ---
    def _set_layout(self, bus: BusBase) -> None:
        # those of a slave with several have their values among its named inputs
        drives = {drive.address: drive for drive in bus.drives if not drive.slave.config.drives}
        self._sources = [_Source(slave, drives.get(slave.address), quality=self._quality) for slave in bus.slaves]
        self._cpus = [_CpuSource(polling, quality=self._quality) for polling in bus.cpus.values()]
        started = time.time_ns() - (bus.runtime.now() - bus.started_ns)
        self._layout = Layout(
            (*(source.described for source in self._sources), *(source.described for source in self._cpus)),
            round(started / NS_PER_S, 3),
            bus.config.source.name if bus.config.source.file is not None else None,
            self._on_change,
            {
                "port": bus.runtime.port_name,
                "baud": bus.params.baud,
                "driver": bus.driver,
                "address": bus.params.address,
            },
        )

    def _on_round(self) -> None:
        bus, view = self._bus, self._view
        assert bus is not None
        assert view is not None
        data = view.cycle
        if data is None or data.published == self._published:
            return  # no slave had its turn in this round
        if self._published and data.published - self._published > 1:
            missed = data.published - self._published - 1
            self._missed += missed
            self._lost += missed
        self._published = data.published
        self._is_silent = False
        if data.announced != self._announced:
            self._news |= data.announced ^ self._announced
            self._announced = data.announced
        if self._news:
            for source in self._sources:
                if source.address in self._news and not source.look(source.address in data.announced):
                    self._news.discard(source.address)
            self._news &= data.inputs.keys()
        self._take(view, data.inputs, data.t_ns, bus.runtime.now())

    def _take(self, view: View, inputs: Mapping[int, bytes], t_ns: int, now: int) -> None:
        wall_ns = time.time_ns() - max(0, now - t_ns)
        self._last_ns = now
        mode = self.mode
        operating = self.mode is Mode.OPERATE
        sources: list[object] = []
        for source in self._sources:
            octets = inputs.get(source.address)
            if octets is None:
                source.add_invalid(sources)
                continue
            sources.append(_EXCHANGING)
            if source.has_inputs:
                words = source.words[0]
                given: bytes | Judged | None = octets if words is None else Judged(octets, words)
                sources += (given, given) if source.has_quality else (given,)
            if source.has_outputs or source.drive is not None:
                held = view.image(source.slave.setup).outputs
                if source.has_outputs:
                    sent, words = held if operating else source.outputs_in(mode, held), source.words[1]
                    given = sent if sent is None or words is None else Judged(sent, words)
                    sources += (given, given) if source.has_quality else (given,)
                if source.drive is not None:
                    sources.append(source.quantities(source.drive, (octets, held), now))
        for cpu in self._cpus:
            cpu.add(sources, now)
        assert self._writer is not None
        sample = Sample(self._layout, t_ns - self._started_ns, wall_ns, tuple(sources), self._lost)
        self._lost = 0 if self._writer.put(sample) else self._lost + 1

    def event(self, event: Event) -> None:
        """Take an event of the bus: another mode, or news of a slave's diagnosis."""
        if isinstance(event, ModeChanged):
            self.mode = event.mode
        elif isinstance(event, (SlaveDiagnosis, SlaveStateChanged, AlarmRaised)):
            self._news.add(event.address)

    def polled(self) -> None:
        """An S7-200 has given new values: a row, unless the rounds of the bus make rows anyway."""
        if self._bus is not None and self._stopping is None and (self._is_silent or not self._sources):
            now = self._bus.runtime.now()
            self._take(self._bus.view, {}, now, now)

    def _look(self) -> None:
        """Now and then: other slaves, no rounds, a thread that ended."""
        bus, loop, writer = self._bus, self._loop, self._writer
        assert bus is not None
        assert loop is not None
        assert writer is not None
        if writer.failure is not None:
            self._trouble(f"{self._file.path}: the recording ended early ({writer.failure!r}); please report it")
            return
        if tuple(source.slave.config for source in self._sources) != tuple(slave.config for slave in bus.slaves):
            self._set_layout(bus)
        now = bus.runtime.now()
        if now - self._last_ns > (_ROW_NS if self._is_silent else _SILENT_NS):
            self._take(bus.view, {}, now, now)
            self._is_silent = True
        self._timer = loop.call_later(_LOOK_S, self._look)

    # --- troubles ---
    def _tell(self, text: str) -> None:
        """From the writer thread, or before the start."""
        if self._loop is None:
            self._trouble(text)
        else:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._trouble, text)

    def _trouble(self, text: str) -> None:
        self.troubles.append(text)
        if self._bus is not None and self._stopping is None:
            self._bus.notice("record", text, Severity.WARNING)


class _CpuSource:
    """One S7-200 of a recording."""

    def __init__(self, polling: CpuPolling, *, quality: bool) -> None:
        config = polling.config
        self._polling = polling
        self._has_quality = quality
        self.described = RecordedSlave(
            config.address, config.name, config.input_fields, config.output_fields, False, quality
        )

    def add(self, sources: list[object], now: int) -> None:
        """Append its state, and its values if they are those of this moment."""
        polling = self._polling
        sources.append(polling.state.value)
        of_all = polling.judge_all(polling.described(now))
        for fields in filter(None, polling.config.fields):
            given = None
            if of_all.quality is Quality.GOOD:
                words = tuple(polling.judge(name, of_all).quality.value for name in fields)
                given = Judged(polling.image, words, tuple(name in polling.refused for name in fields))
            sources += (given, given) if self._has_quality else (given,)


class _Source:
    """One slave of a recording."""

    def __init__(self, slave: Slave, drive: Drive | None, *, quality: bool = False) -> None:
        self.slave = slave
        self.drive = drive
        self.address = slave.address
        config = slave.config
        self.has_inputs = bool(config.input_fields)
        self.has_outputs = bool(config.output_fields)
        self.described = RecordedSlave(
            slave.address, slave.name, config.input_fields, config.output_fields, drive is not None, quality
        )
        self.has_quality = quality
        #: the words of quality by the slave's diagnosis, of inputs and of outputs; None: all are good
        self.words: list[tuple[str, ...] | None] = [None, None]
        self._status: tuple[object, ...] | None = None
        self._key: object = None
        self._before: object = None
        self._read_ns = 0

    def add_invalid(self, sources: list[object]) -> None:
        """Append the state of a slave that is not in data exchange; nothing else of it is valid."""
        sources.append(self.slave.state.value)
        of_values = self.has_inputs + self.has_outputs
        sources.extend((None,) * (of_values * (2 if self.has_quality else 1) + (self.drive is not None)))

    def look(self, announced: bool) -> bool:
        """Judge by the diagnosis anew. ``announced``: a diagnosis that is not read yet. Returns whether to look again
        in the next round: a bus process has read one that has not come yet."""
        slave = self.slave
        image, judged = slave.image, slave.process_quality.by_diagnosis(announced=announced)
        for side, (_, fields) in enumerate(slave.config.fields):
            doubted = any(name in judged for name in fields)
            words = (judged[name].quality.value if name in judged else Quality.GOOD.value for name in fields)
            self.words[side] = tuple(words) if doubted else None
        return announced or image.diagnoses > slave.snapshot.diagnoses

    def outputs_in(self, mode: Mode, held: bytes) -> bytes | None:
        """The outputs on the wire in another mode than Operate."""
        return bytes(len(held)) if mode is Mode.CLEAR and not self.slave.setup.fail_safe else None

    def quantities(self, drive: Drive, key: object, now: int) -> tuple[object, ...]:
        """The status of the drive. Its plugin sees inputs one round after they came."""
        if self._status is None or key != self._key or key != self._before or now - self._read_ns > _DRIVE_NS:
            status = drive.status
            self._status = (
                *(str(status.state), status.setpoint, status.speed, status.frequency_hz),
                *(status.current, status.torque, status.fault, status.warning),
            )
            self._read_ns = now
        self._before, self._key = self._key, key
        return self._status
