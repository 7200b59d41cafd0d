"""``dpstack hart``: what it prints, on a terminal and in a pipe, and how it ends."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_kit import Cli
from plant_files import plant_file

import dpstack
from dpstack.cli.commands.acyclic import show_hart

IO = {"name": "io", "address": 8, "gsd": "io-station", "modules": ["8 DI", "2 AI HART"]}
pytestmark = pytest.mark.usefixtures("alone")


@pytest.fixture
def run(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cli:
    """The command on the port "virtual", whose slaves are simulated for it, in virtual time."""
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    return cli.of("hart", str(plant_file(tmp_path, IO, port="virtual", baud=500_000, cycle_ms=20.0)))


def test_all_that_a_transmitter_says_of_itself(run: Cli) -> None:
    out, err = run("io", "0")
    assert err == ""
    rows = dict(line.split("  ", 1) for line in out.splitlines()[1:] if "  " in line)
    assert out.startswith("slave 8 (io): slot 2, channel 0\n")
    shown = {what: value.strip() for what, value in rows.items()}
    assert (shown["tag"], shown["PV"], shown["loop current"]) == ("PT-101", "5 bar", "12 mA")
    assert (shown["range"], shown["device status"]) == ("0 to 10 bar", "cold start")


def test_all_channels_of_the_module(run: Cli) -> None:
    rows = {" ".join(line.split()) for line in run.out("io").splitlines()}
    assert rows >= {"slave 8 (io): slot 2", "HART channels 2", "request records 80, 82", "profile revision 2.0"}
    told = run.json("io", "--class", "2")
    assert [one["tag"] for one in told["channels"]] == ["PT-101", "TT-102"]
    assert told["channels"][0]["variables"][0] == {"name": "PV", "value": 5.0, "unit": "bar", "unit_code": 7}


def test_one_command(run: Cli) -> None:
    out = run.out("8", "1", "command", "3", "--slot", "2")
    assert [" ".join(line.split()) for line in out.splitlines()] == [
        "slave 8 (io): slot 2, channel 1, HART command 3",
        "what value",
        "loop current 8 mA",
        "PV 0 °C",
        "device status good",
    ]


def test_as_json_over_a_connection_in_compact_format(run: Cli) -> None:
    told = run.json("io", "0", "command", "35", "07", "41A0 0000", "00000000", "--class", "2", "--compact")
    assert (told["command"], told["slot"], told["through"]) == (35, 2, "master")
    assert told["data"] == "0741a0000000000000"
    assert told["device_status"] == ["configuration changed", "cold start"]


@pytest.mark.parametrize(
    ("args", "code", "text"),
    [
        (["pump", "0"], 2, "no slave 'pump' in this configuration; there are: 8 (io)"),
        (["io", "2"], 1, "slot 2 has the HART channels 0 to 1, no channel 2"),
        (["io", "0", "--slot", "1"], 1, "slot 1 has no HART module (record 148: invalid index)"),
        (["io", "0", "--slot", "x"], 2, "'x' is no slot"),
        (["io", "1", "command", "20"], 1, "the device refuses command 20: command not implemented"),
        (["io", "0", "comand", "3"], 2, "behind CHANNEL write command N [HEX]"),
        (["io", "0", "command"], 2, "behind CHANNEL write command N [HEX]"),
        (["io", "0", "command", "3", "0G"], 2, "'0G': 'G' is no hex digit"),
        (["io", "0", "--address", "3"], 2, "--address is for --class 2"),
    ],
)
def test_refusals(run: Cli, args: list[str], code: int, text: str) -> None:
    out, err = run(*args, code=code)
    assert out == ""
    assert text in err


def test_texts_of_a_device_never_reach_a_terminal_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    head = {"slave": "io", "address": 8, "slot": 2, "channel": 0, "command": None}
    show_hart({**head, "rows": [["long tag", "\x1b[2J\u202eTP"], ["descriptor", "a\nb"]]})
    out = capsys.readouterr().out
    assert "\x1b[2J" not in out
    assert r"\x1b[2J\u202eTP" in out
    assert r"a\nb" in out
