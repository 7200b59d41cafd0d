"""``dpstack wireshark``: dissector and extcap program for the Wireshark that is there."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Final

from dpstack.api.config.config import Config, load_config
from dpstack.api.files import AtomicFile
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import UsageError
from dpstack.text import printable
from dpstack.wireshark.installation import Place, State, Wireshark, find_wireshark

_KINDS: Final = {"b": "bytes", "u": "uint", "i": "int", "f": "float"}
#: the first line; the dissector takes no other file
_FIRST: Final = "# names for the PROFIBUS dissector of dpstack"


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack wireshark install\n          dpstack wireshark names plant.toml --out plant.names"
    )
    what = "install, remove: into, from the folders of the user; where: print the folders; names: see CONFIG"
    parser.add_argument("action", choices=("install", "remove", "where", "names"), help=what)
    parser.value("config", "CONFIG", "names: the configuration whose names the dissector shall show", nargs="?")
    parser.value("--out", "FILE", "names: write them into this new file, else to standard output")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    if args.action == "names":
        return _names(args)
    if args.config is not None or args.out is not None:
        raise UsageError(f"wireshark {args.action} takes no CONFIG and no --out: only `wireshark names` does")
    there = find_wireshark()
    if args.action == "install":
        _show(there, there.install(), json=args.json)
        if not args.json:
            output.line("start Wireshark again; tshark has it at once; see docs/how-to/wireshark.md")
    elif args.action == "remove":
        _remove(there, json=args.json)
    else:
        _show(there, there.places, json=args.json)
    return 0


def _names(args: argparse.Namespace) -> int:
    if args.config is None:
        raise UsageError("wireshark names: no CONFIG; name the configuration file of the plant")
    config = load_config(args.config)
    text = names_text(config)
    count = sum(len(fields) for slave in config.slaves for _, fields in slave.fields)
    count += sum(len(cpu.values) for cpu in config.ppi)
    stations = len(config.slaves) + len(config.ppi)
    if args.out is None:
        output.raw(text)
        return 0
    with AtomicFile(args.out) as file:
        file.keep(text.encode())
    if args.json:
        output.json_line({"out": args.out, "stations": stations, "names": count})
    else:
        output.line(f"{args.out}: {stations} stations, {count} names")
        output.line(f"wireshark -o profibus.names:{args.out} FILE, or Preferences, Protocols, PROFIBUS")
    return 0


def names_text(config: Config) -> str:
    """The names of ``config`` as a list for the dissector (profibus.lua), with line ends.

    Columns are separated by tabs: address, "station", name; or address, "input", "output" or "memory", kind (bool,
    uint, int, float, bytes), first octet, octets, first bit, bits, order of the octets (big, little, swapped), scale,
    offset, unit, name. "memory" is a value of an S7-200, whose octets count from its own first one; behind its name
    stand area, data block, start (bits, or number of the timer), transport size and octets of its address.
    """
    return "\n".join([_FIRST, *_lines(config)]) + "\n"


def _lines(config: Config) -> Iterator[str]:
    for slave in config.slaves:
        yield f"{slave.address}\tstation\t{_cell(slave.name)}"
        for direction, fields in slave.fields:
            for field in fields.fields.values():
                order = "little" if field.little else "swapped" if field.swapped else "big"
                place = (field.octet, field.length, field.bit or 0, field.width, order)
                scaled = (field.scale, field.offset, field.unit, field.name)
                yield _row(slave.address, direction, field.type, *place, *scaled)
    for cpu in config.ppi:
        yield f"{cpu.address}\tstation\t{_cell(cpu.name)}"
        for name, value in cpu.values.items():
            address, field = value.address, value.field
            # a timer or counter begins with a status octet
            place = (address.length - field.length, field.length, field.bit or 0, field.width, "big")
            memory = (address.area.code, address.area.block, address.start, address.size, address.length)
            scaled = (field.scale, field.offset, field.unit, name)
            yield _row(cpu.address, "memory", field.type, *place, *scaled, *memory)


def _row(station: int, direction: str, kind: str, *columns: object) -> str:
    kind = kind if kind == "bool" else _KINDS[kind[0]]
    return "\t".join(_cell(str(column)) for column in (station, direction, kind, *columns))


def _cell(text: str) -> str:
    return printable(text.replace("\t", " "))


def _remove(there: Wireshark, *, json: bool) -> None:
    removed, left = there.remove()
    if json:
        output.json_line({"removed": list(map(str, removed)), "left": list(map(str, left))})
        return
    for path in removed:
        output.line(f"removed {path}")
    for path in left:
        output.warn(f"{path} is not of dpstack: left as it is")
    if not removed:
        output.line("nothing of dpstack was there")


def _show(there: Wireshark, places: tuple[Place, Place], *, json: bool) -> None:
    states = {place.what: place.state for place in places}
    if json:
        files = {place.what: {"path": str(place.path), "state": states[place.what].name.lower()} for place in places}
        output.json_line({"tshark": there.tshark, "version": there.version, **files})
        return
    output.line(f"Wireshark {there.version} ({there.tshark})")
    for place in places:
        style = "" if states[place.what] is State.CURRENT else "yellow"
        output.line(f"{place.what}: {place.path}: {states[place.what].value}", style)
