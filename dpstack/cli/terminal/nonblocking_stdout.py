"""Standard streams that never block the program: a thread writes the queued output.

A bus must not depend on the reader of its output: a pipe that nobody empties, a terminal stopped with Ctrl-S. The queue
is bounded; output beyond it is dropped and counted, and a notice with the count follows as soon as there is room.
"""

from __future__ import annotations

import asyncio
import errno
import io
import os
import select
import stat
import sys
import threading
from collections import deque
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING, Final, TextIO

from dpstack.cli.terminal import output
from dpstack.text import json_text

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

#: octets in the queue at most, besides those that the system keeps (64 KiB in a pipe)
LIMIT: Final = 1 << 18
#: at the end: time-out in s for a reader that reads nothing
PATIENCE_S: Final = 2.0


class Queue:
    """Queued output for one file, by descriptor, and the thread that writes it.

    ``notice`` returns the line for a number of dropped lines. ``on_lost`` is called, in the thread, when nothing can be
    written any more.
    """

    def __init__(self, notice: Callable[[int], str], on_lost: Callable[[OSError], None]) -> None:
        self._notice = notice
        self._on_lost = on_lost
        self._items: deque[tuple[int, bytes]] = deque()
        self._waiting = 0  # octets queued or being written
        self._dropped = 0  # lines since the last notice
        self._moved = 0.0  # time of the last successful write
        self._changed = threading.Condition()
        self._lost = False
        threading.Thread(target=self._run, name="output", daemon=True).start()

    def put(self, fd: int, octets: bytes) -> None:
        """Queue ``octets`` for ``fd``, or drop them."""
        with self._changed:
            if self._lost:
                return
            if self._waiting + len(octets) > LIMIT:
                self._dropped += octets.count(b"\n")
                return
            self._add_notice(fd)
            self._add(fd, octets)

    def drained(self, fd: int) -> bool:
        """Wait until all is written; False when nobody reads it. The notice on dropped lines goes to ``fd``."""
        with self._changed:
            self._moved = monotonic()
            self._add_notice(fd)
            while self._waiting and not self._lost:
                left = self._moved + PATIENCE_S - monotonic()
                if left <= 0:
                    return False
                self._changed.wait(left)
        return True

    def _add_notice(self, fd: int) -> None:
        dropped, self._dropped = self._dropped, 0
        if dropped:
            self._add(fd, (self._notice(dropped) + "\n").encode())

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
    """The queue as the lowest layer of a text stream."""

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


def run_unhurried(work: Coroutine[object, object, int], *, json: bool) -> int:
    """Run ``work``; no output of it waits for a reader."""
    with _unhurried(json=json):
        return asyncio.run(work)


@contextmanager
def reader_watched() -> Iterator[None]:
    """Within, standard output counts as lost as soon as the reader of its pipe has gone, not at the next write.

    Needs a running loop. No effect if standard output is no pipe, or the system is not Linux.
    """
    fd, loop = _descriptor(sys.stdout), asyncio.get_running_loop()
    if sys.platform != "linux" or fd is None or not stat.S_ISFIFO(os.fstat(fd).st_mode):
        yield
        return

    def look() -> None:
        loop.remove_reader(fd)
        line = select.poll()
        line.register(fd, 0)
        if line.poll(0):
            output.lose(BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE)))

    loop.add_reader(fd, look)  # a pipe without readers is "readable" for its writer
    try:
        yield
    finally:
        loop.remove_reader(fd)


@contextmanager
def _unhurried(*, json: bool) -> Iterator[None]:
    """Within, no write to standard output or standard error waits for a reader.

    At the end it waits as long as somebody reads; else the rest is thrown away, and standard output counts as lost (see
    :mod:`dpstack.cli.terminal.output`). Output to one and the same file keeps its order.
    """
    old = sys.stdout, sys.stderr
    out, err = map(_descriptor, old)
    queues: dict[int, Queue] = {}
    if out is not None:
        queues[out] = Queue(_missing_json if json else _missing, output.lose)
        sys.stdout = _text(queues[out], out, old[0])
    if err is not None:
        same = out is not None and os.path.sameopenfile(out, err)
        queues[err] = (
            queues[out]
            if out is not None and same
            else Queue(lambda lines: f"dpstack: {_missing(lines)}", lambda _error: None)
        )
        sys.stderr = _text(queues[err], err, old[1])
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        drained = {queue: queue.drained(fd) for fd, queue in reversed(queues.items())}
        unread = [fd for fd, queue in queues.items() if not drained[queue]]
        sys.stdout, sys.stderr = old
        for fd in unread:  # later output must not wait either
            output.nowhere(fd)
        if out in unread:
            output.lose(TimeoutError(0, f"nobody has read it for {PATIENCE_S:g} s"))


def _missing(lines: int) -> str:
    return f"{lines} lines are missing here: nobody was reading"


def _missing_json(lines: int) -> str:
    return json_text({"event": "notice", "text": _missing(lines), "missing": lines})


def _descriptor(stream: TextIO) -> int | None:
    """The descriptor of ``stream``, flushed; None when it is no file (in tests)."""
    try:
        fd = stream.fileno()
        stream.flush()
    except OSError:
        return None
    return fd


def _text(queue: Queue, fd: int, like: TextIO) -> TextIO:
    raw = io.BufferedWriter(_Raw(queue, fd))
    return io.TextIOWrapper(raw, encoding=like.encoding, errors=like.errors, line_buffering=True)
