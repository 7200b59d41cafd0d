"""Wrong arguments of the DP-V1 API raise at once, name the type expected, and send nothing to the bus."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from api_kit import HOIST, bus_of, mirror, serving

import dpstack
from dpstack import ConfigError, Im0, Im1, IoStation, RecordRefused, UsageError
from dpstack.errors import PduError
from dpstack.profile.record47 import Address
from dpstack.slave import DpSlave, SlaveDescription

pytestmark = pytest.mark.virtual_time

VALVES = SlaveDescription.simple(0x4711, inputs=2, outputs=1, name="valves", dpv1=True, alarms=("process",))


def cycle(outputs: bytes, elapsed: int) -> bytes:
    return bytes(2)


@pytest.mark.parametrize(
    ("modules", "text"),
    [
        ([1, 2], "there is no module 1; there are: 8 DI, 16 DI"),
        ([b"8 DI"], "there is no module b'8 DI'"),
        ("8 DI", 'modules = \'8 DI\' is no list: write ["8 DI", "8 DO"]'),
        (None, "modules = None is no list"),
        (5, "modules = 5 is no list"),
    ],
)
def test_modules_of_an_io_station(modules: Any, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        IoStation.of(modules)
    assert text in str(caught.value)


@pytest.mark.parametrize("config", ["10", 16, None, {0x10: 0x20}, {0x10, 0x20}])
def test_identifier_octets_of_an_io_station(config: Any) -> None:
    with pytest.raises(ConfigError, match="is no octets: give bytes"):
        IoStation(config)


def test_orders_to_an_io_station() -> None:
    io: Any = IoStation.of(["8 DI", "8 DO", "2 AI"])
    orders: list[tuple[Callable[[], object], str]] = [
        (lambda: io.set_input(1, "05"), "inputs = '05' is no octets"),
        (lambda: io.set_input(1, 5), "inputs = 5 is no octets"),
        (lambda: io.pull("1"), "slot = '1' is no whole number"),
        (lambda: io.pull(None), "slot = None is no whole number"),
        (lambda: io.wire_break(3, "0", True), "channel = '0' is no whole number"),
        (lambda: io.set_parameter(1, b"\1"), "parameter octet = b'\\x01' is no whole number"),
    ]
    for order, text in orders:
        with pytest.raises(ValueError, match="is no") as caught:
            order()
        assert text in str(caught.value)
    io.pull(2)
    with pytest.raises(ValueError, match="there is no module 3"):
        io.plug(2, 3)


@pytest.mark.parametrize(
    ("given", "error", "text"),
    [
        ({"description": {}}, ConfigError, "made of a SlaveDescription, not of {}: SlaveDescription.simple(0x1234"),
        ({"on_cycle": None}, ConfigError, "slave valves: on_cycle = None is no function"),
        ({"on_read": 5}, ConfigError, "slave valves: on_read = 5 is no function"),
        ({"on_im": "x"}, ConfigError, "slave valves: on_im = 'x' is no function"),
        ({"ms2": 50}, ConfigError, "slave valves: ms2 = 50: 0 to 49 class 2 connections are possible"),
        ({"ms2": -1}, ConfigError, "ms2 = -1: 0 to 49"),
        ({"ms2": "2"}, ConfigError, "ms2 = '2' is no whole number"),
        ({"config": "10"}, ConfigError, "slave valves: config = '10' is no octets"),
        ({"safe": "00"}, ConfigError, "slave valves: safe = '00' is no octets"),
        ({"parameters": 5}, ConfigError, "parameters = 5: give dpstack.profile.record47.TimedRecords"),
        ({"im": ["x"]}, PduError, "'x' is no I&M record: give Im0(order_id=...)"),
        ({"im": Im0(order_id="V")}, PduError, "is no list: write [Im0(order_id=...), Im1()]"),
        ({"im": 5}, PduError, "I&M = 5 is no list"),
        ({"im": {"1": [Im0()]}}, PduError, "slot of I&M = '1' is no whole number"),
    ],
)
def test_impossible_slaves(given: dict[str, Any], error: type[Exception], text: str) -> None:
    arguments: dict[str, Any] = {"description": VALVES, "on_cycle": cycle, **given}
    with pytest.raises(error) as caught:
        DpSlave(**arguments)
    assert text in str(caught.value)


def test_im_from_a_generator() -> None:
    slave = DpSlave(VALVES, cycle, im=(record for record in (Im0(order_id="V"), Im1("fan"))))
    assert [type(record) for record in slave.im] == [Im0, Im1]


Use = Callable[[], Awaitable[object]]


async def refused(uses: list[tuple[Use, str]], error: type[Exception] = UsageError) -> None:
    for use, text in uses:
        with pytest.raises(error) as caught:
            await use()
        assert text in str(caught.value)


async def test_arguments_of_services_and_alarms() -> None:
    slave = DpSlave(VALVES, cycle, im=[Im0(order_id="V")], ms2=1)
    async with serving(slave) as (bus, server):
        served: Any = server
        await refused(
            [
                (lambda: served.alarm("process", 1), "type = 'process' is no whole number"),
                (lambda: served.alarm(2, "1"), "slot = '1' is no whole number"),
                (lambda: served.alarm(2, 1, data="x"), "data = 'x' is no octets"),
            ]
        )
        for states in (5, ["ok"], [4], []):
            with pytest.raises(UsageError, match="is no list of ModuleState"):
                served.module_status(states)
        one: Any = bus.slave("valves")
        class2: Any = bus.class2
        at_it: list[tuple[Use, str]] = [
            (lambda: one.read("1", 2), "slot = '1' is no whole number"),
            (lambda: one.read(1, None), "index = None is no whole number"),
            (lambda: one.read(1, 2, "3"), "length = '3' is no whole number"),
            (lambda: one.read(1, 2, timeout="x"), "timeout = 'x' is no time for a service"),
            (lambda: one.write(1, 2, "ab"), "data = 'ab' is no octets"),
            (lambda: one.write(1, 2, 5), "data = 5 is no octets"),
            (lambda: one.write(1, 2, [256]), "data = [256] is no octets"),
            (lambda: one.im("0"), "number of I&M = '0' is no whole number"),
            (lambda: one.im(0, slot="x"), "slot = 'x' is no whole number"),
            (lambda: one.im(0, timeout="x"), "timeout = 'x' is no time"),
            (lambda: one.write_im("x"), "'x' is no I&M record: give Im1(tag_function=...)"),
            (lambda: one.parameters(1).read(5), "5 is no list of parameters: give for instance [930, Address("),
        ]
        await refused(at_it)
        for wrong, text in (({"slot": "1"}, "slot = '1'"), ({"object": "q"}, "object = 'q'")):
            with pytest.raises(UsageError, match=f"{text} is no whole number"):
                one.parameters(**wrong)
        arguments: list[tuple[dict[str, Any], str]] = [
            ({"source": "ab"}, "source = 'ab' is no octets"),
            ({"source": b"\0"}, "an address in Initiate has API and access level, 1 octets are given"),
            ({"send_timeout": "1"}, "no time"),
        ]
        for wrong, text in arguments:
            with pytest.raises(UsageError, match=text):
                class2.connect(9, **wrong)
        for nobody in (1.5, None):
            with pytest.raises(UsageError, match=f"{nobody} is no slave: give its address, 0..126, its name"):
                class2.connect(nobody)
        await refused(
            [
                (lambda: class2.diagnosis(None), "None is no slave"),
                (lambda: class2.set_address("126", "5"), "old = '126' is no whole number"),
            ]
        )
        async with bus.class2.connect(9) as opened:
            connection: Any = opened
            await refused(
                [
                    (lambda: connection.read("1", 2), "slot = '1' is no whole number"),
                    (lambda: connection.write(1, 2, "ab"), "data = 'ab' is no octets"),
                    (lambda: connection.transport(0, 0, "ab"), "data = 'ab' is no octets"),
                    (lambda: connection.im("x"), "number of I&M = 'x' is no whole number"),
                ]
            )
            assert opened.is_open
            assert [there.services for there in server.connections] == [0]


async def test_several_parameters_of_a_drive() -> None:
    async with bus_of(HOIST) as bus:
        await bus.ready()
        hoist: Any = bus.drive("hoist")
        await refused(
            [
                (lambda: hoist.read_many(5), "parameters = 5 is no list"),
                (lambda: hoist.read_many("x"), "is no list"),
            ]
        )


# --- Wrong arguments of acyclic services are refused at once, the message names the type expected, nothing is sent --


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
