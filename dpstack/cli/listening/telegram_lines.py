"""Explained telegrams on the screen or as JSON lines, and the options of ``decode`` and ``capture`` for them."""

from __future__ import annotations

import argparse
import functools
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Final

import msgspec

from dpstack.cli import options
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.decode.fields import Fields
from dpstack.decode.names import DriveWords, Names, SlaveNames
from dpstack.text import json_text
from dpstack.units import NS_PER_S

if TYPE_CHECKING:
    from dpstack.decode.filter import Match
    from dpstack.decode.telegram import Explained

#: keys of entries that stand in JSON only: the text beside them counts slots, these are the wire's numbers, from 0
_LEFT_OUT: Final = {"Ext_Diag_Data": frozenset({"module", "modules"})}


def add_names_and_filter(parser: Parser) -> None:
    """The options ``--config``, ``--gsd`` and ``--filter``."""
    parser.value("--config", "CONFIG", "names of this configuration: slaves, process data, modules, parameters, drives")
    what = "a GSD file or a folder of them, for slaves that are not in CONFIG; can be given several times"
    parser.value("--gsd", "FILE", what, action="append", default=[])
    expression = options.parsed(_filter)
    parser.value("--filter", "EXPR", "only telegrams that it fits, see docs/how-to/decode.md", type=expression)


def _filter(text: str) -> Match:
    from dpstack.decode.filter import parse_filter  # here, as few commands have one

    return parse_filter(text)


def names_of(args: argparse.Namespace) -> Names:
    """The names that ``--config`` and ``--gsd`` say; else those of drives that are known here, read when a station
    gives its ident number. Raises ConfigError."""
    if args.config is None and not args.gsd:
        return Names({}, _recognise, _record)
    from dpstack.api.config.config import load_config
    from dpstack.api.listen.names import decode_names

    return decode_names(None if args.config is None else load_config(args.config), args.gsd, output.warn)


def _recognise(ident: int, config: bytes) -> SlaveNames | None:
    return _known_names().recognise(ident, config)


def _record(octets: bytes, request: bool, drive: DriveWords | None) -> Fields:
    return _known_names().record(octets, request, drive)


@functools.cache
def _known_names() -> Names:
    from dpstack.api.listen.names import decode_names  # with all that it knows about drives

    return decode_names()


@functools.cache
def _json_text() -> Callable[[dict[str, object]], str]:
    """The encoder of JSON lines: msgspec takes a tenth of the time of the standard library's."""
    encoding = sys.stdout.encoding or "utf-8"
    encode = msgspec.json.Encoder().encode

    def text_of(data: dict[str, object]) -> str:
        octets = encode(data)
        if octets.isascii() and b"\x7f" not in octets:  # msgspec has escaped the other controls
            return octets.decode()
        return json_text(data, encoding=encoding)  # escapes what is not plain

    return text_of


def show(one: Explained, *, json: bool, flush: bool = True) -> None:
    """Print a transmission: its time and octets, the telegram in words, its fields. Without ``flush`` a JSON line may
    wait for others."""
    if json:
        output.ready_line(_json_text()(one.as_dict()), flush=flush)
        return
    sent = one.transmission
    time = "" if sent.t_ns is None else f"{sent.t_ns // NS_PER_S}.{sent.t_ns % NS_PER_S:09}  "
    output.line(f"{one.number:>6}  {time}{sent.octets.hex(' ')}")
    output.line(f"        {one.text}")
    for text in _field_lines(one.fields):
        output.line(f"          {text}")


def _field_lines(fields: Mapping[str, object]) -> Iterator[str]:
    """A line for each field; the fields in a field, and the entries of a list of fields, stand below it."""
    for name, value in fields.items():
        match value:
            case dict():
                yield f"{name}:"
                yield from (f"  {line}" for line in _field_lines(value) if not line.startswith("text: "))
            case [dict(), *_]:
                yield f"{name}:"
                yield from (f"  {_plain(_kept(name, entry))}" for entry in value)
            case _:
                yield f"{name}: {_plain(value)}"


def _kept(name: str, entry: object) -> object:
    """An entry of the list ``name`` without the keys that stand in JSON only."""
    left_out = _LEFT_OUT.get(name)
    if left_out is None or not isinstance(entry, dict):
        return entry
    return {key: value for key, value in entry.items() if key not in left_out}


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
