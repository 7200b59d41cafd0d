"""``dpstack acyclic``: Read and Write of DP-V1, I&M, at one slave."""

from __future__ import annotations

import argparse
import asyncio
import dataclasses
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from dpstack.api.bus.bus import Bus
from dpstack.api.bus.events_json import AddressCollision, Event, FaultKind, Notice, Severity, SlaveFaulted, severity_of
from dpstack.api.bus.open_bus import open_bus
from dpstack.api.bus.temporary_master import joined
from dpstack.api.bus.virtual import World, simulate
from dpstack.api.config.config import Config, load_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.commands import find_word
from dpstack.api.control.own_master import READY_S
from dpstack.api.control.record_commands import COMPARE, PARAMETERS, TRANSPORT, WORDS, OnProgress, carry_out, check
from dpstack.api.control.remote_records import through_run
from dpstack.api.lists.record_list import RecordList, list_of
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.commands.lists import FILES, show_comparison, show_dump, show_list
from dpstack.cli.commands.on_bus import tell_simulated
from dpstack.cli.terminal import output
from dpstack.cli.terminal.drawing import progress_bar
from dpstack.cli.terminal.lost_stdout import warn
from dpstack.cli.terminal.signals import StopSignal
from dpstack.errors import BusError, SlaveFault, UsageError
from dpstack.text import octets_text

_WORDS: Final = (*WORDS, TRANSPORT, *FILES)


#: where another master has the address, or the slave
_BESIDE: Final = "; or ask beside that master with --class 2, where the slave has it"


class Order(NamedTuple):
    """One word and what belongs to it."""

    word: str
    args: tuple[str, ...]


