"""The machines of one bus, made from plain data, and their snapshots; every driver runs these, in whichever process."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Final, Protocol

from dpstack.dp.acyclic.queue import Acyclic, Provider
from dpstack.dp.master.bring_ups import History
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.fixed_cycle import CycleData
from dpstack.dp.master.master import Master
from dpstack.dp.master.scanner import Scanner
from dpstack.dp.master.settings import StackSpec
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.services import fdl_refusal, reading_only
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.alarm_orders import CloseConnections, ConnectionsClosed
from dpstack.drivers.snapshots import (
    BusSnapshot,
    ClockSnapshot,
    Counters,
    ImageSnapshot,
    SentClock,
    SlaveSnapshot,
    no_image,
)
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.interface import LinkStats, LinkUser
from dpstack.fdl.livelist import LiveList, live_allowance
from dpstack.fdl.telegram import Telegram
from dpstack.phy.patience import EXACT, FIRST, Lateness
from dpstack.stats import Histogram
from dpstack.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from dpstack.dp.acyclic.clock_master import ClockMaster, HeardClocks
    from dpstack.dp.pdu.clock import ClockValue

#: a read-only bus asks the whole live list and the diagnosis of each slave anew this often
_LIST_PERIOD: Final = 10 * NS_PER_S
_DIAGNOSIS_PERIOD: Final = 500 * NS_PER_MS


def acyclic_services(own: int, master: Master | None = None) -> Acyclic:
    """All acyclic services of the station ``own``; ``master``: the class 1 master of the same station, if any."""
    return Acyclic(master, _providers(own, master))


def _providers(own: int, master: Master | None) -> Iterable[Provider]:
    from dpstack.dp.acyclic.class2 import Class2  # these here, as most buses have no use for them
    from dpstack.dp.pdu import pa_diagnosis, redundancy  # noqa: F401 (texts of status messages, before the first comes)
    from dpstack.dpv1.master.alarm_handler import Alarms
    from dpstack.dpv1.master.ms1 import Ms1
    from dpstack.dpv1.master.ms2 import Ms2

    ms1 = Ms1(master)
    return Class2(own, master), Alarms(ms1), ms1, Ms2(own, master)


class _NoServices(Provider):
    """Stands for the acyclic services while they are not loaded: no connection is open."""

    def command(self, order: object, now: int) -> bool:
        if isinstance(order, CloseConnections):
            self.queue.report(ConnectionsClosed(t_ns=now))
            return True
        return False


def _watcher(spec: StackSpec) -> Scanner:
    """The scanner of a read-only bus: the whole list quickly once, then within its share, slaves twice a second."""
    own = spec.params.address
    live = LiveList(
        own,
        period_ns=_LIST_PERIOD,
        allowance=live_allowance(spec.params, spec.patience, 0),
        quick_start=True,
    )
    return Scanner(own, live, period_ns=_DIAGNOSIS_PERIOD, wanted=[slave.address for slave in spec.slaves])


def _clock_master(spec: StackSpec, lateness: Callable[[], Lateness]) -> ClockMaster:
    """The class 3 master: it sends the time of this computer, on a simulated bus that of the bus."""
    from dpstack.boottime import is_synchronised, time_at  # these here, as most buses send no time
    from dpstack.dp.acyclic.clock_master import VIRTUAL_EPOCH_NS, ClockMaster

    interval_ns = spec.master.clock_sync_ns
    if spec.master.clock_is_virtual:
        return ClockMaster(spec.params, interval_ns, lambda now: VIRTUAL_EPOCH_NS + now, lambda: True, lateness)
    return ClockMaster(spec.params, interval_ns, time_at, is_synchronised, lateness)


def _sent_clock(master: int, value: ClockValue, at_ns: int, values: int) -> SentClock:
    return SentClock(master, value.time_ns, value.resolution_ms, value.synchronised, value.summer_time, at_ns, values)


class Latency(Protocol):
    histogram: Histogram


class BusDriver(Protocol):
    """The driver that keeps the machines of a bus running."""

    @property
    def lateness(self) -> Latency: ...

    def damage(self) -> dict[str, int]:
        """Octets that arrived damaged, by cause."""

    def now(self) -> int:
        """The time in ns."""


class Stack:
    """The machines of ``spec`` and their snapshots. A :class:`~dpstack.drivers.snapshots.View`.

    ``station`` is the protocol machine; ``line`` is the driver that runs it, set by the owner after construction. On a
    read-only bus a guard refuses every request that could write. ``late_services``: unless a slave is parameterised for
    DP-V1, the acyclic services are not loaded before :meth:`load_services`. Raises ConfigError.
    """

    line: BusDriver

    def __init__(self, spec: StackSpec, *, late_services: bool = False) -> None:
        params, read_only = spec.params, spec.master.read_only
        self.master = master = Master(params, spec.slaves, spec.master)
        self._watcher = _watcher(spec) if read_only and spec.watched else None
        users: list[LinkUser] = [master] if self._watcher is None else [master, self._watcher]
        self._clock: ClockMaster | None = None
        self._heard: HeardClocks | None = None
        if spec.master.clock_sync_ns:
            self._clock = _clock_master(spec, self.lateness)
            users.append(self._clock)
        self._acyclic = Acyclic(master, (_NoServices(),)) if spec.dp else None
        if self._acyclic is not None:
            users.append(self._acyclic)
        self._has_services = False
        if not late_services or any(slave.dpv1 is not None for slave in spec.slaves):
            self.load_services()
        guard = reading_only if read_only and spec.dp else None
        self.station = station = ActiveStation(params, users, patience=spec.patience, guard=guard, window=master.window)
        master.context.ring = lambda: station.las
        if spec.patience != EXACT:
            master.context.lateness = self.lateness
        station.hear_clocks(self._hear_clock)
        if spec.dp:
            station.fdl_guard = lambda order: fdl_refusal(order, master.handlers, read_only=read_only)

    def load_services(self) -> None:
        """Load the acyclic services: of class 2, and those of DP-V1. May be repeated."""
        if self._acyclic is not None and not self._has_services:
            self._acyclic.provide(_providers(self.master.context.params.address, self.master))
            self._has_services = True

    @property
    def read_only(self) -> bool:
        return self.master.context.settings.read_only

    @property
    def setups(self) -> dict[int, SlaveParams]:
        return {address: handler.setup for address, handler in self.master.handlers.items()}

    def lateness(self) -> Lateness:
        """The lateness of the port: measured, or before that of its kind; none in virtual time."""
        patience = self.station.patience
        if patience == EXACT:
            return Lateness()
        histogram = self.line.lateness.histogram
        if histogram.count < FIRST:
            return Lateness(patience.unknown_ns + patience.sending_ns)
        return Lateness(histogram.quantile_ns(0.999), histogram.count)

    def _hear_clock(self, telegram: Telegram, now: int) -> None:
        if self._heard is None:
            from dpstack.dp.acyclic.clock_master import HeardClocks  # here, as few buses have a second one

            self._heard = HeardClocks(self.master.context.emit, sends=self._clock is not None)
        self._heard.hear(telegram, now)

    def _clock_snapshot(self) -> ClockSnapshot | None:
        clock, heard = self._clock, self._heard
        if clock is None and heard is None:
            return None
        others: tuple[SentClock, ...] = ()
        if heard is not None:
            heard.forget_silent(self.line.now())
            known = sorted(heard.masters.items())
            others = tuple(_sent_clock(address, one.value, one.heard_at, one.values) for address, one in known)
        if clock is None:
            return ClockSnapshot(0, Lateness(), others=others) if others else None
        last = None if clock.last is None else _sent_clock(self.station.address, *clock.last, clock.sent)
        return ClockSnapshot(clock.interval_ns, clock.held, last, clock.trouble, others)

    @property
    def mode(self) -> Mode:
        return self.master.mode

    def bus(self) -> BusSnapshot:
        master, station, watcher = self.master, self.station, self._watcher
        return BusSnapshot(
            mode=master.mode,
            synced=frozenset(master.controls.sync.held),
            frozen=frozenset(master.controls.freeze.held),
            in_ring=station.in_ring,
            claimed=station.claimed,
            las=frozenset(station.las),
            patience=station.patience,
            found=None if watcher is None else dict(watcher.found),
            found_all=watcher is not None and watcher.done,
            clock=self._clock_snapshot(),
        )

    def slave(self, address: int) -> SlaveSnapshot:
        handler = self.master.handlers.get(address)
        if handler is None:
            return SlaveSnapshot()
        reports = handler.reports
        return SlaveSnapshot(
            handler.state,
            handler.fault,
            handler.diagnosis,
            handler.watchdog_effective_ns,
            handler.alarm_counts,
            reports.observer.standing,
            reports.diagnoses,
            reports.diagnosis_ns,
            handler.image.withheld,
        )

    def bring_ups(self, address: int) -> History:
        handler = self.master.handlers.get(address)
        return History() if handler is None else handler.bring_ups.history()

    async def history(self, address: int) -> History:
        return self.bring_ups(address)

    def image(self, setup: SlaveParams) -> ImageSnapshot:
        handler = self.master.handlers.get(setup.address)
        return no_image(setup) if handler is None else image_snapshot(handler)

    def set_outputs(self, address: int, octets: bytes) -> None:
        self.master.handlers[address].set_outputs(octets)

    def counted(self) -> Counters:
        """The live counters; the machines go on changing them."""
        master, station, line = self.master, self.station, self.line
        return Counters(
            t_ns=line.now(),
            rotation=master.rotation,
            token_rotation=station.token_rotation,
            lateness=line.lateness.histogram,
            link=station.stats,
            decoder=station.decoder_stats,
            cycles=master.cycles,
            held_back=master.window.held_back,
            forced=master.window.forced,
            damage=line.damage(),
        )

    def counters(self) -> Counters:
        return copy.deepcopy(self.counted())

    @property
    def link(self) -> LinkStats:
        return self.station.stats

    @property
    def rotations(self) -> int:
        return self.master.rotation.count

    @property
    def cycle(self) -> CycleData | None:
        return self.master.cycle

    def watch_rounds(self, on_round: Callable[[], None] | None) -> None:
        self.master.on_round = None if on_round is None else lambda _now: on_round()


def image_snapshot(handler: SlaveHandler) -> ImageSnapshot:
    """Inputs and outputs of one slave."""
    image, reports = handler.image, handler.reports
    return ImageSnapshot(
        image.inputs,
        image.outputs,
        image.valid,
        handler.exchanges,
        image.input_time,
        reports.flagged > 0,
        reports.diagnoses,
        image.returns,
    )
