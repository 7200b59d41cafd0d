"""Garbage collection by hand: when there is time, and at last in any case."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator
from time import monotonic_ns

import pytest

from dpstack.drivers.realtime import gc_control
from dpstack.drivers.realtime.gc_control import Collector
from dpstack.units import NEVER, NS_PER_US


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
