"""Base class of ``BusCore``: the objects behind a bus (once the baud rate is known), slaves, commands, waiting."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from dpstack.api.bus.compose import Parts
from dpstack.api.bus.driver_choice import ASYNCIO, PROCESS
from dpstack.api.bus.events_json import EventLogging
from dpstack.api.bus.plan_checks import refuse_forbidden, refuse_misfit
from dpstack.api.config.config import AUTO, Config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave.services import Services
from dpstack.api.slave.slave import Slave
from dpstack.api.streams import Events, OnEvent, Rounds, Waiters, WallClock, load_beside
from dpstack.argcheck import seconds
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import ForcedClear
from dpstack.dp.plan.plan import Plan
from dpstack.dp.plan.rotation_time import Case
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.line.shutdown import end_limit_ns
from dpstack.drivers.runtime import PortDisturbed, Runtime
from dpstack.drivers.snapshots import BusSnapshot, View
from dpstack.errors import BusError, DpError, UsageError
from dpstack.params import BusParams
from dpstack.trace import Event, Notice, Severity
from dpstack.units import ns_to_s

if TYPE_CHECKING:
    from dpstack.api.ppi.polling import CpuPolling
    from dpstack.api.refused_orders import RefusedOrders
    from dpstack.api.slave.block_units import BlockUnits
    from dpstack.api.slave.device_orders import DeviceOrders
    from dpstack.api.slave.drive import Drive
    from dpstack.api.slave.quality_events import QualityEvents
    from dpstack.api.slave_side.virtual_bench import VirtualBench
    from dpstack.sim.world import World

SEARCHING: Final = "searching for the baud rate"


class BusBase:
    """The inside of a bus, as far as the other modules of this package need it.

    With the baud rate "auto" all properties of the objects behind the bus raise UsageError until it is found."""

    def __init__(self, config: Config, on_event: OnEvent | None) -> None:
        self.config = config
        #: addresses whose answers to the last scan could not be read
        self.unreadable: frozenset[int] = frozenset()
        #: machine time of the start in ns
        self.started_ns = 0
        #: text of the address collision with another station; None without one
        self.collision: str | None = None
        #: the last disturbance of the port by another program
        self.disturbed: PortDisturbed | None = None
        #: addresses of the slaves that GAP polls have found
        self.gap_slaves: set[int] = set()
        #: the event of a Clear that the master went to by itself, until Operate is ordered
        self.forced_clear: ForcedClear | None = None
        self.services = Services(self.command, self.order, lambda: self.is_open, self.load_layouts)
        self._has_layouts = False  # the bus process has loaded them
        self._slaves: dict[int, Slave] = {}
        self._drives: dict[int, tuple[Drive, ...]] = {}  # by address, in the order of the configuration
        self._device_orders: dict[int, DeviceOrders] = {}
        self._block_units: dict[int, BlockUnits] = {}
        #: the S7-200 CPUs of the configuration by address
        self.cpus: dict[int, CpuPolling] = {}
        self._wall_clock = WallClock(lambda: self.runtime.now(), lambda: self.driver == "virtual")
        log = EventLogging(lambda: (self.started_ns, self.runtime.port_name))
        self._events = Events(on_event, self._wall_clock, log)
        self._quality_events: QualityEvents | None = None
        self._refused_orders: RefusedOrders | None = None
        self._waiters = Waiters()
        self._open = False
        self._loop: asyncio.AbstractEventLoop | None = None  # in which it was opened
        self._ending: asyncio.Task[None] | None = None
        self._left = False
        #: the failure or the end after which the bus does nothing
        self._over: DpError | None = None
        self._refused: DpError | None = None  # of an order that no caller awaited
        self._parts: Parts | None = None
        self._round_ns: int | None = None  # None: not calculated for the slaves of this moment

    @property
    def searching(self) -> bool:
        """True while the baud rate "auto" has not been found."""
        return self._parts is None and self.config.bus.baud == AUTO

    @property
    def parts(self) -> Parts:
        if self._parts is None:
            raise UsageError(f"{SEARCHING}: what depends on it is known once the bus is entered (async with)")
        return self._parts

    @property
    def plan(self) -> Plan:
        return self.parts.plan

    @property
    def params(self) -> BusParams:
        return self.parts.plan.params

    def fitting(self, slave: SlaveConfig) -> SlaveParams:
        """The parameters of ``slave`` for the master. Raises ConfigError if it must not have this master, or if
        the cycle has no time for it beside the others."""
        refuse_forbidden(self.config, [slave])
        others = [other for address, other in self.view.setups.items() if address != slave.address]
        refuse_misfit(self.config, self.plan, [*others, slave.params])
        self._round_ns = None
        return slave.params

    def poll_interval_ns(self, slave: SlaveParams) -> int:
        """Time from one Data_Exchange of ``slave`` to the next, see :attr:`round_ns`."""
        return self.round_ns * slave.every

    @property
    def round_ns(self) -> int:
        """Time of a round without repetitions and acyclic services in ns, as the plan calculates it for the slaves that
        are on the bus now."""
        if self._round_ns is None:
            counted = replace(self.plan.figures, setups=tuple(self.view.setups.values()))
            self._round_ns = counted.round_ns(Case.NORMAL)
        return self._round_ns

    @property
    def rotation_limit_s(self) -> float:
        """The longest round of the plan in seconds."""
        return ns_to_s(self.rotation_limit_ns)

    @property
    def rotation_limit_ns(self) -> int:
        """The longest round of the plan in ns."""
        return self.plan.figures.full_ns(Case.LONGEST)

    @property
    def mode(self) -> Mode:
        """The mode of the master; OFFLINE while its runtime does not run."""
        return self.view.mode if self.runtime.not_running is None else Mode.OFFLINE

    @property
    def view(self) -> View:
        """The snapshots of the bus."""
        return (self._parts or self.parts).view  # asked in every cycle: a property of a property would cost three times

    @property
    def snapshot(self) -> BusSnapshot:
        """The last snapshot: mode, token ring and its masters, SYNC and FREEZE, stations found."""
        return self.parts.view.bus()

    @property
    def driver(self) -> str:
        """The driver: "asyncio", "process", or "virtual" on a simulated bus."""
        return self.parts.driver

    @property
    def runtime(self) -> Runtime:
        return (self._parts or self.parts).runtime

    @property
    def rounds(self) -> Rounds:
        """Callbacks at the end of each round of data exchange."""
        return self.parts.rounds

    @property
    def world(self) -> World | None:
        """The simulated bus when there is one."""
        return self.parts.world

    @property
    def bench(self) -> VirtualBench | None:
        """The simulated slaves of this bus; None without any."""
        return self.parts.bench

    # --- slaves and drives ---------------------------------------------------------------------------------------

    @property
    def by_address(self) -> Mapping[int, Slave]:
        """The slaves by address, also those added later."""
        return self._slaves

    @property
    def slaves(self) -> tuple[Slave, ...]:
        return tuple(self._slaves[address] for address in sorted(self._slaves))

    @property
    def drives(self) -> tuple[Drive, ...]:
        return tuple(drive for address in sorted(self._drives) for drive in self._drives[address])

    def drives_at(self, address: int) -> tuple[Drive, ...]:
        """The drives of the slave at ``address``; none for a slave without."""
        return self._drives.get(address, ())

    def slave(self, which: str | int) -> Slave:
        """A slave by name or address. Raises UsageError, which lists the slaves."""
        if type(which) is int and which in self._slaves:
            return self._slaves[which]
        for slave in self._slaves.values():
            if which in (slave.name, slave.address):
                return slave
        for polling in self.cpus.values():
            if type(which) is not bool and which in (polling.config.name, polling.config.address):
                state = polling.fault or "it answers"
                raise UsageError(f"{polling.config.who} is an S7-200, no DP slave (bus.cpu() has it): {state}")
        known = ", ".join(f"{s.name} ({s.address})" for s in self.slaves) or "none"
        raise UsageError(f"no slave {which!r} on this bus; there are: {known}")

    def cpu(self, which: str | int) -> CpuPolling:
        """An S7-200 by name or address. Raises UsageError, which lists them."""
        for polling in self.cpus.values():
            if type(which) is not bool and which in (polling.config.name, polling.config.address):
                return polling
        known = ", ".join(f"{one.config.name} ({address})" for address, one in self.cpus.items()) or "none"
        raise UsageError(f"no CPU {which!r} on this bus; there are: {known}")

    def drive(self, which: str | int) -> Drive:
        """A drive by name or address. Raises UsageError, which lists the drives, also for the address or the name of a
        slave with several."""
        found = [one for one in self.drives if which == one.name] or [
            one for one in self.drives if which in (one.slave.address, one.slave.name)
        ]
        if len(found) == 1:
            return found[0]
        if found:
            names = ", ".join(one.name for one in found)
            raise UsageError(f"{found[0].slave.who} has several drives: name one of {names}")
        known = ", ".join(d.name for d in self.drives) or "none"
        raise UsageError(f"no drive {which!r} on this bus; there are: {known}")

    # --- commands and waiting ------------------------------------------------------------------------------------

    @property
    def was_opened(self) -> bool:
        """True from the opening on, also after the end: before, ``started_ns`` and ``seconds`` mean nothing."""
        return self._open or self._ending is not None or self._over is not None

    @property
    def is_open(self) -> bool:
        """True between a successful opening and the end."""
        return self._open and self._ending is None

    def command(self, command: object) -> None:
        """Hand an order to the machine. Raises UsageError when the bus is not open.

        If the bus process refuses the order, a notice reports it, and the next ``operate()``, ``clear()``, ``stop()``
        or ``outputs_taken()`` raises the refusal.
        """
        self.check_open()
        with self._reason_of_the_end():
            self.runtime.command(command)

    async def order(self, command: object) -> None:
        """As :meth:`command`; returns when the machine has carried it out, and raises the machine's exception."""
        self.check_open()
        self._check_loop()
        with self._reason_of_the_end():
            await self.runtime.order(command)

    async def load_layouts(self) -> None:
        """Before the first acyclic service: in the loop of a bus the import of construct would hold it up 10 ms, and a
        bus process has no such services yet. (In virtual time it takes none.)"""
        if self.driver == ASYNCIO:
            await load_beside("construct")
        elif self.driver == PROCESS and not self._has_layouts:
            from dpstack.drivers.process.messages import LoadServices  # here, as the other drivers need nothing of it

            await self.order(LoadServices())
            self._has_layouts = True

    def check_open(self) -> None:
        """Raises UsageError when the bus is not open."""
        if self._over is not None and self.is_left:
            raise self._over
        if not self._open:
            if self._ending is not None:
                raise UsageError("the bus is not open any more: make a new one with open_bus()")
            raise UsageError(
                "the bus is not open: use it inside `async with open_bus(...)` (dpstack.blocking: `with`), "
                "or call open() first"
            )

    def _check_loop(self) -> None:
        """Raises UsageError in another event loop than that of the bus: it would wait in vain."""
        if self._loop is not None and self._loop is not asyncio.get_running_loop():
            raise UsageError(
                "this bus lives in another event loop than the caller: await it in the loop that opened it; in a test "
                "with dpstack_bus write bus.run(program()) instead of asyncio.run(program()) or of async def test_...()"
            )

    @contextlib.contextmanager
    def _reason_of_the_end(self) -> Iterator[None]:
        """Context manager: after the end of the bus, raise the reason of the end instead of a BusError."""
        try:
            yield
        except BusError:
            if self._over is not None:
                raise self._over from None
            raise

    def raise_refused(self) -> None:
        refused, self._refused = self._refused, None
        if refused is not None:
            raise refused

    async def until(self, condition: Callable[[], bool], timeout: float | None = None) -> None:
        """Wait until ``condition()``, evaluated after every event, is true; it may raise. Raises TimeoutError, and
        UsageError when the bus is not open."""
        seconds("timeout", timeout)
        if self._over is None or isinstance(self._over, UsageError):  # the reason of a failure says more
            self.check_open()
        self._check_loop()

        def condition_or_end() -> bool:
            if self._over is not None:
                raise self._over
            return condition()

        await self._waiters.until(condition_or_end, timeout)

    async def until_round(self, condition: Callable[[], bool], timeout: float | None = None) -> None:
        """As :meth:`until`; ``condition()`` is evaluated after every round of data exchange, too."""
        with self.rounds.watched(self._waiters.check):
            await self.until(condition, timeout)

    @property
    def seconds(self) -> float:
        """Bus time since the start in seconds."""
        return ns_to_s(self.runtime.now() - self.started_ns)

    def wall_ns(self, t_ns: int) -> int:
        """The wall clock in ns at the machine's time ``t_ns``, as events have it."""
        return self._wall_clock.wall_ns(t_ns)

    def notice(self, source: str, message: str, severity: Severity = Severity.INFO) -> None:
        """Publish ``message`` as an event."""
        self._events.publish(Notice(t_ns=self.runtime.now(), source=source, message=message, severity=severity))

    @property
    def refused_orders(self) -> RefusedOrders:
        """Takes the orders from outside that are refused, and reports them."""
        if self._refused_orders is None:
            from dpstack.api.refused_orders import RefusedOrders  # here, as most buses get no order from outside

            self._refused_orders = RefusedOrders(
                self._events.publish, lambda: 0 if self.searching else self.runtime.now()
            )
        return self._refused_orders

    def past_events(self) -> tuple[Event, ...]:
        """The last 1000 events, oldest first."""
        return self._events.past

    def listen_to_events(self, listener: OnEvent | None) -> None:
        """Call ``listener`` for each event from now on; None: no longer. There is one listener at a time."""
        self._events.listener = listener

    # --- the end ------------------------------------------------------------------------------------------------

    @property
    def end_limit_s(self) -> float:
        """Upper limit of the time (s) that the end of the bus takes."""
        return ns_to_s(end_limit_ns(self.params, self.rotation_limit_ns) + self.runtime.close_limit_ns)

    @property
    def ender(self) -> asyncio.Task[None] | None:
        """The task that carries out the end; None before."""
        return self._ending

    @property
    def is_left(self) -> bool:
        """True after the end by a finaliser, and in a forked child: ``close()`` does nothing."""
        return self._left

    def leave(self, why: DpError) -> None:
        """End without :meth:`close` and without the event loop; later calls raise ``why``."""
        self._open = False
        self._left = True
        self._over = why
