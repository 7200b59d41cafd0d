"""``dpstack baud``: finds the baud rate by listening only."""

from __future__ import annotations

import argparse
import asyncio

from dpstack.api.bus.find_baud import SILENCE_S, BaudReport, find_baud
from dpstack.cli import options
from dpstack.cli.terminal import output
from dpstack.cli.terminal.lost_stdout import warn
from dpstack.cli.terminal.signals import StopSignal


def add_to(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.epilog = "example: dpstack baud --port /dev/ttyUSB0"
    parser.add_argument("--port", metavar="P", required=True, help="the port")
    parser.add_argument(
        "--timeout",
        metavar="S",
        type=options.seconds,
        default=SILENCE_S,
        help=f"give up after so many seconds (default {SILENCE_S:g})",
    )
    options.add_json(parser)
    parser.set_defaults(execute=execute)


def execute(args: argparse.Namespace) -> int:
    """Listen until the rate is found; 1 when it is not."""
    return asyncio.run(_run(args))


async def _run(args: argparse.Namespace) -> int:
    found: list[BaudReport] = []

    async def listen() -> None:
        found.append(await find_baud(args.port, timeout=args.timeout))

    with StopSignal() as stop:
        if not await stop.or_done(listen()):
            warn("ended before the baud rate was found")
            return 1
    (report,) = found
    if args.json:
        output.json_line(report.as_dict())
    elif report.baud is not None:
        output.line(f"{report.text} ({report.telegrams} in a row, after {report.seconds:.1f} s)")
    else:
        warn(f"{args.port}: {report.text}")
    return 0 if report.baud is not None else 1
