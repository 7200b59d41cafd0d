"""``Bus``: opening, modes, slaves, events and the end of a running bus."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dpstack.api.bus.core import BusCore
from dpstack.api.bus.cycles import Cycle
from dpstack.api.bus.plan_checks import new_plan_texts
from dpstack.api.config.bus import BusConfig
from dpstack.api.config.config import Config, slave_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave.slave import Slave, all_ready, bring_up_anew
from dpstack.api.streams import EventStream, OnEvent, load_beside
from dpstack.argcheck import Sealed, instance, plain_function
from dpstack.dp.master.commands import Alive, Mode, SetMode
from dpstack.dp.master.events import ControlSent, ForcedClear
from dpstack.dp.master.scanner import Found
from dpstack.dp.plan.plan import Plan
from dpstack.drivers.futures import run_through_cancellation
from dpstack.drivers.snapshots import BusSnapshot
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.livelist import ALL_ADDRESSES
from dpstack.params import BusParams
from dpstack.text import brief, did_you_mean
from dpstack.toml.table import keys_of
from dpstack.trace import Severity
from dpstack.units import baud_text

if TYPE_CHECKING:
    from dpstack.api.bus.live import LiveStream
    from dpstack.api.bus.recording import BusRecording
    from dpstack.api.bus.statistics import BusStats
    from dpstack.api.bus.sync_freeze import Group, Groups
    from dpstack.api.fdl.fdl import Fdl
    from dpstack.api.ppi.plant_cpu import PlantCpu
    from dpstack.api.slave.class2 import Class2
    from dpstack.api.slave.drive import Drive
    from dpstack.sim.world import World
    from dpstack.why.story import Story

SlaveTable = Mapping[str, object] | SlaveConfig


class Bus(Sealed):
    """A running bus: the slaves of a configuration under a class 1 master. Made by :func:`dpstack.open_bus`.

    With the baud rate "auto" what depends on the rate raises UsageError until the rate is found.
    """

    def __init__(
        self,
        config: Config,
        *,
        on_event: OnEvent | None = None,
        join_timeout: float | None = None,
        world: World | None = None,
        watched: bool = True,
    ) -> None:
        self._core = BusCore(config, on_event, join_timeout=join_timeout, world=world, watched=watched)
        self._class2: Class2 | None = None
        self._fdl: Fdl | None = None
        self._cpus: dict[int, PlantCpu] = {}
        self._seal(Bus)

    def __repr__(self) -> str:
        core = self._core
        if core.searching:
            return f"<Bus {core.config.port} searching for its rate>"
        where = f"{core.config.port} {baud_text(core.params.baud)}"
        if not core.is_open:
            return f"<Bus {where} not open>"
        slaves = [slave for slave in core.slaves if not slave.deactivated]
        ready = sum(slave.ready_now for slave in slaves)
        return f"<Bus {where} {core.mode.name.lower()}, {ready} of {len(slaves)} slaves>"

    def _read_hint(self, name: str) -> str:
        """Slaves and drives are no attributes."""
        for kind, known in (("drive", self.drives), ("slave", self.slaves)):
            if any(one.name == name for one in known):
                return f": write bus.{kind}({name!r})"
        return super()._read_hint(name)

    # --- from beginning to end ----------------------------------------------------------------------------------

    async def __aenter__(self) -> Bus:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    if not TYPE_CHECKING:  # a type checker reports unknown attributes

        def __enter__(self) -> None:
            raise UsageError("a bus is entered by `async with`; for plain `with` take dpstack.blocking.open_bus(...)")

        def __exit__(self, *_: object) -> None:
            """Python asks for it before it calls __enter__."""

    async def open(self) -> None:
        """Listen, join the token ring, begin the bring-up in Clear. Raises PortError, BusError.

        With the baud rate "auto" listen for that first: after 5 s of silence BusError says what to do.
        """
        await self._core.open()

    async def close(self) -> None:
        """The ordered end: safe values for one cycle, Clear twice, out of the ring, port released. May be repeated.

        The end takes a few rotations, at most :attr:`end_limit_s`. Cancellations do not shorten it; they are raised
        when it is over. The caller may be in another event loop than the one that opened the bus. In a process forked
        from the one that opened the bus this does nothing.
        """
        await self._core.close()

    def hurry(self) -> None:
        """End within a second, without the steps that do not make outputs safe: safe values and Clear as far as the
        bus can still send them, then the port is released. Call it in the bus's event loop; ``close()`` waits for it.
        """
        self._core.hurry()

    @property
    def end_failed(self) -> bool:
        """True after an end in which slaves that had outputs got neither safe values nor Clear (dead port, no token,
        a bus process that hangs). An event reports it, with the watchdog times of the slaves."""
        return self._core.end_failed

    @property
    def end_limit_s(self) -> float:
        """Upper limit of the time (s) that the end of the bus takes."""
        return self._core.end_limit_s

    @property
    def is_open(self) -> bool:
        """True between a successful opening and the end."""
        return self._core.is_open

    # --- the bus as it is -----------------------------------------------------------------------------------------

    @property
    def config(self) -> Config:
        """The configuration, with the arguments of ``open_bus``."""
        return self._core.config

    @property
    def searching(self) -> bool:
        """True while the baud rate "auto" has not been found."""
        return self._core.searching

    @property
    def plan(self) -> Plan:
        """Bus parameters, rotation times, findings and notes, as ``dpstack plan`` prints them."""
        return self._core.plan

    @property
    def params(self) -> BusParams:
        """The bus parameters in use. Raises UsageError while the rate "auto" has not been found."""
        return self._core.params

    @property
    def driver(self) -> str:
        """The driver: "asyncio", "process", or "virtual" on a simulated bus."""
        return self._core.driver

    @property
    def world(self) -> World | None:
        """The simulated bus when there is one."""
        return self._core.world

    @property
    def mode(self) -> Mode:
        """The mode of the master; OFFLINE while its runtime does not run."""
        return self._core.mode

    @property
    def snapshot(self) -> BusSnapshot:
        """The last snapshot: mode, token ring and its masters, SYNC and FREEZE, stations found."""
        return self._core.snapshot

    @property
    def forced_clear(self) -> ForcedClear | None:
        """The event of a Clear that the master went to by itself, until Operate is ordered."""
        return self._core.forced_clear

    @property
    def collision(self) -> str | None:
        """Text of the address collision with another station; None without one."""
        return self._core.collision

    @property
    def seconds(self) -> float:
        """Bus time since the start in seconds."""
        return self._core.seconds

    @property
    def slaves(self) -> tuple[Slave, ...]:
        """The slaves in the order of their addresses."""
        return self._core.slaves

    @property
    def drives(self) -> tuple[Drive, ...]:
        """The drives, in the order of the addresses of their slaves."""
        return self._core.drives

    def slave(self, which: str | int) -> Slave:
        """A slave by name or address. Raises UsageError, which lists the slaves."""
        return self._core.slave(which)

    def drive(self, which: str | int) -> Drive:
        """A drive by name or address. Raises UsageError, which lists the drives."""
        return self._core.drive(which)

    @property
    def cpus(self) -> tuple[PlantCpu, ...]:
        """The S7-200 CPUs of the plant file (``ppi``), in the order of the file."""
        return tuple(self.cpu(address) for address in self._core.cpus)

    def cpu(self, which: str | int) -> PlantCpu:
        """An S7-200 of the plant file by name or address. Raises UsageError, which lists them."""
        polling = self._core.cpu(which)
        from dpstack.api.ppi.plant_cpu import PlantCpu  # here, as most plants have none

        address = polling.config.address
        if address not in self._cpus:
            self._cpus[address] = PlantCpu(polling, lambda: self._core.runtime.now())
        return self._cpus[address]

    @property
    def class2(self) -> Class2:
        """The services of a class 2 master: diagnosis, configuration, inputs and outputs of any slave, its address."""
        if self._class2 is None:
            from dpstack.api.slave.class2 import Class2  # here, as most programs have no use for it

            self._class2 = Class2(self._core, self._core.by_address, self._core.slave)
        return self._class2

    @property
    def fdl(self) -> Fdl:
        """The FDL services of this station beside its DP master: requests to other stations, SAPs of one's own.

        Requests to SAPs 48 to 63 or from them, to the default SAP of slaves of this bus, and to all stations (127)
        raise UsageError: nobody parameterises or operates slaves behind the master's back.
        """
        if self._fdl is None:
            from dpstack.api.fdl.fdl import Fdl  # here, as most programs have no use for it

            self._fdl = Fdl(self._core.fdl_link())
        return self._fdl

    # --- orders -------------------------------------------------------------------------------------------------

    async def operate(self) -> None:
        """Outputs go out from the next rotation on; with ``auto_clear`` once all slaves are in data exchange.

        This ends a Clear that the master went to by itself (:attr:`forced_clear`), and arms the application watchdog.
        """
        self._core.raise_refused()
        await self._core.order(SetMode(Mode.OPERATE))

    def alive(self) -> None:
        """The application is alive: call it more often than ``application_watchdog_ms`` while the bus is in Operate.

        Without a call for so long the master goes to Clear until :meth:`operate`. No effect while the application
        watchdog is off, not armed, or has run out. Raises UsageError when the bus is not open.
        """
        self._core.check_open()
        if self.config.bus.application_watchdog_ms:
            self._core.command(Alive())

    async def clear(self) -> None:
        """Clear: the master reads inputs and sends zero outputs (empty ones to Fail_Safe slaves)."""
        await self._core.order(SetMode(Mode.CLEAR))
        self._core.raise_refused()

    async def stop(self) -> None:
        """Stop: the master sends slaves no more telegrams (their watchdogs will expire), and stays in the ring."""
        await self._core.order(SetMode(Mode.STOP))
        self._core.raise_refused()

    async def outputs_taken(self) -> None:
        """Wait until the master has the outputs that the program has set; in Operate its next round sends them.

        Raises OrderDropped if a bus process did not take them within 1 s: they will not be sent, and
        ``Slave.outputs`` are the earlier ones. Raises UsageError when the bus is not open, BusError when it is over.
        """
        await self._core.outputs_taken()

    async def ready(self, timeout: float | None = 5.0) -> None:
        """Wait until every slave in service is in data exchange. Raises SlaveFault or SlaveTimeout for the first that
        is not.
        """
        self._core.check_open()
        await all_ready(self._core, [slave for slave in self.slaves if not slave.deactivated], timeout)

    async def sync(self, groups: Groups = (), *, settle: bool = False) -> ControlSent:
        """SYNC to ``groups`` (0 or nothing: all slaves): the slaves apply their last received outputs at one moment,
        and later ones with the next SYNC. Returns when the last bit of the telegram has left the line.

        ``settle``: first one whole Data_Exchange with each slave, so that it has the outputs set just now. The master
        never repeats the telegram. Raises UsageError in Stop or for slaves without ``sync``, SlaveFault, BusError (no
        token).
        """
        return await self._send_control(groups, sync=True, settle=settle)

    async def unsync(self, groups: Groups = ()) -> ControlSent:
        """End SYNC."""
        return await self._send_control(groups, unsync=True)

    async def freeze(self, groups: Groups = ()) -> ControlSent:
        """FREEZE: the slaves keep the inputs of this moment until the next FREEZE. Otherwise as :meth:`sync`."""
        return await self._send_control(groups, freeze=True)

    async def unfreeze(self, groups: Groups = ()) -> ControlSent:
        """End FREEZE."""
        return await self._send_control(groups, unfreeze=True)

    async def _send_control(self, groups: Groups, **what: bool) -> ControlSent:
        from dpstack.api.bus.sync_freeze import send_control  # here, as most programs have no use for it

        return await send_control(self._core, groups, **what)

    def group(self, groups: Groups = ()) -> Group:
        """A group of slaves that change outputs, and sample inputs, at one moment, see
        :class:`~dpstack.api.bus.sync_freeze.Group`."""
        from dpstack.api.bus.sync_freeze import Group

        return Group(self._core, groups)

    async def add_slave(self, table: SlaveTable, *, restart_publishers: bool = False) -> Slave:
        """Add a slave while the bus runs: ``table`` has the keys of a [[slave]] table. Raises ConfigError.

        With ``port="virtual"`` it is simulated like the others. Findings of the plan about it come as notices.

        ``subscribes`` needs publishers that publish already, for another slave. ``restart_publishers``: bring up anew
        those that do not: safe outputs for 50 ms, Unlock, then Publisher_Enable in Set_Prm; a notice names each.
        """
        config = table if isinstance(table, SlaveConfig) else slave_config(table, where="add_slave")
        core = self._core
        others = list(core.view.setups.values())
        if any(other.name == config.name for other in others):
            raise ConfigError(f"there is a slave called {config.name!r} already: give the new one another name")
        taken = {other.name for other in others} | {drive.name for drive in self.drives}
        for name in (config.name, *(one.name for one in config.drives)):
            if name in taken:
                raise ConfigError(f"there is a drive called {name!r} already: give the new one another name")
        config, publishers = _linked(config, self.slaves, restart=restart_publishers)
        setup = core.fitting(config)
        for publisher in publishers:
            text = f"{publisher.params.who} is brought up anew: from now on it publishes its inputs for {config.name}"
            core.notice("dxb", text, Severity.WARNING)
            await run_through_cancellation(bring_up_anew(self.slave(publisher.address), publisher))
        slave = await run_through_cancellation(core.add(config, setup))
        for note in (*config.notes, *new_plan_texts(self.config, self.plan, others, setup)):
            core.notice("plan", note, Severity.WARNING)
        return slave

    async def remove(self, slave: Slave | str | int) -> None:
        """Remove a slave: safe outputs for 50 ms, then Unlock.

        Returns when the master has the order. The bus does not end before the removal is over, and a slave added at
        the same address waits for it.
        """
        address = slave.address if isinstance(slave, Slave) else self.slave(slave).address
        await run_through_cancellation(self._core.remove(address))

    # --- stations, events, cycles, statistics ---------------------------------------------------------------------

    async def scan(
        self, *, configs: bool = False, addresses: Iterable[int] = ALL_ADDRESSES, quick: bool | None = None
    ) -> tuple[Found, ...]:
        """The live list 0..126 without this station, with ident, state and owner of each slave. Slaves do not change.

        ``configs``: ask for the identifier octets too. ``quick``: ask silent addresses one after the other, without
        the pauses that data exchange needs on a slow port (default: while no slave of this bus is in data exchange).
        """
        return await self._core.scan(configs=configs, addresses=addresses, quick=quick)

    async def why(
        self, slave: Slave | str | int, *, ask: bool = True, scan: bool = True, master: int | None = None
    ) -> Story:
        """The story of a slave: its last bring-up step by step, and the likely causes why it is not in data exchange.

        ``ask``: send it Slave_Diag and Get_Cfg, which change nothing; without it, only what was seen so far counts.
        ``scan``: if nobody, or another device, answers at its address, ask the other addresses, for 20 s at most.
        ``master``: the address that the master of the slave should have, on a read-only bus (default: the one that it
        names). Raises UsageError for an unknown slave.
        """
        found = slave if isinstance(slave, Slave) else self.slave(slave)
        if self.driver != "virtual":  # whose time stands still during an import, but not while a thread works
            await load_beside("dpstack.api.bus.why", "dpstack.why.story")
        from dpstack.api.bus.why import gather  # here, as most programs never ask
        from dpstack.why.story import tell

        def asked(addresses: Iterable[int]) -> Awaitable[tuple[Found, ...]]:
            return self.scan(configs=True, addresses=addresses)

        return tell(await gather(self._core, found, asked if scan else None, ask=ask, master=master))

    def events(self) -> EventStream:
        """The events since the start of the bus, an async iterator. It keeps 1000; ``dropped`` counts the lost ones.

        A program may leave it without ``close()``: it is forgotten once nothing refers to it.
        """
        return self._core.event_stream()

    def live(self, interval: float = 0.1) -> LiveStream:
        """Plant, snapshots and events of the bus as one stream of plain data (docs/reference/live.md), an async
        iterator.

        A snapshot comes every ``interval`` seconds (0.02 or more), an event at once. A slow reader gets the latest
        snapshot and up to 1000 events; the bus never waits. It ends with the bus, or by ``close()``.
        """
        from dpstack.api.bus.live import checked_interval  # here, as most programs have no reader

        return self._core.live_feed().join(checked_interval(interval))

    def cycles(self) -> AsyncIterator[Cycle]:
        """A :class:`~dpstack.api.bus.cycles.Cycle` for each round of data exchange, with or without a fixed cycle.

        A slow reader gets the latest one; ``cycle.skipped`` counts the missed ones. The next cycle sends all outputs
        that the body has set before it begins. Ends with the bus.
        """
        return self._core.cycles.read()

    def record(
        self,
        path: str | Path | BusRecording,
        *,
        on_change: bool = False,
        quality: bool = False,
        dead_band: float = 0.0,
        rotate: str | None = None,
    ) -> BusRecording:
        """Keep named values, states and drive quantities of every round in the file ``path``, which ends in .csv,
        .jsonl or .parquet (docs/how-to/record.md). Recording begins at once, and never delays the bus.

        ``on_change``: only rounds in which a value has changed by more than its ``dead_band`` (here: of all numbers, in
        their units; the key ``dead_band`` of a field if it is greater). ``quality``: a column with the quality of each
        named value, which keeps its number while it is bad; without it a bad value has none. ``rotate``: a new file
        after a size or a time, "100MB" or "1h". It ends with ``await recording.stop()``, with its ``async with`` block,
        or with the bus. ``paths``, ``rows``, ``lost`` and ``troubles`` show how far it is.

        Raises UsageError for a file that is there already or cannot be made, for .parquet without pyarrow, on a bus
        that is not open, and on a read-only one.
        """
        from dpstack.api.bus.recording import BusRecording  # here, as most programs record nothing

        self._core.check_open()
        if not isinstance(path, BusRecording):
            path = BusRecording(path, on_change=on_change, dead_band=dead_band, rotate=rotate, quality=quality)
        self._core.record(path)
        return path

    @property
    def stats(self) -> BusStats:
        """Counters and rotation times up to now."""
        from dpstack.api.bus.statistics import bus_figures  # here, as it loads the quality of values

        return bus_figures(self._core, self._core.slaves, cpus=tuple(self._core.cpus.values()))

    # --- waiting --------------------------------------------------------------------------------------------------

    async def until(self, condition: Callable[[], bool], timeout: float | None = None) -> None:
        """Wait until ``condition()``, evaluated after every event of the bus, is true. Inputs change without an event:
        for them see ``Slave.until``.

        ``timeout`` in seconds. Raises what ``condition`` raises, TimeoutError, and the reason of the end when the bus
        ends meanwhile.
        """
        plain_function("condition", condition, "until(lambda: bus.collision is not None)")
        try:
            await self._core.until(condition, timeout)
        except TimeoutError as error:
            if error.args:  # of the condition
                raise
            raise TimeoutError(f"the condition is not true after {timeout:g} s") from None

    async def wait_state(self, mode: Mode, timeout: float | None = None) -> None:
        """Wait until the master is in ``mode``: ``Mode.OPERATE`` for instance is reached late with ``auto_clear``.

        ``timeout`` in seconds. Raises TimeoutError with the mode that it is in, and the reason of the end when the bus
        ends meanwhile.
        """
        instance("mode", mode, Mode, "wait_state(Mode.OPERATE)")
        try:
            await self._core.until(lambda: self.mode is mode, timeout)
        except TimeoutError:
            why = "" if self.forced_clear is None else f": {self.forced_clear.text}"
            wanted, present = mode.name.lower(), self.mode.name.lower()
            raise TimeoutError(f"the master is not in {wanted} after {timeout:g} s, it is in {present}{why}") from None

    async def rotated(self, rotations: int | None, timeout: float | None = None) -> None:
        """Wait until the bus has had ``rotations`` rotations in all (None: for ever). Raises TimeoutError."""
        await self._core.rotated(rotations, timeout)


def core_of(bus: Bus) -> BusCore:
    """The inside of ``bus``, for the rooms of dpstack: its machine, its events, its simulated slaves."""
    return bus._core


def _linked(
    config: SlaveConfig, slaves: Iterable[Slave], *, restart: bool
) -> tuple[SlaveConfig, tuple[SlaveConfig, ...]]:
    """A slave that joins with its links to the others, and the publishers that have to be brought up anew for it.
    Raises ConfigError, also for those unless ``restart``."""
    running = [slave.config for slave in slaves]
    if not (config.subscribes or any(slave.params.links for slave in running)):
        return config, ()
    from dpstack.api.config.broadcast import joining  # here, as few plants have links

    linked, publishers = joining(config, running)
    if publishers and not restart:
        names = ", ".join(f"{one.name} ({one.address})" for one in publishers)
        raise ConfigError(
            f"slave {config.name}: it subscribes to {names}, and Publisher_Enable is not set there: that takes a new "
            "bring-up, in which its outputs are safe and its inputs stand still; if the plant can bear that now, add "
            "restart_publishers=True, else put both into the configuration"
        )
    return linked, publishers


#: the arguments of :func:`dpstack.open_bus` that are no keys of [bus]
_OWN_ARGUMENTS: Final = ("config", "slaves", "on_event", "join_timeout", "world")


def check_arguments(config: object, slaves: object, on_event: object, world: object, bus: Iterable[str]) -> None:
    """Raises ConfigError for arguments of another type, and for one whose name is not known."""
    if not isinstance(config, (str, os.PathLike, Config, type(None))):
        raise ConfigError(
            f"open_bus: {brief(config)} is no configuration: give the path of a file, or port=, baud= and slaves="
        )
    if isinstance(slaves, (str, Mapping)) or not isinstance(slaves, Iterable):
        raise ConfigError(f"open_bus: slaves = {brief(slaves)} is no list: write slaves=[{{'name': 'fan', ...}}]")
    if on_event is not None:
        plain_function("open_bus: on_event", on_event, "on_event=print", ConfigError)
    if world is not None:
        from dpstack.sim.world import World  # here, as a bus on a wire needs none

        instance("open_bus: world", world, World, "world = dpstack.World()", ConfigError)
    names = (*_OWN_ARGUMENTS, *keys_of(BusConfig))
    for name in bus:
        if name not in names:
            hint = did_you_mean(name.lower(), names, f"known: {', '.join(names)}", quoted=True)
            raise ConfigError(f"open_bus: unknown argument {name!r}; {hint}")
