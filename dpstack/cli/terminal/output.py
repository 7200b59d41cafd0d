"""Words, tables and JSON lines: drawn by :mod:`dpstack.cli.terminal.drawing` on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence

from dpstack.cli.terminal.lost_stdout import guarded
from dpstack.text import json_text, long_escape, printable


def on_terminal() -> bool:
    """Whether standard output is a terminal."""
    return sys.stdout.isatty()


def json_line(data: Mapping[str, object] | Sequence[object]) -> None:
    """Write one JSON value on a line of its own, and flush."""
    _write(json_text(data, encoding=sys.stdout.encoding or "utf-8"))


def toml(text: str) -> None:
    """Write TOML. Characters that standard output cannot encode are escaped: only strings and comments have them."""
    encoding = sys.stdout.encoding or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        text = "".join(letter if letter.isascii() else long_escape(letter) for letter in text)
    _write(text.removesuffix("\n"))


def missing(json: bool) -> Callable[[int], str]:
    """The function for the notice on dropped lines, see :func:`dpstack.cli.terminal.nonblocking_stdout.unhurried`."""

    def notice(lines: int) -> str:
        text = f"{lines} lines are missing here: nobody was reading"
        return json_text({"event": "notice", "text": text, "missing": lines}) if json else text

    return notice


def line(text: str, style: str = "") -> None:
    """Write one line; on a terminal in ``style``, wrapped between words only."""
    if on_terminal():
        from dpstack.cli.terminal import drawing

        with guarded():
            drawing.line(text, style)
    else:
        _write(printable(text))


def first_of(labels: Sequence[str], shown: int = 3) -> str:
    """The first ``shown`` labels, and the number of the others."""
    more = len(labels) - shown
    return ", ".join(labels[:shown]) + (f" and {more} more" if more > 0 else "")


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table: drawn on a terminal, aligned columns elsewhere."""
    cells = [[printable(str(cell)) for cell in row] for row in rows]
    if on_terminal():
        from dpstack.cli.terminal import drawing

        with guarded():
            drawing.table(title, columns, cells)
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
