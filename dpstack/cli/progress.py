"""How far something is that takes its time: a bar on a terminal, nothing elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress

#: what is being done, how much of it is, of how much
Shown = Callable[[str, int, int], None]


@contextmanager
def progress_bar(title: str) -> Iterator[Shown]:
    """On stderr, gone at the end; any thread may tell it."""
    shown = Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty())
    task = shown.add_task(title, total=None)

    def tell(what: str, done: int, of: int) -> None:
        shown.update(task, description=what, total=of, completed=done)

    with shown:
        yield tell
