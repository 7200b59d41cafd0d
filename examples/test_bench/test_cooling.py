"""Tests of the application in virtual time, with simulated slaves: ``pytest examples/test_bench``."""

from __future__ import annotations

from pathlib import Path

import pytest
from cooling import control

from dpstack.testing import BusFactory, SimulatedBus

PLANT = Path(__file__).with_name("plant.toml")


@pytest.fixture
def bus(dpstack_bus: BusFactory) -> SimulatedBus:
    bus = dpstack_bus(PLANT)
    bus.device("tank").set(level=60)
    bus.run(control(bus.master, 3))
    return bus


def test_the_fan_runs_while_the_tank_is_full(bus: SimulatedBus) -> None:
    assert bus.device("fan").drive.motor.speed > 0.4
    bus.wire.assert_exchanged("tank", "01")
    bus.device("tank").set(level=40)
    bus.run(control(bus.master, 5))
    assert bus.device("fan").drive.motor.speed < 0.01


def test_the_valve_closes_without_the_fan(bus: SimulatedBus) -> None:
    bus.faults.silence("fan", 2)
    bus.run(control(bus.master, 1))
    assert bus.device("tank").outputs == b"\x00"
    bus.wait(2)
    bus.wire.assert_brought_up("fan")
    bus.wire.assert_last_outputs_safe("fan")


def test_the_end_leaves_safe_outputs(bus: SimulatedBus) -> None:
    bus.close()
    bus.wire.assert_clear()
    for name in ("fan", "tank"):
        bus.wire.assert_last_outputs_safe(name)
