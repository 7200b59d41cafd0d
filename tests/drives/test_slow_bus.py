"""A rotation longer than the drive's own scans: inputs belong to the outputs only when these have gone round."""

from __future__ import annotations

import pytest
from drive_bench import ALONE, MS, PluginBench

import dpstack
from dpstack_drives.fuji import DRIVE

pytestmark = pytest.mark.virtual_time

RUNNING_AT_HALF = "03 37 20 00"  # bit 8: the set point is reached


def running() -> PluginBench:
    """At half speed, 90 ms a rotation: a slave with PPO2 at 9.6 kbit/s."""
    bench = PluginBench(DRIVE.core("fan", "PPO3"), "02 31 00 00", rotation=90 * MS)
    bench.order("speed", value=0.5)
    start = bench.order("start")
    bench.see(RUNNING_AT_HALF, 4)
    assert bench.done(start)["ok"]
    return bench


def test_reached_may_still_be_said_of_the_last_set_point() -> None:
    bench = running()
    bench.order("speed", value=1.0)
    reached = bench.order("reached")
    assert bench.see(RUNNING_AT_HALF, 3) == "04 7F 40 00"
    assert bench.result(reached) is None
    bench.see("02 37 28 00", 3)
    assert bench.result(reached) is None
    assert bench.value(reached, "03 37 40 00") == 1.0


def test_settled_waits_for_the_outputs_to_go_round() -> None:
    bench = running()
    token = bench.order_and_run(3, "settled")
    assert bench.result(token) is None
    bench.run()
    assert bench.value(token) == "running"


def test_settled_waits_for_the_name_of_a_fault() -> None:
    zero = "00 00 00 00 00 00 00 00 "
    bench = PluginBench(DRIVE.core("fan", "PPO1", ALONE), zero + "02 78 00 00")
    token = bench.order_and_run(40, "settled")
    assert bench.result(token) is None
    bench.see("43 B3 01 00 00 00 75 11 02 78 00 00", 2)  # Er5, by PNU 947
    assert bench.done(token)["ok"]
    assert bench.core.status().faults == ("Er5 field bus communications error",)


@pytest.mark.parametrize("drive", ["fuji-frenic", "ls-s100"])
async def test_a_program_at_9600(drive: str) -> None:
    slave = {"name": "fan", "address": 6, "drive": drive, "telegram": "PPO2"}
    async with dpstack.open_bus(port="virtual", baud=9_600, slaves=[slave]) as bus:
        fan = bus.drive("fan")
        await bus.ready(30)
        await bus.operate()
        await fan.settled()
        for speed in (0.5, 1.0, 0.25):
            fan.speed = speed
            await fan.start(timeout=20)
            await fan.reached()
            assert fan.status.speed == pytest.approx(speed, abs=0.01)