def add_to(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.epilog = (
        "example: dpstack acyclic plant.toml 8 read 1 47\n"
        "         dpstack acyclic plant.toml valves write 1 47 00FF\n"
        "         dpstack acyclic plant.toml 8 im\n"
        "         dpstack acyclic plant.toml 8 im --class 2\n"
        "         dpstack acyclic plant.toml 8 dump pump.toml\n\norders:\n"
        + "\n".join(f"  {f'{spec.name} {spec.usage}':29} {spec.text}" for spec in _WORDS)
    )
    parser.add_argument("config", metavar="CONFIG", help="configuration file")
    parser.add_argument("slave", metavar="ADDRESS", help="the slave, by its address or its name there")
    parser.add_argument("order", metavar="ORDER", help="read, write, im ..., see below")
    parser.add_argument("args", metavar="ARG", nargs="*", help="what belongs to it; numbers 47 or 0x2F")
    parser.add_argument("--all", action="store_true", help="compare: what is read only, too")
    parser.add_argument(
        "--class",
        dest="master",
        metavar="1|2",
        type=int,
        choices=(1, 2),
        default=1,
        help="of master; 2: over a connection of its own (MS2), beside the slave's master, without parameterising it",
    )
    parser.add_argument(
        "--address",
        metavar="A",
        type=options.address,
        help="class 2 in the foreground: ask from this address (default: the lowest not heard)",
    )
    parser.add_argument("--port", metavar="P", help="another port")
    parser.add_argument("--baud", metavar="B|auto", type=options.baud_or_auto, help='another rate; "auto": listens')
    options.add_json(parser)
    parser.set_defaults(execute=execute)


def execute(args: argparse.Namespace) -> int:
    """1 where the slave refuses or does not answer."""
    config = load_config(args.config).with_bus(port=args.port, baud=args.baud)
    if args.address is not None and args.master == 1:
        raise UsageError("--address is for --class 2; a master of class 1 has that of the configuration")
    spec = find_word(args.order, _WORDS, "dpstack acyclic")
    spec.check(args.args)
    in_file = spec in FILES
    order = Order(PARAMETERS, tuple(args.args[1:])) if in_file else Order(args.order, tuple(args.args))
    check(*order, class2=args.master == 2)
    if args.all and args.order != COMPARE:
        raise UsageError(f"--all is for {COMPARE}: leave it out")
    asked = _Asked(config, _slave_of(config, args.slave), order, args.order, args.master, args.address)
    match args.order:
        case "dump":
            return _dump(asked, args.args[0], json=args.json)
        case "compare":
            return _compare(asked, args.args[0], read_only=args.all, json=args.json)
        case _:
            return _tell(asked, json=args.json)


class _Asked(NamedTuple):
    """``order`` of a slave; ``word``: as it was typed. ``master``: class 1 or 2; ``own``: its address, None: any."""

    config: Config
    slave: SlaveConfig
    order: Order
    word: str
    master: int
    own: int | None

    def told(self) -> Mapping[str, Any] | None:
        """What came of it; None where a signal ended it before."""
        told = asyncio.run(_run(self))
        if told is None:
            warn(f"ended before {self.word} was done")
        return told


def _tell(asked: _Asked, *, json: bool) -> int:
    told = asked.told()
    if told is None:
        return 1
    if json:
        output.json_line(told)
    else:
        _show(told)
    return 0


def _dump(asked: _Asked, path: str, *, json: bool) -> int:
    with RecordList.file(path, asked.slave.name) as file:
        told = asked.told()
        if told is None:
            return 1
        list_of(told).keep(file)
    show_dump(told, path, json=json)
    return 0


def _compare(asked: _Asked, path: str, *, read_only: bool, json: bool) -> int:
    saved = RecordList.load(path)
    told = asked.told()
    return 1 if told is None else show_comparison(told, path, saved, read_only=read_only, json=json)


async def _run(asked: _Asked) -> Mapping[str, Any] | None:
    """What came of it; None where a signal ended it before."""
    found: list[Mapping[str, Any]] = []
    slave, order = asked.slave, asked.order

    async def done(progress: OnProgress) -> None:
        told = await through_run(asked.config, slave.address, *order, progress, master=asked.master)
        if told is not None:
            found.append({**told, "through": "run"})
            return
        in_foreground = _as_master if asked.master == 1 else _as_class2
        found.append({**await in_foreground(asked, progress), "through": "master"})

    with StopSignal() as stop, progress_bar(f"{order.word} of {slave.name}") as progress:
        await stop.or_done(done(progress))
    return found[0] if found else None


async def _as_master(asked: _Asked, progress: OnProgress) -> Mapping[str, Any]:
    """The master stays in Clear: records are open, and no output is set."""
    config, slave = asked.config, asked.slave
    if config.bus.read_only:
        raise UsageError("the configuration is read only: records need data exchange; leave read_only out")
    tell_simulated(config)
    foreign = up = False

    def on_event(event: Event) -> None:
        nonlocal foreign
        match event:  # of what keeps it from coming up the error tells
            case AddressCollision():
                foreign = True
            case SlaveFaulted(fault=fault) if not up:
                foreign = foreign or fault.kind is FaultKind.LOCKED
            case _:
                _event(event)

    try:
        async with open_bus(config.only(slave), on_event=on_event) as bus:
            found = bus.slave(slave.address)
            await found.ready(READY_S)
            up = True
            return await carry_out(found, *asked.order, progress)
    except (BusError, SlaveFault) as error:
        if not foreign:
            raise
        text = f"{error}{_BESIDE}"
        raise BusError(text) if isinstance(error, BusError) else SlaveFault(slave.address, text) from None


async def _as_class2(asked: _Asked, progress: OnProgress) -> Mapping[str, Any]:
    """A station without slaves, at an address that nobody uses: neither the slave nor its master notices."""
    config, slave = asked.config, asked.slave
    if config.bus.read_only:
        raise UsageError("the configuration is read only: a connection is to be opened; leave read_only out")
    tell_simulated(config)
    world = None
    if config.virtual:
        world = World()
        simulate(world, [slave], baud=config.baud)

    def make_bus(address: int) -> Bus:
        settings = dataclasses.replace(config.bus, address=address, cycle_ms=None, cycle_freeze=(), cycle_sync=())
        return open_bus(dataclasses.replace(config, bus=settings, slaves=()), on_event=on_bus.once(_event), world=world)

    taken = {config.bus.address, *(one.address for one in config.slaves)}
    async with joined(make_bus, asked.own, avoid=taken) as bus, bus.class2.connect(slave) as connection:
        return await carry_out(connection, *asked.order, progress)


def _event(event: Event) -> None:
    if severity_of(event) is not Severity.INFO and not (isinstance(event, Notice) and event.source == "plan"):
        warn(event.text)


def _show(told: Mapping[str, Any]) -> None:
    who = f"slave {told['address']} ({told['slave']})"
    match told["order"]:
        case "read" | "transport":
            octets = bytes.fromhex(told["data"])
            output.line(f"{who}: slot {told['slot']}, index {told['index']}, {octets_text(len(octets))}")
            for at in range(0, len(octets), 16):
                line = octets[at : at + 16]
                text = "".join(chr(octet) if 32 <= octet < 127 else "." for octet in line)
                output.line(f"{at:3}  {line.hex(' ').upper():47}  {text}")
        case "parameters":
            show_list(told)
        case "write":
            output.line(f"{who}: slot {told['slot']}, index {told['index']}: {octets_text(told['length'])} written")
        case _:
            rows = [
                (f"I&M{n}", name, _im_text(name, value))
                for n, record in told["im"].items()
                for name, value in record.items()
            ]
            output.table(f"{who}: slot {told['slot']}", ("record", "what", "value"), rows)


def _im_text(name: str, value: Any) -> str:
    """A field of an I&M record as people read it."""
    match name, value:
        case "version", [major, minor]:
            return f"{major}.{minor}"
        case "supported", int():
            there = [f"I&M{n}" if n else "profile specific" for n in range(16) if value >> n & 1]
            return f"{', '.join(there) or 'I&M0 only'} (0x{value:04X})"
        case _:
            return str(value)


def _slave_of(config: Config, name: str) -> SlaveConfig:
    """Raises UsageError naming the slaves there are."""
    slave = config.find(name)
    if slave is not None:
        return slave
    known = ", ".join(f"{slave.address} ({slave.name})" for slave in config.slaves) or "none"
    raise UsageError(f"no slave {name!r} in this configuration; there are: {known}")
