"""``dpstack drives``: the drives and devices that are known here, and the packages that bring them."""

from __future__ import annotations

import argparse
from typing import Any

from dpstack import __version__
from dpstack.api.gsd_info import bundled, read_gsd
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.profile import registry


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack drives --json"
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if a plugin cannot be loaded."""
    drives, devices, broken = _drives(), _devices(), registry.broken()
    if args.json:
        unusable = [{"name": name, "reason": why} for name, why in broken.items()]
        output.json_line({"drives": drives, "devices": devices, "broken": unusable})
        return int(bool(broken))
    rows = [
        (one["name"], one["title"], one["ident"] or "ask", " ".join(one["telegrams"]), one["origin"]) for one in drives
    ]
    output.table('Drives, for drive = "NAME"', ("name", "drive", "ident", "telegrams", "from"), rows)
    output.table(
        'Devices, for gsd = "NAME"',
        ("name", "device", "ident", "from"),
        [(one["name"], one["title"], one["ident"], one["origin"]) for one in devices],
    )
    for name, why in broken.items():
        output.warn(f"drive {name} cannot be loaded: {why}; repair or uninstall that package")
    return int(bool(broken))


def _drives() -> list[dict[str, Any]]:
    """``ident`` is null if no manual gives the number."""
    places, origins, files = registry.places(), registry.origins(), bundled()
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
            "place": places.get(name, ""),
        }
        for name, drive in sorted(registry.known().items())
    ]


def _devices() -> list[dict[str, Any]]:
    """Those with a GSD file that dpstack brings, and no plugin."""
    found: list[dict[str, Any]] = []
    for name, place in bundled().items():
        if name not in registry.known():
            device = read_gsd(name).device
            title = f"{device.vendor} {device.model}"
            ident = f"0x{device.ident:04X}"
            found.append(
                {"name": name, "title": title, "ident": ident, "origin": f"dpstack {__version__}", "place": place}
            )
    return found
