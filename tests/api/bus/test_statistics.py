"""Counters against what was really on the wire: a simulated bus with literal damage."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from api_kit import RAW, bus_of, operating
from support import present

import dpstack
from dpstack.api.control.handlers import run_status
from dpstack.sim.world import World

pytestmark = pytest.mark.virtual_time


async def test_a_clean_bus_counts_every_telegram_and_nothing_wrong() -> None:
    async with operating(RAW, gap=0) as bus:
        await asyncio.sleep(0.5)
        world = present(bus.world)
        stats = bus.stats
        assert abs(stats.telegrams - world.transmissions) <= 1  # one may be on its way
        raw = stats.slaves[9].link
        assert raw.requests - raw.answers in (0, 1)
        assert raw.telegrams == raw.requests + raw.answers
        assert (stats.retries, stats.timeouts, stats.late, stats.bad) == (0, 0, 0, {})
        summary: Any = stats.summary()
        assert summary["telegrams"] == stats.telegrams
        assert summary["slaves"]["9"]["telegrams"] == raw.telegrams
        assert summary["slaves"]["9"]["bad"] == {}
        await asyncio.sleep(0.1)
        assert stats.slaves[9].link is raw
        assert raw.requests < bus.stats.slaves[9].link.requests  # a picture does not change


def damage(world: World, seconds: float) -> None:
    """Octets that are no telegram, into the wait for an answer now and then."""
    step = 7_300_000

    def hit(n: int) -> None:
        world.inject(b"\x55")
        if n:
            world.call_at(world.now + step, lambda: hit(n - 1))

    world.call_at(world.now + step, lambda: hit(round(seconds * 1e9 / step)))


async def test_damage_is_counted_by_cause_and_for_the_station_asked() -> None:
    async with operating(RAW, gap=0) as bus:
        damage(present(bus.world), 1.0)
        await asyncio.sleep(1.2)
        stats = bus.stats
        raw = stats.slaves[9]
        assert sum(stats.bad.values()) > 20
        assert 0 < sum(raw.link.bad.values()) <= sum(stats.bad.values())
        assert set(raw.link.bad) <= set(stats.bad)
        assert raw.retries == raw.link.retries > 0
        summary: Any = stats.summary()
        assert summary["bad"] == stats.bad
        assert summary["retries"] == stats.retries == raw.retries
        assert bus.slave("raw").state is dpstack.SlaveState.DATA_EXCHANGE


# --- The same state in every shape: status, statistics, summary and live stream of one bus --------------------------


LAMP: dict[str, object] = {
    "name": "lamp", "address": 9, "ident": 0x1234, "config": "20 10", "outputs": {"lamp": "bool@0.0"},
}  # fmt: skip
KEYS = ("outputs", "held", "fields", "held_fields")


async def test_outputs_are_what_the_slave_gets_and_held_what_waits() -> None:
    async with bus_of(LAMP) as bus:
        await bus.ready(5)
        bus.slave("lamp")["lamp"] = True
        shapes = await shapes_of(bus)
        assert shapes["status"] == shapes["stats"] == shapes["live"]
        assert shapes["live"] == {
            "outputs": "00",
            "held": "01",
            "fields": {"lamp": False},
            "held_fields": {"lamp": True},
        }
        stats = bus.stats.slaves[9]
        assert (stats.outputs, stats.held) == (b"\0", b"\1")
        await bus.operate()
        await bus.rotated(2)
        shapes = await shapes_of(bus)
        assert shapes["status"] == shapes["stats"] == shapes["live"]
        assert shapes["live"] == {"outputs": "01", "held": None, "fields": {"lamp": True}, "held_fields": None}
        assert (bus.stats.slaves[9].outputs, bus.stats.slaves[9].held) == (b"\1", None)


async def shapes_of(bus: Any) -> dict[str, dict[str, object]]:
    live: dict[str, Any] = {}
    async for item in bus.live(interval=0.1):
        live |= item.get("snapshot", {}).get("slaves", {}).get("9", {})
        if "outputs" in live:
            break
    status: Any = run_status(bus)
    stats: Any = bus.stats.summary()
    found = {"status": status["slaves"]["9"], "stats": stats["slaves"]["9"], "live": live}
    return {name: {key: values.get(key) for key in KEYS} for name, values in found.items()}
