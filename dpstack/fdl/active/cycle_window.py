"""The time window between two fixed cycles: which acyclic requests the station may still start before the next cycle.

The DP master sets the time of the next cycle (:attr:`CycleWindow.next_at`). The station starts a request that is no
part of the cycle (diagnosis, bring-up, class 2, live list, GAP polls, repeated Global_Control) only when that request
ends before the next cycle in the worst case: slot times, repetitions, the usual lateness of the port
(:class:`dpstack.fdl.active.admission.Admission`). Otherwise its user gets HELD_BACK and asks again. A request that is
too long for every window is forced: after :data:`HELD_BACK_CYCLES` cycles the station sends it although the next
cycle may begin late. The station forces the longest waiting request first, and at most one in as many cycles. The DP
master counts the cycles that begin late.
"""

from __future__ import annotations

from dpstack.fdl.events import HELD_BACK_CYCLES
from dpstack.units import NEVER

#: function, DA and DSAP of a request that is held back
RequestKey = tuple[int, int, int | None]


class CycleWindow:
    """``next_at``: when the next cycle is due, in ns; NEVER without fixed cycles, so that every request fits.

    ``held_back`` counts the refusals (one for each request and cycle), ``forced`` the forced requests.
    """

    def __init__(self) -> None:
        self.next_at = NEVER
        self.held_back = 0
        self.forced = 0
        #: no other master is in the ring, as far as the link layer knows
        self.alone = True
        #: for messages: name of the service that was forced in this cycle; it may end after the next cycle is due
        self.forced_service = ""
        #: for messages: name of the service without answer whose last time-out ended after the next cycle was due
        self.unanswered = ""
        self._cycle = 0
        self._forced_in = -HELD_BACK_CYCLES
        #: numbers of the cycles in which the request was first and last held back
        self._waiting: dict[RequestKey, tuple[int, int]] = {}

    def begin(self, next_at: int) -> None:
        """A cycle begins; the next one is due at ``next_at``."""
        self._cycle += 1
        self.next_at = next_at
        self.forced_service = self.unanswered = ""

    def end(self) -> None:
        """The fixed cycles have stopped."""
        self.next_at = NEVER
        self.forced_service = self.unanswered = ""
        self._waiting.clear()

    def admits(self, key: RequestKey, ends_at: int) -> bool:
        """Whether the station may now start a request that ends at ``ends_at`` (ns) at the latest.

        True with ``ends_at`` > ``next_at``: the request is forced. False: it is held back.
        """
        if ends_at <= self.next_at:
            if self._waiting:
                self._waiting.pop(key, None)
            return True
        cycle = self._cycle
        first, last = self._waiting.get(key, (cycle, -1))
        if last < cycle - 1:
            first = cycle  # its user did not ask in the last cycle: the wait begins anew
        self._waiting[key] = first, cycle
        if not self._has_waited_enough(first):
            self.held_back += last != cycle
            return False
        del self._waiting[key]
        self._forced_in = cycle
        self.forced += 1
        return True

    def _has_waited_enough(self, first: int) -> bool:
        """Whether to force a request that is held back since cycle ``first``: HELD_BACK_CYCLES are over since then and
        since the last forced request, and no other request has waited longer."""
        cycle = self._cycle
        if cycle - max(first, self._forced_in) < HELD_BACK_CYCLES:
            return False
        self._waiting = {key: wait for key, wait in self._waiting.items() if wait[1] >= cycle - 1}
        return first <= min(since for since, _ in self._waiting.values())
