"""Clock that goes on while the computer sleeps, and the time that it has slept."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from dpstack.units import NS_PER_S

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
