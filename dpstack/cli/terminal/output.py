"""Output of the program: words, tables, JSON lines, warnings; and the standard streams that it goes to.

On a terminal words and tables are drawn by :mod:`dpstack.cli.terminal.drawing`, elsewhere they are plain lines.

When standard output is lost (its reader has gone, the disk is full) a command has to end, but to leave its bus in
order. :data:`lost` keeps the error and calls its ``on_lost``; further output is thrown away.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Final

from dpstack.text import escape, json_text, long_escape, printable, traceback_text

#: replacements of characters that the encoding of a terminal or file does not have
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


class Lost:
    """Why nothing can be written any more; ``on_lost`` is called at that moment."""

    def __init__(self) -> None:
        self.error: OSError | None = None
        self.on_lost: Callable[[], None] | None = None


lost: Final = Lost()


@contextlib.contextmanager
def guarded() -> Iterator[None]:
    """Around a write to standard output: after the first failure all output is thrown away."""
    try:
        yield
    except OSError as error:
        nowhere(sys.stdout.fileno())
        lose(error)


def nowhere(fd: int) -> None:
    """Throw away everything written to ``fd`` from now on."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, fd)
    os.close(null)


def lose(error: OSError) -> None:
    """Record that nothing can be written to standard output any more.

    A lost terminal counts as its SIGHUP: if that is ignored (nohup), the program goes on without output.
    """
    if error.errno == errno.EIO and hangup_is_ignored():
        return
    lost.error = error
    if not isinstance(error, BrokenPipeError):  # a reader may end at any time
        warn(f"standard output cannot be written ({error.strerror}): give it another place")
    if lost.on_lost is not None:
        lost.on_lost()


def hangup_is_ignored() -> bool:
    """Whether the program goes on without its terminal: under nohup, and on systems without SIGHUP."""
    import signal  # here, as only a lost terminal asks for it

    number = getattr(signal, "SIGHUP", None)
    return number is None or signal.getsignal(number) is signal.SIG_IGN


def warn(text: str) -> None:
    """Write one line to standard error, after all earlier output."""
    with guarded():
        sys.stdout.flush()
    with contextlib.suppress(OSError):
        print(f"dpstack: {printable(' '.join(text.split()))}", file=sys.stderr, flush=True)


def print_traceback(error: BaseException) -> None:
    """Write the traceback of ``error`` to standard error."""
    with contextlib.suppress(OSError):
        print(traceback_text(error), file=sys.stderr, flush=True)


def fill() -> None:
    """Make the standard streams usable for every text.

    A stream that was closed at the start of the program becomes /dev/null, so that no port gets its number. Characters
    that the encoding of an output does not have are written in ASCII; undecodable input is kept (surrogateescape).
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


# --- words, tables, JSON ----------------------------------------------------------------------------------------------


def on_terminal() -> bool:
    """Whether standard output is a terminal."""
    return sys.stdout.isatty()


def redraws() -> bool:
    """Whether standard output is a terminal on which a picture can be drawn again (not TERM=dumb)."""
    return on_terminal() and os.environ.get("TERM", "dumb").lower() not in ("dumb", "unknown", "")


def ready_line(text: str, *, flush: bool) -> None:
    """Write a line whose characters are printable and in the encoding of standard output. Without ``flush`` it may wait
    until more lines come, or until :func:`flush`."""
    try:
        sys.stdout.write(text + "\n")
        if flush:
            sys.stdout.flush()
    except OSError as error:
        nowhere(sys.stdout.fileno())
        lose(error)


def flush() -> None:
    """Write what waits."""
    with guarded():
        sys.stdout.flush()


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


def raw(text: str) -> None:
    """Write ``text`` of our own as it is, for a program that reads it."""
    _write(text.removesuffix("\n"))


def line(text: str, style: str = "", hang: int = 0) -> None:
    """Write one line; on a terminal in ``style``, wrapped between words only, further lines behind ``hang`` spaces."""
    if on_terminal():
        from dpstack.cli.terminal import drawing

        with guarded():
            drawing.line(text, style, hang)
    else:
        _write(printable(text))


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
