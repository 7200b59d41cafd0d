"""Timers of the drivers: how early a sleep is set to end, the timerfd in an asyncio loop."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from time import monotonic_ns

import pytest
from far_ends import until

from dpstack.drivers.line.timers import FdTimer, Lead, LoopTimer, Timer, make_timer
from dpstack.ports import timerfd
from dpstack.units import NS_PER_MS, NS_PER_US

pytestmark = pytest.mark.skipif(not timerfd.AVAILABLE, reason="timerfd is of Linux")


@pytest.mark.parametrize(("raised", "lowered", "later"), [(9, 1, 0.1), (1, 9, 0.9), (1, 1, 0.5)])
def test_a_lead_follows_a_share_of_the_wake_ups(raised: int, lowered: int, later: float) -> None:
    lead = Lead(20_000, least=0, most=100_000, raised=100 * raised, lowered=100 * lowered)
    numbers = random.Random(3)
    late = [15_000 + round(numbers.expovariate(1 / 8_000)) for _ in range(20_000)]
    above = 0
    for each in late:
        above += each > lead.ns
        lead.learn(each)
    assert abs(above / len(late) - later) < 0.02


def test_a_lead_keeps_its_limits() -> None:
    lead = Lead(20, least=5, most=30, raised=9, lowered=1)
    for _ in range(10):
        lead.learn(1_000)
    assert lead.ns == 30
    for _ in range(100):
        lead.learn(0)
    assert lead.ns == 5


@pytest.mark.parametrize("make", [FdTimer, LoopTimer])
async def test_a_timer_calls_once_for_each_deadline(make: Callable[..., Timer]) -> None:
    calls: list[int] = []
    timer = make(asyncio.get_running_loop(), lambda: calls.append(monotonic_ns()))
    wanted = 0
    for wanted in (1, 2):
        at = monotonic_ns() + NS_PER_MS
        timer.set(at)
        await until(lambda: len(calls) >= wanted, "the call")  # noqa: B023 - called before the next turn
        assert calls[-1] >= at - NS_PER_US
        await asyncio.sleep(0.005)
        assert len(calls) == wanted
    timer.set(monotonic_ns() + NS_PER_MS)
    timer.close()
    await asyncio.sleep(0.005)
    assert len(calls) == 2


async def test_a_timerfd_is_read_only_where_its_call_sets_no_new_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    reads = 0
    clear = timerfd.Timerfd.clear

    def counted(timer: timerfd.Timerfd) -> None:
        nonlocal reads
        reads += 1
        clear(timer)

    monkeypatch.setattr(timerfd.Timerfd, "clear", counted)
    calls = 0

    def due() -> None:
        nonlocal calls
        calls += 1
        if calls < 5:
            timer.set(monotonic_ns())

    timer = FdTimer(asyncio.get_running_loop(), due)
    timer.set(monotonic_ns())
    await until(lambda: calls == 5, "all calls")
    await asyncio.sleep(0.002)
    assert (calls, reads) == (5, 1)
    timer.close()


async def test_a_timer_may_be_closed_by_its_call() -> None:
    timer = FdTimer(asyncio.get_running_loop(), lambda: timer.close())
    timer.set(monotonic_ns())
    await until(lambda: timer._timer.fd < 0, "the call")


async def test_without_descriptors_the_loops_own_timer_is_taken_and_none_is_left_open(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[timerfd.Timerfd] = []
    closed: list[timerfd.Timerfd] = []
    close = timerfd.Timerfd.close

    class Scarce(timerfd.Timerfd):
        def __init__(self, *, blocking: bool = False) -> None:
            if made:
                raise OSError(24, "Too many open files")
            super().__init__(blocking=blocking)
            made.append(self)

        def close(self) -> None:
            closed.append(self)
            close(self)

    monkeypatch.setattr(timerfd, "Timerfd", Scarce)
    timer = make_timer(asyncio.get_running_loop(), lambda: None)
    assert isinstance(timer, LoopTimer)
    assert set(closed) == set(made)


async def test_a_nap_is_never_short() -> None:
    timer = FdTimer(asyncio.get_running_loop(), lambda: None)
    for ns in (-1, 0, 1, 30_000, 300_000):
        at = monotonic_ns() + ns
        timer.nap(at)
        assert time.monotonic_ns() >= at
    timer.close()
