"""Recordings as Parquet, read by pyarrow; pictures made by matplotlib."""

from __future__ import annotations

import asyncio
import csv
import os
import signal
import struct
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from api_kit import HOIST, RAW, in_virtual_time, operating
from cli_kit import Cli
from far_ends import eventually
from plant_files import plant_file

from dpstack.api.recording import record_file
from dpstack.api.recording.parquet import convert
from dpstack.record.reader import Recording

pytestmark = pytest.mark.strangers

VALVES: dict[str, object] = {
    **RAW,
    "name": "valves <b>$x_{1$",
    "address": 8,
    "config": "23 13",
    "inputs": {
        "limit": "bool@0.3",
        "level": {"at": "i16@2", "scale": 0.1, "unit": "bar"},
        "count": "u8@1",
        "raw": "bytes@2:2",
    },
    "outputs": {"target": {"at": "i16@2", "scale": 0.1, "unit": "bar"}},
}


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    return Cli(capsys)


def parquet() -> Any:
    return pytest.importorskip("pyarrow.parquet")


@in_virtual_time
async def _record(folder: Path, *suffixes: str) -> None:
    async with operating(VALVES, HOIST) as bus:
        recordings = [bus.record(folder / f"plant{suffix}") for suffix in suffixes]
        for number in range(20):
            bus.slave(8)["target"] = number / 10
            await asyncio.sleep(0.01)
        for recording in recordings:
            await recording.stop()
            assert recording.troubles == []
            assert recording.lost == 0


def test_a_parquet_file_has_the_rows_of_the_csv_file(tmp_path: Path) -> None:
    read_table = parquet().read_table
    _record(tmp_path, ".csv", ".parquet")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plant.csv", "plant.parquet"]
    table = read_table(tmp_path / "plant.parquet")
    types = {name: str(table.schema.field(name).type) for name in table.schema.names}
    slave = VALVES["name"]
    assert types["time"] == "timestamp[ms, tz=UTC]"
    assert types["t"] == types[f"{slave}.level"] == "double"
    assert (types[f"{slave}.count"], types[f"{slave}.limit"]) == ("int64", "bool")
    assert types[f"{slave}.raw"] == types["hoist.drive_state"] == "string"
    rows = table.to_pylist()
    with (tmp_path / "plant.csv").open(newline="", encoding="utf-8") as file:
        lines = {line["t"]: line for line in csv.DictReader(file)}
    same = [row for row in rows if f"{row['t']:.6f}" in lines and not row["note"]]
    assert len(same) > 30
    for row in same:
        line = lines[f"{row['t']:.6f}"]
        assert row[f"{slave}.level"] == float(line[f"{slave}.level [bar]"])
        assert row[f"{slave}.raw"] == line[f"{slave}.raw"]
        assert f"{row['time']:%Y-%m-%dT%H:%M:%S}" == line["time"][:19]
    assert rows[-1][f"{slave}.level"] is None
    recording = Recording(tmp_path / "plant.parquet")
    assert recording.columns[f"{slave}.level"].unit == "bar"
    assert [row.values[f"{slave}.level"] for row in recording.rows()] == [row[f"{slave}.level"] for row in rows]


def test_after_a_kill_the_rows_are_in_the_csv_file(tmp_path: Path) -> None:
    parquet()
    plant_file(tmp_path, {**RAW, "name": "valves", "address": 8, "config": "23 13", "inputs": {"level": "i16@2"}})
    words = [sys.executable, "-m", "dpstack.cli.main", "run", "plant.toml", "--record", "p.parquet"]
    with subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.DEVNULL) as program:
        journal = tmp_path / "p.parquet.part.csv"
        eventually(lambda: journal.exists() and journal.stat().st_size >= 10_000, "rows")
        program.send_signal(signal.SIGKILL)
    assert not (tmp_path / "p.parquet").exists()
    assert len(list(Recording(tmp_path / "p.parquet").rows())) > 20


def test_a_parquet_file_that_cannot_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parquet()

    def late(journal: Path, target: Path) -> str | None:
        target.write_bytes(b"of somebody else")
        return convert(journal, target)

    monkeypatch.setattr(record_file, "convert", late)
    with pytest.raises(
        AssertionError, match=r"there is a file of that name; the rows are in plant\.parquet\.part\.csv"
    ):
        _record(tmp_path, ".parquet")
    assert (tmp_path / "plant.parquet").read_bytes() == b"of somebody else"
    assert len(list(Recording(tmp_path / "plant.parquet.part.csv").rows())) > 30


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" + bytes(100), b"time,t\n"])
def test_a_file_that_is_no_parquet_is_refused(content: bytes, tmp_path: Path, cli: Cli) -> None:
    parquet()
    path = tmp_path / "p.parquet"
    path.write_bytes(content)
    assert "is no Parquet file, or one that is cut" in cli.err("plot", str(path), "--write", str(tmp_path / "p.svg"))
    assert not (tmp_path / "p.svg").exists()


def test_pictures(tmp_path: Path, cli: Cli) -> None:
    pytest.importorskip("matplotlib")
    _record(tmp_path, ".csv")
    plant = str(tmp_path / "plant.csv")
    cli.out("plot", plant, "--write", str(tmp_path / "p.svg"))
    root = ElementTree.parse(tmp_path / "p.svg").getroot()
    texts = {"".join(one.itertext()).strip() for one in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"bar", "UTC", "valves <b>$x_{1$.level", "hoist.state", "hoist.drive_state", "data_exchange"} <= texts
    cli.out("plot", plant, "--write", str(tmp_path / "p.svg"))  # a picture of ours is replaced
    cli.out("plot", plant, "hoist", "--write", str(tmp_path / "p.png"))
    width, colours = _pixels((tmp_path / "p.png").read_bytes())
    assert width > 1000
    assert len(colours) > 10
    (tmp_path / "mine.svg").write_text("<svg/>")
    assert "it is no picture of `dpstack plot`" in cli.err("plot", plant, "--write", str(tmp_path / "mine.svg"))
    assert "end the name in .svg, .png or .pdf" in cli.err("plot", plant, "--write", str(tmp_path / "p.gif"))
    os.environ.pop("DISPLAY", None)
    assert "no window can be opened here" in cli.err("plot", plant)


def _pixels(octets: bytes) -> tuple[int, set[bytes]]:
    """Width and colours of a PNG, without filters being undone: enough to see that something is drawn."""
    width = struct.unpack_from(">I", octets, 16)[0]
    data, place = b"", 8
    while place < len(octets):
        length, kind = struct.unpack_from(">I4s", octets, place)
        data += octets[place + 8 : place + 8 + length] if kind == b"IDAT" else b""
        place += length + 12
    rows = zlib.decompress(data)
    return width, {rows[n : n + 4] for n in range(0, len(rows), 4)}
