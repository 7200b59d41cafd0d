"""An IMO HD2 on a bus: process data map, fault, and the one baud rate that its card accepts
(docs/reference/drives/imo-hd2.md#address-and-baud-rate)."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

import pytest
from api_kit import in_virtual_time, off_and_on, running, trip

import dpstack
from dpstack.api.config.config import make_config, slave_config
from dpstack.api.slave_side.simulation import Simulation
from dpstack.api.slave_side.virtual_bench import SimulatedSlave
from dpstack.params import BusParams

PUMP: Mapping[str, object] = {"name": "pump", "address": 5, "drive": "imo-hd2"}


@in_virtual_time
async def test_a_users_program() -> None:
    async with running(PUMP, 1_500_000) as (bus, pump):
        with pytest.raises(dpstack.DriveFault, match=r"none is 1; set P15\.02 to 1"):
            await pump.start()
        await pump.write_map(outputs="set_frequency torque", inputs="frequency current torque fault_code")
        pump.frequency = 25.0
        await pump.start()
        await pump.reached()
        await asyncio.sleep(0.5)
        status = pump.status
        assert status.speed == pytest.approx(0.5, abs=0.01)
        assert status.current is not None
        assert 0.3 < status.current < 0.6
        assert status.torque == pytest.approx(0.2, abs=0.02)
        assert await pump.order("output", number="torque", value=50.0) == 50.0
        with pytest.raises(dpstack.UsageError, match=r"torque 400 % is outside -300\.\.300 %"):
            await pump.order("output", number="torque", value=400.0)
        with pytest.raises(dpstack.UsageError, match="no quick stop ramp"):
            await pump.quick_stop()
        with pytest.raises(dpstack.UsageError, match=r"outside 0\.\.50 Hz"):
            pump.speed = 1.5
        with pytest.raises(dpstack.ParameterError, match="cannot be changed while the drive runs") as refused:
            await pump.write("P15.01", 7)
        assert refused.value.number == 8
        await trip(bus, pump, "OC1", "OC1 (code 4)")
        with pytest.raises(dpstack.DriveFault, match=r"OC1 \(code 4\); acknowledge it first"):
            await pump.start()
        await pump.acknowledge()
        await pump.start()
        await pump.stop()
        await pump.write("P00.10", 12.5)
        await off_and_on(bus, 5)
        assert await pump.read("P00.10") == 12.5  # its EEPROM
        await pump.start()  # and its map


@pytest.mark.parametrize(("options", "hears"), [({}, False), ({"baud_index": 6}, False), ({"baud_index": 5}, True)])
@in_virtual_time
async def test_i5_it_answers_only_at_the_rate_it_is_set_to(options: Mapping[str, object], hears: bool) -> None:
    slaves = [{**PUMP, "options": options}, {"name": "fan", "address": 6, "drive": "fuji-frenic"}]
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=slaves) as bus:
        await bus.operate()
        await asyncio.sleep(2)
        assert bus.slave("fan").ready_now
        assert bus.slave("pump").ready_now is hears
        wrong = [text for text in bus.plan.findings if "finds no baud rate by itself" in text]
        assert wrong == [] if hears else "slave 5 (pump): imo-hd2" in wrong[0]
        assert hears or "hears only 1.5 Mbit/s, not 500 kbit/s" in wrong[0]
        assert hears or "option baud_index" in wrong[0]


def test_i5_where_all_search_it_waits_at_its_rate() -> None:
    unit = SimulatedSlave(slave_config(PUMP), BusParams.preset(9_600), searching=True)
    assert unit.on_bus is unit.station
    assert unit.station.baud == 1_500_000
    unit.renew(BusParams.preset(9_600))
    assert unit.station.baud == 1_500_000


async def test_i5_a_port_at_another_rate_is_refused_with_the_option() -> None:
    config = make_config("pty", 500_000, 2, [PUMP])
    with pytest.raises(dpstack.ConfigError, match=r"hears only 1\.5 Mbit/s, not 500 kbit/s.*option baud_index"):
        Simulation(config, "pty", 500_000)


def test_i5_a_rate_that_profibus_does_not_have() -> None:
    with pytest.raises(dpstack.ConfigError, match="9 Mbit/s in the card's table"):
        make_config("virtual", 500_000, 2, [{**PUMP, "options": {"baud_index": 9}}])
