"""Words, tables and JSON lines on standard output: colours on a terminal, plain lines elsewhere."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

from rich.console import Console
from rich.table import Table

from dpstack.cli.streams import guarded

#: columns whose text may be long; the others keep their width
_MAY_WRAP: Final = frozenset({"inputs", "outputs", "when the master stops"})


def on_terminal() -> bool:
    """True when a person reads along."""
    return sys.stdout.isatty()


def json_line(data: Mapping[str, object] | Sequence[object]) -> None:
    """One JSON value on a line of its own, at once."""
    _write(json_text(data))


def json_text(data: Mapping[str, object] | Sequence[object]) -> str:
    """One JSON value without its line end."""
    return json.dumps(data, separators=(",", ":"), ensure_ascii=False)


def missing(json: bool) -> Callable[[int], str]:
    """What is written when so many lines found no reader; see :func:`dpstack.cli.outlet.unhurried`."""

    def notice(lines: int) -> str:
        text = f"{lines} lines are missing here: nobody was reading"
        return json_text({"event": "notice", "text": text, "missing": lines}) if json else text

    return notice


def line(text: str, style: str = "") -> None:
    """One line, in ``style`` on a terminal."""
    if on_terminal():
        with guarded():
            Console(soft_wrap=True).print(text, style=style or None, markup=False, highlight=False)
    else:
        _write(text)


def visible(text: str) -> str:
    """A device's own text, its control characters in hex: they are nothing for a terminal."""
    return "".join(letter if letter.isprintable() else f"\\x{ord(letter):02x}" for letter in text)


def first_of(labels: Sequence[str], shown: int = 3) -> str:
    """So many of ``labels``, and how many more there are."""
    more = len(labels) - shown
    return ", ".join(labels[:shown]) + (f" and {more} more" if more > 0 else "")


def rich_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Table:
    """A table as rich draws it."""
    table = Table(title=title or None, title_justify="left", title_style="bold")
    for column in columns:
        table.add_column(column, no_wrap=column not in _MAY_WRAP, overflow="fold")
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    return table


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A table: drawn on a terminal, aligned columns elsewhere."""
    cells = [[str(cell) for cell in row] for row in rows]
    if on_terminal():
        with guarded():
            Console().print(rich_table(title, columns, cells))
        return
    widths = [max(len(row[n]) for row in [list(columns), *cells]) for n in range(len(columns))]
    aligned = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in [list(columns), *cells]
    ]
    _write("\n".join([title, *aligned] if title else aligned))


def _write(text: str) -> None:
    with guarded():
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
