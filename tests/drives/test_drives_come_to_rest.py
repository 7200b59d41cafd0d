"""A running drive comes to rest on every way out of Operate, and stays at rest when the bus returns to it."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

import pytest
from api_kit import operating
from drive_bench import PluginBench

import dpstack
from dpstack.profile import find

FAN: Mapping[str, object] = {"name": "fan", "address": 4, "drive": "fuji-frenic", "telegram": "PPO3", "ident": 0xDD04}


@pytest.mark.parametrize("way", ["clear", "stop"])
def test_a_running_fuji_comes_to_rest(way: str) -> None:
    """Its CTW bit 10 makes it ignore the zeros of Clear: only 047E before them ramps it down
    (docs/reference/drives/fuji.md#control-and-status-word)."""

    async def program() -> None:
        async with operating(FAN) as bus:
            fan = bus.drive("fan")
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


def test_a_start_nobody_waits_for_any_more_never_comes_true() -> None:
    """Cancelled before the bus operates, the order must not turn the motor once it does."""

    async def program() -> None:
        async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[FAN]) as bus:
            fan = bus.drive("fan")
            await bus.ready()
            waiting = asyncio.ensure_future(fan.start(timeout=60))
            await asyncio.sleep(0.1)
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
            await bus.operate()
            fan.speed = 0.5
            await asyncio.sleep(1)
            assert bus.slave("fan").inputs == bytes.fromhex("02 31 00 00")

    dpstack.run_virtual(program())


def test_a_start_cancelled_half_way_takes_its_command_back() -> None:
    """Octets by docs/reference/drives/fuji.md#worked-run: 047F begins the run, 047E ends it."""
    bench = PluginBench(find("fuji-frenic").core("fan", "PPO3", {}), "02 40 00 00")
    start = bench.order("start", timeout_s=60)
    assert bench.see("02 31 00 00", 2) == "04 7F 00 00"
    cancel = bench.order("cancel", order=start)
    assert bench.out() == "04 7E 00 00"
    assert bench.see("02 37 00 00", 5) == "04 7E 00 00"
    assert bench.result(start) is None
    assert bench.result(cancel) == {"type": "result", "token": cancel, "ok": True, "value": 1}
