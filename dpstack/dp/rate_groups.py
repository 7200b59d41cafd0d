"""Rate groups: in which cycles a slave of ``every`` n has its turn, so that all cycles take about the same time.

A slave has its turn in the cycles whose number modulo its ``every`` is its offset. The plan and the master use the same
offsets, so that the bus runs as planned.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from math import lcm
from typing import Final

from msgspec import Struct
from msgspec.structs import astuple

#: slaves whose ``every`` have a common multiple up to this are set against each other (all of 1..10 have 2520)
HYPERPERIOD: Final = 2520


class Share(Struct, frozen=True):
    """The share of one slave: it takes ``duration_ns`` (any unit, the same for all) in every n-th cycle."""

    address: int
    every: int
    duration_ns: int


def offsets(shares: Iterable[Share], kept: Mapping[int, int] | None = None) -> dict[int, int]:
    """The offset (0..every - 1) of each slave by address: the same input gives the same output, in any order.

    The longest first, each into the cycles of which the fullest is emptiest. ``kept`` are offsets that stay as they
    are (slaves on the bus, when another one is added); those that do not fit their ``every`` are chosen anew.
    """
    slaves = sorted(shares, key=lambda s: (-s.duration_ns, s.every, s.address))
    before = {s.address: o for s in slaves if (o := (kept or {}).get(s.address, -1)) in range(s.every)}
    found: dict[int, int] = {}
    for period, members in _families(slaves):
        load = [0] * period
        for slave in sorted(members, key=lambda s: s.address not in before):
            every = slave.every
            offset = before[slave.address] if slave.address in before else _emptiest(load, every)
            found[slave.address] = offset
            load[offset::every] = [taken + slave.duration_ns for taken in load[offset::every]]
    return found


def fullest(shares: Iterable[Share], chosen: Mapping[int, int]) -> frozenset[int]:
    """The addresses of the slaves in the fullest cycle, with the offsets ``chosen``.

    The fullest cycles of different families are assumed to coincide.
    """
    families = _loads(shares, chosen)
    return frozenset(a for members, load in families for a in _in_turn(members, chosen, load.index(max(load))))


def emptiest(shares: Iterable[Share], chosen: Mapping[int, int]) -> frozenset[int]:
    """The addresses of the slaves in the emptiest cycle that has any, with the offsets ``chosen``.

    The emptiest cycles of different families are assumed to coincide.
    """
    families = list(_loads(shares, chosen))
    least = frozenset(a for members, load in families for a in _in_turn(members, chosen, load.index(min(load))))
    if least or not families:
        return least
    # each family has cycles without a slave: one slave of one family makes the cycle
    members, load = min(families, key=lambda family: min(filter(None, family[1])))
    return frozenset(_in_turn(members, chosen, load.index(min(filter(None, load)))))


def idle_rounds(shares: Iterable[Share], chosen: Mapping[int, int]) -> int:
    """The greatest number of cycles without any slave, one after the other, with the offsets ``chosen``."""
    return min((_longest_gap(load) for _, load in _loads(shares, chosen)), default=0)


def round_interval_ns(slaves: Iterable[tuple[int, int]]) -> int:
    """The shortest time between the beginnings of two rounds in ns; ``slaves``: ``every`` and Min_Slave_Interval in ns.

    A slave of every n-th round allows rounds n times as often as its interval says. A round that leaves nobody out
    (the last ones, an order to all) needs the longest interval as it is: give ``every`` 1 then.
    """
    return max((-(-interval // every) for every, interval in slaves), default=0)


def _loads(shares: Iterable[Share], chosen: Mapping[int, int]) -> Iterator[tuple[list[Share], list[int]]]:
    """The members of each family, and the time that they take in each cycle of its hyperperiod."""
    for period, members in _families(sorted(shares, key=astuple)):
        load = [0] * period
        for slave in members:
            part = slice(chosen[slave.address], None, slave.every)
            load[part] = [taken + slave.duration_ns for taken in load[part]]
        yield members, load


def _in_turn(members: Iterable[Share], chosen: Mapping[int, int], cycle: int) -> Iterator[int]:
    return (s.address for s in members if cycle % s.every == chosen[s.address])


def _longest_gap(load: list[int]) -> int:
    """The most empty cycles in a row; the hyperperiod repeats."""
    taken = [cycle for cycle, duration in enumerate(load) if duration]
    return max(after - before - 1 for before, after in pairwise([*taken, taken[0] + len(load)]))


def _emptiest(load: list[int], every: int) -> int:
    """The first offset whose fullest cycle is emptiest; among equals the one with the least in all its cycles."""
    return min(range(every), key=lambda offset: (max(part := load[offset::every]), sum(part)))


def _families(slaves: Iterable[Share]) -> list[tuple[int, list[Share]]]:
    """The slaves in families with a hyperperiod up to the limit (or one ``every``), the smallest ``every`` first."""
    members = list(slaves)
    periods: list[int] = []
    family: dict[int, int] = {}
    for every in sorted({s.every for s in members}):
        for number, period in enumerate(periods):
            if lcm(period, every) <= max(HYPERPERIOD, period):
                periods[number] = lcm(period, every)
                family[every] = number
                break
        else:
            family[every] = len(periods)
            periods.append(every)
    return [(period, [s for s in members if family[s.every] == n]) for n, period in enumerate(periods)]
