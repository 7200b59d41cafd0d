"""The files of recordings and logs: parts, a full disk, never over another file, after kill -9."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from dpstack.api.recording import event_log
from dpstack.api.recording.event_log import EventLog
from dpstack.api.recording.record_file import RecordFile
from dpstack.api.recording.rotation import Rotation
from dpstack.dp.field_map import FieldMap
from dpstack.dp.process_data import Field
from dpstack.errors import UsageError
from dpstack.record.columns import Layout, RecordedSlave
from dpstack.record.reader import Recording
from dpstack.record.rows import Sample

SECOND = 1_000_000_000
WALL = 1_769_860_800 * SECOND
PLANT = Layout((RecordedSlave(3, "pump", FieldMap({"flow": Field.parse("flow", "u16@0")}, 2)),))


def sample(number: int, layout: Layout = PLANT, lost: int = 0) -> Sample:
    octets = number.to_bytes(2, "big")
    return Sample(layout, number * SECOND // 100, WALL + number * SECOND // 100, ("data_exchange", octets), lost)


def record_file(path: Path, told: list[str], **rotation: float) -> RecordFile:
    return RecordFile(path, Rotation(**rotation), 0.0, told.append)  # type: ignore[arg-type]


def flows(path: Path) -> list[object]:
    return [row.values["pump.flow"] for row in Recording(path).rows()]


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """A disk with ``room`` octets, and a clock for the attempts."""
    state = {"room": 1 << 30, "now": 0}
    write, room = os.write, state

    def limited(fd: int, octets: memoryview) -> int:
        if not room["room"]:
            raise OSError(errno.ENOSPC, "No space left on device")
        done = write(fd, octets[: room["room"]])
        room["room"] -= done
        return done

    monkeypatch.setattr(os, "write", limited)
    monkeypatch.setattr(time, "monotonic", lambda: state["now"])
    return state


@pytest.mark.parametrize("suffix", [".csv", ".jsonl"])
@pytest.mark.parametrize("room", [0, 20, 700, 900])
def test_a_full_disk_costs_rows_and_says_so(suffix: str, room: int, disk: dict[str, int], tmp_path: Path) -> None:
    told: list[str] = []
    file = record_file(tmp_path / f"p{suffix}", told)
    disk["room"] = room
    for number in range(20):
        file.take(sample(number))
        file.flush()
    assert len(told) == 1
    assert "the disk is full; make room there: rows are lost" in told[0]
    content = (tmp_path / f"p{suffix}").read_bytes()
    assert content == b"" or content.endswith(b"\n")
    disk["now"] += 2
    file.flush()  # still full
    assert len(told) == 1
    disk["room"] = 1 << 30
    disk["now"] += 2
    file.flush()
    assert "can be written again" in told[1]
    file.take(sample(20))
    file.flush()
    file.close(0)
    seen = flows(tmp_path / f"p{suffix}")
    *before, last, after, end = seen
    assert (last, after, end) == (19, 20, None)  # goes on with the newest sample
    assert before == list(range(len(before)))
    assert file.rows_lost == 19 - len(before)
    notes = [row.note for row in Recording(tmp_path / f"p{suffix}").rows() if row.note]
    assert notes[0].startswith(f"{file.rows_lost} rows lost since ")
    assert notes[1].startswith("end of the recording: ")
    assert notes[1].endswith(f"{file.rows_lost} rows lost, because the disk was full")


def test_a_disk_that_stays_full(disk: dict[str, int], tmp_path: Path) -> None:
    told: list[str] = []
    file = record_file(tmp_path / "p.csv", told)
    file.take(sample(0))
    file.flush()
    disk["room"] = 0
    for number in range(1, 10):
        file.take(sample(number))
        file.flush()
    file.close(0)
    assert flows(tmp_path / "p.csv") == [0]
    assert file.rows_lost == 9


def test_rotation_by_size_and_never_over_a_file(tmp_path: Path) -> None:
    told: list[str] = []
    (tmp_path / "p_00006_20260101T000000Z.csv").write_text("time,t,pump.flow,note\n")
    file = record_file(tmp_path / "p.csv", told, octets=10_000)
    for number in range(600):
        file.take(sample(number))
    file.close(3)
    names = sorted(one.name for one in tmp_path.iterdir())
    assert names == [
        "p_00006_20260101T000000Z.csv",
        "p_00007_20260131T120000Z.csv",
        *(name for name in names[2:] if re.fullmatch(r"p_0000[89]_20260131T12000\dZ\.csv|p_0001\d_.*", name)),
    ]
    assert len(names) == 5
    assert all(10_000 <= path.stat().st_size < 10_100 for path in file.paths[:-1])
    seen = flows(tmp_path / "p.csv")
    assert seen == [*range(600), None]
    assert list(Recording(tmp_path / "p.csv").rows())[-1].note.endswith(
        "3 rounds lost, because this computer or its disk was too slow"
    )
    assert not told


def test_rotation_by_time_and_lost_rounds(disk: dict[str, int], tmp_path: Path) -> None:
    file = record_file(tmp_path / "p.csv", [], seconds=3600)
    file.take(sample(0))
    disk["now"] += 3599
    file.take(sample(1, lost=5))
    disk["now"] += 1
    file.take(sample(2))
    file.close(0)
    assert [len(list(Recording(path).rows())) for path in file.paths] == [2, 2]
    assert [row.note for row in Recording(file.paths[0]).rows()][1].startswith("5 rounds lost, because this computer")


def test_a_part_that_cannot_be_made_is_tried_again(disk: dict[str, int], tmp_path: Path) -> None:
    told: list[str] = []
    folder = tmp_path / "usb"
    folder.mkdir()
    file = record_file(folder / "p.csv", told, seconds=3600)
    file.take(sample(0))
    file.flush()
    folder.rename(tmp_path / "gone")
    disk["now"] += 3600
    file.take(sample(1))
    file.take(sample(2))
    file.flush()
    assert "cannot be written (No such file or directory): rows are lost" in told[0]
    folder.mkdir()
    disk["now"] += 2
    file.flush()
    file.close(0)
    assert [*flows(tmp_path / "gone" / file.paths[0].name), *flows(file.paths[1])] == [0, 2, None]


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (lambda path: path.write_text("mine"), "there is a file of that name; give the name of a new file"),
        (lambda path: path.mkdir(), "is a directory; name a file"),
        (os.mkfifo, "is a device or a pipe; name an ordinary file"),
    ],
)
def test_an_existing_file_stays(make: Callable[[Path], object], line: str, tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    make(path)
    with pytest.raises(UsageError, match=re.escape(line)):
        record_file(path, [])
    assert path.exists()
    path = tmp_path / "q.csv"
    path.touch()
    record_file(path, []).close(0)
    assert not path.exists()  # nothing was recorded


@pytest.mark.parametrize(
    ("text", "rotation"),
    [
        ("100MB", Rotation(octets=100_000_000)),
        (" 1.5 gb", Rotation(octets=1_500_000_000)),
        ("10kB", Rotation(octets=10_000)),
        ("1h", Rotation(seconds=3600)),
        ("30min", Rotation(seconds=1800)),
        ("2d", Rotation(seconds=172_800)),
    ],
)
def test_sizes_and_times(text: str, rotation: Rotation) -> None:
    assert Rotation.parse(text) == rotation


@pytest.mark.parametrize(
    "text", ["", "100", "MB", "-1h", "1 hour", "1e9MB", "9kB", "0.5min", "1h30min", "\u0661h", "0h"]
)
def test_no_sizes_and_times(text: str) -> None:
    with pytest.raises(UsageError, match=r"^rotate = .*; (give a size or a time|a file has )"):
        Rotation.parse(text)


# --- the log ---


def event(number: int, text: str = "station 3 found") -> dict[str, object]:
    return {"event": "station", "t": number / 1000, "severity": "info", "text": text}


def test_the_lines_of_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time", lambda: 1_769_860_800.25)
    for name in ("bus.log", "bus.jsonl"):
        for number, text in ((4, "earlier"), (5, "a\x1b[31m\nb")):  # the second run goes on in the file of the first
            log = EventLog(tmp_path / name)
            log.put(event(number, text))
            assert log.close()
    assert (tmp_path / "bus.log").read_text() == (
        "2026-01-31T12:00:00.250Z     0.004000 info    earlier\n"
        "2026-01-31T12:00:00.250Z     0.005000 info    a\\x1b[31m\\nb\n"
    )
    earlier, line = (tmp_path / "bus.jsonl").read_text().splitlines()
    assert json.loads(earlier) == {"time": "2026-01-31T12:00:00.250Z", **event(4, "earlier")}
    assert json.loads(line) == {"time": "2026-01-31T12:00:00.250Z", **event(5, "a\x1b[31m\nb")}


def test_a_log_keeps_some_files(tmp_path: Path) -> None:
    for number in range(9):
        log = EventLog(tmp_path / "bus.log", most_octets=1)
        log.put(event(number))
        assert log.close()
    kept = {path.name: path.read_text().split()[1] for path in tmp_path.iterdir()}
    assert kept == {
        "bus.log": "0.008000",
        **{f"bus.log.{n}": f"0.00{8 - n}000" for n in range(1, 6)},
    }
    assert stat.S_IMODE((tmp_path / "bus.log").stat().st_mode) & 0o137 == 0


def test_a_log_on_a_full_disk(disk: dict[str, int], tmp_path: Path) -> None:
    told: list[str] = []
    files = event_log._LogFiles(tmp_path / "bus.log", told.append, 10_000)
    disk["room"] = 150
    for number in range(10):
        files.take({"time": "2026-01-31T12:00:00.250Z", **event(number)})
        files.flush()
    disk["room"] = 1 << 20
    disk["now"] += 2
    files.take({"time": "2026-01-31T12:00:01.250Z", **event(11)})
    files.flush()
    files.close(0)
    lines = (tmp_path / "bus.log").read_text().splitlines()
    assert [line.split()[1] for line in lines[:2]] == ["0.000000", "0.001000"]
    assert "lines lost, because the file could not be written" in lines[2]
    assert "0.011000" in lines[-1]
    assert [told[0].split(": ", 1)[1], told[1].split(": ", 1)[1]] == [
        "the disk is full; make room there: lines of the log are lost until then",
        f"can be written again; {files.lost} lines are lost",
    ]


@pytest.mark.parametrize("name", ["folder", "pipe", "no/bus.log", "\0"])
def test_a_file_that_is_no_log_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UsageError, match="; name a file"):
        EventLog(tmp_path / name)


OTHER_FILES = {
    "plant.toml": '[bus]\nport = "virtual"\n',
    "plant.json": '{"time": "2026-01-31T12:00:00.250Z", "level": "info"}\n',
    "text.json": "2026-01-31T12:00:00.250Z     0.004000 info    a log of text lines\n",
    "json.log": '{"time": "2026-01-31T12:00:00.250Z", "event": "station", "text": "a log of JSON lines"}\n',
    "rows.csv": "time,t,boiler.level,note\n2026-01-31T12:00:00.250Z,0.1,1,\n",
    "octets.log": "\0\0\0\0",
}


@pytest.mark.parametrize("name", OTHER_FILES)
def test_a_log_goes_on_only_in_a_log(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(OTHER_FILES[name])
    with pytest.raises(UsageError, match=r"there is a file of that name, but it is not a log of .* name another file"):
        EventLog(path)
    assert path.read_text() == OTHER_FILES[name]


def test_a_log_goes_on_in_an_empty_file_and_after_a_remark_without_a_time(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    path.touch()
    for line in ({"event": "notice", "severity": "warning", "text": "first"}, {**event(1), "t": 12_345_678.5}):
        path.write_text("")
        for _ in range(2):
            log = EventLog(path)
            log.put(line)
            assert log.close()
        assert len(path.read_text().splitlines()) == 2


def test_a_log_has_one_writer(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    files = event_log._LogFiles(path, lambda _: None, 1)
    for number in range(3):  # also after it has begun a new file
        with pytest.raises(UsageError, match="it is being written already; name another file"):
            EventLog(path)
        files.take({"time": "2026-01-31T12:00:00.250Z", **event(number)})
        files.flush()
    files.close(0)
    assert EventLog(path).close()
    assert len(list(tmp_path.iterdir())) == 3


# --- a program that is killed ---

PLANT_TOML = """[bus]
port = "virtual"
baud = 500000

[[slave]]
name = "valves"
address = 8
ident = 0x1234
config = "23 13"
inputs = { level = { at = "i16@2", scale = 0.1, unit = "bar" } }
"""


@pytest.mark.soak
def test_after_kill_all_whole_lines_are_there(tmp_path: Path) -> None:
    (tmp_path / "plant.toml").write_text(PLANT_TOML)
    words = [sys.executable, "-m", "dpstack.cli.main", "run", "plant.toml", "--record", "p.csv", "--log", "p.log"]
    with subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.DEVNULL) as program:
        path = tmp_path / "p.csv"
        deadline = time.monotonic() + 20
        while not path.exists() or path.stat().st_size < 10_000:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        program.send_signal(signal.SIGKILL)
    rows = list(Recording(path).rows())
    assert len(rows) > 20
    assert rows[-1].values == {"valves.state": "data_exchange", "valves.level": 0.0}
    assert "operate" in (tmp_path / "p.log").read_text()
