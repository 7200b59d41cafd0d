"""Wrong arguments of acyclic services are refused at once, the message names the type expected, nothing is sent."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from api_kit import mirror, serving

import dpstack
from dpstack import RecordRefused, UsageError
from dpstack.profile.record47 import Address
from dpstack.slave import SlaveDescription

pytestmark = pytest.mark.virtual_time

RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, alarms=("process",))
PUMP = {"name": "pump", "address": 6, "drive": "ls-s100"}


def odd(value: object) -> Any:
    return value


async def test_the_list_of_parameters() -> None:
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


def test_messages_need_an_open_bus() -> None:
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
async def test_a_failed_function_is_reported_with_its_place(function: Any, text: str) -> None:
    events: list[dpstack.Event] = []
    async with serving(mirror(RIG, on_read=function, ms2=1), events=events) as (bus, slave):
        with pytest.raises(dpstack.AcyclicError, match="read error"):
            await bus.slave(9).read(1, 2)
        async with bus.class2.connect(9) as connection:
            with pytest.raises(dpstack.AcyclicError, match="read error"):
                await connection.read(1, 2)
        with pytest.raises(UsageError, match="data = 3 is no octets"):
            slave.status(1, 1, data=odd(3))
    assert any(text in event.text for event in events), events


async def test_services_end_with_the_bus() -> None:
    """The error blames the bus: a program that drops slaves with errors must not drop this one."""

    async def never(slot: int, index: int) -> bytes:
        await asyncio.Event().wait()
        return b""

    async with serving(mirror(RIG, on_read=never)) as (bus, _):
        reads = [asyncio.create_task(bus.slave(9).read(1, 2)) for _ in range(3)]
        await asyncio.sleep(0.1)
    ends = await asyncio.gather(*reads, return_exceptions=True)
    assert len(ends) == 3
    for end in ends:
        assert isinstance(end, dpstack.BusError)
        assert str(end).startswith("this bus was closed: Read of slot 1, index 2 to slave 9 ")
