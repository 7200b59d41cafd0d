"""A real-time process leaves the kernel no reason to stop it: spinning and rest, counted on any course of waiting.
Garbage collection by hand: when there is time, and at last in any case."""

from __future__ import annotations

import gc
import os
import weakref
from collections.abc import Iterator
from time import monotonic_ns

import pytest

from dpstack.drivers.realtime import gc_control
from dpstack.drivers.realtime.cpu_budget import SPIN_AT_ONCE_NS, Budget, is_real_time
from dpstack.drivers.realtime.gc_control import Collector
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S, NS_PER_US


def most_in_a_second(spins: list[tuple[int, int]]) -> int:
    """The most that of any second was spun; ``spins`` are (begin, duration)."""
    worst = within = first = 0
    for begin, spun in spins:
        within += spun
        while spins[first][0] < begin + spun - NS_PER_S:
            within -= spins[first][1]
            first += 1
        worst = max(worst, within)
    return worst


@pytest.mark.parametrize("pause_ns", [0, 20_000, 400_000])
@pytest.mark.parametrize("wanted_ns", [7_000, 40_000, 300_000])
def test_spinning_takes_no_more_than_its_share_of_any_second(wanted_ns: int, pause_ns: int) -> None:
    budget, now = Budget(), 1_000 * NS_PER_S
    spins: list[tuple[int, int]] = []
    end = now + 1_300 * NS_PER_MS
    while now < end:
        spin = min(wanted_ns, budget.left_ns()) if budget.may_spin(now) else 0
        now += spin
        spins.append((now - spin, spin))
        budget.spun(spin, now, in_vain=spin < wanted_ns)
        now += pause_ns  # works
        if not spin:
            now += 60_000
            budget.slept(60_000, now)
    assert max(spin for _, spin in spins) <= SPIN_AT_ONCE_NS
    worst = most_in_a_second(spins)
    assert worst <= 0.3 * NS_PER_S + SPIN_AT_ONCE_NS
    if wanted_ns > pause_ns:
        assert worst > 0.25 * NS_PER_S  # and it is not refused for nothing


def test_one_spin_is_bounded_until_something_is_done() -> None:
    budget = Budget()
    assert budget.left_ns() == SPIN_AT_ONCE_NS == 100_000
    budget.spun(60_000, 60_000, in_vain=True)
    assert budget.left_ns() == 40_000
    budget.spun(60_000, 120_000, in_vain=True)
    assert budget.left_ns() == 0
    budget.slept(1_000, 121_000)  # the call alone
    assert budget.left_ns() == 0
    budget.slept(60_000, 181_000)
    assert budget.left_ns() == SPIN_AT_ONCE_NS
    budget.spun(60_000, 241_000, in_vain=True)
    budget.spun(1_000, 242_000)  # something came
    assert budget.left_ns() == SPIN_AT_ONCE_NS


def test_a_used_up_budget_comes_back() -> None:
    budget, now = Budget(), 0
    while budget.may_spin(now):
        now += 50_000
        budget.spun(50_000, now)
    assert budget.may_spin(now + 200 * NS_PER_MS)


def test_a_process_that_always_works_rests_a_twelfth_and_one_that_sleeps_does_not() -> None:
    budget, now, slept = Budget(rests=True), 5 * NS_PER_S, 0
    budget.begin(now)
    begin = now
    while now < begin + NS_PER_S:
        now += 50_000  # works
        sleep_ns = budget.forced_sleep_ns(now)
        if sleep_ns:
            now += sleep_ns
            slept += sleep_ns
            budget.slept(sleep_ns, now)
    assert 0.05 * NS_PER_S < 0.07 * NS_PER_S < slept < 0.09 * NS_PER_S
    for _ in range(1_000):
        now += 900_000
        assert not budget.forced_sleep_ns(now)
        now += 100_000
        budget.slept(100_000, now)


def test_sleep_is_not_saved_up() -> None:
    budget, now = Budget(rests=True), NS_PER_S
    budget.begin(now)
    now += 60 * NS_PER_S
    budget.slept(60 * NS_PER_S, now)
    assert budget.forced_sleep_ns(now + 10 * NS_PER_MS) > 0


def test_an_ordinary_process_is_not_forced_to_rest() -> None:
    budget = Budget()
    budget.begin(0)
    if not is_real_time():
        assert budget.forced_sleep_ns(60 * NS_PER_S) == 0
    assert is_real_time() == (os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR))


class Knot:
    """Refers to itself: only the collector can free it."""

    def __init__(self) -> None:
        self.me = self


@pytest.fixture
def collector() -> Iterator[Collector]:
    gc.unfreeze()  # what tests/conftest.py has frozen: the collector freezes its own
    collector = Collector()
    collector.begin()
    yield collector
    gc.enable()


def knots(count: int) -> weakref.ref[Knot]:
    """Leave so many behind; a reference to the last."""
    for _ in range(count - 1):
        Knot()
    return weakref.ref(Knot())


def test_nothing_begins_by_itself_and_nothing_is_done_for_little(collector: Collector) -> None:
    assert not gc.isenabled()
    assert gc.get_freeze_count() > 1_000
    collector.idle(monotonic_ns(), NEVER)
    assert collector.done == [0, 0, 0]


def test_garbage_is_collected_when_there_is_time(collector: Collector) -> None:
    last = knots(3_000)
    now = monotonic_ns()
    collector.idle(now, now + 10 * NS_PER_US)  # an answer is expected
    assert last() is not None
    collector.idle(now, NEVER)
    assert last() is None
    assert collector.done == [1, 0, 0]
    assert collector.forced == 0


def test_a_collection_that_took_long_needs_more_time_the_next_time(collector: Collector) -> None:
    collector._cost_ns[0] = 400 * NS_PER_US
    knots(3_000)
    now = monotonic_ns()
    collector.idle(now, now + 700 * NS_PER_US)
    assert collector.done == [0, 0, 0]
    collector.idle(now, now + 900 * NS_PER_US)
    assert collector.done == [1, 0, 0]
    assert collector._cost_ns[0] >= 350 * NS_PER_US


def test_without_any_time_memory_does_not_grow_for_ever(collector: Collector) -> None:
    last = knots(1)
    for _ in range(gc_control._YOUNG * gc_control._FORCED // 1_000 + 2):
        knots(1_000)
        now = monotonic_ns()
        collector.idle(now, now + NS_PER_US)
    assert last() is None
    assert collector.forced == 1


def test_older_generations_have_their_turns(collector: Collector) -> None:
    kept = [Knot() for _ in range(10)]
    for _ in range(125):
        knots(800)
        collector.idle(monotonic_ns(), NEVER)
    assert collector.done[0] > 100
    assert collector.done[1] >= 10
    assert collector.done[2] == 1
    assert len(kept) == 10
