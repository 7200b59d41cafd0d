"""The user's own slaves: made from a GSD file, served on a real port or in a virtual world.

Async functions that serve the records of a slave: a task for each request.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar, Unpack

from dpstack.api.gsd_info import read_gsd
from dpstack.api.slave_side.virtual_bench import sim_event_json
from dpstack.api.streams import LEVELS, OnEvent, Waiters, WallClock, call_on_event, logger_below
from dpstack.argcheck import Sealed, octets, whole_number
from dpstack.dp.error_origin import DEVICE_CALL
from dpstack.dp.pdu import layouts
from dpstack.dp.pdu.alarm_blocks import Alarm, ModuleState, Specifier, Status, module_status
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.slave.application import SlaveApp, SlaveAppState, SlaveAppStats
from dpstack.dp.slave.events import SlaveAppEvent
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import DataTransport, ReadReq
from dpstack.dpv1.slave.alarms import AlarmEnd, AlarmServer, Raised
from dpstack.dpv1.slave.clock_receiver import PlantClock, clock_of
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.resource_manager import ServedConnection, ms2_of
from dpstack.dpv1.slave.user_slave import DpSlave, OnCycle, SlaveOptions
from dpstack.drivers.line.asyncio_runtime import AsyncioRuntime
from dpstack.drivers.line.port_latency import patience_of
from dpstack.drivers.runtime import Runtime
from dpstack.drivers.virtual.runtime import VirtualRuntime
from dpstack.errors import AlarmError, BusError, ConfigError, GsdError, SlaveTimeout, UsageError
from dpstack.fdl.commands import AtStation
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.passive.station import PassiveStation
from dpstack.gsd.configuration import configure, default_modules, is_compact_row
from dpstack.machine import LineDown
from dpstack.params import UNADDRESSED, BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.ports import open_port
from dpstack.sim.world import World
from dpstack.text import brief
from dpstack.trace import Event, Notice, Severity
from dpstack.units import baud_text, ns_to_s

if TYPE_CHECKING:
    from dpstack.dpv1.slave.dxb_links import SlaveLink

T = TypeVar("T")


class AsyncRecords:
    """Serves records and Data_Transport by the functions of ``device``. Refuses requests without a function."""

    def __init__(self, device: DpSlave) -> None:
        self._device = device
        self._tasks: set[asyncio.Task[None]] = set()

    def ask(self, request: RecordRequest) -> None:
        """Start the function; its result is the answer. Cancel it if the master gives up polling."""
        task = asyncio.get_running_loop().create_task(self._serve(request), name=request.title)
        self._tasks.add(task)
        request.abandoned = task.cancel
        task.add_done_callback(lambda done: self._on_done(request, done))

    def end(self) -> None:
        """The end of the slave: cancel the running functions."""
        for task in self._tasks:
            task.cancel()

    def _on_done(self, request: RecordRequest, task: asyncio.Task[None]) -> None:
        """If other code has cancelled the function, answer with an error: the master still polls."""
        self._tasks.discard(task)
        if task.cancelled():
            request.fail(asyncio.CancelledError("what it awaited was cancelled"))

    async def _serve(self, request: RecordRequest) -> None:
        service = request.service
        name, result, refusal = "on_write", "", Code.ACCESS_DENIED
        if isinstance(service, ReadReq):
            name, result = "on_read", "a record"
        elif isinstance(service, DataTransport):
            name, result, refusal = "on_transport", "what goes back", Code.FEATURE_NOT_SUPPORTED
        function: Callable[..., Awaitable[object]] | None = getattr(self._device, name)
        if function is None:
            request.refuse(refusal)
            return
        try:
            octets = () if isinstance(service, ReadReq) else (service.data,)
            data = await _result_of(name, function, service.slot, service.index, *octets)
            if not result:
                data = b""
            if not isinstance(data, (bytes, bytearray)):
                raise TypeError(f"{name} returned {type(data).__name__}, {result} is bytes")
            request.answer(bytes(data))
        except Exception as error:  # of the user's function: only this request fails
            request.fail(error)


async def _result_of(name: str, function: Callable[..., Awaitable[T]], *args: object) -> T:
    with DEVICE_CALL:
        result = function(*args)
    if not isinstance(result, Awaitable):
        raise TypeError(f"{name} is an ordinary function, it has to be an async one: write async def")
    with DEVICE_CALL:
        return await result


def slave_from_gsd(
    path: str | Path,
    on_cycle: OnCycle,
    modules: Sequence[int | str] | None = None,
    *,
    name: str = "",
    **options: Unpack[SlaveOptions],
) -> DpSlave:
    """A slave with the properties of the GSD file at ``path`` and the function ``on_cycle(outputs, elapsed)``.

    ``modules``: names or reference numbers of the plugged modules, in slot order, "" for an empty slot; the slave then
    accepts only this configuration. None: it accepts any that the file allows (a compact station all of its modules, if
    they fit together), and Get_Cfg returns ``config``, the file's preset, or its first module. ``on_cycle`` has to
    return inputs for each of them. ``options``: those of :class:`DpSlave`. ``path`` may be the name of a drive with a
    bundled GSD file. Raises ConfigError.
    """
    device = read_gsd(path).device
    try:
        chosen = None if modules is None else configure(device, modules)
        preset = configure(device) if chosen is None and default_modules(device) is not None else None
        if preset is not None and len(preset.modules) > 1 and is_compact_row(device, preset.modules):
            chosen = preset
        description = slave_description(device, chosen, name=name)
    except GsdError as error:
        raise ConfigError(f"{path}: {error}") from None
    if preset is not None and options.get("config") is None:
        options["config"] = preset.config
    return DpSlave(description, on_cycle, **options)


def serve_async(device: Device) -> AsyncRecords | None:
    """Let the async functions of ``device`` serve its records; None if it has none."""
    if not (isinstance(device, DpSlave) and (device.on_read or device.on_write or device.on_transport)):
        return None
    records = AsyncRecords(device)
    device.serve_records(records)
    device.transport = records.ask
    return records


class ServedSlave(Sealed):
    """A served slave. ``restart()`` and ``initial_reset()`` raise UsageError within its own functions."""

    #: the device that is served
    device: Device

    def __init__(
        self, device: Device, address: int, fixed: bool, params: BusParams, patience: Patience, waiters: Waiters
    ) -> None:
        self.device = device
        self._records = serve_async(device)
        self._app = SlaveApp(device, address=address, address_fixed=fixed)
        #: the station of the slave on the line
        self.station = PassiveStation(address, self._app, params, patience=patience)
        #: the runtime of the station, set by the server
        self.runtime: Runtime | None = None
        #: the waiters of the server
        self._waiters = waiters
        self._over: BusError | None = None
        self._seal(ServedSlave)

    def _sealed_name(self) -> str:
        return f"served slave {self.name}"

    def _no_attribute(self, name: str, *, method: bool) -> str:
        if not method and hasattr(self.device, name):
            return f"{self._sealed_name()} has no attribute {name!r}: its device has: assign to device.{name}"
        return super()._no_attribute(name, method=method)

    @property
    def name(self) -> str:
        """The device's name."""
        return self.device.name

    @property
    def address(self) -> int:
        """Its station address; Set_Slave_Add may change it."""
        return self.station.address

    @property
    def address_fixed(self) -> bool:
        """Whether No_Add_Chg was set: only after an initial reset Set_Slave_Add changes the address again."""
        return self._app.address_fixed

    @property
    def state(self) -> SlaveAppState:
        """Wait_Prm, Wait_Cfg or Data_Exch."""
        return self._app.state

    @property
    def master(self) -> int | None:
        """The master that has locked it."""
        return self._app.master

    @property
    def outputs(self) -> bytes:
        """The valid outputs: the safe ones in Clear; empty outside data exchange."""
        return self._app.outputs

    @property
    def inputs(self) -> bytes:
        """The inputs that the master reads; empty outside data exchange."""
        return self._app.inputs

    @property
    def failure(self) -> str | None:
        """The text of an exception in its functions, None without one; :meth:`restart` clears it."""
        return self._app.failure

    @property
    def connections(self) -> tuple[ServedConnection, ...]:
        """Its open connections of class 2."""
        return ms2_of(self._app).connections

    @property
    def connections_free(self) -> int:
        """The number of connections that can still be opened."""
        return ms2_of(self._app).free

    @property
    def links(self) -> tuple[SlaveLink, ...]:
        """Its links to publishers (data exchange broadcast); empty outside data exchange, and without a filter."""
        if self._app.broadcast is None:
            return ()
        from dpstack.dpv1.slave.dxb_links import links_of_slave  # here, as few slaves have it

        return links_of_slave(self._app)

    def abort_connection(self, sap: int, reason: int = 0) -> None:
        """End its connection of class 2 at ``sap`` (see :attr:`connections`).

        Its master receives an Abort of the user with ``reason`` 0..15. Raises UsageError.
        """
        ms2_of(self._app).abort(sap, reason, self._now())

    @property
    def clock(self) -> PlantClock:
        """Its clock, as far as a class 3 master sets it (Time_Event and Clock_Value of DP-V2)."""
        return clock_of(self._app).plant_clock(self._now())

    @property
    def stats(self) -> SlaveAppStats:
        """Counters since the start."""
        return self._app.stats

    def diagnosis(self) -> Diagnosis:
        """The diagnosis that a master would read now."""
        return self._app.diagnosis(self._now())

    def restart(self) -> None:
        """Switch it off and on: safe outputs, Wait_Prm, no failure; the address stays if the device stores it."""
        self._at_station(self._app.restart)

    def initial_reset(self) -> None:
        """Reset it to the state of delivery: like :meth:`restart`, with address 126 and Set_Slave_Add allowed."""
        self._at_station(self._app.initial_reset)

    async def reached(self, state: SlaveAppState, timeout: float | None = None) -> None:
        """Wait up to ``timeout`` seconds until it is in ``state``. Raises SlaveTimeout with its state, and BusError
        after the end of the server.
        """
        try:
            await self._waiters.until(lambda: self._is_in(state), timeout)
        except TimeoutError:
            text = f"is still in {self.state.value} after {timeout} s, not in {state.value}"
            raise SlaveTimeout(self.address, f"slave {self.address} ({self.name}) {text}: {self._hint()}") from None

    async def alarm(
        self,
        type: int,
        slot: int,
        specifier: int = Specifier.NONE,
        data: bytes = b"",
        *,
        add_ack: bool = False,
        timeout: float | None = None,
    ) -> None:
        """Raise an alarm and wait, up to ``timeout`` seconds, until its master has acknowledged it.

        ``type`` 1..6 (:class:`~dpstack.AlarmType`) or 32..126, ``slot`` 0..254, ``specifier`` 0..3
        (:class:`~dpstack.Specifier`), ``data`` 0..59 octets; ``add_ack``: the master's user has to acknowledge it in
        addition. Calls may overlap; the slave queues up to 32 alarms. Raises AlarmError if it cannot send the alarm or
        the alarm ends without acknowledgement, SlaveTimeout, UsageError, PduError for impossible values.
        """
        alarm = Alarm(*_numbers(type, slot, specifier), data=octets("data", data), add_ack=add_ack)
        server = self._alarm_server()
        raised = server.alarm(alarm)
        over: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        raised.ended = lambda: None if over.done() else over.set_result(None)
        what = f"slave {self.address} ({self.name}): {alarm.text}"
        try:
            async with asyncio.timeout(timeout):
                await over
        except TimeoutError:
            text = f"{what}: not acknowledged after {timeout} s; {_hint(raised)}"
            raise SlaveTimeout(self.address, text) from None
        finally:  # after cancellation or time-out: withdraw an alarm that the master has not read yet
            raised.ended = None
            if raised.end is None:
                server.withdraw(raised)
        if raised.end is not None and raised.end is not AlarmEnd.ACKNOWLEDGED:
            reason = "data exchange ended" if raised.end is AlarmEnd.LEFT else "withdrawn"
            raise AlarmError(f"{what}: {raised.end.value}", reason)

    def status(self, type: int, slot: int = 0, specifier: int = Specifier.NONE, data: bytes = b"") -> None:
        """Send a status message once, without acknowledgement: ``type`` 1..3, 30, 31 (:class:`~dpstack.StatusType`) or
        32..126, the rest as for :meth:`alarm`. Raises AlarmError if it cannot be sent, UsageError, PduError."""
        self._alarm_server().status(Status(*_numbers(type, slot, specifier), octets("data", data)))

    def module_status(self, states: Sequence[ModuleState]) -> None:
        """Send the states of its modules, slot 1 first, as :meth:`status`."""
        given = tuple(states) if isinstance(states, Iterable) else (states,)
        if not given or any(not isinstance(state, int) or state not in range(4) for state in given):
            raise UsageError(
                f"{brief(states)} is no list of ModuleState: ModuleState.OK, .INVALID, .WRONG or .MISSING for each"
            )
        self._alarm_server().status(module_status(tuple(ModuleState(state) for state in given)))

    def _alarm_server(self) -> AlarmServer:
        server = self.device.alarm_server
        if server is None:
            raise UsageError(f"slave {self.name}: it has no DP-V1, so no alarms; say dpv1=True in its description")
        return server

    def switch_off(self, why: BusError, now: int) -> None:
        """The end of the server: safe outputs; later calls raise ``why``."""
        self._over = why
        if self._records is not None:
            self._records.end()
        self.station.command(LineDown("switched off"), now)
        self._app.restart(now)

    def _now(self) -> int:
        return 0 if self.runtime is None else self.runtime.now()

    def _is_in(self, state: SlaveAppState) -> bool:
        if self._over is not None:
            raise self._over
        return self.state is state

    def _hint(self) -> str:
        if self.failure is not None:
            return f"its function failed ({self.failure}); correct it and restart() the slave"
        if not _is_spoken_to(self.stats):
            return "no master has spoken to it; check address, baud rate and cable"
        return "its master stopped half-way; look at the slave's events for what was refused"

    def _at_station(self, act: Callable[[int], None]) -> None:
        def again(now: int) -> None:
            self.station.command(LineDown("switched off"), now)
            act(now)

        if isinstance(self.device, DpSlave) and self.device.inside:
            raise UsageError(
                f"slave {self.name}: it cannot be restarted or reset within its own function; "
                f"do it afterwards, for instance by loop.call_soon(server.slave.restart)"
            )
        if self.runtime is None:
            again(0)
        else:
            self.runtime.command(AtStation(again))


