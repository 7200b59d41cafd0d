"""The application under test: a fan runs while the tank is more than half full; without the fan the valve closes."""

from __future__ import annotations

import asyncio

import dpstack


async def control(bus: dpstack.Bus, seconds: float) -> None:
    """Look ten times a second."""
    fan, tank = bus.drive("fan"), bus.slave("tank")
    for _ in range(round(seconds * 10)):
        full = float(tank["level"]) > 50
        tank["valve"] = full and fan.slave.ready_now
        if full and fan.slave.ready_now and not fan.status.running and not fan.status.fault:
            await fan.start()
            fan.speed = 0.5
        elif not full and fan.status.running:
            await fan.stop()
        await asyncio.sleep(0.1)


async def main() -> None:
    async with dpstack.open_bus("plant.toml") as bus:
        await bus.operate()
        await bus.ready()
        await control(bus, 3600)


if __name__ == "__main__":
    asyncio.run(main())
