"""A drive of any maker with `drive = "profidrive"`, its GSD file and a telegram, without a device file."""

from __future__ import annotations

from pathlib import Path

import pytest

from dpstack import Drive
from dpstack.testing import BusFactory, SimulatedBus

GSD = Path(__file__).with_name("vendor.gsd")


def plant(dpstack_bus: BusFactory, telegram: str) -> SimulatedBus:
    slave = {"name": "fan", "address": 5, "drive": "profidrive", "gsd": str(GSD), "telegram": telegram}
    return dpstack_bus(slaves=[slave | {"reference_rpm": 1500}])


def runs(drive: Drive) -> bool:
    return drive.status.running


@pytest.mark.parametrize(
    ("telegram", "config", "ordered"),
    [
        ("1", "c3 c1 c1 fd 00 01", "04 7f e0 00"),
        ("2", "c3 c3 c3 fd 00 02", "04 7f e0 00 00 00 00 00"),
        ("PPO1", "f3 f1", "04 7f e0 00"),
    ],
)
def test_it_starts_follows_stops_trips_and_tells_the_number(
    dpstack_bus: BusFactory, telegram: str, config: str, ordered: str
) -> None:
    bus = plant(dpstack_bus, telegram)
    fan = bus.drive("fan")
    params = bus.config.slaves[0].params
    assert (params.ident, params.config.hex(" "), params.user_prm.hex(" ")) == (0x0FFD, config, "80 00 00 11 22")
    fan.speed = -0.5
    bus.run(fan.start())
    bus.run(fan.reached())
    assert fan.slave.outputs[-len(bytes.fromhex(ordered)) :].hex(" ") == ordered
    assert runs(fan)
    assert fan.status.speed == pytest.approx(-0.5, abs=0.01)
    assert fan.status.speed_rpm == pytest.approx(-750, abs=10)
    bus.run(fan.stop())
    assert not runs(fan)
    bus.run(fan.start())
    bus.faults.trip("fan", "7011")
    bus.run(bus.master.until(lambda: fan.status.fault == "number 7011", 5))
    assert fan.status.faults == ("number 7011",)
    bus.run(fan.acknowledge())
    assert fan.status.fault is None
    assert not runs(fan)
    bus.run(fan.start())


def test_a_parameter_is_read_by_its_number(dpstack_bus: BusFactory) -> None:
    bus = plant(dpstack_bus, "1")
    assert bus.run(bus.drive("fan").read(944)) == 0


def test_without_a_gsd_file_the_ident_number_is_made_up(dpstack_bus: BusFactory) -> None:
    bus = dpstack_bus(slaves=[{"name": "fan", "address": 5, "drive": "profidrive"}])
    bus.run(bus.drive("fan").start())
    assert bus.drive("fan").status.running
