"""A running drive comes to rest on every way out of Operate, and stays at rest when the bus returns to it."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

import pytest

import dpstack

FAN: Mapping[str, object] = {"name": "fan", "address": 4, "drive": "fuji-frenic", "telegram": "PPO3", "ident": 0xDD04}


@pytest.mark.parametrize("way", ["clear", "stop"])
def test_a_running_fuji_comes_to_rest(way: str) -> None:
    """Its CTW bit 10 makes it ignore the zeros of Clear: only 047E before them ramps it down (F2, table 8.5)."""

    async def program() -> None:
        async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[FAN]) as bus:
            fan = bus.drive("fan")
            await bus.ready()
            await bus.operate()
            await fan.start()
            fan.speed = 0.5
            await fan.reached()
            await (bus.clear() if way == "clear" else bus.stop())
            await asyncio.sleep(0.15)  # before its watchdog could do it
            await bus.clear()
            await asyncio.sleep(2)
            assert bus.slave("fan").inputs == bytes.fromhex("02 31 00 00")
            await bus.operate()
            await asyncio.sleep(0.5)
            assert bus.slave("fan").inputs == bytes.fromhex("02 31 00 00")
            assert fan.speed == 0.5  # the set point stays, the run command does not

    dpstack.run_virtual(program())
