"""A day of virtual time with starts, stops, losses and map changes, and a minute of it."""

from __future__ import annotations

import pytest
from soak.day import CYCLE_MS, DAY_S, run_day

#: octets and Python objects after the warm-up: three hours took 1 MB and 962 more, in histories of events that fill up
_GROWTH = 4 << 20
_OBJECTS = 5_000


def test_a_minute_of_the_day() -> None:
    day = run_day(seed=2, seconds=60, longest_s=10)
    assert day.wrong == []
    assert {"run", "map", "lose", "short"} <= set(day.acts)  # seed 2 has them all


@pytest.mark.soak
@pytest.mark.parametrize("seed", [1])
def test_a_day(seed: int) -> None:
    """Some 13 minutes of a core."""
    day = run_day(seed)
    assert day.wrong == []
    assert day.now_s >= DAY_S
    assert {"run", "map", "lose", "short", "trip"} <= set(day.acts)
    assert day.cycles * CYCLE_MS / 1000 > 0.8 * DAY_S
    warm, end = day.memory
    assert end.rss - warm.rss < _GROWTH, day.memory
    assert end.objects - warm.objects < _OBJECTS, day.memory
