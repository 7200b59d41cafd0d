"""``SimulatedBus``: a master and simulated slaves in virtual time, for plain (not async) tests."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

from dpstack.api.bus.bus import Bus, SlaveTable, core_of
from dpstack.api.bus.opening import open_bus
from dpstack.api.bus.virtual import simulate
from dpstack.api.config.config import Config, load_config, make_config
from dpstack.api.control.scenario import SimulatedPlant
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.injected import SIMULATION
from dpstack.api.listen.names import decode_names
from dpstack.api.slave.drive import Drive
from dpstack.api.slave.slave import Slave
from dpstack.api.slave_side.slave_server import AsyncRecords, serve_async
from dpstack.api.slave_side.virtual_bench import SimulatedSlave, VirtualBench
from dpstack.dp.master.events import DriveEvent
from dpstack.dp.slave.events import DeviceFailed
from dpstack.drivers.virtual.loop import VirtualLoop, refuse_running_loop
from dpstack.errors import DpError, UsageError
from dpstack.profile import Device, DriveDevice
from dpstack.sim.io_station.station import IoStation
from dpstack.sim.world import World
from dpstack.testing.faults import Faults
from dpstack.testing.wire import Watched, Wire
from dpstack.text import printable
from dpstack.trace import Event, Notice, Severity
from dpstack.units import ns_to_s

if TYPE_CHECKING:
    from dpstack.api.fdl_station.station import FdlStation
    from dpstack.devices.pa.device import PaDevice

_T = TypeVar("_T")
#: limit of one run in seconds of virtual time
_LONGEST_S: Final = 600.0
_BAUD: Final = 500_000
#: events that are kept
_EVENTS: Final = 1_000


class VirtualTime:
    """An event loop in virtual time that a plain test drives: it goes while :meth:`run` runs, and stands still between.

    Buses, tasks and timers that a program has started go on in the next run.
    """

    def __init__(self) -> None:
        self._runner = asyncio.Runner(loop_factory=VirtualLoop)
        self._is_over = False

    def __repr__(self) -> str:
        return "<VirtualTime, over>" if self._is_over else f"<VirtualTime {self.now:.6f} s>"

    @property
    def now(self) -> float:
        """Virtual time in seconds, from 0."""
        return self._runner.get_loop().time()

    def check_open(self) -> None:
        """Raises UsageError after the end of the test that it belongs to."""
        if self._is_over:
            raise UsageError(
                "this bus ended with its test: make one in each test, or in a fixture of the default scope (function) "
                "that returns dpstack_bus(...)"
            )

    def run(self, program: Awaitable[_T], *, timeout: float | None = _LONGEST_S) -> _T:
        """Run ``program`` to its end, and return its result.

        ``timeout``: seconds of virtual time after which TimeoutError ends it; None: never. Raises UsageError inside a
        running event loop.
        """
        self.check_open()
        given: object = program
        if not isinstance(given, Awaitable):
            name = getattr(given, "__name__", "program")
            todo = f"call the function: run({name}(...))" if callable(given) else "give run() what an async def returns"
            raise UsageError(f"run() takes a coroutine, not {given!r}; {todo}")
        refuse_running_loop("run()", program)
        return self._runner.run(_limited(program, timeout))

    def wait(self, seconds: float) -> None:
        """Let ``seconds`` of virtual time go by."""
        self.check_open()
        refuse_running_loop("wait()")
        self.run(asyncio.sleep(seconds), timeout=None)

    def close(self) -> None:
        """End all tasks, and the loop."""
        self._is_over = True
        self._runner.close()


async def _limited(program: Awaitable[_T], timeout: float | None) -> _T:
    try:
        async with asyncio.timeout(timeout) as limit:
            return await program
    except TimeoutError:
        if not limit.expired():
            raise
        raise TimeoutError(
            f"the program did not end within {timeout:g} s of virtual time; give run() another timeout if it needs more"
        ) from None


class SimulatedDevice:
    """The device side of a simulated slave: the outputs that act at it, and its inputs."""

    def __init__(self, bench: VirtualBench, address: int) -> None:
        self._bench = bench
        self._address = address

    def __repr__(self) -> str:
        return f"<SimulatedDevice {self._unit.who}: {self._unit.app.state.value}>"

    @property
    def _unit(self) -> SimulatedSlave:
        return self._bench.units[self._address]

    @property
    def exchanging(self) -> bool:
        """Whether the slave is in data exchange, as it sees it itself."""
        return self._unit.app.data is not None

    @property
    def outputs(self) -> bytes:
        """The outputs that the device acts on: zeros in Clear, empty outside data exchange."""
        return self._unit.app.outputs

    @property
    def inputs(self) -> bytes:
        """The inputs that the master reads. Assigning sets them until :meth:`mirror`; without that a slave's inputs are
        its outputs. Raises UsageError for another length, and for a drive, whose motor makes them."""
        return self._unit.inputs

    @inputs.setter
    def inputs(self, octets: bytes) -> None:
        self._unit.set_inputs(octets)

    def set(self, **values: object) -> None:
        """Set named inputs (the key ``inputs`` of the slave), all or none. Raises UsageError, ValueError."""
        unit = self._unit
        unit.check_settable()
        unit.set_inputs(unit.inputs_with(values))

    def mirror(self) -> None:
        """The inputs are the outputs again."""
        self._unit.set_inputs(None)

    @property
    def station(self) -> IoStation:
        """The simulated I/O station: ``set_input()``, ``pull()``, ``plug()``, ``wire_break()``. Raises UsageError for
        another slave."""
        device = self._unit.device
        if not isinstance(device, IoStation):
            raise UsageError(f"{self._unit.who} is no simulated I/O station")
        return device

    @property
    def drive(self) -> DriveDevice:
        """The simulated drive: ``motor.speed`` and ``motor.torque`` in parts of the reference and of the rated torque,
        ``motor.on``; ``set_load()``, ``release()``, ``contact()``, ``set_point()``, ``acknowledge()`` (keypad). Raises
        UsageError for another slave."""
        unit = self._unit
        device = unit.device
        if not isinstance(device, DriveDevice):
            several = "; it has several, see drives" if unit.several is not None else ""
            raise UsageError(f"{unit.who} is no simulated drive{several}")
        device.advance(self._bench.now)
        return device

    @property
    def drives(self) -> dict[str, DriveDevice]:
        """The simulated drives of a slave with several by their names; none of another slave."""
        several = self._unit.several
        if several is None:
            return {}
        several.advance(self._bench.now)
        return dict(several.drives)

    @property
    def process(self) -> PaDevice:
        """The simulated PROFIBUS PA device: ``set_process()``, ``simulate()``, ``maintenance()``, ``sensor_failure()``,
        ``order_fail_safe()`` and its other faults; ``model.block("AI1").get("out")``. Raises UsageError for another
        slave."""
        return self._bench.process_device(self._address)


class SimulatedBus:
    """Simulated slaves, and a master in Operate, on a line in virtual time. The fixture ``dpstack_bus`` makes it.

    ``world``: the line itself; ``events``: the last 1,000 events of the master.
    """

    def __init__(
        self,
        time: VirtualTime,
        config: Config,
        *,
        has_master: bool = True,
        safe: Mapping[str, bytes | str] | None = None,
        scenario: str | Path | None = None,
        devices: Mapping[str, Device] | None = None,
        allow_code: bool = False,
    ) -> None:
        self._time = time
        self._bus: Bus | None = None
        #: configuration of the bus
        self.config = config
        self.events: list[Event] = []
        if has_master:
            self._bus = open_bus(config, on_event=self._on_event)
            core = core_of(self._bus)
            assert core.world is not None
            assert core.bench is not None
            self.world, self._bench = core.world, core.bench
        else:
            #: the line itself, with its virtual time
            self.world = World(referee=False)
            self._bench = simulate(self.world, config.slaves, baud=config.baud, ppi=config.ppi)
            self._bench.on_events = self._on_device_events
        self._records: list[AsyncRecords] = []
        for name, device in (devices or {}).items():
            self._replace(name, device)
        octets = {name: bytes.fromhex(one) if isinstance(one, str) else one for name, one in (safe or {}).items()}
        unknown = octets.keys() - {slave.name for slave in config.slaves}
        if unknown:
            raise UsageError(f"safe: no slave is called {', '.join(sorted(unknown))}")
        watched = [Watched.of(slave, octets.get(slave.name)) for slave in config.slaves]
        #: what went over the line, see :class:`Wire`
        self.wire = Wire(watched, lambda: self.world.baud, decode_names(config), self.world.log)
        self._faults = Faults(self._bench, self.world, config.bus.address)
        self._plant = SimulatedPlant(
            self._bench,
            self._on_event,
            slave_handlers(self._bench),
            scenario=None if scenario is None else str(scenario),
            allow_code=allow_code,
        )

    def __repr__(self) -> str:
        who = f"{len(self.config.slaves)} slaves without a master" if self._bus is None else repr(self._bus)
        return f"<SimulatedBus {self.now:.6f} s: {who}>"

    def _replace(self, name: str, device: Device) -> None:
        """``device`` of the test instead of the simulated one of this name."""
        slave = next((one for one in self.config.slaves if one.name == name), None)
        if slave is None:
            known = ", ".join(one.name for one in self.config.slaves) or "none"
            raise UsageError(f"devices: no slave is called {name!r}; there are: {known}")
        records = serve_async(device)
        if records is not None:
            self._records.append(records)
        self._bench.add(slave, device)

    def start(self) -> None:
        """Begin the scenario, and the recordings and functions of the slaves: their times count from now on."""
        self._plant.start(self.world.now)

    async def bring_up(self, *, operate: bool, ready_s: float) -> None:
        """Open the master's bus; ``operate``: to Operate, until all slaves are in data exchange, within ``ready_s``."""
        await self.master.open()
        if operate:
            await self.master.operate()
            await self.master.ready(ready_s)

    @property
    def device_failures(self) -> list[str]:
        """The exceptions in simulated devices, for people."""
        notices = [one for one in self.events if isinstance(one, Notice) and one.source == SIMULATION]
        return [one.text for one in notices]

    def _on_device_events(self, events: list[Event]) -> None:
        for event in events:
            if isinstance(event, DeviceFailed):
                text = event.text
                self._on_event(Notice(t_ns=event.t_ns, source=SIMULATION, message=text, severity=Severity.ERROR))

    def _on_event(self, event: Event) -> None:
        self.events.append(event)
        del self.events[:-_EVENTS]

    # --- time -------------------------------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """Bus time in seconds, that of ``wire``; events have it as ``t_ns``."""
        return ns_to_s(self.world.now)

    def run(self, program: Awaitable[_T], *, timeout: float | None = _LONGEST_S) -> _T:
        """Run ``program`` to its end in virtual time, see :meth:`VirtualTime.run`; the bus goes on meanwhile."""
        return self._time.run(program, timeout=timeout)

    def wait(self, seconds: float) -> None:
        """Let ``seconds`` of virtual time go by."""
        self._time.wait(seconds)

    # --- master -----------------------------------------------------------------------------------------------------

    @property
    def master(self) -> Bus:
        """The bus for the application under test. Raises UsageError if the application opens its own."""
        if self._bus is None:
            raise UsageError("this bus was made with master=None: the application opens its own, by open_bus() of it")
        return self._bus

    def slave(self, which: str | int) -> Slave:
        """A slave of the master by name or address."""
        return self.master.slave(which)

    def drive(self, which: str | int) -> Drive:
        """A drive of the master by name or address."""
        return self.master.drive(which)

    def open_bus(self, config: str | Path | Config | None = None, **arguments: Any) -> Bus:
        """As :func:`dpstack.open_bus`, on this line whatever the port is: for an application that opens its bus itself.

        ``config`` None: the one that the line was made of. Made with ``master=None``, the application is the only
        master.
        """
        own = arguments.get("on_event")

        def on_event(event: Event) -> None:
            self._on_event(event)
            if own is not None:
                own(event)

        arguments |= {"driver": "auto", "world": self.world, "on_event": on_event}
        return open_bus(self.config if config is None else config, **arguments)

    def open_fdl(self, address: int, **arguments: Any) -> FdlStation:
        """As :func:`dpstack.open_fdl`, on this line at its rate: another station, for an application with FDL services
        of its own, or as the partner of ``bus.master.fdl``."""
        from dpstack.api.fdl_station.station import open_fdl  # here, as most tests need no such station

        return open_fdl(**{"baud": self.config.baud, **arguments, "address": address, "world": self.world})

    # --- slaves -----------------------------------------------------------------------------------------------------

    @property
    def faults(self) -> Faults:
        """Faults of slaves and line. Raises UsageError after the end of the test."""
        self._time.check_open()
        return self._faults

    def device(self, which: str | int) -> SimulatedDevice:
        """The device side of a simulated slave by name or address. Raises UsageError, which lists the slaves; after the
        end of the test, too."""
        self._time.check_open()
        return SimulatedDevice(self._bench, self._bench.address_of(which))

    # --- end --------------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """The ordered end of the master: safe outputs, Clear, out of the ring. May be repeated."""
        self._plant.close()
        if self._bus is not None:
            self.run(self._bus.close())
        for records in self._records:
            records.end()

    def report(self, telegrams: int, events: int = 20) -> str:
        """The end of the events and of the decoded wire log, for people."""
        lines = [f"bus time {self.now:.6f} s"]
        if self.events and events > 0:
            lines += ["the last events:"]
            lines += [f"  {ns_to_s(one.t_ns):.6f} s  {printable(one.text)}" for one in _changes(self.events)[-events:]]
        faults = [f"{name}: {text}" for name, texts in self._faults.active.items() for text in texts]
        if faults:
            lines += ["faults that act: " + printable("; ".join(faults))]
        return "\n".join([*lines, f"the last of the wire ({telegrams} lines):", self.wire.text(telegrams)])


