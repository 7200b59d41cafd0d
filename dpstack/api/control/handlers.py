"""The control servers of run, sim and segment, and the handlers of their commands."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from time import monotonic_ns
from typing import Any, Final

from msgspec import structs

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.core import BusCore
from dpstack.api.bus.live_list import answer_notes
from dpstack.api.bus.parts import SEARCHING
from dpstack.api.bus.statistics import clear_since, diagnosis_dict, drive_dict, inputs_dict
from dpstack.api.control import arguments
from dpstack.api.control.commands import KINDS, SLAVES
from dpstack.api.control.drive_orders import drive_order
from dpstack.api.control.live_items import live_items
from dpstack.api.control.record_orders import acyclic_order
from dpstack.api.control.scenario import read_fault
from dpstack.api.control.server import ControlServer, Handler, LongCommand, Send, kept_alive
from dpstack.api.control.tap_feed import TapFeed
from dpstack.api.injected import Injected
from dpstack.api.server.fault_steps import Deed, End
from dpstack.api.server.simulation import Segment, Simulation
from dpstack.api.server.virtual_bench import Bench, silence_text
from dpstack.api.slave.slave import Slave
from dpstack.api.slave.station_report import KnownDevices, read_station, station_report
from dpstack.api.streams import OnEvent, call_on_event
from dpstack.dp.master.scanner import Found
from dpstack.dp.process_data import as_json
from dpstack.drivers.runtime import Runtime
from dpstack.drivers.virtual.runtime import VirtualRuntime
from dpstack.errors import BusError, UsageError
from dpstack.fdl.livelist import ALL_ADDRESSES
from dpstack.params import UNADDRESSED
from dpstack.profile.simulator.device import DriveDevice
from dpstack.sim.io_station import IoStation
from dpstack.text import number_or_name, octets_text
from dpstack.trace import Notice

#: a pty that the program makes itself
PTY: Final = "pty"
#: addresses that a scan asks in one go; its progress counts them
_SCAN_PART: Final = 16
#: carries out a command: bench, address of the simulated slave, further arguments
_Act = Callable[[Bench, int, list[str]], object]


def control_run(
    bus: Bus,
    port: str,
    feed: TapFeed | None = None,
    *,
    stop: Callable[[], None] | None = None,
    kind: str = "run",
) -> ControlServer:
    """The control server of a master on ``port``; of one with a pty :meth:`ControlServer.move_to` its path. ``feed``:
    of its tap, if there is one already; ``stop`` ends the program in order; ``kind``: of the program."""

    def end(_args: list[str]) -> None:
        if stop is None:
            raise UsageError("this program ends by itself, and not by a command")
        stop()

    specs = KINDS["run"]
    handlers: dict[str, Handler] = {
        "status": lambda _: run_status(bus),
        "outputs": lambda args: _outputs(bus, args),
        "set": lambda args: _set(bus, args),
        "operate": lambda _: bus.operate(),
        "clear": lambda _: bus.clear(),
        "stop": end,
        "drive": lambda args: drive_order(bus, args),
        "acyclic": lambda args: acyclic_order(bus, args),
        "class2": lambda args: acyclic_order(bus, args, class2=True),
        "diag": lambda args: _diag(bus, args[0]),
        "stats": lambda _: bus.stats.summary(),
        "scan": ScanOrder(bus),
        "why": lambda args: _why(bus, args),
        "tap": (feed or run_feed(bus)).handler,
        "live": lambda args: live_items(bus, args),
    }
    core = core_of(bus)
    if not bus.searching and core.bench is not None:
        specs = (*specs, *(spec for spec in SLAVES if spec.name not in handlers))
        handlers = slave_handlers(core.bench, core) | handlers
    # there may be several runs with a pty
    own, also = (f"{PTY}:{os.getpid()}", PTY) if port == PTY else (port, None)
    return ControlServer(kind, own, specs, handlers, also=also, config=bus.config.file)


def control_sim(simulation: Simulation, port: str) -> ControlServer:
    """The control server of simulated slaves on ``port``, or on the pty that they have made."""
    runtime = simulation.runtime
    feed = TapFeed(runtime.tap, runtime.now, lambda: _line_of(runtime, simulation.baud))
    handlers = {
        "status": lambda _: simulation.status(),
        "tap": feed.handler,
        **slave_handlers(simulation, simulation),
    }
    own, also = (simulation.port_name, PTY) if port == PTY else (port, None)
    return ControlServer("sim", own, KINDS["sim"], handlers, also=also, config=simulation.config.file)


def control_segment(segment: Segment, on_event: OnEvent | None = None) -> ControlServer:
    """The control server of a segment; its port is the directory. It calls ``on_event`` for each injected fault."""

    def reported(command: str, act: Callable[[list[str]], None]) -> Handler:
        def carry_out(args: list[str]) -> None:
            act(args)
            call_on_event(on_event, Injected(t_ns=monotonic_ns(), command=command, args=tuple(args)))

        return carry_out

    def noise(args: list[str]) -> None:
        rate = arguments.number(args[0], 0, 1, "1e-4")
        if rate == 1:
            raise UsageError("a probability of 1 leaves nothing; write for instance 1e-4")
        segment.error_rate = rate

    def silence(args: list[str]) -> None:
        segment.silence(_station(args[0]), _time_ns(args[1:]))

    handlers: dict[str, Handler] = {
        "status": lambda _: segment_status(segment),
        "noise": reported("noise", noise),
        "silence": reported("silence", silence),
        "resume": reported("resume", lambda args: segment.resume(_station(args[0]))),
        "stats": lambda _: segment.stats(),
        "tap": TapFeed(segment.tap, monotonic_ns, lambda: {"baud": segment.baud, "paced": segment.paced}).handler,
    }
    return ControlServer("segment", str(segment.directory), KINDS["segment"], handlers)


def run_feed(bus: Bus) -> TapFeed:
    """The feed of the tap of a master; a line has one tap at a time."""

    def about() -> dict[str, object]:
        return {"baud": None, "paced": True} if bus.searching else _line_of(core_of(bus).runtime, bus.params.baud)

    # nothing of these is there while the bus searches for its rate
    return TapFeed(lambda tap: core_of(bus).runtime.tap(tap), lambda: core_of(bus).runtime.now(), about)


def _line_of(runtime: Runtime, baud: int | None) -> dict[str, object]:
    return {"baud": baud, "paced": runtime.paced, "exact": isinstance(runtime, VirtualRuntime)}


def segment_status(segment: Segment) -> dict[str, object]:
    """State of the segment: ``error_rate``, ``baud``, ``ports``; ``injected``: the faults that act at this moment."""
    status: dict[str, object] = {"error_rate": segment.error_rate, "baud": segment.baud, "ports": segment.paths}
    injected = [f"noise {segment.error_rate:g}"] if segment.error_rate else []
    for number, left_ns in segment.silenced().items():
        injected.append(f"station {number}: {silence_text(left_ns)}")
    return status | ({"injected": injected} if injected else {})


def run_status(bus: Bus) -> dict[str, object]:
    """State of the master: ``seconds``, ``mode``, ``baud``, ``in_ring``, ``masters``, ``slaves``; ``clear``
    (:func:`~dpstack.api.bus.statistics.clear_since`) after it went to Clear by itself.

    While it searches its baud rate: only ``baud`` None and a ``text``.
    """
    if bus.searching:
        return {"baud": None, "text": SEARCHING}
    slaves: dict[str, object] = {}
    core = core_of(bus)
    drives = {drive.slave.address: drive for drive in bus.drives}
    for slave in bus.slaves:
        entry: dict[str, object] = {
            "name": slave.name,
            "state": slave.state.value,
            "inputs": slave.inputs.hex(),
            **inputs_dict(slave.inputs_valid, slave.inputs_age),
            **_outputs_of(slave),
        }
        if slave.fault is not None:
            entry["fault"] = slave.fault.text
        entry |= diagnosis_dict(slave)
        if slave.alarm_counts is not None:
            entry["alarms"] = structs.asdict(slave.alarm_counts)
        if slave.address in drives:
            entry["drive"] = drive_dict(core, drives[slave.address])
        if core.bench is not None:
            entry |= core.bench.status_of(slave.address)
        slaves[str(slave.address)] = entry
    return {
        "seconds": round(bus.seconds, 3),
        "address": bus.params.address,
        "mode": bus.mode.name.lower(),
        **({"clear": clear} if (clear := clear_since(core)) else {}),
        "baud": bus.params.baud,
        "in_ring": bus.snapshot.in_ring,
        "masters": sorted(bus.snapshot.las),
        "slaves": slaves,
    }


def _outputs_of(slave: Slave) -> dict[str, object]:
    """``outputs``: the octets that the master sends now, "" for none; ``held``: the application's if they differ.

    Likewise ``fields``, the named inputs and outputs, and ``held_fields``.
    """
    sent, held = slave.outputs_sent, slave.outputs_held
    named = as_json(slave.output_values)
    now = named
    entry: dict[str, object] = {"outputs": sent.hex()}
    if sent != held:
        entry["held"] = held.hex()
        there = len(sent) == len(held)
        now = as_json(slave.config.output_fields.values(sent)) if there else dict.fromkeys(named)
    fields = as_json(slave.input_values) | now
    if fields:
        entry["fields"] = fields
    if now != named:
        entry["held_fields"] = named
    return entry


async def _outputs(bus: Bus, args: list[str]) -> None:
    """Set output octets. Parses all arguments before the first one takes effect."""
    await _put_out(bus, {_slave_of(bus, where): octets for where, octets in map(arguments.octets, args)})


async def _set(bus: Bus, args: list[str]) -> None:
    """Set named outputs, and named inputs of simulated slaves. Parses all arguments before the first takes effect."""
    wanted: dict[Slave, bytes] = {}
    inputs: list[str] = []
    core = core_of(bus)
    for text in args:
        where, name, value = arguments.field_value(text)
        slave = _slave_of(bus, where)
        if core.bench is not None and name in slave.config.input_fields:
            inputs.append(text)
            continue
        found = slave.output_field(name)
        try:
            wanted[slave] = found.put(wanted.get(slave, slave.outputs_held), found.read(value))
        except ValueError as error:
            raise UsageError(f"{slave.who}: {error}") from None
    if core.bench is not None and inputs:
        _set_inputs(core.bench, core, inputs)
    if wanted:
        await _put_out(bus, wanted)


async def _put_out(bus: Bus, wanted: dict[Slave, bytes]) -> None:
    """Set outputs, and wait until the master has them. Raises OrderDropped where it does not take them in time."""
    for slave, octets in wanted.items():
        if any(drive.slave is slave for drive in bus.drives):
            raise UsageError(f"{slave.who}: its drive plugin makes the outputs")
        length = len(slave.outputs_held)
        if len(octets) != length:
            raise UsageError(f"{slave.who} has {octets_text(length)} of outputs, {octets_text(len(octets))} given")
    for slave, octets in wanted.items():
        slave.outputs = octets
    await bus.outputs_taken()


def _diag(bus: Bus, where: str) -> LongCommand:
    """The report on a station, given by address 0..126 or by the name of a slave; ``reading``: its octets.

    Raises UsageError for this master itself, BusError while it searches its baud rate.
    """
    if bus.searching:
        raise BusError(f"{SEARCHING}: no station can be asked before")
    number = number_or_name(where)
    known = next((slave for slave in bus.slaves if number in (slave.address, slave.name)), None)
    address = known.address if known is not None else arguments.within(where, int, 0, UNADDRESSED, _STATION)
    own = bus.params.address
    if address == own:
        raise UsageError(f"station {own} is this master itself: it has no diagnosis")

    async def work() -> dict[str, object]:
        reading = await read_station(bus.class2, address, own, "run", bus.snapshot.las)
        config = None if known is None else known.config
        devices = KnownDevices(slave.config for slave in bus.slaves)
        return {**station_report(reading, config, devices), "reading": reading.as_dict()}

    async def long_command(send: Send) -> dict[str, object]:
        return await kept_alive(work(), lambda: {"state": "asking"}, send)

    return long_command


_STATION: Final = "ADDRESS: write the address of a station, 0..126, or the name of a slave"


def _why(bus: Bus, args: list[str]) -> LongCommand:
    """The story of a slave. A scan of the bus may take some seconds."""
    slave = _slave_of(bus, args[0])

    async def tell() -> dict[str, object]:
        return (await bus.why(slave)).as_dict()

    return lambda send: kept_alive(tell(), lambda: {"state": slave.state.value}, send)


def _slave_of(bus: Bus, where: str) -> Slave:
    return bus.slave(address_of(where, {slave.address: slave.name for slave in bus.slaves}))


def _station(text: str) -> int:
    return arguments.whole_number(text, "station of the segment; they are numbered from 0")


def _time_ns(args: list[str]) -> int | None:
    return arguments.time_ns(args[0]) if args else None


def address_of(text: str, names: Mapping[int, str]) -> int:
    """The address of a slave by its address or name. Raises UsageError with the known ones."""
    for address, name in names.items():
        if text in (name, str(address)):
            return address
    known = ", ".join(f"{address} ({name})" for address, name in sorted(names.items())) or "none"
    raise UsageError(f"no slave {text!r} here; there are: {known}")


# --- the live list of a run ------------------------------------------------------------------------------------------


class ScanOrder:
    """The handler of ``scan``; one scan at a time, as each takes bus time that another one would wait for."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._under_way = False

    def __call__(self, _args: list[str]) -> LongCommand:
        """Items have ``progress``: ["addresses", number asked, 127]. The result is that of ``scan --json``, and each
        station also has ``config`` (identifier octets in hex, or null) and ``name`` (in the configuration, or null).

        Slaves do not change, and data exchange goes on: the master asks in the time that a token hold leaves.
        """
        if self._bus.searching:
            raise BusError(f"{SEARCHING}: a scan is possible once it is found")
        return self._carry_out

    async def _carry_out(self, send: Send) -> dict[str, Any]:
        if self._under_way:
            raise UsageError("a scan is under way already; ask again when it is over")
        self._under_way = True
        progress = ["addresses", 0, len(ALL_ADDRESSES)]
        try:
            return await kept_alive(self._scan(progress), lambda: {"progress": progress}, send)
        finally:
            self._under_way = False

    async def _scan(self, progress: list[Any]) -> dict[str, Any]:
        bus = self._bus
        found: list[Found] = []
        unreadable: set[int] = set()
        for at in range(0, len(ALL_ADDRESSES), _SCAN_PART):
            part = ALL_ADDRESSES[at : at + _SCAN_PART]
            found += await bus.scan(configs=True, addresses=part)
            unreadable |= core_of(bus).unreadable
            progress[1] = at + len(part)
        names = {slave.address: slave.name for slave in bus.slaves}
        return {
            "baud": bus.params.baud,
            "address": bus.params.address,
            "stations": [{"config": None, **one.as_dict(), "name": names.get(one.address)} for one in found],
            "unreadable": sorted(unreadable),
            "notes": list(answer_notes(found, unreadable)),
        }


