"""``dpstack import``: a configuration from the project of another engineering tool, for work beside its PLC."""

# ruff: noqa: N999 the module has the name of its command, which is loaded by that name
from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Final

from msgspec import to_builtins

from dpstack.api.bus.compose import plan_bus
from dpstack.api.config.config import parse_config
from dpstack.api.files import AtomicFile, read_file
from dpstack.api.gsd_folder import GsdFolder
from dpstack.api.gsd_orders import FolderFinder
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import ConfigError, UsageError
from dpstack.importers.step7_cfg import MAX_OCTETS, Export, read_cfg
from dpstack.importers.step7_plant import ImportedPlant, make_plant

#: of a slave in JSON
_OF_SLAVE: Final = ("address", "name", "source", "names", "active", "refuse_master")


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack import line4.cfg --gsd gsd/ --out line4.toml\n"
        "          dpstack import plant.cfg --system 2 --out bus2.toml"
    )
    parser.value("file", "FILE.cfg", "the hardware export of STEP 7 (HW Config, Station > Export)")
    parser.value("--gsd", "DIR", "the folder of the plant's GSD files, and the folders in it")
    parser.value("--out", "FILE", "write the configuration into this new file; without it to standard output")
    parser.value("--system", "N", "the DP system, if the export has several", type=int)
    parser.value("--encoding", "NAME", "the code page of the export, if it was not recognised (cp1250, cp1251 ...)")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    if args.out is None:
        return _import(args, Path())
    with AtomicFile(args.out) as file:  # first: a name that is taken must not cost the work
        return _import(args, Path(args.out).parent, file)


def _import(args: argparse.Namespace, beside: Path, file: AtomicFile | None = None) -> int:
    finder = None if args.gsd is None else FolderFinder(GsdFolder(args.gsd, beside=beside))
    octets = _octets(args.file)
    try:
        export = read_cfg(octets, args.encoding or "")
        plant = make_plant(export, args.system, finder, partial(_refused, beside=beside), file=Path(args.file).name)
    except ConfigError as error:
        raise ConfigError(f"{args.file}: {error}") from None
    if file is not None:
        file.keep(plant.text.encode())
    if not args.json:
        for remark in plant.remarks:
            output.warn(f"{args.file}{f':{remark.line}' if remark.line else ''}: {remark.text}")
    _show(args, export, plant)
    return 1 if export.cut else 0


def _octets(path: str) -> bytes:
    try:
        return read_file(path, MAX_OCTETS)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UsageError(f"{path}: {reason}; give the hardware export of STEP 7 (.cfg)") from None


def _refused(text: str, beside: Path) -> str:
    """Why ``dpstack plan`` refuses the configuration ``text`` in the folder ``beside``; empty if it does not."""
    try:
        file = beside / "plant.toml"  # its folder counts: GSD files are looked for from there
        plan_bus(parse_config(text, str(file), file=file.absolute()))
    except ConfigError as error:
        return error.what or str(error)
    return ""


def _show(args: argparse.Namespace, export: Export, plant: ImportedPlant) -> None:
    if args.json:
        output.json_line(_as_dict(args, export, plant))
    elif args.out is None:
        output.toml(plant.text)
    else:
        active = [slave for slave in plant.slaves if slave.active]
        left = len(plant.slaves) - len(active)
        names = sum(slave.names for slave in active)
        more = f", {left} as comments" if left else ""
        output.line(f"{args.out}: {len(active)} slaves{more}, {names} names, {len(plant.remarks)} remarks")
        output.line("read only: the PLC is their master; `dpstack run` of this file would join its token ring and look")


def _as_dict(args: argparse.Namespace, export: Export, plant: ImportedPlant) -> dict[str, object]:
    return {
        "file": args.file,
        "out": args.out,
        "station": plant.station,
        "step7": plant.version,
        "encoding": export.encoding,
        "cut": bool(export.cut),
        "system": plant.system.number,
        "name": plant.system.name,
        "subnet": plant.system.subnet,
        "plc": plant.system.master,
        "baud": plant.baud,
        "address": plant.address,
        "slaves": [{key: getattr(slave, key) for key in _OF_SLAVE} for slave in plant.slaves],
        "remarks": to_builtins(plant.remarks),
        "toml": plant.text if args.out is None else None,
    }
