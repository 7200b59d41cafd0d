"""Drives in another process on a segment of ptys, run by one user's program. Assert what happens, never when."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from programs import Starter

import dpstack

PLANT = """
[bus]
port = "{port}"
baud = 500000

[[slave]]
name = "saw"
address = 5
drive = "keb-f5"
telegram = "PCH+4/4"

[slave.options]
control_bits = "enable=0 reset=1 run=2 reverse=3 quick_stop=8"
status_bits = "ready=0 fault=1 run=2 reverse=3 reached=4"
rpm_per_count = 1.0
reference_rpm = 1500
reference_hz = 50

[slave.simulated]
load = 0.5
"oP.28" = 0.1
"oP.30" = 0.1

[[slave]]
name = "pump"
address = 6
drive = "ls-s100"
telegram = "PPO1"
simulated = {{ dr-03 = 0.1, dr-04 = 0.1 }}
"""


def test_a_users_program_runs_a_keb_and_an_ls(tmp_path: Path, start: Starter) -> None:
    directory, config = tmp_path / "bus", tmp_path / "plant.toml"
    start.segment(directory)
    config.write_text(PLANT.format(port=directory / "1"), encoding="utf-8")
    start("sim", str(config), "--port", str(directory / "0"))  # the bus waits for its slaves

    async def main() -> dict[str, object]:
        async with dpstack.open_bus(config) as bus:
            await bus.operate()
            for name in ("saw", "pump"):
                drive = bus.drive(name)
                drive.speed = 0.5
                await drive.start(timeout=20)
                await drive.reached(timeout=20)
                assert drive.status.speed == pytest.approx(0.5, abs=0.02)
            saw = bus.drive("saw")
            await saw.write("oP.3", 20, data_set=2)
            assert await saw.read("oP.3", data_set=2) == 20.0
            assert await bus.drive("pump").read(965) == 0x0328
            values = await saw.order("inputs")
            await saw.stop(timeout=20)
            assert isinstance(values, dict)
            return values

    values = asyncio.run(main())
    assert values["sy.53 (2035h)"] == 750
