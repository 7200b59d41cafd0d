"""``dpstack scan``: the live list of a bus: stations with type, ident number, state and owner; writes nothing."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping

from msgspec import structs

from dpstack.api.bus.events_json import Found
from dpstack.api.commissioning.candidates import chosen_slaves
from dpstack.api.commissioning.live_list import Chosen, LiveListResult, cause_dict, config_skeleton, drive_of, scan_port
from dpstack.api.gsd_folder import GsdFolder
from dpstack.cli.commands import on_bus
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.signals import run_to_result
from dpstack.errors import PortBusyError, UsageError
from dpstack.units import baud_text


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack scan --port /dev/ttyUSB0 --baud 500000 --config > plant.toml"
    on_bus.add_port(parser)
    parser.flag("--config", "print a configuration file of what was found")
    parser.value("--gsd", "DIR", "with --config: take modules from the GSD files of this folder, by ident number")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 when no station answers."""
    on_bus.check_port(args)
    if args.gsd is not None and not args.config:
        raise UsageError("scan: --gsd finds modules for a configuration file: add --config, or leave --gsd out")
    # a path that is not a folder is reported before the bus is scanned
    folder = None if args.gsd is None else GsdFolder(args.gsd, beside=".")
    result = run_to_result(_scan(args), "the live list was complete")
    chosen, notes = ({}, []) if folder is None else chosen_slaves(folder, result.stations)
    _show(structs.replace(result, notes=(*result.notes, *notes)), args, chosen)
    if result.stations:
        return 0
    output.warn(f"nobody answers at {baud_text(result.baud)}: check rate, power, A and B, and the termination")
    return 1


async def _scan(args: argparse.Namespace) -> LiveListResult:
    try:
        make_bus = on_bus.bus_maker(args, await on_bus.rate_of(args), read_only=True)
        return await scan_port(make_bus, address=args.address, configs=args.config)
    except PortBusyError as error:
        if "`dpstack run " not in str(error):
            raise
        raise PortBusyError(f"{error}; or let that run ask: dpstack ctl {shlex.quote(args.port)} scan") from None


def _show(result: LiveListResult, args: argparse.Namespace, chosen: Mapping[int, Chosen] | None = None) -> None:
    if args.json:
        more: dict[str, object] = {"config": config_skeleton(result, args.port, chosen)} if args.config else {}
        output.json_line({**result.as_dict(), **more})
        return
    if args.config:
        output.toml(config_skeleton(result, args.port, chosen))
    else:
        count = len(result.stations)
        title = f"{count} station{'s' * (count != 1)} at {baud_text(result.baud)}, asked by {result.address}"
        columns = ("address", "type", "ident", "state", "master", "device")
        output.table(title, columns, [_row(found) for found in result.stations])
        waiting = [(found.address, cause_dict(found)["cause"]) for found in result.stations if cause_dict(found)]
        if waiting:
            output.table("Not in data exchange", ("address", "likely cause"), waiting)
    for note in result.notes:
        output.warn(note)


def _row(found: Found) -> tuple[object, ...]:
    fields = found.as_dict()
    drive = drive_of(found)
    cells = ["" if fields[key] is None else fields[key] for key in ("address", "type", "ident", "state", "master")]
    return (*cells, "" if drive is None else drive.title)
