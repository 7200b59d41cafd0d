"""Lines, tables and bars of progress as rich draws them on a terminal."""

from __future__ import annotations

import math
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from rich.cells import cell_len
from rich.console import Console, Group
from rich.markup import escape
from rich.progress import Progress
from rich.table import Column, Table
from rich.text import Text

from dpstack.text import printable

#: words up to this length stay whole in every table: all numbers, names of states; longer ones (octets in hex, paths)
#: may be folded, and no text is wrapped to less than this
_WHOLE: Final = 24
#: interval of the pictures of a screen in s
_REFRESH_S: Final = 0.5


def line(text: str, style: str, hang: int = 0) -> None:
    """One line, wrapped between words only; further lines begin with ``hang`` spaces."""
    console = Console(soft_wrap=True)
    # the terminal wraps a longer word: copied from there it is still one word
    parts = textwrap.wrap(
        printable(text),
        console.width,
        subsequent_indent=" " * min(hang, console.width // 2),
        break_long_words=False,
        break_on_hyphens=False,
    )
    console.print(Text("\n".join(parts), style=style))


def shown(text: str, style: str = "") -> Text:
    """``text`` as rich draws it: nothing in it is an escape sequence, markup or the name of an emoji."""
    return Text(printable(text), style=style)


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A table as wide as the terminal at most."""
    Console().print(rich_table(title, columns, rows))


def rich_table(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[object]],
    width: int | None = None,
    styles: Sequence[str] = (),
) -> Group:
    """A table as rich draws it, at most ``width`` characters wide (None: the terminal's); ``styles``: of the rows.

    If it is too narrow, cells are wrapped between words; if that is not enough, the columns of each row stand in
    two or more lines, as in the heading. No word of up to 24 characters is cut, and so no number is.
    """
    cells = [[shown(str(cell)) for cell in row] for row in rows]
    names = [shown(column) for column in columns]
    room = Console().width if width is None else width
    widths = _widths([names, *cells], room)
    table = Table(*(Column(width=one, overflow="fold") for one in widths), show_header=False)
    for row, style in zip([names, *cells], ["bold", *styles, *[""] * (len(cells) - len(styles))], strict=True):
        for line in _lines(row, len(widths)):
            table.add_row(*line, style=style or None)
        if row is names or len(columns) > len(widths):
            table.add_section()
    return Group(*([shown(title, "bold")] if title else []), table)


def _lines(row: Sequence[Text], count: int) -> Iterator[Sequence[Text]]:
    """The lines of one row with so many columns beside each other."""
    for at in range(0, len(row), count):
        yield row[at : at + count]


def _widths(rows: Sequence[Sequence[Text]], room: int) -> list[int]:
    """Of the columns that stand beside each other: all of them if ``room`` characters are enough."""
    columns = len(rows[0])
    natural = [max(row[at].cell_len for row in rows) for at in range(columns)]
    least = [max(_least(row[at].plain, heading=row is rows[0]) for row in rows) for at in range(columns)]
    for lines in range(1, columns + 1):
        count = math.ceil(columns / lines)
        free = room - 3 * count - 1  # a border and a space on either side of each column, one more border
        wanted = [max(natural[at::count]) for at in range(count)]
        needed = [max(least[at::count]) for at in range(count)]
        if sum(needed) <= free:
            while sum(wanted) > free:
                at = max((at for at in range(count) if wanted[at] > needed[at]), key=wanted.__getitem__)
                wanted[at] -= 1
            return wanted
    return [max(1, room - 4)]


def _least(text: str, *, heading: bool) -> int:
    words = text.split() if heading or len(text.split()) == 2 else [text]  # 200 ms, in/out octets
    return max((min(cell_len(word), _WHOLE) for word in words), default=0)


async def redrawn(picture: Callable[[], Group]) -> None:
    """Draw a picture on a screen of its own again and again, until cancelled; then the terminal has its text again."""
    import asyncio  # these here, as most drawings stand still

    from rich.live import Live

    with Live(picture(), auto_refresh=False, screen=True) as live:
        while True:
            await asyncio.sleep(_REFRESH_S)
            live.update(picture(), refresh=True)


#: called with the step, the number done, the number of all
Shown = Callable[[str, int, int], None]


@contextmanager
def progress_bar(title: str) -> Iterator[Shown]:
    """A progress bar on stderr, removed at the end; nothing if that is no terminal. Any thread may call it."""
    if not sys.stderr.isatty():  # a disabled Progress of older versions of rich writes an empty line at its end
        yield lambda what, done, of: None
        return
    shown = Progress(console=Console(stderr=True), transient=True)
    task = shown.add_task(_label(title), total=None)

    def tell(what: str, done: int, of: int) -> None:
        shown.update(task, description=_label(what), total=of, completed=done)

    with shown:
        yield tell


def _label(text: str) -> str:
    return escape(printable(text))
