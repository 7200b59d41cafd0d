"""Faults of the testing kit and of ``dpstack ctl`` in both worlds, held against one table."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from dpstack import SlaveState
from dpstack.api.control.commands import SEGMENT, SLAVES
from dpstack.api.slave_side.fault_steps import KINDS
from dpstack.testing import BusFactory, Fault, Faults
from tests.testing.injected_faults import ELSEWHERE, FAN, ROWS, Place, Row, call, carry_out, port_place, virtual_place

pytestmark = pytest.mark.virtual_time

#: members of the kit that are no fault
_NO_FAULT = {"active", "begin", "clear"}
#: commands that end a fault, or only ask
_NO_FAULT_ON_A_LINE = {"stats"}


def called(row: Row) -> str:
    """The method of the kit that the row calls."""
    names: list[str] = []

    class Asked:
        def __getattr__(self, name: str) -> object:
            names.append(name)
            return lambda *_args, **_keys: None

    if row.kit is not None:
        row.kit(Asked())  # type: ignore[arg-type]
    return "".join(names)


def test_every_fault_has_a_row() -> None:
    commands = [words.split() for row in ROWS for words in (*row.begin, *row.end) if not row.line]
    tried = {words[0] for words in commands} | set(ELSEWHERE)
    assert {spec.name for spec in SLAVES} == tried
    assert set(KINDS) == {words[2] for words in commands if words[0] == "fault"}
    on_line = {words.split()[0] for row in ROWS if row.line for words in (row.line, *row.end)}
    assert {spec.name for spec in SEGMENT} - _NO_FAULT_ON_A_LINE == on_line
    of_kit = {name for name in vars(Faults) if not name.startswith("_")} - _NO_FAULT
    assert of_kit == {called(row) for row in ROWS} - {"", "begin"}
    assert {name for name in vars(Fault) if not name.startswith("_")} == {"acts", "end"}


async def test_by_commands_on_a_simulated_bus() -> None:
    async with virtual_place() as place:
        await by_commands(place)


async def test_by_calls_of_the_kit() -> None:
    async with virtual_place() as place:
        await place.bus.operate()
        faults = place.faults
        assert faults is not None
        for row in ROWS:
            if row.kit is not None:
                await call(place, row, faults)


@pytest.mark.strangers
def test_by_commands_behind_a_port() -> None:
    async def program() -> None:
        async with port_place() as place:
            await by_commands(place)

    asyncio.run(program())


@pytest.mark.strangers
def test_by_commands_of_a_segment(tmp_path: Path) -> None:
    async def program() -> None:
        async with port_place(tmp_path / "segment") as place:
            await by_commands(place)

    asyncio.run(program())


async def by_commands(place: Place) -> None:
    """The rows of the line on a segment, all others elsewhere."""
    await place.bus.operate()
    for row in ROWS:
        order = place.line if row.line else place.order if place.line is None else None
        if order is not None and (row.line or row.begin):
            await carry_out(place, row, order)


def test_a_silenced_slave_is_safe_to_the_millisecond(dpstack_bus: BusFactory) -> None:
    """Its watchdog runs while it is cut off; later it is brought up as one that wants parameters."""
    bus = dpstack_bus(slaves=[{**FAN, "watchdog_ms": 100}], baud=187_500)
    fan = bus.device("fan")
    bus.run(bus.drive("fan").start())
    began = bus.now
    with bus.faults.silence("fan", 1):
        bus.wait(0.095)  # the last request came a few milliseconds before
        assert (fan.exchanging, fan.outputs[:2], fan.drive.motor.on) == (True, b"\x04\x7f", True)
        bus.wait(0.010)
        assert (fan.exchanging, fan.outputs, fan.drive.motor.on) == (False, b"", False)
        bus.wait(0.8)
        assert bus.slave("fan").state is SlaveState.OFFLINE
    bus.run(bus.slave("fan").ready(10))
    bus.wait(0.1)
    bus.wire.assert_brought_up("fan", since=began)
    bus.wire.assert_last_outputs_safe("fan")


def test_a_motor_has_no_power_while_its_drive_is_off(dpstack_bus: BusFactory) -> None:
    bus = dpstack_bus(slaves=[FAN], baud=187_500)
    fan = bus.device("fan")
    bus.run(bus.drive("fan").start())
    bus.drive("fan").speed = 0.5
    bus.wait(2)
    turning = fan.drive.motor.speed
    with bus.faults.power_off("fan"):
        assert (fan.exchanging, fan.outputs, fan.drive.motor.on) == (False, b"", False)
        bus.wait(0.2)
        assert not fan.drive.motor.on
        assert 0 < fan.drive.motor.speed < turning / 2  # it coasts against its load
