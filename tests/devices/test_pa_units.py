"""Units of values, read from the function blocks of a PA device over MS1 or class 2."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from api_kit import in_virtual_time, slave_in
from support import WorldFactory

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.slave import block_units
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.sim.world import World
from dpstack.trace import Notice

TANK: dict[str, Any] = {"name": "tank", "address": 5, "device": "vegabar-65", "modules": ["AI", "AI"]}
#: OUT_SCALE: EU100 100.0, EU0 0.0, the code of the unit, decimal point (DS-36); 1001 degC, 1137 bar, 1138 mbar
SCALE = "42 C8 00 00 00 00 00 00 {:04X} 01"


@pytest.fixture(autouse=True)
def a_minute_is_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(block_units, "LOOK_S", 2.0)


class Blocks:
    """The records of two AI blocks in slots 1 and 2; the block object stands at index 16."""

    def __init__(self) -> None:
        self.records = {(1, 17): "00 01", (1, 28): SCALE.format(1137), (2, 17): "00 01", (2, 28): SCALE.format(1001)}
        self.asked: list[tuple[int, int]] = []

    def ask(self, request: RecordRequest) -> None:
        place = request.service.slot, request.service.index
        self.asked.append(place)
        if place not in self.records:
            request.refuse(Code.INVALID_INDEX)
        else:
            request.answer(bytes.fromhex(self.records[place]))


class Transmitter:
    """A bus with the transmitter of ``blocks``, which has connections of class 2."""

    def __init__(self, world: World, blocks: Blocks, **more: object) -> None:
        self.blocks = blocks
        user_prm = bytes.fromhex(str(more.get("user_prm", "")))
        description = SlaveDescription(
            ident=0x076F, configs=(bytes.fromhex("94 94"),), user_prm_len=(len(user_prm), 237)
        )
        device = DpSlave(description, lambda outputs, elapsed: bytes.fromhex("40 F0 00 00 80 41 AC 00 00 80"))
        device.records, device.ms2 = blocks, 1
        self.station, self.app = slave_in(world, device, 5)
        slaves = [{**TANK, **more}]
        self.bus = dpstack.open_bus(port="virtual", baud=500_000, slaves=slaves, world=world, cycle_ms=50)

    @property
    def units(self) -> dict[str, str]:
        return dict(self.bus.slave("tank").config.input_fields.units)

    @property
    def told(self) -> list[str]:
        return [
            one.message for one in core_of(self.bus).past_events() if isinstance(one, Notice) and one.source == "units"
        ]


async def until(condition: Callable[[], bool]) -> None:
    for _ in range(200):
        if condition():
            return
        await asyncio.sleep(0.05)
    raise AssertionError("not within 10 s")


@pytest.mark.parametrize("way", ["class 2", "MS1"])
@in_virtual_time
async def test_units_are_read_once_and_again_when_a_block_has_changed(way: str, world: WorldFactory) -> None:
    more = {"dpv1": True, "user_prm": "80 00 00"} if way == "MS1" else {}
    one = Transmitter(world(), Blocks(), **more)
    async with one.bus as bus:
        assert one.units == {"temperature": "degC"}  # of the device file
        await bus.operate()
        await bus.ready()
        await until(lambda: one.units == {"pressure": "bar", "temperature": "°C"})
        assert one.blocks.asked == [(1, 17), (1, 28), (2, 17), (2, 28)]
        assert core_of(bus).services.connections == {}
        one.blocks.records |= {(1, 28): SCALE.format(1138), (1, 17): "00 02"}
        one.blocks.asked.clear()
        await asyncio.sleep(block_units.LOOK_S + 1)
        assert one.blocks.asked == [(1, 17), (1, 28), (2, 17)]
        assert one.units == {"pressure": "mbar", "temperature": "°C"}
        slave = bus.slave("tank")
        await slave.deactivate()
        one.blocks.records[2, 28] = SCALE.format(1002)
        await slave.activate()
        await until(lambda: one.units == {"pressure": "mbar", "temperature": "°F"})  # it may be another device
    assert one.told == []


@in_virtual_time
async def test_a_unit_that_the_plant_file_gives_stays(world: WorldFactory) -> None:
    inputs = {"pressure": {"at": "f32@0", "status": "u8@4", "quality": "pa-classic", "unit": "m"}}
    one = Transmitter(world(), Blocks(), inputs=inputs)
    async with one.bus as bus:
        await bus.operate()
        await until(lambda: one.units == {"pressure": "m", "temperature": "°C"})


@pytest.mark.parametrize(
    ("records", "told", "units"),
    [
        ({}, "slave 5 (tank): units of its blocks could not be read: ", {"temperature": "degC"}),
        (
            {(1, 28): "00 00"},
            "slave 5 (tank): units of its blocks could not be read: slot 1 index 28 has 2 octets, the profile gives",
            {"temperature": "°C"},
        ),
    ],
)
@in_virtual_time
async def test_reads_that_fail_are_reported_once_and_change_nothing(
    records: dict[tuple[int, int], str], told: str, units: dict[str, str], world: WorldFactory
) -> None:
    blocks = Blocks()
    blocks.records = blocks.records | records if records else {}
    one = Transmitter(world(), blocks)
    async with one.bus as bus:
        await bus.operate()
        await bus.ready()
        before = bus.stats.slaves[5].exchanges
        await asyncio.sleep(3 * block_units.LOOK_S)
        (text,) = one.told
        assert text.startswith(told)
        assert text.endswith("; those of its device file count")
        assert one.units == units
        stats = bus.stats.slaves[5]
        assert (stats.retries, stats.timeouts) == (0, 0)
        assert stats.exchanges > before
        assert bus.slave("tank")["pressure"] == 7.5


@in_virtual_time
async def test_a_unit_as_text_cannot_hurt_a_terminal(world: WorldFactory) -> None:
    """Code 1995: the unit is a text of the device, OUT_UNIT_TEXT at relative index 35."""
    blocks = Blocks()
    blocks.records |= {(1, 28): SCALE.format(1995), (1, 51): b"kg\x1b[2J/m2      ".hex()}
    one = Transmitter(world(), blocks)
    async with one.bus as bus:
        await bus.operate()
        await until(lambda: "pressure" in one.units)
        assert one.units["pressure"].isprintable()
        assert "[" not in one.units["pressure"]


@in_virtual_time
async def test_no_units_are_read_on_request(world: WorldFactory) -> None:
    one = Transmitter(world(), Blocks(), options={"units": False})
    async with one.bus as bus:
        await bus.operate()
        await bus.ready()
        await asyncio.sleep(5)
        assert (one.blocks.asked, one.told) == ([], [])


@in_virtual_time
async def test_the_bus_ends_while_units_are_read(world: WorldFactory) -> None:
    class Silent(Blocks):
        def ask(self, request: RecordRequest) -> None:
            self.asked.append((request.service.slot, request.service.index))

    one = Transmitter(world(), Silent())
    async with one.bus as bus:
        await bus.operate()
        await until(lambda: bool(one.blocks.asked))
