"""Process data as classes, typed values, waiting for inputs: against octets, in virtual time."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import replace
from typing import assert_type

import pytest
from api_kit import RAW, bench_of, bus_of, operating

import dpstack
from dpstack import Bool, Int, Octets, Scaled, SlaveTimeout, UsageError, at

pytestmark = pytest.mark.virtual_time

VALVES: dict[str, object] = {
    **RAW,
    "name": "valves",
    "config": "23 13",
    "inputs": {
        "limit": "bool@0.3",
        "level": {"at": "i16@2", "scale": 0.1, "unit": "bar"},
        "count": "u8@1",
    },
    "outputs": {"flap": "bool@0.3", "target": {"at": "i16@2", "scale": 0.1, "unit": "bar"}, "step": "u8@1"},
}


class Valves(dpstack.Inputs):
    limit: Bool = at(0, 3)
    count: Int = at(1, "u8")
    level: Scaled = at(2, "i16", scale=0.1, unit="bar")
    raw: Octets = at(2, 2)


class Named(dpstack.Inputs):
    level: Scaled = at()
    count: Scaled = at()


class Orders(dpstack.Outputs):
    flap: Bool = at(0, 3)
    target: Scaled = at()


async def test_inputs_of_one_exchange_with_their_types() -> None:
    async with operating(VALVES) as bus:
        slave = bus.slave("valves")
        bench_of(bus).units[9].set_inputs(bytes.fromhex("0805001f"))
        await slave.until(lambda v: bool(v["limit"]), 1)
        valves = slave.inputs_as(Valves)
        assert_type(valves, Valves)
        assert_type(valves.limit, bool)
        assert_type(valves.level, float)
        assert_type(valves.raw, bytes)
        assert valves == Valves(limit=True, count=5, level=3.1, raw=b"\x00\x1f")
        assert repr(slave.inputs_as(Named)) == "Named(level=3.1, count=5.0)"
        assert_type(slave.value("level", float), float)
        assert (slave.value("level", float), slave.value("count", int), slave.value("count", float)) == (3.1, 5, 5.0)
        with pytest.raises(UsageError, match=r"slave 9 \(valves\): limit is bool, not int"):
            slave.value("limit", int)
        with pytest.raises(UsageError, match="did you mean level"):
            slave.value("levle", float)


async def test_outputs_change_only_the_bits_that_the_class_has() -> None:
    async with operating(VALVES) as bus:
        slave = bus.slave("valves")
        slave["step"] = 7
        orders = slave.outputs_as(Orders)
        assert orders == Orders(flap=False, target=0.0)
        slave.send(replace(orders, flap=True, target=-1.5))
        assert slave.outputs == bytes.fromhex("0807fff1")
        says = r"slave 9 \(valves\): Orders: target = 1000000000\.0 is outside -3276\.8\.\.3276\.7 bar"
        with pytest.raises(UsageError, match=says):
            slave.send(Orders(flap=False, target=1e9))
        assert slave.outputs == bytes.fromhex("0807fff1")


class Far(dpstack.Inputs):
    level: Scaled = at(3, "i16")


class Other(dpstack.Inputs):
    level: Scaled = at(2, "i16", scale=0.01, unit="bar")


class Unknown(dpstack.Inputs):
    levle: Scaled = at()


class WrongKind(dpstack.Inputs):
    level: Int = at()


class NoPlace(dpstack.Inputs):
    level: str = at(2, "i16")


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        (Far, r'Far: level = "i16@3" ends in octet 4; its configuration has octets 0\.\.3 of its process data'),
        (
            Other,
            r"Other: level is i16@2, scale 0\.01, offset 0, bar here and i16@2, scale 0\.1, offset 0, bar in",
        ),
        (Unknown, r"Unknown: the configuration names no levle; it names: limit, level, count"),
        (WrongKind, r"WrongKind: level is i16@2, scale 0\.1, offset 0, bar, which is no Int: annotate it as Scaled"),
        (NoPlace, r"NoPlace: level is no field; write level: Bool = at\(0, 3\), or Int, Scaled, Octets"),
    ],
)
async def test_a_class_that_does_not_fit_the_configuration(kind: type[dpstack.Inputs], says: str) -> None:
    async with operating(VALVES) as bus:
        with pytest.raises(UsageError, match=rf"^slave 9 \(valves\): {says}"):
            bus.slave("valves").inputs_as(kind)


async def test_until_says_why_it_was_not_reached() -> None:
    async with operating(VALVES) as bus:
        slave, bench = bus.slave("valves"), bench_of(bus)
        says = r"not reached in 0\.1 s: its inputs are valid, the condition is not true"
        with pytest.raises(SlaveTimeout, match=says):
            await slave.until(lambda v: bool(v["limit"]), 0.1)
        bench.power(9, False)
        await bus.until(lambda: slave.fault is not None, 5)
        says = r"slave 9 \(valves\): not reached in 2 s: stopped answering during Data_Exchange; check its power"
        with pytest.raises(SlaveTimeout, match=says):
            await slave.until(lambda _: True, 2)
        bench.power(9, True)
        with pytest.raises(UsageError, match="no input is called 'limt'; did you mean limit"):
            await slave.until(lambda v: bool(v["limt"]), 60)


async def test_changes_are_told_while_the_inputs_are_valid_and_end_with_the_bus() -> None:
    told: list[object] = []
    async with bus_of(VALVES) as bus:
        slave, bench = bus.slave("valves"), bench_of(bus)

        async def read() -> None:
            async for value in slave.changes("level"):
                told.append(value)  # noqa: PERF401 - it is looked at meanwhile

        reading = asyncio.create_task(read())
        await bus.operate()
        await bus.ready()
        for octets in ("00000001", "00000001", "ff000001", "00000020"):
            bench.units[9].set_inputs(bytes.fromhex(octets))
            await asyncio.sleep(0.05)
        bench.power(9, False)
        await bus.until(lambda: slave.fault is not None, 5)
        bench.units[9].set_inputs(bytes.fromhex("00000030"))
        await asyncio.sleep(0.5)
        assert told == [0.1, 3.2]
        with pytest.raises(UsageError, match="no input is called 'levle'; did you mean level"):
            await anext(slave.changes("levle"))
    with contextlib.suppress(asyncio.CancelledError):
        await reading
    assert told == [0.1, 3.2]


async def test_the_mode_of_the_bus_is_waited_for() -> None:
    async with bus_of(VALVES, auto_clear=True) as bus:
        waiting = asyncio.create_task(bus.wait_state(dpstack.Mode.OPERATE, 5))
        await bus.operate()
        await waiting
        assert repr(bus) == "<Bus virtual 500 kbit/s operate, 1 of 1 slaves>"
        with pytest.raises(TimeoutError):
            await bus.wait_state(dpstack.Mode.CLEAR, 0.1)
    assert repr(bus) == "<Bus virtual 500 kbit/s not open>"
