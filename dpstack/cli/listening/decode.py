"""``dpstack decode``: explains every telegram of a capture, or of octets in hex, to the bit."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Callable, Generator

from dpstack.api.config.bus import AUTO
from dpstack.capture.cutter import split
from dpstack.capture.pcapng import Interface
from dpstack.capture.transmission import Transmission
from dpstack.cli import options
from dpstack.cli.listening.source_file import STDIN, add_channel, is_growing, transmissions_of
from dpstack.cli.listening.telegram_lines import add_names_and_filter, names_of, show
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.decode.filter import one_later
from dpstack.decode.names import Names
from dpstack.decode.source import from_hex
from dpstack.decode.telegram import Explained, Explainer
from dpstack.errors import UsageError


def add_to(parser: Parser) -> None:
    parser.epilog = (
        'examples: dpstack decode bus.pcapng; dpstack decode "68 05 05 68 83 82 6D 3C 3E EC 16"; '
        "dpstack decode bus.pcapng --filter 'station 5 and (retry or error)'"
    )
    what = "a file: pcapng, of a logic analyser (.sr, VCD, CSV), or of hex digits; octets; or - for standard input"
    parser.add_argument("source", metavar="FILE|HEX|-", nargs="+", help=what)
    parser.value(
        "--baud",
        "B|auto",
        "rate in a logic analyser's file (default: finds it)",
        type=options.baud_or_auto,
        default=AUTO,
    )
    add_channel(parser)
    add_names_and_filter(parser)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if a transmission is no telegram, or the file cannot be read to its end."""
    bad = 0
    at_once = len(args.source) == 1 and is_growing(args.source[0])  # somebody may be watching
    buses = _Buses(names_of(args))
    with contextlib.closing(_transmissions(args, buses.choose)) as transmissions:
        explained = map(buses.explain, transmissions)
        for one in explained if args.filter is None else one_later(explained):
            bad += one.error is not None
            if args.filter is None or args.filter(one):
                show(one, json=args.json, flush=at_once)
                if output.lost.error is not None:
                    break
    output.flush()
    return 1 if bad else 0


class _Buses:
    """The buses in one file: each port has its own course and stations, the numbers of telegrams are those of the
    file."""

    def __init__(self, names: Names) -> None:
        self._names = names
        self._explainers: dict[str, Explainer] = {}
        self._explainer = Explainer(names)
        self._number = 0

    def choose(self, interface: Interface) -> None:
        """The next transmission is of this port; at another rate the same port is another interface of the file."""
        self._explainer = self._explainers.setdefault(interface.name, Explainer(self._names))

    def explain(self, sent: Transmission) -> Explained:
        self._number += 1
        return self._explainer.add(sent, self._number)


def _transmissions(args: argparse.Namespace, on_interface: Callable[[Interface], None]) -> Generator[Transmission]:
    source: list[str] = args.source
    name = source[0]
    if len(source) == 1 and (name == STDIN or os.path.lexists(name) or os.sep in name):  # a file goes before hex digits
        yield from transmissions_of(name, on_interface, baud=args.baud, channel=args.channel)
    else:
        text = " ".join(source)
        try:
            octets = from_hex(text)
        except UsageError as error:
            raise UsageError(f"{text!r} is no file here, and {error}") from None
        if not octets:
            raise UsageError("no octets to decode; give a file, octets such as 68 05 05 68, or -")
        yield from map(Transmission, split(octets))
