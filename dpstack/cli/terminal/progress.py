"""How far something is that takes its time: a bar on a terminal, nothing elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress

from dpstack.text import printable

#: what is being done, how much of it is, of how much
Shown = Callable[[str, int, int], None]


@contextmanager
def progress_bar(title: str) -> Iterator[Shown]:
    """On stderr, gone at the end; any thread may tell it."""
    shown = Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty())
    task = shown.add_task(_label(title), total=None)

    def tell(what: str, done: int, of: int) -> None:
        shown.update(task, description=_label(what), total=of, completed=done)

    with shown:
        yield tell


def _label(text: str) -> str:
    """Rich reads it as markup."""
    return escape(printable(text))
