"""``dpstack decode --parquet``, read back with pyarrow: every row is what ``decode --json`` and ``monitor`` say, and a
file has its name only when it is whole."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import pytest
from bus_kit import SimBus, setup
from cli_kit import Cli
from recordings import WHOLE
from support import MS, S

from dpstack.api.listen import telegram_table
from dpstack.capture.listener import Listener
from dpstack.capture.pcapng import Writer
from dpstack.capture.recording import PortAbout, Recording
from dpstack.capture.transmission import Damage, Transmission
from dpstack.decode.columns import COLUMNS
from dpstack.params import BusParams
from dpstack.sim.world import World

pytestmark = pytest.mark.strangers


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    return Cli(capsys)


HOUR: Final = 3600 * S
#: 2026-01-31T07:59:59Z
BEFORE_EIGHT: Final = 1_769_846_399 * S
REFERENCE: Final = Path(__file__).resolve().parents[2] / "docs" / "reference" / "telegram-table.md"


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """All rows below ``folder``, with the columns of the folders, in the order of capture and number."""
    import pyarrow.dataset

    files = sorted(map(str, folder.rglob("*.parquet")))
    found = pyarrow.dataset.dataset(files, format="parquet", partitioning="hive", partition_base_dir=str(folder))
    table = found.to_table()
    times = table.column("time").cast("int64").to_pylist()
    rows = table.drop_columns(["time"]).to_pylist()
    for row, t_ns in zip(rows, times, strict=True):
        row["time"] = t_ns
    return sorted(rows, key=lambda row: (row["capture"], row["number"]))


def capture(path: Path, sent: Iterable[Transmission], port: str = "/dev/ttyUSB0") -> str:
    with path.open("wb") as file:
        recording = Recording(file, "a test", PortAbout(port, "tap", paced=True, exact=True))
        for one in sent:
            recording.add(one)
    return str(path)


def bus_with_faults(start_ns: int, *, damaged: bool) -> list[Transmission]:
    """A bus with retries of three depths, a slave that is lost and comes back, and an absent one."""
    params = BusParams.preset(500_000, address=2, gap=2, hsa=12, max_retry=3)
    world, heard = World(seed=7, keep=1_000_000, referee=False), list[Transmission]()
    world.add(Listener(0, heard.append, baud=500_000), name="listener")
    bus = SimBus(world, params, [setup(5, config=b"\x10\x20"), setup(6), setup(7)], silent=[6], watchdog_ms=5_000)
    world.run_for(300 * MS)
    assert len(bus.slaves) == 2
    for times in (1, 2, 3, 4):
        world.faults.drop(lambda tx: tx.sender == "5" and tx.octets[0] == 0x68 and tx.octets[4] < 0x80, times=times)
        world.run_for(100 * MS)
    if damaged:
        world.faults.noise(1e-3)
        world.run_for(200 * MS)
    return [one._replace(t_ns=start_ns + (one.t_ns or 0)) for one in heard]


def hostile() -> list[Transmission]:
    """Times, rates and marks that a file may claim."""
    poll, answer = bytes.fromhex("68 04 04 68 03 02 5D 07 69 16"), bytes.fromhex("68 04 04 68 02 03 08 AA B7 16")
    return [
        Transmission(poll, 5 * S, 500_000),
        Transmission(answer, 2**64 - 1, 500_000),
        Transmission(poll, 0, (1 << 40) + 1),
        Transmission(answer, 3 * HOUR, (1 << 40) + 1, "", Damage.PARITY_OR_FRAMING),
        Transmission(bytes(70_000), 3 * HOUR + 1, 500_000),
    ]


def captures(folder: Path) -> dict[str, str]:
    """Captures of every kind that the tests have, by name."""
    octets = [one for recording in WHOLE for _, one in recording.lines]
    real = [Transmission(one, BEFORE_EIGHT + number * MS, 1_500_000) for number, one in enumerate(octets)]
    two = folder / "two.pcapng"
    with two.open("wb") as file:
        writer = Writer(file, "a test")
        ports = [writer.interface(name, 500_000, "") for name in ("/dev/ttyUSB0", "a \x1b[2J \u202eport")]
        for number, one in enumerate(bus_with_faults(BEFORE_EIGHT, damaged=False)[:400]):
            writer.packet(ports[number % 3 == 0], one.t_ns or 0, one.octets)
    log = folder / "pasted.log"
    log.write_text("\n".join(f"TX {one.hex(' ')}" for one in octets[:60]))
    return {
        "real": capture(folder / "real.pcapng", real),
        "faults": capture(folder / "faults.pcapng", bus_with_faults(BEFORE_EIGHT, damaged=False)),
        "noise": capture(folder / "noise.pcapng", bus_with_faults(BEFORE_EIGHT + HOUR, damaged=True)),
        "hostile": capture(folder / "hostile.pcapng", hostile()),
        "two": str(two),
        "pasted": str(log),
    }


def test_each_row_is_the_line_of_decode_json(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(telegram_table, "ROWS", 500)  # several row groups
    archive = tmp_path / "archive"
    seen = Counter[str]()
    for name, path in captures(tmp_path).items():
        out, _ = cli("decode", path, "--parquet", str(archive), "--segment", name)
        rows = [row for row in rows_of(archive) if row["segment"] == name]
        told, _ = cli("decode", path, "--json", code=int(name in ("noise", "hostile")))
        lines = [json.loads(line) for line in told.splitlines()]
        assert [row["number"] for row in rows] == [line["number"] for line in lines], name
        assert sum(map(int, re.findall(r": (\d+) telegrams$", out, re.MULTILINE))) == len(rows) > 0
        for row, line in zip(rows, lines, strict=True):
            course = line["course"]
            same = ("kind", "da", "sa", "dsap", "ssap", "service", "function", "fc", "fcb", "fcv", "error")
            assert {key: row[key] for key in same} == {key: line[key] for key in same}
            of_course = ("answer_to", "late", "retry_of", "repeated_poll_of", "unanswered")
            assert {key: row[key] for key in of_course} == {key: course[key] for key in of_course}
            us = course["response_us"]
            if us is not None and abs(us) > 9e12:
                us = None
            assert row["t_sdr_ns"] == (None if us is None else round(us * 1000))
            assert row["size"] == min(len(line["octets"]) // 2, 65_535)
            assert row["damage"] == (", ".join(sorted(line.get("damage", []))) or None)
            t = line["t"]
            assert row["time"] == (None if t is None or t > 9.2e9 else pytest.approx(t * 1e9, abs=300))
            assert (row["hour"], row["date"]) == _hour(row["time"])
            for key in (
                "retry_of",
                "unanswered",
                "late",
                "error",
                "repeated_poll_of",
                "damage",
                "t_sdr_ns",
                "answer_to",
            ):
                seen[key] += row[key] not in (None, False)
    assert min(seen.values()) > 0, seen


def _hour(t_ns: int | None) -> tuple[int, str]:
    import datetime

    when = datetime.datetime.fromtimestamp((t_ns or 0) // S, datetime.UTC)
    return when.hour, f"{when:%Y-%m-%d}"


@pytest.mark.parametrize("damaged", [False, True], ids=["lost", "damaged"])
def test_the_sums_are_those_of_monitor(cli: Cli, tmp_path: Path, damaged: bool) -> None:
    path = capture(tmp_path / "bus.pcapng", bus_with_faults(BEFORE_EIGHT, damaged=damaged))
    cli("decode", path, "--parquet", str(tmp_path / "archive"))
    rows = rows_of(tmp_path / "archive")
    judged, _ = cli("monitor", path, "--json", code=1)
    summary = json.loads(judged.splitlines()[-1])
    assert summary["telegrams"] == sum(row["kind"] is not None for row in rows)
    assert sum(summary["damaged"].values()) == sum(row["kind"] is None for row in rows)
    assert (sum(summary["damaged"].values()) > 0) is damaged
    retries = 0
    for address, station in summary["stations"].items():
        if station["role"] == "master":
            continue
        own = [row for row in rows if row["station"] == int(address)]
        retries += station["repetitions"]
        assert station["repetitions"] == sum(row["retry_of"] is not None for row in own)
        assert station["repeated_polls"] == sum(row["repeated_poll_of"] is not None for row in own)
        assert station["late"] == sum(row["late"] for row in own)
        assert station["answers"] == sum(row["answer_to"] is not None and not row["late"] for row in own)
        t_sdr = [row["t_sdr_ns"] for row in own if row["t_sdr_ns"] is not None and not row["late"]]
        if t_sdr:
            tsdr_us = station["tsdr_us"]
            assert (tsdr_us["min"], tsdr_us["max"]) == pytest.approx((min(t_sdr) / 1000, max(t_sdr) / 1000), abs=0.001)
    assert retries >= 9


# --- the files -------------------------------------------------------------------------------------------------------
def _polls(start_ns: int, count: int, step_ns: int = MS) -> list[Transmission]:
    return [Transmission(bytes.fromhex("DC 02 02"), start_ns + number * step_ns, 500_000) for number in range(count)]


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_a_file_for_each_hour_named_after_segment_and_capture(cli: Cli, tmp_path: Path) -> None:
    """Without an option the segment has the name of the ring. An hour has no zero before it."""
    name = "press north_00007_20260131T075959Z.pcapng"
    path = capture(tmp_path / name, _polls(BEFORE_EIGHT, 3, 1800 * S))
    out = cli.out("decode", path, "--parquet", str(tmp_path / "archive"))
    found = names(tmp_path / "archive")
    stem = "press%20north_00007_20260131T075959Z-"
    hours = ("7", "8")
    assert len(found) == 2
    for file, hour in zip(found, hours, strict=True):
        assert file.startswith(f"segment=press%20north/date=2026-01-31/hour={hour}/{stem}")
        assert file.endswith(".parquet")
    assert out.splitlines()[-1] == f"3 telegrams in 2 files below {tmp_path / 'archive'}"
    assert {row["segment"] for row in rows_of(tmp_path / "archive")} == {"press north"}


def test_the_segment_is_that_of_the_configuration_or_of_the_option(cli: Cli, tmp_path: Path) -> None:
    path = capture(tmp_path / "bus.pcapng", _polls(BEFORE_EIGHT, 1))
    config = tmp_path / "mill.toml"
    config.write_text('[bus]\nport = "virtual"\nbaud = 500000\n')
    archive = str(tmp_path / "archive")
    cli("decode", path, "--parquet", archive, "--config", str(config))
    cli("decode", path, "--parquet", archive, "--segment", "../a=b\n\u202e")
    assert {row["segment"] for row in rows_of(tmp_path / "archive")} == {"mill", "../a=b\n\u202e"}
    assert all(name.count("/") == 3 for name in names(tmp_path / "archive"))


def test_the_same_capture_again_and_grown_doubles_no_row(cli: Cli, tmp_path: Path) -> None:
    """Two captures of one name stay apart, and so do those whose long names differ at their ends."""
    archive, other = tmp_path / "archive", tmp_path / "other"
    other.mkdir()
    grown = _polls(BEFORE_EIGHT, 2000)
    path = capture(tmp_path / "bus.pcapng", grown[:1500])
    same_name = capture(other / "bus.pcapng", _polls(BEFORE_EIGHT + 1, 10))
    for _ in range(2):
        cli("decode", path, same_name, path, "--parquet", str(archive))
    before = names(archive)
    assert len(rows_of(archive)) == 1510
    capture(tmp_path / "bus.pcapng", grown)
    cli("decode", path, same_name, "--parquet", str(archive))
    assert names(archive) == before
    assert len(rows_of(archive)) == 2010
    long = [capture(tmp_path / ("\u0431" * 60 + f"{end}.pcapng"), grown[:1]) for end in "ab"]
    cli("decode", *long, "--parquet", str(archive), "--segment", "long")
    assert len(rows_of(archive)) == 2012


def test_captures_of_one_name_without_times_stay_apart(cli: Cli, tmp_path: Path) -> None:
    """Logs without times, and captures that count from their begin, may all begin with the same telegram."""
    archive = tmp_path / "archive"
    paths = []
    for folder, count in (("a", 3), ("b", 4)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "bus.log").write_text("DC 02 02\n" * count)
        paths += [str(tmp_path / folder / "bus.log"), capture(tmp_path / folder / "bus.pcapng", _polls(0, 10 * count))]
    for _ in range(2):
        cli("decode", *paths, "--parquet", str(archive))
        cli("decode", *paths[:2], "--parquet", str(archive))
        assert len(rows_of(archive)) == 77
        assert len(names(archive)) == 4
    (tmp_path / "a" / "bus.log").write_text("DC 02 02\n" * 9)
    cli("decode", *paths, "--parquet", str(archive))
    assert len(rows_of(archive)) == 83


def test_standard_input_without_times_is_named_after_its_telegrams(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = tmp_path / "archive"
    for count, rows in ((3, 3), (4, 7), (3, 7)):
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"DC 02 02\n" * count)))
        cli("decode", "-", "--parquet", str(archive), "--segment", "s")
        assert len(rows_of(archive)) == rows


def test_a_copy_in_another_folder_is_left_out(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Given by the same command; written by a later one it replaces the rows, as the capture itself does."""
    archive, copy = tmp_path / "archive", tmp_path / "copy"
    copy.mkdir()
    path = capture(tmp_path / "bus.pcapng", _polls(BEFORE_EIGHT, 10))
    short = capture(copy / "bus.pcapng", _polls(BEFORE_EIGHT, 4))
    for _ in range(2):
        out, err = cli("decode", path, short, "--parquet", str(archive), "--json", code=1)
        why = f"it has the name and the first telegram of {path}, as a copy of the same capture has; give one of them"
        assert err == f"dpstack: {short}: left out: {why}\n"
        summary = {"event": "summary", "captures": 2, "unread": 1, "telegrams": 10, "files": 1}
        assert json.loads(out.splitlines()[-1]) == summary
        assert len(rows_of(archive)) == 10
        monkeypatch.setattr(telegram_table, "ROWS", 3)  # it is left out before it is read to its end
    for given, rows in ((short, 4), (path, 10)):
        cli("decode", given, "--parquet", str(archive))
        assert len(rows_of(archive)) == rows


