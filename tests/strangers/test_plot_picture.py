"""The picture of ``dpstack plot``: a recording of the simulated plant of docs/pictures/plant.toml in virtual time.

With DPSTACK_PICTURES=docs/pictures it is written there.
"""

from __future__ import annotations

import asyncio
import math
from pathlib import Path

import pytest
from api_kit import bench_of
from pictures_kit import copy_plant, picture_folder

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.cli.main import main

pytestmark = pytest.mark.strangers

#: the shown slaves and columns
SHOWN = ("fan.setpoint", "fan.speed", "fan.frequency_hz", "tank.level", "mixer.state", "fan.drive_state", "valves.full")


async def record(file: Path, recording: Path) -> None:
    """Twelve seconds: the fan ramps twice, the level goes up and down, the mixer loses its power for 1.5 s."""
    async with dpstack.open_bus(file) as bus:
        await bus.ready()
        await bus.operate()
        order = slave_handlers(bench_of(bus), core_of(bus))
        fan = bus.drive("fan")
        async with bus.record(recording, on_change=True):
            for tenth in range(120):
                level = round(16 + 12 * math.sin(tenth / 24)) / 2
                order["set"]([f"tank.level={level}", "tank.temperature=40"])
                match tenth:
                    case 10:
                        await fan.start()
                    case 20:
                        fan.speed = 0.6
                    case 60:
                        order["power-off"](["mixer"])
                    case 75:
                        order["power-on"](["mixer"])
                    case 90:
                        fan.speed = 0.2
                if tenth % 30 == 15:
                    order["set"]([f"valves.full={'on' if tenth % 60 == 15 else 'off'}"])
                await asyncio.sleep(0.1)


def test_picture_of_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = picture_folder(tmp_path)
    monkeypatch.chdir(tmp_path)
    # the title has the name of the file
    dpstack.run_virtual(record(copy_plant(tmp_path), tmp_path / "simulated.csv"))
    png = tmp_path / "picture.png"
    assert main(["plot", "simulated.csv", *SHOWN, "--write", str(png)]) == 0
    octets = png.read_bytes()
    assert octets.startswith(b"\x89PNG")
    assert len(octets) > 20_000
    (target / "plot.png").write_bytes(octets)
