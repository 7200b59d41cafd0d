"""Commands at a plant with an S7-200: plan, run and sim say what it is, and what it costs."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_kit import Cli

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
    assert "CPU 2 (press) is an S7-200, which this command cannot ask: `dpstack ppi` can" in cli.err(
        "why", plant, "press"
    )


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
