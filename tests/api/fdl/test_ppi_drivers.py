"""An S7-200 beside a slave on ptys with both drivers, both behind one port, as `dpstack sim` has them."""

from __future__ import annotations

from pathlib import Path

import pytest
from far_ends import until
from process_kit import DRIVERS, Driver

import dpstack
from dpstack.api.config.config import make_config
from dpstack.api.control.orders import carry_out
from dpstack.api.slave_side.simulation import Segment, Simulation
from dpstack.plant.orders import SetCpuValues

PRESS: dict[str, object] = {
    "address": 2,
    "name": "press",
    "values": {"level": "VW100", "on": "M0.3"},
    "allow_commands": ["on"],
    "poll_ms": 50,
}
VALVES = {"name": "valves", "address": 8, "ident": 1, "config": "20 10", "watchdog_ms": 3000}


@pytest.mark.parametrize("driver", DRIVERS)
async def test_values_and_orders(driver: Driver, tmp_path: Path) -> None:
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        plant = make_config(segment.paths[1], 1_500_000, 0, [VALVES]).with_ppi([PRESS])
        async with Simulation(plant, segment.paths[1], 1_500_000) as simulation:
            cpu = simulation.cpus[2]
            cpu.set_values({"level": 4711})
            async with dpstack.open_bus(
                port=segment.paths[0], baud=1_500_000, driver=driver, slaves=[VALVES], ppi=[PRESS], max_retry=7
            ) as bus:
                await bus.operate()
                await bus.ready(20)
                press = bus.cpu("press")
                await until(lambda: press["level"] == 4711, "the value")
                await carry_out(bus, SetCpuValues(2, {"on": True}), now=True)
                assert cpu.responder.cpu["M0.3"] is True
                cpu.power(False)
                await until(lambda: not press.ready_now, "the loss")
                assert not press.value("level").good
                assert bus.slave("valves").ready_now
