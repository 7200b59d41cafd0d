"""docs/how-to/many-captures.md: its blocks, run by DuckDB and by Dask on two workers over an archive of a hundred
segments, give what stands below them, and what was put into the captures."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import pytest
from cli_kit import Cli

from tests.strangers.plant_archive import LATER, WEEKS, Archive
from tests.strangers.stranger_kit import environment

pytestmark = pytest.mark.strangers

PAGE: Final = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "many-captures.md"
#: as the page names them
NAMED: Final = ("DuckDB==2.0.1", "Dask==2026.8.0", "pandas==3.1.1", "pyarrow==26.0.1")
_BLOCK: Final = re.compile(r"<!-- readers -->\n```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
#: Runs the blocks in the file of the first argument, a JSON list of [kind, text]: SQL in one DuckDB, Python with one
#: set of names beside two workers of Dask. Prints the output of each as a JSON list, then the whole results.
RUNS_BLOCKS: Final = """
import contextlib, io, json, sys

def main():
    import dask, duckdb
    from dask.distributed import LocalCluster

    con, names, outputs = duckdb.connect(), {"__name__": "blocks"}, []

    def ask(text):
        found = con.execute(text)
        rows = [[one[0] for one in found.description], *found.fetchall()]
        return "" if rows[0] == ["Count"] else "".join(",".join(map(str, row)) + "\\n" for row in rows)

    def run(text):
        output = io.StringIO()
        with contextlib.redirect_stdout(output):
            exec(text, names)
        return output.getvalue()

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as workers:
        dask.config.set({"scheduler-address": workers.scheduler_address})
        with open(sys.argv[1]) as blocks:
            outputs = [{"sql": ask, "python": run}[kind](text) for kind, text in json.load(blocks)]
    whole = {
        "DuckDB": {
            "retries": con.execute("select segment, station, date::varchar, hour, retries from retries").fetchall(),
            "later": con.execute("select segment, station, weeks from later").fetchall(),
            "minutes": con.execute(
                "select segment, station, epoch_ns(lost), retries, damaged, slowest_ns from minutes"
            ).fetchall(),
        },
        "Dask": {
            "retries": names["retries"].astype({"date": str}).values.tolist(),
            "later": [[*key, int(row.notna().sum())] for key, row in names["later"].iterrows()],
            "minutes": [
                [segment, station, int(lost.value), int(row.retries), int(row.error), int(row.slowest_ns)]
                for (segment, station, lost), row in names["minutes"].iterrows()
            ],
        },
    }
    (rows,) = con.execute("select count(*) from telegrams").fetchone()
    print(json.dumps([outputs, rows, whole], default=int))

if __name__ == "__main__":
    main()
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    duckdb, dask, *others = NAMED
    # half of the time of the installation is compiling modules that nobody loads
    return environment(
        tmp_path_factory.mktemp("many"),
        "--no-compile",
        duckdb,
        dask.replace("Dask", "dask[dataframe,distributed]"),
        *others,
    )


def test_the_blocks_of_the_page_find_what_was_put_into_the_captures(
    python: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plant = Archive(tmp_path / "made")
    cli = Cli(capsys)
    for segment, captures in plant.captures.items():
        cli("decode", *map(str, captures), "--parquet", str(tmp_path / "archive"), "--segment", segment)
    _again_by_the_command_of_the_page(plant, tmp_path)
    # what a killed program leaves
    hidden = next((tmp_path / "archive").rglob("*.parquet")).with_name(".0123456789abcdef.tmp")
    hidden.write_bytes(b"half")

    page = PAGE.read_text(encoding="utf-8")
    named = re.findall(r"(?:DuckDB|Dask|pandas|pyarrow) [\d.]*\d", page.partition("\n## ")[0].replace("\n", " "))
    assert [one.replace(" ", "==") for one in named] == [*NAMED]
    blocks = _BLOCK.findall(page)
    asked = [block for block in blocks if block[0] != "text"]
    assert page.count("```sql") + page.count("```python") == len(asked)
    (tmp_path / "blocks.json").write_text(json.dumps(asked))
    (tmp_path / "run.py").write_text(RUNS_BLOCKS)
    # compiled modules are kept: the two workers load them, too
    keeping = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    command = [str(python), "run.py", "blocks.json"]
    done = subprocess.run(command, cwd=tmp_path, env=keeping, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    outputs, rows, whole = json.loads(done.stdout.splitlines()[-1])
    assert rows == plant.telegrams
    for found in whole.values():
        _check(plant, found)
    told = iter(outputs)
    shown = [(kind, text if kind == "text" else next(told)) for kind, text in blocks]
    below = [(output, text) for (_, output), (kind, text) in pairwise(shown) if kind == "text"]
    assert [output for output, _ in below] == [text for _, text in below]
    assert len(below) == 6


def _check(plant: Archive, found: dict[str, list[Any]]) -> None:
    retries = {(segment, station, date[:10], hour): count for segment, station, date, hour, count in found["retries"]}
    assert retries == plant.retries
    assert found["later"] == [[*LATER, WEEKS]]
    assert sorted(row[:5] for row in found["minutes"]) == sorted(map(list, plant.losses))


def _again_by_the_command_of_the_page(plant: Archive, folder: Path) -> None:
    """Two segments whose rows are there already."""
    (command,) = re.findall(r"^\$ (dpstack decode .*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    for segment in ("line-07", "line-08"):
        shutil.copytree(plant.captures[segment][0].parent, folder / "captures" / segment)
    before = sorted((folder / "archive").rglob("*.parquet"))
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env={**os.environ, "PATH": path},
        check=True,
        timeout=60,
        stdout=subprocess.DEVNULL,
    )
    assert sorted((folder / "archive").rglob("*.parquet")) == before
