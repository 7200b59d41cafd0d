"""``bus.record()``: rows against the program's own cycles, slaves that go and change, the cost of a round."""

from __future__ import annotations

import asyncio
import csv
import json
import math
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType

import pytest
from api_kit import HOIST, RAW, bench_of, bus_of, operating

import dpstack
from dpstack.api.bus import recording as bus_recording
from dpstack.api.bus.bus import core_of
from dpstack.api.recording.line_file import LineFile

pytestmark = pytest.mark.virtual_time

VALVES: dict[str, object] = {
    **RAW,
    "name": "valves",
    "address": 8,
    "config": "23 13",
    "inputs": {"limit": "bool@0.3", "level": {"at": "i16@2", "scale": 0.1, "unit": "bar", "dead_band": 0.5}},
    "outputs": {"open": "bool@0.3", "target": {"at": "i16@2", "scale": 0.1, "unit": "bar"}},
}


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


async def test_every_cycle_is_a_row(tmp_path: Path) -> None:
    path = tmp_path / "plant.csv"
    seen: list[tuple[float, float]] = []
    async with operating(VALVES) as bus:
        async with bus.record(path) as recording:
            async for cycle in bus.cycles():
                level = cycle["valves"]["level"]
                assert isinstance(level, float)
                assert cycle.skipped == 0
                seen.append((round((cycle.t_ns - core_of(bus).started_ns) / 1e9, 6), level))
                bus.slave("valves")["target"] = len(seen) / 10
                if len(seen) == 30:
                    break
        assert (recording.paths, recording.lost, recording.troubles) == ((path,), 0, [])
    rows = read_csv(path)
    assert list(rows[0]) == [
        *("time", "t", "valves.state", "valves.limit", "valves.level [bar]", "valves.open", "valves.target [bar]"),
        "note",
    ]
    *rows, last = rows
    assert last["note"] == f"end of the recording: {len(rows)} rows"
    recorded = {float(row["t"]): float(row["valves.level [bar]"]) for row in rows}
    assert {t: recorded[t] for t, _ in seen} == dict(seen)
    assert max(recorded.values()) == max(level for _, level in seen) > 2.0
    assert {row["valves.state"] for row in rows} == {"data_exchange"}


async def test_values_are_empty_while_they_are_not_valid(tmp_path: Path) -> None:
    path = tmp_path / "plant.csv"
    async with operating(VALVES, cycle_ms=20) as bus:
        bus.slave("valves").update({"open": True, "target": 12.0})
        await asyncio.sleep(0.05)
        async with bus.record(path):
            await asyncio.sleep(0.05)
            await bus.clear()
            await asyncio.sleep(0.05)
            bench_of(bus).power(8, on=False)
            await asyncio.sleep(1.4)
    rows = [(row["valves.state"], row["valves.level [bar]"], row["valves.target [bar]"]) for row in read_csv(path)]
    *_, last = rows
    assert last == ("", "", "")
    assert ("data_exchange", "12.0", "12.0") in rows
    assert ("data_exchange", "0.0", "0.0") in rows  # Clear: the zeros that are on the wire, and the slave mirrors them
    gone = [row for row in rows if row[0] not in ("data_exchange", "")]
    assert {row[1:] for row in gone} == {("", "")}
    assert gone  # also where there is no round any more


async def test_the_quantities_of_a_drive(tmp_path: Path) -> None:
    path = tmp_path / "plant.jsonl"
    hoist = {**HOIST, "options": {"set_412": True}}
    async with operating(hoist, cycle_ms=20) as bus, bus.record(path):
        drive = bus.drive("hoist")
        await drive.start()
        drive.speed = 0.25
        await drive.reached()
        await asyncio.sleep(0.05)
        status = drive.status
    head, *rows = (json.loads(line) for line in path.read_text().splitlines())
    assert head["recording"]["version"] == 2
    *_, row, _ = rows
    assert (row["hoist.drive_state"], row["hoist.setpoint"]) == ("running", 0.25)
    assert status.speed is not None
    assert row["hoist.speed"] == pytest.approx(status.speed, abs=1e-6)
    speeds = [row["hoist.speed"] for row in rows if row.get("hoist.speed") is not None]
    assert len(set(speeds)) > 5  # it ramps


async def test_on_change_with_the_dead_band_of_the_field(tmp_path: Path) -> None:
    path = tmp_path / "plant.csv"
    async with operating(VALVES) as bus, bus.record(path, on_change=True):
        await asyncio.sleep(0.1)
        for target in (0.4, 0.5, 0.6, 0.7, 5.0):
            bus.slave("valves")["target"] = target
            await asyncio.sleep(0.05)
    rows = read_csv(path)
    targets = [row["valves.target [bar]"] for row in rows]
    assert list(dict.fromkeys(targets)) == ["0.0", "0.4", "0.5", "0.6", "0.7", "5.0", ""]
    assert rows[-2]["valves.level [bar]"] == "5.0"
    assert len(rows) < 12


