"""``run --record``, ``--rotate``, ``--on-change``, ``--log``, and ``ctl set`` with a scaled value."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest
from cli_kit import Cli

PLANT = """[bus]
port = "virtual"
baud = 500000

[[slave]]
name = "valves"
address = 8
ident = 0x1234
config = "23 13"
inputs = { level = { at = "i16@2", scale = 0.1, unit = "bar" } }
outputs = { target = { at = "i16@2", scale = 0.1, unit = "bar" } }
"""


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plant.toml").write_text(PLANT)
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
