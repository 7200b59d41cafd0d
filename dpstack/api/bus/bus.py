"""``open_bus`` and ``Bus``: opening, modes, slaves, events and the end of a running bus."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
from collections.abc import AsyncIterator, Awaitable, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Literal

from dpstack.api.bus.compose import compose
from dpstack.api.bus.cycles import Cycle, Cycles
from dpstack.api.bus.find_baud import rate_of, require_wire
from dpstack.api.bus.live import LiveFeed, LiveStream, checked_interval
from dpstack.api.bus.parts import BusBase
from dpstack.api.bus.plan_checks import new_plan_texts
from dpstack.api.bus.recording import BusRecording
from dpstack.api.bus.ring_entry import OtherMasterNotices, join, listening_report
from dpstack.api.bus.shutdown import OrderedEnd
from dpstack.api.bus.statistics import BusStats, bus_figures
from dpstack.api.bus.sync_freeze import Group, Groups, send_control
from dpstack.api.bus.why import gather
from dpstack.api.config.config import Config, load_config, make_config, slave_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave.class2 import Class2
from dpstack.api.slave.drive import Drive, DrivePlugin
from dpstack.api.slave.slave import Slave
from dpstack.api.streams import EventStream, OnEvent
from dpstack.argcheck import Sealed
from dpstack.dp.master.commands import AddSlave, Alive, DriveCommand, Mode, RemoveSlave, SetMode
from dpstack.dp.master.events import (
    ControlSent,
    DriveEvent,
    ForcedClear,
    ModeChanged,
    OperateWaits,
    SlaveState,
    SlaveStateChanged,
)
from dpstack.dp.master.scanner import Found, ScanDone, SlaveView, SurveyOrder, view_of
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.orders import AcknowledgeAlarm, HoldAlarms
from dpstack.drivers.futures import run_through_cancellation, wait_through_cancellation
from dpstack.drivers.runtime import stopped_by
from dpstack.errors import BusError, ConfigError, DpError, UsageError
from dpstack.fdl.commands import DetachUser, GoOnline
from dpstack.fdl.events import AddressCollision, RingJoined
from dpstack.fdl.livelist import ALL_ADDRESSES
from dpstack.fdl.telegram import StationType
from dpstack.sim.world import World
from dpstack.trace import Event, Notice, Severity
from dpstack.units import ns_to_s
from dpstack.why.story import Story, tell


class BusFailed(Notice):
    """The failure that ended the bus. Every pending and later call on the bus raises it as well."""


SlaveTable = Mapping[str, object] | SlaveConfig


class Bus(Sealed, BusBase):
    """A running bus: the slaves of a configuration under a class 1 master. Made by :func:`dpstack.open_bus`."""

    def __init__(
        self,
        config: Config,
        *,
        on_event: OnEvent | None = None,
        join_timeout: float | None = None,
        world: World | None = None,
        watched: bool = True,
    ) -> None:
        super().__init__(config, on_event)
        self._given_world = world
        self._watched = watched
        self._join_timeout = join_timeout
        self._ordered_end = OrderedEnd(self, self.close, self.hurry)
        self._joined_ns = 0  # machine time of the first token
        self._cycles = Cycles(self)
        self._recordings: list[BusRecording] = []
        self._live = LiveFeed(self)
        #: the services of a class 2 master: diagnosis, configuration, inputs and outputs of any slave, its address
        self.class2 = Class2(self, self._slaves, self.slave)
        if not self.searching:
            self._build(config)
        elif world is None:
            require_wire(config.port)
        self._seal(Bus)

    def _build(self, config: Config) -> None:
        """Make the objects behind the bus; ``config`` has a baud rate. Raises ConfigError."""
        self._parts = compose(
            config, self._on_events, self._on_failure, self._on_refused, world=self._given_world, watched=self._watched
        )
        self.config = config
        self._other_masters = OtherMasterNotices(self.params, lambda: self.snapshot)
        for slave in config.slaves:
            self._register(slave, self.parts.plugins.get(slave.address))

    def _register(self, config: SlaveConfig, plugin: DrivePlugin | None) -> Slave:
        setup = self.view.setups[config.address]
        slave = self._slaves[config.address] = Slave(self, config, setup, has_plugin=plugin is not None)
        if plugin is not None:
            self._drives[config.address] = Drive(self, slave, plugin)
        return slave

    # --- from beginning to end ----------------------------------------------------------------------------------

    async def __aenter__(self) -> Bus:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def open(self) -> None:
        """Listen, join the token ring, begin the bring-up in Clear. Raises PortError, BusError.

        With the baud rate "auto" listen for that first: after 5 s of silence BusError says what to do.
        """
        if self._open or self._ending is not None:
            raise UsageError("this bus was opened before: make a new one with open_bus()")
        rate_text = None
        if self.searching:
            report = await rate_of(self.config, self._given_world)
            self._build(self.config.with_bus(baud=report.baud))
            rate_text = report.text
        if self._ending is not None:
            raise UsageError("the bus was closed while it was searching for its baud rate")
        self.started_ns = self.runtime.now()
        await self.runtime.open()
        self._open = True
        try:
            await self._ordered_end.watch()
            if rate_text is not None:
                self.notice("bus", rate_text)
            for note in (*self.plan.findings, *self.plan.notes):
                self.notice("plan", note, Severity.WARNING)
            await self.order(GoOnline())
            await join(self, self._join_timeout)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """The ordered end: safe values for one cycle, Clear twice, out of the ring, port released. May be repeated.

        The end takes a few rotations, at most :attr:`end_limit_s`. Cancellations do not shorten it; they are raised
        when it is over. The caller may be in another event loop than the one that opened the bus. In a process forked
        from the one that opened the bus this does nothing.
        """
        if self.is_left or await self._ordered_end.elsewhere():
            return
        ending = self._begin_end()
        await wait_through_cancellation(ending)
        if not ending.cancelled():
            ending.result()

    def hurry(self) -> None:
        """End within a second, without the steps that do not make outputs safe: safe values and Clear as far as the
        bus can still send them, then the port is released. Call it in the bus's event loop; ``close()`` waits for it.
        """
        self._ordered_end.hurry()
        for recording in self._recordings:
            recording.hurry()
        if self.is_open:
            self._begin_end()

    @property
    def end_failed(self) -> bool:
        """True after an end in which slaves that had outputs got neither safe values nor Clear (dead port, no token,
        a bus process that hangs). An event reports it, with the watchdog times of the slaves."""
        return self._ordered_end.failed

    def _begin_end(self) -> asyncio.Task[None]:
        if self._ending is None:
            self._ending = asyncio.create_task(self._end())
        return self._ending

    async def _end(self) -> None:
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

    # --- orders -------------------------------------------------------------------------------------------------

    async def operate(self) -> None:
        """Outputs go out from the next rotation on; with ``auto_clear`` once all slaves are in data exchange.

        This ends a Clear that the master went to by itself (:attr:`forced_clear`), and arms the application watchdog.
        """
        self._raise_refused()
        await self.order(SetMode(Mode.OPERATE))

    def alive(self) -> None:
        """The application is alive: call it more often than ``application_watchdog_ms`` while the bus is in Operate.

        Without a call for so long the master goes to Clear until :meth:`operate`. No effect while the application
        watchdog is off, not armed, or has run out. Raises UsageError when the bus is not open.
        """
        self.check_open()
        if self.config.bus.application_watchdog_ms:
            self.command(Alive())

    async def clear(self) -> None:
        """Clear: the master reads inputs and sends zero outputs (empty ones to Fail_Safe slaves)."""
        await self.order(SetMode(Mode.CLEAR))
        self._raise_refused()

    async def stop(self) -> None:
        """Stop: the master sends slaves no more telegrams (their watchdogs will expire), and stays in the ring."""
        await self.order(SetMode(Mode.STOP))
        self._raise_refused()

    async def outputs_taken(self) -> None:
        """Wait until the master has the outputs that the program has set; in Operate its next round sends them.

        Raises OrderDropped where a bus process did not take them within 1 s: they will not be sent, and
        ``Slave.outputs`` are the earlier ones. Raises UsageError when the bus is not open, BusError when it is over.
        """
        self.check_open()
        with self._reason_of_the_end():
            await self.runtime.hand_over_outputs()
        self._raise_refused()

    async def ready(self, timeout: float | None = 5.0) -> None:
        """Wait until every slave in service is in data exchange. Raises SlaveFault or SlaveTimeout for the first that
        is not.
        """
        loop = asyncio.get_running_loop()
        end = None if timeout is None else loop.time() + timeout
        for slave in [slave for slave in self._slaves.values() if not slave.deactivated]:
            await slave.ready(None if end is None else max(0.0, end - loop.time()))

    async def sync(self, groups: Groups = (), *, settle: bool = False) -> ControlSent:
        """SYNC to ``groups`` (0 or nothing: all slaves): the slaves apply their last received outputs at one moment,
        and later ones with the next SYNC. Returns when the last bit of the telegram has left the line.

        ``settle``: first one whole Data_Exchange with each slave, so that it has the outputs set just now. The master
        never repeats the telegram. Raises UsageError in Stop or for slaves without ``sync``, SlaveFault, BusError (no
        token).
        """
        return await send_control(self, groups, sync=True, settle=settle)

    async def unsync(self, groups: Groups = ()) -> ControlSent:
        """End SYNC."""
        return await send_control(self, groups, unsync=True)

    async def freeze(self, groups: Groups = ()) -> ControlSent:
        """FREEZE: the slaves keep the inputs of this moment until the next FREEZE. Otherwise as :meth:`sync`."""
        return await send_control(self, groups, freeze=True)

    async def unfreeze(self, groups: Groups = ()) -> ControlSent:
        """End FREEZE."""
        return await send_control(self, groups, unfreeze=True)

    def group(self, groups: Groups = ()) -> Group:
        """A group of slaves that change outputs, and sample inputs, at one moment, see
        :class:`~dpstack.api.bus.sync_freeze.Group`."""
        return Group(self, groups)

    async def add_slave(self, table: SlaveTable) -> Slave:
        """Add a slave while the bus runs: ``table`` has the keys of a [[slave]] table. Raises ConfigError.

        With ``port="virtual"`` it is simulated like the others. Findings of the plan about it come as notices.
        """
        config = table if isinstance(table, SlaveConfig) else slave_config(table)
        others = list(self.view.setups.values())
        if any(other.name == config.name for other in others):
            raise ConfigError(f"there is a slave called {config.name!r} already: give the new one another name")
        setup = self.fitting(config)
        slave = await run_through_cancellation(self._add(config, setup))
        for note in (*config.notes, *new_plan_texts(self.config, self.plan, others, setup)):
            self.notice("plan", note, Severity.WARNING)
        return slave

    async def _add(self, config: SlaveConfig, setup: SlaveParams) -> Slave:
        await self.order(AddSlave(setup))
        if self.bench is not None:
            self.bench.add(config)
        try:
            plugin = await self.parts.attach(config)
        except DpError:
            await self.order(RemoveSlave(setup.address))
            raise
        return self._register(config, plugin)

    async def remove(self, slave: Slave | str | int) -> None:
        """Remove a slave: safe outputs for 50 ms, then Unlock.

        Returns when the master has the order. The bus does not end before the removal is over, and a slave added at
        the same address waits for it.
        """
        address = slave.address if isinstance(slave, Slave) else self.slave(slave).address
        await run_through_cancellation(self._remove(address))

    async def _remove(self, address: int) -> None:
        await self.order(RemoveSlave(address))
        self._round_ns = None
        del self._slaves[address]
        self.services.alarms.forget(address)
        drive = self._drives.pop(address, None)
        if drive is not None:
            drive.end(UsageError(f"drive {drive.name} was removed from the bus"))

    # --- stations, events, cycles, statistics ---------------------------------------------------------------------

    async def scan(
        self, *, configs: bool = False, addresses: Iterable[int] = ALL_ADDRESSES, quick: bool | None = None
    ) -> tuple[Found, ...]:
        """The live list 0..126 without this station, with ident, state and owner of each slave. Slaves do not change.

        ``configs``: ask for the identifier octets too. ``quick``: ask silent addresses one after the other, without
        the pauses that data exchange needs on a slow port (default: while no slave of this bus is in data exchange).
        """
        if quick is None:
            quick = not any(slave.ready_now for slave in self.slaves if not self.view.read_only)
        own = self.params.address
        mine = {} if self.view.read_only else {slave.address: slave for slave in self.slaves}
        token = self.services.token()
        order = SurveyOrder(token, tuple(addresses), tuple(mine), configs=configs, quick=quick)
        try:
            result = await self.services.answer_to(order, ScanDone)
        finally:
            with contextlib.suppress(DpError):  # the bus may have ended meanwhile
                self.command(DetachUser(token))
        self.unreadable = frozenset(result.unreadable)
        return tuple(_with_state_of(found, mine.get(found.address), own) for found in result.found)

    async def why(
        self, slave: Slave | str | int, *, ask: bool = True, scan: bool = True, master: int | None = None
    ) -> Story:
        """The story of a slave: its last bring-up step by step, and the likely causes why it is not in data exchange.

        ``ask``: send it Slave_Diag and Get_Cfg, which change nothing; without it, only what was seen so far counts.
        ``scan``: where nobody, or another device, answers at its address, ask the other addresses, for 20 s at most.
        ``master``: the address that the master of the slave should have, on a read-only bus (default: the one that it
        names). Raises UsageError for an unknown slave.
        """

        def asked(addresses: Iterable[int]) -> Awaitable[tuple[Found, ...]]:
            return self.scan(configs=True, addresses=addresses)

        found = slave if isinstance(slave, Slave) else self.slave(slave)
        return tell(await gather(self, found, asked if scan else None, ask=ask, master=master))

    def events(self) -> EventStream:
        """The events since the start of the bus, an async iterator. It keeps 1000; ``dropped`` counts the lost ones.

        A program may leave it without ``close()``: it is forgotten once nothing refers to it.
        """
        return self._events.stream()

    def publish(self, event: Event) -> None:
        """Hand ``event`` to all readers of :meth:`events`, and to ``on_event``."""
        self._events.publish(event)

    def live(self, interval: float = 0.1) -> LiveStream:
        """Plant, snapshots and events of the bus as one stream of plain data (docs/reference/live.md), an async
        iterator.

        A snapshot comes every ``interval`` seconds (0.02 or more), an event at once. A slow reader gets the latest
        snapshot and up to 1000 events; the bus never waits. It ends with the bus, or by ``close()``.
        """
        return self._live.join(checked_interval(interval))

    def cycles(self) -> AsyncIterator[Cycle]:
        """A :class:`~dpstack.api.bus.cycles.Cycle` for each round of data exchange, with or without a fixed cycle.

        A slow reader gets the latest one; ``cycle.skipped`` counts the missed ones. The next cycle sends all outputs
        that the body has set before it begins. Ends with the bus.
        """
        return self._cycles.read()

    def record(
        self,
        path: str | Path | BusRecording,
        *,
        on_change: bool = False,
        dead_band: float = 0.0,
        rotate: str | None = None,
    ) -> BusRecording:
        """Keep named values, states and drive quantities of every round in the file ``path``, which ends in .csv,
        .jsonl or .parquet (docs/how-to/record.md). Recording begins at once, and never delays the bus.

        ``on_change``: only rounds in which a value has changed by more than its ``dead_band`` (here: of all numbers, in
        their units; the key ``dead_band`` of a field if it is greater). ``rotate``: a new file after a size or a time,
        "100MB" or "1h". It ends with ``await recording.stop()``, with its ``async with`` block, or with the bus.
        ``paths``, ``rows``, ``lost`` and ``troubles`` tell how far it is.

        Raises UsageError for a file that is there already or cannot be made, for .parquet without pyarrow, on a bus
        that is not open, and on a read-only one.
        """
        self.check_open()
        if not isinstance(path, BusRecording):
            path = BusRecording(path, on_change=on_change, dead_band=dead_band, rotate=rotate)
        try:
            path.start(self)
        except BaseException:
            path.discard()
            raise
        self._recordings = [recording for recording in self._recordings if not recording.is_over] + [path]
        return path

    @property
    def stats(self) -> BusStats:
        """Counters and rotation times up to now."""
        return bus_figures(self, self.slaves)

    @property
    def seconds_in_ring(self) -> float:
        """Bus time in seconds since this master received, or claimed, its first token; 0 before that."""
        return ns_to_s(self.runtime.now() - self._joined_ns) if self._joined_ns else 0.0

    async def rotated(self, rotations: int | None, timeout: float | None = None) -> None:
        """Wait until the bus has had ``rotations`` rotations in all (None: for ever). Raises TimeoutError."""
        if rotations is None:
            await self.until(lambda: False, timeout)
            return
        with self.rounds.watched(self._waiters.check):
            await self.until(lambda: self.view.rotations >= rotations, timeout)

    # --- events and failures of the machine -----------------------------------------------------------------------

    def _on_events(self, events: list[Event]) -> None:
        for event in events:
            self._ordered_end.on_event(event)
            if self.services.handle_event(event):  # only the caller that awaits this service gets it
                continue
            if isinstance(event, ModeChanged):
                for recording in self._recordings:
                    recording.mode = event.mode
            match event:
                case DriveEvent(address=address, payload=payload):
                    drive = self._drives.get(address)
                    if drive is not None:
                        drive.on_payload(payload, event.t_ns)
                case SlaveStateChanged(address=address) if address in self._drives:
                    self._drives[address].publish_status()
                case AddressCollision():
                    self.collision = event.text
                case ForcedClear():
                    self.forced_clear = event
                case ModeChanged(mode=mode) if mode is not Mode.CLEAR:
                    self.forced_clear = None
                case OperateWaits():
                    self.forced_clear = None
            self._events.publish(event)
            for notice in self._other_masters.notices(event):
                self._events.publish(notice)
            if isinstance(event, RingJoined) and not self._joined_ns:
                self._joined_ns = event.t_ns
                text, severity = listening_report(self.params.address, self.view)
                self._events.publish(Notice(t_ns=event.t_ns, source="bus", message=text, severity=severity))
        self._waiters.check()

    def _on_refused(self, order: object, error: DpError) -> None:
        """The bus process did not carry out an order that nobody awaits."""
        self.notice("bus", f"{type(order).__name__} was not carried out: {error}", Severity.ERROR)
        match order:
            case DriveCommand(address=address, token=token) if address in self._drives:
                self._drives[address].on_refused(token, error)
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
        """Every pending and later call raises ``error``, or the first one where this was called before."""
        if self._over is None:
            self._over = error
        self._ordered_end.is_over()
        for drive in self._drives.values():
            drive.end(self._over)
        self._cycles.end()
        self.services.end(self._over)
        self._events.end()
        self._live.end(str(self._over))
        self._waiters.check()


def _with_state_of(found: Found, slave: Slave | None, own: int) -> Found:
    """``found`` with the master's own state of ``slave``. (The scan sends it no diagnosis request: the answer would
    reset the diagnosis flag, and the master would miss a new diagnosis.)"""
    if slave is None or found.kind is not StationType.SLAVE:
        return found
    exchanging = slave.state is SlaveState.DATA_EXCHANGE
    return dataclasses.replace(
        found,
        state=SlaveView.DATA_EXCHANGE if exchanging else view_of(slave.diagnosis),
        ident=None if slave.diagnosis is None else slave.diagnosis.ident,
        master=own if exchanging else None,
        config=slave.setup.config if exchanging else None,
        diagnosis=slave.diagnosis,
    )


def open_bus(
    config: str | Path | Config | None = None,
    *,
    port: str | None = None,
    baud: int | Literal["auto"] | None = None,
    address: int | None = None,
    driver: Literal["auto", "asyncio", "process"] | None = None,
    slaves: Iterable[SlaveTable] = (),
    on_event: OnEvent | None = None,
    join_timeout: float | None = None,
    world: World | None = None,
    **bus: object,
) -> Bus:
    """A bus from a configuration file (``port``, ``baud``, ``address`` override it), or from arguments alone.

    Use it as ``async with open_bus(...) as bus``: entering listens, joins the token ring and begins to bring the slaves
    up in Clear; ``await bus.operate()`` lets outputs out. ``slaves`` are mappings with the keys of a [[slave]] table,
    ``bus`` further keys of [bus]. ``driver="process"``: the bus runs in a process of its own, which the application
    cannot hold up (docs/explanation/drivers.md). ``port="virtual"`` simulates the slaves in this process. ``on_event``
    is called for every event at once; ``world`` joins an existing simulated bus (see :func:`simulate`).
    ``join_timeout`` in seconds: how long to wait for the token beside other masters (default: two passes over a GAP
    like this master's, 30 s at least).

    ``baud="auto"``: entering listens for the rate first. Until it is found ``bus.searching`` is true, and what depends
    on it (``plan``, ``params``, slaves and drives) raises UsageError. After 5 s of silence it gives up: a master that
    is alone on its bus must give the rate.

    Raises ConfigError here, with "auto" on entering; PortError and BusError on entering.
    """
    if config is None:
        if baud is None:
            raise ConfigError("open_bus: no baud; give for instance baud=500000, or a configuration file")
        if port is None and world is None:
            raise ConfigError('open_bus: no port; give for instance port="/dev/ttyUSB0", or "virtual"')
        own = 2 if address is None else address
        made = make_config(port or "virtual", baud, own, slaves, bus={"driver": driver, **bus})
    else:
        made = config if isinstance(config, Config) else load_config(config)
        made = made.with_bus(port=port, baud=baud, address=address, driver=driver, **bus).with_slaves(slaves)
    return Bus(made, on_event=on_event, join_timeout=join_timeout, world=world)
