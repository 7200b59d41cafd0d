"""``dpstack pa``: two transmitters of octets, in the foreground as master of class 1 and 2, and through a run."""

from __future__ import annotations

import asyncio
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from api_kit import RAW, slave_in
from cli_kit import Cli
from pa_kit import Transmitter, f32, transmitter, words
from plant_files import plant_file

import dpstack
from dpstack.api.config.config import Config
from dpstack.api.control.handlers import control_run
from dpstack.api.control.record_orders import parse_order
from dpstack.api.control.remote import through_run
from dpstack.api.slave.class2 import Connection
from dpstack.api.streams import OnEvent
from dpstack.cli.commands import acyclic, on_bus
from dpstack.slave import DpSlave, SlaveDescription

RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True)
Devices = dict[int, Transmitter]

pytestmark = pytest.mark.usefixtures("alone")


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    keys = {**RAW, "config": "10 20", "user_prm": "00 00 00", "dpv1": True}
    return plant_file(tmp_path, keys | {"name": "tank", "address": 8}, keys | {"name": "tank2", "address": 9})


@pytest.fixture
def run(cli: Cli, plant: Path) -> Cli:
    return cli.of("pa", str(plant))


@pytest.fixture
def devices(monkeypatch: pytest.MonkeyPatch) -> Devices:
    """Both transmitters in virtual time; the second one is the neighbour with another range."""
    other = Transmitter(transmitter("S-2", "NEIGHBOUR"))
    other.records[1, 114] = f32(250.0, 0.0)
    made = {8: Transmitter(), 9: other}

    def bus(config: Config, on_event: OnEvent | None = None, world: object = None) -> dpstack.Bus:
        return open_bus(made, config, on_event)

    for module, name in ((acyclic, "open_bus"), (on_bus, "Bus")):
        monkeypatch.setattr(module, name, bus)
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    return made


def open_bus(devices: Devices, config: Config, on_event: OnEvent | None = None) -> dpstack.Bus:
    world = dpstack.World()
    for address, device in devices.items():
        slave = DpSlave(RIG, lambda outputs, elapsed: outputs, ms2=1)
        slave.serve_records(device)
        slave_in(world, slave, address)
    return dpstack.open_bus(config, on_event=on_event, world=world)


SHOWN = """\
slave 8 (tank): Endress+Hauser CERABAR
  tag                  TANK LEVEL
  serial number        S-1
  revisions            software 1.04.02, hardware 2.0
  profile              3.02, directory in slot 1
  ident number         profile (0)
  descriptor           tank 7
  installed            2026-11-01
  write protection     none
  diagnosis            maintenance required
pb1: physical block, transmitter, slot 0 index 16, tag TANK LEVEL
  mode                 AUTO (normal AUTO; permitted O/S, MAN, AUTO)
  alarms               none
  feature              classic status and diagnosis in force (possible: condensed status and diagnosis)
ai1: function block, analogue input, slot 1 index 16, tag FB PRESSURE
  mode                 AUTO (normal AUTO; permitted O/S, MAN, AUTO)
  alarms               HI alarm
  out                  3.85 m, uncertain: sensor conversion not accurate (status 50)
  pv_scale             0 to 10 mbar
  out_scale            0 to 4 m
  lin_type             linear (0)
  channel              tb1.primary_value (274)
  simulate             off
tb1: transducer block, pressure, mixed, slot 1 index 80
  mode                 AUTO (normal AUTO; permitted O/S, MAN, AUTO)
  alarms               none
  sensor_value         350 mbar
  primary_value        350.1 mbar
  temperature          21.5 °C
  scale_in             0 to 400 mbar
  scale_out            0 to 400 mbar
  lin_type             linear (0)
  sensor_lo_lim        -100 mbar
  sensor_hi_lim        1000 mbar
"""


def test_what_a_transmitter_is_and_why_its_value_is_uncertain(run: Cli, devices: Devices) -> None:
    records = devices[8].records
    records[0, 29] = b"\0\x20\0\0"
    records[1, 26] = f32(3.85) + b"\x50"
    records[1, 23] = b"\x04" + bytes(7)
    assert run("tank") == (SHOWN, "")
    assert run.out("8", "show", "--class", "2") == SHOWN
    told = run.json("tank")
    assert (told["order"], told["slave"], told["address"], told["through"]) == ("show", "tank", 8, "master")
    assert told["identity"]["maker_id"] == 17
    assert told["diagnosis"]["category"] == "maintenance"
    assert [block["name"] for block in told["blocks"]] == ["pb1", "ai1", "tb1"]
    out = told["blocks"][1]["values"][0]
    assert (out["name"], out["value"], out["unit"], out["quality"]) == (
        "ai1.out",
        {"value": 3.85, "status": 80},
        "m",
        "uncertain",
    )


