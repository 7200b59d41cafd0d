"""``dpstack run`` with a slave that flaps: its state at the end is chance, so the exit code does not follow it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path

import pytest
from api_kit import RAW, bench_of
from cli_kit import Cli
from plant_files import plant_file

import dpstack
from dpstack.cli.terminal.causes import CauseLines
from dpstack.drivers.virtual import loop

OTHER = {**RAW, "name": "other", "address": 4}


def flapping_run(monkeypatch: pytest.MonkeyPatch, offs: Sequence[float]) -> None:
    """Slave 9 of `dpstack run` on "virtual" has no power for 0.3 s at these times in s."""

    class Lines(CauseLines):
        def __init__(self, bus: dpstack.Bus) -> None:
            super().__init__(bus)
            loop = asyncio.get_running_loop()
            for at in offs:
                loop.call_later(at, lambda: bench_of(bus).power(9, False))
                loop.call_later(at + 0.3, lambda: bench_of(bus).power(9, True))

    monkeypatch.setattr("dpstack.cli.terminal.causes.CauseLines", Lines)
    monkeypatch.setattr(asyncio, "run", loop.run)


def test_a_run_ends_with_1_if_a_slave_is_in_data_exchange_by_chance(
    tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    flapping_run(monkeypatch, [1.0, 2.0, 3.0])
    plant = str(plant_file(tmp_path, RAW, OTHER, baud=45_450))
    out, err = cli("run", plant, "--seconds", "4", "--plain", code=1)
    says = "slave 9 (raw) flaps: it is in data exchange at this moment, but has left it several times"
    assert says in err
    assert "1. reboots (87 %): the slave restarts again and again" in out
    summary = cli.json("run", plant, "--seconds", "4", code=1)
    assert summary["why"]["9"]["causes"][0]["cause"] == "reboots"


@pytest.mark.parametrize(("offs", "seconds"), [([1.0], 2.0), ([1.0, 2.0], 20.0)])
def test_one_loss_and_losses_of_long_ago_are_no_flapping(
    offs: list[float], seconds: float, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    flapping_run(monkeypatch, offs)
    _, err = cli("run", str(plant_file(tmp_path, RAW, OTHER, baud=45_450)), "--seconds", f"{seconds}", "--plain")
    assert "flaps" not in err


def test_losses_of_a_scenario_are_wanted(tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(asyncio, "run", loop.run)
    steps = "".join(f'[[step]]\nat = {at}\nslave = "raw"\ndo = "power_off"\nfor = 0.3\n' for at in (1.0, 2.0))
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(steps, encoding="utf-8")
    plant = str(plant_file(tmp_path, RAW, OTHER, baud=45_450))
    assert "raw" in cli.out("run", plant, "--seconds", "3", "--plain", "--scenario", str(scenario))
