"""Entry point of ``dpstack``: command line, error output, exit codes.

0 success, 1 a finding or a failed run, 2 wrong use (arguments, configuration). Expected errors are printed in one
line, without a traceback.
"""

from __future__ import annotations

import argparse
import errno
import os
import sys
from collections.abc import Sequence

from dpstack import __version__
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import ConfigError, DpError, UsageError

#: what each command does; the module of the same name in dpstack.cli.commands has its options and is imported when the
#: command is used
_COMMANDS = {
    "demo": "every known drive, simulated, each through a little story",
    "run": "the soft master, operating at once",
    "sim": "the slaves of a configuration, one simulated drive, or one device of a GSD file, on one port",
    "segment": "a virtual RS-485 segment: ptys joined as one bus, that any program may open",
    "ctl": "gives orders to a running run, sim or segment; without COMMAND: lists them",
    "drive": "one drive by hand: through the run that holds the port, "
    "otherwise as master in the foreground until Ctrl-C",
    "acyclic": "records of a slave (DP-V1): through the run that holds the port, otherwise as master in the foreground",
    "hart": "a HART transmitter behind remote I/O: tag, variables, range, status, identity, or one command",
    "pa": "a process device of PROFIBUS PA: identity, diagnosis, blocks; parameters read, written, dumped, compared",
    "scan": "the stations on the bus: addresses 0-126 with type, ident number, state and owner; changes nothing",
    "diag": "diagnosis, configuration, inputs and outputs of any station, beside its own master; writes nothing",
    "fdl": "one FDL service by hand: SDA, SDN, SRD, FDL status, ident of any station, as a master without DP",
    "ppi": "an S7-200 over PPI: read and write its values, RUN and STOP, its clock, as a master without DP",
    "why": "why a slave is not in data exchange: its last bring-up step by step, likely causes, what to try next",
    "address": "gives a slave that no master owns another station address (Set_Slave_Add) and verifies it",
    "plan": "bus parameters, rotation times, watchdogs, and what does not fit together",
    "sheet": "commissioning sheets: what to set at each drive and device and why, telegrams, words, faults, LEDs",
    "import": "a STEP 7 hardware export (.cfg) as a configuration for work beside its PLC",
    "names": "the I/O list of a configuration: named values, channels without a name; written as CSV and taken back",
    "baud": "finds the baud rate of a bus by listening only",
    "capture": "listens to a bus and keeps the telegrams in a pcapng file, or explains them; never sends",
    "monitor": "judges a bus by listening, live or from a capture file: stations, masters, verdicts with reasons",
    "decode": "explains telegrams to the bit: of captures, logic analysers' files, hex digits, pasted logs; diagnoses",
    "plot": "a recording of `run --record` drawn over wall clock, in a window or as SVG, PNG, PDF",
    "web": "the page in the browser: joins the run that holds the port, else reads only",
    "fleet": "all segments of an MQTT broker at a glance: verdict, lost slaves, silent gateways; only --rebirth sends",
    "mcp": "read-only tools for assistants over standard input and output; nothing is sent to a bus",
    "wireshark": "dissector and extcap program for the Wireshark that is there: install, remove, where",
    "ports": "serial adapters with their lasting path, chip and holder",
    "doctor": "adapters, permissions, latency, rates and real-time rights: what was found, what to do",
    "drives": "the drives and devices that are known here, and the packages that bring them",
    "device": "device files: check one, list and show them, begin one from a GSD file",
    "gsd": "GSD files: show, check, find, diff, configure, write",
    "completion": "the completion script for bash, zsh or fish",
}
#: the commands whose modules stand in another room than ``commands``
_ROOMS = {
    "assistants": ("mcp",),
    "devices": ("device", "drives"),
    "link": ("fdl", "ppi"),
    "listening": ("baud", "capture", "decode", "monitor", "wireshark"),
    "looking": ("diag", "fleet", "hart", "import", "names", "pa", "plot", "sheet", "web", "why"),
}
#: commands that load next to nothing
_PLAIN = ("completion", "ctl")
_VERSION = "--version"
_INTERRUPTED = 130
#: environment variable; any value: errors are printed with their traceback
_DEBUG = "DPSTACK_DEBUG"


class _Version(argparse.Action):
    """Prints the version; argparse's own action would load what it needs to wrap lines."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        output.raw(f"dpstack {__version__}")
        parser.exit()


def build_parser(words: Sequence[str] = ()) -> Parser:
    """The parser of the program. If the first of ``words`` is a command, the parsers of the others are left out."""
    parser = Parser(
        prog="dpstack",
        description="PROFIBUS-DP: a soft master, simulated slaves, and what belongs to them.",
        epilog="example: dpstack demo",
    )
    parser.add_argument(_VERSION, action=_Version, nargs=0, help="show program's version number and exit")
    # with a prog, as argparse would ask the terminal for its width to make one
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", required=True, parser_class=Parser, prog=parser.prog
    )
    first = words[0] if words else ""
    named = [first] if first in _COMMANDS else [] if first == _VERSION else _COMMANDS
    for name in named:
        text = _COMMANDS[name]
        room = next((room for room, inside in _ROOMS.items() if name in inside), "commands")
        commands.add_parser(name, help=text, description=text).module = f"dpstack.cli.{room}.{name}"
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command. Returns the exit code."""
    output.fill()
    try:
        words = sys.argv[1:] if argv is None else argv
        if words[:1] == ["run"]:
            from dpstack.api.bus.opening import begin_for_command  # here, as no other command brings a bus process up

            begin_for_command(words[1:])
        if words[:1] and words[0] in _COMMANDS and words[0] not in _PLAIN:
            from dpstack.late_imports import spare_imports  # here, as help needs nothing of it

            spare_imports()
        return _execute(build_parser(words).parse_args(words))
    except KeyboardInterrupt:
        return _INTERRUPTED


def _execute(args: argparse.Namespace) -> int:
    try:
        code: int = args.execute(args)
    except (ConfigError, UsageError) as error:
        code = _say(error, 2)
    except DpError as error:
        code = _say(error, 1)
    except OSError as error:
        if error.errno not in (errno.EMFILE, errno.ENFILE):
            raise
        code = _say(UsageError(f"no file descriptors left ({error.strerror}): raise that limit (ulimit -n)"), 1)
    with output.guarded():
        sys.stdout.flush()
    return code or int(output.lost.error is not None)


def _say(error: Exception, code: int) -> int:
    if os.environ.get(_DEBUG):
        output.print_traceback(error)
    output.warn(str(error))
    return code


if __name__ == "__main__":
    sys.exit(main())
