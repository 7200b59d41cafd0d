"""The entry point: finds the command, turns every expected error into one line and gives the exit code.

0 success, 1 a finding or a failed run, 2 wrong use (arguments, configuration). No traceback for what a user or the
world outside can cause.
"""

from __future__ import annotations

import argparse
import os
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

from dpstack.cli import ctl, demo, doctor, plan, ports, run, segment, sim
from dpstack.errors import ConfigError, DpError, UsageError

_COMMANDS = (demo, run, sim, segment, ctl, plan, ports, doctor)
_INTERRUPTED = 130
#: set to anything: errors are shown with where they come from
_DEBUG = "DPSTACK_DEBUG"


class Parser(argparse.ArgumentParser):
    """Refuses wrong arguments in one line."""

    def error(self, message: str) -> NoReturn:
        """One line on stderr, exit code 2."""
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


def build_parser() -> Parser:
    """All commands with their options."""
    parser = Parser(
        prog="dpstack",
        description="PROFIBUS-DP: a soft master, simulated slaves, and what belongs to them.",
        epilog="example: dpstack demo",
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=Parser)
    for module in _COMMANDS:
        module.add_to(commands)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    args = build_parser().parse_args(argv)
    try:
        code: int = args.execute(args)
        sys.stdout.flush()
        return code
    except (ConfigError, UsageError) as error:
        return _say(error, 2)
    except DpError as error:
        return _say(error, 1)
    except BrokenPipeError:
        # the reader of our output has gone: nothing more can be said, and nothing may be said at exit either
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except KeyboardInterrupt:
        return _INTERRUPTED


def _say(error: Exception, code: int) -> int:
    text = " ".join(str(error).split())
    if os.environ.get(_DEBUG):
        traceback.print_exception(error)
    print(f"dpstack: {text}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
