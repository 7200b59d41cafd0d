"""``dpstack gsd``: shows, checks, configures, copies and writes GSD files."""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from dpstack.api.gsd_info import (
    REQUIRES,
    SUPPORTS,
    alarms_text,
    check_gsd,
    copy_gsd,
    device_facts,
    diagnosis_texts,
    diagnostic_dict,
    flags_of,
    gsd_dict,
    gsd_files,
    module_lengths,
    module_prm,
    read_gsd,
    write_gsd,
)
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import ConfigError
from dpstack.gsd.check import check
from dpstack.gsd.model import Device, Diagnostic, GsdFile, Parameter, PrmBlock, ranges_text
from dpstack.text import runs_of, some_of
from dpstack.trace import Severity
from dpstack.units import baud_text

_STYLES = {Severity.INFO: "dim", Severity.WARNING: "yellow", Severity.ERROR: "bold red"}

#: rows of the table of a device, and their keys in the JSON
_FACTS: Final = {
    "vendor": "vendor",
    "model": "model",
    "ident number": "ident",
    "revision": "revision",
    "GSD revision": "gsd_revision",
    "modules at most": "max_module",
    "inputs at most": "max_input_len",
    "outputs at most": "max_output_len",
    "both together": "max_data_len",
    "diagnosis at most": "max_diag_data_len",
    "user parameters": "user_prm",
}


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack gsd show valves.gsd"
    inner = parser.add_subparsers(dest="gsd_command", metavar="COMMAND", required=True)

    def command(name: str, text: str, example: str) -> Parser:
        return inner.add_parser(name, help=text, description=text, epilog=f"example: dpstack gsd {example}")

    shower = command("show", "the contents of a GSD file", "show valves.gsd --json")
    shower.value("file", "FILE", "GSD file, or a drive that has one here (demag-dedrive, keb-f5)")
    shower.run_by(show)
    checker = command(
        "check",
        "faults and oddities of GSD files, with a summary for a directory; exit code 1 where one is damaged",
        "check *.gsd",
    )
    checker.value("files", "FILE|DIR", "GSD files, or directories of them", nargs="+")
    checker.run_by(check_files)
    chooser = command(
        "configure",
        "ask the way from a GSD file to a [[slave]] table on stdout",
        "configure valves.gsd >> plant.toml",
    )
    chooser.value("file", "FILE", "GSD file, as the configuration will name it")
    seen = "configuration that the table is for: its names and addresses are taken, FILE is named as seen from it"
    chooser.value("--config", "CONFIG", seen)
    chooser.run_by(configure, json=False)
    copier = command(
        "copy",
        "write the GSD file that dpstack brings for a drive (from its manual, not the vendor's) or for io-station",
        "copy demag-dedrive hoist.gsd",
    )
    copier.value("drive", "DRIVE", "name of the drive, or io-station")
    copier.value("file", "FILE", "where to; a new file")
    copier.run_by(copy, json=False)
    # in the room of commands that look at things, above this one
    command(
        "find",
        "GSD files by words (vendor, model, order number, ident number, module), the best ones first",
        "find siemens 8DI gsd/",
    ).module = "dpstack.cli.looking.gsd_find"
    command(
        "diff",
        "two GSD files: what differs on the wire, then modules, texts, parameters; exit code 1 where they differ",
        "diff old.gsd new.gsd",
    ).module = "dpstack.cli.looking.gsd_diff"
    writer = command(
        "write",
        "write a GSD file for a slave of your own, so that the tool of a PLC knows it; loads (runs) the module",
        "write tank.py:TYPE tank.gsd",
    )
    writer.value("slave", "MODULE:NAME", "a SlaveDescription or a DpSlave, in a module or a file tank.py")
    writer.value("file", "FILE", "where to; a new file")
    writer.flag("--force", "write over an existing file")
    writer.run_by(write, json=False)


def show(args: argparse.Namespace) -> int:
    file = read_gsd(args.file)
    if args.json:
        output.json_line(gsd_dict(file))
    else:
        _show(file)
    return 0


def configure(args: argparse.Namespace) -> int:
    from dpstack.cli.commands.gsd_configure import Dialogue  # here, as the others ask nothing

    return Dialogue(read_gsd(args.file), args.file, args.config).run()


def copy(args: argparse.Namespace) -> int:
    copy_gsd(args.drive, args.file)
    return 0


def write(args: argparse.Namespace) -> int:
    """Remarks go to standard error; they do not change the exit code."""
    from dpstack.api.user_code import load_description  # here, as the others run no code of the user

    for remark in write_gsd(load_description(args.slave), args.file, replace=args.force):
        output.warn(remark)
    return 0


def check_files(args: argparse.Namespace) -> int:
    """Print the findings of every file, and a summary for directories. Exit code 1 when a finding is an error."""
    worst: Counter[str] = Counter()
    folders = [given for given in args.files if os.path.isdir(given)]  # Path.is_dir would raise for an impossible name
    for given in args.files:
        is_folder = given in folders
        for path in map(str, gsd_files(Path(given))) if is_folder else [given]:
            worst[_check_file(path, json=args.json, among_many=is_folder)] += 1
            if output.lost.error is not None:
                return 1
    if folders:
        _summary(worst, json=args.json)
    return int(bool(worst[_DAMAGED] or worst[_UNREADABLE]))


_DAMAGED: Final = "damaged"
_UNREADABLE: Final = "unreadable"
#: worst finding of a file -> text of the summary
_JUDGEMENTS: Final = {
    "sound": "without a finding",
    "info": "with remarks only",
    "warning": "with warnings",
    _DAMAGED: "damaged",
    _UNREADABLE: "unreadable",
}


