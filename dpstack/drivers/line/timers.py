"""Deadlines inside an event loop (a timerfd on Linux, the loop's own timer elsewhere); how long the computer slept."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Protocol

from dpstack.ports import timerfd
from dpstack.units import NS_PER_S

if TYPE_CHECKING:  # the bus process runs without asyncio, and starts sooner without it
    import asyncio


if hasattr(time, "CLOCK_BOOTTIME"):
    #: the clock that goes on while the computer sleeps (CLOCK_BOOTTIME), in ns; CLOCK_MONOTONIC where there is no such
    #: clock. Without a function of Python's around it: it is read in each step.
    boottime_ns: Callable[[], int] = partial(time.clock_gettime_ns, time.CLOCK_BOOTTIME)
else:
    boottime_ns = time.monotonic_ns


def suspended_ns() -> int:
    """How long the computer has slept since it was started, in ns: CLOCK_BOOTTIME less CLOCK_MONOTONIC. About 0 on
    systems without CLOCK_BOOTTIME.

    Never too much: a pause between looking at the two clocks only makes it smaller.
    """
    return boottime_ns() - time.monotonic_ns()


class Timer(Protocol):
    """Calls back once when a deadline is reached, never early by more than the clock's grain.

    The deadline is taken off before the call.
    """

    def set(self, at: int) -> None:
        """Wait for ``at`` (CLOCK_MONOTONIC, ns) instead of what was waited for."""

    def close(self) -> None:
        """Call back no more."""


class FdTimer:
    """A timerfd in the loop's selector: about 0.04 ms late."""

    __slots__ = ("_callback", "_loop", "_timer")

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._callback = callback
        self._timer = timerfd.Timerfd()
        loop.add_reader(self._timer.fd, self._fired)

    def set(self, at: int) -> None:
        """Wait for ``at``."""
        self._timer.set(at)

    def close(self) -> None:
        """Give the descriptor back."""
        if self._timer.fd >= 0 and not self._loop.is_closed():
            self._loop.remove_reader(self._timer.fd)
        self._timer.close()

    def _fired(self) -> None:
        self._timer.clear()
        self._callback()


class LoopTimer:
    """The loop's ``call_later``: up to 0.75 ms late on epoll, more on Windows."""

    __slots__ = ("_callback", "_handle", "_loop")

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self._loop = loop
        self._callback = callback
        self._handle: asyncio.TimerHandle | None = None

    def set(self, at: int) -> None:
        """Wait for ``at``."""
        if self._handle is not None:
            self._handle.cancel()
        self._handle = self._loop.call_later(max(0, at - time.monotonic_ns()) / NS_PER_S, self._fired)

    def close(self) -> None:
        """Cancel."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def _fired(self) -> None:
        self._handle = None
        self._callback()


def make_timer(loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> Timer:
    """The most precise timer that this system and this loop can have."""
    if timerfd.AVAILABLE:
        try:
            return FdTimer(loop, callback)
        except (NotImplementedError, OSError):  # a loop without add_reader, no descriptors left
            pass
    return LoopTimer(loop, callback)