def test_folders_of_captures_are_segments(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rule for the files in a folder is that of ``monitor DIR``. A file is read once, however it is named."""
    archive, first = tmp_path / "archive", ""
    for number, segment in enumerate(("line-01", "007")):
        (tmp_path / segment).mkdir()
        for part in (1, 2):
            start = BEFORE_EIGHT - part * HOUR + number
            name = f"bus_0000{part}_20260131T000000Z.pcapng"
            first = capture(tmp_path / segment / name, _polls(start, 10 + number))
    (tmp_path / "007" / "notes.txt").write_text("DC 02 02")
    (tmp_path / "007" / "latest").symlink_to("gone")
    monkeypatch.chdir(tmp_path / "line-01")
    out, err = cli("decode", ".", "../007/", first, "--parquet", str(archive), "--json")
    assert err.splitlines() == [
        "dpstack: ../007/: left out, cannot be read: latest (No such file or directory)",
        "dpstack: ../007/: left out, no telegrams in pcapng: notes.txt",
    ]
    assert json.loads(out.splitlines()[-1])["captures"] == 4
    assert Counter(row["segment"] for row in rows_of(archive)) == {"line-01": 20, "007": 22}
    cli("decode", ".", "../007", "--parquet", str(archive), "--segment", "both")
    assert len([row for row in rows_of(archive) if row["segment"] == "both"]) == 42


def test_a_clock_that_was_set_back_gives_a_second_file_of_its_hour(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(telegram_table, "ROWS", 4)
    times = [0, 0, 3600, 3600, 0, 0, 3600, 3600, 0]
    sent = [one._replace(t_ns=BEFORE_EIGHT + t * S) for one, t in zip(_polls(0, 9), times, strict=True)]
    path = capture(tmp_path / "bus.pcapng", sent)
    for _ in range(2):
        cli("decode", path, "--parquet", str(tmp_path / "archive"))
    found = [re.sub(r".*hour=(\d)/bus-\w{12}(.*)", r"\1\2", name) for name in names(tmp_path / "archive")]
    assert found == ["7-2.parquet", "7-3.parquet", "7.parquet", "8-2.parquet", "8.parquet"]
    assert [row["number"] for row in rows_of(tmp_path / "archive")] == [*range(1, 10)]


def test_schema_version_and_types(cli: Cli, tmp_path: Path) -> None:
    import pyarrow.parquet

    path = capture(tmp_path / "bus.pcapng", _polls(BEFORE_EIGHT, 1))
    cli("decode", path, "--parquet", str(tmp_path / "archive"), "--segment", "\u00fc")
    (file,) = (tmp_path / "archive").rglob("*.parquet")
    schema = pyarrow.parquet.read_schema(file)
    about = {"version": 1, "segment": "\u00fc", "capture": "bus.pcapng"}
    assert json.loads(schema.metadata[b"dpstack.telegrams"]) == about
    types = {field.name: str(field.type) for field in schema}
    assert types == {one.name: {"timestamp": "timestamp[ns]"}.get(one.type, one.type) for one in COLUMNS}
    page = REFERENCE.read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \|", page, re.MULTILINE)
    assert rows[: len(COLUMNS)] == [(one.name, one.type) for one in COLUMNS]


def test_readable_parts_of_damaged_captures_are_written_and_the_others_too(cli: Cli, tmp_path: Path) -> None:
    whole = capture(tmp_path / "whole.pcapng", _polls(BEFORE_EIGHT, 10))
    octets = Path(whole).read_bytes()
    (tmp_path / "cut.pcapng").write_bytes(octets[:-5])
    (tmp_path / "empty.pcapng").write_bytes(b"")
    sources = [str(tmp_path / name) for name in ("cut.pcapng", "gone.pcapng", "empty.pcapng", "whole.pcapng")]
    out, err = cli("decode", *sources, "--parquet", str(tmp_path / "archive"), "--segment", "s", "--json", code=1)
    assert [line.partition(": ")[2] for line in err.splitlines()] == [
        f"{sources[0]}: the file ends within a block: 31 octets of a last block are not read",
        f"{sources[1]}: cannot be read (No such file or directory); name a capture file",
        f"{sources[2]}: empty",
    ]
    *files, summary = map(json.loads, out.splitlines())
    assert summary == {"event": "summary", "captures": 4, "unread": 3, "telegrams": 19, "files": 2}
    assert [file["telegrams"] for file in files] == [9, 10]
    assert len(rows_of(tmp_path / "archive")) == 19


def test_wrong_folders_are_reported_before_a_capture_is_read(cli: Cli, tmp_path: Path) -> None:
    path = capture(tmp_path / "bus.pcapng", _polls(BEFORE_EIGHT, 1))
    for folder in (path, f"{path}/archive"):
        assert "is no folder; name one with --parquet" in cli.err("decode", path, "--parquet", folder)
    assert "cannot be made" in cli.err("decode", path, "--parquet", "/proc/archive")
    assert "null" in cli.err("decode", path, "--parquet", "a\0b")
    assert "needs the name of a folder" in cli.err("decode", path, "--parquet", "")


def test_files_of_others_stay(cli: Cli, tmp_path: Path) -> None:
    path = capture(tmp_path / "bus.pcapng", _polls(BEFORE_EIGHT, 1))
    archive = tmp_path / "archive"
    (archive / "segment=bus").mkdir(parents=True)
    others = {archive / "README": "mine", archive / "segment=bus" / "x.parquet": "no Parquet"}
    for other, text in others.items():
        other.write_text(text)
    cli("decode", path, "--parquet", str(archive))
    assert {other: other.read_text() for other in others} == others
    # a folder in place of a file
    (file,) = (archive / "segment=bus").rglob("bus-*.parquet")
    file.unlink()
    file.mkdir()
    assert f"{file}: cannot be written (Is a directory)" in cli.err("decode", path, "--parquet", str(archive), code=1)
    assert names(archive) == ["README", "segment=bus/x.parquet"]


def test_a_reader_of_its_lines_that_goes_ends_it_without_a_traceback(tmp_path: Path) -> None:
    """As with `| head -1`: whole files stay."""
    sources = [capture(tmp_path / f"{name}.pcapng", _polls(BEFORE_EIGHT, 1)) for name in "abc"]
    command = [sys.executable, "-u", "-m", "dpstack", "decode", *sources, "--parquet", str(tmp_path / "archive")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.close()
        _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (1, "")
    assert [name.split("/")[0] for name in names(tmp_path / "archive")] == ["segment=a"]


_LIMITED = """
import resource, sys
from dpstack.api.listen import telegram_table
from dpstack.cli.main import main
telegram_table.ROWS = 2000
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), resource.RLIM_INFINITY))
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.parametrize(("limit", "whole"), [(30_000, ["hour=7"]), (2_000, [])], ids=["rows", "end"])
def test_a_full_disk_leaves_whole_files_and_says_what_to_do(tmp_path: Path, limit: int, whole: list[str]) -> None:
    """The limit of a file's size stands for the disk: the rows of the second hour do not fit, or the end of the first
    file."""
    jitter = [number * number * 7919 % 900_001 for number in range(20_000)]
    first = _polls(BEFORE_EIGHT, 100, 9 * MS)
    second = [
        one._replace(t_ns=(one.t_ns or 0) + more)
        for one, more in zip(_polls(BEFORE_EIGHT + S, 20_000), jitter, strict=True)
    ]
    path = capture(tmp_path / "bus.pcapng", [*first, *second])
    archive = tmp_path / "archive"
    command = [sys.executable, "-B", "-c", _LIMITED, str(limit), "decode", path, "--parquet", str(archive)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1, done
    (line,) = done.stderr.splitlines()
    where, _, what = line.partition(": cannot be written ")
    assert re.search(rf"hour={8 if whole else 7}/bus-\w+\.parquet$", where)
    assert what == (
        "(File too large); make room there and give the same command again: all files with a name are whole, and it "
        "replaces them"
    )
    assert [name.split("/")[2] for name in names(archive)] == whole
    assert not whole or len(rows_of(archive)) == 100
    assert subprocess.run([*command[:4], "-1", *command[5:]], capture_output=True, timeout=60).returncode == 0
    assert len(rows_of(archive)) == 20_100


_LOOKS = """
import glob, os, signal, sys
from dpstack.api.listen import telegram_table
from dpstack.cli.main import main
telegram_table.ROWS = 10
write = telegram_table._HourFile.write
def look(self, rows):
    write(self, rows)
    if self.rows >= 50:
        print(*glob.glob(sys.argv[2] + "/**/*.parquet", recursive=True), flush=True)
        os.kill(os.getpid(), getattr(signal, sys.argv[3]))
telegram_table._HourFile.write = look
sys.exit(main(["decode", sys.argv[1], "--parquet", sys.argv[2]]))
"""


@pytest.mark.parametrize(("signal", "left"), [("SIGINT", 0), ("SIGKILL", 1)])
def test_a_file_that_is_not_whole_has_no_name_for_its_readers(tmp_path: Path, signal: str, left: int) -> None:
    path = capture(tmp_path / "bus.pcapng", _polls(BEFORE_EIGHT + S, 100))
    archive = tmp_path / "archive"
    command = [sys.executable, "-c", _LOOKS, path, str(archive), signal]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode != 0
    assert done.stdout.split() == []
    hidden = [name.rpartition("/")[2] for name in names(archive)]
    assert [re.sub(r"\w{16}", "", name) for name in hidden] == ["..tmp"] * left


_MEASURED = """
import sys
from dpstack.api.listen import telegram_table
from dpstack.cli.main import main
telegram_table.ROWS = 10_000
code = main(sys.argv[1:])
print(open("/proc/self/status").read().partition("VmHWM:")[2].split()[0])
sys.exit(code)
"""


@pytest.mark.parametrize(("few", "many", "size"), [(20_000, 80_000, 3), (100, 1000, 60_000)], ids=["many", "long"])
def test_memory_does_not_grow_with_the_capture(tmp_path: Path, few: int, many: int, size: int) -> None:
    """Here 10 000 rows are written together; a row that waits takes 300 octets."""
    most = []
    for count in (few, many):
        sent = (Transmission(number.to_bytes(size, "little"), BEFORE_EIGHT, 500_000) for number in range(count))
        path = capture(tmp_path / f"{count}.pcapng", sent)
        command = [sys.executable, "-c", _MEASURED, "decode", path, "--parquet", str(tmp_path / "archive")]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        most.append(int(done.stdout.split()[-1]))
    assert most[1] < most[0] + 8_000, most
