"""Drives with other settings than their plugins expect: the error of `start()` and the status of a run."""

from __future__ import annotations

import asyncio
import json

import pytest
from api_kit import bench_of, in_operate, running
from support import instance, present

import dpstack
from dpstack.api.config.config import parse_config
from dpstack.api.control.handlers import run_status
from dpstack.errors import DriveFault
from dpstack.profile import DriveDevice

pytestmark = pytest.mark.virtual_time

PLANT = """
[bus]
port = "virtual"
baud = 1500000

[[slave]]
name = "hoist"
address = 3
drive = "demag-dedrive"
simulated = { 412 = 1, 390 = 60 }

[[slave]]
name = "fan"
address = 4
drive = "fuji-frenic"
simulated = { F03 = 50 }

[[slave]]
name = "mixer"
address = 5
drive = "imo-hd2"
simulated = { "P15.02" = 1, "P00.06" = 0 }

[[slave]]
name = "saw"
address = 6
drive = "keb-f5"
simulated = { "oP.00" = 0 }

[[slave]]
name = "pump"
address = 7
drive = "ls-s100"
simulated = { dr-07 = 0 }

[[slave]]
name = "blower"
address = 8
drive = "fuji-frenic"
telegram = "PPO3"
"""
SAYS = {
    "hoist": "390 is 60 Hz in data set 1",
    "fan": "F03 is 50 Hz, not 60 Hz",
    "mixer": "P00.06 is 0, not 9",
    "saw": "oP.00 is 0, not 5",
    "pump": "dr-07 is 0, not 8",
}


async def test_each_drive_is_refused_and_the_status_of_the_run_says_why() -> None:
    async with in_operate(dpstack.open_bus(parse_config(PLANT, "plant.toml"))) as bus:
        for name, says in SAYS.items():
            with pytest.raises(DriveFault, match=f"drive {name}: .*{says}"):
                await bus.drive(name).start()
            assert not bus.drive(name).status.running
        await bus.drive("blower").start()
        slaves = json.loads(json.dumps(run_status(bus)))["slaves"]
        for address, (name, says) in enumerate(SAYS.items(), 3):
            told = slaves[str(address)]["drive"]
            assert told["settings"] == "different", name
            assert any(says in text for text in told["settings_texts"])
        assert slaves["8"]["drive"]["settings"] == "not_checked"
        assert "PPO3 has no parameter channel" in slaves["8"]["drive"]["settings_texts"][0]


async def test_a_drive_that_comes_back_with_other_settings_is_refused() -> None:
    """The drive has other settings after power-on: the comparison begins again with data exchange."""
    fan = {"name": "fan", "address": 4, "drive": "fuji-frenic"}
    async with running(fan, 1_500_000) as (bus, drive):
        await drive.start()
        await drive.stop()
        device = instance(bench_of(bus).device(4), DriveDevice)
        present(device.store).install("F03", 100)
        bench_of(bus).silence(4, 500_000_000)
        await bus.until(lambda: not bus.slave("fan").ready_now, 5)
        await bus.ready()
        await asyncio.sleep(0.2)
        assert drive.status.settings == "different"
        await drive.acknowledge()  # Er5: its watchdog ended data exchange
        with pytest.raises(DriveFault, match="F03 is 100 Hz, not 60 Hz"):
            await drive.start()
