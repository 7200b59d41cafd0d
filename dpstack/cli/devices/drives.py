"""``dpstack drives``: the drives and devices that are known here, and the packages that bring them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from dpstack import __version__
from dpstack.api.gsd_info import bundled, read_gsd
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.devices import finding
from dpstack.profile import registry


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack drives --json"
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if a plugin cannot be loaded."""
    drives, devices, broken = _drives(), _devices(), finding.broken()
    if args.json:
        unusable = [{"name": name, "reason": why} for name, why in broken.items()]
        output.json_line({"drives": drives, "devices": devices, "broken": unusable})
        return int(bool(broken))
    rows = [
        (one["name"], one["title"], one["ident"] or "ask", " ".join(one["telegrams"]), one["origin"]) for one in drives
    ]
    output.table('Drives, for drive = "NAME"', ("name", "drive", "ident", "telegrams", "from"), rows)
    for key in ("device", "gsd"):
        output.table(
            f'Devices, for {key} = "NAME"',
            ("name", "device", "ident", "from"),
            [(one["name"], one["title"], one["ident"] or "ask", one["origin"]) for one in devices if one["key"] == key],
        )
    warn_broken(broken)
    return int(bool(broken))


def warn_broken(broken: Mapping[str, str]) -> None:
    """A line for each plugin or device file that cannot be loaded."""
    plugins = registry.places()
    for name, why in broken.items():
        todo = "; repair or uninstall that package" if name in plugins else ""
        output.warn(f"drive {name} cannot be loaded: {why}{todo}")


def _drives() -> list[dict[str, Any]]:
    """``ident`` is null if no manual gives the number."""
    places, origins, files = registry.places(), finding.origins(), bundled()
    return [
        {
            "name": name,
            "title": drive.title,
            "ident": None if drive.ident_made_up else f"0x{drive.ident:04X}",
            "telegrams": list(drive.telegrams),
            "telegram": drive.default_telegram,
            "options": sorted(drive.core_options),
            "gsd": name in files,
            "origin": origins.get(name, ""),
            "place": places.get(name) or drive.file,
        }
        for name, drive in finding.known().items()
    ]


def _devices() -> list[dict[str, Any]]:
    """Device files of others than drives, and those with a GSD file that dpstack brings; ``key`` of [[slave]]."""
    drives, origins = finding.known(), finding.origins()
    found: list[dict[str, Any]] = [
        {
            "name": name,
            "key": "device",
            "title": one.title,
            "ident": None if one.ident_made_up else f"0x{one.ident:04X}",
            "origin": origins.get(name, ""),
            "place": one.file,
        }
        for name, one in finding.known_devices().items()
    ]
    for name, place in bundled().items():
        if name not in drives:
            device = read_gsd(name).device
            title = f"{device.vendor} {device.model}"
            ident = f"0x{device.ident:04X}"
            found.append(
                {
                    "name": name,
                    "key": "gsd",
                    "title": title,
                    "ident": ident,
                    "origin": f"dpstack {__version__}",
                    "place": place,
                }
            )
    return found
