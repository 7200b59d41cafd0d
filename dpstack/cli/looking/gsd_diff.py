"""``dpstack gsd diff``: two GSD files compared: on the wire first, then texts, parameters, the rest."""

from __future__ import annotations

import argparse

from dpstack.api.gsd_info import read_gsd
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.gsd.device_comparison import Part, compare_devices


def add_to(parser: Parser) -> None:
    parser.value("old", "FILE", "GSD file, or a drive that has one here")
    parser.value("new", "FILE", "the other one")
    parser.flag("--wire", "only what differs on the wire: exit code 0 if that is the same")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """As diff: exit code 0 if the files say the same, 1 if they differ, 2 if one cannot be read."""
    old, new = read_gsd(args.old), read_gsd(args.new)
    changes = compare_devices(old.device, new.device)
    wire = [change for change in changes if change.part is Part.WIRE]
    if args.wire:
        changes = wire
    if args.json:
        listed = [change.as_dict() for change in changes]
        output.json_line({"old": args.old, "new": args.new, "same_on_wire": not wire, "changes": listed})
        return 1 if changes else 0
    if changes or args.wire:
        output.line("on the wire: " + (f"{len(wire)} difference{'s' * (len(wire) > 1)}" if wire else "the same"))
    else:
        output.line("the same: both files say the same about the device")
    part = None
    for change in changes:
        if change.part is not part:
            part = change.part
            if part is not Part.WIRE:
                output.line(f"{part.value}:")
        output.line(f"  {change.text}")
    return 1 if changes else 0
