"""The rule that keeps everything else out of a fixed cycle: which requests may still start before the next cycle.

The DP master sets the time of the next cycle (:attr:`CycleWindow.next_at`). A request that is no part of the cycle
itself (diagnosis, bring-up, class 2, live list, GAP polls, repeated Global_Control) starts only when its longest course
ends before that (``ends_at`` in :mod:`dpstack.fdl.active.admission`: slot times, repetitions, the usual lateness of the
port); otherwise its user gets HELD_BACK and asks again. A request that fits into no gap goes out all the same, the
longest waiting first, in every eighth cycle at most; the DP master counts the start that it may delay.
"""

from __future__ import annotations

from dpstack.fdl.events import PATIENCE
from dpstack.units import NEVER

#: function, DA and DSAP of a request that waits
Key = tuple[int, int, int | None]


class CycleWindow:
    """``next_at``: when the next cycle is due, in ns; NEVER: there is none, and everything fits.

    ``held_back`` counts the waits (once for each request and cycle), ``forced`` what was sent without fitting in.
    """

    def __init__(self) -> None:
        self.next_at = NEVER
        self.held_back = 0
        self.forced = 0
        #: no other master is in the ring, as far as the link layer knows
        self.alone = True
        #: a service that was sent in this cycle without fitting in, for people
        self.overdrawn = ""
        #: a service that ran into the next cycle because nobody answered it, for people
        self.silent = ""
        self._cycle = 0
        self._forced_in = -PATIENCE
        #: the cycles of the first and of the last wait
        self._waiting: dict[Key, tuple[int, int]] = {}

    def begin(self, next_at: int) -> None:
        """A cycle begins; the next one is due at ``next_at``."""
        self._cycle += 1
        self.next_at = next_at
        self.overdrawn = self.silent = ""

    def end(self) -> None:
        """There are no cycles for now."""
        self.next_at = NEVER
        self.overdrawn = self.silent = ""
        self._waiting.clear()

    def set_alone(self, alone: bool) -> None:
        self.alone = alone

    def overdraw(self, service: str) -> None:
        """``service`` is sent in this cycle without fitting in."""
        self.overdrawn = service

    def ran_over(self, service: str) -> None:
        """Nobody answered ``service``, and that took until after the next cycle was due."""
        self.silent = service

    def admits(self, key: Key, ends_at: int) -> bool:
        """Whether what lasts until ``ends_at`` at the longest may be started now; if not it waits.

        Afterwards ``ends_at`` > ``next_at`` says that it does not fit in and is sent because it waited long enough.
        """
        if ends_at <= self.next_at:
            if self._waiting:
                self._waiting.pop(key, None)
            return True
        cycle = self._cycle
        first, last = self._waiting.get(key, (cycle, -1))
        if last < cycle - 1:
            first = cycle  # nobody wanted it for a whole cycle: another wait
        self._waiting[key] = first, cycle
        if not self._must_go(first):
            self.held_back += last != cycle
            return False
        del self._waiting[key]
        self._forced_in = cycle
        self.forced += 1
        return True

    def _must_go(self, first: int) -> bool:
        """It has waited long enough since the cycle ``first``, longest of all, and no other one went of late."""
        cycle = self._cycle
        if cycle - max(first, self._forced_in) < PATIENCE:
            return False
        self._waiting = {key: wait for key, wait in self._waiting.items() if wait[1] >= cycle - 1}
        return first <= min(since for since, _ in self._waiting.values())
