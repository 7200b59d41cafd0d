"""``slave.pa``: a process device over MS1 and MS2: walk, values in words, checked writes, dumps."""

from __future__ import annotations

import asyncio
import contextlib
import re
import struct
from collections.abc import AsyncIterator

import pytest
from api_kit import mirror, serving
from pa_kit import AI, PB, TB, Transmitter, block_object, f32, transmitter, words
from support import WorldFactory

import dpstack
from dpstack.api.pa.values import Meaning, value_of
from dpstack.errors import AcyclicError, SlaveFault, SlaveTimeout, UsageError
from dpstack.pa.blocks import BlockObject
from dpstack.pa.parameters import targets_of
from dpstack.pa.walk import Block, Layout
from dpstack.plant.quality import Quality
from dpstack.sim.world import World
from tests.pa.makers_octets import STATUS

pytestmark = pytest.mark.virtual_time


@contextlib.asynccontextmanager
async def on_bus(device: Transmitter, world: World | None = None) -> AsyncIterator[dpstack.Bus]:
    async with serving(mirror(on_read=device.read, on_write=device.write, ms2=1), world) as (bus, _):
        yield bus


async def test_the_blocks_and_one_value_with_unit_and_status(world: WorldFactory) -> None:
    device = Transmitter()
    async with on_bus(device, world()) as bus:
        pa = bus.slave("rig").pa
        assert pa is bus.slave("rig").pa
        assert [(one.name, one.slot, one.index) for one in await pa.blocks()] == [
            ("pb1", *PB),
            ("ai1", *AI),
            ("tb1", *TB),
        ]
        out = await pa.read("ai1.out")
        assert (out.text, out.unit, out.quality) == ("3.5 m", "m", Quality.GOOD)
        device.records[1, 26] = f32(3.25) + b"\x51"
        out = await pa.read("AI1.OUT")
        assert out.value == {"value": 3.25, "status": 0x51}
        assert out.quality is Quality.UNCERTAIN
        assert out.text == "3.25 m, uncertain: sensor conversion not accurate, low limit (status 51)"
        for name, text in (
            ("ai1.pv_scale", "0 to 10 mbar"),  # CHANNEL leads to the transducer block, which has the unit
            ("ai1.out_scale", "0 to 4 m"),
            ("ai1.out_scale.unit", "m"),
            ("ai1.channel", "tb1.primary_value (274)"),
            ("ai1.mode_blk", "AUTO (normal AUTO; permitted O/S, MAN, AUTO)"),
            ("tb1.lower_range", "0 mbar"),
            ("tb1.scale_in.eu_100", "400 mbar"),
            ("tb1.temperature", "21.5 °C"),
            ("tb1.primary_value", "350.1 mbar"),
            ("pb1.device_man_id", "Endress+Hauser (17)"),
            ("pb1.tag", "TANK LEVEL"),
            ("pb1.write_locking", "not locked (2457)"),
            ("1:130", "00 2a"),
            ("1:26", out.text),
        ):
            assert (await pa.read(name)).text == text, name
        over = bus.class2.connect("rig")
        async with over as connection:
            assert await connection.pa.read("ai1.out") == out


async def test_condensed_status_by_feature() -> None:
    device = Transmitter()
    device.records[0, 42] = b"\x03\0\0\0\x01\0\0\0"
    device.records[1, 26] = f32(3.25) + b"\xa4"
    async with on_bus(device) as bus:
        out = await bus.slave("rig").pa.read("ai1.out")
    assert (out.quality, out.text) == (Quality.GOOD, "3.25 m, good: maintenance required (status A4)")


