"""The application watchdog with the bus in a process of its own, while the application hangs."""

from __future__ import annotations

import asyncio
import time

import pytest
from far_ends import until
from process_kit import DRIVERS, VALVES, Driver, eventually, ready_bus

from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import ApplicationSilent, ForcedClear

OUT = b"\x11\x22"


async def test_the_application_hangs() -> None:
    """The outputs of the slave become zeros although nothing runs in the application."""
    async with ready_bus(VALVES, application_watchdog_ms=1000, after_stall="safe") as (bus, there):
        bus.slave("valves").outputs = OUT
        await bus.operate()
        await until(lambda: there.slaves[4].outputs == OUT, "its outputs")
        eventually(lambda: there.slaves[4].outputs == bytes(2), "Clear while the application hangs")
        await until(lambda: bus.mode is Mode.CLEAR, "the application is told")
        assert isinstance(bus.forced_clear, ApplicationSilent)
        await bus.operate()
        await until(lambda: there.slaves[4].outputs == OUT, "its outputs again")


@pytest.mark.parametrize("driver", DRIVERS)
async def test_an_application_that_is_alive(driver: Driver) -> None:
    """The bus process reads every sign of life, however many come, and answers orders between them."""
    told: list[object] = []
    async with ready_bus(
        VALVES, application_watchdog_ms=20_000, after_stall="resume", on_event=told.append, driver=driver
    ) as (bus, there):
        bus.slave("valves").outputs = OUT
        await bus.operate()
        await until(lambda: there.slaves[4].outputs == OUT, "its outputs")
        end = time.monotonic() + 0.3
        while time.monotonic() < end:
            for _ in range(100):
                bus.alive()
            await asyncio.sleep(0)
        assert bus.stats.slaves[4].exchanges
        assert not [event for event in told if isinstance(event, ForcedClear)]
        assert there.slaves[4].outputs == OUT
