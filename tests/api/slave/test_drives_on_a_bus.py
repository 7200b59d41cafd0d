"""Drives on a bus: options in the configuration, orders, process data maps, power-off, faults."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path

import pytest
from api_kit import off_and_on, running, trip

import dpstack
from dpstack.api.config.config import make_config, slave_config
from dpstack.api.slave_side.simulation import Simulation
from dpstack.api.slave_side.virtual_bench import SimulatedSlave
from dpstack.params import BusParams

pytestmark = pytest.mark.virtual_time

SAW: Mapping[str, object] = {"name": "saw", "address": 5, "drive": "keb-f5", "telegram": "PCH+8/8"}
INPUTS, OUTPUTS = "ru.12:long sy.51 sy.53", "cS.19:long sy.50 sy.52"


async def test_a_users_program_with_a_keb() -> None:
    """Start, a map that acts after power-on, and a fault."""
    async with running(SAW) as (bus, saw):
        await saw.start()
        saw.frequency = 25.0
        await saw.reached()
        assert saw.status.speed == pytest.approx(0.5, abs=0.01)
        assert saw.status.frequency_hz == pytest.approx(25, abs=0.5)
        await saw.stop()
        await saw.write("oP.3", -12.5, data_set=3)
        assert await saw.read("oP.3", data_set=3) == -12.5
        with pytest.raises(dpstack.ParameterError, match="8/0/0034") as refused:
            await saw.read("oP.3", index=0xFF)
        assert refused.value.number == 0x08000034
        with pytest.raises(dpstack.UsageError, match="the long value must be the first"):
            await saw.write_map(inputs="sy.51 ru.12:long")
        assert await saw.write_map(inputs=INPUTS, outputs=OUTPUTS) == {
            "inputs": "220C:long 2033 2035",
            "outputs": "2F13:long 2032 2034",
        }
        await off_and_on(bus, 5)
        found = await saw.read_map()
        assert isinstance(found, dict)
        assert found["inputs"] == "220C:long 2033 2035"
        assert await saw.read("oP.3", data_set=3) == -12.5  # its EEPROM
        with pytest.raises(dpstack.UsageError, match="it has start, stop"):
            await saw.order("dance")


async def test_a_map_in_the_configuration() -> None:
    table = {**SAW, "options": {"map_inputs": INPUTS, "map_outputs": "cS.19:long=100 sy.50 sy.52"}}
    async with running(table) as (bus, saw):
        await saw.write_map()  # the one that the configuration has
        await off_and_on(bus, 5)
        saw.speed = -0.25
        await saw.start()
        await saw.reached()
        values = await saw.order("inputs")
        assert isinstance(values, dict)
        assert values["sy.53 (2035h)"] == pytest.approx(-375, abs=8)
        assert await saw.order("output", number="cS.19", value=100) == 100


async def test_a_fault_on_the_bus_is_named_and_acknowledged() -> None:
    async with running(SAW) as (bus, saw):
        await saw.start()
        await trip(bus, saw, "E.OC", "inverter state ru.00 = 4 E.OC")
        with pytest.raises(dpstack.DriveFault, match=r"ru\.00 = 4 E\.OC"):
            await saw.start()
        await saw.acknowledge()
        await saw.start()


def test_on_a_real_port_the_bits_are_the_users(tmp_path: Path) -> None:
    """The options reach the plugin, and a note says which data are made up."""
    path = tmp_path / "plant.toml"
    text = """
[bus]
port = "/dev/ttyUSB0"
baud = 500000