# --- commands to simulated slaves of a sim, or of a run on "virtual" ----------------------------------------


def slave_handlers(bench: Bench, program: BusCore | Simulation | None = None) -> dict[str, Handler]:
    """The handlers of :data:`~dpstack.api.control.commands.SLAVES`; ``program`` publishes an event for each command."""

    def handler(command: str, act: _Act) -> Handler:
        def carry_out(args: list[str]) -> object:
            address = address_of(args[0], bench.names())
            result = act(bench, address, args[1:])
            _publish(bench, program, command, address, tuple(args))
            return result

        return carry_out

    faults = _Faults(program)
    acts = _ACTS | {"fault": faults.begin, "normal": faults.end}
    handlers = {command: handler(command, act) for command, act in acts.items()}
    return handlers | {"set": lambda args: _set_inputs(bench, program, args)}


class _Faults:
    """The faults that the command `fault` began, by the address of the slave; ``program`` publishes their ends."""

    def __init__(self, program: BusCore | Simulation | None) -> None:
        self._program = program
        self._open: dict[int, list[tuple[Deed, End]]] = {}

    def begin(self, bench: Bench, address: int, args: list[str]) -> None:
        deed, for_ns = read_fault(args, bench, address)
        end = deed.begin()
        if end is None:
            return
        self._open.setdefault(address, []).append((deed, end))
        if for_ns is not None:
            bench.call_at(bench.now + for_ns, partial(self._over, bench, address, deed, end))

    def end(self, bench: Bench, address: int, args: list[str]) -> None:
        for deed, end in self._open.get(address, ())[:]:
            self._over(bench, address, deed, end)

    def _over(self, bench: Bench, address: int, deed: Deed, end: End) -> None:
        found = self._open.get(address, [])
        if (deed, end) in found:
            found.remove((deed, end))
            if end() and self._program is not None:
                who = bench.units[address].who
                self._program.publish(Notice(t_ns=bench.now, source=who, message=f"over: {deed.text}"))


