"""``dpstack scan``: who is on the bus, without changing anything there."""

from __future__ import annotations

import argparse
import asyncio

from dpstack.api.baud import find_baud
from dpstack.api.bus import Bus
from dpstack.api.config import AUTO, make_config
from dpstack.api.events import Event, Found, MasterSeen, Severity, severity_of
from dpstack.api.livelist import LiveListResult, scan_port
from dpstack.api.skeleton import config_skeleton, drive_of
from dpstack.cli import options, output
from dpstack.cli.signals import StopSignal
from dpstack.cli.streams import warn
from dpstack.errors import BusError, UsageError
from dpstack.units import baud_text


def add_to(commands: options.Commands) -> None:
    """The command and its options."""
    parser = options.command(
        commands,
        "scan",
        "who is on the bus: stations 0-126 with type, ident number, state and owner; changes nothing",
        "dpstack scan --port /dev/ttyUSB0 --baud 500000 --config > plant.toml",
    )
    parser.add_argument("--port", metavar="P", required=True, help="the port")
    parser.add_argument(
        "--baud",
        metavar="B|auto",
        type=options.baud_or_auto,
        default=AUTO,
        help="the rate (default auto: found by listening, where a master is on the bus)",
    )
    parser.add_argument(
        "--address", metavar="A", type=options.address, help="ask from this address (default: the lowest not heard)"
    )
    parser.add_argument("--config", action="store_true", help="print a configuration file of what was found")
    options.add_json(parser)
    parser.set_defaults(execute=execute)


def execute(args: argparse.Namespace) -> int:
    """1 when nobody answers."""
    if args.port in ("virtual", "pty"):
        raise UsageError(f'scan: nobody is on port "{args.port}"; name the port of a bus')
    return asyncio.run(_run(args))


async def _run(args: argparse.Namespace) -> int:
    result: LiveListResult | None = None
    baud = 0

    def make_bus(address: int) -> Bus:
        config = make_config(args.port, baud, address, where="scan", bus={"read_only": True})
        return Bus(config, on_event=tell, watched=False)

    def tell(event: Event) -> None:
        if severity_of(event) is not Severity.INFO:
            warn(event.text)
        elif isinstance(event, MasterSeen) and event.present and not args.json:
            warn(f"master {event.address} is on this bus: the scan waits until it is let into the ring")

    async def scan() -> None:
        nonlocal result, baud
        baud = await _rate(args)
        result = await scan_port(make_bus, address=args.address, configs=args.config)

    with StopSignal() as stop:
        await stop.or_done(scan())
    if result is None:
        warn("ended before the live list was complete")
        return 1
    _show(result, args)
    if result.stations:
        return 0
    warn(f"nobody answers at {baud_text(result.baud)}: check rate, power, A and B, and the termination")
    return 1


async def _rate(args: argparse.Namespace) -> int:
    """The rate given, or found by listening. Raises BusError."""
    if args.baud != AUTO:
        return int(args.baud)
    report = await find_baud(args.port)
    if report.baud is None:
        raise BusError(
            f"{args.port}: {report.text}; on a bus without a master give the rate, for instance --baud 500000"
        )
    if not args.json:
        warn(report.text)
    return report.baud


def _show(result: LiveListResult, args: argparse.Namespace) -> None:
    if args.json:
        more: dict[str, object] = {"config": config_skeleton(result, args.port)} if args.config else {}
        output.json_line({**result.as_dict(), **more})
        return
    if args.config:
        output.line(config_skeleton(result, args.port).rstrip("\n"))
    else:
        title = f"{len(result.stations)} stations at {baud_text(result.baud)}, asked by {result.address}"
        columns = ("address", "type", "ident", "state", "master", "device")
        output.table(title, columns, [_row(found) for found in result.stations])
    for note in result.notes:
        warn(note)


def _row(found: Found) -> tuple[object, ...]:
    told = found.as_dict()
    drive = drive_of(found)
    cells = ["" if told[key] is None else told[key] for key in ("address", "type", "ident", "state", "master")]
    return (*cells, "" if drive is None else drive.title)
