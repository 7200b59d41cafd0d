"""A KEB F5 on a bus: options in the configuration, its own orders, process data map, power-off, faults."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from api_kit import off_and_on, running, trip

import dpstack

pytestmark = pytest.mark.virtual_time

SAW: Mapping[str, object] = {"name": "saw", "address": 5, "drive": "keb-f5", "telegram": "PCH+8/8"}
INPUTS, OUTPUTS = "ru.12:long sy.51 sy.53", "cS.19:long sy.50 sy.52"


async def test_a_users_program() -> None:
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
