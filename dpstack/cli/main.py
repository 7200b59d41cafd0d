"""The entry point: finds the command, turns every expected error into one line and gives the exit code.

0 success, 1 a finding or a failed run, 2 wrong use (arguments, configuration). No traceback for what a user or the
world outside can cause.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from dpstack import __version__
from dpstack.cli.terminal import lost_stdout
from dpstack.errors import ConfigError, DpError, UsageError
from dpstack.text import printable

#: modules of dpstack.cli.commands, imported when the program runs: an early Ctrl-C is no traceback
_COMMANDS = (
    "demo",
    "run",
    "sim",
    "segment",
    "ctl",
    "drive",
    "acyclic",
    "scan",
    "address",
    "plan",
    "baud",
    "ports",
    "doctor",
    "gsd",
)
_INTERRUPTED = 130
#: set to anything: errors are shown with where they come from
_DEBUG = "DPSTACK_DEBUG"


class Parser(argparse.ArgumentParser):
    """Refuses wrong arguments in one line."""

    def error(self, message: str) -> NoReturn:
        """One line on stderr, exit code 2."""
        self.exit(2, f"{self.prog}: {printable(message)}; see {self.prog} --help\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        """Help, errors, version: lines of text."""
        super()._print_message("\n".join(map(printable, message.split("\n"))), file)


def build_parser() -> Parser:
    """All commands with their options."""
    parser = Parser(
        prog="dpstack",
        description="PROFIBUS-DP: a soft master, simulated slaves, and what belongs to them.",
        epilog="example: dpstack demo",
    )
    parser.add_argument("--version", action="version", version=f"dpstack {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=Parser)
    for name in _COMMANDS:
        importlib.import_module(f"dpstack.cli.commands.{name}").add_to(commands)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    lost_stdout.fill()
    try:
        args = build_parser().parse_args(argv)
        return _execute(args)
    except KeyboardInterrupt:
        return _INTERRUPTED


def _execute(args: argparse.Namespace) -> int:
    try:
        code: int = args.execute(args)
    except (ConfigError, UsageError) as error:
        code = _say(error, 2)
    except DpError as error:
        code = _say(error, 1)
    with lost_stdout.guarded():
        sys.stdout.flush()
    return code or int(lost_stdout.lost.error is not None)


def _say(error: Exception, code: int) -> int:
    if os.environ.get(_DEBUG):
        lost_stdout.print_traceback(error)
    lost_stdout.warn(str(error))
    return code


if __name__ == "__main__":
    sys.exit(main())
