"""How much a driver with real-time priority may take of its processor.

Under SCHED_FIFO nobody else runs while it does. The kernel holds up a real-time process that leaves less than 5 % of a
second (``sched_rt_runtime_us`` 950000 of 1000000): measured 51 to 53 ms in every second of a loop that never waits,
which loses slaves; with the rest taken here, none. So what is merely waiting for something is bounded, and who never
waits is made to rest a little and often.
"""

from __future__ import annotations

import os
from typing import Final

from dpstack.units import NS_PER_MS, NS_PER_US

#: The longest spin without anything done in between.
SPIN_AT_ONCE_NS: Final = 100 * NS_PER_US
#: Spinning may take 27 % for good and 30 ms more at once: in any second no more than 30 %.
_NS_PER_SPUN_NS: Final = 100 / 27
_CREDIT_NS: Final = int(30 * NS_PER_MS * _NS_PER_SPUN_NS)
#: At least 8 % of the time is rest: what sleeps for 1 ns may be awake for this much.
_NS_PER_SLEPT_NS: Final = 12.5
#: A sleep this short was none: the call itself takes as long.
_NO_SLEEP_NS: Final = 5 * NS_PER_US
#: Rest that is owed is taken when it is this much: a shorter one would be as late as it is long.
_NAP_NS: Final = 200 * NS_PER_US


class Budget:
    """Two accounts: of spinning, and of rest. All times in ns of one clock, never running backwards.

    ``rests``: whether rest is owed; None: under a real-time scheduler, as found out by :meth:`begin`.
    """

    __slots__ = ("_paid_until", "_spun_until", "_streak", "_wanted_rests", "rests")

    def __init__(self, *, rests: bool | None = None) -> None:
        self._wanted_rests = rests
        self.rests = bool(rests)
        self._spun_until = 0  # when what was spun is paid off
        self._streak = 0  # spun since something was done
        self._paid_until = 0  # up to when enough was slept

    def begin(self, now: int) -> None:
        """The loop begins to run."""
        self.rests = is_real_time() if self._wanted_rests is None else self._wanted_rests
        self._paid_until = now

    def may_spin(self, now: int) -> bool:
        """Whether there is anything left to spin with."""
        return self._spun_until - now < _CREDIT_NS

    def left_ns(self) -> int:
        """How long a spin may be that begins now; 0: sleep first."""
        return max(0, SPIN_AT_ONCE_NS - self._streak)

    def spun(self, ns: int, now: int, *, in_vain: bool = False) -> None:
        """So long was spun up to ``now``; ``in_vain``: nothing was ready or due after it."""
        self._streak = self._streak + ns if in_vain else 0
        self._spun_until = max(self._spun_until, now) + int(ns * _NS_PER_SPUN_NS)

    def slept(self, ns: int, now: int) -> None:
        """So long was slept up to ``now``."""
        if ns > _NO_SLEEP_NS:
            self._streak = 0
            self._paid_until = min(now, self._paid_until + int(ns * _NS_PER_SLEPT_NS))

    def owed_ns(self, now: int) -> int:
        """How long it must sleep now, whatever is due; 0: it need not."""
        if not self.rests:
            return 0
        owed = int((now - self._paid_until) / _NS_PER_SLEPT_NS)
        return owed if owed >= _NAP_NS else 0


def is_real_time() -> bool:
    """Whether this process has a real-time scheduler."""
    if not hasattr(os, "sched_getscheduler"):
        return False
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)