def _check_file(path: str, *, json: bool, among_many: bool) -> str:
    """Print the findings of one file and return its key in :data:`_JUDGEMENTS`.

    ``among_many``: a file that cannot be read is a finding too, and one without findings gets no line.
    """
    try:
        found = check_gsd(path)
    except ConfigError as error:
        if not among_many:
            raise
        if json:
            output.json_line({"file": path, "diagnostics": [], "error": str(error)})
        else:
            output.line(str(error), _STYLES[Severity.ERROR])
        return _UNREADABLE
    if json:
        output.json_line({"file": path, "diagnostics": [diagnostic_dict(d) for d in found]})
    else:
        for diagnostic in found:
            _show_diagnostic(path, diagnostic)
        if not found and not among_many:
            output.line(f"{path}: nothing is wrong", "green")
    severities = {diagnostic.severity for diagnostic in found}
    if Severity.ERROR in severities:
        return _DAMAGED
    return "warning" if Severity.WARNING in severities else "info" if severities else "sound"


def _summary(counts: Counter[str], *, json: bool) -> None:
    if json:
        kinds = {kind: counts[kind] for kind in _JUDGEMENTS}
        output.json_line({"event": "summary", "files": counts.total(), **kinds})
    else:
        texts = ", ".join(f"{counts[kind]} {words}" for kind, words in _JUDGEMENTS.items() if counts[kind])
        output.line(f"{counts.total()} file{'s' * (counts.total() != 1)}: {texts}")


def _show_diagnostic(path: str, diagnostic: Diagnostic) -> None:
    output.line(f"{path}:{diagnostic.text}", _STYLES[diagnostic.severity])


def _show(file: GsdFile) -> None:
    data, device = device_facts(file.device), file.device
    rows = [(name, data[key]) for name, key in _FACTS.items() if data[key] not in (None, "")]
    if data["user_prm"] != data["user_prm_const"]:
        rows.append(("constants beneath", data["user_prm_const"]))
    rows.append(("supports", ", ".join(flags_of(file.device, SUPPORTS)) or "nothing beyond the basics"))
    required = flags_of(file.device, REQUIRES)
    if required:
        rows.append(("requires", ", ".join(required)))
    alarms = alarms_text(file.device)
    if alarms is not None:
        rows.append(("alarms", alarms))
    if any(ref.number in device.parameters for ref in device.prm.refs):
        rows.append(("parameters", _numbers(device.prm)))
    if any(m.preset for m in device.modules):
        which = "fixed presets" if device.fix_preset_modules else "presets"
        rows.append((which, ", ".join(m.name for m in device.modules if m.preset)))
    output.table("Device", ("", "value"), rows)
    output.table(
        "Baud rates",
        ("rate", "MaxTsdr in bit times"),
        [(baud_text(s.baud), "not said" if s.max_tsdr is None else s.max_tsdr) for s in device.speeds],
    )
    if device.slots:
        output.table(
            f"Slots that SlotDefinition lists (the first slot is {device.first_slot})",
            ("slot", "slot name", "default module", "allowed modules"),
            [
                (s.number, s.name, "" if s.default is None else s.default, ranges_text(s.allowed) or "any")
                for s in device.slots
            ],
        )
    if device.modules:
        output.table(
            f"Modules ({len(device.modules)})",
            ("reference", "module", "identifier", "in", "out", "user parameters", "parameters"),
            [
                (
                    "" if m.reference is None else m.reference,
                    m.name,
                    m.config.hex(" "),
                    *("?" if length is None else length for length in module_lengths(m)),
                    module_prm(file, m).hex(" "),
                    _numbers(m.prm),
                )
                for m in device.modules
            ],
        )
    if device.parameters:
        users = _users(device)
        output.table(
            f"Parameters ({len(device.parameters)})",
            ("number", "parameter", "type", "default", "allowed", "used by"),
            [
                (p.number, p.name, p.type.text, p.texts.get(p.default, p.default), _allowed(p), users[p.number])
                for p in device.parameters.values()
            ],
        )
    _show_diagnosis(device)
    for diagnostic in check(file):
        _show_diagnostic(file.name, diagnostic)


def _show_diagnosis(device: Device) -> None:
    """All texts of diagnoses; those of diagnosis types and modules with their origin."""
    sources = [("", device.diagnosis), *((f"UnitDiagType {d.type}", d) for d in device.diag_types)]
    sources += [(m.name, m.diagnosis) for m in device.modules]
    rows = [
        (where, _where(row), row["text"], row["help"]) for where, texts in sources for row in diagnosis_texts(texts)
    ]
    if rows:
        output.table(f"Texts of diagnoses ({len(rows)})", ("of", "where", "text", "help"), rows)


def _where(row: Mapping[str, object]) -> str:
    match row["kind"]:
        case "bit":
            return f"bit {row['first']}"
        case "not_bit":
            return f"bit {row['first']} is 0"
        case "area":
            return f"bits {row['first']}..{row['last']} = {row['value']}"
        case _:
            return f"channel error {row['value']}"


def _numbers(prm: PrmBlock) -> str:
    """``1..4, 7``: numbers of parameters in ascending order, each once."""
    return ranges_text(tuple(runs_of(ref.number for ref in prm.refs)))


def _users(device: Device) -> dict[int, str]:
    """Number of a parameter -> its users: the device, and the first modules by name."""
    found: dict[int, dict[str, None]] = {number: {} for number in device.parameters}
    for title, prm in (("device", device.prm), *((m.name, m.prm) for m in device.modules)):
        for ref in prm.refs:
            found.get(ref.number, {})[title] = None
    return {number: some_of(users) for number, users in found.items()}


def _allowed(parameter: Parameter) -> str:
    return ", ".join(parameter.choices.values()) or ranges_text(parameter.allowed)
