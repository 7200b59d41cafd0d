"""Slaves that find the baud rate by themselves, and a second master that does.

They are on a simulated bus that several programs could share; with real ports it is ``dpstack sim --baud auto`` and
``baud = "auto"``.
"""

import asyncio

import dpstack

VALVES = {"name": "valves", "address": 9, "ident": 0x1234, "config": "20 10"}


async def main() -> None:
    """The master comes at one rate, goes, and comes back at another one: the slaves follow."""
    world = dpstack.World()
    dpstack.simulate(world, [VALVES], baud="auto")
    for baud in (1_500_000, 187_500):
        async with dpstack.open_bus(world=world, baud=baud, slaves=[VALVES]) as bus:
            await bus.operate()
            await bus.ready()
            async with dpstack.open_bus(world=world, baud="auto", address=5) as second:
                print(f"the slaves follow to {baud} bit/s, master 5 found {second.params.baud}")
        await asyncio.sleep(1)  # the watchdog ends, then silence: the slaves search again


asyncio.run(main())
