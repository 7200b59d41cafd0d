"""Limit of the processor time that a driver with real-time priority takes.

A SCHED_FIFO process keeps all others off its processor. The kernel stops one that leaves less than 5 % of a second free
(``sched_rt_runtime_us`` 950000 of 1000000): measured 51 to 53 ms in every second of a loop that never waits, and slaves
were lost. So the driver limits its spinning, and a loop that never waits sleeps briefly and often; then the kernel
never stops it.
"""

from __future__ import annotations

import os
from typing import Final

from dpstack.units import NEVER, NS_PER_MS, NS_PER_US

#: The longest spin without work in between.
SPIN_AT_ONCE_NS: Final = 100 * NS_PER_US
#: Spinning may take 27 % of the time, and 30 ms more at once: at most 30 % of any second.
_NS_PER_SPUN_NS: Final = 100 / 27
_CREDIT_NS: Final = int(30 * NS_PER_MS * _NS_PER_SPUN_NS)
#: Sleep is at least 8 % of the time: two ns of sleep allow this many ns awake.
_NS_PER_2_SLEPT_NS: Final = 25
#: A shorter sleep does not count: the call itself takes as long.
_NO_SLEEP_NS: Final = 5 * NS_PER_US
#: The shortest sleep that is forced: a shorter one would end as late as it is long.
_NAP_NS: Final = 200 * NS_PER_US
_NAP_ALLOWS_NS: Final = _NAP_NS * _NS_PER_2_SLEPT_NS // 2


class Budget:
    """Limits spinning, and forces sleep. All times in ns of one monotonic clock.

    ``rests``: whether sleep is forced; None: under a real-time scheduler, which :meth:`begin` finds out.
    """

    __slots__ = ("_spun_until", "_streak", "_wanted_rests", "rest_at")

    def __init__(self, *, rests: bool | None = None) -> None:
        self._wanted_rests = rests
        #: from this time on a sleep is forced (:meth:`forced_sleep_ns`)
        self.rest_at = _NAP_ALLOWS_NS if rests else NEVER
        self._spun_until = 0  # when the time spun so far is within 27 %
        self._streak = 0  # spun since the last work

    def begin(self, now: int) -> None:
        rests = is_real_time() if self._wanted_rests is None else self._wanted_rests
        self.rest_at = now + _NAP_ALLOWS_NS if rests else NEVER

    def may_spin(self, now: int) -> bool:
        return self._spun_until - now < _CREDIT_NS

    def left_ns(self) -> int:
        """Longest spin that may begin now; 0: sleep first."""
        return max(0, SPIN_AT_ONCE_NS - self._streak)

    def spun(self, ns: int, now: int, *, in_vain: bool = False) -> None:
        """The loop spun for ``ns`` up to ``now``; ``in_vain``: nothing was ready or due after it."""
        self._streak = self._streak + ns if in_vain else 0
        self._spun_until = max(self._spun_until, now) + int(ns * _NS_PER_SPUN_NS)

    def slept(self, ns: int, now: int) -> None:
        """The loop slept for ``ns`` up to ``now``."""
        if ns > _NO_SLEEP_NS:
            self._streak = 0
            if self.rest_at != NEVER:
                rest_at, latest = self.rest_at + (ns * _NS_PER_2_SLEPT_NS >> 1), now + _NAP_ALLOWS_NS
                self.rest_at = rest_at if rest_at < latest else latest

    def forced_sleep_ns(self, now: int) -> int:
        """Sleep in ns that the loop has to take now, even if a deadline is due; 0 before :attr:`rest_at`."""
        return _NAP_NS + 2 * (now - self.rest_at) // _NS_PER_2_SLEPT_NS if now >= self.rest_at else 0


def is_real_time() -> bool:
    """Whether this process has a real-time scheduler."""
    if not hasattr(os, "sched_getscheduler"):
        return False
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)
