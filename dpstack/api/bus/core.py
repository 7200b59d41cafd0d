"""``BusCore``: the inside of a ``Bus``: beginning and end, orders, events and failures of the machine."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Iterable
from typing import TYPE_CHECKING

from msgspec.structs import replace

from dpstack.api.bus.compose import compose
from dpstack.api.bus.cycles import Cycles
from dpstack.api.bus.driver_choice import PROCESS
from dpstack.api.bus.parts import BusBase
from dpstack.api.bus.ring_entry import OtherMasterNotices, join, listening_report
from dpstack.api.bus.shutdown import OrderedEnd
from dpstack.api.config.config import Config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.injected import SIMULATION
from dpstack.api.slave.slave import Slave
from dpstack.api.streams import EventStream, OnEvent
from dpstack.dp.master.commands import AddSlave, DriveCommand, Mode, RemoveSlave
from dpstack.dp.master.events import (
    DriveEvent,
    ForcedClear,
    ModeChanged,
    OperateWaits,
    SlaveEvent,
    SlaveState,
    SlaveStateChanged,
)
from dpstack.dp.master.scanner import Found, ScanDone, SurveyOrder
from dpstack.dp.pdu.diagnosis import SlaveView, view_of
from dpstack.dp.process_image import DRIVE
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.alarm_orders import AcknowledgeAlarm, HoldAlarms
from dpstack.drivers.futures import wait_through_cancellation
from dpstack.drivers.runtime import PortDisturbed, stopped_by
from dpstack.errors import BusError, DpError, UsageError
from dpstack.fdl.commands import DetachUser, GoOnline
from dpstack.fdl.events import AddressCollision, RingJoined, StationFound
from dpstack.fdl.livelist import ALL_ADDRESSES
from dpstack.fdl.telegram import StationType
from dpstack.trace import Event, Notice, Severity
from dpstack.units import ns_to_s

if TYPE_CHECKING:
    from dpstack.api.bus.compose import Plugin
    from dpstack.api.bus.live import LiveFeed
    from dpstack.api.bus.recording import BusRecording
    from dpstack.api.fdl.link import FdlLink
    from dpstack.fdl.services.identity import Ident
    from dpstack.sim.world import World


class BusFailed(Notice):
    """The failure that ended the bus. Every pending and later call on the bus raises it as well."""


class BusCore(BusBase):
    """The inside of a :class:`~dpstack.api.bus.bus.Bus`, for the rooms of dpstack.

    ``world``, ``watched``, ``dp``: see :func:`~dpstack.api.bus.compose.compose`; ``join_timeout`` in seconds.
    """

    def __init__(
        self,
        config: Config,
        on_event: OnEvent | None,
        *,
        join_timeout: float | None = None,
        world: World | None = None,
        watched: bool = True,
        dp: bool = True,
    ) -> None:
        super().__init__(config, on_event)
        self._given_world = world
        self._watched = watched
        self._dp = dp
        self._fdl_link: FdlLink | None = None
        self._join_timeout = join_timeout
        self._ordered_end = OrderedEnd(self, self.close, self.hurry)
        self._joined_ns = 0  # machine time of the first token
        self.cycles = Cycles(self)
        self._live: LiveFeed | None = None
        self._recordings: list[BusRecording] = []
        #: awaited when the rate is known, before the port is opened
        self.before_opening: list[Callable[[], Awaitable[None]]] = []
        if not self.searching:
            self._build(config)
        elif world is None:
            from dpstack.api.bus.find_baud import require_wire  # here, as most buses have a rate

            require_wire(config.port)

    def _build(self, config: Config) -> None:
        """Make the objects behind the bus; ``config`` has a baud rate. Raises ConfigError."""
        self._parts = compose(
            config,
            self._on_events,
            self._on_failure,
            self._on_refused,
            world=self._given_world,
            watched=self._watched,
            dp=self._dp,
        )
        if self.driver != PROCESS:  # in the loop of a bus nothing is loaded later, which would hold it up
            self._load_rest()
        self.config = config
        self._other_masters = OtherMasterNotices(self.params, lambda: self.snapshot)
        for slave in config.slaves:
            self._register(slave, self.parts.plugins.get(slave.address, ()))
        if config.ppi:
            from dpstack.api.ppi.polling import CpuPolling  # here, as most plants have none

            self.cpus = {one.address: CpuPolling(self, one) for one in config.ppi}

    def _load_rest(self) -> None:
        """Load the modules that a running bus may need without a file handle left."""
        from dpstack.api.bus import statistics, sync_freeze  # noqa: F401
        from dpstack.api.slave import quality_events  # noqa: F401

        if any(slave.dpv1 is not None for slave in self.view.setups.values()):
            from dpstack.dpv1.master import orders  # noqa: F401

    def _register(self, config: SlaveConfig, plugins: tuple[Plugin, ...]) -> Slave:
        setup = self.view.setups[config.address]
        orders = None
        if plugins and config.device_profile is not None:
            from dpstack.api.slave.device_orders import DeviceOrders  # here, as most buses have none

            (plugin,) = plugins
            assert not isinstance(plugin, tuple)
            orders = self._device_orders[config.address] = DeviceOrders(self, plugin)
        slave = self._slaves[config.address] = Slave(
            self, config, setup, has_plugin=bool(plugins), device_orders=orders
        )
        if plugins and self._has_block_units(config):
            from dpstack.api.slave.block_units import BlockUnits  # here, as most buses have no PA devices
            from dpstack.api.slave.class2 import Class2

            self._block_units[config.address] = BlockUnits(
                slave, Class2(self, self.by_address, self.slave), self._tell_units
            )
        if plugins and orders is None:
            from dpstack.api.slave.drive import (
                Drive,
                DrivePlugin,
            )  # here, as a bus without drives needs nothing of them

            self._drives[config.address] = tuple(
                Drive(self, slave, plugin) for plugin in plugins if isinstance(plugin, DrivePlugin)
            )
        return slave

    def _has_block_units(self, config: SlaveConfig) -> bool:
        """Whether blocks of the slave have the units of its values; not a simulated one without records."""
        if self.config.bus.read_only or config.device_profile is None or config.device_profile.units is None:
            return False
        bench = self.parts.bench
        return bench is None or config.address not in bench.units or bench.device(config.address).records is not None

    def _tell_units(self, text: str) -> None:
        self.notice("units", text, Severity.WARNING)

    # --- from beginning to end ----------------------------------------------------------------------------------------

    async def open(self) -> None:
        """See ``Bus.open``."""
        if self._open or self._ending is not None:
            raise UsageError("this bus was opened before: make a new one with open_bus()")
        rate_text = None
        if self.searching:
            from dpstack.api.bus.find_baud import rate_of

            report = await rate_of(self.config, self._given_world)
            self._build(self.config.with_bus(baud=report.baud))
            rate_text = report.text
        for prepared in self.before_opening:
            await prepared()
        if self._ending is not None:
            raise UsageError("the bus was closed before its port was opened")
        self.started_ns = self.runtime.now()
        if self.bench is not None:
            self.bench.on_events = self._on_device_events
        await self.runtime.open()
        self._open, self._loop = True, asyncio.get_running_loop()
        try:
            await self._ordered_end.watch()
            if rate_text is not None:
                self.notice("bus", rate_text)
            for note in (*self.plan.findings, *self.plan.notes):
                self.notice("plan", note, Severity.WARNING)
            for text in [] if self.bench is None else self.bench.unfed:
                self.notice("simulation", text, Severity.WARNING)
            await self.order(GoOnline())
            if self.driver == PROCESS:  # while the bus listens
                self._load_rest()
            await join(self, self._join_timeout)
            for polling in self.cpus.values():
                polling.begin(self._on_poll)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See ``Bus.close``."""
        if self.is_left or await self._ordered_end.elsewhere():
            return
        ending = self._begin_end()
        await wait_through_cancellation(ending)
        if not ending.cancelled():
            ending.result()

    def hurry(self) -> None:
        """See ``Bus.hurry``."""
        self._ordered_end.hurry()
        for recording in self._recordings:
            recording.hurry()
        if self.is_open:
            self._begin_end()

    @property
    def end_failed(self) -> bool:
        """See ``Bus.end_failed``."""
        return self._ordered_end.failed

    def _begin_end(self) -> asyncio.Task[None]:
        if self._ending is None:
            self._ending = asyncio.create_task(self._end())
        return self._ending

    async def _end(self) -> None:
        for units in self._block_units.values():
            units.end()
        for polling in self.cpus.values():
            polling.end()
        try:
            if self._open:
                await self._ordered_end.carry_out()
        finally:
            self._open = False
            try:
                if not self.searching:
                    with contextlib.suppress(asyncio.CancelledError):  # the runtime closes all the same
                        await self.runtime.close()
            finally:
                self._fail_all_calls(UsageError("the bus is closed"))
                await self._ordered_end.unwatch()
                for recording in self._recordings:
                    await recording.stop()

    def _on_device_events(self, events: list[Event]) -> None:
        """Report exceptions in simulated devices: on the wire they are a slave without valid inputs only."""
        from dpstack.dp.slave.events import DeviceFailed  # here, as a bus on a wire simulates no slaves

        for event in events:
            if isinstance(event, DeviceFailed):
                self.notice(SIMULATION, event.text, Severity.ERROR)

    # --- orders, waiting ----------------------------------------------------------------------------------------------

    async def add(self, config: SlaveConfig, setup: SlaveParams) -> Slave:
        if setup.dpv1 is not None:
            await self.load_layouts()
        await self.order(AddSlave(setup))
        if self.bench is not None:
            self.bench.add(config)
        try:
            plugins = await self.parts.attach(config)
        except DpError:
            await self.order(RemoveSlave(setup.address))
            raise
        return self._register(config, plugins)

    async def remove(self, address: int) -> None:
        await self.order(RemoveSlave(address))
        self._round_ns = None
        del self._slaves[address]
        orders = self._device_orders.pop(address, None)
        if orders is not None:
            orders.end(UsageError(f"slave {address} was removed from the bus"))
        if (units := self._block_units.pop(address, None)) is not None:
            units.end()
        self.services.alarms.forget(address)
        for drive in self._drives.pop(address, ()):
            drive.end(UsageError(f"drive {drive.name} was removed from the bus"))

    async def outputs_taken(self) -> None:
        """See ``Bus.outputs_taken``."""
        self.check_open()
        with self._reason_of_the_end():
            await self.runtime.hand_over_outputs()
        self.raise_refused()

    async def rotated(self, rotations: int | None, timeout: float | None = None) -> None:
        """See ``Bus.rotated``."""
        if rotations is None:
            await self.until(lambda: False, timeout)
            return
        await self.until_round(lambda: self.view.rotations >= rotations, timeout)

    @property
    def seconds_in_ring(self) -> float:
        """Bus time in seconds since this master received, or claimed, its first token; 0 before that."""
        return ns_to_s(self.runtime.now() - self._joined_ns) if self._joined_ns else 0.0

    async def scan(
        self,
        *,
        configs: bool = False,
        addresses: Iterable[int] = ALL_ADDRESSES,
        quick: bool | None = None,
        types_only: bool = False,
    ) -> tuple[Found, ...]:
        """See ``Bus.scan``. ``types_only``: no Slave_Diag to anybody."""
        if quick is None:
            quick = not any(slave.ready_now for slave in self.slaves if not self.view.read_only)
        own = self.params.address
        mine = {} if self.view.read_only else {slave.address: slave for slave in self.slaves}
        token = self.services.token()
        skip = tuple(ALL_ADDRESSES if types_only else mine)
        order = SurveyOrder(token, tuple(addresses), skip, configs=configs, quick=quick)
        try:
            result = await self.services.answer_to(order, ScanDone)
        finally:
            with contextlib.suppress(DpError):  # the bus may have ended meanwhile
                self.command(DetachUser(token))
        self.unreadable = frozenset(result.unreadable)
        return tuple(_with_state_of(found, mine.get(found.address), own) for found in result.found)

    def fdl_link(self, *, per_hold: int = 1, ident: Ident | None = None) -> FdlLink:
        """The FDL services of this station, made for the first user."""
        if self._fdl_link is None:
            from dpstack.api.fdl.link import FdlLink  # here, as most buses have no use for it
            from dpstack.fdl.services.identity import Ident

            self._fdl_link = FdlLink(self, per_hold=per_hold, ident=ident or Ident("dpstack", "soft master"))
        return self._fdl_link

    def live_feed(self) -> LiveFeed:
        """The feed of ``bus.live()``, made for the first reader."""
        if self._live is None:
            from dpstack.api.bus.live import LiveFeed

            self._live = LiveFeed(self)
            if self._over is not None:
                self._live.end(str(self._over), failed=isinstance(self._over, BusError))
        return self._live

    def record(self, recording: BusRecording) -> None:
        """Begin ``recording``; it ends with the bus. Raises UsageError."""
        try:
            recording.start(self)
        except BaseException:
            recording.discard()
            raise
        self._recordings = [one for one in self._recordings if not one.is_over] + [recording]

    def _on_poll(self) -> None:
        """The values of an S7-200 are new."""
        for recording in self._recordings:
            recording.polled()
        self._waiters.check()

    def publish(self, event: Event) -> None:
        """Hand ``event`` to all readers of events, and to ``on_event``."""
        self._events.publish(event)

    def event_stream(self) -> EventStream:
        """The events since the start of the bus."""
        return self._events.stream()

    # --- events and failures of the machine ---------------------------------------------------------------------------

    def _on_events(self, events: list[Event]) -> None:
        for event in map(self._wall_clock.stamped, events):
            self._ordered_end.on_event(event)
            if self._fdl_link is not None and self._fdl_link.take(event):
                continue
            if self.services.handle_event(event):  # only the caller that awaits this service gets it
                continue
            for recording in self._recordings:
                recording.event(event)
            match event:
                case DriveEvent(address=address, payload=payload):
                    for drive in self._drives.get(address, ()):
                        if payload.get(DRIVE, drive.name) == drive.name:
                            drive.on_payload(payload, event.t_ns)
                    if (orders := self._device_orders.get(address)) is not None:
                        orders.on_payload(self._slaves[address], payload)
                case SlaveStateChanged(address=address) if address in self._drives:
                    for drive in self._drives[address]:
                        drive.publish_status()
                case SlaveStateChanged(address=address, state=SlaveState.DATA_EXCHANGE) if address in self._block_units:
                    self._block_units[address].on_data_exchange()
                case AddressCollision():
                    self.collision = event.text
                case PortDisturbed():
                    self.disturbed = event
                case StationFound(address=address, kind=kind):
                    (self.gap_slaves.add if kind is StationType.SLAVE else self.gap_slaves.discard)(address)
                case ForcedClear():
                    self.forced_clear = event
                case ModeChanged(mode=mode) if mode is not Mode.CLEAR:
                    self.forced_clear = None
                case OperateWaits():
                    self.forced_clear = None
            self._events.publish(event)
            if isinstance(event, SlaveEvent):
                self._judge_quality(event, self._slaves.get(event.address))
            for notice in self._other_masters.notices(event):
                self._events.publish(notice)
            if isinstance(event, RingJoined) and not self._joined_ns:
                self._joined_ns = event.t_ns
                text, severity = listening_report(self.params.address, self.view)
                self._events.publish(Notice(t_ns=event.t_ns, source="bus", message=text, severity=severity))
        self._waiters.check()

    def _judge_quality(self, event: SlaveEvent, slave: Slave | None) -> None:
        """Publish an event if the quality of the named values of ``slave`` has changed."""
        if self._quality_events is None:
            if slave is None or not any(fields for _, fields in slave.config.fields):
                return
            from dpstack.api.slave.quality_events import QualityEvents  # here, as a program may have no named values

            self._quality_events = QualityEvents(self._events.publish, lambda: self.runtime.now())
        self._quality_events.event(event, slave)

    def _on_refused(self, order: object, error: DpError) -> None:
        """The bus process did not carry out an order that nobody awaits."""
        self.notice("bus", f"{type(order).__name__} was not carried out: {error}", Severity.ERROR)
        match order:
            case DriveCommand(address=address, token=token) if address in self._drives:
                for drive in self._drives[address]:
                    drive.on_refused(token, error)
            case HoldAlarms() | AcknowledgeAlarm():
                self.services.alarms.on_refused(order, error)
            case _:
                self._refused = error

    def _on_failure(self, error: Exception) -> None:
        """The bus has stopped: pending calls raise ``error``, as a BusError (any other kind is a defect of dpstack)."""
        failure = error
        if not isinstance(failure, BusError):
            failure = BusError(f"the bus was stopped by {stopped_by(error)}")
            failure.__cause__ = error
        now = self.runtime.now()
        self._events.publish(BusFailed(t_ns=now, source="bus", message=str(failure), severity=Severity.ERROR))
        self._fail_all_calls(failure)

    def _fail_all_calls(self, error: DpError) -> None:
        """Every pending and later call raises ``error``, or the first one if this was called before."""
        if self._over is None:
            self._over = error
        self._ordered_end.is_over()
        for drive in self.drives:
            drive.end(self._over)
        for orders in self._device_orders.values():
            orders.end(self._over)
        self.cycles.end()
        self.services.end(self._over)
        for polling in self.cpus.values():
            polling.end()
        if self._fdl_link is not None:
            self._fdl_link.end(self._over)
        if self._quality_events is not None:
            self._quality_events.end()
        if self._refused_orders is not None:
            self._refused_orders.end()
        self._events.end()
        if self._live is not None:
            self._live.end(str(self._over), failed=isinstance(self._over, BusError))
        self._waiters.check()


def _with_state_of(found: Found, slave: Slave | None, own: int) -> Found:
    """``found`` with the master's own state of ``slave``. (The scan sends it no diagnosis request: the answer would
    reset the diagnosis flag, and the master would miss a new diagnosis.)"""
    if slave is None or found.kind is not StationType.SLAVE:
        return found
    exchanging = slave.state is SlaveState.DATA_EXCHANGE
    return replace(
        found,
        state=SlaveView.DATA_EXCHANGE if exchanging else view_of(slave.diagnosis),
        ident=None if slave.diagnosis is None else slave.diagnosis.ident,
        master=own if exchanging else None,
        config=slave.setup.config if exchanging else None,
        diagnosis=slave.diagnosis,
    )
