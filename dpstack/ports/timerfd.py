"""A Linux timerfd: a deadline on CLOCK_MONOTONIC in nanoseconds that an event loop waits for like for a port.

``os.timerfd_*`` came with Python 3.13; before, ctypes calls the C library without giving the interpreter up (the calls
never wait, and with a busy application thread getting it back would take milliseconds). Measured: a loop's ``call_at``
on epoll is 0.75 ms late, a timerfd 0.04 ms; PR_SET_TIMERSLACK changes nothing for it, so the process's is left alone.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Callable
from functools import partial
from typing import Final

from dpstack.units import NS_PER_S

AVAILABLE: Final = sys.platform == "linux"

_CLOCK_MONOTONIC: Final = 1
_TFD_NONBLOCK: Final = 0o4000
_TFD_CLOEXEC: Final = 0o2000000
_TFD_TIMER_ABSTIME: Final = 1


def _set_nothing() -> None:
    """Of a closed timer."""


class Timerfd:
    """One deadline; ``fd`` becomes readable when it is reached. ``times_set``: how often a deadline was set.

    ``blocking``: for :meth:`sleep`."""

    __slots__ = ("_lib", "_settime", "_spec", "fd", "times_set")

    def __init__(self, *, blocking: bool = False) -> None:
        self._lib = ctypes.PyDLL(None, use_errno=True)
        self.times_set = 0
        self._spec = (ctypes.c_long * 4)()  # struct itimerspec: interval s, ns; value s, ns
        if sys.version_info >= (3, 13):
            flags = os.TFD_CLOEXEC if blocking else os.TFD_CLOEXEC | os.TFD_NONBLOCK
            self.fd = os.timerfd_create(_CLOCK_MONOTONIC, flags=flags)
        else:
            flags = _TFD_CLOEXEC if blocking else _TFD_CLOEXEC | _TFD_NONBLOCK
            self.fd = int(self._lib.timerfd_create(_CLOCK_MONOTONIC, flags))
            if self.fd < 0:
                raise OSError(ctypes.get_errno(), "timerfd_create: " + os.strerror(ctypes.get_errno()))
        #: sets what stands in ``_spec``; bound once, as it is called for each telegram
        self._settime: Callable[[], object] = partial(
            self._lib.timerfd_settime, self.fd, _TFD_TIMER_ABSTIME, ctypes.byref(self._spec), None
        )

    def set(self, at: int) -> None:
        """Wait for ``at`` (CLOCK_MONOTONIC, ns; one in the past is reached at once)."""
        if at <= 0:
            at = 1  # 0 would disarm it
        self.times_set += 1
        if sys.version_info >= (3, 13):
            os.timerfd_settime_ns(self.fd, flags=os.TFD_TIMER_ABSTIME, initial=at)
        else:
            self._spec[2], self._spec[3] = divmod(at, NS_PER_S)
            self._settime()

    def sleep(self, until: int) -> None:
        """Let this thread sleep until ``until`` (CLOCK_MONOTONIC, ns), some 0.02 ms longer: ``time.sleep`` takes the
        thread's timer slack of 0.05 ms on top. Only for a blocking one."""
        self.set(until)
        os.read(self.fd, 8)

    def clear(self) -> None:
        """Reset ``fd`` after the deadline; call it when ``fd`` is readable."""
        with contextlib.suppress(BlockingIOError):
            os.read(self.fd, 8)

    def close(self) -> None:
        fd, self.fd = self.fd, -1
        self._settime = _set_nothing  # the number may soon be another file's
        if fd >= 0:
            os.close(fd)
