"""What people hand to acyclic services by mistake: refused at once, with what is wanted; nothing is sent."""

from __future__ import annotations

import asyncio
import re
from typing import Any

import pytest
from api_kit import in_virtual_time, virtual

import dpstack
from dpstack import AlarmType, DpSlave, RecordRefused, SlaveDescription, UsageError
from dpstack.profile.record47 import Address
from dpstack.sim.world import World

TYPE = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, alarms=("process",))
PUMP = {"name": "pump", "address": 6, "drive": "ls-s100"}


def odd(value: object) -> Any:
    return value


@in_virtual_time
async def test_what_is_meant_well() -> None:
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[PUMP]) as bus:
        await bus.ready()
        pump = bus.slave("pump").parameters()
        assert await pump.read([930, 918]) == await pump.read([Address(930), Address(918)])
        assert await pump.read(range(930, 931)) == await pump.read([930])
        for wrong in (930, Address(930), ["p930"]):
            with pytest.raises(UsageError, match=r"is no list of parameters|is no parameter: give its number"):
                await pump.read(odd(wrong))
        with pytest.raises(UsageError, match=r"give a list of .Address"):
            await pump.change([odd((Address(930), 5))])


def test_before_the_bus_is_open_nobody_waits_for_messages() -> None:
    slave = dpstack.open_bus(port="virtual", baud=500_000, slaves=[PUMP]).slave("pump")
    for listen in (slave.alarms, slave.status_messages):
        with pytest.raises(UsageError, match="the bus is not open"):
            listen()


@pytest.mark.parametrize("codes", [(0x1234,), (-1,), ("invalid index",), (0xB0, 256)])
def test_a_refusal_has_octets(codes: tuple[Any, ...]) -> None:
    with pytest.raises(UsageError, match="is no octet; 0xB0 says invalid index"):
        RecordRefused(*codes)


def plain(slot: int, index: int) -> bytes:
    return b"\1"


async def too_much(slot: int, index: int) -> bytes:
    return bytes(241)


async def times_out(slot: int, index: int) -> bytes:
    async with asyncio.timeout(0.01):
        await asyncio.sleep(1)
    return b""


async def fails(slot: int, index: int) -> bytes:
    raise KeyError(slot)


@pytest.mark.parametrize(
    ("function", "text"),
    [
        (
            plain,
            "(TypeError: on_read is an ordinary function, it has to be an async one: write async def)",
        ),
        (too_much, "its function failed (PduError: 241 octets of data, 240 are possible in one record)"),
        (times_out, f"(TimeoutError), in times_out(), {__name__}.py line {times_out.__code__.co_firstlineno + 1}"),
        (fails, f"(KeyError: 1), in fails(), {__name__}.py line {fails.__code__.co_firstlineno + 1}"),
    ],
)
def test_a_function_that_cannot_be_is_told_with_its_place(function: Any, text: str) -> None:
    told: list[str] = []

    async def main() -> None:
        world = World()
        slave = DpSlave(TYPE, lambda outputs, elapsed: outputs, on_read=function, ms2=1)
        async with (
            dpstack.serve_slave(slave, world=world, address=9, on_event=lambda e: told.append(e.text)) as server,
            dpstack.open_bus(world=world, baud=500_000, slaves=[TYPE.table(9)]) as bus,
        ):
            await bus.ready()
            with pytest.raises(dpstack.AcyclicError, match="read error"):
                await bus.slave(9).read(1, 2)
            async with bus.class2.connect(9) as connection:
                with pytest.raises(dpstack.AcyclicError, match="read error"):
                    await connection.read(1, 2)
            with pytest.raises(UsageError, match="data = 3 is no octets"):
                await server.slave.alarm(AlarmType.PROCESS, 1, data=odd(3))
            with pytest.raises(UsageError, match="data = 3 is no octets"):
                server.slave.status(1, 1, data=odd(3))

    virtual(main())
    assert any(re.search(re.escape(text), one) for one in told), told


def test_the_bus_is_closed_meanwhile() -> None:
    """Nothing is wrong with the slave: whoever drops slaves that fail must not drop this one."""

    async def never(slot: int, index: int) -> bytes:
        await asyncio.Event().wait()
        return b""

    async def main() -> list[bytes | BaseException]:
        world = World()
        slave = DpSlave(TYPE, lambda outputs, elapsed: outputs, on_read=never)
        async with dpstack.serve_slave(slave, world=world, address=9):
            async with dpstack.open_bus(world=world, baud=500_000, slaves=[TYPE.table(9)]) as bus:
                await bus.ready()
                asking = [asyncio.create_task(bus.slave(9).read(1, 2)) for _ in range(3)]
                await asyncio.sleep(0.1)
            return await asyncio.gather(*asking, return_exceptions=True)

    ends = virtual(main())
    assert len(ends) == 3
    for end in ends:
        assert isinstance(end, dpstack.BusError)
        assert str(end).startswith("this bus was closed: Read of slot 1, index 2 to slave 9 ")
