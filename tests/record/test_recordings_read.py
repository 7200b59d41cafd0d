"""Recordings: their lines against literal ones, reading them again, cut and damaged files, replay."""

from __future__ import annotations

import asyncio
import csv
import io
import json
from pathlib import Path
from typing import Any

import pytest
from api_kit import RAW, operating, virtual
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.dp.field_map import FieldMap
from dpstack.dp.process_data import Field, with_scale, with_status
from dpstack.errors import UsageError
from dpstack.plant.state import LiveState
from dpstack.record.columns import Column, Judged, Layout, RecordedSlave
from dpstack.record.reader import Recording
from dpstack.record.replay import Item, Replay, replay_items
from dpstack.record.rows import Rows, Sample

SECOND = 1_000_000_000
WALL = 1_769_860_800 * SECOND  # 2026-01-31T12:00:00Z


def boiler(name: str = "boiler", **keys: float | str) -> RecordedSlave:
    level = with_scale(Field.parse("level", "i16@0"), {"scale": 0.1, "unit": "bar", **keys})
    fields = {"level": level, "burner": Field.parse("burner", "bool@3.0")}
    return RecordedSlave(12, name, FieldMap(fields, 4))


def layout(*slaves: RecordedSlave, on_change: bool = False) -> Layout:
    bus = {"port": "/dev/ttyX", "baud": 500_000, "driver": "process", "address": 2}
    return Layout(slaves or (boiler(),), 1_769_860_800.0, "plant.toml", on_change, bus)


def sample(of: Layout, at_ms: int, *sources: object) -> Sample:
    return Sample(of, at_ms * 1_000_000, WALL + at_ms * 1_000_000, sources)


def test_the_lines_of_a_csv_file() -> None:
    plant = layout()
    rows = Rows(plant, "csv")
    assert rows.head() == b"time,t,boiler.state,boiler.level [bar],boiler.burner,note\n"
    first = rows.row(sample(plant, 5, "data_exchange", bytes.fromhex("007b 0001")), "joined, late")
    assert first is not None
    *cells, note = next(csv.reader(io.StringIO(first.decode())))
    assert cells == ["2026-01-31T12:00:00.005Z", "0.005000", "data_exchange", "12.3", "true"]
    described = json.loads(note)
    assert described["note"] == "joined, late"
    (slave,) = described["recording"]["slaves"]
    assert (slave["name"], slave["address"]) == ("boiler", 12)
    assert slave["columns"] == [
        {"field": "state", "kind": "state", "type": "text"},
        {"field": "level", "kind": "input", "unit": "bar", "at": "i16@0", "scale": 0.1},
        {"field": "burner", "kind": "input", "type": "bool", "at": "bool@3.0"},
    ]
    second = rows.row(sample(plant, 10, "offline", None), 'a "note"')
    assert second == b'2026-01-31T12:00:00.010Z,0.010000,offline,,,"a ""note"""\n'
    assert rows.end(0, WALL, "end") == b"2026-01-31T12:00:00.000Z,0.000000,,,,end\n"


def test_the_lines_of_a_json_file() -> None:
    plant = layout()
    rows = Rows(plant, "jsonl")
    assert json.loads(rows.head())["recording"]["config"] == "plant.toml"
    line = rows.row(sample(plant, 5, "data_exchange", bytes.fromhex("fff6 0000")))
    assert line == (
        b'{"time":"2026-01-31T12:00:00.005Z","t":0.005000,"boiler.state":"data_exchange","boiler.level":-1.0,'
        b'"boiler.burner":false,"note":""}\n'
    )
    line = rows.row(sample(plant, 6, "offline", None), "lost")
    assert line is not None
    assert json.loads(line)["boiler.level"] is None
    assert json.loads(line)["note"] == "lost"


