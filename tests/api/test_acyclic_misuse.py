"""What people hand to acyclic services by mistake: refused at once, with what is wanted; nothing is sent."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable
from typing import Any, cast

import pytest
from api_kit import virtual

import dpstack
from dpstack import AlarmType, DpSlave, Im1, RecordRefused, SlaveDescription, UsageError
from dpstack.profile.acyclic import Address
from dpstack.sim.world import World

TYPE = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, alarms=("process",))
PUMP = {"name": "pump", "address": 6, "drive": "ls-s100"}
Call = Callable[[dpstack.Slave, dpstack.Connection], Awaitable[Any]]
#: what no type checker would let through
ODD = cast(Any, None)


def odd(value: object) -> Any:
    return value


CALLS: dict[str, tuple[Call, str]] = {
    "an int is no octets": (lambda s, c: s.write(1, 1, odd(3)), "data = 3 are no octets: give bytes, for instance b"),
    "nor is a text": (lambda s, c: s.write(1, 1, odd("00")), "data = '00' are no octets: give bytes, .*fromhex"),
    "nor nothing": (lambda s, c: s.write(1, 1, ODD), "data = None are no octets"),
    "nor numbers beyond": (lambda s, c: s.write(1, 1, odd([1, 256])), r"data = \[1, 256\] are no octets"),
    "class 2": (lambda s, c: c.write(1, 1, odd(3)), "data = 3 are no octets"),
    "Data_Transport": (lambda s, c: c.transport(1, 1, odd(3)), "data = 3 are no octets"),
    "a slot": (lambda s, c: s.read(odd("1"), 1), "slot = '1' is no whole number"),
    "an index": (lambda s, c: c.read(1, odd(1.0)), "index = 1.0 is no whole number"),
    "a length": (lambda s, c: s.read(1, 1, odd("2")), "length = '2' is no whole number"),
    "no time": (lambda s, c: s.read(1, 1, timeout=odd("1")), "timeout = .1. is no time for a service: seconds are"),
    "an I&M number": (lambda s, c: s.im(odd("0")), "there is no I&M'0': 0..4"),
    "an I&M class": (lambda s, c: s.write_im(odd(Im1)), "is no I&M record: give one of Im1 to Im4"),
    "an I&M table": (lambda s, c: s.write_im(odd({"date": "2026"})), "is no I&M record: give one of Im1 to Im4"),
    "no list": (lambda s, c: s.parameters().read(odd(930)), "930 is no list of parameters: give for instance"),
    "one address": (lambda s, c: s.parameters().read(odd(Address(930))), "is no list of parameters"),
    "a name": (lambda s, c: s.parameters().read([odd("p930")]), "'p930' is no parameter: give its number, or Add"),
    "no values": (lambda s, c: s.parameters().change([odd((Address(930), 5))]), "give a list of .Address"),
}


@pytest.mark.parametrize("name", CALLS)
def test_refused_at_once(name: str) -> None:
    call, text = CALLS[name]

    async def main() -> None:
        async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[PUMP]) as bus:
            await bus.ready()
            async with bus.class2.connect("pump") as connection:
                at = asyncio.get_running_loop().time()
                with pytest.raises(UsageError, match=text):
                    await call(bus.slave("pump"), connection)
                assert asyncio.get_running_loop().time() == at

    virtual(main())


def test_what_is_meant_well() -> None:
    async def main() -> None:
        async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[PUMP]) as bus:
            await bus.ready()
            pump = bus.slave("pump").parameters()
            assert await pump.read([930, 918]) == await pump.read([Address(930), Address(918)])
            assert await pump.read(range(930, 931)) == await pump.read([930])
            for where in ({"slot": 255}, {"object": 256}, {"object": "1"}):
                with pytest.raises(UsageError, match=f"{next(iter(where))} = .* a whole number 0.."):
                    bus.slave("pump").parameters(**odd(where))
            with pytest.raises(UsageError, match="source = 5 are no octets"):
                bus.class2.connect("pump", source=odd(5))

    virtual(main())


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
        (plain, "its function failed (TypeError: on_read is no async function: define it with `async def`)"),
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
            with pytest.raises(UsageError, match="data = 3 are no octets"):
                await server.slave.alarm(AlarmType.PROCESS, 1, data=odd(3))
            with pytest.raises(UsageError, match="data = 3 are no octets"):
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
        assert str(end).startswith("Read of slot 1, index 2 to slave 9 has no end")
        assert str(end).endswith("this bus was closed")
