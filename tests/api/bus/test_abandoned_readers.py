"""Readers of a bus that a program leaves without closing them are forgotten; those that still wait are not."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import AsyncIterator, Callable

import pytest
from api_kit import RAW, RIG, mirror, operating, serving
from soak.leftovers import stack_objects

import dpstack

pytestmark = pytest.mark.virtual_time


@pytest.mark.parametrize("reader", ["events", "live", "cycles"])
async def test_a_loop_that_was_left_leaves_nothing(reader: str) -> None:
    async with operating(RAW) as bus:
        for _ in range(3):  # what is made once is there
            async for _ in getattr(bus, reader)():
                break
        await asyncio.sleep(0.1)
        before, tasks = stack_objects(), len(asyncio.all_tasks())
        for _ in range(50):
            async for _ in getattr(bus, reader)():
                break
        await asyncio.sleep(0.1)
        left = stack_objects() - before
        assert not {kind: count for kind, count in left.items() if kind.startswith(("dpstack.api", "dpstack.plant"))}
        assert len(asyncio.all_tasks()) == tasks
        assert not any("Live" in repr(task.get_coro()) for task in asyncio.all_tasks())


def events(bus: dpstack.Bus) -> AsyncIterator[object]:
    return bus.events()


def live(bus: dpstack.Bus) -> AsyncIterator[object]:
    return bus.live()


def cycles(bus: dpstack.Bus) -> AsyncIterator[object]:
    return bus.cycles()


def alarms(bus: dpstack.Bus) -> AsyncIterator[object]:
    return bus.slave(9).alarms()


def statuses(bus: dpstack.Bus) -> AsyncIterator[object]:
    return bus.slave(9).status_messages()


@pytest.mark.parametrize("reader", [events, live, cycles, alarms, statuses])
async def test_a_task_that_waits_for_an_item_is_kept(reader: Callable[[dpstack.Bus], AsyncIterator[object]]) -> None:
    """Event loops hold tasks weakly, and many programs do not hold theirs: the bus must."""
    got: list[object] = []

    async def read(bus: dpstack.Bus) -> None:
        got.extend([item async for item in reader(bus)])
        got.append("end")

    async with serving(mirror(RIG)) as (bus, _):
        asyncio.get_running_loop().create_task(read(bus))
        await asyncio.sleep(0.3)
        gc.collect()
        await asyncio.sleep(0.1)
    await asyncio.sleep(0.1)
    assert got[-1] == "end"
