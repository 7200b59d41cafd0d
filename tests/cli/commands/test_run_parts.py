"""Parts of ``dpstack run`` beside the bus: ``--record``, ``--rotate``, ``--on-change``, ``--log``; a connector in
the configuration begins before the bus, and ends after it, however the run ends."""

from __future__ import annotations

import csv
import json
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import probe_connector
import pytest
from api_kit import RAW
from cli_kit import Cli
from plant_files import plant_file

LEVEL = {"at": "i16@2", "scale": 0.1, "unit": "bar"}
VALVES = {"name": "valves", "address": 8, "ident": 0x1234, "config": "23 13"}


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    plant_file(tmp_path, {**VALVES, "inputs": {"level": LEVEL}, "outputs": {"target": LEVEL}})
    return tmp_path


def test_a_run_with_files(plant: Path, cli: Cli) -> None:
    words = ["run", "plant.toml", "--outputs", "valves=0000007b", "--seconds", "0.1", "--log", "bus.jsonl"]
    *_, summary = cli.jsons(*words, "--record", "p.csv")
    with (plant / "p.csv").open(newline="") as file:
        *rows, end = csv.DictReader(file)
    assert summary["recording"] == {"files": ["p.csv"], "rows": len(rows) + 1, "lost": 0}
    assert summary["slaves"]["8"]["units"] == {"level": "bar", "target": "bar"}
    assert "12.3" in {row["valves.target [bar]"] for row in rows}
    assert end["note"] == f"end of the recording: {len(rows)} rows"
    lines = [json.loads(line) for line in (plant / "bus.jsonl").read_text().splitlines()]
    assert {"time", "t", "event", "severity", "text"} <= lines[0].keys()
    assert "operate" in {line.get("mode") for line in lines}
    assert "the name of a new file" in cli.err(*words, "--record", "p.csv")
    out = cli.out(*words, "--record", "q.csv", "--on-change", "--rotate", "1h", "--plain")
    assert re.search(r"^recording: q_00001_\w+\.csv, \d+ rows$", out, re.MULTILINE)
    assert "12.3 bar" in out
    (part,) = plant.glob("q_00001_*.csv")
    assert len(part.read_text().splitlines()) < 20


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--rotate", "1h"], "--rotate is about a recording: add --record FILE, or leave it out"),
        (["--on-change"], "--on-change is about a recording: add --record FILE, or leave it out"),
        (["--record", "p.csv", "--rotate", "1x"], "rotate = '1x'; give a size or a time, for instance 100MB"),
        (["--record", "p.txt"], "p.txt: the suffix says the kind of recording; end the name in .csv, .jsonl"),
        (["--record", "no/p.csv"], "no/p.csv: cannot be written (No such file or directory); name a file in a"),
        (["--record", "p.csv", "--read-only"], "--record on a read-only bus: it reads no process data; leave one"),
        (["--log", "."], ".: cannot be written (Is a directory); name a file in a directory of yours"),
    ],
)
def test_a_recording_or_log_that_cannot_be_made_is_one_line(words: list[str], line: str, plant: Path, cli: Cli) -> None:
    assert cli.err("run", "plant.toml", *words).startswith(f"dpstack: {line}")
    assert [path.name for path in plant.iterdir()] == ["plant.toml"]


def test_without_pyarrow_and_matplotlib(plant: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *_: None)
    (plant / "p.csv").write_text("time,t,a.b\n")
    assert "needs pyarrow; install it: pip install 'dpstack[parquet]'" in cli.err(
        *("run", "plant.toml", "--record", "p.parquet")
    )
    assert "needs matplotlib: pip install 'dpstack[plot]'" in cli.err("plot", "p.csv")


LAMP: dict[str, object] = {**RAW, "name": "valves", "address": 8, "config": "21 11", "outputs": {"lamp": "bool@0.1"}}
_PROGRAM = """
import sys
import probe_connector
from dpstack.cli.main import main
probe_connector.register()
sys.exit(main(sys.argv[1:]))
"""


