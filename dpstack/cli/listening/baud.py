"""``dpstack baud``: finds the baud rate by listening only."""

from __future__ import annotations

import argparse

from dpstack.api.bus.find_baud import SILENCE_S, find_baud
from dpstack.cli import options
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.signals import run_to_result


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack baud --port /dev/ttyUSB0"
    parser.value("--port", "P", "the port", required=True)
    parser.value(
        "--timeout",
        "S",
        f"give up after S seconds (default {SILENCE_S:g})",
        type=options.seconds,
        default=SILENCE_S,
    )
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 when the rate is not found."""
    report = run_to_result(find_baud(args.port, timeout=args.timeout), "the baud rate was found")
    if args.json:
        output.json_line(report.as_dict())
    elif report.baud is not None:
        output.line(f"{report.text} ({report.telegrams} in a row, after {report.seconds:.1f} s)")
        output.line(report.evidence)
    else:
        output.warn(f"{args.port}: {report.text}")
    return 0 if report.baud is not None else 1
