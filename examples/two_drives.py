"""Both drives at once: parameters, start, a set point, stop. Run it beside plant.toml."""

import asyncio
from pathlib import Path

import dpstack

PLANT = Path(__file__).with_name("plant.toml")


async def hoist_up(hoist: dpstack.Drive) -> None:
    if await hoist.read(412) != 1:  # at the factory the contacts control it
        await hoist.write(412, 1)
    await hoist.write("ramp_set_point", 2)  # the line's set point alone
    hoist.speed = 0.5
    await hoist.start()
    await hoist.reached()
    print(f"hoist at {hoist.status.frequency_hz:.0f} Hz")
    await hoist.stop()


async def fan_to_and_fro(fan: dpstack.Drive) -> None:
    for speed in (0.4, -0.4):
        fan.speed = speed
        await fan.start()
        await fan.reached()
        print(f"fan at {fan.status.frequency_hz:.0f} Hz")
        await fan.stop()


async def main() -> None:
    async with dpstack.open_bus(PLANT) as bus:
        await bus.operate()
        try:
            await asyncio.gather(hoist_up(bus.drive("hoist")), fan_to_and_fro(bus.drive("fan")))
        except dpstack.DriveError as error:
            print(error)
        print(f"{bus.stats.rotations} rotations, {bus.stats.rotation_us['p50']} us each")


if __name__ == "__main__":
    asyncio.run(main())
