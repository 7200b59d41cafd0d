"""``drive`` and ``acyclic`` on the port "virtual" without a run warn that the slaves are simulated for this command."""

from __future__ import annotations

import asyncio
import json
import threading
from pathlib import Path

import pytest
from cli_kit import SIMULATED, Cli
from plant_files import plant_file

import dpstack
from dpstack.api.control.handlers import control_run
from dpstack.cli.main import main

Out = pytest.CaptureFixture[str]
IO = {"name": "io", "address": 8, "gsd": "io-station", "modules": ["8 DI", "8 DO"]}
PUMP = {"name": "pump", "address": 3, "drive": "demag-dedrive", "simulated": {"ready": True}}
IM0 = ["acyclic", "PLANT", "8", "im", "2"]
COMMANDS = [IM0, [*IM0, "--class", "2"], ["drive", "PLANT", "pump", "status"]]

pytestmark = pytest.mark.usefixtures("alone")


@pytest.fixture
def plant(tmp_path: Path) -> str:
    return str(plant_file(tmp_path, IO, PUMP))


def given(command: list[str], plant: str) -> list[str]:
    return [plant if word == "PLANT" else word for word in command]


@pytest.mark.parametrize("command", COMMANDS)
def test_in_one_line_beside_the_json(command: list[str], plant: str, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    out, err = cli(*given(command, plant), "--json")
    assert err == SIMULATED
    (line,) = out.splitlines()
    told = json.loads(line)
    assert told["through"] == "master"
    if told["order"] == "im":
        assert told["im"]["0"]["order_id"] == "8 DO"


def test_an_order_refused_before_the_bus_opens_is_one_line(plant: str, capsys: Out) -> None:
    plant_file(Path(plant).parent, IO, PUMP, read_only=True)
    for command in COMMANDS:
        assert main(given(command, plant)) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "leave read_only out" in line


def test_a_run_that_holds_it_is_asked_and_nothing_is_told(plant: str, cli: Cli) -> None:
    up, over = threading.Event(), threading.Event()

    async def run() -> None:
        async with dpstack.open_bus(plant) as bus, control_run(bus, "virtual"):
            await bus.ready()
            up.set()
            await asyncio.to_thread(over.wait)

    holder = threading.Thread(target=lambda: asyncio.run(run()))
    holder.start()
    try:
        assert up.wait(20)
        for command in COMMANDS:
            out, err = cli(*given(command, plant), "--json")
            assert err == ""
            assert json.loads(out)["through"] == "run"
    finally:
        over.set()
        holder.join()