def _is_spoken_to(stats: SlaveAppStats) -> bool:
    """Whether a master has sent a request to the slave."""
    return stats.services + stats.exchanges + stats.refused > 0


def _numbers(type: int, slot: int, specifier: int) -> tuple[int, int, int]:
    return whole_number("type", type), whole_number("slot", slot), whole_number("specifier", specifier)


def _hint(raised: Raised) -> str:
    if raised.offered:
        return "its master has read it in the diagnosis, but sends no Alarm_Ack"
    return "its master has not fetched it: others are before it, or the master does not heed diagnosis messages"


#: events of a port with served slaves
_SERVED: Final = logging.getLogger("dpstack.served")


class SlaveServer(Sealed):
    """Serves slaves as stations behind one port (or in ``world``). A context manager (``async with``).

    Its events go to ``on_event``, and to the loggers ``dpstack.served.NAME`` (docs/how-to/service.md#logs).

    Leaving sets all outputs to their safe values. Raises ConfigError; PortError on entering.
    """

    #: baud rate in bit/s
    baud: int
    #: the served slaves, in the order given
    slaves: tuple[ServedSlave, ...]
    on_event: OnEvent | None
    failure: BusError | None

    def __init__(
        self,
        slaves: Mapping[int, Device],
        *,
        port: str | None,
        baud: int | None,
        fixed: bool,
        world: World | None,
        on_event: OnEvent | None,
    ) -> None:
        if not slaves:
            raise ConfigError("no slave to serve")
        if port is None and world is None:
            raise ConfigError('no port; give for instance port="/dev/ttyUSB0", or a world')
        if baud is None and world is None:
            raise ConfigError("no baud; give for instance baud=500000 (dpstack.find_baud finds it by listening)")
        self.baud = baud or (world.baud if world is not None else 0)
        for device in slaves.values():
            _check_rate(device, self.baud)
        params = BusParams.preset(self.baud)
        #: callback for every event
        self.on_event = on_event
        self._clock = WallClock(lambda: self._runtimes[0].now(), lambda: world is not None)
        self._world = world
        #: the failure that stopped the server, a defect in dpstack; None without one
        self.failure = None
        self._waiters = Waiters()
        opened = None if port is None or world is not None else open_port(port, self.baud)
        patience = EXACT if opened is None else patience_of(opened)
        self.slaves = tuple(
            ServedSlave(device, at, fixed, params, patience, self._waiters) for at, device in slaves.items()
        )
        self._runtimes: list[Runtime] = []
        self._begun_ns = 0
        if opened is not None:
            layouts.load()
            line = Multidrop([slave.station for slave in self.slaves], params, patience=patience)
            runtime: Runtime = AsyncioRuntime(opened, line, self._on_events, on_failure=self._failed)
            self._attach(runtime, *self.slaves)
        elif world is not None:
            for slave in self.slaves:
                self._attach(VirtualRuntime(world, slave.station, self._on_events, on_failure=self._failed), slave)
        self._seal(SlaveServer)

    def _sealed_name(self) -> str:
        return "slave server"

    def __repr__(self) -> str:
        slaves = ", ".join(f"{slave.address} {slave.name!r} {slave.state.value}" for slave in self.slaves)
        return f"<SlaveServer {slaves}>"

    def _attach(self, runtime: Runtime, *slaves: ServedSlave) -> None:
        self._runtimes.append(runtime)
        for slave in slaves:
            slave.runtime = runtime

    @property
    def slave(self) -> ServedSlave:
        """The only slave, or the first."""
        return self.slaves[0]

    @property
    def port_name(self) -> str:
        """The name of the port; of a pty made here the path to open."""
        return self._runtimes[0].port_name

    async def serve_forever(self) -> None:
        """Wait until a cancellation. Raises BusError when a failure has stopped the server."""
        await self._waiters.until(self._over, None)

    async def __aenter__(self) -> SlaveServer:
        self._begun_ns = self._runtimes[0].now()
        for runtime in self._runtimes:
            await runtime.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        self._make_safe(BusError("the slaves are served no more"))
        async with contextlib.AsyncExitStack() as runtimes:  # closes all of them despite a cancellation
            runtimes.callback(self._publish_rest)
            for runtime in reversed(self._runtimes):
                runtimes.push_async_callback(runtime.close)

    def _publish_rest(self) -> None:
        rest: list[Event] = [event for slave in self.slaves for event in slave.station.take_events()]
        self._on_events([*rest, *self._deaf_slaves()])

    def _deaf_slaves(self) -> Iterator[Notice]:
        """A notice of each slave that has heard nothing because its world runs at another rate."""
        world = self._world
        if world is None or world.baud in (0, self.baud):
            return
        for slave in self.slaves:
            if not _is_spoken_to(slave.stats):
                yield Notice(
                    t_ns=self._runtimes[0].now(),
                    source=f"slave {slave.address} ({slave.name})",
                    message=f"no master has spoken to it: it was served at {baud_text(self.baud)}, and the bus ran at "
                    f"{baud_text(world.baud)}; give baud={world.baud}",
                    severity=Severity.WARNING,
                )

    def _on_events(self, events: list[Event]) -> None:
        self._waiters.check()
        for event in events:
            stamped = self._clock.stamped(event)
            self._log(stamped)
            call_on_event(self.on_event, stamped)

    def _log(self, event: Event) -> None:
        """A record of ``logging``, as those of a bus (dpstack/api/bus/events_json.py)."""
        logger = logging.getLogger(logger_below("served", event.name)) if isinstance(event, SlaveAppEvent) else _SERVED
        level = LEVELS[event.severity]
        if logger.isEnabledFor(level):
            fields = sim_event_json(event, ns_to_s(event.t_ns - self._begun_ns))
            fields.pop("text", None)
            logger.log(level, "%s", event.text, extra={"dpstack": {**fields, "port": self.port_name}})

    def _make_safe(self, why: BusError) -> None:
        for slave in self.slaves:
            if slave.runtime is not None:
                slave.switch_off(why, slave.runtime.now())
        self._waiters.check()

    def _failed(self, error: Exception) -> None:
        self.failure = BusError(f"the slaves were stopped by a defect in dpstack ({type(error).__name__}: {error})")
        self.failure.__cause__ = error
        self._make_safe(self.failure)

    def _over(self) -> bool:
        if self.failure is not None:
            raise self.failure
        return False