def test_octets_are_no_number_for_anybody_and_are_read_as_before(tmp_path: Path) -> None:
    """Bare hex was: 1e05 is 100000.0 for pandas, polars and pyarrow. Files of version 1 have it."""
    raw = RecordedSlave(9, "scale", FieldMap({"code": Field.parse("code", "bytes@0:2")}, 2))
    plant = layout(raw)
    for form in ("csv", "jsonl"):
        rows = Rows(plant, form)
        lines = [rows.head(), rows.row(sample(plant, 5, "data_exchange", bytes.fromhex("1e05")))]
        path, older = tmp_path / f"now.{form}", tmp_path / f"older.{form}"
        path.write_bytes(b"".join(line or b"" for line in [*lines, rows.end(6_000_000, WALL + 6_000_000, "over")]))
        assert b"x1e05" in path.read_bytes()
        older.write_bytes(path.read_bytes().replace(b"x1e05", b"1e05").replace(b'"version":2', b'"version":1'))
        for file in (path, older):
            assert [row.values["scale.code"] for row in Recording(file).rows()] == ["1e05", None]


def test_each_row_of_json_lines_has_all_columns() -> None:
    plant = layout()
    rows = Rows(plant, "jsonl")
    first = rows.row(sample(plant, 5, "data_exchange", bytes.fromhex("fff6 0000")))
    last = rows.end(6_000_000, WALL + 6_000_000, "end of the recording")
    assert first is not None
    assert [*json.loads(first)] == [*json.loads(last)] == ["time", "t", *(one.name for one in plant.columns), "note"]
    assert json.loads(last)["boiler.level"] is None


def test_a_drive_and_fields_called_like_its_quantities() -> None:
    named = FieldMap({"speed": Field.parse("speed", "u8@0"), "state": Field.parse("state", "u8@1")}, 2)
    plant = layout(RecordedSlave(3, "hoist", named, is_drive=True))
    assert [column.name for column in plant.columns][:6] == [
        *("hoist.slave state", "hoist.speed", "hoist.state", "hoist.drive_state", "hoist.setpoint"),
        "hoist.drive speed",
    ]
    rows = Rows(plant, "csv")
    status = ("running", 0.5, 0.1 + 0.2, None, None, None, "F1, F2", None)
    line = rows.row(sample(plant, 0, "data_exchange", b"\1\2", status))
    assert line is not None
    assert b',data_exchange,1,2,running,0.5,0.3,,,,"F1, F2",,' in line


def test_on_change_a_value_has_to_leave_its_dead_band() -> None:
    plant = layout(boiler(dead_band=0.2), on_change=True)
    rows = Rows(plant, "jsonl")

    def level(raw: int, burner: int = 0) -> object:
        line = rows.row(sample(plant, 0, "data_exchange", raw.to_bytes(2, "big") + bytes((0, burner))))
        return None if line is None else json.loads(line)["boiler.level"]

    assert level(100) == 10.0
    assert level(102) is None  # at the edge
    assert level(103) == 10.3
    assert level(101) is None
    assert level(102, burner=1) == 10.2  # a row has all values of its moment
    assert level(104, burner=1) is None
    assert level(105, burner=1) == 10.5  # a slow drift is seen: the last row counts, not the last sample
    assert rows.row(sample(plant, 0, "offline", None)) is not None
    assert rows.row(sample(plant, 0, "offline", None)) is None


def write(path: Path, of: Layout, values: list[tuple[int, int | None]]) -> bytes:
    """A recording with the raw level (None: not valid) at each time in ms."""
    rows = Rows(of, path.suffix[1:])
    made = rows.head()
    for at_ms, raw in values:
        octets = None if raw is None else raw.to_bytes(2, "big", signed=True) + b"\0\1"
        made += rows.row(sample(of, at_ms, "offline" if raw is None else "data_exchange", octets)) or b""
    path.write_bytes(made)
    return made


