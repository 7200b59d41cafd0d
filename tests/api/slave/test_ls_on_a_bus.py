"""An LS S100 on a bus: profiles by configuration, Clear and Stop, power-off, faults."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path

import pytest
from api_kit import device_of, off_and_on, running, trip

import dpstack

pytestmark = pytest.mark.virtual_time

PUMP: Mapping[str, object] = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "PPO1"}
LS = {"profile": "ls"}


async def test_a_users_program() -> None:
    async with running(PUMP) as (bus, pump):
        pump.frequency = 30.0
        await pump.start()
        await pump.reached()
        assert pump.status.frequency_hz == pytest.approx(30, abs=0.5)
        assert await pump.read(918) == 6
        assert await pump.read("baud_rate") == 4  # 500 kbit/s
        await pump.write("dr-03", 2.5)
        await trip(bus, pump, "LV", "34 LV")
        with pytest.raises(dpstack.DriveFault, match="34 LV; acknowledge it first"):
            await pump.start()
        await pump.acknowledge()
        await pump.start()
        await pump.quick_stop()
        with pytest.raises(dpstack.ParameterError, match="error 0, illegal parameter number"):
            await pump.read("dr-99")
        with pytest.raises(dpstack.UsageError, match="dr-20"):
            pump.speed = 1.5
        await off_and_on(bus, 6)
        assert await pump.read("dr-03") == 2.5  # its EEPROM


@pytest.mark.parametrize("way", ["clear", "stop"])
@pytest.mark.parametrize(("telegram", "options"), [("PPO3", {}), ("PPO3", LS), ("VENDOR 2/3", {})])
async def test_a_running_drive_comes_to_rest(telegram: str, options: Mapping[str, object], way: str) -> None:
    """The safe outputs stop it before Clear, whose zeros PROFIdrive ignores."""
    table = {**PUMP, "telegram": telegram, "options": options}
    async with running(table) as (bus, pump):
        device = device_of(bus, 6)
        await pump.start()
        pump.speed = 0.5
        await pump.reached()
        await (bus.clear() if way == "clear" else bus.stop())
        await asyncio.sleep(0.15)
        await bus.clear()
        await asyncio.sleep(2)
        assert device.motor.frequency == 0
        await bus.operate()
        await asyncio.sleep(0.5)
        assert device.motor.frequency == 0
        assert pump.speed == 0.5  # the set point stays, the run command does not


async def test_the_message_about_a_wrong_profile_names_the_parameter() -> None:
    async with running({**PUMP, "options": LS}) as (_, pump):
        await pump.start()
        await pump.stop()
        with pytest.raises(dpstack.UsageError, match="no quick stop"):
            await pump.quick_stop()
        await pump.write("COM-11", 1)
        await pump.write("COM-94", 1)
        with pytest.raises(dpstack.DriveFault, match="set COM-11 to 2 and COM-94 to 1"):
            await pump.start()


def test_a_note_about_made_up_identifier_octets(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text(
        """
[bus]
port = "/dev/ttyUSB0"
baud = 500000

[[slave]]
name = "pump"
address = 6
drive = "ls-s100"
telegram = "VENDOR 3/2"
options = { para_control = "0005 0006 dr-03=1" }
""",
        encoding="utf-8",
    )
    slave = dpstack.load_config(path).slaves[0]
    assert slave.params.config.hex() == "6251"
    assert "identifier octets 62 51 of ls-s100 are in no manual" in slave.notes[0]
