"""Latency of a port and the patience derived from it: by numbers, and through the driver."""

from __future__ import annotations

import pytest

from dpstack.drivers.line.port_latency import PortLatency
from dpstack.phy.patience import FIRST, Patience, measured
from dpstack.units import NS_PER_MS
from tests.drivers.driver_rig import REQUEST, Rig


@pytest.mark.parametrize(
    ("p999_ms", "known", "unknown"),
    [(0, 20, 2), (0.1, 20, 2), (4, 20, 4), (10, 30, 10), (16, 48, 16), (30, 60, 20), (9_000, 60, 20)],
)
def test_the_patience_is_three_times_the_measured_latency_within_limits(
    p999_ms: float, known: int, unknown: int
) -> None:
    patience = measured(round(p999_ms * NS_PER_MS))
    assert patience == Patience(
        known_ns=known * NS_PER_MS,
        unknown_ns=unknown * NS_PER_MS,
        unknown_divisor=100,
        stall_ns=20 * NS_PER_MS,
        sending_ns=NS_PER_MS,
    )


def test_the_patience_is_derived_after_1000_answers_and_then_every_10000() -> None:
    told: list[tuple[int, int]] = []
    lateness = PortLatency(lambda patience, now: told.append((patience.known_ns // NS_PER_MS, now)))
    now = 0
    for count in range(1, 22_002):
        sent_at = now + 1_000_000
        # 0.1 ms on the wire, then the adapter: 2 ms, from the 5000th answer on 12 ms
        late = 2 * NS_PER_MS if count < 5_000 else 12 * NS_PER_MS
        now = sent_at + 100_000 + late
        lateness.add_answer(sent_at, 100_000, now)
        if count == FIRST:
            assert [known for known, _ in told] == [20]
    assert [known for known, _ in told] == [20, pytest.approx(36, abs=1)]
    assert lateness.histogram.count == 22_001
    assert lateness.histogram.min_ns == 2 * NS_PER_MS


def test_without_a_callback_latencies_are_only_counted() -> None:
    lateness = PortLatency()
    for _ in range(FIRST + 1):
        lateness.add_answer(1, 0, 5)
    assert lateness.patience is None
    assert lateness.histogram.max_ns == 4


@pytest.mark.usefixtures("each_driver")
async def test_the_driver_counts_first_answers_only() -> None:
    async with Rig() as rig:
        histogram = rig.driver.lateness.histogram
        rig.far.write(b"\xe5")  # nothing was sent: no answer
        await rig.settle()
        assert histogram.count == 0
        for answered in (True, False, True):
            rig.driver.command(REQUEST)
            if answered:
                rig.far.write(b"\xe5")
                await rig.settle()
                rig.far.write(b"\xe5")
                await rig.settle()
        assert histogram.count == 2
        assert 0 <= histogram.min_ns <= histogram.max_ns < 10_000_000_000


@pytest.mark.usefixtures("each_driver")
async def test_the_derived_patience_reaches_the_machine() -> None:
    told: list[Patience] = []
    async with Rig(tune=lambda patience, _now: told.append(patience)) as rig:
        lateness = rig.driver.lateness
        for _ in range(FIRST):
            lateness.add_answer(1, 0, 16 * NS_PER_MS)
        assert told == [lateness.patience]
