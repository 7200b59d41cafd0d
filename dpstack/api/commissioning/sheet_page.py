"""The HTML file of commissioning sheets, to print: each sheet begins on a page of its own. No network, no script."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from itertools import groupby
from typing import Final

from dpstack.api.commissioning.sheet import Block, Sheet, blocks_of, title_of
from dpstack.monitor.markup import Html, html_inputs, html_list, html_page, html_section, html_table, join_lines, text
from dpstack.text import printable

#: the block with a box for each row, to tick off
_TO_DO: Final = "To set at the device"
_BOX: Final = Html('<span class="tick" aria-hidden="true"></span>')


def sheets_page(sheets: Sequence[Sheet], plant: str, version: str, made: datetime) -> str:
    """The page of ``sheets``; ``plant``: name of the configuration."""
    header = f"<h1>Commissioning sheets</h1><p>{text(plant)}: {len(sheets)} of its slaves</p>"
    if len(sheets) > 1:
        links = "".join(f'<li><a href="#s{one.address}">{text(title_of(one))}</a></li>' for one in sheets)
        header += f'<nav aria-label="Sheets"><ul>{links}</ul></nav>'
    what = f"dpstack {version}, made {made:%Y-%m-%d %H:%M} of {printable(plant)}"
    title = f"Commissioning sheets, {plant}" if len(sheets) > 1 else f"Commissioning sheet, {title_of(sheets[0])}"
    return html_page(title, header, join_lines(_sheet(one) for one in sheets), what, version)


def _sheet(sheet: Sheet) -> str:
    prefix = f"s{sheet.address}-"
    done = html_section(
        "Done",
        f'<div class="fields signed">{html_inputs(("Set by", "Date, signature"), prefix)}</div>',
        "whole",
        prefix=prefix,
        level=3,
    )
    parts = []
    for narrow, some in groupby(blocks_of(sheet), _is_narrow):
        html = join_lines(_block(one, prefix) for one in some)
        parts.append(f'<div class="grid">{html}</div>' if narrow else html)
    blocks = join_lines(parts)
    head = f'<h2 class="sheet-title" id="s{sheet.address}">{text(title_of(sheet))}</h2>'
    return f'<article class="sheet" aria-labelledby="s{sheet.address}">\n{head}\n{blocks}\n{done}</article>\n'


def _is_narrow(block: Block) -> bool:
    """Whether the block has a table of two columns, beside which another one has room."""
    return len(block.columns) == 2 and any(block.columns)


def _block(block: Block, prefix: str) -> str:
    body = ""
    if len(block.lines) == 1:
        body = f"<p>{text(block.lines[0])}</p>"
    elif block.lines:
        body = html_list(block.lines, "")
    if block.rows and not any(block.columns):
        rows = "".join(f'<tr><th scope="row">{text(a)}</th><td>{text(b)}</td></tr>\n' for a, b in block.rows)
        body += f'<table class="pairs"><tbody>\n{rows}</tbody></table>'
    elif block.rows and block.title == _TO_DO:
        columns = (*block.columns, "done")
        body += html_table("", columns, [(*row, _BOX) for row in block.rows], numbers=())
    elif block.rows:
        body += html_table("", block.columns, block.rows, numbers=())
    return html_section(block.title, body, prefix=prefix, level=3)