async def test_a_write_is_checked_before_and_read_back() -> None:
    device = Transmitter()
    async with on_bus(device) as bus:
        pa = bus.slave("rig").pa
        done = await pa.write("tb1.lower_range", "-50")
        assert device.written == [(1, 114, f32(400.0, -50.0))]
        assert done.text == "tb1.scale_in.eu_0 = -50 mbar (before: 0 mbar), written and read back; ST_REV 7 -> 8"
        assert (await pa.write("tb1.temperature_unit", "K")).value.value == 1000
        assert (await pa.write("ai1.target_mode", "man")).value.text == "MAN"
        assert (await pa.write("ai1.out", {"value": 1.5, "status": 0x80})).value.text == "1.5 m"
        assert (await pa.write("ai1.simulate", "enabled=on value=2.5")).value.text == "on: 2.5 m"
        assert (await pa.write("ai1.fsafe_type", "last usable value")).value.value == 1
        device.written.clear()
        for name, value, why in (
            ("tb1.primary_value", 1.0, "tb1.primary_value can only be read"),
            (
                "ai1.pv_scale",
                "x",
                "it has the elements eu_100, eu_0: write eu_100=... eu_0=..., or ai1.pv_scale.eu_100",
            ),
            ("ai1.pv_scale", {"eu_0": 10}, "lower and upper end of the range are both 10"),
            ("ai1.pv_ftime", "much", "ai1.pv_ftime = much: a number is wanted"),
            ("ai1.alert_key", 256, "256 is outside 0 to 255"),
            ("ai1.channel", "-1", "outside 0 to 65535"),
            ("ai1.tag_desc", "x" * 33, "at most 32 characters"),
            ("ai1.target_mode", "cas", "ai1.target_mode: CAS is not permitted; the block has O/S, MAN, AUTO"),
            ("ai1.target_mode", "quick", "no mode: write AUTO, MAN"),
            ("tb1.sensor_unit", "furlong", "no unit of the profile"),
            ("tb1.cal_point_hi", 1001.0, "outside the sensor: -100 to 1000 mbar"),
            ("1:130", "0G", "write its octets as 00FF"),
            ("1:130", "00", "1:130 has 2 octets, 1 are given"),
            ("ai9.out", 1, "the device has no block 'ai9'; did you mean ai1?"),
            ("ai1.pvscale", 1, "no parameter 'pvscale'; did you mean pv_scale?"),
            ("ai1.pv_scale.eu0", 1, "did you mean eu_0?"),
        ):
            with pytest.raises(UsageError, match=".*".join(map(_escaped, [why]))):
                await pa.write(name, value)
        assert device.written == []
        await pa.write("ai1.target_mode", "auto")
        with pytest.raises(
            UsageError, match=r"in the modes MAN and O/S only, ai1 is in AUTO: write ai1\.target_mode MAN"
        ):
            await pa.write("ai1.out", {"value": 1.5})


def _escaped(text: str) -> str:
    return "".join(f"\\{one}" if one in ".()[]*+?|\\" else one for one in text)


@pytest.mark.parametrize("maker", sorted({row.source.maker for row in STATUS}))
def test_status_octets_that_makers_print_beside_a_value(maker: str) -> None:
    """Through the value of a parameter, in both codings."""
    block = Block("ai1", *AI, block_object(2, 1, 1, 46), BlockObject.parse(block_object(2, 1, 1, 46)))
    target = next(one for one in targets_of(block) if one.parameter == "out")
    for row in (row for row in STATUS if row.source.maker == maker):
        octets = [int(part, 16) for part in re.split(r"\W+", row.octets)]
        for octet in (octets[0], octets[-1]):
            found = value_of(target, f32(7.5) + bytes((octet,)), Meaning(Layout((block,), 1), row.coding), "bar")
            assert found.quality is not None
            assert found.quality.value == row.quality, (row.octets, found.text)
            assert row.says in found.text
            assert found.text.startswith("7.5 bar")


async def test_write_protection() -> None:
    device = Transmitter()
    async with on_bus(device) as bus:
        pa = bus.slave("rig").pa
        await pa.write("pb1.write_locking", "locked")
        with pytest.raises(UsageError, match=r"is locked \(WRITE_LOCKING is 0\): write pb1.write_locking 2457 unlocks"):
            await pa.write("tb1.lower_range", 1)
        await pa.write("pb1.write_locking", 2457)
        device.records[0, 41] = b"\x02"
        with pytest.raises(
            UsageError, match=r"write-protected at the device \(HW_WRITE_PROTECTION is 2\): release its"
        ):
            await pa.write("tb1.lower_range", 1)
        assert len(device.written) == 2
        # a device that does not say so refuses all the same
        device.records[0, 41] = b"\0"

        def refuse(slot: int, index: int, data: bytes | None) -> None:
            if data is not None:
                raise dpstack.RecordRefused(0xB6)

        device.on_access = refuse
        hint = r"some devices take it in O/S only, tb1 is in AUTO"
        with pytest.raises(
            AcyclicError, match=rf"^tb1\.scale_in\.eu_0 \({hint}\): slave 9 refuses Write of slot 1, index 114"
        ):
            await pa.write("tb1.lower_range", 1)


async def test_a_device_that_limits_what_is_written() -> None:
    device = Transmitter()
    async with on_bus(device) as bus:

        def limit(slot: int, index: int, data: bytes | None) -> None:
            if (slot, index) == (1, 114) and data is None and device.written:
                device.records[1, 114] = f32(400.0, 5.0)

        device.on_access = limit
        with pytest.raises(
            SlaveFault, match="eu_0 was written as 1 mbar, and the device has 5 mbar: it changes or limits"
        ):
            await bus.slave("rig").pa.write("tb1.lower_range", 1)


async def test_an_exchanged_device_is_walked_anew() -> None:
    device = Transmitter()
    async with on_bus(device) as bus:
        pa = bus.slave("rig").pa
        assert (await pa.read("tb1.sensor_value")).text == "350 mbar"
        moved = {
            (slot, index + 20 if (slot, index) >= TB and index < 0xE0 else index): octets
            for (slot, index), octets in transmitter().items()
        }
        moved[1, 1] = words(0x0104, 1, 0x0105, 1, 0x0106, 1, 0x0010, 29, 0x0164, 60, 0x0110, 46)
        device.records = moved
        assert (await pa.read("tb1.sensor_value")).index == 108


