"""``dpstack decode``: explains every telegram of a capture, or of octets in hex, to the bit."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Callable, Generator, Iterator
from typing import TYPE_CHECKING

from dpstack.capture.cutter import split
from dpstack.capture.transmission import Transmission
from dpstack.cli import options
from dpstack.cli.listening.source_file import (
    STDIN,
    UnreadLines,
    add_channel,
    is_growing,
    text_of,
    transmissions_of,
)
from dpstack.cli.listening.telegram_lines import add_names_and_filter, names_of, show
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.decode.names import Names
from dpstack.decode.telegram import Explained, Explainer
from dpstack.errors import UsageError
from dpstack.units import AUTO

if TYPE_CHECKING:
    from dpstack.capture.pcapng import Interface
    from dpstack.decode.log_text import Unread


def add_to(parser: Parser) -> None:
    parser.epilog = (
        'examples: dpstack decode bus.pcapng; dpstack decode "68 05 05 68 83 82 6D 3C 3E EC 16"; '
        "dpstack decode bus.pcapng --filter 'station 5 and (retry or error)'; "
        "dpstack decode --diagnosis 08 0C 00 02 80 E0 43 02 00"
    )
    what = (
        "a file: pcapng, of a logic analyser (.sr, VCD, CSV), of hex digits or lines of a log; octets; - for standard "
        "input; with --parquet also several files, and folders of pcapng files"
    )
    parser.add_argument("source", metavar="FILE|HEX|-", nargs="+", help=what)
    parser.flag(
        "--diagnosis", "the octets are a diagnosis without its telegram, station status 1 first: as SFC 13 gives it"
    )
    parser.value("--address", "ADDRESS", "with --diagnosis and --config: address or name of the slave that it is of")
    parser.value(
        "--baud",
        "B|auto",
        "rate in a logic analyser's file (default: finds it)",
        type=options.baud_or_auto,
        default=AUTO,
    )
    add_channel(parser)
    add_names_and_filter(parser)
    parser.value(
        "--parquet", "DIR", "write captures as Parquet files, a row a telegram, see docs/how-to/many-captures.md"
    )
    parser.value(
        "--segment",
        "NAME",
        "with --parquet: name of the bus (default: that of CONFIG, of the folder, or of the capture)",
    )
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if a transmission is no telegram, or the file cannot be read to its end."""
    if args.parquet is not None:
        from dpstack.cli.listening import parquet_files  # here, as it needs pyarrow

        names = names_of(args)
        return parquet_files.execute(args, lambda: Buses(names))
    if args.segment is not None:
        raise UsageError("--segment names the bus in Parquet files: it needs --parquet DIR")
    if args.diagnosis:
        from dpstack.cli.listening import diagnosis  # here, as telegrams need none of it

        return diagnosis.execute(args, text_of(args.source[0]) if _is_file(args.source) else " ".join(args.source))
    if args.address is not None:
        raise UsageError("--address says of which slave a diagnosis is: it needs --diagnosis")
    bad = 0
    unread = UnreadLines(shown=not args.json and args.filter is None)
    at_once = len(args.source) == 1 and is_growing(args.source[0])  # somebody may be watching
    buses = Buses(names_of(args))
    with contextlib.closing(_transmissions(args, buses.choose, unread.add)) as transmissions:
        explained: Iterator[Explained] = map(buses.explain, transmissions)
        if args.filter is not None:
            from dpstack.decode.filter import one_later  # here, as it is loaded with a filter

            explained = one_later(explained)
        for one in explained:
            bad += one.error is not None
            if args.filter is None or args.filter(one):
                show(one, json=args.json, flush=at_once)
                if output.lost.error is not None:
                    break
    output.flush()
    if bad and not _is_file(args.source):
        from dpstack.decode.diagnosis import may_be_diagnosis

        if may_be_diagnosis(" ".join(args.source)):
            output.warn("octets of a diagnosis without its telegram are explained by dpstack decode --diagnosis")
    return 1 if unread.report() or bad else 0


class Buses:
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


def _is_file(source: list[str]) -> bool:
    """A file goes before hex digits. A path that is not there is one, if it is no pasted line."""
    name = source[0]
    is_path = os.sep in name and not any(map(str.isspace, name))
    return len(source) == 1 and (name == STDIN or os.path.lexists(name) or is_path)


def _transmissions(
    args: argparse.Namespace, on_interface: Callable[[Interface], None], on_unread: Callable[[Unread], None]
) -> Generator[Transmission]:
    source: list[str] = args.source
    if _is_file(source):
        yield from transmissions_of(source[0], on_interface, on_unread=on_unread, baud=args.baud, channel=args.channel)
        return
    text = " ".join(source)
    try:
        octets = _pasted(text)
    except UsageError:
        if not all(map(os.path.isfile, source)):
            raise
        raise UsageError(
            f"these are {len(source)} files: name one; dpstack monitor judges several, --parquet makes a table of them"
        ) from None
    if octets is not None:
        yield from map(Transmission, split(octets))
        return
    from dpstack.decode.log_text import LogReader

    reader = LogReader(on_unread)
    for line in text.splitlines():
        yield from reader.add(line)
    yield from reader.end()


def _pasted(text: str) -> bytes | None:
    """The octets of hex digits on the command line; None for lines of a log with octets. Raises UsageError."""
    try:
        octets = bytes.fromhex(text)
    except ValueError:  # more than hex digits and blanks
        from dpstack.decode.log_text import LogReader, from_hex, padded

        try:
            octets = from_hex(padded(text))
        except UsageError as error:
            reader = LogReader(lambda line: None)
            if any(True for line in text.splitlines() for _ in reader.add(line)) or any(reader.end()):
                return None
            raise UsageError(f"{text!r} is no file here, and {error}") from None
    if not octets:
        raise UsageError("no octets to decode; give a file, octets such as 68 05 05 68, or -")
    return octets
