"""Clocks of this computer: the one that goes on while it sleeps, and whether a time server keeps the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Final

from dpstack.units import NS_PER_S

#: octets of ``struct timex`` and more; ``modes`` = 0 in its first octets only reads (adjtimex(2))
_TIMEX: Final = 512
#: the clock is not synchronised (adjtimex(2))
_TIME_ERROR: Final = 5

if hasattr(time, "CLOCK_BOOTTIME"):
    #: CLOCK_BOOTTIME in ns, which goes on while the computer sleeps; CLOCK_MONOTONIC if none exists. Called in
    #: each step of a line, so without a Python function around it.
    boottime_ns: Callable[[], int] = partial(time.clock_gettime_ns, time.CLOCK_BOOTTIME)
else:
    boottime_ns = time.monotonic_ns


def boottime_s() -> float:
    return boottime_ns() / NS_PER_S


def suspended_ns() -> int:
    """Sleep of the computer since its start in ns: CLOCK_BOOTTIME less CLOCK_MONOTONIC; 0 without CLOCK_BOOTTIME.

    Never too large: a pause between reading the two clocks only makes it smaller.
    """
    return boottime_ns() - time.monotonic_ns()


def time_at(now: int) -> int:
    """The time in ns since 1970 at ``now`` of CLOCK_MONOTONIC."""
    return time.time_ns() - time.monotonic_ns() + now


def is_synchronised() -> bool:
    """Whether the kernel takes its clock for synchronised (NTP, PTP, chrony). False if it cannot be asked."""
    import ctypes  # here, as few buses send the time

    try:
        state: int = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX))
    except (OSError, AttributeError):
        return False
    return 0 <= state < _TIME_ERROR
