"""``connection.pa`` and the simulated process devices: all kinds, each layout, each lie, the maker's parameters."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

import dpstack
from dpstack.api.pa.device import PaDevice
from dpstack.errors import SlaveFault, UsageError
from dpstack.plant.quality import Quality

pytestmark = pytest.mark.virtual_time


@contextlib.asynccontextmanager
async def simulated(device: str, **simulated: Any) -> AsyncIterator[PaDevice]:
    """A device over a class 2 connection, beside data exchange."""
    table = {"name": "tank", "address": 8, "device": device, "simulated": simulated}
    async with dpstack.open_bus(port="virtual", baud=93_750, slaves=[table]) as bus:
        await bus.ready()
        async with bus.class2.connect("tank") as connection:
            yield connection.pa
        assert bus.slave("tank").ready_now


@pytest.mark.parametrize(
    ("device", "names", "value"),
    [
        ("pa-pressure", "pb1 ai1 tb1", "ai1.out = 1 bar"),
        ("pa-temperature", "pb1 ai1 tb1", "tb1.primary_value = 20 °C"),
        ("pa-level", "pb1 ai1 ai2 tb1", "ai2.out = 5 m"),
        ("pa-flow", "pb1 ai1 ai2 tot1 tb1", "ai1.pv_scale = 0 to 50 m³/h"),
        ("pa-positioner", "pb1 ao1 tb1", "ao1.check_back = in the fail-safe position"),
    ],
)
async def test_all_kinds_of_devices(device: str, names: str, value: str) -> None:
    async with simulated(device) as pa:
        assert [block.name for block in await pa.blocks()] == names.split()
        found = await pa.overview()
        assert (found.identity.device, found.remarks) == (device.upper(), ())
        name, text = value.split(" = ")
        assert (await pa.read(name)).text == text


async def test_what_an_actuator_does_without_supply_has_words() -> None:
    async with simulated("pa-positioner") as pa:
        assert (await pa.read("tb1.actuator_action")).text == "closing (2)"
        done = await pa.write("tb1.actuator_action", "opening")
        assert done.text.startswith("tb1.actuator_action = opening (1) (before: closing (2)), written and read back")


@pytest.mark.parametrize(
    "layout",
    [
        {"profile": 2},
        {"numbering": "anew"},
        {"numbering": "anew", "records": "one"},
        {"directory_slot": 0, "records": "one"},
        {"shifted": True},
    ],
    ids=str,
)
async def test_each_layout(layout: dict[str, Any]) -> None:
    async with simulated("pa-flow", **layout) as pa:
        walked = await pa.walk()
        assert [block.name for block in walked.blocks] == ["pb1", "ai1", "ai2", "tot1", "tb1"]
        assert (walked.directory, walked.remarks) == (layout.get("directory_slot", 1), ())
        assert (await pa.read("ai1.out")).text == "10 m³/h"


async def test_profile_2_with_blocks_100_higher_and_a_whole_device() -> None:
    async with simulated("pa-pressure", profile=2, numbering="anew", shifted=True) as pa:
        assert [(block.name, block.slot) for block in await pa.blocks()] == [("pb1", 1), ("ai1", 1), ("tb1", 1)]
        dumped = await pa.dump()
        assert (dumped.remarks, dumped.list.unreadable) == ((), ())
        assert (await pa.compare(dumped.list)).differences == ()


@pytest.mark.parametrize("lie", ["outside", "circles", "lengths", "short record"])
async def test_directories_that_lie(lie: str) -> None:
    async with simulated("pa-pressure", lie=lie) as pa:
        walked = await pa.walk()
        assert walked.directory is None
        assert [block.name for block in walked.blocks] == ["pb1", "ai1", "tb1"]
        assert walked.remarks[0].startswith("no usable directory (slot 1: ")
        assert (await pa.read("ai1.out")).quality is Quality.GOOD


async def test_devices_that_lie_elsewhere() -> None:
    async with simulated("pa-pressure", lie="long views") as pa:
        view = await pa.read("ai1.view_1")
        assert len(view.octets) == 240
        assert view.text.endswith("(240 octets, as many as a read carries: it may go on)")
    async with simulated("pa-pressure", lie="maker's unit") as pa:
        assert (await pa.read("ai1.out")).text.startswith("1 maker's unit ")
    async with simulated("pa-pressure", lie="short parameters") as pa:
        out = await pa.read("ai1.out")
        assert out.unreadable == "4 octets where data type value has 5 (3f 80 00 00)"
        with pytest.raises(UsageError, match="its other elements cannot be kept"):
            await pa.write("ai1.out_scale.eu_0", 1)
        assert len((await pa.overview()).blocks) == 3
    async with simulated("pa-pressure", lie="changing") as pa:
        remarks = (await pa.dump()).remarks
        assert "it was read once more" in remarks[0]
        assert "it changed during the second reading, too" in remarks[1]


DEVICE = """
format = 1
name = "mine"
title = "A transmitter with two parameters of its own"
base = "pa"
source = "made up for this test"
on_loss = "nothing: it has no set points"

[bus]
ident = 0x9700

[slots.1]
block = "AI"
name = "pressure"
unit = "bar"

[extension]
"0.5" = "outside its range"

[parameters]
most = { block = "TB1", relative = 9, type = "f32", unit = "bar", source = "this test" }
look = { slot = 1, index = 19, type = "u16", access = "rw", words = { 0 = "plain", 7 = "loud" }, source = "this test" }
"""


async def test_parameters_of_the_maker_and_its_words(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(DEVICE, encoding="utf-8")
    async with simulated(str(path)) as pa:
        assert (await pa.read("tb1.most")).text == "10 bar"
        assert (await pa.read("ai1.look")).text == "plain (0)"
        assert (await pa.write("ai1.look", "loud")).value.value == 7
        assert (await pa.read("1:19")).name == "ai1.look"
        with pytest.raises(UsageError, match="possible: plain, loud"):
            await pa.write("ai1.look", "shy")


async def test_a_device_that_is_no_process_device() -> None:
    async with dpstack.open_bus(
        port="virtual", baud=500_000, slaves=[{"name": "io", "address": 8, "gsd": "io-station", "modules": ["8 DI"]}]
    ) as bus:
        await bus.ready()
        async with bus.class2.connect("io") as connection:
            with pytest.raises(SlaveFault, match=r"slave 8 \(io\): no PROFIBUS PA device by its records"):
                await connection.pa.blocks()
