"""``bus.live()``: plant, snapshots and events of a bus as one stream (:mod:`dpstack.plant.state`).

Nothing is added to the work of the bus a telegram or a cycle: while there are readers, a task reads the snapshots that
the bus has anyway, a few slaves at a time, with pauses in which the bus goes on.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from time import time
from typing import TYPE_CHECKING, Any, Final

from msgspec import convert, to_builtins

from dpstack.api.bus.events_json import event_json
from dpstack.api.bus.parts import BusBase
from dpstack.api.bus.picture import CpuPicture, Picture, SlavePicture, clock_of
from dpstack.api.bus.statistics import bus_figures, clear_since
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave.slave import Slave
from dpstack.api.streams import when_dropped
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState, SlaveStateChanged
from dpstack.dp.process_data import Field
from dpstack.dp.slot_map import Direction
from dpstack.drivers.snapshots import Counters
from dpstack.errors import UsageError
from dpstack.plant.items import PPI, Item, SlavePlant, all_of
from dpstack.plant.nodes import Described, slave_of
from dpstack.plant.pending import Pending
from dpstack.plant.state import end_of
from dpstack.stats import Histogram
from dpstack.text import iso_time
from dpstack.trace import Event
from dpstack.units import NS_PER_US, ns_to_s

if TYPE_CHECKING:
    from dpstack.api.config.config import Config
    from dpstack.api.config.cpu import CpuConfig
    from dpstack.profile import DriveProfile

#: slaves in one step of a snapshot, about 0.2 ms, and their named values, of which one slave may have more; and the
#: pause between two steps
_STEP: Final = 8
_STEP_VALUES: Final = 500
_PAUSE_S: Final = 0.002
#: a snapshot takes one in this many parts of the time at most: that of 125 slaves, or on a busy computer, comes later,
#: by this many s at most
_SHARE: Final = 25
_LONGEST_S: Final = 0.5
#: counters and rotation times of the bus are read no more often
_FIGURES_S: Final = 1.0
#: shortest interval of snapshots in s
_SHORTEST_S: Final = 0.02
#: classes of the rotation times in a snapshot, at most
_CLASSES: Final = 40
#: upper limits in us of the classes of ``histograms``, which stay the same as long as the bus runs
LIMITS_US: Final = tuple(step * 10**power for power in range(1, 7) for step in (1, 2, 5))
_LIMITS_NS: Final = tuple(limit * NS_PER_US for limit in LIMITS_US)


class LiveItems:
    """The items that wait for one reader. The feed holds them, and so keeps a task alive that waits for the next."""

    def __init__(self, interval: float) -> None:
        self.interval = interval
        self._pending = Pending()
        self._more = asyncio.Event()
        self._due = False
        self.ended = False

    def put(self, item: Item) -> None:
        self._pending.put(item)
        if "snapshot" not in item:
            self._more.set()

    def wake(self) -> None:
        """The snapshot of this moment is complete: hand it over."""
        if self._pending.waiting:
            self._due = True
            self._more.set()

    def take(self) -> Item | None:
        """The next item; None without one at this moment."""
        item = self._pending.take(snapshots=self._due)
        if item is not None and "snapshot" in item:
            self._due = False
        self.ended = self.ended or (item is not None and "end" in item)
        return item

    async def wait(self) -> None:
        """Wait until :meth:`take` has an item, or the stream was closed."""
        while not self.ended and not (self._pending.urgent or (self._due and self._pending.waiting)):
            self._more.clear()
            await self._more.wait()

    def end(self) -> None:
        self.ended = True
        self._more.set()


class LiveStream(AsyncIterator[Item]):
    """The items for one reader, an async iterator. Ends after the item ``end``, or when the program leaves it.

    A reader that is late gets snapshots merged into one, and the last 1000 events; ``lost`` counts the others.
    """

    def __init__(self, items: LiveItems, leave: Callable[[LiveItems], None] | None) -> None:
        self._items = items
        self._leave = leave
        # a program may leave an ``async for`` without close()
        self._finaliser = None if leave is None else when_dropped(self, leave, items)

    def take(self) -> Item | None:
        """The next item; None without one at this moment."""
        return self._items.take()

    async def wait(self) -> None:
        """Wait until :meth:`take` has an item, or the stream was closed."""
        await self._items.wait()

    async def __anext__(self) -> Item:
        while not self._items.ended:
            item = self.take()
            if item is not None:
                return item
            await self.wait()
        raise StopAsyncIteration

    def close(self) -> None:
        """Stop receiving items. May be repeated."""
        self._items.end()
        if self._leave is not None and self._finaliser is not None and self._finaliser.detach() is not None:
            self._leave(self._items)


class LiveFeed:
    """The stream of ``bus`` for all its readers. Without readers it costs nothing."""

    def __init__(self, bus: BusBase) -> None:
        self._bus = bus
        self._readers: dict[LiveItems, float] = {}  # with the time of its next snapshot
        self._task: asyncio.Task[None] | None = None
        self._end: Item | None = None
        #: time of the start of the bus in s since 1970, by the clock at the first reader: it never jumps afterwards
        self._started = 0.0
        self._plant: Item | None = None
        self._known: tuple[object, ...] = ()
        #: the values of the bus at this moment
        self._now: dict[str, Any] = {}
        self._slaves: dict[int, Picture] = {}
        self._figures_at = 0.0
        #: time of the loop that the present snapshot has taken, in s
        self._busy = 0.0

    def join(self, interval: float) -> LiveStream:
        """A new reader. Call it in the event loop of the bus."""
        reader = LiveItems(interval)
        self._describe()  # a bus that has ended does not do this any more
        if self._plant is not None:
            reader.put(self._plant)
            slaves = {str(address): all_of(picture.values) for address, picture in self._slaves.items()}
            reader.put(self._snapshot({"bus": dict(self._now), "slaves": slaves}, whole=True))
            if self._now:  # else the first round makes it whole, and wakes the reader
                reader.wake()
        for event in self._bus.past_events():
            self._put_event(event, [reader])
        if self._end is not None:
            reader.put(self._end)
            return LiveStream(reader, None)
        self._readers[reader] = 0.0
        if self._task is None:
            self._bus.listen_to_events(self._on_event)
            self._task = asyncio.get_running_loop().create_task(self._run())
        return LiveStream(reader, self.leave)

    def leave(self, reader: LiveItems) -> None:
        self._readers.pop(reader, None)
        if not self._readers:
            self._stop()
            # a later reader must not get an old snapshot
            self._plant, self._now = None, {}

    def end(self, why: str, *, failed: bool) -> None:
        """The bus has ended, by a fault if ``failed``: hand out its last snapshot, and the end."""
        if self._end is not None:
            return
        self._end = end_of(why, failed=failed)
        if self._readers and self._plant is not None:
            self._hand_out(self._slave_changes(self._bus.slaves))
            if self._bus.cpus:
                self._hand_out(self._cpu_changes())
            self._figures_at = -math.inf
            self._hand_out(self._bus_changes())
        for reader in list(self._readers):
            reader.put(self._end)
        self._readers.clear()
        self._stop()

    def _stop(self) -> None:
        task, self._task = self._task, None
        if task is not None:
            self._bus.listen_to_events(None)
            task.cancel()

    # --- items ----------------------------------------------------------------------------------------------------

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            begun, self._busy = loop.time(), 0.0
            with contextlib.suppress(UsageError):  # the bus was closed, or a slave removed, during the pauses
                await self._round()
            now = loop.time()
            for reader, due in list(self._readers.items()):
                if now >= due:
                    self._readers[reader] = max(now, due + reader.interval)
                    reader.wake()
            shortest = min((reader.interval for reader in self._readers), default=_SHORTEST_S)
            period = max(shortest, min(_SHARE * self._busy, _LONGEST_S))
            await asyncio.sleep(max(_PAUSE_S, begun + period - loop.time()))

    async def _round(self) -> None:
        """One snapshot, a few slaves at a time."""
        self._describe()
        if self._bus.searching:
            self._hand_out({"bus": {}, "slaves": {}})  # a sign of life
            return
        loop, slaves = asyncio.get_running_loop(), self._bus.slaves
        since = loop.time()
        for step in _steps(slaves):
            if step[0] is not slaves[0]:
                self._busy += loop.time() - since
                await asyncio.sleep(_PAUSE_S)
                since = loop.time()
            self._hand_out(self._slave_changes(step))
        if self._bus.cpus:
            self._hand_out(self._cpu_changes())
        self._hand_out(self._bus_changes())
        self._busy += loop.time() - since

    def _describe(self) -> None:
        """Hand out the plant if it is new, with an empty whole snapshot, which the rest of this round fills."""
        bus = self._bus
        # a bus that searches its rate has neither slaves nor a time yet, one that is not open no time
        slaves = tuple((slave.address, id(slave.config), _ident(slave)) for slave in bus.slaves)
        known = (bus.searching, bus.was_opened, slaves)
        if known == self._known and self._plant is not None:
            return
        if known[:2] != self._known[:2]:
            self._started = time() - self._t
        self._known = known
        self._plant = {"plant": plant_of(bus, self._started)}
        self._now, self._slaves = {}, {}
        whole = self._snapshot({"bus": {}, "slaves": {}}, whole=True)
        for stream in self._readers:
            stream.put(self._plant)
            stream.put(whole)

    def _slave_changes(self, slaves: Iterable[Slave]) -> dict[str, Any]:
        now, found = self._bus.snapshot, {}
        for slave in slaves:
            reader = self._slaves.get(slave.address)
            if reader is None:
                reader = self._slaves[slave.address] = SlavePicture(self._bus, slave)
            changes = reader.take(now)
            if self._end is not None:  # nothing of an ended bus is alive
                changes |= reader.end()
            if changes:
                found[str(slave.address)] = changes
        return {"bus": {}, "slaves": found}

    def _cpu_changes(self) -> dict[str, Any]:
        """As :meth:`_slave_changes`, of the S7-200 CPUs."""
        now, found = self._bus.snapshot, {}
        for address, polling in self._bus.cpus.items():
            reader = self._slaves.get(address)
            if reader is None:
                reader = self._slaves[address] = CpuPicture(self._bus, polling)
            changes = reader.take(now)
            if self._end is not None:
                changes |= reader.end()
            if changes:
                found[str(address)] = changes
        return {"bus": {}, "slaves": found}

    def _bus_changes(self) -> dict[str, Any]:
        bus, at = self._bus, asyncio.get_running_loop().time()
        ring, values = bus.snapshot, dict[str, Any]()
        if not self._now or at - self._figures_at >= _FIGURES_S:
            self._figures_at = at
            counters = bus.view.counted()
            values = bus_figures(bus, (), counters).summary() | {
                "histogram": histogram(counters.rotation),
                "histograms": histograms(counters),
            }
            del values["slaves"]
        values |= {
            "mode": (bus.mode if bus.was_opened else Mode.OFFLINE).name.lower(),
            "in_ring": ring.in_ring,
            "masters": sorted(ring.las),
            "clear": clear_since(bus) or None,
            "clock": to_builtins(clock_of(ring.clock, bus.started_ns)) if bus.was_opened else None,
        }
        known = self._now
        changes = {key: value for key, value in values.items() if key not in known or known[key] != value}
        known.update(changes)
        return {"bus": changes, "slaves": {}}

    def _hand_out(self, changes: dict[str, Any]) -> None:
        item = self._snapshot(changes, whole=False)
        for stream in self._readers:
            stream.put(item)

    def _snapshot(self, values: Mapping[str, Any], *, whole: bool) -> Item:
        return {"snapshot": {"t": self._t, "whole": whole, "bus": values["bus"], "slaves": values["slaves"]}}

    @property
    def _t(self) -> float:
        return round(self._bus.seconds, 6) if self._bus.was_opened else 0.0

    def _on_event(self, event: Event) -> None:
        self._put_event(event, self._readers)
        if isinstance(event, SlaveStateChanged) and event.state is not SlaveState.DATA_EXCHANGE:
            self._show_loss(event.address)

    def _show_loss(self, address: int) -> None:
        """A slave has left data exchange: readers get a snapshot of it at once, as its values look fresh until then.
        It is at most one a slave and round: ``state`` comes back to data exchange in a round only."""
        reader = self._slaves.get(address)
        if reader is None or reader.values.state != SlaveState.DATA_EXCHANGE.value or not self._now:
            return
        with contextlib.suppress(UsageError):  # it is being removed
            # with the mode, which may be the reason
            self._hand_out(self._bus_changes() | {"slaves": {str(address): reader.take(self._bus.snapshot)}})
            for one in self._readers:
                one.wake()

    def _put_event(self, event: Event, readers: Iterable[LiveItems]) -> None:
        t = ns_to_s(event.t_ns - self._bus.started_ns)
        line = event_json(event, t)
        if line is None:
            return
        more = {"time": iso_time(self._started + t), "severity": event.severity.value, "text": event.text}
        item = {"event": line | more}
        for stream in readers:
            stream.put(item)


def _steps(slaves: Iterable[Slave]) -> Iterator[list[Slave]]:
    """``slaves`` in the steps of a snapshot."""
    step: list[Slave] = []
    values = 0
    for slave in slaves:
        own = len(slave.config.input_fields) + len(slave.config.output_fields)
        if step and (len(step) == _STEP or values + own > _STEP_VALUES):
            yield step
            step, values = [], 0
        step.append(slave)
        values += own
    if step:
        yield step


def checked_interval(interval: float) -> float:
    """Raises UsageError for an interval that is no number of seconds from 0.02 on."""
    if not isinstance(interval, (int, float)) or not _SHORTEST_S <= interval < math.inf:
        raise UsageError(f"interval = {interval!r}: give the seconds between two snapshots, {_SHORTEST_S:g} or more")
    return interval


# --- plant and values as plain data -------------------------------------------------------------------------------


def plant_of(bus: BusBase, started: float) -> dict[str, object]:
    """``bus`` as configured; ``started``: its start in s since 1970.

    While it searches its rate: ``baud`` None, no slaves.
    """
    config = bus.config
    plant: dict[str, object] = {
        "version": 1,
        "started": round(started, 3),
        "port": config.port if bus.searching else bus.runtime.port_name,
        "baud": None,
        "driver": None,
        "address": config.bus.address,
        "read_only": config.bus.read_only,
        "virtual": config.virtual,
        "paced": None,
        "config": None if config.file is None else str(config.file),
        "config_digest": config.digest,
        "parameters": {},
        "plan": None,
        "slaves": {},
    }
    if bus.searching:
        return plant
    plan = bus.plan.as_dict()
    return plant | {
        "baud": bus.params.baud,
        "driver": bus.driver,
        "address": bus.params.address,
        "paced": bus.runtime.paced,
        "parameters": plan["parameters"],
        "plan": {"rotation_us": plan["rotation_us"], "cycle_us": _cycle_us(config.bus.cycle_ns)},
        "slaves": {str(slave.address): slave_plant(bus, slave) for slave in bus.slaves} | _cpu_plants(bus),
    }


def _cpu_plants(bus: BusBase) -> dict[str, dict[str, object]]:
    """The S7-200 CPUs as configured, by address."""
    return {str(address): _cpu_plant(polling.config) for address, polling in bus.cpus.items()}


def _cpu_plant(config: CpuConfig) -> dict[str, object]:
    inputs, outputs = ([one.as_dict() for one in side.fields.values()] for side in config.fields)
    return {
        "name": config.name,
        "address": config.address,
        "model": "S7-200 (PPI)",
        "protocol": PPI,
        "inputs": inputs,
        "outputs": outputs,
        "drive": None,
        "dpv1": False,
    }


def _cycle_us(cycle_ns: int | None) -> float | None:
    return cycle_ns / NS_PER_US if cycle_ns else None


def slave_plant(bus: BusBase, slave: Slave) -> dict[str, object]:
    """The same before the bus is open, so that readers can prepare themselves."""
    config, params = slave.config, slave.setup
    watchdog = None if bus.config.bus.read_only else params.watchdog(bus.plan.watchdog_ms)
    device, profile = config.device, config.profile
    known = config.any_profile
    models = [one.profile.title for one in config.drives] if known is None else [known.title]
    return {
        **named_values(config),
        "name": slave.name,
        "address": slave.address,
        "ident": _ident(slave),
        "vendor": "" if device is None else device.vendor,
        "model": device.model if device is not None else ", ".join(dict.fromkeys(models)),
        "gsd": config.gsd,
        "modules": _modules(config),
        "input_len": params.input_len,
        "output_len": params.output_len,
        "safe": params.safe_outputs.hex(),
        "watchdog_ms": 0 if watchdog is None else watchdog.ms,
        "groups": list(params.groups),
        "dpv1": params.dpv1 is not None,
        "every": params.every,
        "drive": None if profile is None else _drive_plant(profile, config.telegram, config.options),
        "drives": {one.name: _drive_plant(one.profile, one.telegram, one.options) for one in config.drives} or None,
    }


def _drive_plant(profile: DriveProfile, telegram: str | None, options: Mapping[str, object]) -> dict[str, object]:
    return {
        "profile": profile.name,
        "telegram": telegram,
        "reference_hz": options.get("reference_hz"),
        "reference_rpm": options.get("reference_rpm"),
    }


def named_values(config: SlaveConfig) -> dict[str, object]:
    """The keys of a slave of the plant that say which values it has by name: ``name``, ``inputs``, ``outputs``, and
    ``drive``, here without its facts."""
    return {
        "name": config.name,
        "inputs": [_field(config, field, Direction.INPUT) for field in config.input_fields.fields.values()],
        "outputs": [_field(config, field, Direction.OUTPUT) for field in config.output_fields.fields.values()],
        "drive": None if config.profile is None else {},
    }


def described_slaves(config: Config) -> dict[int, Described]:
    """The nodes and orders that connectors will have of ``config``, by address, if the run takes orders."""
    plants = {one.address: {**named_values(one), "dpv1": one.params.dpv1 is not None} for one in config.slaves}
    plants |= {one.address: _cpu_plant(one) for one in config.ppi}
    return {at: slave_of(at, convert(plant, SlavePlant), writable=True) for at, plant in plants.items()}


def _ident(slave: Slave) -> str | None:
    """The ident number; with ``ident = "ask"`` that of the slave's diagnosis, None before the first."""
    ident = slave.setup.ident
    if ident is None and slave.diagnosis is not None:
        ident = slave.diagnosis.ident
    return None if ident is None else f"0x{ident:04X}"


