"""``dpstack decode``: explains every telegram of a capture, or of octets in hex, to the bit."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator

from dpstack.capture.cutter import split
from dpstack.capture.transmission import Transmission
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.decode.filter import parse_filter
from dpstack.decode.source import from_hex, read_transmissions
from dpstack.decode.telegram import Explained, explain
from dpstack.errors import UsageError
from dpstack.units import NS_PER_S


def add_to(parser: Parser) -> None:
    parser.epilog = (
        'examples: dpstack decode bus.pcapng; dpstack decode "68 05 05 68 83 82 6D 3C 3E EC 16"; '
        "dpstack decode bus.pcapng --filter 'station 5 and (retry or error)'"
    )
    what = "a pcapng file, or a text file of hex digits; octets; or - for standard input"
    parser.add_argument("source", metavar="FILE|HEX|-", nargs="+", help=what)
    parser.value("--filter", "EXPR", "only telegrams that it fits, see docs/decode.md", type=_filter)
    parser.run_by(execute)


def _filter(text: str) -> object:
    try:
        return parse_filter(text)
    except UsageError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 where a transmission is no telegram, or the file cannot be read to its end."""
    bad = 0
    for one in explain(_transmissions(args.source)):
        bad += one.error is not None
        if args.filter is None or args.filter(one):
            _show(one, json=args.json)
    return 1 if bad else 0


def _transmissions(source: list[str]) -> Iterator[Transmission]:
    name = source[0]
    if len(source) == 1 and name == "-":
        yield from read_transmissions(sys.stdin.buffer, "standard input")
    elif len(source) == 1 and os.path.exists(name):  # a file goes before hex digits
        try:
            with open(name, "rb") as file:
                yield from read_transmissions(file, name)
        except OSError as error:
            raise UsageError(f"{name}: {error.strerror}") from None
    else:
        text = " ".join(source)
        try:
            octets = from_hex(text)
        except UsageError as error:
            raise UsageError(f"{text!r} is no file here, and {error}") from None
        if not octets:
            raise UsageError("no octets to decode; give a file, octets such as 68 05 05 68, or -")
        yield from map(Transmission, split(octets))


def _show(one: Explained, *, json: bool) -> None:
    if json:
        output.json_line(one.as_dict())
        return
    sent = one.transmission
    time = "" if sent.t_ns is None else f"{sent.t_ns // NS_PER_S}.{sent.t_ns % NS_PER_S:09}  "
    output.line(f"{one.number:>6}  {time}{sent.octets.hex(' ')}")
    output.line(f"        {one.text}")
    for name, value in one.fields.items():
        output.line(f"          {name}: {_plain(value)}")


def _plain(value: object) -> str:
    """A field's value in words."""
    match value:
        case bool():
            return "yes" if value else "no"
        case None:
            return "none"
        case list():
            return "; ".join(map(_plain, value)) or "none"
        case dict():
            return ", ".join(f"{key} {_plain(inner)}" for key, inner in value.items())
    return str(value) or "none"
