"""``dpstack gsd``: what people and scripts read, and the way from a file to a table that a configuration accepts."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from gsd_kit import FILES

from dpstack.api.config import parse_config
from dpstack.cli.main import main

WHOLE = str(FILES / "whole.gsd")


def test_show_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gsd", "show", WHOLE, "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert {
        key: shown[key]
        for key in (
            "ident",
            "vendor",
            "model",
            "gsd_revision",
            "modular",
            "max_module",
            "max_input_len",
            "max_output_len",
            "max_data_len",
            "max_diag_data_len",
            "user_prm",
            "user_prm_const",
            "unit_diag_bits",
        )
    } == {
        "ident": "0x1A2B",
        "vendor": "Nobody & Sons",
        "model": "Terminal 8",
        "gsd_revision": 5,
        "modular": True,
        "max_module": 4,
        "max_input_len": 16,
        "max_output_len": 8,
        "max_data_len": 20,
        "max_diag_data_len": 32,
        "user_prm": "8000000800",
        "user_prm_const": "8000000000",
        "unit_diag_bits": 1,
    }
    assert [
        {k: m[k] for k in ("name", "reference", "config", "inputs", "outputs", "user_prm")} for m in shown["modules"]
    ] == [
        {"name": "8 DI", "reference": 1, "config": "10", "inputs": 1, "outputs": 0, "user_prm": "0101f4"},
        {"name": "8 DO", "reference": 2, "config": "20", "inputs": 0, "outputs": 1, "user_prm": ""},
        {"name": "4 AI", "reference": 3, "config": "4343010203", "inputs": 8, "outputs": 0, "user_prm": ""},
    ]
    assert shown["diagnostics"] == []  # a default over zero bits of the constants is the usual way
    assert main(["gsd", "show", str(FILES / "prm.gsd"), "--json"]) == 0
    found = [d for d in json.loads(capsys.readouterr().out)["diagnostics"] if "contradict" in d["message"]]
    assert [(d["line"], d["column"], d["severity"]) for d in found] == [(39, 1, "warning")]
    assert found[0]["message"].startswith("the device: defaults contradict the constant octets (Diagnosis@3.3:")


def test_show_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gsd", "show", WHOLE]) == 0
    out = capsys.readouterr().out
    for text in ("Terminal 8", "0x1A2B", "4 AI", "43 43 01 02 03", "Diagnosis", "off, on", "12 Mbit/s", "sync, freeze"):
        assert text in out


@pytest.mark.parametrize("name", sorted(path.stem for path in FILES.glob("*.gsd")))
def test_every_file_is_shown(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(FILES / f"{name}.gsd")
    assert main(["gsd", "show", path]) == 0
    assert main(["gsd", "show", path, "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["ident"]


def test_check_tells_and_judges(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["gsd", "check", str(FILES / "slots.gsd"), str(FILES / "mark_missing.gsd")]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"{FILES}/slots.gsd: nothing is wrong",
        f"{FILES}/mark_missing.gsd:1:1: warning: no line #Profibus_DP, which begins a GSD file; read from its first "
        "line",
    ]
    wrong = tmp_path / "wrong.gsd"
    wrong.write_bytes(b"")
    assert main(["gsd", "check", str(wrong), str(FILES / "damaged_module.gsd"), "--json"]) == 1
    first, second = map(json.loads, capsys.readouterr().out.splitlines())
    assert first == {
        "file": str(wrong),
        "diagnostics": [
            {"line": 1, "column": 1, "severity": "error", "message": "the file is empty; get a whole copy of it"}
        ],
    }
    assert [d["severity"] for d in second["diagnostics"]].count("error") == 3


def test_check_tells_that_a_modular_station_has_no_module(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    cut = tmp_path / "cut.gsd"
    cut.write_text((FILES / "whole.gsd").read_text(encoding="utf-8").partition('Module = "')[0], encoding="utf-8")
    assert main(["gsd", "check", str(cut)]) == 0
    assert "a modular station (Modular_Station = 1) without any Module: the file may be cut short" in (
        capsys.readouterr().out
    )


@pytest.mark.parametrize("command", ["show", "configure"])
def test_what_cannot_be_read(command: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["gsd", command, str(tmp_path / "none.gsd")]) == 2
    assert capsys.readouterr().err == (
        f"dpstack: {tmp_path}/none.gsd: No such file or directory; give the path of a GSD file\n"
    )
    assert main(["gsd", command, __file__]) == 2
    assert "no GSD file: no line #Profibus_DP" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["show", "check"])
def test_a_name_that_is_nearly_one(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gsd", command, "io-sttion"]) == 2
    assert capsys.readouterr().err == (
        "dpstack: io-sttion: No such file or directory; did you mean io-station, or give the path of a GSD file?\n"
    )


def test_alarms_are_shown_by_their_names_in_a_configuration(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gsd", "show", "io-station"]) == 0
    assert "pull_plug, process, diagnostic, update; one of each at a time or 8 in all" in capsys.readouterr().out
    assert main(["gsd", "show", "io-station", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["alarms"] == ["pull_plug", "process", "diagnostic", "update"]
    assert (shown["alarms_required"], shown["alarm_sequence"]) == ([], 8)


def configure(name: str, answers: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(answer + "\n" for answer in answers)))
    return main(["gsd", "configure", str(FILES / f"{name}.gsd")])


BUS = '[bus]\nport = "virtual"\nbaud = 500000\n'


def test_configure(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    answers = ["valves", "126", "8", "n", "8 DI", "9 DO", "2", "-", "", "y", "off", "2000", "33"]
    assert configure("whole", answers, monkeypatch) == 0
    out, err = capsys.readouterr()
    assert out.splitlines() == [
        "[[slave]]",
        'name = "valves"',
        "address = 8",
        f'gsd = "{WHOLE}"',
        'modules = ["8 DI", "8 DO", ""]',
        'parameters = { "Diagnosis" = "off", "Delay" = 33 }',
        "# identifier octets 10 20 00: 1 octets of inputs, 1 of outputs",
        "# user parameters 80 00 00 00 00 01 00 21",
    ]
    for told in ("'126' is no station address", "there is no module '9 DO'", "'Delay' = 2000 is not allowed"):
        assert told in err
    slave = parse_config(BUS + out, "plant.toml").slaves[0]
    assert (slave.config.hex(), slave.user_prm.hex()) == ("102000", "8000000000010021")


@pytest.mark.parametrize(
    ("name", "answers", "config", "modules"),
    [
        ("whole", ["", "3", "", ""], "20", '["8 DO"]'),
        ("equal_names", ["r", "4", "Reserve", "2", "1", "twin"], "201000", '[2, 1, "Twin"]'),
        ("prm_old", ["old", "6", "y"], "1323", '["fixed"]'),
    ],
)
def test_its_tables_are_accepted(
    name: str,
    answers: list[str],
    config: str,
    modules: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    code = configure(name, answers, monkeypatch)
    out = capsys.readouterr().out
    assert (code, parse_config(BUS + out, "plant.toml").slaves[0].config.hex()) == (0, config)
    assert f"modules = {modules}\n" in out


def test_slots_refuse_at_once(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert configure("slots", ["s", "5", "n", "1", "4", "5", "2", ""], monkeypatch) == 0
    out, err = capsys.readouterr()
    assert "is not allowed in slot 2 (signals); allowed references: 2..3, 5" in err
    assert "4 octets of outputs, the device has at most 2" in err
    assert parse_config(BUS + out, "plant.toml").slaves[0].config.hex() == "0011"


def test_answers_that_end_too_early(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert configure("whole", ["valves"], monkeypatch) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.endswith("the answers ended before the table was complete; nothing was written\n")


def test_the_files_of_bundled_drives_by_name(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["gsd", "show", "demag-dedrive", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ident"] == "0x0696"
    assert main(["gsd", "check", "demag-dedrive", "keb-f5", "io-station"]) == 0
    capsys.readouterr()
    target = tmp_path / "hoist.gsd"
    assert main(["gsd", "copy", "demag-dedrive", str(target)]) == 0
    assert target.read_bytes().startswith(b"#Profibus_DP")
    assert main(["gsd", "copy", "demag-dedrive", str(target)]) == 2
    assert main(["gsd", "copy", "fuji-frenic", str(target)]) == 2
    assert capsys.readouterr().err == (
        f"dpstack: {target}: File exists; give the name of a new file\n"
        "dpstack: no GSD file was written for 'fuji-frenic'; there is one for demag-dedrive, keb-f5, ls-s100, "
        "io-station\n"
    )
