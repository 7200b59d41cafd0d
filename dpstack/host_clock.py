"""The clock of this computer: its time, and whether a time server keeps it."""

from __future__ import annotations

import ctypes
import time
from typing import Final

#: octets of ``struct timex`` and more; ``modes`` = 0 in its first octets only reads (adjtimex(2))
_TIMEX: Final = 512
#: the clock is not synchronised (adjtimex(2))
_TIME_ERROR: Final = 5


def is_synchronised() -> bool:
    """Whether the kernel takes its clock for synchronised (NTP, PTP, chrony). False if it cannot be asked."""
    try:
        state: int = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX))
    except (OSError, AttributeError):
        return False
    return 0 <= state < _TIME_ERROR


def time_at(now: int) -> int:
    """The time in ns since 1970 at ``now`` of CLOCK_MONOTONIC."""
    return time.time_ns() - time.monotonic_ns() + now
