"""Standard output and standard error as they really are: closed from the start, lost in the middle, full.

Where standard output takes nothing any more (its reader has gone, the disk is full) the program is not to go on for
nobody, but a bus has to be left in order: the loss is kept in :data:`lost`, its ``told`` is called, and the rest is
thrown away.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final


@dataclass(slots=True)
class Lost:
    """Why nothing can be written any more, and who wants to know at once."""

    error: OSError | None = None
    told: Callable[[], None] | None = None


lost: Final = Lost()


@contextlib.contextmanager
def guarded() -> Iterator[None]:
    """What writes to standard output: from the first failure on it writes to nowhere."""
    try:
        yield
    except OSError as error:
        nowhere(sys.stdout.fileno())
        lose(error)


def nowhere(fd: int) -> None:
    """From now on what is written to ``fd`` is thrown away."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, fd)
    os.close(null)


def lose(error: OSError) -> None:
    """Nothing can be written to standard output any more."""
    lost.error = error
    if not isinstance(error, BrokenPipeError):  # a reader that has seen enough is no news
        warn(f"standard output cannot be written ({error.strerror}): give it another place")
    if lost.told is not None:
        lost.told()


def warn(text: str) -> None:
    """One line on standard error, after what was said before."""
    with guarded():
        sys.stdout.flush()
    with contextlib.suppress(OSError):
        print(f"dpstack: {' '.join(text.split())}", file=sys.stderr, flush=True)


def fill() -> None:
    """Streams that were closed when the program was started lead to nowhere, and no port gets their numbers."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))
