"""Words, tables and JSON lines on standard output: colours on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from dpstack.cli.streams import guarded
from dpstack.text import json_text, long_escape, printable

#: columns whose text may be long; the others keep their width
_MAY_WRAP: Final = frozenset(
    {
        "inputs",
        "outputs",
        "when the master stops",
        "value",
        "module",
        "parameter",
        "parameters",
        "user parameters",
        "allowed",
        "allowed modules",
        "used by",
        "text",
        "help",
    }
)


def on_terminal() -> bool:
    """True when a person reads along."""
    return sys.stdout.isatty()


def json_line(data: Mapping[str, object] | Sequence[object]) -> None:
    """One JSON value on a line of its own, at once."""
    _write(json_text(data, encoding=sys.stdout.encoding or "utf-8"))


def toml(text: str) -> None:
    """Lines of TOML. What standard output cannot encode is escaped: it can only stand in strings and comments."""
    encoding = sys.stdout.encoding or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        text = "".join(letter if letter.isascii() else long_escape(letter) for letter in text)
    _write(text.removesuffix("\n"))


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
            Console(soft_wrap=True).print(shown(text, style))
    else:
        _write(printable(text))


def shown(text: str, style: str = "") -> Text:
    """``text`` as rich draws it: nothing in it is an escape sequence, markup or the name of an emoji."""
    return Text(printable(text), style=style)


def first_of(labels: Sequence[str], shown: int = 3) -> str:
    """So many of ``labels``, and how many more there are."""
    more = len(labels) - shown
    return ", ".join(labels[:shown]) + (f" and {more} more" if more > 0 else "")


def rich_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Table:
    """A table as rich draws it."""
    table = Table(title=shown(title, "bold") if title else None, title_justify="left")
    for column in columns:
        table.add_column(column, no_wrap=column not in _MAY_WRAP, overflow="fold")
    for row in rows:
        table.add_row(*(shown(str(cell)) for cell in row))
    return table


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A table: drawn on a terminal, aligned columns elsewhere."""
    cells = [[printable(str(cell)) for cell in row] for row in rows]
    if on_terminal():
        with guarded():
            Console().print(rich_table(title, columns, cells))
        return
    widths = [max(len(row[n]) for row in [list(columns), *cells]) for n in range(len(columns))]
    aligned = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in [list(columns), *cells]
    ]
    _write("\n".join([printable(title), *aligned] if title else aligned))


def _write(text: str) -> None:
    with guarded():
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
