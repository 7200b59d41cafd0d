"""Recordings in the readers that people use: none makes a number of octets, and the blocks of ask-recordings.md give
what stands below them."""

from __future__ import annotations

import json
import re
import subprocess
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Final

import pytest

from dpstack.dp.field_map import FieldMap
from dpstack.dp.process_data import Field
from dpstack.record.columns import Layout, RecordedSlave
from dpstack.record.rows import Rows, Sample
from tests.strangers.plant_recordings import write_recordings
from tests.strangers.stranger_kit import environment

pytestmark = pytest.mark.strangers

#: octets that look like numbers: 100000.0, 5, 12 and 10 to the 99th
OCTETS: Final = ("1e05", "0005", "0012", "1e99")
#: for each reader and form a program that prints the column of the octets in the file of its first argument
READERS: Final = {
    ("pandas", "csv"): "import pandas; found = pandas.read_csv(path)['scale.code'].tolist()",
    ("pandas", "jsonl"): "import pandas; found = pandas.read_json(path, lines=True)['scale.code'].tolist()[1:]",
    ("polars", "csv"): "import polars; found = polars.read_csv(path)['scale.code'].to_list()",
    ("polars", "jsonl"): "import polars; found = polars.read_ndjson(path)['scale.code'].to_list()[1:]",
    ("pyarrow", "csv"): "import pyarrow.csv; found = pyarrow.csv.read_csv(path)['scale.code'].to_pylist()",
    ("duckdb", "csv"): "import duckdb; found = [row[0] for row in duckdb.read_csv(path)['scale.code'].fetchall()]",
}

#: as the page names them
NAMED: Final = ("DuckDB==1.4.3", "polars==1.36.1")
PAGE: Final = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "ask-recordings.md"
_BLOCK: Final = re.compile(r"<!-- readers -->\n```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
#: runs blocks of standard input, a JSON list of [kind, text], in one DuckDB; prints the output of each as a JSON list
RUNS_BLOCKS: Final = """
import contextlib, io, json, sys
import duckdb

con = duckdb.connect()

def ask(text):
    found = con.execute(text)
    rows = [[one[0] for one in found.description], *found.fetchall()]
    return "".join(",".join("" if cell is None else str(cell) for cell in row) + "\\n" for row in rows)

def run(text):
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(text, {})
    return output.getvalue()

print(json.dumps([{"sql": ask, "python": run}[kind](text) for kind, text in json.load(sys.stdin)]))
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = environment(tmp_path_factory.mktemp("readers"), "pandas==3.0.0")
    # msgspec: the module of dpstack that makes Parquet files runs there, too
    others = (*NAMED, "pyarrow==22.0.0", f"msgspec=={version('msgspec')}")
    subprocess.run(
        [made, "-m", "pip", "install", "-q", "--disable-pip-version-check", *others], check=True, timeout=300
    )
    return made


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("recordings")
    scale = RecordedSlave(9, "scale", FieldMap({"code": Field.parse("code", "bytes@0:2")}, 2))
    layout = Layout((scale,), 1_769_860_800.0, "plant.toml", False, {"port": "/dev/ttyX", "baud": 500_000})
    for form in ("csv", "jsonl"):
        rows = Rows(layout, form)
        samples = [
            Sample(layout, number * 1_000_000, 1_769_860_800_000_000_000, ("data_exchange", bytes.fromhex(octets)))
            for number, octets in enumerate(OCTETS)
        ]
        lines = [rows.head(), *filter(None, map(rows.row, samples))]
        (made / f"scale.{form}").write_bytes(b"".join(lines))
    return made


@pytest.mark.parametrize(("reader", "form"), READERS)
def test_octets_stay_octets(python: Path, folder: Path, reader: str, form: str) -> None:
    program = f"import json, sys; path = sys.argv[1]; {READERS[reader, form]}; print(json.dumps(found))"
    done = subprocess.run(
        [python, "-c", program, folder / f"scale.{form}"], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert json.loads(done.stdout) == [f"x{octets}" for octets in OCTETS]


def test_the_page_gives_what_stands_below_its_blocks(python: Path, tmp_path: Path) -> None:
    write_recordings(tmp_path, python)
    page = PAGE.read_text(encoding="utf-8")
    assert [re.sub(r"\s", "==", found) for found in re.findall(r"(?:DuckDB|polars)\s\d[\d.]*\d", page)] == [*NAMED]
    blocks = _BLOCK.findall(page)
    asked = [block for block in blocks if block[0] != "text"]
    assert page.count("```sql") + page.count("```python") == len(asked) >= 10
    done = subprocess.run(
        [python, "-c", RUNS_BLOCKS], input=json.dumps(asked), cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr[-2000:]
    outputs = iter(json.loads(done.stdout))
    found = [(kind, text if kind == "text" else next(outputs)) for kind, text in blocks]
    below = [(output, text) for (_, output), (kind, text) in pairwise(found) if kind == "text"]
    assert [output for output, _ in below] == [text for _, text in below]
    assert len(below) == len(asked) - 1  # the views give nothing