def _set_inputs(bench: Bench, program: BusCore | Simulation | None, args: list[str]) -> object:
    """Set named inputs of simulated slaves. Parses all arguments before the first one takes effect."""
    wanted: dict[int, bytes] = {}
    said: list[tuple[int, str, str]] = []
    for text in args:
        where, name, value = arguments.field_value(text)
        address = address_of(where, bench.names())
        unit = bench.units[address]
        found = unit.input_field(name)
        try:
            wanted[address] = found.put(wanted.get(address, unit.inputs), found.read(value))
        except ValueError as error:
            raise UsageError(f"{unit.who}: {error}") from None
        said.append((address, where, f"{name}={value}"))
    remarks = [bench.units[address].set_inputs(octets) for address, octets in wanted.items()]
    for address, where, text in said:
        _publish(bench, program, "set", address, (where, text))
    return next((f"done, without an alarm: {remark}" for remark in remarks if remark), None)


def _publish(
    bench: Bench, program: BusCore | Simulation | None, command: str, address: int, args: tuple[str, ...]
) -> None:
    if program is not None:
        now, name = program.runtime.now(), bench.names()[address]
        program.publish(Injected(t_ns=now, command=command, args=args, address=address, name=name))


def _input(bench: Bench, address: int, args: list[str]) -> object:
    """Set all inputs of a slave, or those of a module."""
    unit = bench.units[address]
    if len(args) > 1 and isinstance(unit.device, IoStation):
        return _OF_SLOT(bench, address, args)
    octets = arguments.hex_octets(args[-1], "write for instance 01FF")
    if len(args) > 1:
        octets = unit.with_module_inputs(arguments.whole_number(args[0]), octets)
    remark = unit.set_inputs(octets)
    return None if remark is None else f"done, without an alarm: {remark}"


