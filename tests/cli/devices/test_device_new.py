"""``dpstack device new``: a first device file from a GSD file, by options and by questions, that ``check`` accepts."""

from __future__ import annotations

import io
import itertools
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from cli_kit import Cli
from gsd_kit import PROFIDRIVE

from dpstack.profile import DriveProfile
from dpstack.testing.drive_conformance import Outcome, run_checks

OWN = "Telegram 352, PZD-6/6"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gsd").mkdir()
    (tmp_path / "gsd" / "n1.gsd").write_text(PROFIDRIVE)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    monkeypatch.setattr("dpstack.cli.devices.check.run_checks", first_checks)
    return tmp_path


def first_checks(profile: DriveProfile, telegrams: Sequence[str], **settings: Any) -> Iterator[Outcome]:
    """The checks of the declarations, and the first one on the bus with each telegram; all of them take long."""
    return itertools.islice(run_checks(profile, telegrams, **settings), 2 + len(telegrams))


def answers(monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    """A terminal with somebody who types."""
    typed = io.StringIO("".join(f"{line}\n" for line in lines))
    monkeypatch.setattr(typed, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdin", typed)


def test_all_standard_telegrams_and_the_file_is_sound_at_once(folder: Path, cli: Cli) -> None:
    err = cli.err("device", "new", "--gsd", "gsd/n1.gsd", "-o", "fan.toml", code=0)
    assert err == "fan.toml: written, telegrams 1 PPO1 PPO4; next: dpstack device check fan.toml\n"
    text = (folder / "fan.toml").read_text()
    assert tomllib.loads(text) == {
        "format": 1,
        "name": "fan",
        "title": "Nobody Drives Inverter N1",
        "base": "profidrive",
        "gsd": "gsd/n1.gsd",
        "telegrams": {
            "1": {"modules": ["Standard telegram 1, PZD-2/2"]},
            "PPO1": {"modules": ["PPO 1: 4 PKW + 2 PZD"]},
            "PPO4": {"modules": ["6 PZD"]},
        },
        "words": {},
    }
    for hint in ("# [fault]\n", "# [parameters]\n", "# [settings]\n", "# [[example]]\n", "# source = "):
        assert hint in text, hint
    found = cli.json("device", "check", "fan.toml")
    assert {one["telegram"] for one in found["checks"]} == {"", "1", "PPO1", "PPO4"}


def test_the_hints_are_keys_that_the_reader_knows(folder: Path, cli: Cli) -> None:
    text = cli.out("device", "new", "--gsd", "gsd/n1.gsd", "--name", "fan")
    taken = [line.removeprefix("# ") if " = " in line or line.startswith("# [") else line for line in text.splitlines()]
    (folder / "fan.toml").write_text("\n".join(taken))
    found = cli.json("device", "check", "fan.toml")
    assert found["examples"] == [{"line": 46, "holds": True}]


def test_a_telegram_of_no_standard_with_its_words(folder: Path, cli: Cli) -> None:
    new = ["device", "new", "--gsd", "gsd/n1.gsd", "--name", "fan", "--modules", OWN]
    data = tomllib.loads(cli.out(*new))
    assert data["telegrams"] == {
        "352": {
            "modules": [OWN],
            "out": ["control", "setpoint", 0, 0, 0, 0],
            "in": ["status", "speed", "word_3", "word_4", "word_5", "word_6"],
        }
    }
    words = [
        "--out",
        "control",
        "setpoint",
        "limit:n2",
        "0x10",
        "0",
        "0",
        "--in",
        "status",
        "speed:n4",
        "load",
        "a:f32",
    ]
    data = tomllib.loads(cli.out(*new, *words, "--title", "Exhaust"))
    assert data["telegrams"]["352"]["out"] == ["control", "setpoint", "limit", 16, 0, 0]
    assert data["words"] == {"limit": {"type": "n2"}, "load": {}, "a": {"type": "f32"}}
    assert data["telegrams"]["352"]["in"] == ["status", "speed_b", "load", "a"]
    assert data["title"] == "Exhaust"
    cli("device", *new[1:6], "--modules", "352", *words, "-o", "fan.toml")
    assert cli.json("device", "check", "fan.toml")["sound"]


def test_a_telegram_of_two_modules(folder: Path, cli: Cli) -> None:
    cli("device", "new", "--gsd", "gsd/n1.gsd", "--modules", "4 PKW", "6 PZD", "-o", "fan.toml")
    data = tomllib.loads((folder / "fan.toml").read_text())
    assert data["telegrams"] == {"PPO2": {"modules": ["4 PKW", "6 PZD"]}}
    assert cli.json("device", "check", "fan.toml")["sound"]


def test_without_states_check_says_what_is_missing(folder: Path, cli: Cli) -> None:
    cli("device", "new", "--gsd", "gsd/n1.gsd", "--base", "bits", "--modules", OWN, "-o", "fan.toml")
    text = (folder / "fan.toml").read_text()
    assert "# states = { fault = [0x0008, 0x0008]," in text
    out = cli.out("device", "check", "fan.toml", code=1)
    assert "no states; add states = { running = [mask, value], ... }" in out
    taken = [line.removeprefix("# ") for line in text.splitlines()]
    own = [line for line in taken if line.startswith(("[control]", "run =", "goals =", "[status]", "states ="))]
    (folder / "fan.toml").write_text("\n".join([text, *own]))
    assert "setpoint has no scale; give full, the counts at 100 %" in cli.out("device", "check", "fan.toml", code=1)
    for word in ("setpoint", "speed"):
        text = text.replace(f"{word} = {{}}", f'{word} = {{ type = "n2" }}')
    (folder / "fan.toml").write_text("\n".join([text, *own]))
    assert cli.json("device", "check", "fan.toml")["sound"]


def test_questions_on_a_terminal(folder: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    answers(
        monkeypatch,
        "",  # base
        "9",
        "1, 2",
        "control setpoint limit 0 0",
        "control setpoint limit 0 0 0",
        "status speed load torque fault fault",
        "status speed load torque warning fault",
    )
    err = cli.err("device", "new", "--gsd", "gsd/n1.gsd", "-o", "fan.toml", code=0)
    assert "base, profidrive, drivecom, bits [profidrive]: " in err
    assert "   2  'Telegram 352, PZD-6/6': 6 words to the drive, 6 from it\n" in err
    assert "dpstack: numbers of 1..4 with blanks between, or all; type them" in err
    assert "dpstack: the words to the drive have 10 octets, the telegram has 12; a word has two octets" in err
    assert "dpstack: the word 'fault' is there twice" in err
    data = tomllib.loads((folder / "fan.toml").read_text())
    assert list(data["telegrams"]) == ["1", "352"]
    assert data["telegrams"]["352"]["in"] == ["status", "speed", "load", "torque", "warning", "fault"]
    assert cli.json("device", "check", "fan.toml")["sound"]


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--gsd", "nowhere.gsd"], "nowhere.gsd: there is no such GSD file"),
        (["--gsd", "keb-f5"], "keb-f5: there is no such GSD file"),
        (["--gsd", "gsd/n1.gsd", "--name", "../x"], "'../x' is no name"),
        (["--gsd", "gsd/n1.gsd", "--name", "a", "-o", "b.toml"], "the file of a must be called a.toml"),
        (["--gsd", "gsd/n1.gsd", "-o", "gsd/n1.gsd"], "the file of n1 must be called n1.toml"),
        (["--gsd", "gsd/n1.gsd", "-o", "there.toml"], "there.toml: there is a file of that name"),
        (["--gsd", "gsd/n1.gsd", "--modules", "status only"], "0 of outputs are no telegram of a drive"),
        (["--gsd", "gsd/n1.gsd", "--modules", "nothing"], "there is no module 'nothing'"),
        (["--gsd", "gsd/n1.gsd", "--modules", "1", "--modules", "1"], "two rows of modules make telegram 1"),
        (["--gsd", "gsd/n1.gsd", "--base", "drivecom"], "name modules by --modules; they are Standard telegram 1"),
        (["--gsd", "gsd/n1.gsd", "--out", "control"], "--out and --in are for one telegram"),
        (["--gsd", "gsd/n1.gsd", "--modules", OWN, "--out", "setpoint"], "the first word to the drive is 'control'"),
        (["--gsd", "gsd/n1.gsd", "--modules", OWN, "--in", "status", "4x"], "'4x' is neither a name nor a constant"),
        (["--gsd", "gsd/n1.gsd", "--modules", OWN, "--in", "status", "a:u8"], "'a:u8': there is no type 'u8'"),
    ],
)
def test_wrong_use_writes_nothing(args: list[str], said: str, folder: Path, cli: Cli) -> None:
    (folder / "there.toml").write_text("format = 1\n")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert said in cli.err("device", "new", *args)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
