"""What a bus consists of once its baud rate is known: its parts, its slaves, orders to it, waiting for it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Final

from dpstack.api.bus.compose import Parts
from dpstack.api.bus.find_baud import need_wire, rate_of
from dpstack.api.bus.plan_checks import refuse_misfit
from dpstack.api.config.config import AUTO, Config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.server.virtual_bench import VirtualBench
from dpstack.api.slave.drive import Drive
from dpstack.api.slave.services import Services
from dpstack.api.slave.slave import Slave
from dpstack.api.streams import Events, OnEvent, Rounds, Waiters
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import ForcedClear
from dpstack.dp.plan.plan import Case, Plan
from dpstack.dp.plan.rotation_time import figures
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.runtime import Runtime
from dpstack.drivers.shutdown import end_limit_ns
from dpstack.drivers.snapshots import BusSnapshot, View
from dpstack.errors import BusError, DpError, UsageError
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Notice, Severity
from dpstack.units import ns_to_s

SEARCHING: Final = "searching for the baud rate"


class Composed:
    """Made by ``make`` of a ``config``: at once, or once the rate is found where it is "auto".

    Until then every part raises UsageError. ``world``: the simulated bus to find it on, if any. Raises ConfigError
    where nothing can be found.
    """

    def __init__(
        self, config: Config, make: Callable[[Config], Parts], world: World | None, on_event: OnEvent | None
    ) -> None:
        self.config = config
        #: addresses whose answers to the last scan could not be read
        self.unreadable: frozenset[int] = frozenset()
        #: machine time of the start in ns
        self.started_ns = 0
        #: what was heard of another station at this one's address
        self.collision: str | None = None
        #: why the master is in Clear by itself, until Operate is ordered; None while it is not
        self.forced_clear: ForcedClear | None = None
        self.services = Services(self.command, self.order, lambda: self.is_open)
        self._slaves: dict[int, Slave] = {}
        self._drives: dict[int, Drive] = {}
        self._events = Events(on_event)
        self._waiters = Waiters()
        self._open = False
        self._ending: asyncio.Task[None] | None = None
        self._left = False
        #: why nothing will happen any more: a failure, or the end
        self._over: DpError | None = None
        self._refused: DpError | None = None  # an order that was not awaited
        self._given_world = world
        self._make = make
        self._parts: Parts | None = None
        self._round_ns: int | None = None  # None: to be counted again
        if self.searching and world is None:
            need_wire(config.port)

    def _build(self, config: Config) -> None:
        """Make the parts, now that the rate is in ``config``. Raises ConfigError."""
        self._parts = self._make(config)
        self.config = config

    async def _find_rate(self) -> str | None:
        """Listen for the rate where it is to be found, then make the parts; what it was recognised by, for people.

        Raises BusError, ConfigError, PortError.
        """
        if not self.searching:
            return None
        report = await rate_of(self.config, self._given_world)
        self._build(self.config.with_bus(baud=report.baud))
        return report.text

    @property
    def searching(self) -> bool:
        """The baud rate is to be found and not known yet."""
        return self._parts is None and self.config.bus.baud == AUTO

    @property
    def parts(self) -> Parts:
        """All of them."""
        if self._parts is None:
            raise UsageError(f"{SEARCHING}: what depends on it is known once the bus is entered (async with)")
        return self._parts

    @property
    def plan(self) -> Plan:
        """Rotation times, watchdogs, findings."""
        return self.parts.plan

    @property
    def params(self) -> BusParams:
        """The bus parameters."""
        return self.parts.plan.params

    def fitting(self, slave: SlaveConfig) -> SlaveParams:
        """``slave`` for the master, beside all others. Raises ConfigError where the cycle has no room for it."""
        others = [other for address, other in self.view.setups.items() if address != slave.address]
        refuse_misfit(self.config, self.plan, [*others, slave.params])
        self._round_ns = None
        return slave.params

    def poll_interval_ns(self, slave: SlaveParams) -> int:
        """The time from one Data_Exchange of ``slave`` to the next where nothing is repeated and no service is beside
        it, as the plan counts it with the slaves that are on the bus now."""
        if self._round_ns is None:
            counted = self.plan.figures
            setups = list(self.view.setups.values())
            if setups != list(counted.setups):
                counted = figures(
                    counted.params,
                    setups,
                    others=counted.others,
                    cycle_ns=counted.cycle_ns,
                    host_slack_ns=counted.host_slack_ns,
                )
            self._round_ns = counted.round_ns(Case.NORMAL)
        return self._round_ns * slave.every

    @property
    def rotation_limit_s(self) -> float:
        """The longest rotation of the plan in seconds."""
        return ns_to_s(self.rotation_limit_ns)

    @property
    def rotation_limit_ns(self) -> int:
        """The longest rotation of the plan in ns."""
        return self.plan.rotation_ns(Case.LONGEST)

    @property
    def mode(self) -> Mode:
        """The mode of the master; OFFLINE while nobody keeps it running."""
        return self.snapshot.mode if self.runtime.not_running is None else Mode.OFFLINE

    @property
    def view(self) -> View:
        """Where the snapshots of the bus are found."""
        return self.parts.view

    @property
    def snapshot(self) -> BusSnapshot:
        """Mode, token ring and its masters, SYNC and FREEZE, the stations found: as the bus told them last."""
        return self.parts.view.bus()

    @property
    def driver(self) -> str:
        """What keeps it running: "asyncio", "process", or "virtual" on a simulated bus."""
        return self.parts.driver

    @property
    def runtime(self) -> Runtime:
        """What keeps it running."""
        return self.parts.runtime

    @property
    def rounds(self) -> Rounds:
        """The ends of the rounds with data exchange."""
        return self.parts.rounds

    @property
    def world(self) -> World | None:
        """The simulated bus when there is one."""
        return self.parts.world

    @property
    def bench(self) -> VirtualBench | None:
        """The simulated slaves, where they are part of this bus."""
        return self.parts.bench

    # --- slaves and drives ---------------------------------------------------------------------------------------

    @property
    def slaves(self) -> tuple[Slave, ...]:
        """All slaves by address."""
        return tuple(self._slaves[address] for address in sorted(self._slaves))

    @property
    def drives(self) -> tuple[Drive, ...]:
        """All drives by address."""
        return tuple(self._drives[address] for address in sorted(self._drives))

    def slave(self, which: str | int) -> Slave:
        """A slave by name or address. Raises UsageError naming those there are."""
        for slave in self._slaves.values():
            if which in (slave.name, slave.address):
                return slave
        known = ", ".join(f"{s.name} ({s.address})" for s in self.slaves) or "none"
        raise UsageError(f"no slave {which!r} on this bus; there are: {known}")

    def drive(self, which: str | int) -> Drive:
        """A drive by name or address. Raises UsageError naming those there are."""
        for drive in self._drives.values():
            if which in (drive.name, drive.slave.address):
                return drive
        known = ", ".join(d.name for d in self.drives) or "none"
        raise UsageError(f"no drive {which!r} on this bus; there are: {known}")

    # --- orders and what is waited for --------------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        """True between a successful opening and the end."""
        return self._open and self._ending is None

    def command(self, command: object) -> None:
        """Hand an order to the machine. Raises UsageError when the bus is not open.

        What a bus process refuses of it comes as a notice, and is raised by the next ``operate()``, ``clear()``,
        ``stop()`` or ``outputs_taken()``.
        """
        self.check_open()
        try:
            self.runtime.command(command)
        except BusError:
            if self._over is not None:
                raise self._over from None
            raise

    async def order(self, command: object) -> None:
        """As :meth:`command`; returns when the machine has carried it out. What it raises is raised here."""
        self.check_open()
        await self._unless_over(self.runtime.order(command))

    def check_open(self) -> None:
        """Raises UsageError when the bus is not open."""
        if self.is_left and self._over is not None:
            raise self._over
        if not self._open:
            raise UsageError("the bus is not open: use it inside `async with open_bus(...)`")

    async def _unless_over(self, order: Awaitable[object]) -> None:
        try:
            await order
        except BusError:
            if self._over is not None:
                raise self._over from None
            raise

    def _raise_refused(self) -> None:
        refused, self._refused = self._refused, None
        if refused is not None:
            raise refused

    async def until(self, condition: Callable[[], bool], timeout: float | None = None) -> None:
        """Wait until ``condition()``, judged after every event; what it raises is raised here. Raises TimeoutError."""

        def judged() -> bool:
            if self._over is not None:
                raise self._over
            return condition()

        await self._waiters.until(judged, timeout)

    @property
    def seconds(self) -> float:
        """Bus time since the start in seconds."""
        return ns_to_s(self.runtime.now() - self.started_ns)

    def notice(self, source: str, message: str, severity: Severity = Severity.INFO) -> None:
        """Tell ``message`` as an event."""
        self._events.tell(Notice(t_ns=self.runtime.now(), source=source, message=message, severity=severity))

    @property
    def collided(self) -> bool:
        """Another station uses this one's address."""
        return self.collision is not None

    # --- the end ------------------------------------------------------------------------------------------------

    @property
    def end_limit_s(self) -> float:
        """No end takes longer than this (s), whatever port and slaves do."""
        return ns_to_s(end_limit_ns(self.params, self.rotation_limit_ns) + self.runtime.close_limit_ns)

    @property
    def ender(self) -> asyncio.Task[None] | None:
        """The task that carries the end out, once it was begun."""
        return self._ending

    @property
    def is_left(self) -> bool:
        """A finaliser has ended it, or this process is a fork of its own: there is nothing to close."""
        return self._left

    def leave(self, why: DpError) -> None:
        """It is over without :meth:`close`; ``why`` is raised by every order. Its event loop is not touched."""
        self._open = False
        self._left = True
        self._over = why