def serve_slave(
    device: Device,
    *,
    port: str | None = None,
    baud: int | None = None,
    address: int | None = None,
    address_fixed: bool = False,
    world: World | None = None,
    on_event: OnEvent | None = None,
) -> SlaveServer:
    """Serve ``device`` as a slave: ``async with serve_slave(...) as server``, then ``server.slave``.

    ``port`` and ``baud`` (bit/s) as for a master, or ``world``, a simulated bus. ``address`` None: 126, for a slave
    that gets its address by Set_Slave_Add; ``address_fixed``: as after No_Add_Chg. ``on_event``: called for each event.
    Raises ConfigError; PortError on entering.
    """
    if address is None:
        if not device.set_slave_add:
            raise ConfigError(
                f"slave {device.name}: no address, and Set_Slave_Add is not supported; give address=0..125"
            )
        address = UNADDRESSED
    return SlaveServer({address: device}, port=port, baud=baud, fixed=address_fixed, world=world, on_event=on_event)


def serve_slaves(
    slaves: Mapping[int, Device],
    *,
    port: str | None = None,
    baud: int | None = None,
    world: World | None = None,
    on_event: OnEvent | None = None,
) -> SlaveServer:
    """Serve several slaves, address -> device, behind one port; otherwise as :func:`serve_slave`."""
    return SlaveServer(slaves, port=port, baud=baud, fixed=False, world=world, on_event=on_event)


def _check_rate(device: Device, baud: int) -> None:
    rates = device.description.rates if isinstance(device, DpSlave) else {}
    if rates and baud not in rates:
        known = ", ".join(baud_text(rate) for rate in sorted(rates))
        raise ConfigError(f"slave {device.name}: it has no {baud_text(baud)}; it knows {known}")
