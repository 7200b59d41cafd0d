"""``dpstack acyclic``: DP-V1 records and I&M of one slave."""

from __future__ import annotations

import argparse
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import Any, Final, NamedTuple

from dpstack.api.bus.events_json import AddressCollision, Event, FaultKind, SlaveFaulted
from dpstack.api.bus.opening import open_bus
from dpstack.api.commissioning.live_list import joined
from dpstack.api.config.config import Config, load_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.commands import ParsedCommand, Spec, find_word
from dpstack.api.control.record_orders import (
    COMPARE,
    DUMP,
    PA,
    PARAMETERS,
    TRANSPORT,
    WORDS,
    OnProgress,
    carry_out,
    check_order,
    parse_order,
)
from dpstack.api.control.remote import through_run
from dpstack.api.lists.record_list import ListedValues, RecordList, compared, list_of
from dpstack.api.slave.class2 import Connection
from dpstack.api.slave.slave import Slave
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.commands.lists import show_comparison, show_dump
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.drawing import progress_bar
from dpstack.cli.terminal.signals import run_to_result
from dpstack.errors import BusError, SlaveFault, UsageError
from dpstack.text import octets_text

_FILES: Final = (
    Spec(DUMP, "FILE [SLOT] [OBJECT]", "that list into a file", "pump.toml"),
    Spec(COMPARE, "FILE [SLOT] [OBJECT]", "where the device differs from such a file", "pump.toml"),
)
#: process devices have a command of their own
_WORDS: Final = (*(spec for spec in WORDS if spec.name != PA), TRANSPORT, *_FILES)
#: the way out if another station has the master's address, or another master the slave
_BESIDE: Final = "; or ask beside that master with --class 2, if the slave has it"


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "example: dpstack acyclic plant.toml 8 read 1 47\n"
        "         dpstack acyclic plant.toml valves write 1 47 00FF\n"
        "         dpstack acyclic plant.toml 8 parameter 1120\n"
        "         dpstack acyclic plant.toml 8 stamps 100\n"
        "         dpstack acyclic plant.toml 8 im\n"
        "         dpstack acyclic plant.toml 8 im --class 2\n"
        "         dpstack acyclic plant.toml 8 dump pump.toml\n\norders:\n"
        + "\n".join(f"  {f'{spec.name} {spec.usage}':29} {spec.text}" for spec in _WORDS)
    )
    parser.value("config", "CONFIG", "configuration file")
    parser.value("slave", "ADDRESS", "the slave, by its address or its name there")
    parser.value("order", "ORDER", "read, write, im ..., see below")
    parser.value("args", "ARG", "what belongs to it; numbers 47 or 0x2F", nargs="*", default=[])
    parser.flag("--all", "compare: what is read only, too")
    add_master_options(parser, default=1)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if the slave refuses or does not answer."""
    config = load_config(args.config).with_bus(port=args.port, baud=args.baud)
    slave = on_bus.slave_of(config, args.slave)
    master = master_of(args, slave)
    spec = find_word(args.order, _WORDS, "dpstack acyclic")
    spec.check(args.args)
    path, word, texts = "", args.order, args.args
    if spec in _FILES:
        (path, *texts), word = texts, PARAMETERS
    order = parse_order(word, texts, class2=master == 2)
    if args.all and args.order != COMPARE:
        raise UsageError(f"--all is for {COMPARE}: leave it out")
    request = RecordOrder(config, slave, order, args.order, master, args.address)
    check_order(order, slave)
    if args.order == DUMP:
        with RecordList.file(path, slave.name) as file:
            answer = request.answer()
            read = list_of(answer)
            read.keep(file)
        unreadable = [one.as_dict() for one in read.unreadable]
        show_dump(_who(answer), read, _head(answer, args), unreadable, json=args.json)
    elif args.order == COMPARE:
        saved = RecordList.load(path)
        answer = request.answer()
        found = compared(list_of(answer), saved, read_only=args.all, where=path)
        differences = [
            {"file": one.saved.as_dict(), "device": one.found.as_dict(), "elements": list(one.elements)}
            for one in found.differences
        ]
        skipped = [{"number": one.number, "reason": why} for one, why in found.skipped]
        return show_comparison(_who(answer), found, _head(answer, args), differences, skipped, json=args.json)
    else:
        answer = request.answer()
        output.json_line(answer) if args.json else _show(answer)
    return 0


def _head(answer: Mapping[str, Any], args: argparse.Namespace) -> dict[str, object]:
    kept = {key: answer[key] for key in ("slave", "address", "slot", "object", "through")}
    return {"order": args.order, **kept, "file": args.args[0]}


def _who(answer: Mapping[str, Any]) -> str:
    return f"slave {answer['address']} ({answer['slave']})"


def add_master_options(parser: Parser, *, default: int | None = None) -> None:
    """Options that say who asks, class of master, own address, another port. ``default``: None is by the slave."""
    by_slave = "; left out: 1 if the configuration has dpv1 for the slave, else 2"
    parser.value(
        "--class",
        "1|2",
        "of master; 2: over a connection of its own (MS2), beside the slave's master, without parameterising it"
        + by_slave * (default is None),
        dest="master",
        type=int,
        choices=(1, 2),
        default=default,
    )
    options.add_own_address(parser, "class 2 in the foreground: ")
    options.add_other_port(parser)


def master_of(args: argparse.Namespace, slave: SlaveConfig) -> int:
    """The class of master that asks ``slave``: class 1 needs DP-V1 in its parameters. Raises UsageError."""
    master: int = args.master or (1 if slave.params.dpv1 is not None else 2)
    if args.address is not None and master == 1:
        raise UsageError("--address is for --class 2; a master of class 1 has that of the configuration")
    return master


class RecordOrder(NamedTuple):
    """One order to one slave. ``word``: the order as typed; ``master``: class 1 or 2; ``own``: the master's address."""

    config: Config
    slave: SlaveConfig
    order: ParsedCommand
    word: str
    master: int
    own: int | None

    def answer(self) -> Mapping[str, Any]:
        """The answer to the order. Raises BusError if a signal ended the command first."""
        with progress_bar(f"{self.order.word} of {self.slave.name}") as progress:
            return run_to_result(self._carry_out(progress), f"{self.word} was done")

    async def _carry_out(self, progress: OnProgress) -> Mapping[str, Any]:
        answer = await through_run(self.config, self.slave.address, self.order, progress, master=self.master)
        if answer is not None:
            return {**answer, "through": "run"}
        in_foreground = self._as_master if self.master == 1 else self._as_class2
        async with in_foreground() as slave:
            return {**await carry_out(slave, self.order, progress), "through": "master"}

    @asynccontextmanager
    async def _as_master(self) -> AsyncIterator[Slave]:
        """The slave under a class 1 master that stays in Clear: records can be read, outputs are zero."""
        if self.config.bus.read_only:
            raise UsageError("the configuration is read only: records need data exchange; leave read_only out")
        on_bus.warn_of_simulation(self.config)
        foreign = up = False

        def on_event(event: Event) -> None:
            nonlocal foreign
            match event:  # the error that follows names what kept the slave from data exchange
                case AddressCollision():
                    foreign = True
                case SlaveFaulted(fault=fault) if not up:
                    foreign = foreign or fault.kind is FaultKind.LOCKED
                case _:
                    on_bus.warn_of(event)

        try:
            async with open_bus(self.config.only(self.slave), on_event=on_event) as bus:
                found = bus.slave(self.slave.address)
                await found.ready(on_bus.READY_S)
                up = True
                yield found
        except (BusError, SlaveFault) as error:
            if not foreign:
                raise
            text = f"{error}{_BESIDE}"
            raise BusError(text) if isinstance(error, BusError) else SlaveFault(self.slave.address, text) from None

    @asynccontextmanager
    async def _as_class2(self) -> AsyncIterator[Connection]:
        """A connection of a class 2 master at a free address: it parameterises no slave."""
        config = self.config
        if config.bus.read_only:
            raise UsageError("the configuration is read only: a connection is to be opened; leave read_only out")
        make_bus = on_bus.class2_maker(config.only(self.slave), read_only=False)
        taken = on_bus.stations_of(config)
        async with joined(make_bus, self.own, avoid=taken) as bus, bus.class2.connect(self.slave) as connection:
            yield connection