@pytest.mark.parametrize("suffix", [".csv", ".jsonl"])
@examples(15)
@given(
    name=st.text(st.characters(exclude_categories=("Cs", "Cc", "Cf", "Zl", "Zp", "Co", "Cn")), min_size=1, max_size=30),
    values=st.lists(st.none() | st.integers(-32768, 32767), min_size=1, max_size=8),
    cut=st.floats(0, 1),
)
def test_a_file_cut_anywhere_gives_its_whole_rows(
    suffix: str, name: str, values: list[int | None], cut: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / f"cut{suffix}"
    made = write(path, layout(boiler(name.strip() or "x")), [(10 * n, raw) for n, raw in enumerate(values)])
    left = made[: round(cut * len(made))]
    path.write_bytes(left)
    whole = left.count(b"\n")
    if not whole:
        with pytest.raises(UsageError, match="is empty, or its first line is cut"):
            Recording(path)
        return
    recording = Recording(path)
    rows = list(recording.rows())
    column = f"{name.strip() or 'x'}.level"
    wanted = [None if raw is None else raw / 10 for raw in values[: whole - 1]]
    if whole > 1 or suffix == ".jsonl":
        assert [row.values[column] for row in rows] == wanted
    assert [row.at for row in rows] == pytest.approx([0.01 * n for n in range(whole - 1)])
    assert bool(recording.remarks) == (not left.endswith(b"\n"))


@pytest.mark.parametrize("suffix", [".csv", ".jsonl"])
@examples(10)
@given(octets=st.binary(max_size=60), place=st.integers(1, 4))
def test_a_damaged_line_costs_no_other(
    suffix: str, octets: bytes, place: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / f"damaged{suffix}"
    made = write(path, layout(), [(10 * n, n) for n in range(5)]).splitlines(keepends=True)
    made.insert(place + 1, octets.replace(b"\n", b"") + b"\n")
    path.write_bytes(b"".join(made))
    recording = Recording(path)
    levels = [row.values["boiler.level"] for row in recording.rows()]
    assert levels == [0.0, 0.1, 0.2, 0.3, 0.4]
    assert len(recording.remarks) == 1
    assert recording.remarks[0].endswith(f"1 line cannot be read and is left out, the first is line {place + 2}")


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        ("a.txt", b"x", "a recording ends in .csv, .jsonl, .parquet; give a file that run --record wrote"),
        ("a.csv", None, "there is no such file, and no part of it (a_00001_TIME.csv)"),
        ("a.csv", b"", "is empty, or its first line is cut"),
        ("a.csv", b"a,b\n1,2\n", 'is no recording (its first columns are not time and t: "a,b"); give a file'),
        ("a.csv", b"\xff\x1b[31m\n", "is no recording (its first columns are not time and t"),
        ("a.jsonl", b'{"time":1}\n', "is no recording (its first line describes no columns"),
        ("a.jsonl", b"[" * 100_000 + b"\n", "is no recording (its first line describes no columns"),
        (
            "a.jsonl",
            b'{"recording":{}}\n',
            "the description of its columns cannot be read ('slaves'); give an unchanged",
        ),
        ("a.jsonl", b'{"recording":{"slaves":[1]}}\n', "the description of its columns cannot be read ("),
        (
            "a.jsonl",
            b'{"recording":{"slaves":[{"name":1}]}}\n',
            "the description of its columns cannot be read (name = 1",
        ),
        (
            "a.jsonl",
            b'{"recording":{"slaves":[{"name":"a","columns":[{"field":"b","kind":"x"}]}]}}\n',
            "the description of its columns cannot be read ('x' is not a valid Kind)",
        ),
    ],
)
def test_files_that_are_no_recordings(name: str, content: bytes | None, line: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UsageError) as caught:
        Recording(path)
    assert str(caught.value).startswith(f"{path}: {line}")
    assert str(caught.value).isprintable()


