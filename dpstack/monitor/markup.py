"""HTML of what is printed: the acceptance report and the commissioning sheet. No network, no script.

Foreign text (names, texts of GSD files) is escaped.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib import resources
from typing import Final

from dpstack.text import printable

NOT_TIMED: Final = "n/a"
_POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'"


def text(value: object) -> str:
    """``value`` as text of HTML or SVG: foreign text has neither mark-up nor controls any more."""
    return escape(printable(str(value)))


def html_page(title: str, header: str, body: str, made: str, version: str) -> str:
    """A whole page: ``header`` and ``body`` are HTML, the others text."""
    style = resources.files(__package__).joinpath("report.css").read_text(encoding="utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="generator" content="dpstack {text(version)}">\n'
        f"<title>{text(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
        f"<header>{header}</header>\n<main>\n{body}</main>\n<footer><p>{text(made)}</p></footer>\n"
        "</body>\n</html>\n"
    )


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def join_lines(parts: Iterable[str]) -> str:
    return "\n".join(parts)


def html_section(title: str, body: str, css: str = "", *, prefix: str = "", level: int = 2) -> str:
    """A section with a heading of ``level``; ``prefix`` makes its anchor unique."""
    name = prefix + "-".join(re.findall(r"\w+", title.lower()))
    kind = f' class="{css}"' if css else ""
    return (
        f'<section aria-labelledby="{name}"{kind}>\n<h{level} id="{name}">{text(title)}</h{level}>\n{body}\n'
        "</section>\n"
    )


def html_inputs(names: Iterable[str], prefix: str) -> str:
    return "".join(
        f'<div class="field"><label for="{prefix}{number}">{name}</label><input id="{prefix}{number}" type="text" '
        'autocomplete="off" maxlength="80"></div>'
        for number, name in enumerate(names)
    )


def html_pairs(rows: Mapping[str, object]) -> str:
    """Names and values as a table with row headers."""
    lines = "".join(
        f'<tr><th scope="row">{text(name)}</th><td>{_cell(value)}</td></tr>\n' for name, value in rows.items()
    )
    return f'<table class="pairs"><tbody>\n{lines}</tbody></table>'


def html_table(
    caption: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[object]],
    *,
    numbers: Iterable[int],
    head_is_number: bool = False,
) -> str:
    """A table whose first column heads its rows, with a ``caption`` unless it is empty.

    ``numbers``: columns set to the right. Empty columns are left out.
    """
    kept = list(rows)
    used = [n for n in range(len(columns)) if n == 0 or not kept or any(row[n] not in ("", None) for row in kept)]
    right = set(numbers)

    def kind(column: int) -> str:
        return ' class="n"' if column in right or (column == 0 and head_is_number) else ""

    head = "".join(f'<th scope="col"{kind(n)}>{text_of_column(columns[n])}</th>' for n in used)
    lines = []
    for row in kept:
        cells = "".join(f"<td{kind(n)}>{_cell(row[n])}</td>" for n in used[1:])
        lines.append(f'<tr><th scope="row"{kind(0)}>{_cell(row[0])}</th>{cells}</tr>\n')
    name = text(caption)
    scroll = f' role="region" aria-label="{name}" tabindex="0"' if caption else ""
    return (
        f'<div class="scroll"{scroll}><table>{f"<caption>{name}</caption>" if caption else ""}\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{''.join(lines)}</tbody></table></div>\n"
    )


def text_of_column(name: str) -> str:
    """A heading of ours; its soft hyphens stay."""
    return "&shy;".join(map(text, name.split("\xad")))


def _cell(value: object) -> str:
    return value if isinstance(value, Html) else text(plain_text(value))


def plain_text(value: object, none: str = NOT_TIMED) -> str:
    match value:
        case None:
            return none
        case bool():
            return "yes" if value else "no"
        case str():
            return value
        case dict() | list() | tuple():
            return json.dumps(value, ensure_ascii=False)
    return str(value)


def html_list(lines: object, empty: str) -> str:
    if not isinstance(lines, (list, tuple)) or not lines:
        return f"<p>{text(empty)}</p>" if empty else ""
    return "<ul>" + "".join(f"<li>{text(line)}</li>" for line in lines) + "</ul>"