def _show(answer: Mapping[str, Any]) -> None:
    who = _who(answer)
    match answer["order"]:
        case "read" | "transport":
            octets = bytes.fromhex(answer["data"])
            output.line(f"{who}: slot {answer['slot']}, index {answer['index']}, {octets_text(len(octets))}")
            for at in range(0, len(octets), 16):
                line = octets[at : at + 16]
                text = "".join(chr(octet) if 32 <= octet < 127 else "." for octet in line)
                output.line(f"{at:3}  {line.hex(' ').upper():47}  {text}")
        case "stamps":
            keys = ("time", "slot", "signal", "state_text", "kind_text")
            stamps = [tuple(str(one[key]) for key in keys) for one in answer["events"]]
            title = f"{who}: time-stamped events of record {answer['index']}: {len(stamps)}"
            output.table(title, ("time (UTC)", "slot", "signal", "state", "kind"), stamps)
        case "parameters":
            found = list_of(answer)
            listed = [(one.number, one.name, one.format, one.text, "ro" * one.read_only) for one in found.parameters]
            title = f"{who}: {len(listed)} parameters of slot {found.slot}, object {found.object}"
            output.table(title, ("number", "name", "format", "values", ""), listed)
        case "parameter":
            found_one = ListedValues.from_dict(answer["parameter"])
            element = "" if answer["index"] is None else f"[{answer['index']}]"
            written = ", written and read back" if answer["written"] else ""
            output.line(f"{who}: {found_one.label}{element} = {found_one.text} ({found_one.format}{written})")
        case "hart":
            show_hart(answer)
        case "write":
            output.line(
                f"{who}: slot {answer['slot']}, index {answer['index']}: {octets_text(answer['length'])} written"
            )
        case _:
            rows = [
                (f"I&M{n}", name, _im_text(name, value))
                for n, record in answer["im"].items()
                for name, value in record.items()
            ]
            output.table(f"{who}: slot {answer['slot']}", ("record", "what", "value"), rows)


def show_hart(answer: Mapping[str, Any]) -> None:
    """The answer to the order ``hart`` as a table."""
    number, channel = answer["command"], answer["channel"]
    what = "" if number is None else f", HART command {number}"
    place = f"slot {answer['slot']}" + ("" if channel is None else f", channel {channel}")
    title = f"{_who(answer)}: {place}{what}"
    output.table(title, ("what", "value"), answer["rows"])


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
