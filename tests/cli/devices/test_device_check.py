"""``dpstack device check``: mistakes with their lines, examples, and the drive in the simulation."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_kit import Cli

from dpstack.devices import finding
from dpstack.testing.drive_conformance import Outcome, run_checks

FAN = """\
format = 1
name = "fan"
title = "Fan of the exhaust"
base = "profidrive"
only = ["1"]
[telegrams]
1 = {}
[fault]
texts = { 1 = "overcurrent" }
[[example]]
inputs = "EB31 0000"
state = "ready_to_switch_on"
outputs = { start = "047F 0000" }
"""
CHECKS = 14


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """One check that passes instead of all; the telegrams that were to be checked."""
    asked: list[tuple[str, ...]] = []

    def checks(_: object, telegrams: tuple[str, ...], **__: object) -> Iterator[Outcome]:
        asked.append(telegrams)
        yield Outcome("it comes", telegrams[0], "")

    monkeypatch.setattr("dpstack.cli.devices.check.run_checks", checks)
    return asked


@pytest.fixture
def fan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "fan.toml"
    path.write_text(FAN)
    return path


def test_a_sound_file(fan: Path, cli: Cli) -> None:
    lines = cli.out("device", "check", "fan.toml").splitlines()
    assert lines[0] == "fan.toml: Fan of the exhaust, base profidrive, telegrams 1"
    assert lines[1:3] == ["examples: 1 of 1 hold", "in the simulation"]
    assert lines[-1] == "sound"
    assert [line.split()[-2:] for line in lines if line.startswith("it starts and stops")] == [["1", "passed"]]
    assert sum(line.endswith("passed") for line in lines) == CHECKS


def test_telegrams_of_the_file_or_those_that_are_named(fan: Path, cli: Cli, quick: list[tuple[str, ...]]) -> None:
    fan.write_text(FAN.replace('only = ["1"]', 'only = ["1", "PPO1", "3"]'))
    found = cli.json("device", "check", "fan.toml")
    assert (found["sound"], found["errors"]) == (True, [])
    assert found["examples"] == [{"line": 10, "holds": True}]
    assert found["checks"][0] == {"check": "it comes", "telegram": "1", "passed": True, "reason": ""}
    cli("device", "check", "fan.toml", "--telegram", "PPO1", "1")
    assert quick == [("1", "3", "PPO1"), ("PPO1", "1")]


def test_every_mistake_has_its_line_and_a_remedy(fan: Path, cli: Cli) -> None:
    fan.write_text(FAN.replace('name = "fan"', 'name = "van"').replace("1 = {}", '1 = { out = ["control", "speeed"] }'))
    out = cli.out("device", "check", "fan.toml", code=1).splitlines()
    assert out == [
        "fan.toml:2: the file: name = 'van', but the file is fan.toml; give both the same name",
        "fan.toml:7: the file: telegrams: 1: out: 'speeed' is no word of this file; did you mean 'speed'?",
        "not sound: 2 errors",
    ]
    found = cli.json("device", "check", "fan.toml", code=1)
    assert (found["sound"], found["examples"], found["checks"]) == (False, [], [])
    assert [(one["line"], one["todo"]) for one in found["errors"]] == [
        (2, "give both the same name"),
        (7, "did you mean 'speed'?"),
    ]


def test_an_example_that_does_not_hold(fan: Path, cli: Cli, quick: object) -> None:
    fan.write_text(FAN.replace('"047F 0000"', '"047B 0000"'))
    out = cli.out("device", "check", "fan.toml", code=1).splitlines()
    assert out[0] == (
        "fan.toml:10: [[example]]: 'start' sends 047F 0000, not 047B 0000; "
        "correct the example, or the words of the file that it contradicts"
    )
    assert "examples: 0 of 1 hold" in out
    assert out[-1] == "not sound: 1 error, 0 checks failed"
    assert cli.json("device", "check", "fan.toml", code=1)["examples"] == [{"line": 10, "holds": False}]


def test_a_drive_that_fails_in_the_simulation(fan: Path) -> None:
    """The word that should lead on to running keeps it in the state before."""
    fan.write_text(FAN.partition("[[example]]")[0] + "[control]\nrun = { ready_to_switch_on = 0x047E }\n")
    first = itertools.islice(run_checks(finding.find(str(fan)), keys={"ident": 0xFFF0}), 4)
    start = list(first)[-1]
    assert (start.check, start.telegram, start.passed) == ("it starts and stops", "1", False)
    assert "the drive reports ready_to_switch_on, not running" in start.reason


def test_a_failed_check_is_a_finding(fan: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = Outcome("it starts", "1", "it does not")
    monkeypatch.setattr("dpstack.cli.devices.check.run_checks", lambda *_, **__: iter([failed]))
    found = cli.json("device", "check", "fan.toml", code=1)
    assert (found["sound"], found["errors"]) == (False, [])
    assert found["checks"] == [{"check": "it starts", "telegram": "1", "passed": False, "reason": "it does not"}]
    lines = cli.out("device", "check", "fan.toml", code=1).splitlines()
    assert lines[-2].split() == ["it", "starts", "1", "it", "does", "not"]
    assert lines[-1] == "not sound: 0 errors, 1 check failed"


def test_python_that_no_package_has_registered(fan: Path, cli: Cli) -> None:
    fan.write_text(FAN.replace('base = "profidrive"', 'base = "profidrive"\npython = "os:system"'))
    assert "python = 'os:system': no installed package has registered it" in cli.out(
        "device", "check", "fan.toml", code=1
    )


def test_wrong_use(fan: Path, cli: Cli) -> None:
    assert "nowhere.toml: there is no such file" in cli.err("device", "check", "nowhere.toml")
    assert "no device file is called 'nowhere'" in cli.err("device", "check", "nowhere")
    assert "fan has no telegram '7'; it has 1" in cli.err("device", "check", "fan.toml", "--telegram", "7")


def test_a_file_by_its_name(fan: Path, cli: Cli, quick: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DPSTACK_DEVICES", str(fan.parent))
    monkeypatch.chdir("/")
    assert cli.json("device", "check", "fan")["file"] == str(fan)
    assert cli.json("device", "check", "profidrive", "--telegram", "3")["sound"]


def test_an_encoder_comes_into_data_exchange(cli: Cli) -> None:
    """It is no drive: its examples, and the bring-up in the simulation."""
    found = cli.json("device", "check", "simodrive-sensor", "--telegram", "class2")
    assert found["sound"]
    assert [one["holds"] for one in found["examples"]] == [True] * 4
    assert found["checks"] == [
        {"check": "it comes into data exchange", "telegram": "class2", "passed": True, "reason": ""}
    ]
