"""Rate groups: which slaves are exchanged data with in which cycle.

A slave with ``every`` = n is due in every n-th cycle. The cycles of such slaves are spread so that each cycle has about
the same load: the slave with the longest telegrams chooses first (of equal ones that with the lowest address), and
takes the offset 0 .. n-1 whose fullest cycle is the least full, the first of equal ones. So the order depends on the
configuration only. Where a fixed cycle is shorter than a slave's Min_Slave_Interval, the slave goes at the next
multiple. A turn that could not be taken (the cycle was left out, the slave was away) is taken in the next cycle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import lcm
from typing import Final

from dpstack.dp.plan import answer_octets, request_octets
from dpstack.dp.setup import SlaveSetup

#: T_SDR and T_ID1 of an exchange, in characters: so that short telegrams weigh more than their octets
_BETWEEN: Final = 7
#: loads are compared over no more cycles than this
_WINDOW: Final = 720


def effective_every(setup: SlaveSetup, cycle_ns: int) -> int:
    """In every which cycle of ``cycle_ns`` (0: free running) ``setup`` is due: with Min_Slave_Interval as the least."""
    return max(setup.every, -(-setup.min_slave_interval_ns // cycle_ns)) if cycle_ns else setup.every


def offsets(setups: Iterable[SlaveSetup], cycle_ns: int) -> dict[int, tuple[int, int]]:
    """By address: n and the offset of each slave that is not due in every cycle, but in those whose number is the
    offset modulo n.
    """
    rare = [(effective_every(s, cycle_ns), s) for s in setups]
    slaves = [(every, request_octets(s) + _BETWEEN + answer_octets(s), s) for every, s in rare if every > 1]
    window = min(lcm(*(every for every, _, _ in slaves)), _WINDOW)
    loads = [0] * window
    result: dict[int, tuple[int, int]] = {}
    for every, load, setup in sorted(slaves, key=lambda s: (-s[1], s[2].address)):
        # beyond the window a slave is as rare as any other: only its first turns count
        offset = min(range(min(every, window)), key=lambda o: (max(loads[o::every]), o))
        for turn in range(offset, window, every):
            loads[turn] += load
        result[setup.address] = every, offset
    return result


class Rates:
    """Whose turn it is. ``cycle_ns`` 0: rounds without a fixed cycle, counted the same way."""

    __slots__ = ("_cycle_ns", "_due", "_offsets", "_setups")

    def __init__(self, cycle_ns: int) -> None:
        self._cycle_ns = cycle_ns
        self._setups: Sequence[SlaveSetup] = ()
        #: of those that are not due in every cycle: n and offset, and the number of the next turn
        self._offsets: dict[int, tuple[int, int]] = {}
        self._due: dict[int, int] = {}

    def arrange(self, setups: Sequence[SlaveSetup]) -> None:
        """The slaves there are, whether they are in data exchange or not."""
        if setups != self._setups:
            self._setups = setups
            self._offsets = offsets(setups, self._cycle_ns)
            self._due.clear()

    @property
    def uneven(self) -> bool:
        """Somebody is not due in every cycle."""
        return bool(self._offsets)

    def due(self, address: int, number: int) -> bool:
        """Whether the slave at ``address`` has a turn in cycle ``number``, or one it could not take before."""
        spread = self._offsets.get(address)
        if spread is None:
            return True
        at = self._due.get(address)
        if at is None:
            every, offset = spread
            at = self._due[address] = number + (offset - number) % every
        return number >= at

    def taken(self, address: int, number: int) -> None:
        """It had its turn in cycle ``number``."""
        spread = self._offsets.get(address)
        if spread is not None:
            every, offset = spread
            self._due[address] = number + 1 + (offset - number - 1) % every
