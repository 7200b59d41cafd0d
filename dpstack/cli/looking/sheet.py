"""``dpstack sheet``: commissioning sheets of the drives and devices of a configuration."""

from __future__ import annotations

import argparse
import contextlib
import os
from datetime import datetime
from pathlib import Path

from dpstack import __version__
from dpstack.api.commissioning.sheet import Sheet, blocks_of, make_sheets, title_of
from dpstack.api.config.config import load_config
from dpstack.api.files import close_written, open_new, write_error
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack sheet plant.toml\n         dpstack sheet plant.toml hoist --html hoist.html"
    parser.value("config", "CONFIG", "configuration file")
    parser.value("name", "NAME", "only the slave of this name or address", nargs="?")
    parser.value("--html", "FILE", "write the sheets into this new file, to print", type=Path)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 0; wrong use raises ConfigError, UsageError."""
    sheets = make_sheets(load_config(args.config), args.name)
    if args.html is not None:
        _write(args.html, sheets, Path(args.config).name)
    if args.json:
        output.json_line({"sheets": [sheet.as_dict() for sheet in sheets]})
    elif args.html is not None:
        names = ", ".join(sheet.name for sheet in sheets)
        output.line(f"{args.html}: the sheet{'s' * (len(sheets) > 1)} of {names}; open it in a browser and print it")
    else:
        for sheet in sheets:
            _show(sheet)
    return 0


def _write(path: Path, sheets: list[Sheet], plant: str) -> None:
    from dpstack.api.commissioning.sheet_page import sheets_page  # here, as most sheets are read on the terminal

    octets = memoryview(sheets_page(sheets, plant, __version__, datetime.now()).encode("utf-8", "backslashreplace"))
    fd = open_new(path)
    try:
        while octets:
            octets = octets[os.write(fd, octets) :]
    except OSError as error:
        with contextlib.suppress(OSError):
            os.ftruncate(fd, 0)
        raise write_error(path, error) from None
    finally:
        close_written(fd, path)


def _show(sheet: Sheet) -> None:
    output.line(title_of(sheet), "bold")
    for block in blocks_of(sheet):
        output.line("")
        if block.rows:
            used = [n for n in range(len(block.columns)) if n == 0 or any(row[n] for row in block.rows)]
            rows = [[row[n] for n in used] for row in block.rows]
            output.table(block.title, [block.columns[n] for n in used], rows)
        else:
            output.line(block.title, "bold")
        for text in block.lines:
            output.line(f"- {text}")
    output.line("")
