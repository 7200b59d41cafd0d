"""``dpstack device list`` and ``show``: what is known by base, source and place, and the parts of one file."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_kit import Cli

from dpstack import __version__

PUMP = """\
format = 1
name = "pump"
title = "Pump of the cellar"
base = "profidrive"
only = ["PPO1", "350"]
source = "manual, edition 3"
tried = "not tried at the device"
[telegrams]
350 = { out = ["control", "setpoint", "limit", 4], in = ["status", "speed", "power"], config = "C3 C3 C2 FD 01 5E" }
[words]
limit = { full = 1000, of = "p2003", low = 0, high = 200 }
power = { bits = { line = 0 } }
[control]
bits = { mop_up = 13 }
[orders]
jog_on = { set = ["mop_up"] }
[fault]
texts = { 7 = "hot" }
[parameters]
p2003 = { number = 2003, type = "f32", unit = "Nm", low = 0, high = 100, factory = 10, title = "Reference torque" }
p922 = { number = 922 }
[settings]
p922 = { equals = "{telegram}", why = "it must be the same" }
[options]
ramp = { default = 2, low = 0, high = 9, text = "ramp in s" }
"""


@pytest.fixture
def pump(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DPSTACK_DEVICES", str(tmp_path))
    path = tmp_path / "pump.toml"
    path.write_text(PUMP)
    return path


def test_the_list_has_base_source_and_place(pump: Path, cli: Cli) -> None:
    found = cli.json("device", "list")
    by_name = {one["name"]: one for one in found["devices"]}
    assert by_name["pump"] == {
        "name": "pump",
        "kind": "drive",
        "title": "Pump of the cellar",
        "base": "profidrive",
        "source": "manual, edition 3",
        "tried": "not tried at the device",
        "telegrams": ["PPO1", "350"],
        "ident": None,
        "origin": str(pump.parent),
        "file": str(pump),
    }
    assert by_name["profidrive"]["origin"] == by_name["keb-f5"]["origin"] == f"dpstack {__version__}"
    assert found["broken"] == []
    lines = cli.out("device", "list").splitlines()
    assert lines[1].split() == ["name", "title", "base", "source", "tried", "from"]
    words = f"pump Pump of the cellar profidrive manual, edition 3 not tried at the device {pump.parent}"
    assert words in [" ".join(line.split()) for line in lines]


def test_a_file_with_mistakes_is_listed_with_the_reason(pump: Path, cli: Cli) -> None:
    pump.write_text(PUMP.replace("format = 1", "format = 2"))
    out, err = cli("device", "list", code=1)
    assert "pump" not in out
    assert err == (
        f"dpstack: drive pump cannot be loaded: {pump}:1: the file: format = 2 is outside 1..1; "
        "this dpstack reads format = 1\n"
    )
    found = cli.json("drives", code=1)
    assert [one["name"] for one in found["broken"]] == ["pump"]


def test_a_device_file_is_shown(pump: Path, cli: Cli) -> None:
    lines = [" ".join(line.split()) for line in cli.out("device", "show", "pump").splitlines()]
    for line in (
        "pump: Pump of the cellar",
        "base: profidrive",
        "source: manual, edition 3",
        "350 C3 C3 C2 FD 01 5E control setpoint limit 0004h status speed power",
        "PPO1 F3 71 PKW control setpoint PKW status speed",
        "limit u16 3E8h = p2003 0..200 %",
        "power n2 4000h = 100 % 0 line",
        "running 004F 0007",
        "to running from ready_to_switch_on 047F",
        "jog_on mop_up",
        "7 hot",
        "2003 p2003 Reference torque f32 0..100 Nm 10 Nm",
        "p922 {telegram} no start it must be the same",
        "ramp 2.0 0..9 ramp in s",
        "fault: number in word fault, else parameter 945",
    ):
        assert line in lines, line
    found = cli.json("device", "show", str(pump))
    assert found["telegram"] == "350"
    assert found["telegrams"][-1] == {
        "name": "350",
        "config": "C3 C3 C2 FD 01 5E",
        "made_up": False,
        "channel": False,
        "outputs": ["control", "setpoint", "limit", 4],
        "inputs": ["status", "speed", "power"],
        "modules": [],
    }
    assert found["control_bits"]["mop_up"] == 13
    assert found["orders"] == {"jog_on": {"set": ["mop_up"], "clear": []}}


def test_wrong_names(pump: Path, cli: Cli) -> None:
    assert "no drive is called 'pumps'; did you mean pump?" in cli.err("device", "show", "pumps")


def test_a_drive_with_python_of_its_own_and_an_encoder(cli: Cli) -> None:
    shown = cli.json("device", "show", "keb-f5")
    assert (shown["python"], shown["base"]) == ("keb-f5", "bits")
    shown = cli.json("device", "show", "simodrive-sensor")
    assert (shown["base"], shown["ident"], "states" in shown) == ("encoder", "0x0024", False)
    assert "class2    F1 (made up)  preset        position" in cli.out("device", "show", "tr-58")
    (listed,) = (one for one in cli.json("device", "list")["devices"] if one["name"] == "tr-58")
    assert (listed["kind"], listed["base"]) == ("device", "encoder")


def test_drives_has_device_files_too(pump: Path, cli: Cli) -> None:
    (found,) = (one for one in cli.json("drives")["drives"] if one["name"] == "pump")
    assert (found["place"], found["origin"], found["ident"]) == (str(pump), str(pump.parent), None)
    assert found["telegram"] == "350"
    assert "ramp" in found["options"]