def test_parameters_are_read_and_written(run: Cli, devices: Devices) -> None:
    assert run.out("tank", "read", "ai1.pv_scale") == (
        "slave 8 (tank): ai1.pv_scale = 0 to 10 mbar (range, slot 1 index 27)\n"
    )
    assert run.out("tank", "read", "1:130") == "slave 8 (tank): 1:130 = 00 2a (octets, slot 1 index 130)\n"
    lines = run.out("tank", "read", "ai1").splitlines()
    assert lines[0] == "slave 8 (tank): 27 parameters of ai1"
    assert lines[1].split() == ["name", "index", "type", "value"]
    assert "ai1.out           26     value      3.5 m" in " ".join(lines)
    assert run.out("tank", "write", "tb1.lower_range", "-20") == (
        "slave 8 (tank): tb1.scale_in.eu_0 = -20 mbar (before: 0 mbar), written and read back; ST_REV 7 -> 8\n"
    )
    assert devices[8].records[1, 114] == f32(400.0, -20.0)
    told = run.json("tank", "write", "ai1.target_mode", "MAN", "--class", "2")
    assert (told["order"], told["name"], told["parameter"]["text"], told["st_rev"]) == (
        "write",
        "ai1.target_mode",
        "MAN",
        [7, 8],
    )
    assert run.out("tank", "write", "pb1.descriptor", "tank", "seven").startswith(
        "slave 8 (tank): pb1.descriptor = tank seven (before: tank 7)"
    )


@pytest.mark.usefixtures("devices")
def test_a_dump_and_the_neighbour(run: Cli, devices: Devices, tmp_path: Path) -> None:
    path = tmp_path / "tank.toml"
    assert run("tank", "dump", str(path)) == (f"slave 8 (tank): 82 parameters are in {path}\n", "")
    found = tomllib.loads(path.read_text(encoding="utf-8"))
    assert (found["kind"], found["maker"], found["device"], found["serial"]) == ("profibus pa", 17, "CERABAR", "S-1")
    assert found["parameters"][1] == {
        "name": "pb1.st_rev",
        "slot": 0,
        "number": 17,
        "type": "u16",
        "group": "measured",
        "values": [7],
        "text": "7",
        "read_only": True,
    }
    out = run.out("tank", "compare", str(path))
    assert out.splitlines()[-1] == f"slave 8 (tank): 60 parameters are as in {path}, 0 differ"
    between = run.out("tank2", "compare", "tank", code=1)
    assert between.splitlines() == [
        "configuration:",
        "  pb1.tag_desc: tank TANK LEVEL; tank2 NEIGHBOUR",
        "  tb1.scale_in: tank 0 to 400 mbar; tank2 0 to 250 mbar",
        "identity:",
        "  pb1.device_ser_num: tank S-1; tank2 S-2",
        "not compared: pb1.st_rev, pb1.mode_blk, pb1.alarm_sum and 18 more: measured values, --all compares them",
        "not compared: 1:130: octets of the maker without a known meaning, --all compares them",
        "slave 9 (tank2): 57 parameters are as in tank, 3 differ",
    ]
    told = run.json("tank2", "compare", str(path), "--class", "2", code=1)
    assert [(one["name"], one["elements"]) for one in told["differences"]] == [
        ("pb1.tag_desc", ["0"]),
        ("pb1.device_ser_num", ["0"]),
        ("tb1.scale_in", ["eu_100"]),
    ]
    devices[9].records[1, 114] = devices[8].records[1, 114]
    devices[9].records[0, 18] = devices[8].records[0, 18]
    assert "pb1.device_ser_num: file S-1; tank2 S-2" in run.out("tank2", "compare", str(path))
    assert len(run.out("tank", "dump").splitlines()) == 84
    assert len(run.json("tank", "dump")["parameters"]) == 82


