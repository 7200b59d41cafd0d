"""S7-200 without await: a CPU by itself, and one of a plant."""

from __future__ import annotations

from far_ends import eventually

import dpstack
from dpstack import blocking
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.ppi import CpuStation


def test_a_cpu_by_itself() -> None:
    world = dpstack.World()
    world.add(PassiveStation(2, CpuStation(), BusParams.preset(187_500, address=2)), name="CPU")
    with blocking.open_ppi(2, world=world, baud=187_500, hsa=5, timeout=60) as cpu:
        cpu.write("VW100", 5)
        assert cpu.read("VW100") == 5
        assert cpu.read_all(["VW100", "M0.0"]) == [5, False]
        assert cpu.station.is_open


def test_a_cpu_of_a_plant() -> None:
    press = {"address": 2, "name": "press", "values": {"level": "VW100"}, "poll_ms": 20}
    with blocking.open_bus(port="virtual", baud=187_500, hsa=5, ppi=[press]) as bus:
        cpu = bus.cpu("press")
        cpu.write("level", 7)
        eventually(lambda: cpu["level"] == 7, "the value")
        assert cpu.value("level").value == 7
        assert [one.name for one in bus.cpus] == ["press"]
        assert cpu.cpu.read("VW100") == 7
