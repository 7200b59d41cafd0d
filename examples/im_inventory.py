"""Inventory of the devices on a bus: the live list, and I&M0 and I&M1 of every slave, beside whatever master they have.

Nothing is changed: class 2 connections take no slave away. On a real bus: ``port="/dev/ttyUSB0"``, ``baud=500_000``.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator

import dpstack
from dpstack import Im0, Im1
from dpstack.slave import DpSlave, SlaveDescription


async def inventory(bus: dpstack.Bus) -> None:
    for found in await bus.scan():
        if found.ident is None:
            print(f"{found.address:3}  {found.kind.name.lower().replace('_', ' ')}")
            continue
        what = await what_it_is(bus, found.address)
        print(f"{found.address:3}  ident 0x{found.ident:04X}, master {found.master}: {what}")


async def what_it_is(bus: dpstack.Bus, address: int) -> str:
    try:
        async with bus.class2.connect(address) as connection:
            im0 = await connection.im()
            assert isinstance(im0, Im0)
            text = f"{im0.order_id}, serial number {im0.serial_number}, {im0.software_revision}"
            if im0.supported & 0b10:  # a bit for each of I&M1 to I&M4
                im1 = await connection.im(1)
                assert isinstance(im1, Im1)
                text += f", {im1.tag_function}"
            return text
    except dpstack.AcyclicError as error:
        return f"refuses I&M (0x{error.code_1:02X})"
    except dpstack.ServiceRefused:
        return "no class 2 connection (or none free)"
    except dpstack.SlaveError as error:  # it stopped answering half-way, or closed the connection
        return str(error)


@contextlib.asynccontextmanager
async def plant(world: dpstack.World) -> AsyncIterator[None]:
    """Somebody else's master and three slaves: with I&M, with records only, without DP-V1."""
    v1 = SlaveDescription.simple(0x4711, inputs=2, outputs=1, name="valves", dpv1=True)
    v0 = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="lamp")
    valves = DpSlave(
        v1,
        lambda outputs, elapsed: bytes(2),
        im=[Im0(order_id="V-8", serial_number="0042"), Im1(tag_function="cooling")],
        ms2=1,
    )
    others = {
        4: DpSlave(v1, lambda outputs, elapsed: bytes(2), ms2=1),
        5: DpSlave(v0, lambda outputs, elapsed: outputs),
    }
    async with dpstack.slave.serve_slaves({3: valves} | others, world=world):
        tables = [v1.table(3), v1.table(4) | {"name": "pumps"}, v0.table(5)]
        async with dpstack.open_bus(world=world, baud=500_000, address=1, gap=1, slaves=tables) as owner:
            await owner.ready()
            yield


async def main() -> None:
    world = dpstack.World()
    async with plant(world), dpstack.open_bus(world=world, baud=500_000, address=10) as bus:
        await inventory(bus)


if __name__ == "__main__":
    asyncio.run(main())
