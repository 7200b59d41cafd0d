"""``dpstack names``: the I/O list of a configuration, written as CSV and taken back; its names in EPICS."""

from __future__ import annotations

import argparse
from pathlib import Path

from dpstack.api.config.config import Config, parse_config, read_text
from dpstack.api.files import AtomicFile, read_file
from dpstack.api.lists.io_list import COLUMNS, csv_text, io_rows
from dpstack.api.lists.io_list_reader import MAX_LIST, TakenList, take_list
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import ConfigError, UsageError
from dpstack.toml.reading import MAX_OCTETS

#: the value of ``--csv`` without a file
_STDOUT = "-"
#: columns that the table for people leaves out
_LEFT_OUT = ("address", "dead_band", "status", "quality")
_BOM = "\ufeff"


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack names plant.toml\n"
        "          dpstack names plant.toml --csv plant.csv\n"
        "          dpstack names plant.toml --from plant.csv\n"
        "          dpstack names plant.toml --epics"
    )
    parser.value("config", "CONFIG", "configuration file")
    parser.value(
        "--csv",
        "FILE",
        "write the list as CSV into a new file; without FILE to standard output",
        nargs="?",
        const=_STDOUT,
    )
    parser.flag("--semicolons", "with --csv: semicolons between the cells, and decimal commas")
    parser.value("--from", "FILE", "take the names of a list (CSV) into CONFIG", dest="take")
    parser.flag("--epics", "the names of the process variables of [epics], one a line")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    if args.epics and (args.take is not None or args.csv is not None):
        raise UsageError("names: --epics prints other names than --csv and --from: leave one of them out")
    if args.take is not None and (args.csv is not None or args.semicolons):
        raise UsageError("names writes a list with --csv or takes one with --from: leave one of them out")
    if args.semicolons and args.csv is None:
        raise UsageError("names: --semicolons belongs to --csv: add --csv, or leave --semicolons out")
    if args.take is not None:
        return _take(args)
    if args.epics:
        return _epics(args)
    rows = list(io_rows(_config(args.config)[1]))
    if args.csv is not None:
        text = csv_text(rows, semicolons=args.semicolons)
        if args.csv == _STDOUT:
            output.raw(text.replace("\r\n", "\n"))
            return 0
        with AtomicFile(args.csv) as file:
            # with a mark of its encoding: spreadsheets read the file as another one without it
            file.keep((_BOM + text).encode())
    if args.json:
        output.json_line({"names": [row.cells for row in rows]})
    elif args.csv is not None:
        named = sum(row.is_named for row in rows)
        output.line(f"{args.csv}: {_names(named)}, {len(rows) - named} channels without a name")
    else:
        columns = [column for column in COLUMNS if column not in _LEFT_OUT]
        output.table(
            "Names and channels",
            columns,
            [["" if row.cells[column] is None else row.cells[column] for column in columns] for row in rows],
        )
    return 0


def _epics(args: argparse.Namespace) -> int:
    from dpstack.api.bus.live import described_slaves  # these here, as they load a bus
    from dpstack.api.config.connectors import EpicsConfig
    from dpstack.api.connectors.kinds import epics_names

    config = _config(args.config)[1]
    table = config.connectors.get("epics")
    if not isinstance(table, EpicsConfig):
        raise ConfigError(f"{args.config}: there is no table [epics]; add it, with the key prefix")
    slaves = described_slaves(config)
    pvs = epics_names(table, slaves, fixed=bool(config.bus.cycle_ns)).pvs.values()
    if args.json:
        shown = [
            {
                "name": pv.name,
                "slave": pv.node.slave,
                "unit": pv.node.unit or None,
                "order": None if pv.order is None else pv.order.name,
            }
            for pv in pvs
        ]
        output.json_line({"epics": shown})
    else:
        for pv in pvs:
            output.line(pv.name)
    return 0


def _config(path: str) -> tuple[str, Config]:
    """The text of the configuration file, and what it says."""
    text = read_text(path, "configuration file")
    return text, parse_config(text, path, file=Path(path).resolve())


def _take(args: argparse.Namespace) -> int:
    """Exit code 2 if lines are refused: then the configuration stays as it is."""
    before = _octets(args.config, MAX_OCTETS)
    text, config = _config(args.config)
    found = take_list(_octets(args.take, MAX_LIST), args.take, config, text)
    for note in found.notes:
        output.warn(note)
    if found.refused:
        for error in found.refused:
            output.warn(str(error))
        count = len(found.refused)
        lines = "1 line is" if count == 1 else f"{count} lines are"
        raise ConfigError(f"{args.take}: {lines} refused; correct the list: {args.config} stays as it is")
    if found.text != text:
        _replace(args.config, before, text, found.text)
    _show(args, found)
    return 0


def _replace(path: str, before: bytes, text: str, new: str) -> None:
    """Replace the configuration at once, unless it is another one by now."""
    with AtomicFile(path, lambda _: True) as file:
        if _octets(path, MAX_OCTETS) != before:
            raise UsageError(f"{path}: has changed meanwhile, nothing was written; take the list again")
        mark = before[: len(before) - len(text.encode())]  # of its encoding
        file.keep(mark + new.encode())


def _octets(path: str, most: int) -> bytes:
    try:
        return read_file(path, most)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else None
        raise ConfigError(f"{path}: {why or error}; name a file that can be read") from None


def _show(args: argparse.Namespace, found: TakenList) -> None:
    if args.json:
        output.json_line(
            {"config": args.config, "changes": [change.as_dict() for change in found.changes], "kept": found.kept}
        )
        return
    for change in found.changes:
        output.line(change.text)
    if found.kept:
        output.line(f"not in the list, as before: {', '.join(found.kept)}")
    changed = f"{_names(len(found.changes))} changed" if found.changes else "nothing to change"
    output.line(f"{args.config}: {changed}")


def _names(count: int) -> str:
    return "1 name" if count == 1 else f"{count} names"