async def test_a_slave_that_is_added_begins_a_new_file(tmp_path: Path) -> None:
    async with operating(VALVES, cycle_ms=20) as bus, bus.record(tmp_path / "plant.csv") as recording:
        await asyncio.sleep(0.05)
        await bus.add_slave({**VALVES, "name": "more", "address": 9})
        await asyncio.sleep(0.4)
    first, second = recording.paths
    assert first == tmp_path / "plant.csv"
    assert second.name.startswith("plant_00001_")
    assert "more.level [bar]" not in read_csv(first)[0]
    assert "more.level [bar]" in read_csv(second)[0]


async def test_a_disk_that_hangs_holds_up_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bus goes on while the thread hangs in a write; what found no room in the queue is counted in the file."""
    hangs, goes_on = threading.Event(), threading.Event()
    write = LineFile.write

    def hanging(file: LineFile, octets: bytes) -> None:
        hangs.set()
        assert goes_on.wait(20)
        write(file, octets)

    monkeypatch.setattr(LineFile, "write", hanging)
    monkeypatch.setattr(bus_recording, "MOST_WAITING", 10)
    path = tmp_path / "plant.csv"
    async with operating(VALVES) as bus:
        async with bus.record(path) as recording:
            await asyncio.sleep(0.01)
            await asyncio.to_thread(hangs.wait, 20)
            before = bus.slave("valves").exchanges
            await asyncio.sleep(0.2)
            assert bus.slave("valves").exchanges > before + 50
            assert recording.lost > 30
            goes_on.set()
            while recording.rows < 3:
                await asyncio.to_thread(time.sleep, 0.01)
            await asyncio.sleep(0.02)
        lost = recording.lost
    notes = [row["note"] for row in read_csv(path) if "rounds lost" in row["note"]]
    assert sum(int(note.split()[0]) for note in notes[:-1]) <= lost
    assert notes[-1].endswith(f"{lost} rounds lost, because this computer or its disk was too slow")


async def test_a_recording_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "plant.csv"
    path.write_text("mine")
    bus = bus_of(VALVES)
    with pytest.raises(dpstack.UsageError, match="the bus is not open"):
        bus.record(tmp_path / "other.csv")
    async with bus:
        with pytest.raises(dpstack.UsageError, match="there is a file of that name"):
            bus.record(path)
        with pytest.raises(dpstack.UsageError, match=r"dead_band = -1; give a number of 0 or more"):
            bus.record(tmp_path / "a.csv", dead_band=-1)
        with pytest.raises(dpstack.UsageError, match="dead_band = nan"):
            bus.record(tmp_path / "a.csv", dead_band=math.nan)
    assert path.read_text() == "mine"
    async with bus_of(VALVES, read_only=True) as bus:
        with pytest.raises(dpstack.UsageError, match="a read-only bus reads no process data"):
            bus.record(tmp_path / "b.csv")
    assert [one.name for one in tmp_path.iterdir()] == ["plant.csv"]


def _calls_of(work: Callable[[], object]) -> list[CodeType]:
    """The Python functions that ``work`` calls."""
    codes: list[CodeType] = []

    def profile(frame: FrameType, event: str, _argument: object) -> None:
        if event == "call":
            codes.append(frame.f_code)

    sys.setprofile(profile)
    try:
        work()
    finally:
        sys.setprofile(None)
    return codes


@pytest.mark.usefixtures("no_collection")
@pytest.mark.parametrize(("outputs", "most"), [(False, 12), (True, 12 + 5 * 10)])
async def test_the_cost_of_a_round(outputs: bool, most: int, tmp_path: Path) -> None:
    """Ten slaves: calls of Python functions at the end of a round, none without a recording."""

    tables = [{**VALVES, "name": f"v{n}", "address": n + 10} for n in range(10)]
    slaves = tables if outputs else [{**table, "outputs": {}} for table in tables]
    async with operating(*slaves) as bus:
        ends: list[list[CodeType]] = []
        view = core_of(bus).view
        watch = view.watch_rounds

        def counted(on_round: Callable[[], None] | None) -> None:
            watch(None if on_round is None else lambda: ends.append(_calls_of(on_round)))

        view.watch_rounds = counted  # type: ignore[method-assign]
        await asyncio.sleep(0.05)
        assert ends == []
        async with bus.record(tmp_path / "plant.csv") as recording:
            await asyncio.sleep(0.05)
        assert len(ends) > 5
        assert 5 < max(map(len, ends)) <= most
        assert {"_on_round", "_take", "put"} <= {code.co_name for code in ends[-1]}
        count = len(ends)
        await asyncio.sleep(0.05)
        assert len(ends) == count
    assert recording.rows >= count