def _of_drive(act: Callable[..., None]) -> _Act:
    """A handler that calls ``act`` with the drive and the arguments."""

    def carry_out(bench: Bench, address: int, args: list[str]) -> None:
        device = bench.device(address)
        if not isinstance(device, DriveDevice):
            what = "the I/O station" if isinstance(device, IoStation) else "it mirrors its outputs"
            raise UsageError(f"slave {address} ({device.name}) is no simulated drive: {what}")
        act(device, *args)

    return carry_out


def _of_station(act: Callable[[IoStation, int, list[str]], str | None]) -> _Act:
    """A handler that calls ``act`` with the I/O station, the slot and the arguments after it."""

    def carry_out(bench: Bench, address: int, args: list[str]) -> str | None:
        device = bench.device(address)
        if not isinstance(device, IoStation):
            raise UsageError(f'slave {address} ({device.name}) is no I/O station; one has gsd = "io-station"')
        left_out = act(device, arguments.whole_number(args[0]), args[1:])
        return None if left_out is None else f"done, without an alarm: {left_out}"

    return carry_out


def _refuse(drive: DriveDevice, error: str, times: str = "1") -> None:
    count = arguments.whole_number(times)
    if not count:
        raise UsageError("0 times: write 1 or more")
    drive.refuse(error, count)


