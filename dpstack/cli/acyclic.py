"""``dpstack acyclic``: Read and Write of DP-V1, I&M, at one slave."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Mapping
from typing import Any

from dpstack.api.acyclic_words import WORDS, carry_out, check
from dpstack.api.config import Config, load_config
from dpstack.api.control.records import through_run
from dpstack.api.events import Event, Notice, Severity, severity_of
from dpstack.api.one_drive import READY_S
from dpstack.api.opening import open_bus
from dpstack.api.slave_config import SlaveConfig
from dpstack.cli import options, output
from dpstack.cli.signals import StopSignal
from dpstack.cli.streams import warn
from dpstack.errors import UsageError


def add_to(commands: options.Commands) -> None:
    """The command and its options."""
    parser = options.command(
        commands,
        "acyclic",
        "records of a slave (DP-V1): through the run that holds the port, otherwise as master in the foreground",
        "dpstack acyclic plant.toml 8 read 1 47\n"
        "         dpstack acyclic plant.toml valves write 1 47 00FF\n"
        "         dpstack acyclic plant.toml 8 im\n\norders:\n"
        + "\n".join(f"  {f'{spec.name} {spec.usage}':26} {spec.text}" for spec in WORDS),
    )
    parser.add_argument("config", metavar="CONFIG", help="configuration file")
    parser.add_argument("slave", metavar="ADDRESS", help="the slave, by its address or its name there")
    parser.add_argument("order", metavar="ORDER", help="read, write or im, see below")
    parser.add_argument("args", metavar="ARG", nargs="*", help="what belongs to it; numbers 47 or 0x2F")
    parser.add_argument("--class", dest="master", metavar="1|2", choices=("1", "2"), default="1", help="of master")
    parser.add_argument("--port", metavar="P", help="another port")
    parser.add_argument("--baud", metavar="B|auto", type=options.baud_or_auto, help='another rate; "auto": listens')
    options.add_json(parser)
    parser.set_defaults(execute=execute)


def execute(args: argparse.Namespace) -> int:
    """1 where the slave refuses or does not answer."""
    config = load_config(args.config).with_bus(port=args.port, baud=args.baud)
    if args.master == "2":
        raise UsageError("class 2 (MS2) is not supported yet by this version; leave --class out")
    check(args.order, args.args)
    slave = _slave_of(config, args.slave)
    return asyncio.run(_run(config, slave, args))


async def _run(config: Config, slave: SlaveConfig, args: argparse.Namespace) -> int:
    found: list[Mapping[str, Any]] = []

    async def order() -> None:
        told = await through_run(config.port, slave.address, args.order, args.args)
        if told is not None:
            found.append({**told, "through": "run"})
        else:
            found.append({**await _as_master(config, slave, args), "through": "master"})

    with StopSignal() as stop:
        await stop.or_done(order())
    if not found:
        warn(f"ended before {args.order} was done")
        return 1
    (told,) = found
    if args.json:
        output.json_line(told)
    else:
        _show(told)
    return 0


async def _as_master(config: Config, slave: SlaveConfig, args: argparse.Namespace) -> Mapping[str, Any]:
    """The master stays in Clear: records are open, and no output is set."""
    if config.bus.read_only:
        raise UsageError("the configuration is read only: records need data exchange; leave read_only out")
    async with open_bus(config.only(slave), on_event=_event) as bus:
        found = bus.slave(slave.address)
        await found.ready(READY_S)
        return await carry_out(found, args.order, args.args)


def _event(event: Event) -> None:
    if severity_of(event) is not Severity.INFO and not (isinstance(event, Notice) and event.source == "plan"):
        warn(event.text)


def _show(told: Mapping[str, Any]) -> None:
    who = f"slave {told['address']} ({told['slave']})"
    match told["order"]:
        case "read":
            octets = bytes.fromhex(told["data"])
            output.line(f"{who}: slot {told['slot']}, index {told['index']}, {len(octets)} octets")
            for at in range(0, len(octets), 16):
                line = octets[at : at + 16]
                text = "".join(chr(octet) if 32 <= octet < 127 else "." for octet in line)
                output.line(f"{at:3}  {line.hex(' ').upper():47}  {text}")
        case "write":
            output.line(f"{who}: slot {told['slot']}, index {told['index']}: {told['length']} octets written")
        case _:
            rows = [(f"I&M{n}", name, value) for n, record in told["im"].items() for name, value in record.items()]
            output.table(f"{who}: slot {told['slot']}", ("record", "what", "value"), rows)


def _slave_of(config: Config, name: str) -> SlaveConfig:
    """Raises UsageError naming the slaves there are."""
    slave = config.find(name)
    if slave is not None:
        return slave
    known = ", ".join(f"{slave.address} ({slave.name})" for slave in config.slaves) or "none"
    raise UsageError(f"no slave {name!r} in this configuration; there are: {known}")
