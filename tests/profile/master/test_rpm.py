"""Set points and actual speed in rpm, by the reference of the profile or of an option."""

from __future__ import annotations

import dataclasses

import pytest
from drive_bench import PluginBench
from profidrive_kit import DRIVE, READY, STD1, Core

import dpstack
from dpstack.api.bus.opening import open_bus
from dpstack.api.config.config import parse_config
from dpstack.api.control.drive_orders import carry_out, find_order
from dpstack.errors import UsageError
from dpstack.profile import DriveProfile, Options

RPM = dataclasses.replace(DRIVE, reference_rpm=1500.0)
PLANT = """
[bus]
port = "virtual"
baud = 500000
[[slave]]
name = "mill"
address = 6
drive = "keb-f5"
reference_rpm = 3000
options = { control_bits = "simulated", status_bits = "simulated" }
"""


def bench(profile: DriveProfile, options: Options) -> PluginBench:
    return PluginBench(Core(profile, "belt", STD1, {"check_settings": False, **options}), READY)


@pytest.mark.parametrize(
    ("options", "rpm", "word", "shown"),
    [({}, 750.0, "20 00", 750.0), ({"reference_rpm": 3000.0}, 750.0, "10 00", 1500.0), ({}, -1500.0, "C0 00", 750.0)],
)
def test_the_set_point_in_rpm(options: Options, rpm: float, word: str, shown: float) -> None:
    drive = bench(RPM, options)
    assert drive.done(drive.order("rpm", value=rpm))["speed_rpm"] == rpm
    assert drive.out()[6:] == word
    drive.see("00 40 20 00")
    assert drive.core.status().speed_rpm == shown
    assert drive.core.status().as_dict()["speed_rpm"] == shown
    assert drive.core.status().unknown().speed_rpm is None


def test_a_drive_whose_reference_nobody_knows_has_no_rpm() -> None:
    drive = bench(DRIVE, {})
    assert "give the drive its option reference_rpm" in drive.misuse("rpm", value=100)
    drive.see("00 40 20 00")
    assert drive.core.status().speed_rpm is None
    assert "speed_rpm" not in drive.done(drive.order("speed", value=0.5))


def test_a_program_sets_and_reads_rpm() -> None:
    async def program() -> tuple[float | None, float, float]:
        config = parse_config(PLANT)
        async with open_bus(config) as bus:
            mill = bus.drive("mill")
            await bus.operate()
            await bus.ready()
            mill.rpm = 600.0
            await mill.start(30)
            await mill.reached(30)
            return mill.status.speed_rpm, mill.rpm, mill.speed

    actual, wanted, part = dpstack.run_virtual(program())
    assert actual == pytest.approx(600, abs=30)
    assert wanted == pytest.approx(600)
    assert part == pytest.approx(0.2)


def test_an_order_of_the_shell_and_of_a_control_client() -> None:
    async def program() -> dict[str, object]:
        async with open_bus(parse_config(PLANT)) as bus:
            await bus.operate()
            await bus.ready()
            return await carry_out(*find_order(bus, ["now", "mill", "rpm", "600"]))

    status = dpstack.run_virtual(program())["status"]
    assert isinstance(status, dict)
    assert status["setpoint"] == pytest.approx(0.2)
    assert "speed_rpm" in status


def test_a_program_is_told_that_the_reference_is_missing() -> None:
    async def program() -> None:
        config = parse_config(PLANT.replace("keb-f5", "fuji-frenic").partition("reference_rpm")[0])
        async with open_bus(config) as bus:
            with pytest.raises(UsageError, match="drive mill: nobody knows how many rpm 100 % is"):
                bus.drive("mill").rpm = 600

    dpstack.run_virtual(program())
