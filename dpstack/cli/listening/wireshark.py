"""``dpstack wireshark``: dissector and extcap program for the Wireshark that is there."""

from __future__ import annotations

import argparse

from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.wireshark.installation import Place, State, Wireshark, find_wireshark


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack wireshark install"
    what = "install, remove: into, from the folders of the user; where: print the folders"
    parser.add_argument("action", choices=("install", "remove", "where"), help=what)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
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