[[slave]]
name = "saw"
address = 5
drive = "keb-f5"
telegram = "8+2/8+4 own-gsd"
ident = 0x1234
{options}
"""
    options = 'options = { control_bits = "run=2", status_bits = "run=2 fault=1", rpm_per_count = 1 }'
    path.write_text(text.format(options=options), encoding="utf-8")
    slave = dpstack.load_config(path).slaves[0]
    assert slave.params.config.hex() == "a7a19793"
    assert slave.options == {"control_bits": "run=2", "status_bits": "run=2 fault=1", "rpm_per_count": 1}
    assert "identifier octets A7 A1 97 93 of keb-f5 are in no manual" in slave.notes[0]
    path.write_text(text.format(options="options = { control_bit = 1 }"), encoding="utf-8")
    with pytest.raises(dpstack.ConfigError, match=r"plant\.toml:12: .*no option 'control_bit'; did you mean"):
        dpstack.load_config(path)
    path.write_text(text.format(options='options = "run=2"'), encoding="utf-8")
    with pytest.raises(dpstack.ConfigError, match=r"options = 'run=2' is a text; it must be a table"):
        dpstack.load_config(path)


@pytest.mark.parametrize(("bits", "outputs"), [("simulated", "00 05"), ("run=15", "80 00")])
async def test_the_simulated_drive_takes_the_options_that_it_shares(bits: str, outputs: str) -> None:
    """Plugin and simulated drive have the same options: bits of the user, or the made-up ones by name."""
    async with running({**SAW, "options": {"control_bits": bits, "pd_in_cycle_ms": 25}}) as (bus, saw):
        await saw.start()
        assert bus.slave("saw").outputs[8:10] == bytes.fromhex(outputs)


# --- An LS S100 on a bus: profiles by configuration, power-off, faults ----------------------------------------------


LS: Mapping[str, object] = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "PPO1"}
LS_PROFILE = {"profile": "ls"}


async def test_a_users_program_with_an_ls() -> None:
    async with running(LS) as (bus, pump):
        pump.frequency = 30.0
        await pump.start()
        await pump.reached()
        assert pump.status.frequency_hz == pytest.approx(30, abs=0.5)
        assert await pump.read(918) == 6
        assert await pump.read("baud_rate") == 4  # 500 kbit/s
        await pump.write("dr-03", 2.5)
        await trip(bus, pump, "LV", "34 LV")
        with pytest.raises(dpstack.DriveFault, match="34 LV; acknowledge it first"):
            await pump.start()
        await pump.acknowledge()
        await pump.start()
        await pump.quick_stop()
        with pytest.raises(dpstack.ParameterError, match="error 0, illegal parameter number"):
            await pump.read("dr-99")
        with pytest.raises(dpstack.UsageError, match="dr-20"):
            pump.speed = 1.5
        await off_and_on(bus, 6)
        assert await pump.read("dr-03") == 2.5  # its EEPROM


async def test_the_message_about_a_wrong_profile_names_the_parameter() -> None:
    async with running({**LS, "options": LS_PROFILE}) as (_, pump):
        await pump.start()
        await pump.stop()
        with pytest.raises(dpstack.UsageError, match="no quick stop"):
            await pump.quick_stop()
        await pump.write("COM-11", 1)
        await pump.write("COM-94", 1)
        with pytest.raises(dpstack.DriveFault, match="set COM-11 to 2 and COM-94 to 1"):
            await pump.start()


def test_a_note_about_made_up_identifier_octets(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text(
        """
[bus]
port = "/dev/ttyUSB0"
baud = 500000

[[slave]]
name = "pump"
address = 6
drive = "ls-s100"
telegram = "VENDOR 3/2"
options = { para_control = "0005 0006 dr-03=1" }
""",
        encoding="utf-8",
    )
    slave = dpstack.load_config(path).slaves[0]
    assert slave.params.config.hex() == "6251"
    assert "identifier octets 62 51 of ls-s100 are in no manual" in slave.notes[0]


# --- An IMO HD2 ------------------------------------------------------------------------------------------------------
# its process data map, a fault, and the one baud rate that its card accepts
# (docs/reference/drives/imo-hd2.md#address-and-baud-rate)


IMO: Mapping[str, object] = {"name": "pump", "address": 5, "drive": "imo-hd2"}


async def test_a_users_program_with_an_imo() -> None:
    async with running(IMO, 1_500_000) as (bus, pump):
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
async def test_i5_it_answers_only_at_the_rate_it_is_set_to(options: Mapping[str, object], hears: bool) -> None:
    slaves = [{**IMO, "options": options}, {"name": "fan", "address": 6, "drive": "fuji-frenic"}]
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=slaves) as bus:
        await bus.operate()
        await asyncio.sleep(1)
        assert bus.slave("fan").ready_now
        assert bus.slave("pump").ready_now is hears
        wrong = [text for text in bus.plan.findings if "finds no baud rate by itself" in text]
        assert wrong == [] if hears else "slave 5 (pump): imo-hd2" in wrong[0]
        assert hears or "hears only 1.5 Mbit/s, not 500 kbit/s" in wrong[0]
        assert hears or "option baud_index" in wrong[0]


def test_i5_where_all_search_it_waits_at_its_rate() -> None:
    unit = SimulatedSlave(slave_config(IMO), BusParams.preset(9_600), searching=True)
    assert unit.on_bus is unit.station
    assert unit.station.baud == 1_500_000
    unit.renew(BusParams.preset(9_600))
    assert unit.station.baud == 1_500_000


def test_i5_a_port_at_another_rate_is_refused_with_the_option() -> None:
    config = make_config("pty", 500_000, 2, [IMO])
    with pytest.raises(dpstack.ConfigError, match=r"hears only 1\.5 Mbit/s, not 500 kbit/s.*option baud_index"):
        Simulation(config, "pty", 500_000)


def test_i5_a_rate_that_profibus_does_not_have() -> None:
    with pytest.raises(dpstack.ConfigError, match="9 Mbit/s in the card's table"):
        make_config("virtual", 500_000, 2, [{**IMO, "options": {"baud_index": 9}}])
