"""A thread that encodes and writes what the event loop puts into its queue.

The event loop only appends to a queue of bounded length. The thread looks into it five times a second. It works in
short pieces and lets go of the interpreter between them, so that the bus never waits for it longer than for one piece.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Final, Generic, Protocol, TypeVar

Item = TypeVar("Item", contravariant=True)
T = TypeVar("T")

#: seconds between two looks into the queue
PERIOD_S: Final = 0.2
#: a piece of work, and the pause after it
_PIECE_S: Final = 0.0005
_PAUSE_S: Final = 0.0002


class Sink(Protocol[Item]):
    """The work of the thread. Nothing of it may raise OSError for long: a full disk is the sink's own affair."""

    def take(self, item: Item) -> None:
        """Encode ``item``."""

    def flush(self) -> None:
        """Write what was encoded."""

    def close(self, lost: int) -> None:
        """Write the end, and close the files. ``lost``: items that did not fit into the queue."""


class WriterThread(Generic[T]):
    """Hands the items of :meth:`put` to ``sink`` in a thread. At most ``most`` of them wait; ``lost`` counts others."""

    def __init__(self, name: str, sink: Sink[T], most: int) -> None:
        self.lost = 0
        #: an exception of the sink, which ended the thread
        self.failure: Exception | None = None
        self._sink = sink
        self._most = most
        self._queue: deque[T] = deque()
        self._end = threading.Event()
        self._rounds = 0
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, item: T) -> bool:
        """Take one item, from the event loop. False if the queue is full: it is lost."""
        if len(self._queue) >= self._most:
            self.lost += 1
            return False
        self._queue.append(item)
        return True

    def finish(self) -> None:
        """Have the thread write the rest and end."""
        self._end.set()

    def ended(self, wait_s: float) -> bool:
        """Whether the thread has ended within ``wait_s``."""
        self._thread.join(wait_s)
        return not self._thread.is_alive()

    @property
    def steps(self) -> int:
        """Counts what the thread does: it stands still while a disk does not answer."""
        return self._rounds

    def _run(self) -> None:
        try:
            while not self._end.wait(PERIOD_S):
                self._work()
            self._work()
            self._sink.close(self.lost)
        except Exception as error:
            self.failure = error

    def _work(self) -> None:
        began = time.perf_counter()
        for _ in range(len(self._queue)):
            self._sink.take(self._queue.popleft())
            if time.perf_counter() - began > _PIECE_S:
                time.sleep(_PAUSE_S)
                began = time.perf_counter()
                self._rounds += 1
        self._sink.flush()
        self._rounds += 1
