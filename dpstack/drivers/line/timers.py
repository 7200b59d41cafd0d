"""Timers for deadlines in an event loop (timerfd on Linux, else the loop's own); how early they are set."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from dpstack.ports import timerfd
from dpstack.units import NS_PER_S

if TYPE_CHECKING:  # the bus process runs without asyncio, and starts sooner without it
    import asyncio


class Lead:
    """Time by which a sleep is set to end before its deadline, learned from how late wake-ups are. In ns.

    ``raised``, ``lowered``: steps after a wake-up that was later than the lead, and after another one. So the share
    ``lowered / (raised + lowered)`` of all wake-ups is later than the lead. ``least``, ``most``: its limits.
    """

    __slots__ = ("_least", "_lowered", "_most", "_raised", "ns")

    def __init__(self, first: int, *, least: int, most: int, raised: int, lowered: int) -> None:
        self.ns = first
        self._least, self._most = least, most
        self._raised, self._lowered = raised, lowered

    def learn(self, late: int) -> None:
        """A wake-up was ``late`` ns after the end that was set for it."""
        ns = self.ns
        if late > ns:
            ns += self._raised
            self.ns = ns if ns < self._most else self._most
        elif ns > self._least:
            ns -= self._lowered
            self.ns = ns if ns > self._least else self._least


class Timer(Protocol):
    """Calls back once when its deadline is reached, early at most by the clock's grain. The call may use ``set``."""

    def set(self, at: int) -> None:
        """Replace the deadline by ``at`` (CLOCK_MONOTONIC, ns)."""

    def nap(self, until: int) -> None:
        """Let the thread sleep until ``until`` (CLOCK_MONOTONIC, ns); returns at once if no precise sleep is to be
        had. The loop does nothing meanwhile."""

    def close(self) -> None: ...


class FdTimer:
    """A timerfd in the loop's selector: about 0.04 ms late."""

    __slots__ = ("_callback", "_loop", "_naps", "_timer", "set")

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._callback = callback
        self._timer = self._naps = timerfd.Timerfd()
        self.set = self._timer.set  # without a call in between: it is set for each telegram
        try:
            self._naps = timerfd.Timerfd(blocking=True)
            loop.add_reader(self._timer.fd, self._fired)
        except BaseException:  # no descriptors left, a loop without add_reader
            self._timer.close()
            self._naps.close()
            raise

    def nap(self, until: int) -> None:
        self._naps.sleep(until)

    def close(self) -> None:
        if self._timer.fd >= 0 and not self._loop.is_closed():
            self._loop.remove_reader(self._timer.fd)
        self._timer.close()
        self._naps.close()

    def _fired(self) -> None:
        timer = self._timer
        count = timer.times_set
        self._callback()
        if timer.times_set == count and timer.fd >= 0:  # a new deadline, which most calls set, has reset it already
            timer.clear()


class LoopTimer:
    """The loop's ``call_later``: up to 0.75 ms late on epoll, more on Windows."""

    __slots__ = ("_callback", "_handle", "_loop")

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._callback = callback
        self._handle: asyncio.TimerHandle | None = None

    def set(self, at: int) -> None:
        if self._handle is not None:
            self._handle.cancel()
        self._handle = self._loop.call_later(max(0, at - time.monotonic_ns()) / NS_PER_S, self._fired)

    def nap(self, until: int) -> None:
        """Never: a sleep would be as late as the timer."""

    def close(self) -> None:
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def _fired(self) -> None:
        self._handle = None
        self._callback()


def make_timer(loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> Timer:
    """The most precise timer that this system and this loop offer."""
    if timerfd.AVAILABLE:
        try:
            return FdTimer(loop, callback)
        except (NotImplementedError, OSError):  # a loop without add_reader, no descriptors left
            pass
    return LoopTimer(loop, callback)