def test_a_plant_so_large_that_no_cell_holds_its_description(tmp_path: Path) -> None:
    path = tmp_path / "large.csv"
    plant = layout(*(boiler(f"boiler{n}{'x' * 150}") for n in range(400)))
    rows = Rows(plant, "csv")
    path.write_bytes(rows.head() + (rows.row(sample(plant, 0, *("data_exchange", bytes(4)) * 400), "first") or b""))
    recording = Recording(path)
    assert [column.title for column in recording.columns.values()] == [column.title for column in plant.columns]
    (row,) = recording.rows()
    assert (row.note, set(row.values.values())) == ("first", {"data_exchange", 0.0})
    with path.open(newline="", encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 1  # within the limits of other readers


def test_a_table_of_somebody_else(tmp_path: Path) -> None:
    path = tmp_path / "other.csv"
    path.write_bytes(b"\xef\xbb\xbftime,t,pump.flow [m3/h],on,who\r\n2026-01-31T12:00:00+01:00,0,1.5,TRUE,me\r\n")
    recording = Recording(path)
    assert [*recording.columns.values()] == [
        Column("pump", "flow", unit="m3/h"),
        Column("", "on"),
        Column("", "who"),
    ]
    (row,) = recording.rows()
    assert row.values == {"pump.flow": 1.5, "on": True, "who": "me"}
    assert row.time == 1_769_857_200.0


def test_a_rotated_set_with_other_columns_and_a_clock_that_was_set_back(tmp_path: Path) -> None:
    write(tmp_path / "p_00001_20260131T120000Z.csv", layout(), [(0, 1), (1000, 2)])
    write(tmp_path / "p_00010_20260131T130000Z.csv", layout(boiler(), boiler("b")), [])
    with (tmp_path / "p_00002_20260131T110000Z.csv").open("wb") as file:
        rows = Rows(layout(), "csv")
        late = Sample(layout(), 2 * SECOND, WALL - 3600 * SECOND, ("data_exchange", bytes(4)))
        file.write(rows.head() + (rows.row(late) or b""))
    (tmp_path / "p_1_x.csv").write_bytes(b"something else")
    recording = Recording(tmp_path / "p.csv")
    assert len(recording.parts) == 3
    assert {"boiler.level", "b.level"} < recording.columns.keys()
    rows_read = list(recording.rows())
    assert [row.values["boiler.level"] for row in rows_read] == [0.1, 0.2, 0.0]
    assert [row.at for row in rows_read] == [0.0, 1.0, 1.0]


async def _items(path: Path, start: float = 0.0) -> tuple[list[Item], list[float]]:
    waits: list[float] = []

    async def sleep(seconds: float) -> None:
        waits.append(seconds)

    return [item async for item in replay_items(path, 1.0, start, sleep=sleep)], waits


def _of(items: list[Item], kind: str) -> list[dict[str, Any]]:
    return [item[kind] for item in items if kind in item]


def rack(*, quality: bool) -> Layout:
    level = with_status(Field.parse("level", "f32@0"), Field.parse("status", "u8@4"), "pa-classic")
    fields = {"level": level, "door": Field.parse("door", "bool@5.0")}
    return layout(RecordedSlave(12, "rack", FieldMap(fields, 6), quality=quality))


ALL_GOOD = bytes.fromhex("3f800000 80 01")
BAD_STATUS = bytes.fromhex("3f800000 10 01")


def test_a_bad_value_has_a_number_only_beside_its_quality() -> None:
    judged = Judged(ALL_GOOD, ("bad", "uncertain"))
    plain, beside = rack(quality=False), rack(quality=True)
    rows = Rows(plain, "csv", described=True)
    assert rows.head() == b"time,t,rack.state,rack.level,rack.door,note\n"

    def cells(of: Layout, rows: Rows, *sources: object) -> list[str]:
        line = rows.row(sample(of, 5, "data_exchange", *sources))
        assert line is not None
        return next(csv.reader(io.StringIO(line.decode())))[3:-1]

    assert cells(plain, rows, ALL_GOOD) == ["1.0", "true"]
    assert cells(plain, rows, judged) == ["", "true"]
    assert cells(plain, rows, BAD_STATUS) == ["", "true"]
    rows = Rows(beside, "csv", described=True)
    assert rows.head() == b"time,t,rack.state,rack.level,rack.door,rack.level quality,rack.door quality,note\n"
    assert cells(beside, rows, ALL_GOOD, ALL_GOOD) == ["1.0", "true", "good", "good"]
    assert cells(beside, rows, judged, judged) == ["1.0", "true", "bad", "uncertain"]
    assert cells(beside, rows, BAD_STATUS, BAD_STATUS) == ["1.0", "true", "bad", "good"]
    assert cells(beside, rows, None, None) == ["", "", "stale", "stale"]


async def test_a_replay_has_the_qualities_of_the_recording(tmp_path: Path) -> None:
    path, plant = tmp_path / "plant.csv", rack(quality=True)
    rows = Rows(plant, "csv")
    judged = Judged(ALL_GOOD, ("bad", "uncertain"))
    lines = [rows.row(sample(plant, 5 + n, "data_exchange", judged, judged)) for n in range(3)]
    path.write_bytes(rows.head() + b"".join(line for line in lines if line))
    items, _ = await _items(path)
    slave = _of(items, "snapshot")[0]["slaves"]["12"]
    assert slave["fields"] == {"level": 1.0, "door": True}
    assert {name: one["quality"] for name, one in slave["qualities"].items()} == {"level": "bad", "door": "uncertain"}
    assert slave["level"] == "error"


@pytest.mark.parametrize("suffix", [".csv", ".jsonl"])
async def test_replay(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"plant{suffix}"
    values: list[tuple[int, int | None]] = [(10 * n, n) for n in range(50)]
    write(path, layout(), [*values, (500, None), (9000, 7)])
    items, waits = await _items(path)
    (plant,) = _of(items, "plant")
    assert "plant" in items[0]
    assert [plant[key] for key in ("port", "baud", "address", "config")] == ["/dev/ttyX", 500_000, 2, "plant.toml"]
    assert plant["slaves"]["12"]["inputs"][0] == {
        "slot": None,
        "channel": None,
        "name": "level",
        "type": "i16",
        "at": "i16@0",
        "scale": 0.1,
        "offset": 0,
        "unit": "bar",
        "dead_band": 0,
    }
    snapshots = _of(items, "snapshot")
    assert snapshots[0]["whole"]
    assert not any(snapshot["whole"] for snapshot in snapshots[1:])
    seen = [(one["t"], one["slaves"]["12"]["fields"]["level"], one["slaves"]["12"]["state"]) for one in snapshots]
    assert seen == [
        *((n / 10, float(n), "data_exchange") for n in range(5)),
        (0.5, None, "offline"),
        (0.5, None, None),  # nothing is known about the time up to the next row
        (9.0, 0.7, "data_exchange"),
    ]
    texts = [(event["t"], event["text"]) for event in _of(items, "event")]
    assert texts == [
        (0.0, f"replay of plant{suffix}"),
        (0.5, "boiler: state offline"),
        (9.0, "boiler: state data_exchange"),
    ]
    assert "end" in items[-1]
    assert max(waits) == pytest.approx(9.0, abs=0.5)


async def test_replay_from_the_middle(tmp_path: Path) -> None:
    path = tmp_path / "plant.csv"
    write(path, layout(), [(1000 * n, n) for n in range(5)])
    items, _ = await _items(path, start=2.5)
    assert [one["t"] for one in _of(items, "snapshot")] == [3.0, 4.0]
    assert _of(items, "snapshot")[0]["slaves"]["12"]["fields"]["level"] == 0.2  # the values that held at 2.5 s
    with pytest.raises(UsageError, match=r"is 4\.0 s long; start before that"):
        await _items(path, start=5)
    with pytest.raises(UsageError, match="give a number above 0"):
        async for _ in replay_items(path, 0):
            pass
    path.write_bytes(Rows(layout(), "csv").head())
    with pytest.raises(UsageError, match="has no rows"):
        await _items(path)


async def test_a_replay_feeds_the_state_of_any_connector(tmp_path: Path) -> None:
    path = tmp_path / "plant.csv"
    plant = layout(boiler(), RecordedSlave(3, "hoist", is_drive=True))
    rows = Rows(plant, "csv")
    status = ("running", 0.5, 0.25, 12.5, None, None, None, "hot")
    lines = [
        rows.row(sample(plant, 0, "data_exchange", bytes(4), "offline", None)),
        rows.row(sample(plant, 400, "data_exchange", b"\0\1\0\1", "data_exchange", status)),
    ]
    path.write_bytes(rows.head() + b"".join(filter(None, lines)))
    state = LiveState()
    for item in (await _items(path))[0]:
        state.apply(item)
    assert state.plant is not None
    assert (state.plant.source, state.t) == ("replay", 0.4)
    assert state.end == "end of the recording plant.csv"
    assert state.slaves["12"].fields == {"level": 0.1, "burner": True}
    drive = state.slaves["3"].drive
    assert drive is not None
    assert (drive.state, drive.running, drive.speed, drive.warnings) == ("running", True, 0.25, ["hot"])
    assert [event["text"] for event in state.events][1:] == [
        "hoist: state data_exchange",
        "hoist: drive_state running",
        "hoist: warning hot",
    ]


async def test_a_replay_has_the_keys_of_a_live_stream(tmp_path: Path) -> None:
    path = tmp_path / "plant.csv"
    write(path, layout(), [(0, 1)])
    items, _ = await _items(path)
    live: list[Item] = []

    async def of_a_bus() -> None:
        async with operating({**RAW, "config": "23 13", "inputs": {"level": "i16@2"}}) as bus:
            async for item in bus.live():
                live.append(item)
                if "snapshot" in item:
                    break

    await asyncio.to_thread(virtual, of_a_bus())
    (plant,), (same,) = _of(live, "plant"), _of(items, "plant")
    assert same.keys() - {"source"} == plant.keys()
    (slave,), (other,) = plant["slaves"].values(), same["slaves"].values()
    assert other.keys() == slave.keys()
    assert other["inputs"][0].keys() == slave["inputs"][0].keys()
    snapshot, mine = _of(live, "snapshot")[0], _of(items, "snapshot")[0]
    (slave,), (other,) = snapshot["slaves"].values(), mine["slaves"].values()
    assert other.keys() == slave.keys()


@pytest.mark.parametrize("number", ["1" + "0" * 400, "-" + "9" * 4000, "NaN", "Infinity", "1e400"])
def test_a_number_beyond_a_float_is_no_value_and_no_time(number: str, tmp_path: Path) -> None:
    lines = tmp_path / "plant.jsonl"
    head = '{"recording":{"slaves":[{"name":"a","columns":[{"field":"x"}]}]}}'
    row = '{"time":"2026-01-31T12:00:00Z","t":%s,"a.x":%s}'
    lines.write_text("\n".join((head, row % ("0", "1"), row % ("1", number), row % (number, "2"), "")))
    recording = Recording(lines)
    assert [row.values["a.x"] for row in recording.rows()] == [1, None]
    assert recording.remarks == [f"{lines}: 1 line cannot be read and is left out, the first is line 4"]
    table = tmp_path / "plant.csv"
    table.write_text(
        f"time,t,a.x\n2026-01-31T12:00:00Z,0,1\n2026-01-31T12:00:00Z,1,{number}\n2026-01-31T12:00:00Z,{number},2\n"
    )
    assert [row.t for row in Recording(table).rows()] == [0, 1]
    assert not isinstance(list(Recording(table).rows())[1].values["a.x"], (int, float))


ABOUT = '{"recording":{"slaves":[{"name":"a","columns":[{"field":"x","scale":%s}]}],"bus":{"baud":%s}}}'
LINE = '{"time":"%s","t":%s,"a.x":1}'


@pytest.mark.parametrize("number", ["NaN", "-Infinity", "1e999"])
@pytest.mark.parametrize("head", [ABOUT % ("%s", "1"), ABOUT % ("1", "%s")])
def test_a_description_with_a_number_that_json_does_not_have_is_refused(head: str, number: str, tmp_path: Path) -> None:
    path = tmp_path / "plant.jsonl"
    path.write_text(f"{head % number}\n")
    with pytest.raises(UsageError, match="its first line describes no columns"):
        Recording(path)


@pytest.mark.parametrize(
    ("time", "t"),
    [
        ("0001-01-01T00:00:00+23:59", "1"),
        ("9999-12-31T23:59:59.9999999-23:59", "1"),
        ("9999-12-31T23:59:59Z", "1"),
        ("2026-01-31T12:00:01Z", "1e308"),
        ("2026-01-31T12:00:01Z", "-1e308"),
    ],
)
def test_a_line_with_a_time_beyond_the_calendar_is_left_out(time: str, t: str, tmp_path: Path) -> None:
    lines, table = tmp_path / "plant.jsonl", tmp_path / "plant.csv"
    lines.write_text("\n".join((ABOUT % (1, 1), LINE % (time, t), LINE % ("2026-01-31T12:00:02Z", "2"), "")))
    table.write_text(f"time,t,a.x\n{time},{t},1\n2026-01-31T12:00:02Z,2,1\n")
    for path in (lines, table):
        recording = Recording(path)
        assert [row.t for row in recording.rows()] == [2]
        assert "1 line cannot be read and is left out, the first is line 2" in recording.remarks[0]
        events = [item["event"] for _, item in Replay(recording).items() if "event" in item]
        assert {event["time"] for event in events} == {"2026-01-31T12:00:02.000Z"}
