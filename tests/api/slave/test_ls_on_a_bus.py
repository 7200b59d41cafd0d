"""An LS S100 on a bus: profiles by configuration, power-off, faults."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from api_kit import off_and_on, running, trip

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
