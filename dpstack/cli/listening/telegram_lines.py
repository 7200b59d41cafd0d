"""Explained telegrams on the screen or as JSON lines, and the options of ``decode`` and ``capture`` for them."""

from __future__ import annotations

import argparse
import functools
import sys
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Final, NamedTuple

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


#: telegrams whose JSON is kept
_KEPT_LINES: Final = 4096
#: the place of most telegrams in the course of the bus: a request, and an answer
_REQUEST: Final = (
    '{"retry_of":null,"answer_to":null,"response_us":null,"unanswered":null,"late":false,"repeated_poll_of":null,'
    '"fcb_turned":%s,"probably_answers":null,"remarks":[]}'
)
_REQUESTS: Final = {None: _REQUEST % "null", False: _REQUEST % "false", True: _REQUEST % "true"}
_ANSWER: Final = (
    '{"retry_of":null,"answer_to":%d,"response_us":%s,"unanswered":null,"late":false,"repeated_poll_of":null,'
    '"fcb_turned":null,"probably_answers":null,"remarks":[]}'
)


#: msgspec writes numbers between these as Python does
_SHORT, _LONG = 0.001, 1e15


class _Kept(NamedTuple):
    """The JSON of a telegram around its place in the course, with all that it depends on besides the octets."""

    head: str
    tail: str
    service: str
    fields: Fields
    sender: str
    receiver: str


class JsonLines:
    """JSON lines of explained telegrams: what repeats itself is kept by its octets, number, time and course are made
    anew. ``encoding``: of the output, for characters that it does not have."""

    def __init__(self, encoding: str) -> None:
        self._encode = msgspec.json.Encoder().encode  # a tenth of the time of the standard library's
        self._encoding = encoding
        self._seen: set[object] = set()  # once
        self._kept: dict[object, _Kept] = {}

    def line(self, one: Explained) -> str:
        """The object of :meth:`Explained.as_dict` in one line."""
        octets, t_ns, _, note, damage = one.transmission
        retry, answer_to, us, unanswered, late, request, remarks, repeated, turned, probably = one.step
        if (
            one.error is not None
            or damage
            or note
            or remarks
            or late
            or t_ns is None
            or not _SHORT <= (t := t_ns / NS_PER_S) < _LONG
            or not retry is unanswered is repeated is probably is None
        ):
            return self._whole(one)
        if answer_to is None:
            course = _REQUESTS[turned]
        elif us is not None and _SHORT <= us < _LONG:
            course = _ANSWER % (answer_to, us)
        else:
            return self._whole(one)
        key: object = octets
        if request is not None and len(octets) == 1:  # SC has no addresses
            key = request.da << 7 | request.sa
        kept = self._kept.get(key)
        if kept is None:
            if key in self._seen:
                return self._keep(key, one, f'{{"number":{one.number},"t":{t}', course)
            if len(self._seen) >= _KEPT_LINES:
                self._seen.clear()
            self._seen.add(key)
            return self._whole(one)
        if (
            kept.service is not one.service
            or kept.fields is not one.fields
            or kept.sender is not one.sender
            or kept.receiver is not one.receiver
        ):
            return self._keep(key, one, f'{{"number":{one.number},"t":{t}', course)
        return f'{{"number":{one.number},"t":{t}{kept.head}{course}{kept.tail}'

    def _keep(self, key: object, one: Explained, begin: str, course: str) -> str:
        line = self._whole(one)
        head, found, tail = line.removeprefix(begin).partition(course)
        if found and line.startswith(begin):
            if len(self._kept) >= _KEPT_LINES:
                self._kept.clear()
            self._kept[key] = _Kept(head, tail, one.service, one.fields, one.sender, one.receiver)
        return line

    def _whole(self, one: Explained) -> str:
        data = one.as_dict()
        octets = self._encode(data)
        if octets.isascii() and b"\x7f" not in octets:  # msgspec has escaped the other controls
            return octets.decode()
        return json_text(data, encoding=self._encoding)  # escapes what is not plain


@functools.cache
def _json_lines() -> JsonLines:
    return JsonLines(sys.stdout.encoding or "utf-8")


def show(one: Explained, *, json: bool, flush: bool = True) -> None:
    """Print a transmission: its time and octets, the telegram in words, its fields. Without ``flush`` a JSON line may
    wait for others."""
    if json:
        output.ready_line(_json_lines().line(one), flush=flush)
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
