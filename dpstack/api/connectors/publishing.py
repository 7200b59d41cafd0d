"""``publish``: the connectors of a bus, which publish its plant, from beginning to end."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
from asyncio import FIRST_COMPLETED
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Final

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.driver_choice import PROCESS
from dpstack.api.bus.live import LiveStream, described_slaves
from dpstack.api.config.connectors import KEEP, ConnectorConfig, loss_text, read_connectors
from dpstack.api.connectors.kinds import KINDS, ConnectorKind, Parts
from dpstack.api.connectors.outside import OutsideOrders
from dpstack.api.streams import LEVELS, load_beside
from dpstack.bridge.connector import Connector, ConnectorState, RemarkReporter
from dpstack.bridge.gateway import END_S, TICK_S, Gateway
from dpstack.bridge.orders import Orders, check_allowed
from dpstack.dp.master.commands import Alive
from dpstack.errors import BusError, ConfigError, DpError, UsageError
from dpstack.plant.items import Item
from dpstack.plant.orders import DriveOrder, RefusedOrder, SetOutputs
from dpstack.plant.tree import PlantTree
from dpstack.ports import posix
from dpstack.text import printable
from dpstack.toml.table import Source
from dpstack.trace import Severity
from dpstack.units import NS_PER_S

#: s between two snapshots for the connectors
_INTERVAL_S: Final = 0.2
#: s that the connectors have for their nodes before the bus begins: 50 000 take some 10 s
_BUILD_S: Final = 60.0
#: s that the connectors have if the user is in a hurry, or the bus still runs
_HURRIED_S: Final = 0.5
#: s between two looks whether the user is in a hurry
_LOOK_S: Final = 0.1
#: s without a sign of life of the connectors after which they hang, and between two looks
HANG_S: Final = 5.0
_BEAT_S: Final = 1.0
#: remarks that are kept until the bus is open
_MOST_REMARKS: Final = 100
_SOURCE: Final = "connectors"
#: texts of Python and of the loader if there are no addresses left
_NO_THREAD: Final = "can't start new thread"
_NO_MAP: Final = ("failed to map segment", "annot allocate memory")
_LOG: Final = logging.getLogger("dpstack.bridge")


def publish(bus: Bus, **tables: Mapping[str, object]) -> Publishing:
    """Publish the plant of ``bus`` by its connectors, within ``async with publish(bus), bus:``. In this order a
    connector that cannot begin is known before anything is sent, and the end of the bus comes first, waits for no
    connector, and is published by them. A block inside that of the bus works, too.

    The connectors are those of its configuration file, or of ``tables``: mappings with the keys of the table of that
    name (docs/reference/configuration.md). They run in the event loop of the program, read the live stream, and never
    delay the bus if it has a process of its own. A connector that fails ends alone; a notice of the bus reports it.
    Leaving the block ends them, which takes 4.5 s at most, and 1 s while the bus is open.

    Raises ConfigError here, and UsageError for anything but a bus; on entering UsageError if the package of an extra
    is missing, and PortError or ConfigError if a connector cannot begin.
    """
    if not isinstance(bus, Bus):
        raise UsageError(
            "publish: it takes a bus of the same module: dpstack.publish one of dpstack.open_bus, "
            "dpstack.blocking.publish one of dpstack.blocking.open_bus"
        )
    source = Source("publish") if tables else bus.config.source
    made = read_connectors(source, tables) if tables else bus.config.connectors
    if not made:
        raise UsageError("publish: no connector is given: add a table to the configuration, for instance [mqtt]")
    return Publishing(bus, made, source)


class Publishing:
    """The connectors of a bus; an async context manager. Made by :func:`dpstack.publish`.

    It may be entered before the bus is opened: so a connector that cannot begin is known before anything goes on the
    bus.
    """

    #: remarks that came when the bus had ended, or never was open
    remarks: list[str]

    def __init__(
        self,
        bus: Bus,
        tables: Mapping[str, ConnectorConfig],
        source: Source | None = None,
        *,
        hurried: Callable[[], bool] | None = None,
    ) -> None:
        self._bus = bus
        self._tables = dict(tables)
        #: of the tables, for messages
        self._source = source or bus.config.source
        self._hurried = hurried or (lambda: False)
        self._tree = PlantTree()
        #: as the tree will have them
        self._slaves = described_slaves(bus.config)
        self._connectors: list[Connector] = []
        self._stream: LiveStream | None = None
        self._gateway: Gateway | None = None
        self._running: asyncio.Task[None] | None = None
        self._watching: asyncio.Task[None] | None = None
        self._outside = OutsideOrders(bus, self._tell)
        #: the gate of the orders of each connector that may give some, by its name
        self._gates: dict[str, Orders] = {}
        self._losing: set[asyncio.Task[None]] = set()
        #: the bus has a process of its own, which can act while this loop stands still
        self._arms = False
        self._armed = False
        self._has_reported_driver = False
        self._waiting: list[tuple[str, Severity]] = []
        self.remarks = []

    @property
    def connectors(self) -> tuple[str, ...]:
        """The names of the connectors that serve at this moment."""
        return () if self._gateway is None else tuple(connector.name for connector in self._gateway.connectors)

    async def __aenter__(self) -> Publishing:
        try:
            return await self._begin()
        except (MemoryError, RuntimeError) as error:
            if isinstance(error, RuntimeError) and str(error) != _NO_THREAD:
                raise
            raise self._no_memory(str(error) or type(error).__name__) from None

    def _check_room(self, kinds: Mapping[str, ConnectorKind]) -> None:
        """Raises BusError if the limit of addresses is too low: some packages end the program then, without a word
        that anybody could catch."""
        if not posix.is_available():
            return
        import resource  # here, as other systems have none

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if most == resource.RLIM_INFINITY:
            return
        with contextlib.suppress(OSError, ValueError):  # of another system than Linux
            left = most - int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            wanted = sum(kind.room_mb for kind in kinds.values()) << 20
            if left < wanted:
                raise self._no_memory(f"{left >> 20} MB of addresses are left, they take some {wanted >> 20}")

    def _no_memory(self, why: str) -> BusError:
        names = ", ".join(self._tables)
        return BusError(
            f"{names}: there is too little memory for them ({why}): raise that limit (ulimit -v, LimitAS= of systemd), "
            f"or take one of these tables out"
        )

    async def _begin(self) -> Publishing:
        kinds = {name: KINDS[name] for name in self._tables}
        for name, kind in kinds.items():
            for package in kind.needs:
                if find_spec(package) is None:
                    raise UsageError(f"[{name}] needs {package}: pip install 'dpstack[{name}]'")
        self._check_room(kinds)
        try:
            await load_beside(*(kind.module for kind in kinds.values()))
        except ImportError as error:
            if any(text in str(error) for text in _NO_MAP):
                raise self._no_memory(str(error)) from None
            names = ",".join(self._tables)
            raise UsageError(f"a connector cannot be loaded ({error}): pip install 'dpstack[{names}]'") from None
        try:
            for name, kind in kinds.items():
                tell = RemarkReporter(name, self._tell)
                orders = partial(self._orders, name, tell)
                parts = Parts(self._tree, tell, orders, self._slaves, self._connector_states, self._bus_pid)
                with self._blaming(name):
                    self._connectors.append(kind.make(self._tables[name], parts))
            for connector in self._connectors:
                with self._blaming(connector.name):
                    await connector.open()
            self._stream = self._bus.live(_INTERVAL_S)
            self._gateway = Gateway(
                self._items(self._stream),
                self._connectors,
                tree=self._tree,
                tell=self._tell,
                on_loss=lambda connector: self._lose(connector.name),
            )
        except BaseException:
            self._release()
            raise
        self._running = asyncio.create_task(self._gateway.run(), name="dpstack gateway")
        self._running.add_done_callback(self._ended)
        if self._gates and not self._bus.config.bus.read_only:
            self._tell(loss_text(self._gates, self._bus.config.bus.on_connector_loss), Severity.INFO)
            self._watching = asyncio.create_task(self._watch(), name="dpstack connectors: whether they hang")
        core_of(self._bus).before_opening.append(self._built)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        task, loop = self._running, asyncio.get_running_loop()
        assert task is not None
        limit = loop.time() + END_S + 2 * TICK_S
        try:
            # the end of a bus is on its way through the stream: the connectors publish it before they end
            if self._bus.is_open or not core_of(self._bus).was_opened:
                task.cancel()
            if self._bus.is_open:  # its end may be waiting for this one
                limit = loop.time() + _HURRIED_S
            while not (task.done() or self._hurried() or loop.time() > limit):
                await asyncio.wait((task,), timeout=_LOOK_S)
        finally:
            task.cancel()
            await asyncio.wait((task,), timeout=_HURRIED_S)
            for other in (self._watching, *self._losing):
                if other is not None:
                    other.cancel()
            self._release()

    # --- connectors that are lost ---------------------------------------------------------------------------------

    def _lose(self, *names: str, hang: bool = False) -> None:
        """The connectors ``names`` have ended by a fault or hang: none of their orders acts any more."""
        for name in names:
            if name in self._gates:
                self._gates[name].recall(for_ever=not hang)
        if self._bus.is_open:
            task = asyncio.create_task(self._outside.lose(names), name="dpstack connectors: safe values")
            self._losing.add(task)
            task.add_done_callback(self._losing.discard)

    async def _watch(self) -> None:
        """Find out that the connectors hang: by then also this loop, in which they run, stood still. If the bus has
        a process of its own, that goes to Clear meanwhile if something from outside is in effect."""
        assert self._gateway is not None
        assert self._running is not None
        loop = asyncio.get_running_loop()
        hung = False
        try:
            while not self._running.done():
                looked_at = loop.time()
                await asyncio.sleep(_BEAT_S)
                late_s = loop.time() - looked_at - _BEAT_S
                silent_s = max(late_s, loop.time() - self._gateway.beat - TICK_S)
                before, hung = hung, silent_s > HANG_S
                if hung and not before and not self._running.done():
                    why = " (this program was stopped, or its event loop was blocked)" if late_s > HANG_S else ""
                    self._tell(f"the connectors gave no sign of life for {silent_s:.0f} s{why}", Severity.ERROR)
                    self._lose(*self._gates, hang=True)
                self._arm(self._outside.in_effect)
        finally:
            self._arm(False)

    def _arm(self, wanted: bool) -> None:
        """Have the bus process go to Clear once this loop has stood still for :data:`HANG_S`, or no longer."""
        if self._arms and (wanted or self._armed) and self._bus.is_open:
            self._armed = wanted
            with contextlib.suppress(DpError):  # the bus process has ended, or is silent
                core_of(self._bus).command(Alive(limit_ns=round(HANG_S * NS_PER_S) if wanted else 0))

    def _connector_states(self) -> list[ConnectorState]:
        failed = [] if self._gateway is None else self._gateway.failed
        return [
            ConnectorState(connector.name, connector not in failed, connector.dropped, connector.connected)
            for connector in self._connectors
        ]

    def _bus_pid(self) -> int | None:
        return core_of(self._bus).runtime.pid if self._bus.is_open else None

    def _release(self) -> None:
        """Close the connectors and the stream, whatever happens."""
        if self._stream is not None:
            self._stream.close()
        for connector in self._connectors:
            try:
                connector.close()
            except Exception as error:
                self._tell(f"{connector.name}: {type(error).__name__}: {error}", Severity.WARNING)
        self.remarks += [text for text, severity in self._waiting if severity is not Severity.INFO]
        self._waiting.clear()

    async def _built(self) -> None:
        """Wait until the connectors have made their nodes, or are over: afterwards the bus must not wait for them."""
        assert self._gateway is not None
        assert self._running is not None
        building = asyncio.ensure_future(self._gateway.built())
        collects = gc.isenabled()
        gc.disable()  # the nodes stay: to look for garbage among them again and again takes half of this time
        try:
            done, _ = await asyncio.wait({building, self._running}, timeout=_BUILD_S, return_when=FIRST_COMPLETED)
            gc.freeze()  # nor does a collection while the bus runs, which would hold up its end
        finally:
            building.cancel()
            if collects:
                gc.enable()
        if not done:
            self._tell(
                f"connectors: their nodes are not made after {_BUILD_S:g} s; the bus begins now", Severity.WARNING
            )

    def _ended(self, task: asyncio.Task[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self._tell(f"all connectors have ended by a fault ({type(error).__name__}: {error})", Severity.ERROR)
            self._lose(*self._gates)

    @contextlib.contextmanager
    def _blaming(self, name: str) -> Iterator[None]:
        """Turn a ConfigError about a value into one with its place: the key that its text begins with, or the table."""
        try:
            yield
        except ConfigError as error:
            what, _, todo = str(error).partition("; ")
            key = what.partition(" ")[0].rstrip(":")
            raise self._source.error((name, key), f"[{name}]: {what}", todo or "correct it") from None

    # --- items and remarks ----------------------------------------------------------------------------------------

    async def _items(self, stream: LiveStream) -> AsyncIterator[Item]:
        async for item in stream:
            if self._bus.is_open and not self._has_reported_driver:
                self._has_reported_driver = True
                self._arms = self._bus.driver == PROCESS and self._bus.config.bus.on_connector_loss != KEEP
                self._report_where_they_run()
            yield item

    def _report_where_they_run(self) -> None:
        if self._bus.driver == "asyncio":
            names = ", ".join(self._tables)
            todo = 'with driver = "process" in [bus] they cannot delay it'
            self._tell(f"{names}: in the event loop of the bus; {todo}", Severity.INFO)
        self._report_waiting()

    def _tell(self, text: str, severity: Severity) -> None:
        """Publish a remark as a notice of the bus; before its start it waits, after its end it goes to the log."""
        text = printable(text)
        if self._bus.is_open:
            self._report_waiting()
            core_of(self._bus).notice(_SOURCE, text, severity)
        elif core_of(self._bus).was_opened:
            _LOG.log(LEVELS[severity], "%s", text)
            self.remarks.append(text)
        elif len(self._waiting) < _MOST_REMARKS:
            self._waiting.append((text, severity))

    def _report_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for text, severity in waiting:
            core_of(self._bus).notice(_SOURCE, text, severity)

    # --- orders ---------------------------------------------------------------------------------------------------

    def _read_only(self, name: str) -> str:
        """Why the value ``name`` (SLAVE.VALUE) of an S7-200 is no order; empty for another name."""
        where, _, value = name.rpartition(".")
        known = (cpu for cpu in self._bus.config.ppi if cpu.name == where)
        if any(value in cpu.values or value == "*" for cpu in known):
            return "values of an S7-200 are read-only; list it in allow_commands of its entry of ppi, too"
        return ""

    def _orders(self, name: str, tell: RemarkReporter, allow: Sequence[str], max_age_s: float) -> Orders:
        orders = (order.name for one in self._slaves.values() for order in one.orders)
        check_allowed(allow, orders, self._read_only)
        gate = Orders(
            self._tree,
            partial(self._carry_out, name),
            allow,
            max_age_s=max_age_s,
            tell=tell,
            refused=self._refused,
            origin=name,
        )
        if gate.takes_any:
            self._gates[name] = gate
        return gate

    def _refused(self, order: RefusedOrder) -> None:
        """Report an order that was refused; behind the end of the bus nothing reports it."""
        if self._bus.is_open:
            core_of(self._bus).refused_orders.add(order)
        elif not core_of(self._bus).was_opened:
            self._tell(order.text, Severity.WARNING)

    async def _carry_out(self, name: str, order: SetOutputs | DriveOrder) -> object:
        if self._arms:
            self._arm(True)  # before it is in effect; the next look switches it off if it is not
        return await self._outside.carry_out(name, order)
