"""Bring a bus up in Clear (inputs only), print what happens for two seconds, then the inputs of every slave."""

import asyncio
from pathlib import Path

import dpstack

PLANT = Path(__file__).with_name("plant.toml")


async def print_events(bus: dpstack.Bus) -> None:
    async for event in bus.events():
        print(event.text)


async def main() -> None:
    async with dpstack.open_bus(PLANT) as bus:
        watching = asyncio.create_task(print_events(bus))
        await asyncio.sleep(2)
        for slave in bus.slaves:
            print(slave.address, slave.name, slave.state.value, slave.inputs.hex(" "))
    await watching  # ends with the bus


if __name__ == "__main__":
    asyncio.run(main())
