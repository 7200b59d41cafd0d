"""Commands at a plant with an S7-200: plan, run and sim say what it is, and what it costs."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_kit import Cli

from dpstack.cli.commands import ctl

PLANT = """
[bus]
port = "virtual"
baud = 187500

[[ppi]]
address = 2
name = "press"
values = { level = { at = "VW100", unit = "cm" }, on = "M0.3" }
"""


@pytest.fixture
def plant(tmp_path: Path) -> str:
    (tmp_path / "plant.toml").write_text(PLANT, encoding="utf-8")
    return str(tmp_path / "plant.toml")


def test_plan_names_the_polls(cli: Cli, plant: str) -> None:
    assert "CPU 2 (press): 2 values by 1 request every 500 ms; each takes up to" in cli.out("plan", plant)
    (poll,) = cli.json("plan", plant)["ppi"]
    assert {key: poll[key] for key in ("address", "name", "values", "requests", "poll_ms", "fits")} == {
        "address": 2,
        "name": "press",
        "values": 2,
        "requests": 1,
        "poll_ms": 500,
        "fits": True,
    }
    assert "they fit between no two cycles" in cli.out("plan", plant, "--cycle-ms", "4", code=1)


def test_run_has_its_values_in_the_summary(cli: Cli, plant: str) -> None:
    lines = cli.jsons("run", plant, "--seconds", "0.3")
    assert {"address": 2, "name": "press", "state": "data_exchange"}.items() <= next(
        line for line in lines if line["event"] == "slave"
    ).items()
    summary = lines[-1]["slaves"]["2"]
    assert summary["fields"] == {"level": 0, "on": False}
    assert (summary["protocol"], summary["units"]) == ("ppi", {"level": "cm"})


def test_run_ends_with_1_while_the_cpu_is_away(cli: Cli, plant: str, tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text('[[step]]\nat = 0.1\ndo = "power-off"\nslave = "press"\n', encoding="utf-8")
    out, err = cli("run", plant, "--seconds", "1", "--scenario", str(scene), code=1)
    assert "slave 2 (press): offline" in out
    assert "slave 2 (press): power off" in out
    assert "CPU 2 (press) gives no values: CPU 2 does not answer: check address, rate, cable and supply" in err


def test_other_commands_say_what_it_is(cli: Cli, plant: str) -> None:
    err = cli.err("why", plant, "press")
    assert "CPU 2 (press) is an S7-200, which this command cannot ask: `dpstack ppi` can, or while a run" in err


def test_names_lists_its_values_and_takes_no_row_of_them(cli: Cli, plant: str, tmp_path: Path) -> None:
    written = PLANT.replace("values =", 'allow_commands = ["on"]\nvalues =')
    Path(plant).write_text(written, encoding="utf-8")
    lines = cli.out("names", plant).splitlines()
    assert [line.split() for line in lines[2:]] == [
        ["press", "input", "level", "VW100", "cm"],
        ["press", "output", "on", "M0.3"],
    ]
    (level, on) = cli.json("names", plant)["names"]
    assert (level["address"], level["type"], level["octet"], level["unit"]) == (2, "VW100", None, "cm")
    assert (on["direction"], on["slot"], on["bit"]) == ("output", None, None)
    file = tmp_path / "list.csv"
    cli.out("names", plant, "--csv", str(file))
    out, err = cli("names", plant, "--from", str(file))
    assert "nothing to change" in out
    assert "list.csv: the rows of press are not read: values of a CPU stand in [[ppi]], change them there" in err
    assert Path(plant).read_text(encoding="utf-8") == written


def test_sheet_has_its_settings_and_values(cli: Cli, plant: str, tmp_path: Path) -> None:
    (sheet,) = cli.json("sheet", plant, "press")["sheets"]
    assert (sheet["kind"], sheet["address"], [one["at"] for one in sheet["values"]]) == ("ppi", 2, ["VW100", "M0.3"])
    out = cli.out("sheet", plant)
    for text in ("press, address 2: S7-200 (PPI)", "baud rate = 187.5 kbit/s", "what was written stays", "VW100"):
        assert text in out
    for text in ("ident number", "watchdog   ", "LEDs", "slot"):
        assert text not in out
    cli.out("sheet", plant, "2", "--html", str(tmp_path / "sheet.html"))
    assert "VW100" in (tmp_path / "sheet.html").read_text(encoding="utf-8")
    assert cli.err("sheet", plant, "prss") == "dpstack: no slave is called 'prss'; did you mean press?\n"


def test_scenarios_set_its_values(cli: Cli, plant: str, tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    step = '[[step]]\nat = 0.1\nslave = "press"\n'
    scene.write_text(f'{step}do = "set"\ninputs = {{ level = 7 }}\n', encoding="utf-8")
    summary = cli.json("run", plant, "--seconds", "1", "--scenario", str(scene))
    assert summary["slaves"]["2"]["fields"]["level"] == 7
    scene.write_text(f'{step}do = "set"\ninputs = {{ levle = 7 }}\n', encoding="utf-8")
    assert "no value is called 'levle'; did you mean level" in cli.err("run", plant, "--scenario", str(scene))
    scene.write_text(f'{step}do = "rs"\n', encoding="utf-8")
    assert "rs is for DP slaves; CPU 2 (press) is an S7-200; take set" in cli.err(
        "run", plant, "--scenario", str(scene)
    )


def test_ctl_shows_the_meaning_of_a_number_and_the_time_of_trouble_only(capsys: pytest.CaptureFixture[str]) -> None:
    running = {"quality": "good", "reason": "good", "text": "running", "since": 5.6, "remedy": ""}
    refused = {"quality": "bad", "reason": "no_value", "text": "refused", "since": 0.2, "remedy": ""}
    fields: dict[str, object] = {"blade": 1, "out": None, "level": 0}
    ctl._show({"fields": fields, "qualities": {"blade": running, "out": refused}})
    assert capsys.readouterr().out.splitlines() == [
        "fields: blade 1 (running), out none (bad), level 0",
        "qualities:",
        "  blade: good: running",
        "  out: bad: refused (since 0.2 s)",
    ]
