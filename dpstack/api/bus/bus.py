"""``open_bus`` and ``Bus``: opening, modes, slaves, events and the end of a running bus."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
from collections.abc import AsyncIterator, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Literal

from dpstack.api.bus.compose import compose
from dpstack.api.bus.cycles import Cycle, Cycles
from dpstack.api.bus.find_baud import need_wire, rate_of
from dpstack.api.bus.parts import BusBase
from dpstack.api.bus.plan_checks import new_plan_texts
from dpstack.api.bus.ring_entry import OtherMasterNotices, heard_before_joining, join
from dpstack.api.bus.shutdown import OrderedEnd
from dpstack.api.bus.statistics import BusStats, collect
from dpstack.api.bus.sync_freeze import Group, Groups, send_control
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
from dpstack.drivers.futures import outlast, whole
from dpstack.errors import BusError, ConfigError, DpError, UsageError
from dpstack.fdl.commands import DetachUser, GoOnline
from dpstack.fdl.events import AddressCollision, RingJoined
from dpstack.fdl.livelist import ALL_ADDRESSES
from dpstack.fdl.telegram import StationType
from dpstack.sim.world import World
from dpstack.trace import Event, Notice, Severity
from dpstack.units import ns_to_s


class BusFailed(Notice):
    """The failure that ends the bus. Every pending and later call on the bus raises it as well."""


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
        #: the services of a class 2 master: diagnosis, configuration, inputs and outputs of any slave, its address
        self.class2 = Class2(self, self._slaves, self.slave)
        if not self.searching:
            self._build(config)
        elif world is None:
            need_wire(config.port)
        self._seal(Bus)

    def _build(self, config: Config) -> None:
        """Make the parts, now that the rate is in ``config``. Raises ConfigError."""
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

        It takes a few rotations, and never longer than :attr:`end_limit_s`. It goes through any number of
        cancellations; the cancellation is raised when it is over. It may be called in another event loop than the
        one that opened the bus. In a process that was forked from the one that opened the bus it does nothing.
        """
        if self.is_left or await self._ordered_end.elsewhere():
            return
        ending = self._begin_end()
        await outlast(ending)
        if not ending.cancelled():
            ending.result()

    def hurry(self) -> None:
        """End now, and leave out what is not needed to make outputs safe: within a second safe values and Clear are
        sent, as far as the bus still can, and the port is released. To be called in the bus's event loop; ``close()``
        waits for it.
        """
        self._ordered_end.hurry()
        if self.is_open:
            self._begin_end()

    @property
    def end_failed(self) -> bool:
        """True after an end in which slaves that had outputs got neither safe values nor Clear (dead port, no token,
        a bus process that hangs). An event tells it, and what the slaves do."""
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

    # --- orders -------------------------------------------------------------------------------------------------

    async def operate(self) -> None:
        """Outputs go out from the next rotation on; with ``auto_clear`` once all slaves are in data exchange.

        It ends a Clear that the master went to by itself (:attr:`forced_clear`), and arms the application watchdog.
        """
        self._raise_refused()
        await self.order(SetMode(Mode.OPERATE))

    def alive(self) -> None:
        """The application is alive: call it more often than ``application_watchdog_ms`` while the bus is in Operate.

        When it is not called for so long the master goes to Clear until :meth:`operate`. It changes nothing while the
        application watchdog is off, not armed, or has run out. Raises UsageError when the bus is not open.
        """
        self.check_open()
        if self.config.bus.application_watchdog_ms:
            self.command(Alive())

    async def clear(self) -> None:
        """Inputs are read, outputs are zero (empty for Fail_Safe slaves)."""
        await self.order(SetMode(Mode.CLEAR))
        self._raise_refused()

    async def stop(self) -> None:
        """Nothing more is sent to slaves (their watchdogs will expire); the master stays in the ring."""
        await self.order(SetMode(Mode.STOP))
        self._raise_refused()

    async def outputs_taken(self) -> None:
        """Wait until the master has the outputs that were set up to now; in Operate they go out in its next round.

        Raises OrderDropped where a bus process did not take them within 1 s: they will not go out, and
        ``Slave.outputs`` are those from before. Raises UsageError when the bus is not open, BusError when it is over.
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
        """SYNC to ``groups`` (0 or nothing: all slaves): what they were sent last goes to their outputs, all at once,
        and further outputs wait for the next SYNC. Returns when it has been sent, to the last bit.

        ``settle``: first one whole Data_Exchange with each, so that outputs set just now are passed on. Never sent
        twice. Raises UsageError in Stop or for slaves without ``sync``, SlaveFault, BusError (no token).
        """
        return await send_control(self, groups, sync=True, settle=settle)

    async def unsync(self, groups: Groups = ()) -> ControlSent:
        """End SYNC."""
        return await send_control(self, groups, unsync=True)

    async def freeze(self, groups: Groups = ()) -> ControlSent:
        """FREEZE: inputs of this moment are kept until the next FREEZE. Everything else as :meth:`sync`."""
        return await send_control(self, groups, freeze=True)

    async def unfreeze(self, groups: Groups = ()) -> ControlSent:
        """End FREEZE."""
        return await send_control(self, groups, unfreeze=True)

    def group(self, groups: Groups = ()) -> Group:
        """Slaves to be written at one moment and read at one moment, see
        :class:`~dpstack.api.bus.sync_freeze.Group`."""
        return Group(self, groups)

    async def add_slave(self, table: SlaveTable) -> Slave:
        """Take up one more slave while the bus runs: ``table`` has the keys of a [[slave]] table. Raises ConfigError.

        With ``port="virtual"`` it is simulated like the others. What the plan has to say about it comes as notices.
        """
        config = table if isinstance(table, SlaveConfig) else slave_config(table)
        others = list(self.view.setups.values())
        if any(other.name == config.name for other in others):
            raise ConfigError(f"there is a slave called {config.name!r} already: give the new one another name")
        setup = self.fitting(config)
        slave = await whole(self._add(config, setup))
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
        """Give a slave up: safe outputs for 50 ms, Unlock, then forget it.

        Returns when it has been ordered; the bus does not end before, and a slave added at its address waits.
        """
        address = slave.address if isinstance(slave, Slave) else self.slave(slave).address
        await whole(self._remove(address))

    async def _remove(self, address: int) -> None:
        await self.order(RemoveSlave(address))
        self._round_ns = None
        del self._slaves[address]
        self.services.alarms.forget(address)
        drive = self._drives.pop(address, None)
        if drive is not None:
            drive.end(UsageError(f"drive {drive.name} was removed from the bus"))

    # --- what there is ------------------------------------------------------------------------------------------

    async def scan(
        self, *, configs: bool = False, addresses: Iterable[int] = ALL_ADDRESSES, quick: bool | None = None
    ) -> tuple[Found, ...]:
        """The live list 0..126 without this station, with ident, state and owner of each slave; it changes nothing.

        ``configs``: ask for the identifier octets too. ``quick``: silent addresses without regard to the port's share
        for them (default: while no slave of this bus is in data exchange).
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
        return tuple(_with_own_knowledge(found, mine.get(found.address), own) for found in result.found)

    def events(self) -> EventStream:
        """What happens, from the start of the bus on: an async iterator, bounded; ``dropped`` counts what was lost."""
        return self._events.stream()

    def tell(self, event: Event) -> None:
        """Hand ``event`` to everybody who reads :meth:`events`, and to ``on_event``."""
        self._events.tell(event)

    def cycles(self) -> AsyncIterator[Cycle]:
        """One :class:`~dpstack.api.bus.cycles.Cycle` for each round of data exchange, with or without a fixed cycle.

        Latest wins, ``cycle.skipped`` says how many were missed. Outputs set in the body before the next cycle begins
        go out in that one, all together. Ends with the bus.
        """
        return self._cycles.read()

    @property
    def stats(self) -> BusStats:
        """Counters and rotation times up to now."""
        return collect(self)

    @property
    def seconds_in_ring(self) -> float:
        """Bus time since this master was given, or claimed, its first token in seconds; 0 before that."""
        return ns_to_s(self.runtime.now() - self._joined_ns) if self._joined_ns else 0.0

    async def rotated(self, rotations: int | None, timeout: float | None = None) -> None:
        """Wait until there were so many rotations in all (None: for ever). Raises TimeoutError."""
        if rotations is None:
            await self.until(lambda: False, timeout)
            return
        with self.rounds.watched(self._waiters.check):
            await self.until(lambda: self.view.rotations >= rotations, timeout)

    # --- from the machine ---------------------------------------------------------------------------------------

    def _on_events(self, events: list[Event]) -> None:
        for event in events:
            self._ordered_end.on_event(event)
            if self.services.handle_event(event):  # only the caller that awaits this service gets it
                continue
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
            self._events.tell(event)
            for notice in self._other_masters.notices(event):
                self._events.tell(notice)
            if isinstance(event, RingJoined) and not self._joined_ns:
                self._joined_ns = event.t_ns
                text, severity = heard_before_joining(self.params.address, self.view)
                self._events.tell(Notice(t_ns=event.t_ns, source="bus", message=text, severity=severity))
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
        """The bus no longer runs: pending calls raise ``error``. Anything but a BusError is a defect of dpstack."""
        failure = error
        if not isinstance(failure, BusError):
            text = f"the bus was stopped by a defect in dpstack ({type(error).__name__}: {error}); please report it"
            failure = BusError(text)
            failure.__cause__ = error
        now = self.runtime.now()
        self._events.tell(BusFailed(t_ns=now, source="bus", message=str(failure), severity=Severity.ERROR))
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
        self._waiters.check()


def _with_own_knowledge(found: Found, slave: Slave | None, own: int) -> Found:
    """``found`` with the state that the master itself has of ``slave``. (A diagnosis request of the scan would take a
    new diagnosis away from the master.)"""
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
    cannot hold up (docs/drivers.md). ``port="virtual"`` simulates the slaves in this process. ``on_event`` is called
    for every event at once; ``world`` joins an existing simulated bus (see :func:`simulate`). ``join_timeout`` in
    seconds: how long to wait for the token beside other masters (default: two passes over a GAP like this master's,
    30 s at least).

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
