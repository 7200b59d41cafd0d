"""Garbage collection outside the cycle: Python's own is off, the loop collects in pauses longer than a collection.

Reference counting frees nearly all objects of the stack (4000 exchanges leave some hundred); the collector is needed
for reference cycles. Measured on a virtual machine: a full collection takes 30 ms, or 0.3 us when all objects of the
start are frozen; a young one of 2000 objects in reference cycles 0.1 ms.
"""

from __future__ import annotations

import gc
from time import monotonic_ns
from typing import Final

from dpstack.units import NS_PER_US

#: A young collection is due when this many more objects were made than freed.
_YOUNG: Final = 700
#: Collections of a generation after which the next older one is due.
_EVERY: Final = 10
#: Without pauses it is collected when _YOUNG is exceeded by this factor, so that memory does not grow for ever.
_FORCED: Final = 10
#: Factor on the measured duration: collections differ.
_MARGIN: Final = 2
_LEAST_NS: Final = 40 * NS_PER_US
_OLDEST: Final = 2


class Collector:
    """Collects in the loop's pauses: ``loop.on_idle = collector.idle``.

    ``done``: collections by generation; ``forced``: those without a pause.
    """

    def __init__(self) -> None:
        self.done = [0, 0, 0]
        self.forced = 0
        self._since = [0, 0, 0]  # collections of a generation since the next older one's
        self._cost_ns = [_LEAST_NS] * 3

    def begin(self) -> None:
        """At the end of the start: exclude the objects of the start from collections, and switch automatic ones off.

        Nothing is collected first: an import leaves 600 objects in reference cycles among 26 000, and to find them
        takes 18 ms.
        """
        gc.freeze()
        gc.disable()

    def idle(self, now: int, until: int) -> None:
        """No work is expected before ``until`` (ns): collect the oldest generation that is due and fits."""
        young = gc.get_count()[0]
        if young < _YOUNG:
            return
        time = until - now
        oldest = self._due(_EVERY)
        for generation in range(oldest, -1, -1):
            if time > _MARGIN * self._cost_ns[generation]:
                self._collect(generation)
                return
        overdue = self._due(_EVERY * _FORCED)
        if young > _YOUNG * _FORCED:
            self.forced += 1
            self._collect(overdue)

    def _due(self, every: int) -> int:
        """The oldest generation that is due after ``every`` collections of the younger one."""
        generation = 0
        while generation < _OLDEST and self._since[generation] >= every:
            generation += 1
        return generation

    def _collect(self, generation: int) -> None:
        begin = monotonic_ns()
        gc.collect(generation)
        took = monotonic_ns() - begin
        cost = self._cost_ns
        cost[generation] = max(took, _LEAST_NS, cost[generation] * 7 // 8)
        self.done[generation] += 1
        self._since[generation] += 1
        for younger in range(generation):
            self._since[younger] = 0
