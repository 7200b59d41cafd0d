"""The control servers of the three kinds of programs: what each command does to them."""

from __future__ import annotations

import dataclasses
import os
from typing import Final

from dpstack.api.bench import station_status
from dpstack.api.bus import Bus
from dpstack.api.control import arguments
from dpstack.api.control.drives import drive_order
from dpstack.api.control.records import acyclic_order
from dpstack.api.control.server import ControlServer, Handler
from dpstack.api.control.slaves import SlaveCommands, address_of
from dpstack.api.control.specs import KINDS, SLAVES
from dpstack.api.parts import SEARCHING
from dpstack.api.simulation import Segment, Simulation
from dpstack.api.statistics import inputs_dict
from dpstack.dp.commands import Mode, SetMode
from dpstack.dp.fields import as_json
from dpstack.errors import UsageError

#: a pty that the program makes itself
PTY: Final = "pty"


def control_run(bus: Bus, port: str) -> ControlServer:
    """Talks to a master on ``port``; on a pty of its own :meth:`ControlServer.move_to` the path once it is known."""
    specs = KINDS["run"]
    handlers: dict[str, Handler] = {
        "status": lambda _: run_status(bus),
        "outputs": lambda args: _outputs(bus, args),
        "set": lambda args: _set(bus, args),
        "operate": lambda _: bus.command(SetMode(Mode.OPERATE)),
        "clear": lambda _: bus.command(SetMode(Mode.CLEAR)),
        "drive": lambda args: drive_order(bus, args),
        "acyclic": lambda args: acyclic_order(bus, args),
        "class2": lambda args: acyclic_order(bus, args, class2=True),
        "stats": lambda _: bus.stats.summary(),
    }
    if not bus.searching and bus.bench is not None:
        specs = (*specs, *SLAVES)
        handlers |= SlaveCommands(bus.bench).handlers()
    if port == PTY:  # there may be several
        return ControlServer("run", f"{PTY}:{os.getpid()}", specs, handlers, also=PTY, config=bus.config.file)
    return ControlServer("run", port, specs, handlers, config=bus.config.file)


def control_sim(simulation: Simulation, port: str) -> ControlServer:
    """Talks to simulated slaves on ``port``; of a pty made here the path of it, too."""
    handlers: dict[str, Handler] = {
        "status": lambda _: simulation.status(),
        **SlaveCommands(simulation).handlers(),
    }
    config = simulation.config.file
    if port == PTY:
        return ControlServer("sim", simulation.port_name, KINDS["sim"], handlers, also=PTY, config=config)
    return ControlServer("sim", port, KINDS["sim"], handlers, config=config)


def control_segment(segment: Segment) -> ControlServer:
    """Talks to a segment, found by its directory."""

    def noise(args: list[str]) -> None:
        rate = arguments.number(args[0], 0, 1, "1e-4")
        if rate == 1:
            raise UsageError("a probability of 1 leaves nothing; write for instance 1e-4")
        segment.error_rate = rate

    def silence(args: list[str]) -> None:
        segment.silence(_station(args[0]), arguments.time_ns(args[1]) if len(args) > 1 else None)

    handlers: dict[str, Handler] = {
        "status": lambda _: {"error_rate": segment.error_rate, "baud": segment.baud, "ports": segment.paths},
        "noise": noise,
        "silence": silence,
        "resume": lambda args: segment.resume(_station(args[0])),
        "stats": lambda _: segment.stats(),
    }
    return ControlServer("segment", str(segment.directory), KINDS["segment"], handlers)


def run_status(bus: Bus) -> dict[str, object]:
    """The master at this moment: ``seconds``, ``mode``, ``baud``, ``in_ring``, ``masters``, and each slave.

    While the baud rate is searched only that: ``baud`` None and a ``text``.
    """
    if bus.searching:
        return {"baud": None, "text": SEARCHING}
    slaves: dict[str, object] = {}
    drives = {drive.slave.address: drive for drive in bus.drives}
    for slave in bus.slaves:
        entry: dict[str, object] = {
            "name": slave.name,
            "state": slave.state.value,
            "inputs": slave.inputs.hex(),
            **inputs_dict(slave.inputs_valid, slave.inputs_age),
            "outputs": slave.outputs.hex(),
        }
        fields = slave.input_values | slave.output_values
        if fields:
            entry["fields"] = as_json(fields)
        if slave.fault is not None:
            entry["fault"] = slave.fault.text
        if slave.alarm_counts is not None:
            entry["alarms"] = dataclasses.asdict(slave.alarm_counts)
        if slave.address in drives:
            entry["drive"] = drives[slave.address].status.as_dict()
        if bus.bench is not None:
            entry |= station_status(bus.bench.device(slave.address))
        slaves[str(slave.address)] = entry
    return {
        "seconds": round(bus.seconds, 3),
        "mode": bus.mode.name.lower(),
        "baud": bus.params.baud,
        "in_ring": bus.station.in_ring,
        "masters": sorted(bus.station.las),
        "slaves": slaves,
    }


async def _outputs(bus: Bus, args: list[str]) -> None:
    """All or nothing: every argument is understood before the first one takes effect."""
    names = {slave.address: slave.name for slave in bus.slaves}
    wanted = {}
    for text in args:
        where, octets = arguments.octets(text)
        wanted[address_of(where, names)] = octets
    await _put_out(bus, wanted)


async def _set(bus: Bus, args: list[str]) -> None:
    """Named outputs; all or nothing as well, those of one slave in one image."""
    names = {slave.address: slave.name for slave in bus.slaves}
    wanted: dict[int, bytes] = {}
    for text in args:
        where, name, value = arguments.field_value(text)
        address = address_of(where, names)
        slave = bus.slave(address)
        found = slave.output_field(name)
        try:
            wanted[address] = found.put(wanted.get(address, slave.outputs), found.read(value))
        except ValueError as error:
            raise UsageError(f"slave {address} ({slave.name}): {error}") from None
    await _put_out(bus, wanted)


async def _put_out(bus: Bus, wanted: dict[int, bytes]) -> None:
    """Returns when the master has them. Raises OrderDropped where it does not take them in time."""
    for address, octets in wanted.items():
        slave = bus.slave(address)
        if any(drive.slave is slave for drive in bus.drives):
            raise UsageError(f"slave {address} ({slave.name}): its drive plugin makes the outputs")
        if len(octets) != len(slave.outputs):
            raise UsageError(
                f"slave {address} ({slave.name}) has {len(slave.outputs)} octets of outputs, {len(octets)} were given"
            )
    for address, octets in wanted.items():
        bus.slave(address).outputs = octets
    await bus.outputs_taken()


def _station(text: str) -> int:
    if not text.isdecimal():
        raise UsageError(f"{text!r} is no station of the segment; they are numbered from 0")
    return int(text)
