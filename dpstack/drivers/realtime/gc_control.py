"""Garbage collection out of the cycle: off, and done by hand where nothing is due for longer than it takes.

Nearly all a stack makes is freed when it is used up (4000 exchanges leave some hundred objects more than before); what
refers to itself is left to the collector. Measured on a virtual machine: a full collection takes 30 ms, with all frozen
that there is at the start 0.3 us; a young one of 2000 objects that refer to themselves 0.1 ms.
"""

from __future__ import annotations

import gc
from time import monotonic_ns
from typing import Final

from dpstack.units import NS_PER_US

#: A young collection is due after so many more objects than went.
_YOUNG: Final = 700
#: The next older generation is due after so many collections of one.
_EVERY: Final = 10
#: It is done whatever is due when that is exceeded by this factor, so that memory does not grow for ever.
_FORCED: Final = 10
#: The measured time counts so often: collections differ.
_MARGIN: Final = 2
_LEAST_NS: Final = 40 * NS_PER_US
_OLDEST: Final = 2


class Collector:
    """Collects when told that there is time: ``loop.on_idle = collector.idle``.

    ``done``: collections by generation; ``forced``: those at a bad time.
    """

    def __init__(self) -> None:
        self.done = [0, 0, 0]
        self.forced = 0
        self._since = [0, 0, 0]  # collections of a generation since the next older one's
        self._cost_ns = [_LEAST_NS] * 3

    def begin(self) -> None:
        """Everything is loaded and made: keep that out of all collections, and let none begin by itself."""
        gc.collect()
        gc.freeze()
        gc.disable()

    def end(self) -> None:
        """The interpreter's own rules again."""
        gc.unfreeze()
        gc.enable()

    def idle(self, now: int, until: int) -> None:
        """Nothing is due or expected before ``until`` (ns): collect what is due and fits."""
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
        """The oldest generation that is due where each takes ``every`` of the one before."""
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