#: the inputs of a module of the I/O station
_OF_SLOT: Final = _of_station(
    lambda io, slot, args: io.set_input(slot, arguments.hex_octets(args[0], "write for instance 01"))
)

_ACTS: Final[dict[str, _Act]] = {
    "trip": _of_drive(lambda drive, code: drive.trip(code)),
    "warn": _of_drive(lambda drive, text: drive.warn(arguments.mask(text))),
    "load": _of_drive(lambda drive, text: drive.set_load(arguments.number(text, -10, 10, "0.6"))),
    "release": _of_drive(lambda drive, text: drive.release(arguments.switch(text))),
    "jog": _of_drive(lambda drive, text: drive.jog(arguments.direction(text))),
    "mains": _of_drive(lambda drive, text: drive.mains(arguments.switch(text))),
    "link": _of_drive(lambda drive, text: drive.link(arguments.switch(text))),
    "parameter-error": _of_drive(_refuse),
    "input": _input,
    "mirror": lambda bench, address, args: bench.units[address].set_inputs(None),
    "wire-break": _of_station(
        lambda io, slot, args: io.wire_break(slot, arguments.whole_number(args[0]), arguments.switch(args[1]))
    ),
    "pull": _of_station(lambda io, slot, args: io.pull(slot)),
    "plug": _of_station(lambda io, slot, args: io.plug(slot, args[0] if args else "")),
    "parameter": _of_station(lambda io, slot, args: io.set_parameter(slot, arguments.octet(args[0]))),
    "silence": lambda bench, address, args: bench.silence(address, _time_ns(args)),
    "resume": lambda bench, address, args: bench.resume(address),
    "power-off": lambda bench, address, args: bench.power(address, False),
    "power-on": lambda bench, address, args: bench.power(address, True),
}
