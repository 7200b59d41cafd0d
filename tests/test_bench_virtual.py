"""Cost of an exchange in virtual time, in Python calls of both ends, the wire and the referee."""

from __future__ import annotations

import sys
from collections.abc import Callable
from heapq import heappush
from types import FrameType
from typing import Any

import pytest

from bench.virtual import Plant
from dpstack.profile.model.states import State
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


@pytest.mark.parametrize(("drive", "most"), [(None, 68), ("demag-dedrive", 77)], ids=["mirrors", "drives"])
def test_an_exchange_in_virtual_time_costs_so_many_python_calls(drive: str | None, most: int) -> None:
    # 150 and 175 before a station heard an edge without a heap entry and an unchanged answer was not encoded again
    plant = Plant(10, _BAUD, drive)
    assert calls_an_exchange(plant, lambda: plant.world.run_for(200 * NS_PER_MS)) <= most


def test_an_exchange_in_virtual_time_costs_hardly_a_heap_entry() -> None:
    # nothing comes between request, answer, T_SDR and T_ID1; the master's slot time ends in the middle of the answer
    entries = 0

    def count(_frame: FrameType, event: str, argument: Any) -> None:
        nonlocal entries
        entries += event == "c_call" and argument is heappush

    plant = Plant(10, _BAUD)
    before = plant.exchanges
    sys.setprofile(count)
    try:
        plant.world.run_for(200 * NS_PER_MS)
    finally:
        sys.setprofile(None)
    assert entries / (plant.exchanges - before) <= 0.3


def test_a_world_that_runs_does_the_same_as_one_that_steps() -> None:
    stepped, run, asked = (Plant(3, _BAUD) for _ in range(3))
    end = stepped.world.now + 50 * NS_PER_MS
    steps = 0
    while stepped.world.next_at() <= end:
        stepped.world.step()
        steps += 1
    run.world.run_until(end)
    answers = [False] * steps
    assert not asked.world.run(end, answers.pop)
    telegrams = [entry for entry in run.world.log if entry.start_ns > end - 50 * NS_PER_MS]
    # asked where a station sends and where its telegram ends; timers that were put off are no events of a run
    assert 2 * len(telegrams) <= steps - len(answers) <= steps
    assert list(stepped.world.log) == list(run.world.log) == list(asked.world.log)
    assert stepped.exchanges == run.exchanges == asked.exchanges


@pytest.mark.parametrize("stop", [1, 2, 3, 5, 8, 13, 21])
def test_a_world_that_is_stopped_has_done_what_one_that_steps_does_up_to_this_time(stop: int) -> None:
    stops, steps = (Plant(3, _BAUD) for _ in range(2))
    end = stops.world.now + 50 * NS_PER_MS
    assert stops.world.run(end, [True, *[False] * (stop - 1)].pop)
    assert stops.world.now < end
    while steps.world.next_at() <= stops.world.now:
        steps.world.step()
    assert list(steps.world.log) == list(stops.world.log)
    for plant in (stops, steps):
        plant.world.run_until(end)
    assert list(steps.world.log) == list(stops.world.log)


def test_the_drives_of_the_benchmark_run_at_their_speed() -> None:
    # without control by the bus (412 = 1) each of them refused its start, and ten standing drives were measured
    plant = Plant(10, _BAUD, "demag-dedrive")
    assert len(plant.drives) == 10
    for core in plant.drives:
        status = core.status()
        assert status.state is State.RUNNING
        assert status.speed == pytest.approx(0.5, abs=0.01)


def test_a_global_control_to_all_slaves_costs_an_exchange_hardly_more_than_one_to_one_slave() -> None:
    found = []
    for members in (30, 1):
        plant = Plant(30, _BAUD, members=members)
        found.append(calls_an_exchange(plant, lambda plant=plant: plant.run_rounds(3)))  # type: ignore[misc]
    to_all, to_one = found
    assert to_all / to_one <= 1.2
