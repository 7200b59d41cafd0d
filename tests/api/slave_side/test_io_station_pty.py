"""`dpstack sim` of an I/O station behind a pty, and a master: what is done to it arrives and is acknowledged."""

from __future__ import annotations

import dpstack
from dpstack.api.config.config import make_config
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.slave_side.simulation import Simulation, sim_event_json


async def test_the_simulation_of_a_station() -> None:
    table = {
        "name": "io",
        "address": 8,
        "gsd": "io-station",
        "modules": ["8 DI", "8 DO"],
        "dpv1": {"alarms": ["pull_plug", "process"]},
    }
    config = make_config("/dev/elsewhere", 500_000, 2, [table])
    told: list[dict[str, object]] = []
    async with Simulation(config, "pty", 500_000) as simulation:
        simulation.on_event = lambda event: told.append(sim_event_json(event, 0.0))
        handlers = slave_handlers(simulation)
        async with dpstack.open_bus(config.with_bus(port=simulation.port_name)) as bus:
            await bus.operate()
            await bus.ready(20)
            stream = bus.slave("io").alarms(acknowledge=False)
            assert handlers["input"](["io", "1", "81"]) is None
            assert handlers["pull"](["8", "2"]) is None
            for slot in (1, 2):
                alarm = await anext(stream)
                assert alarm.slot == slot
                await alarm.acknowledge()
            assert await bus.slave("io").read(0, 2) == b"\x00\x03"
            assert bus.slave("io").inputs == b"\x81"
    acknowledged = [line["text"] for line in told if "acknowledged" in str(line.get("text"))]
    assert acknowledged == [
        "slave 8 (io): process alarm, slot 1: acknowledged by master 2",
        "slave 8 (io): pull alarm, slot 2, appears, slot disturbed: acknowledged by master 2",
    ]