def _modules(config: SlaveConfig) -> list[dict[str, object]]:
    """The slots in order; a drive's telegram without a GSD file has its name in the first."""
    found: list[dict[str, object]] = []
    for slot in config.params.slots.slots:
        name = slot.name or (config.telegram or "" if config.modules is None and not found else "")
        found.append({**slot.as_dict(), "name": name})
    return found


def _field(config: SlaveConfig, field: Field, direction: Direction) -> dict[str, object]:
    slot = config.params.slots.at(direction, field.octet)
    return field.as_dict(None if slot is None else slot.number)


def histogram(rotation: Histogram) -> list[tuple[float, int]]:
    """Rotation times in at most 40 classes of equal width: the upper limit of each in us, and its count."""
    values = rotation.values()
    if not values:
        return []
    low, high = values[0][0], values[-1][0]
    width = max(1, -(-(high - low + 1) // _CLASSES))
    counts: dict[int, int] = {}
    for ns, count in values:
        counts[(ns - low) // width] = counts.get((ns - low) // width, 0) + count
    return [(round((low + (index + 1) * width) / NS_PER_US, 3), counts[index]) for index in sorted(counts)]


def histograms(counters: Counters) -> dict[str, object]:
    """Durations in classes whose limits stay, and whose counts never fall, as monitoring systems want them."""
    found = {"rotation": counters.rotation, "token": counters.token_rotation, "host": counters.lateness}
    if counters.cycles.cycle_ns:
        found["late"] = counters.cycles.late
    return {name: _in_classes(durations) for name, durations in found.items()}


def _in_classes(durations: Histogram) -> dict[str, object]:
    """``counts`` has one more number than ``limits_us``: that above the last limit."""
    counts, total_ns = durations.in_classes(_LIMITS_NS)
    return {"limits_us": list(LIMITS_US), "counts": counts, "sum_us": round(total_ns / NS_PER_US, 3)}