async def test_dump_compare_and_a_device_that_changes_meanwhile() -> None:
    device, other = Transmitter(), Transmitter(transmitter("S-2", "NEIGHBOUR"))
    other.records[1, 114] = f32(250.0, 0.0)
    other.records[1, 88] = f32(12.0)  # a measured value
    other.records[1, 130] = words(43)  # octets of the maker
    async with on_bus(device) as bus:
        one = await bus.slave("rig").pa.dump()
        assert one.remarks == ()
        assert (one.list.maker, one.list.device, one.list.serial, one.list.profile) == (17, "CERABAR", "S-1", "3.02")
        calls = 0

        def change(slot: int, index: int, data: bytes | None) -> None:
            nonlocal calls
            calls += (slot, index) == (1, 17)
            if (slot, index) == (1, 17) and calls == 2:
                device.records[1, 17] = words(9)

        device.on_access = change
        again = await bus.slave("rig").pa.dump()
        assert again.remarks == ("the device was changed while it was read (ai1 ST_REV 7 -> 9): it was read once more",)
    async with on_bus(other) as bus:
        found = await bus.slave("rig").pa.compare(one.list)
        assert [(diff.saved.name, diff.group) for diff in found.differences] == [
            ("pb1.tag_desc", "configuration"),
            ("pb1.device_ser_num", "identity"),
            ("tb1.scale_in", "configuration"),
        ]
        assert found.differences[2].text == "tb1.scale_in: file 0 to 400 mbar; device 0 to 250 mbar"
        assert found.differences[2].elements == ("eu_100",)
        more = await bus.slave("rig").pa.compare(one.list, everything=True)
        names = {diff.saved.name for diff in more.differences}
        assert {"tb1.sensor_value", "1:130"} <= names
    assert type(one.list).parse(one.list.text()) == one.list


async def test_a_slow_a_silent_and_a_lost_device() -> None:
    device = Transmitter(delay=0.3)
    async with on_bus(device) as bus:
        pa = bus.slave("rig").pa
        assert (await pa.read("ai1.out")).text == "3.5 m"
        device.delay = 60.0
        with pytest.raises(SlaveTimeout, match="slave 9"):
            await pa.read("ai1.out", timeout=1.0)
    busy = Transmitter()
    left = 3

    def refuse(slot: int, index: int, data: bytes | None) -> None:
        nonlocal left
        if left:
            left -= 1
            raise dpstack.RecordRefused(0xC2)

    busy.on_access = refuse
    async with on_bus(busy) as bus:
        assert (await bus.slave("rig").pa.read("ai1.out")).text == "3.5 m"


@pytest.mark.parametrize("records", [{}, {(1, 0): bytes(12)}, {(1, 0): b"PROFIBUS", (0, 16): bytes(20)}])
async def test_a_slave_that_is_no_process_device(records: dict[tuple[int, int], bytes]) -> None:
    async with on_bus(Transmitter(records)) as bus:
        with pytest.raises(SlaveFault, match=r"slave 9 \(rig\): no PROFIBUS PA device by its records: no directory"):
            await bus.slave("rig").pa.overview()


async def test_the_overview() -> None:
    device = Transmitter()
    device.records[0, 29] = b"\x20\0\0\x80"
    device.records[0, 30] = b"\x01\0\0\0\0\0"
    device.records[1, 26] = struct.pack(">f", float("nan")) + b"\x80"
    async with on_bus(device) as bus:
        found = await bus.slave("rig").pa.overview()
    assert (found.identity.maker, found.identity.device, found.identity.serial) == ("Endress+Hauser", "CERABAR", "S-1")
    assert (found.identity.profile, found.directory, found.write_protection) == ("3.02", 1, "none")
    assert found.diagnosis.category == "failure"
    assert found.diagnosis.texts[0].startswith("measurement failed")
    assert found.diagnosis.extension_texts == ("maker's bit 1",)
    function = found.blocks[1]
    assert (function.tag, function.target_mode, function.alarms) == ("FB PRESSURE", "AUTO", "none")
    out = function.values[0]
    assert out.quality is Quality.BAD
    assert "not a number" in out.text
    assert out.as_dict()["value"] == {"value": None, "status": 0x80}


async def test_readings_of_several_programs_at_once() -> None:
    async with on_bus(Transmitter()) as bus:
        pa = bus.slave("rig").pa
        texts = await asyncio.gather(*(pa.read(name) for name in ("ai1.out", "tb1.temperature", "pb1.tag_desc")))
        assert [one.text for one in texts] == ["3.5 m", "21.5 °C", "TANK LEVEL"]
