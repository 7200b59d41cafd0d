"""Plants of the testing kit: scenarios, inputs over time, commands to simulated devices, and devices of the test."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

import dpstack
from dpstack.slave import DpSlave, SlaveDescription
from dpstack.testing import BusFactory

TANK = {"name": "tank", "address": 8, "ident": 0x1234, "config": "11 20", "inputs": {"level": "u16@0"}}
STATION = {"name": "io", "address": 9, "gsd": "io-station", "modules": ["8 DI", "2 AI"]}
#: few telegrams a second
BAUD = 9_600


def test_a_scenario_begins_when_the_bus_is_there(dpstack_bus: BusFactory, tmp_path: Path) -> None:
    steps = tmp_path / "steps.toml"
    steps.write_text(
        '[[step]]\nat = 0.5\nslave = "tank"\ndo = "set"\ninputs = { level = 700 }\n'
        '[[step]]\nat = 1\nslave = "tank"\ndo = "silence"\nfor = 0.5\n',
        encoding="utf-8",
    )
    bus = dpstack_bus(slaves=[TANK], baud=BAUD, scenario=steps)
    began = bus.now
    bus.wait(0.4)
    assert bus.device("tank").inputs == bytes(2)
    bus.wait(0.3)
    assert bus.slave("tank")["level"] == 700
    bus.wait(0.6)
    assert bus.master.slave("tank").state is dpstack.SlaveState.OFFLINE
    bus.run(bus.slave("tank").ready())
    bus.wait(0.2)
    bus.wire.assert_brought_up("tank", since=began + 1.5)
    told = [event.text for event in bus.events]
    assert "scenario step 2, slave 8 (tank): silence for 0.5 s" in told
    assert told.count("scenario step 2, slave 8 (tank): over: silence") == 1


def test_a_wrong_scenario_is_refused_before_the_bus_is_made(dpstack_bus: BusFactory, tmp_path: Path) -> None:
    steps = tmp_path / "steps.toml"
    steps.write_text('[[step]]\nat = 1\nslave = "tnak"\ndo = "silence"\n', encoding="utf-8")
    with pytest.raises(dpstack.ConfigError, match=r"steps\.toml:3: .* no slave 'tnak'; did you mean 'tank'\?"):
        dpstack_bus(slaves=[TANK], baud=BAUD, scenario=steps)


def test_inputs_of_a_recording(dpstack_bus: BusFactory, tmp_path: Path) -> None:
    (tmp_path / "monday.csv").write_text("t,tank.level\n0,1\n0.5,300\n1,700\n", encoding="utf-8")
    (tmp_path / "plant.toml").write_text(
        f'[bus]\nport = "/dev/ttyUSB0"\nbaud = {BAUD}\n[[slave]]\nname = "tank"\naddress = 8\nident = 0x1234\n'
        'config = "11 20"\ninputs = { level = "u16@0" }\nsimulate = { recording = "monday.csv" }\n',
        encoding="utf-8",
    )
    bus = dpstack_bus(tmp_path / "plant.toml")
    seen = []
    for _ in range(4):
        bus.wait(0.3)
        seen.append(bus.slave("tank")["level"])
    assert seen == [1, 300, 300, 700]


def test_functions_run_only_when_allowed(dpstack_bus: BusFactory, tmp_path: Path) -> None:
    (tmp_path / "kit_tank.py").write_text("def inputs(t, outputs):\n    return {'level': 55}\n", encoding="utf-8")
    (tmp_path / "plant.toml").write_text(
        f'[bus]\nbaud = {BAUD}\n[[slave]]\nname = "tank"\naddress = 8\nident = 0x1234\nconfig = "11 20"\n'
        'inputs = { level = "u16@0" }\nsimulate = { function = "kit_tank:inputs" }\n',
        encoding="utf-8",
    )
    with pytest.raises(dpstack.ConfigError, match=r"in a test allow_code=True"):
        dpstack_bus(tmp_path / "plant.toml")
    bus = dpstack_bus(tmp_path / "plant.toml", allow_code=True)
    bus.wait(0.5)
    assert bus.slave("tank")["level"] == 55


def test_commands_to_a_station(dpstack_bus: BusFactory) -> None:
    bus = dpstack_bus(slaves=[STATION, TANK], baud=BAUD)
    bus.faults.begin("io", "wire_break", args=["2", "0", "on"])
    bus.wait(0.2)
    assert bus.slave("io").inputs[1:3] == b"\x7f\xff"
    bus.device("io").station.wire_break(2, 0, False)
    bus.device("io").station.set_input(1, b"\x05")
    bus.wait(0.2)
    assert bus.slave("io").inputs == b"\x05\x00\x00\x00\x00"
    with pytest.raises(dpstack.ConfigError, match="unknown do 'wire_brake'; did you mean 'wire_break'"):
        bus.faults.begin("io", "wire_brake")
    with pytest.raises(dpstack.UsageError, match=r"slave 8 \(tank\) is no simulated I/O station"):
        _ = bus.device("tank").station
    bus.faults.silence("io")
    bus.faults.begin("io", "normal")
    assert "silence" not in bus.faults.active.get("io", [])


def test_a_device_of_the_test(dpstack_bus: BusFactory) -> None:
    """A slave that somebody writes for a PLC is tested with the faults and the wire of the kit."""
    press = SlaveDescription.simple(0x4712, inputs=2, outputs=1, name="press", dpv1=True)
    closed: list[bool] = []

    def cycle(outputs: bytes, elapsed: int) -> bytes:
        closed.append(bool(outputs[0] & 1))
        return bytes([outputs[0] & 1, 0x55])

    async def read(slot: int, index: int) -> bytes:
        await asyncio.sleep(0.01)
        return bytes([slot, index])

    own = DpSlave(press, cycle, on_read=read)
    bus = dpstack_bus(slaves=[press.table(9), TANK], devices={"press": own}, baud=BAUD)
    bus.slave("press").outputs = b"\x01"
    bus.wait(0.2)
    assert bus.slave("press").inputs == b"\x01\x55"
    assert bus.run(bus.slave("press").read(3, 7)) == b"\x03\x07"
    with bus.faults.silence_master():
        bus.wait(bus.slave("press").watchdog_ms / 1000 + 0.2)
        assert closed[-1] is False  # its watchdog has made it safe
    with bus.faults.power_off("press"):
        bus.wait(0.5)
    began = bus.now
    bus.run(bus.slave("press").ready(30))
    bus.wait(0.2)
    bus.wire.assert_brought_up("press", since=began)
    with pytest.raises(dpstack.UsageError, match="its own function makes its inputs"):
        bus.device("press").inputs = bytes(2)
    with pytest.raises(dpstack.UsageError, match=r"devices: no slave is called 'pres'; there are: press, tank"):
        dpstack_bus(slaves=[press.table(9), TANK], devices={"pres": own}, baud=BAUD)