def _changes(events: Iterable[Event]) -> list[Event]:
    """The events without those of a drive whose text repeats the one before of the same drive."""
    last: dict[int, str] = {}
    found: list[Event] = []
    for event in events:
        if isinstance(event, DriveEvent):
            if last.get(event.address) == event.text:
                continue
            last[event.address] = event.text
        found.append(event)
    return found


class BusFactory:
    """Makes simulated buses for one test, all in the same virtual time. The fixture ``dpstack_bus``."""

    def __init__(self, time: VirtualTime) -> None:
        self._time = time
        #: the buses made so far
        self.buses: list[SimulatedBus] = []

    def __call__(
        self,
        config: str | Path | Config | None = None,
        *,
        slaves: Iterable[SlaveTable] = (),
        baud: int | None = None,
        master: Literal["operate", "clear"] | None = "operate",
        safe: Mapping[str, bytes | str] | None = None,
        scenario: str | Path | None = None,
        devices: Mapping[str, Device] | None = None,
        allow_code: bool = False,
        ready_s: float = 30.0,
        **bus: object,
    ) -> SimulatedBus:
        """A simulated bus of a configuration file (its port does not count) or of ``slaves``, mappings with the keys of
        a [[slave]] table.

        ``baud``: bit/s (default: that of the file, or 500,000). ``master``: "operate" returns in Operate with all
        slaves in data exchange; "clear" returns in Clear, while the bring-up begins; None simulates the slaves only,
        and the application opens its bus itself. ``safe``: safe outputs by name, octets or hex, if they are not
        zeros or those of the drive. ``scenario``: a file of steps, as for ``dpstack sim --scenario``; its times, and
        those of recordings and functions of the key ``simulate``, count from the return of this call. ``devices``: own
        devices by the name of the slave, such as a :class:`dpstack.slave.DpSlave`, instead of simulated ones.
        ``allow_code``: functions of the key ``simulate`` may be loaded and called. ``ready_s``: seconds of virtual time
        for the bring-up. ``bus``: further keys of [bus].

        Raises ConfigError; SlaveFault or SlaveTimeout if a slave does not come into data exchange.
        """
        refuse_running_loop("dpstack_bus()")
        if config is None:
            made = make_config("virtual", _BAUD if baud is None else baud, 2, slaves, where="dpstack_bus", bus=bus)
        else:
            made = config if isinstance(config, Config) else load_config(config)
            made = made.with_bus(**{"driver": "auto", **bus, "port": "virtual", "baud": baud}).with_slaves(slaves)
        one = SimulatedBus(
            self._time,
            made,
            has_master=master is not None,
            safe=safe,
            scenario=scenario,
            devices=devices,
            allow_code=allow_code,
        )
        self.buses.append(one)  # before its bring-up, so that the report of a failing one has its wire log
        if master is not None:
            try:
                one.run(one.bring_up(operate=master == "operate", ready_s=ready_s))
            except DpError as error:
                for text in one.device_failures:
                    error.add_note(text)
                raise
        one.start()
        return one

    def close(self) -> None:
        """End all buses in order."""
        for bus in self.buses:
            bus.close()
