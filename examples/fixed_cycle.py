"""A fixed cycle of 5 ms: all inputs of one moment in, all outputs at one moment out. No hardware needed."""

import asyncio

import dpstack

SLAVES = [
    {
        "name": name,
        "address": address,
        "ident": 0x1234,
        "config": "21 11",  # two octets each way; the simulated ones give back what they are sent
        "inputs": {"position": "u16@0"},
        "outputs": {"target": "u16@0"},
        "groups": [1],
        "sync": True,
        "freeze": True,
    }
    for name, address in (("left", 5), ("right", 6))
] + [{"name": "lamp", "address": 9, "ident": 0x1234, "config": "20", "every": 4}]  # in every fourth cycle only


async def main() -> None:
    bus = dpstack.open_bus(port="virtual", baud=500_000, slaves=SLAVES, cycle_ms=5, cycle_freeze=[1], cycle_sync=[1])
    async with bus:
        await bus.operate()
        await bus.ready()
        left, right = bus.slave("left"), bus.slave("right")
        apart = count = 0
        async for cycle in bus.cycles():
            apart = max(apart, abs(int(cycle["left"]["position"]) - int(cycle["right"]["position"])))
            left["target"] = right["target"] = count = count + 1
            if count == 200:
                print(f"{count} cycles, the two never more than {apart} apart, {cycle.missed} missed")
                break
        lamp = bus.stats.slaves[9].exchanges / bus.stats.slaves[5].exchanges
        print(f"the lamp was told {lamp:.2f} times a cycle")


asyncio.run(main())
