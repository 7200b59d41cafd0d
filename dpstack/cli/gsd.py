"""``dpstack gsd``: what a GSD file says, what is wrong with it, and the way to a [[slave]] table."""

from __future__ import annotations

import argparse

from dpstack.api.gsd import (
    alarms_text,
    check_gsd,
    copy_gsd,
    diagnostic_dict,
    gsd_dict,
    module_lengths,
    module_prm,
    read_gsd,
    requires,
    supports,
)
from dpstack.cli import gsd_configure, options, output
from dpstack.gsd.check import check
from dpstack.gsd.model import Diagnostic, GsdFile, Parameter, ranges_text
from dpstack.trace import Severity
from dpstack.units import baud_text

_STYLES = {Severity.INFO: "dim", Severity.WARNING: "yellow", Severity.ERROR: "bold red"}


def add_to(commands: options.Commands) -> None:
    """The command with its own commands."""
    parser = options.command(commands, "gsd", "GSD files: show, check, configure", "dpstack gsd show valves.gsd")
    inner = parser.add_subparsers(dest="gsd_command", metavar="COMMAND", required=True)
    shower = options.command(inner, "show", "what a GSD file says", "dpstack gsd show valves.gsd --json")
    shower.add_argument("file", metavar="FILE", help="GSD file, or a drive that has one here (demag-dedrive, keb-f5)")
    options.add_json(shower)
    shower.set_defaults(execute=show)
    checker = options.command(
        inner, "check", "what is wrong or odd in GSD files; exit code 1 where one is damaged", "dpstack gsd check *.gsd"
    )
    checker.add_argument("files", metavar="FILE", nargs="+", help="GSD files")
    options.add_json(checker)
    checker.set_defaults(execute=check_files)
    chooser = options.command(
        inner,
        "configure",
        "ask the way from a GSD file to a [[slave]] table on stdout",
        "dpstack gsd configure valves.gsd >> plant.toml",
    )
    chooser.add_argument("file", metavar="FILE", help="GSD file, as the configuration will name it")
    chooser.set_defaults(execute=configure)
    copier = options.command(
        inner,
        "copy",
        "write the GSD file that dpstack brings for a drive (from its manual, not the vendor's) or for io-station",
        "dpstack gsd copy demag-dedrive hoist.gsd",
    )
    copier.add_argument("drive", metavar="DRIVE", help="name of the drive, or io-station")
    copier.add_argument("file", metavar="FILE", help="where to; a new file")
    copier.set_defaults(execute=copy)


def show(args: argparse.Namespace) -> int:
    """Print what a file says."""
    file = read_gsd(args.file)
    if args.json:
        output.json_line(gsd_dict(file))
    else:
        _show(file)
    return 0


def configure(args: argparse.Namespace) -> int:
    """Ask, then print a table."""
    return gsd_configure.run(read_gsd(args.file), args.file)


def copy(args: argparse.Namespace) -> int:
    """Write a drive's own file."""
    copy_gsd(args.drive, args.file)
    return 0


def check_files(args: argparse.Namespace) -> int:
    """Print the findings of every file; 1 when one of them is an error."""
    worst = 0
    for path in args.files:
        found = check_gsd(path)
        if args.json:
            output.json_line({"file": path, "diagnostics": [diagnostic_dict(d) for d in found]})
        else:
            for diagnostic in found:
                _tell(path, diagnostic)
            if not found:
                output.line(f"{path}: nothing is wrong", "green")
        worst |= any(diagnostic.severity is Severity.ERROR for diagnostic in found)
    return int(worst)


def _tell(path: str, diagnostic: Diagnostic) -> None:
    output.line(f"{path}:{diagnostic.text}", _STYLES[diagnostic.severity])


def _show(file: GsdFile) -> None:
    data, device = gsd_dict(file), file.device
    rows = [
        (name, data[key])
        for name, key in (
            ("vendor", "vendor"),
            ("model", "model"),
            ("ident number", "ident"),
            ("revision", "revision"),
            ("GSD revision", "gsd_revision"),
            ("modules at most", "max_module"),
            ("inputs at most", "max_input_len"),
            ("outputs at most", "max_output_len"),
            ("both together", "max_data_len"),
            ("diagnosis at most", "max_diag_data_len"),
            ("user parameters", "user_prm"),
        )
        if data[key] not in (None, "")
    ]
    if data["user_prm"] != data["user_prm_const"]:
        rows.append(("constants beneath", data["user_prm_const"]))
    rows.append(("supports", ", ".join(supports(file)) or "nothing beyond the basics"))
    if requires(file):
        rows.append(("requires", ", ".join(requires(file))))
    alarms = alarms_text(file.device)
    if alarms is not None:
        rows.append(("alarms", alarms))
    output.table("Device", ("", "value"), rows)
    output.table(
        "Baud rates",
        ("rate", "MaxTsdr in bit times"),
        [(baud_text(s.baud), "not said" if s.max_tsdr is None else s.max_tsdr) for s in device.speeds],
    )
    if device.modules:
        output.table(
            f"Modules ({len(device.modules)})",
            ("reference", "name", "identifier", "in", "out", "user parameters"),
            [
                (
                    "" if m.reference is None else m.reference,
                    m.name,
                    m.config.hex(" "),
                    *("?" if length is None else length for length in module_lengths(m)),
                    module_prm(file, m).hex(" "),
                )
                for m in device.modules
            ],
        )
    if device.parameters:
        output.table(
            f"Parameters ({len(device.parameters)})",
            ("number", "name", "type", "default", "allowed"),
            [
                (p.number, p.name, p.type.text, p.texts.get(p.default, p.default), _allowed(p))
                for p in device.parameters.values()
            ],
        )
    for diagnostic in check(file):
        _tell(file.name, diagnostic)


def _allowed(parameter: Parameter) -> str:
    return ", ".join(parameter.texts.values()) or ranges_text(parameter.allowed)
