"""Data exchange broadcast on ptys with both drivers: publisher and subscriber are behind one port, as `dpstack sim` has
them."""

from __future__ import annotations

from pathlib import Path

import pytest
from far_ends import until
from process_kit import DRIVERS, Driver, bus_on

from dpstack.api.config.config import make_config
from dpstack.api.slave_side.simulation import Segment, Simulation
from tests.api.bus.test_dxb_bus import ENCODER, VALVE


@pytest.mark.parametrize("driver", DRIVERS)
async def test_the_value_of_a_publisher(driver: Driver, tmp_path: Path) -> None:
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        plant = make_config(segment.paths[1], 1_500_000, slaves=[ENCODER, VALVE])
        async with Simulation(plant, segment.paths[1], 1_500_000) as simulation:
            table = VALVE | {"watchdog_ms": 3000}
            async with bus_on(segment.paths[0], driver, ENCODER | {"watchdog_ms": 3000}, table) as bus:
                await bus.operate()
                await bus.ready(20)
                bus.slave("encoder").outputs = b"\x11\x12\x13\x14"
                bus.slave("valve").outputs = b"\x01\x02\x03\x04\x05\x06"
                await until(lambda: bus.slave("valve").inputs == b"\x01\x02\x03\x12\x13\x06", "the publisher's value")
            assert simulation.slaves[1].app.stats.failures == 0


@pytest.mark.parametrize("driver", DRIVERS)
async def test_a_subscriber_joins_leaves_and_joins_again(driver: Driver, tmp_path: Path) -> None:
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        plant = make_config(segment.paths[1], 1_500_000, slaves=[ENCODER, VALVE])
        async with (
            Simulation(plant, segment.paths[1], 1_500_000),
            bus_on(segment.paths[0], driver, ENCODER | {"watchdog_ms": 3000}) as bus,
        ):
            await bus.operate()
            await bus.ready(20)
            bus.slave("encoder").outputs = b"\x11\x12\x13\x14"
            # the first one restarts its publisher, the second one finds it publishing
            for restart in (True, False):
                valve = await bus.add_slave(VALVE | {"watchdog_ms": 3000}, restart_publishers=restart)
                await bus.ready(20)
                valve.outputs = b"\x01\x02\x03\x04\x05\x06"
                await until(lambda: bus.slave("valve").inputs == b"\x01\x02\x03\x12\x13\x06", "the publisher's value")
                await until(lambda: [link.good for link in bus.slave("valve").links] == [True], "the link")
                await bus.remove("valve")
