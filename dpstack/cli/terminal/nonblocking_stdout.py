"""Standard streams that never hold the program up: what is written waits for a thread that may block.

A bus must not depend on who reads its output: a pipe nobody empties, a terminal stopped with Ctrl-S. What waits is
bounded; what finds no room is dropped, counted, and told as soon as there is room.
"""

from __future__ import annotations

import io
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING, Final, TextIO

from dpstack.cli.terminal import lost_stdout

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

#: octets that wait for a reader, besides those the system keeps (64 KiB in a pipe)
LIMIT: Final = 1 << 18
#: at the end: so long without a reader taking anything is no reader, in s
PATIENCE_S: Final = 2.0


class Queue:
    """What is to be written to one file, by descriptor, and the thread that does it.

    ``notice`` makes the line that tells of so many dropped lines. ``on_lost`` is called, in the thread, when nothing
    can be written any more.
    """

    def __init__(self, notice: Callable[[int], str], on_lost: Callable[[OSError], None]) -> None:
        self._notice = notice
        self._on_lost = on_lost
        self._items: deque[tuple[int, bytes]] = deque()
        self._waiting = 0  # octets queued or being written
        self._untold = 0  # lines dropped since this was told
        self._moved = 0.0  # when something was taken last
        self._changed = threading.Condition()
        self._lost = False
        threading.Thread(target=self._run, name="output", daemon=True).start()

    def put(self, fd: int, octets: bytes) -> None:
        """Queue ``octets`` for ``fd``, or drop them."""
        with self._changed:
            if self._lost:
                return
            if self._waiting + len(octets) > LIMIT:
                self._untold += octets.count(b"\n")
                return
            self._tell(fd)
            self._add(fd, octets)

    def drained(self, fd: int) -> bool:
        """Wait until all is written; False when nobody takes it. What was dropped is told on ``fd``."""
        with self._changed:
            self._moved = monotonic()
            self._tell(fd)
            while self._waiting and not self._lost:
                left = self._moved + PATIENCE_S - monotonic()
                if left <= 0:
                    return False
                self._changed.wait(left)
        return True

    def _tell(self, fd: int) -> None:
        untold, self._untold = self._untold, 0
        if untold:
            self._add(fd, (self._notice(untold) + "\n").encode())

    def _add(self, fd: int, octets: bytes) -> None:
        self._items.append((fd, octets))
        self._waiting += len(octets)
        self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._items)
                fd, octets = self._items.popleft()
            try:
                while octets:
                    done = os.write(fd, octets)
                    octets = octets[done:]
                    with self._changed:
                        self._waiting -= done
                        self._moved = monotonic()
                        self._changed.notify_all()
            except OSError as error:
                with self._changed:
                    self._lost = True
                    self._changed.notify_all()
                self._on_lost(error)
                return


class _Raw(io.RawIOBase):
    """The queue as the lowest layer of a text stream; all else is the descriptor's."""

    def __init__(self, queue: Queue, fd: int) -> None:
        self._queue = queue
        self._fd = fd

    def write(self, octets: ReadableBuffer) -> int:
        taken = bytes(octets)  # the buffer is the caller's
        self._queue.put(self._fd, taken)
        return len(taken)

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return os.isatty(self._fd)

    def fileno(self) -> int:
        return self._fd


@contextmanager
def unhurried(notice: Callable[[int], str]) -> Iterator[None]:
    """Within, nothing that is written to standard output or standard error waits for a reader.

    At the end it is waited for, for as long as somebody reads; else the rest is thrown away, and standard output
    counts as lost (see :mod:`dpstack.cli.terminal.lost_stdout`). What goes to one and the same file keeps its order.
    """
    old = sys.stdout, sys.stderr
    out, err = map(_descriptor, old)
    queues: dict[int, Queue] = {}
    if out is not None:
        queues[out] = Queue(notice, lost_stdout.lose)
        sys.stdout = _text(queues[out], out, old[0])
    if err is not None:
        same = out is not None and os.path.sameopenfile(out, err)
        queues[err] = queues[out] if out is not None and same else Queue(_plain, lambda _error: None)
        sys.stderr = _text(queues[err], err, old[1])
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        drained = {queue: queue.drained(fd) for fd, queue in reversed(queues.items())}
        unread = [fd for fd, queue in queues.items() if not drained[queue]]
        sys.stdout, sys.stderr = old
        for fd in unread:  # whatever is still said must not wait either
            lost_stdout.nowhere(fd)
        if out in unread:
            lost_stdout.lose(TimeoutError(0, f"nobody has read it for {PATIENCE_S:g} s"))


def _plain(lines: int) -> str:
    return f"dpstack: {lines} lines are missing here: nobody was reading"


def _descriptor(stream: TextIO) -> int | None:
    """Its descriptor, emptied up to here; None when it is no file (a test's)."""
    try:
        fd = stream.fileno()
        stream.flush()
    except OSError:
        return None
    return fd


def _text(queue: Queue, fd: int, like: TextIO) -> TextIO:
    raw = io.BufferedWriter(_Raw(queue, fd))
    return io.TextIOWrapper(raw, encoding=like.encoding, errors=like.errors, line_buffering=True)
