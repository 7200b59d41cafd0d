"""The same state in every shape: status, statistics, summary and live stream of one bus."""

from __future__ import annotations

from typing import Any

from api_kit import bus_of, in_virtual_time

from dpstack.api.control.handlers import run_status

LAMP: dict[str, object] = {
    "name": "lamp", "address": 9, "ident": 0x1234, "config": "20 10", "outputs": {"lamp": "bool@0.0"},
}  # fmt: skip
KEYS = ("outputs", "held", "fields", "held_fields")


@in_virtual_time
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