def with_probe(tmp_path: Path, **keys: object) -> str:
    return str(plant_file(tmp_path, LAMP, tables={"probe": keys}))


@pytest.mark.parametrize("fails", ["no", "take", "serve", "close"])
def test_a_run_goes_on_without_a_connector_that_fails(tmp_path: Path, cli: Cli, probe: None, fails: str) -> None:
    config = with_probe(tmp_path, fails=fails, log=tmp_path / "course")
    out, err = cli("run", config, "--seconds", "0.8", "--json")
    *events, summary = [json.loads(line) for line in out.splitlines()]
    assert summary["slaves"]["8"]["state"] == "data_exchange"
    assert events[0]["event"] == "start"
    told = [event["text"] for event in events if event["event"] == "notice" and "fault" in event["text"]]
    assert len(told) == (fails in ("take", "serve"))
    assert err == ("dpstack: probe: ZeroDivisionError: close\n" if fails == "close" else "")
    begun, served, *last = (tmp_path / "course").read_text().splitlines()
    assert (begun, served, last[-1]) == ("open", "serve", "close")
    assert ("last: Died 8, Died None" in last) == (fails in ("no", "close"))


def test_a_connector_that_cannot_begin_is_one_line_before_the_port_is_opened(
    tmp_path: Path, cli: Cli, probe: None
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        config = plant_file(tmp_path, LAMP, port="/dev/there-is-none", tables={"probe": {"port": port}})
        err = cli.err("run", str(config), code=1)
        assert err == f"dpstack: [probe] port {port}: Address already in use; give another one\n"
    err = cli.err("run", with_probe(tmp_path, allow_commands=["valves.lmap"]))
    assert err.endswith("fits no order of this plant; did you mean 'valves.lamp'?\n")
    assert err.count("\n") == 1


@pytest.mark.parametrize(("fails", "signals", "code"), [("no", 1, 0), ("end", 2, 130)])
def test_signals_end_a_run_and_its_connectors(tmp_path: Path, fails: str, signals: int, code: int) -> None:
    config = with_probe(tmp_path, fails=fails, log=tmp_path / "course")
    kits = Path(probe_connector.__file__).parent
    command = [sys.executable, "-c", _PROGRAM, "run", config, "--json"]
    with subprocess.Popen(command, cwd=kits, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        for line in run.stdout:
            if "probe: born 8" in line:
                break
        for number in range(signals):
            if number:
                time.sleep(1.1)  # signals within a second are the same one
            run.send_signal(signal.SIGTERM)
        _, err = run.communicate(timeout=30)
    assert (run.returncode, err) == (code, "")
    course = (tmp_path / "course").read_text().splitlines()
    assert course[-1] == "close"
    assert "last: Died 8, Died None" in course


@pytest.mark.parametrize("more", ["", 'on_connector_loss = "keep"', "read_only = true"])
def test_the_plan_says_the_rule_if_a_connector_may_give_orders(
    tmp_path: Path, cli: Cli, probe: None, more: str
) -> None:
    path = tmp_path / "plant.toml"
    plant = f'[bus]\nport = "virtual"\nbaud = 500000\n{more}\n[probe]\n[metrics]\n'
    path.write_text(plant, encoding="utf-8")
    assert "on_connector_loss" not in cli("plan", str(path))[0] + cli("plan", str(path), "--json")[0]
    path.write_text(plant.replace("[probe]", '[probe]\nallow_commands = ["tank.*"]'), encoding="utf-8")
    out, found = cli("plan", str(path))[0], json.loads(cli("plan", str(path), "--json")[0])
    if "read_only" in more:
        assert "on_connector_loss" not in out + str(found)
        return
    rule = "keep" if more else "safe"
    assert found["on_connector_loss"] == rule
    note = "note: probe: when a connector ends by a fault or hangs, all that it has ordered"
    assert note in " ".join(out.split())
    assert f'(on_connector_loss = "{rule}")' in " ".join(out.split())
