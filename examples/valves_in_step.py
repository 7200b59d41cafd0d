"""Two valve islands that switch within one telegram, and their inputs of one moment. No hardware needed."""

import asyncio

import dpstack

SLAVES = [
    {"name": name, "address": address, "ident": 0x1234, "config": "20 10", "groups": [1], "sync": True, "freeze": True}
    for name, address in (("north", 5), ("south", 6))
]


async def main() -> None:
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=SLAVES) as bus:
        await bus.ready()
        await bus.operate()
        async with bus.group(1) as valves:  # SYNC and FREEZE end with the block
            for step in range(1, 4):
                octets = bytes((step,))
                await valves.write({"north": octets, "south": octets})  # both change at the end of one telegram
                picture = await valves.read()  # both as they were at the end of another one
                print("step", step, {name: inputs.hex() for name, inputs in picture.items()})

        north = bus.slave("north")
        await north.deactivate()  # safe outputs, Unlock; then it may be unplugged
        print("north is", north.state.value)
        await north.activate()
        await north.reparameterise(watchdog_ms=500, groups=(1, 2), sync=True)
        print("north is in groups", north.setup.groups, "and watches for", north.watchdog_ms, "ms")


asyncio.run(main())
