"""I&M0 for the report of a run: slaves that answer, refuse, never answer, are absent, or come late."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest
from api_kit import RIG, bench_of, mirror, operating
from support import WorldFactory

import dpstack
from dpstack import Im0
from dpstack.api.listen.inventory import Inventory

pytestmark = pytest.mark.virtual_time

TERMINAL: dict[str, object] = {
    "name": "valves",
    "address": 8,
    "gsd": "examples/terminal.gsd",
    "modules": ["8 DO", "8 DI", "", "4 AI"],
}
RAW: dict[str, object] = {"name": "raw", "address": 9, "ident": 0x1234, "config": "20 10"}


async def _hang(slot: int, index: int, data: bytes) -> None:
    await asyncio.sleep(600)


@contextlib.asynccontextmanager
async def five(world: WorldFactory) -> AsyncIterator[dpstack.Bus]:
    """The first has I&M, the second has no records, the others never answer a Write."""
    made = world()
    slaves = {3: mirror(im=[Im0(order_id="A-1")]), 4: mirror(), **{n: mirror(on_write=_hang) for n in (5, 6, 7)}}
    async with dpstack.slave.serve_slaves(slaves, world=made, baud=93_750):
        tables: list[Any] = [RIG.table(address) | {"name": f"rig{address}"} for address in slaves]
        async with dpstack.open_bus(world=made, baud=93_750, slaves=tables) as bus:
            await bus.ready()
            await bus.operate()
            yield bus


async def test_each_slave_is_asked_once_and_the_end_waits_a_bounded_time(world: WorldFactory) -> None:
    async with five(world) as bus:
        inventory = Inventory(bus)
        inventory.begin()
        began = asyncio.get_running_loop().time()
        await inventory.rest()
        assert asyncio.get_running_loop().time() - began == pytest.approx(2.0, abs=0.05)
        found = inventory.im0(bus.slave(3))
        assert found is not None
        assert found["order_id"] == "A-1"
        assert inventory.why_not(bus.slave(3)) == ""
        assert inventory.im0(bus.slave(4)) is None
        assert inventory.why_not(bus.slave(4)).startswith("slave 4 refuses Write of slot 0, index 255 (RS)")
        assert "to slave 5 had no answer within 1 s" in inventory.why_not(bus.slave(5))
        assert inventory.why_not(bus.slave(6)) == "it did not answer before the end of the run"
        assert inventory.why_not(bus.slave(7)).startswith("it was not asked")
        inventory.end()
        assert all(slave.ready_now for slave in bus.slaves)


async def test_a_slave_that_comes_late_is_asked_then_and_nobody_waits_for_it() -> None:
    async with operating(TERMINAL, RAW, baud=187_500) as bus:
        valves, bench = bus.slave("valves"), bench_of(bus)
        bench.power("valves", False)
        await valves.wait_state(dpstack.SlaveState.OFFLINE, timeout=5)
        inventory = Inventory(bus)
        inventory.begin()
        began = asyncio.get_running_loop().time()
        await inventory.rest()
        assert asyncio.get_running_loop().time() == began
        assert inventory.why_not(valves).startswith("it was not asked")
        assert inventory.why_not(bus.slave("raw")) == "configured without DP-V1"
        bench.power("valves", True)
        await valves.ready(5)
        await inventory.rest()
        found = inventory.im0(valves)
        assert found is not None
        assert found["order_id"] == "T8-001"
        inventory.end()