@pytest.mark.parametrize(
    ("args", "code", "text"),
    [
        (["tank", "raed", "ai1.out"], 2, "dpstack pa does not know 'raed'; did you mean read?"),
        (["tank", "read"], 2, "read takes NAME"),
        (["tank", "write", "ai1.out"], 2, "write takes NAME VALUE, for instance: write tb1.lower_range 0"),
        (["tank", "read", "ai2.out"], 2, "the device has no block 'ai2'; did you mean ai1?"),
        (["tank", "read", "ai1.oout"], 2, "no parameter 'oout'; did you mean out?"),
        (["tank", "read", "ai1.hi_hi_alm.x"], 2, "no element 'x'; it has unacknowledged"),
        (["tank", "read", "1:250"], 1, "1:250: slave 8 refuses Read of slot 1, index 250: invalid index"),
        (["tank", "read", "1:256"], 2, "slots are 0 to 254, indices 0 to 255"),
        (["tank", "write", "tb1.primary_value", "1"], 2, "tb1.primary_value can only be read"),
        (["tank", "write", "ai1.out", "value=1"], 2, "in the modes MAN and O/S only, ai1 is in AUTO"),
        (["tank", "compare", "tank"], 2, "tank is the device itself"),
        (["tank", "compare", "/nowhere"], 2, "/nowhere: No such file"),
        (["tank", "--all"], 2, "--all is for compare"),
        (
            ["tank", "write", "PB1.Factory_Reset", "1"],
            2,
            "settings are lost, and a valve can move; if the plant allows",
        ),
        (["tank", "write", "tb1.self_calib_cmd", "1"], 2, "the valve moves over its whole travel; if the plant allows"),
        (
            ["tank", "write", "1:26", "1"],
            2,
            "by slot and index it can be one that resets the device or moves a valve; if",
        ),
        (["tank", "read", "ai1.out", "--yes"], 2, "--yes is for write"),
        (["tank", "--timeout", "4000"], 2, "timeout='4000': write seconds, more than 0, at most 3600"),
        (["pump"], 2, "no slave 'pump' in this configuration; there are: 8 (tank), 9 (tank2)"),
        (["tank", "--address", "5"], 2, "--address is for --class 2"),
    ],
)
@pytest.mark.usefixtures("devices")
def test_what_is_refused_in_one_line(run: Cli, args: list[str], code: int, text: str) -> None:
    err = run.err(*args, code=code)
    assert text in err
    assert err.count("\n") == 1


@pytest.mark.usefixtures("devices")
def test_a_reset_is_written_if_it_is_wanted_and_not_read_back(run: Cli) -> None:
    assert run.out("tank", "write", "pb1.factory_reset", "1", "--yes", "--timeout", "30") == (
        "slave 8 (tank): pb1.factory_reset = reset to defaults (1) (before: nothing (0)), written; "
        "ST_REV is 7 as before\n"
    )


@pytest.mark.parametrize("order", [(), ("read", "ai1.out"), ("write", "tb1.lower_range", "0"), ("dump",)])
@pytest.mark.usefixtures("devices")
def test_a_time_limit_for_each_read_and_write(run: Cli, order: Sequence[str], monkeypatch: pytest.MonkeyPatch) -> None:
    limits: set[float | None] = set()
    read = Connection.read

    async def noted(
        self: Connection, slot: int, index: int, length: int = 240, *, timeout: float | None = None
    ) -> bytes:
        limits.add(timeout)
        return await read(self, slot, index, length, timeout=timeout)

    monkeypatch.setattr(Connection, "read", noted)
    run.out("tank", *order, "--timeout", "45", "--class", "2")
    assert limits == {45.0}


def test_devices_that_make_trouble(run: Cli, devices: Devices) -> None:
    device = devices[8]
    device.records[0, 34] = words(0)
    assert "is locked (WRITE_LOCKING is 0)" in run.err("tank", "write", "tb1.lower_range", "1")
    device.records[0, 18] = b"\x1b[31mred\x9b\0\n" + b" " * 20
    assert "\\x1b[31mred\\x9b" in run.out("tank")
    assert "\\x1b[31mred" in run.out("tank", "read", "pb1.tag_desc")
    device.records.clear()
    err = run.err("tank", code=1)
    assert "slave 8 (tank): no PROFIBUS PA device by its records" in err
    assert err.count("\n") == 1
    del devices[8]
    assert run.err("tank", code=1).count("\n") == 1
    assert run.err("tank", "--class", "2", code=1).count("\n") == 1


async def test_through_a_run(plant: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In real time: the device answers slowly, and progress is shown meanwhile."""
    devices = {8: Transmitter(), 9: Transmitter()}
    config = dpstack.load_config(plant)
    steps: list[tuple[str, int, int]] = []

    async def ask(*order: str, master: int = 1) -> Any:
        parsed = parse_order("pa", order, class2=master == 2)
        return await through_run(config, 8, parsed, lambda *step: steps.append(step), master=master)

    bus = open_bus(devices, config)
    async with bus, control_run(bus, "virtual"):
        await bus.ready()
        for master in (1, 2):
            shown, dumped = await ask(master=master), await ask("dump", master=master)
            assert shown["asked"] == "show"
            assert [block["name"] for block in shown["parameters"]] == ["pb1", "ai1", "tb1"]
            assert len(dumped["parameters"]) == 82
        written = await ask("write", "tb1.lower_range", "5")
        assert written["st_rev"] == [7, 8]
        with pytest.raises(dpstack.UsageError, match=r"tb1\.primary_value can only be read"):
            await ask("write", "tb1.primary_value", "5")
    await asyncio.sleep(0)
