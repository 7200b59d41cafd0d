"""``dpstack segment``: a virtual RS-485 segment of ptys."""

from __future__ import annotations

import argparse
import asyncio
from time import monotonic_ns
from typing import Any

from dpstack.api.control.simulation_handlers import control_segment
from dpstack.api.slave_side.simulation import DEFAULT_BAUD, Segment
from dpstack.cli import options
from dpstack.cli.commands.on_bus import reachable
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.nonblocking_stdout import run_unhurried
from dpstack.cli.terminal.report import event_printer
from dpstack.cli.terminal.signals import StopSignal

_COLUMNS = ("path", "sent", "received", "dropped", "overrun", "telegrams", "damaged", "erased")


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack segment --stations 2 --dir /tmp/bus"
    parser.value("--stations", "N", "how many ptys (default 2)", type=options.count, default=2)
    parser.value("--dir", "DIR", "where the links 0, 1 ... are made")
    parser.value("--baud", "B", "the rate of a tty nobody set, and of --paced", type=options.baud, default=DEFAULT_BAUD)
    parser.flag("--paced", "octets take their time on the wire")
    parser.flag("--echo", "a station hears itself")
    parser.value(
        "--error-rate",
        "P",
        "probability that a bit is inverted",
        type=options.number(float, 0, 1, "probability, 0 up to 1"),
        default=0.0,
    )
    parser.value("--seed", "N", "of the noise", type=int, default=0)
    parser.value("--seconds", "S", "end after S seconds", type=options.seconds)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    return run_unhurried(_run(args), json=args.json)


async def _run(args: argparse.Namespace) -> int:
    segment = Segment(
        args.stations,
        args.dir,
        baud=args.baud,
        paced=args.paced,
        echo=args.echo,
        error_rate=args.error_rate,
        seed=args.seed,
        on_notice=output.warn,
    )
    with StopSignal() as stop:
        show = event_printer(monotonic_ns(), json=args.json)
        async with segment, reachable(control_segment(segment, lambda event: show(event, 1))):
            if args.json:
                output.json_line({"event": "start", "ports": segment.paths, "baud": args.baud})
            else:
                output.line("one bus, each of these is a port of it (Ctrl-C ends):")
                for path in segment.paths:
                    output.line(path)
            await stop.or_done(asyncio.sleep(args.seconds) if args.seconds else asyncio.Event().wait())
            _summary(segment.stats(), args.json)
    return 0


def _summary(stats: dict[str, Any], json: bool) -> None:
    if json:
        output.json_line({"event": "summary", **stats})
        return
    rows = [[s[column] for column in _COLUMNS] for s in stats["stations"]]
    output.table("Octets and telegrams", ("port", *_COLUMNS[1:]), rows)
    output.line(f"{stats['damaged']} octets damaged: {stats['lost']} lost, {stats['changed']} changed")
