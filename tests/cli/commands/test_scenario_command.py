"""`run --scenario` and `sim --scenario`: each step is a line, and a master sees it."""

from __future__ import annotations

import asyncio
import json
import re
from pathlib import Path
from typing import Any

import pytest
from api_kit import RAW
from cli_kit import Cli

import dpstack
from dpstack.api.config.config import load_config, make_config
from dpstack.api.control.scenario import ScenarioRun, load_scenario, parse_scenario
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.slave_side.simulation import Simulation, sim_event_json
from dpstack.dp.master.events import SlaveDiagnosis
from dpstack.drivers.virtual import loop

ROOT = Path(__file__).resolve().parents[3]
PLANT, FAULTS = ROOT / "examples" / "plant.toml", ROOT / "examples" / "faults.toml"


def test_the_example_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cli: Cli) -> None:
    """In virtual time, with a tenth of its times."""
    text = FAULTS.read_text(encoding="utf-8").replace("repeat = 24.0", "").replace("by_ms = 20", "by_ms = 0.5")
    text = re.sub(r"(?m)^(at|for) = (.*)", lambda found: f"{found[1]} = {float(found[2]) / 10}", text)
    (tmp_path / "faults.toml").write_text(text, encoding="utf-8")
    monkeypatch.setattr(asyncio, "run", loop.run)
    plant = tmp_path / "plant.toml"
    plant.write_text(PLANT.read_text(encoding="utf-8").replace("500000", "93750\ncycle_ms = 40"), encoding="utf-8")
    told = cli.jsons("run", str(plant), "--scenario", str(tmp_path / "faults.toml"), "--seconds", "3")
    steps = [(line["t"], line["step"], line["state"]) for line in told if line["event"] == "scenario"]
    assert steps == [
        (0.2, 1, "begin"),
        (0.4, 1, "end"),
        (0.5, 2, "begin"),
        (0.6, 2, "end"),
        (0.8, 3, "begin"),
        (1.0, 3, "end"),
        (1.2, 4, "begin"),
        (1.3, 4, "end"),
        (1.5, 5, "begin"),
        (1.55, 5, "end"),
        (1.7, 6, "begin"),
        (1.8, 6, "end"),
        (1.9, 7, "begin"),
        (2.0, 8, "begin"),
        (2.2, 7, "end"),
        (2.2, 0, "over"),
    ]
    seen = [str(line) for line in told]
    for word in ("line break", "refuses Data_Exchange (RS)", "F2100", "stopped answering"):
        assert any(word in line for line in seen), word


async def test_a_scenario_behind_a_pty() -> None:
    """The faults of a simulated slave on a port, as a master on that port sees them; none of them ends."""
    lines: list[dict[str, Any]] = []
    over, read, refused = asyncio.Event(), asyncio.Event(), asyncio.Event()

    def told(event: dpstack.Event) -> None:
        lines.append(sim_event_json(event, 0.0))
        if lines[-1].get("state") == "over":
            over.set()

    def seen(event: dpstack.Event) -> None:
        if isinstance(event, SlaveDiagnosis) and event.diagnosis.ext == bytes.fromhex("80 43 26"):
            read.set()
        if "refuses Data_Exchange (RS)" in event.text:
            refused.set()

    text = "".join(
        f'[[step]]\nat = {at}\nslave = "raw"\ndo = "{do}"\n{keys}\n'
        for at, do, keys in (
            (0.0, "diagnosis", 'octets = "80 43 26"'),
            (0.05, "late_answers", "by_ms = 4"),
            (0.1, "rs", ""),
        )
    )
    config = make_config("/dev/elsewhere", 500_000, 2, [RAW])
    async with Simulation(config, "pty", 500_000) as simulation:
        simulation.on_event = told
        master = config.with_bus(port=simulation.port_name)
        async with dpstack.open_bus(master, on_event=seen) as bus:
            await bus.ready(20)
            scenario = parse_scenario(text, simulation, slave_handlers(simulation))
            ScenarioRun(scenario, simulation, simulation.publish).start(simulation.now)
            async with asyncio.timeout(20):
                for one in (over, read, refused):
                    await one.wait()
        assert simulation.injected(9) == [
            "diagnosis 80 43 26",
            "late answers by 4 ms",
            "Data_Exchange refused with RS",
        ]
    states = [(line["step"], line["state"], line["text"]) for line in lines if line["event"] == "scenario"]
    assert [state[:2] for state in states] == [(1, "begin"), (2, "begin"), (3, "begin"), (0, "over")]
    assert states[-1][2] == "scenario: all 3 steps are over; steps 1, 2 and 3 still act"


def test_each_step_is_in_the_log(cli: Cli, tmp_path: Path) -> None:
    text = '[[step]]\nat = 0\nslave = "valves"\ndo = "diagnosis"\nerror = "line break"\nchannel = 3\n'
    (tmp_path / "one.toml").write_text(text, encoding="utf-8")
    files = ("--scenario", str(tmp_path / "one.toml"), "--log", str(tmp_path / "sim.jsonl"))
    shown = cli.out("sim", str(PLANT), "--port", "pty", *files, "--seconds", "0.05")
    said = "scenario step 1, slave 8 (valves): diagnosis, slot 1, output channel 3 (bit): line break"
    assert said in shown
    logged = [json.loads(line) for line in (tmp_path / "sim.jsonl").read_text(encoding="utf-8").splitlines()]
    (line,) = [line for line in logged if line.get("step") == 1]
    assert (line["event"], line["state"], line["severity"], line["text"]) == ("scenario", "begin", "info", said)
    assert line["time"].endswith("Z")


def test_a_scenario_needs_simulated_slaves(cli: Cli, tmp_path: Path) -> None:
    said = cli.err("run", str(PLANT), "--port", "/dev/nowhere", "--scenario", str(FAULTS))
    assert said == (
        'dpstack: --scenario on /dev/nowhere: only simulated slaves have one; take "virtual", or dpstack sim\n'
    )
    wrong = tmp_path / "wrong.toml"
    wrong.write_text('[[step]]\nat = 1\nslave = "fan"\ndo = "rz"\n', encoding="utf-8")
    for command in (("run", str(PLANT)), ("sim", str(PLANT), "--port", "pty")):
        assert cli.err(*command, "--scenario", str(wrong)).startswith(
            f"dpstack: {wrong}:4: [[step]] 1: unknown do 'rz'; did you mean 'rs'?"
        )
    assert "there is no such file" in cli.err("run", str(PLANT), "--scenario", str(tmp_path / "none.toml"))


def test_the_example_fits_its_plant() -> None:
    async def check() -> None:
        simulation = Simulation(load_config(PLANT), "pty", 500_000)
        assert len(load_scenario(FAULTS, simulation, slave_handlers(simulation)).steps) == 8

    asyncio.run(check())
