"""``dpstack device``: device files checked, shown, listed and begun."""

from __future__ import annotations

import argparse

from dpstack.cli.parser import Parser
from dpstack.devices.finding import DRIVE_BASES


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack device check fan.toml"
    inner = parser.add_subparsers(dest="device_command", metavar="COMMAND", required=True)

    def command(name: str, text: str, example: str) -> Parser:
        return inner.add_parser(name, help=text, description=text, epilog=f"example: dpstack device {example}")

    checker = command(
        "check",
        "every mistake of a device file with its line, then its examples, then its drive in the simulation; "
        "exit code 1 if one does not hold",
        "check fan.toml",
    )
    checker.value("file", "FILE", "device file, or the name of one that is known")
    checker.value("--telegram", "T", "check this telegram in the simulation, instead of those of the file", nargs="+")
    checker.run_by(check)
    beginner = command(
        "new",
        "write a first device file from a GSD file; on a terminal it asks, elsewhere the options say it",
        "new --gsd fan.gsd -o fan.toml",
    )
    beginner.value("--gsd", "FILE", "the maker's GSD file", required=True)
    beginner.value("--base", "BASE", "profidrive, drivecom or bits; by the modules if left out", choices=DRIVE_BASES)
    beginner.value("--name", "NAME", "name of the drive; that of the file, or of the model, if left out")
    beginner.value("--title", "TITLE", "maker and type; those of the GSD file if left out")
    modules = "modules of one telegram, by name or number; may be repeated. All standard telegrams if left out"
    beginner.value("--modules", "M", modules, nargs="+", action="append")
    words = "words {} in their order, NAME, NAME:TYPE or a constant, for a telegram of no standard"
    beginner.value("--out", "WORD", words.format("to the drive"), nargs="+")
    beginner.value("--in", "WORD", words.format("from the drive"), nargs="+", dest="inputs")
    beginner.value("-o", "FILE", "the new file; without it standard output", dest="target")
    beginner.run_by(begin, json=False)
    lister = command("list", "the drives and devices that are known, with base, source and place", "list")
    lister.run_by(list_all)
    shower = command(
        "show",
        "telegrams with their words, bits, states, faults, parameters, options and settings of a drive",
        "show profidrive",
    )
    shower.value("file", "NAME", "name of a drive, or the path of a device file")
    shower.run_by(show)


def check(args: argparse.Namespace) -> int:
    from dpstack.cli.devices.check import check_file  # each here, as it loads what the others do not need

    return check_file(args.file, tuple(args.telegram or ()), json=args.json)


def begin(args: argparse.Namespace) -> int:
    from dpstack.cli.devices.new import new_file

    return new_file(args)


def list_all(args: argparse.Namespace) -> int:
    from dpstack.cli.devices.show import list_devices

    return list_devices(json=args.json)


def show(args: argparse.Namespace) -> int:
    from dpstack.cli.devices.show import show_device

    return show_device(args.file, json=args.json)
