"""A DP-V1 slave of one's own: records, an alarm, I&M, parameters (PROFIdrive) and class 2 connections; and its master.

On a real bus (or ``port="pty"``, then ``server.port_name`` is what a master opens) the slave alone is
``async with dpstack.slave.serve_slave(mixer(), port="/dev/ttyUSB0", baud=500_000, address=9, on_event=tell) as server:
await server.serve_forever()``.
"""

import asyncio

import dpstack
from dpstack import AlarmType, Event, Im0, Im1, RecordRefused
from dpstack.profile import ParamSpec, ParamStore, ParamTable
from dpstack.profile.record47 import ParameterServer, StoreParameters, TimedRecords
from dpstack.slave import DpSlave, SlaveDescription

TYPE = SlaveDescription.simple(0x4711, inputs=1, outputs=1, name="mixer", dpv1=True, alarms=("process",))
TABLE = ParamTable([ParamSpec(number=10, name="ramp", title="Ramp time", unit="s", decimals=1, factory=5)])


class Recipes:
    """Record 10 + n of slot 1 is recipe n."""

    def __init__(self) -> None:
        self.stored = {10: b"water"}

    async def read(self, slot: int, index: int) -> bytes:
        await asyncio.sleep(0.02)  # a database, say: the master polls meanwhile, the cycle goes on
        if slot != 1 or index not in self.stored:
            raise RecordRefused(0xB0)  # invalid index; anything else that is raised is told as an event
        return self.stored[index]

    async def write(self, slot: int, index: int, data: bytes) -> None:
        if len(data) > 20:
            raise RecordRefused(0xB1)  # write length error
        if index == 13:
            raise OSError("disk full")
        self.stored[index] = data


def mixer() -> DpSlave:
    recipes = Recipes()
    return DpSlave(
        TYPE,
        lambda outputs, elapsed: outputs,
        on_read=recipes.read,
        on_write=recipes.write,
        im=[Im0(order_id="MIX-1"), Im1()],
        parameters=TimedRecords(ParameterServer(StoreParameters(ParamStore(TABLE, {})))),
        ms2=2,
    )


def tell(event: Event) -> None:
    """Print refused requests, and functions that failed with file and line."""
    if isinstance(event, dpstack.slave.RequestRefused):
        print(event.text)


async def main() -> None:
    world = dpstack.World()
    async with (
        dpstack.slave.serve_slave(mixer(), world=world, address=9, on_event=tell) as server,
        dpstack.open_bus(world=world, baud=500_000, slaves=[TYPE.table(9)]) as bus,
    ):
        await bus.ready()
        slave = bus.slave("mixer")
        await slave.write(1, 11, b"milk")
        print(await slave.read(1, 10), await slave.read(1, 11))
        async with bus.class2.connect(9) as connection:
            im0 = await connection.im()
            assert isinstance(im0, Im0)
            print(f"over class 2: {await connection.read(1, 10)!r}, {im0.order_id}")

        alarms = slave.alarms()
        raised = asyncio.create_task(server.slave.alarm(AlarmType.PROCESS, 1, data=b"\x01", timeout=2))
        print((await anext(alarms)).text)
        await raised  # the master has acknowledged it
        alarms.close()

        for one in await slave.parameters().read_out(progress=lambda done, of: print(f"{done} of {of} parameters")):
            print(one.pnu, one.description and one.description.name, one.values)
        for index, length in ((12, 21), (13, 1)):  # too long; and one whose function fails, which ``tell`` shows
            try:
                await slave.write(1, index, bytes(length))
            except dpstack.AcyclicError as error:
                print(error)


if __name__ == "__main__":
    asyncio.run(main())
