"""Alarms of a slave as an async stream, acknowledged by the program once it has dealt with each; the cycle goes on.

The slave is the simulated I/O station, whose modules are pulled and plugged here. On a real bus:
``port="/dev/ttyUSB0"``, ``baud=500_000``, and the table of your slave with ``dpv1 = { alarms = [...] }``.
"""

import asyncio

import dpstack
from dpstack import AlarmType


async def shift(station: dpstack.IoStation) -> None:
    """The disturbances of the plant."""
    await asyncio.sleep(0.5)
    station.pull(2)
    await asyncio.sleep(0.5)
    station.plug(2)
    await asyncio.sleep(0.5)
    station.set_input(1, b"\x05")


async def watch(io: dpstack.Slave) -> None:
    """Ends with the bus, or when whoever holds the iterator is cancelled."""
    async for alarm in io.alarms(acknowledge=False):
        print(f"{alarm.title}, slot {alarm.slot}", *alarm.texts, sep="; ")
        if alarm.type == AlarmType.PULL:
            print("  slots", (await io.read(0, 2)).hex(" "))  # what is there to be read of it
        try:
            await alarm.acknowledge()  # until then the slave raises no further one
        except dpstack.SlaveError as error:  # it has left data exchange, or refuses: its alarms are void then
            print(f"  {error}")


async def main() -> None:
    station = dpstack.IoStation.of(["8 DI", "8 DO", "2 AI"], name="io")
    world = dpstack.World()
    async with (
        dpstack.slave.serve_slave(station, world=world, address=8),
        dpstack.open_bus(world=world, baud=500_000, slaves=[station.table(8)]) as bus,
    ):
        await bus.ready()
        watching = asyncio.create_task(watch(bus.slave("io")))
        await shift(station)
        await asyncio.sleep(0.5)
        print(bus.slave("io").alarm_counts)
    await watching


if __name__ == "__main__":
    asyncio.run(main())
