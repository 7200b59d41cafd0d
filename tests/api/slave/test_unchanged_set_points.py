"""A set point that the drive gets already is compared only; in all other cases its assignment is an order."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from api_kit import stack_of

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.dp.master.commands import DriveCommand
from dpstack.dp.master.events import DriveEvent
from dpstack.machine import HeldUp
from dpstack.testing import BusFactory, SimulatedBus
from dpstack.units import NS_PER_MS

FAN = {"name": "fan", "address": 4, "drive": "ls-s100"}
#: few telegrams a second
BAUD = 93_750


def plant(dpstack_bus: BusFactory, **keys: Any) -> SimulatedBus:
    return dpstack_bus(slaves=[FAN], baud=BAUD, **keys)


def results(bus: SimulatedBus) -> int:
    """The number of orders that the plugin has answered."""
    return sum(isinstance(one, DriveEvent) and one.payload["type"] == "result" for one in bus.events)


def assign(bus: SimulatedBus, value: Any, rotations: int = 3) -> int:
    """Assign the set point; the number of orders that the plugin has answered for it."""
    before = results(bus)
    bus.drive("fan").speed = value
    bus.wait(rotations * 0.01)
    return results(bus) - before


def set_point(bus: SimulatedBus) -> str:
    """The last set point on the wire, as hex."""
    outputs = bus.wire.last_outputs("fan")
    assert outputs is not None
    return outputs[-2:].hex()


@pytest.fixture
def bus(dpstack_bus: BusFactory) -> SimulatedBus:
    bus = plant(dpstack_bus)
    bus.run(bus.drive("fan").start())
    assert assign(bus, 0.5) == 1
    assert set_point(bus) == "2000"
    return bus


def test_no_order_for_the_set_point_that_it_gets(bus: SimulatedBus) -> None:
    assert assign(bus, 0.5) == 0
    assert assign(bus, 0.25) == 1
    assert set_point(bus) == "1000"
    assert assign(bus, 0.5) == 1
    fan = bus.drive("fan")
    hertz = fan.frequency
    before = results(bus)
    fan.frequency = hertz
    bus.wait(0.05)
    assert results(bus) == before
    assert fan.speed == 0.5


def test_the_wire_is_the_same_as_with_orders(dpstack_bus: BusFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Octets and times, with the comparison and without it."""

    async def control(bus: dpstack.Bus) -> None:
        fan = bus.drive("fan")
        await fan.start()
        async for cycle in bus.cycles():
            fan.speed = 0.5 if cycle.number % 50 < 30 else 0.25
            if cycle.number > 200:
                break

    logs = []
    for compared in (True, False):
        bus = plant(dpstack_bus)
        if not compared:
            monkeypatch.setattr(bus.drive("fan"), "_is_unchanged", lambda _: False)
        bus.run(control(bus.master))
        bus.wait(0.1)
        logs.append((results(bus), bus.wire.text(2_000, every=True)))
    assert logs[0][1] == logs[1][1]
    assert logs[0][0] < 20 < 150 < logs[1][0]


def test_another_order_came_between(bus: SimulatedBus) -> None:
    """What another door has ordered counts, not what this program has assigned last."""
    core_of(bus.master).command(DriveCommand(4, "speed", {"value": 0.25}, 4711))
    bus.wait(0.05)
    assert set_point(bus) == "1000"
    assert assign(bus, 0.5) == 1
    assert set_point(bus) == "2000"


def test_the_order_before_is_not_answered(bus: SimulatedBus) -> None:
    """Of several assignments in a row the last one counts."""
    fan = bus.drive("fan")
    fan.speed = 0.25
    fan.speed = 0.5
    assert fan.speed == 0.5
    bus.wait(0.05)
    assert set_point(bus) == "2000"


def test_after_clear(bus: SimulatedBus) -> None:
    bus.run(bus.master.clear())
    bus.wait(0.05)
    assert assign(bus, 0.5) == 1  # held: an order for later
    held = bus.slave("fan").held_because
    assert held is not None
    assert "the bus is in Clear" in held
    bus.run(bus.master.operate())
    bus.wait(0.1)
    assert set_point(bus) == "2000"
    assert assign(bus, 0.5) == 0


def test_after_a_stall(bus: SimulatedBus) -> None:
    gap = HeldUp(5_000 * NS_PER_MS, "the computer was suspended for 5000 ms", suspended=True)
    stack_of(bus.master).station.held_up(gap, core_of(bus.master).runtime.now())
    bus.wait(0.1)
    assert bus.master.mode.name == "CLEAR"
    assert assign(bus, 0.5) == 1
    held = bus.slave("fan").held_because
    assert held is not None
    assert "stall" in held
    bus.run(bus.master.operate())
    bus.wait(0.1)
    assert assign(bus, 0.5) == 0


def test_after_its_return(bus: SimulatedBus) -> None:
    bus.faults.silence("fan", 1)
    bus.wait(0.8)
    assert bus.slave("fan").state is not dpstack.SlaveState.DATA_EXCHANGE
    assert assign(bus, 0.5) == 1
    bus.wait(1)
    bus.run(bus.slave("fan").ready())
    bus.run(bus.drive("fan").settled())
    assert assign(bus, 0.5) == 0
    assert set_point(bus) == "2000"


def test_assignments_do_not_feed_the_application_watchdog(dpstack_bus: BusFactory) -> None:
    """Neither as orders nor as comparisons: ``alive()`` does. After it has run out they are held."""
    bus = plant(dpstack_bus, application_watchdog_ms=100)
    fan = bus.drive("fan")

    async def program(alive: Callable[[], None]) -> None:
        for _ in range(30):
            fan.speed = 0.5
            alive()
            await asyncio.sleep(0.01)

    bus.run(program(bus.master.alive))
    assert bus.master.mode.name == "OPERATE"
    bus.run(program(lambda: None))
    assert bus.master.mode.name == "CLEAR"
    assert assign(bus, 0.5) == 1
    held = bus.slave("fan").held_because
    assert held is not None
    assert "application watchdog" in held


def test_a_failed_plugin_refuses(bus: SimulatedBus, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(inputs: bytes, now: int) -> bytes:
        raise ZeroDivisionError("a defect")

    fan = bus.drive("fan")
    monkeypatch.setattr(fan._core, "cyclic", broken)
    bus.wait(0.1)
    fan.speed = 0.5
    with pytest.raises(dpstack.DpError, match="plugin failed"):
        bus.run(fan.start())


@pytest.mark.parametrize("value", [True, "0.5", float("nan"), 10**400, float("inf"), 3.0, None])
def test_what_is_no_set_point_is_refused_as_before(bus: SimulatedBus, value: Any) -> None:
    with pytest.raises(dpstack.UsageError, match="drive fan: "):
        bus.drive("fan").speed = value
    assert set_point(bus) == "2000"


def test_a_closed_bus_refuses(bus: SimulatedBus) -> None:
    bus.run(bus.master.close())
    with pytest.raises(dpstack.UsageError, match="the bus is "):
        bus.drive("fan").speed = 0.5
