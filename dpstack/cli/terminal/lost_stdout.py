"""Standard output and standard error as they really are: closed from the start, lost in the middle, full.

Where standard output takes nothing any more (its reader has gone, the disk is full) the program is not to go on for
nobody, but a bus has to be left in order: the loss is kept in :data:`lost`, its ``told`` is called, and the rest is
thrown away.
"""

from __future__ import annotations

import codecs
import contextlib
import io
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Final

from dpstack.text import escape, printable, traceback_text

#: how a character is written where the encoding of the terminal or the file does not have it
_PLAIN: Final = {
    **dict.fromkeys("\u2010\u2011\u2012\u2013\u2014\u2212", "-"),
    **dict.fromkeys("\u2018\u2019", "'"),
    **dict.fromkeys("\u201c\u201d", '"'),
    "\u2026": "...",
    "\u2588": "#",
    "\xa0": " ",
    "\xb5": "u",
    "\u03bc": "u",
}
_DEGRADE: Final = "dpstack-degrade"


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
        print(f"dpstack: {printable(' '.join(text.split()))}", file=sys.stderr, flush=True)


def print_traceback(error: BaseException) -> None:
    """Where ``error`` comes from, on standard error."""
    with contextlib.suppress(OSError):
        print(traceback_text(error), file=sys.stderr, flush=True)


def fill() -> None:
    """Make the standard streams fit for every text.

    One that was closed when the program was started leads to nowhere, and no port gets its number. What the encoding
    of an output does not have is written in ASCII; what that of the input does not have is read as it is.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))
        elif isinstance(stream, io.TextIOWrapper):
            with contextlib.suppress(OSError):
                stream.reconfigure(errors="surrogateescape" if mode == "r" else _DEGRADE)
    sys.excepthook = _defect


def _defect(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    print_traceback(error.with_traceback(trace))


def _degrade(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    return "".join(_PLAIN.get(letter) or escape(letter) for letter in letters), error.end


codecs.register_error(_DEGRADE, _degrade)
