"""The control servers of sim and segment, and the handlers of the commands to simulated slaves."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import monotonic_ns
from typing import TYPE_CHECKING, Final

from dpstack.api.bus.core import BusCore
from dpstack.api.control import arguments
from dpstack.api.control.arguments import PTY
from dpstack.api.control.commands import KINDS
from dpstack.api.control.control_server import ControlServer, Handler
from dpstack.api.control.scenario import read_fault
from dpstack.api.control.tap_feed import TapFeed
from dpstack.api.injected import Injected
from dpstack.api.slave_side.fault_steps import Deed, End
from dpstack.api.slave_side.simulation import Segment, Simulation
from dpstack.api.slave_side.virtual_bench import CPU_COMMANDS, Bench, silence_text
from dpstack.api.streams import OnEvent, call_on_event
from dpstack.errors import UsageError
from dpstack.profile.simulator.device import DriveDevice
from dpstack.sim.io_station.station import IoStation
from dpstack.trace import Notice
from dpstack.units import ns_to_s

if TYPE_CHECKING:
    from dpstack.pa.simulated.slave import ProcessSlave

#: carries out a command: bench, address of the simulated slave, further arguments
_Act = Callable[[Bench, int, list[str]], object]


def control_sim(simulation: Simulation, port: str) -> ControlServer:
    """The control server of simulated slaves on ``port``, or on the pty that they have made."""
    runtime = simulation.runtime
    feed = TapFeed(runtime.tap, runtime.now, lambda: {"baud": simulation.baud, "paced": runtime.paced, "exact": False})
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


def segment_status(segment: Segment) -> dict[str, object]:
    """State of the segment: ``error_rate``, ``baud``, ``ports``; ``injected``: the faults that act at this moment."""
    status: dict[str, object] = {"error_rate": segment.error_rate, "baud": segment.baud, "ports": segment.paths}
    injected = [f"noise {segment.error_rate:g}"] if segment.error_rate else []
    for number, left_ns in segment.silenced().items():
        injected.append(f"station {number}: {silence_text(left_ns)}")
    return status | ({"injected": injected} if injected else {})


def _station(text: str) -> int:
    return arguments.whole_number(text, "station of the segment; they are numbered from 0")


def _time_ns(args: list[str]) -> int | None:
    return arguments.time_ns(args[0]) if args else None


def slave_handlers(bench: Bench, program: BusCore | Simulation | None = None) -> dict[str, Handler]:
    """The handlers of :data:`~dpstack.api.control.commands.SLAVES`; ``program`` publishes an event for each command."""

    def handler(command: str, act: _Act) -> Handler:
        def carry_out(args: list[str]) -> object:
            address = bench.address_of(args[0])
            if command not in CPU_COMMANDS:
                bench.unit(args[0])
            result = act(bench, address, args[1:])
            _publish(bench, program, command, address, tuple(args))
            return result

        return carry_out

    def drive_handler(command: str, act: Callable[..., None]) -> Handler:
        def carry_out(args: list[str]) -> None:
            address, drive = bench.drive(args[0], or_encoder=command in _OF_ENCODERS)
            act(drive, *args[1:])
            _publish(bench, program, command, address, tuple(args))

        return carry_out

    faults = _Faults(program)
    acts = _ACTS | {"fault": faults.begin, "normal": faults.end}
    handlers = {command: handler(command, act) for command, act in acts.items()}
    handlers |= {command: drive_handler(command, act) for command, act in _DRIVE_ACTS.items()}
    return handlers | {"set": lambda args: set_inputs(bench, program, args)}


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


def set_inputs(bench: Bench, program: BusCore | Simulation | None, args: list[str]) -> object:
    """Set named inputs of simulated slaves. Parses all arguments before the first one takes effect."""
    wanted: dict[int, bytes] = {}
    of_cpus: dict[int, dict[str, object]] = {}
    said: list[tuple[int, str, str]] = []
    for text in args:
        where, name, value = arguments.field_value(text)
        address = bench.address_of(where)
        if address in bench.cpus:
            of_cpus.setdefault(address, {})[name] = value
            said.append((address, where, f"{name}={value}"))
            continue
        unit = bench.units[address]
        try:
            wanted[address] = unit.put_input(wanted.get(address, unit.inputs), name, value)
        except ValueError as error:
            raise UsageError(f"{unit.who}: {error}") from None
        said.append((address, where, f"{name}={value}"))
    for address, values in of_cpus.items():
        bench.cpus[address].set_values(values)
    remarks = [bench.units[address].set_inputs(octets) for address, octets in wanted.items()]
    for address, where, text in said:
        _publish(bench, program, "set", address, (where, text))
    return next((f"done, without an alarm: {remark}" for remark in remarks if remark), None)


def _publish(
    bench: Bench, program: BusCore | Simulation | None, command: str, address: int, args: tuple[str, ...]
) -> None:
    if program is not None:
        now, unit = program.runtime.now(), bench.station(address)
        slave = bench.units.get(address)
        several = {} if slave is None or slave.several is None else slave.several.drives
        name = f"{unit.name}, {args[0]}" if args[0] in several else unit.name
        program.publish(Injected(t_ns=now, command=command, args=args, address=unit.address, name=name))


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


def _turn(bench: Bench, address: int, args: list[str]) -> None:
    unit = bench.units[address]
    if unit.encoder is None:
        raise UsageError(f"{unit.who} is no simulated encoder")
    unit.encoder.turn(arguments.number(args[0], -100_000, 100_000, "60"))


def _of_process(act: Callable[..., None]) -> _Act:
    """A handler that calls ``act`` with the simulated process device and the arguments after it."""

    def carry_out(bench: Bench, address: int, args: list[str]) -> None:
        try:
            act(bench.process_device(address), *args)
        except ValueError as error:
            raise UsageError(f"{bench.units[address].who}: {error}") from None

    return carry_out


def _simulate(device: ProcessSlave, value: str, status: str = "", block: str = "") -> None:
    if value == "off":
        device.simulate(None, block=status or block)
        return
    number = arguments.number(value, -1e9, 1e9, "7.5, or off")
    device.simulate(number, arguments.octet(status) if status else None, block)


def _of_station(act: Callable[[IoStation, int, list[str]], str | None]) -> _Act:
    """A handler that calls ``act`` with the I/O station, the slot and the arguments after it."""

    def carry_out(bench: Bench, address: int, args: list[str]) -> str | None:
        device = bench.device(address)
        if not isinstance(device, IoStation):
            raise UsageError(f'slave {address} ({device.name}) is no I/O station; one has gsd = "io-station"')
        left_out = act(device, arguments.whole_number(args[0]), args[1:])
        return None if left_out is None else f"done, without an alarm: {left_out}"

    return carry_out


def _hart(io: IoStation, slot: int, args: list[str]) -> None:
    """CHANNEL FAULT [VALUE]: how many requests, a time for "slow", an octet for "status"."""
    channel, fault, *rest = arguments.whole_number(args[0]), *args[1:]
    if fault == _STATUS:
        io.hart_status(slot, channel, arguments.octet(rest[0] if rest else "00"))
        return
    value: float | None = None
    if rest:
        value = ns_to_s(arguments.time_ns(rest[0])) if fault == _SLOW else arguments.whole_number(rest[0])
    io.hart_fault(slot, channel, fault, value)


def _refuse(drive: DriveDevice, error: str, times: str = "1") -> None:
    count = arguments.whole_number(times)
    if not count:
        raise UsageError("0 times: write 1 or more")
    drive.refuse(error, count)


#: words of the command `hart` whose value is no number of requests
_STATUS: Final = "status"
_SLOW: Final = "slow"
#: the inputs of a module of the I/O station
_OF_SLOT: Final = _of_station(
    lambda io, slot, args: io.set_input(slot, arguments.hex_octets(args[0], "write for instance 01"))
)

#: each is called with the simulated drive and the arguments
_DRIVE_ACTS: Final[dict[str, Callable[..., None]]] = {
    "trip": lambda drive, code: drive.trip(code),
    "warn": lambda drive, text: drive.warn(arguments.mask(text)),
    "load": lambda drive, text: drive.set_load(arguments.number(text, -10, 10, "0.6")),
    "release": lambda drive, text: drive.release(arguments.switch(text)),
    "contact": lambda drive, name, text: drive.contact(name, arguments.switch(text)),
    "set-point": lambda drive, text: drive.set_point(arguments.number(text, -1000, 1000, "12.5")),
    "acknowledge": lambda drive: drive.acknowledge(),
    "jog": lambda drive, text: drive.jog(arguments.direction(text)),
    "mains": lambda drive, text: drive.mains(arguments.switch(text)),
    "link": lambda drive, text: drive.link(arguments.switch(text)),
    "parameter-error": _refuse,
}
#: those that a simulated encoder knows too
_OF_ENCODERS: Final = frozenset({"trip", "warn", "acknowledge"})
#: each is called with the simulated process device and the arguments
_PROCESS_ACTS: Final[dict[str, Callable[..., None]]] = {
    "process": lambda device, text, name="": device.set_process(arguments.number(text, -1e9, 1e9, "1.2"), name),
    "simulate": _simulate,
    "fail-safe": lambda device, text: device.order_fail_safe(arguments.switch(text)),
    "sensor-failure": lambda device, text: device.sensor_failure(arguments.switch(text)),
    "maintenance": lambda device, degree: device.maintenance(degree),
    "function-check": lambda device, text: device.function_check(arguments.switch(text)),
    "out-of-service": lambda device, text: device.out_of_service(arguments.switch(text)),
    "local-operation": lambda device, text: device.local_operation(arguments.switch(text)),
    "jam": lambda device, text: device.block_valve(arguments.switch(text)),
    "write-protect": lambda device, text: device.write_protect(arguments.switch(text)),
    "slow": lambda device, text: device.answer_after(arguments.number(text, 0, 60, "2")),
}
_ACTS: Final[dict[str, _Act]] = {
    **{command: _of_process(act) for command, act in _PROCESS_ACTS.items()},
    "turn": _turn,
    "input": _input,
    "mirror": lambda bench, address, args: bench.units[address].set_inputs(None),
    "wire-break": _of_station(
        lambda io, slot, args: io.wire_break(slot, arguments.whole_number(args[0]), arguments.switch(args[1]))
    ),
    "hart": _of_station(_hart),
    "pull": _of_station(lambda io, slot, args: io.pull(slot)),
    "plug": _of_station(lambda io, slot, args: io.plug(slot, args[0] if args else "")),
    "parameter": _of_station(lambda io, slot, args: io.set_parameter(slot, arguments.octet(args[0]))),
    "silence": lambda bench, address, args: bench.silence(bench.station(address).name, _time_ns(args)),
    "resume": lambda bench, address, args: bench.resume(bench.station(address).name),
    "power-off": lambda bench, address, args: bench.power(bench.station(address).name, False),
    "power-on": lambda bench, address, args: bench.power(bench.station(address).name, True),
}
