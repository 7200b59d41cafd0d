"""Cost of an exchange in virtual time, in Python calls of both ends, the wire and the referee."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

import pytest

from bench.virtual import Plant
from dpstack.units import NS_PER_MS

_BAUD = 500_000


def calls_an_exchange(plant: Plant, run: Callable[[], object]) -> float:
    """Python calls for each exchange while ``run`` runs."""
    calls = 0

    def count(_frame: FrameType, event: str, _argument: Any) -> None:
        nonlocal calls
        calls += event == "call"

    before = plant.exchanges
    sys.setprofile(count)
    try:
        run()
    finally:
        sys.setprofile(None)
    return calls / (plant.exchanges - before)


@pytest.mark.parametrize(("drive", "most"), [(None, 82), ("demag-dedrive", 91)], ids=["mirrors", "drives"])
def test_an_exchange_in_virtual_time_costs_so_many_python_calls(drive: str | None, most: int) -> None:
    # 150 and 175 before a station heard an edge without a heap entry and an unchanged answer was not encoded again
    plant = Plant(10, _BAUD, drive)
    assert calls_an_exchange(plant, lambda: plant.world.run_for(200 * NS_PER_MS)) <= most


def test_a_global_control_to_all_slaves_costs_an_exchange_hardly_more_than_one_to_one_slave() -> None:
    found = []
    for members in (30, 1):
        plant = Plant(30, _BAUD, members=members)
        found.append(calls_an_exchange(plant, lambda plant=plant: plant.run_rounds(3)))  # type: ignore[misc]
    to_all, to_one = found
    assert to_all / to_one <= 1.2
