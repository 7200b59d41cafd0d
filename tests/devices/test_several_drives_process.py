"""Several drives of one slave in a bus process: status, orders, parameters and octets of each."""

from __future__ import annotations

from pathlib import Path

from far_ends import until
from process_kit import UNHURRIED

import dpstack
from dpstack.api.config.config import make_config
from dpstack.api.slave_side.simulation import Segment, Simulation
from dpstack.profile import State
from tests.devices.test_several_drives import CU320


async def test_a_bus_process_has_all_drives_of_a_slave(tmp_path: Path) -> None:
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        plant = make_config(segment.paths[1], 1_500_000, slaves=[CU320])
        bus = dpstack.open_bus(port=segment.paths[0], baud=1_500_000, driver="process", slaves=[CU320], **UNHURRIED)
        async with Simulation(plant, segment.paths[1], 1_500_000), bus:
            await bus.operate()
            await bus.ready(60)
            first, second = bus.drives
            assert await second.read(944, timeout=60) == 0
            second.speed = 0.5
            await second.start(timeout=60)
            await until(lambda: second.status.running, "the status of the second drive")
            await until(lambda: bus.slave(5).outputs.hex(" ", 2) == "047e 0000 047f 2000 0000 0000", "its outputs")
            assert first.status.state is State.READY_TO_SWITCH_ON
            assert (first.status.setpoint, second.status.setpoint) == (0.0, 0.5)
