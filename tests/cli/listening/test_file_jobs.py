"""Several capture files judged as one, by one process and by several: with the same result, whatever is in them."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from typing import Any

import pytest
from changed_traffic import recorded, traffic
from cli_kit import Cli
from hypothesis import given, settings
from hypothesis import strategies as st
from support import MS, S

from dpstack.capture.pcapng import Writer
from dpstack.capture.timing import FILE, LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.cli.listening import file_jobs
from dpstack.cli.listening.capture_set import captures_in
from dpstack.cli.listening.file_jobs import FileJobs
from dpstack.cli.listening.judged_file import JudgedFiles
from dpstack.errors import CaptureFileError
from dpstack.monitor.monitor import Happening, Monitor
from tests.monitor.test_counted_at_once import plain


def write(path: Path, heard: Sequence[Transmission], port: str = "bus") -> str:
    with path.open("wb") as file:
        writer = Writer(file, "a test")
        ports: dict[int, int] = {}
        for one in heard:
            if one.baud not in ports:
                ports[one.baud] = writer.interface(port, one.baud, "times by tap, resolution 0.001 us")
            writer.packet(ports[one.baud], one.t_ns or 0, one.octets, one.damage, one.note)
    return str(path)


def ring(folder: Path, heard: Sequence[Transmission], ends: Sequence[int]) -> list[str]:
    """``heard`` in files as of a ring, which end before these transmissions."""
    parts = [heard[begin:end] for begin, end in zip([0, *ends], [*ends, len(heard)], strict=True)]
    return [write(folder / f"bus_{n:05}_20260101T000000Z.pcapng", part) for n, part in enumerate(parts, 1) if part]


class Here:
    """In place of processes: the work is done when it is asked for. ``breaks``: the process ends before this one."""

    breaks = -1

    def __init__(self, count: int, **_: object) -> None:
        self._left = self.breaks

    def submit(self, work: Any, *args: object) -> Future[Any]:
        future: Future[Any] = Future()
        self._left -= 1
        if self._left == -1:
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(work(*args))
        return future

    def shutdown(self, **_: object) -> None: ...


def sound() -> list[Transmission]:
    """The part of the traffic in which all stations are there."""
    return [one for one in traffic()[:240] if one.octets[4:5] not in (b"\x09", b"\x89")]


Outcome = tuple[Any, list[Happening], dict[str, object], list[str]]


def judged(names: list[str], jobs: FileJobs | None = None, seconds: float | None = None) -> Outcome:
    """All that a monitor knows after the files, its events, the summary, and what was damaged."""
    events: list[Happening] = []
    monitor = Monitor(LineTiming(FILE, None), on_event=events.append)
    files = JudgedFiles(names, monitor, jobs=jobs, baud=1_500_000, on_remark=lambda text: None)
    try:
        files.read(seconds)
    except CaptureFileError as error:
        files.damage.append(str(error))
    return plain(monitor.counters), events, monitor.summary(), files.damage


@pytest.fixture(scope="module")
def here() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(file_jobs, "ProcessPoolExecutor", Here)
        patch.setattr(file_jobs, "_PIECE", 400)
        yield


@settings(max_examples=15)
@given(
    recorded(),
    st.lists(st.integers(0, 150), max_size=4),
    st.integers(1, 3),
    st.booleans(),
    st.sampled_from([None, 0.002]),
)
def test_files_cut_anywhere_are_judged_as_one(
    here: None, batches: list[list[Transmission]], cuts: list[int], count: int, torn: bool, seconds: float | None
) -> None:
    heard = [one for batch in batches for one in batch]
    with tempfile.TemporaryDirectory() as name:
        files = ring(Path(name), heard, sorted(min(cut, len(heard)) for cut in cuts))
        whole = write(Path(name) / "whole.pcapng", heard)
        if torn:
            os.truncate(files[-1], os.path.getsize(files[-1]) - 5)
            os.truncate(whole, os.path.getsize(whole) - 5)
        by_one = judged(files, seconds=seconds)
        with FileJobs(count) as jobs:
            assert judged(files, jobs, seconds) == by_one
        if len(by_one[3]) == torn and not any(one.kind == "gap" for one in by_one[1]):
            assert judged([whole], seconds=seconds)[:3] == by_one[:3]


def test_processes_judge_as_one_does(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_jobs, "_PIECE", 2_000)
    heard = [one._replace(t_ns=(one.t_ns or 0) + n * 50 * MS) for n in range(3) for one in sound()]
    ring(tmp_path, heard, [5, 90, 91, 300])
    outputs = {cli.out("monitor", str(tmp_path), "--jobs", jobs, *more) for jobs in "123" for more in [["--json"]]}
    (output,) = outputs
    assert output.count('"telegrams":') == 1
    report = [str(tmp_path / f"{jobs}.html") for jobs in "12"]
    for jobs, name in zip("12", report, strict=True):
        cli.out("monitor", str(tmp_path), "--jobs", jobs, "--report", name)


def test_a_process_that_ends_costs_no_telegrams(
    here: None, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = write(tmp_path / "a.pcapng", sound())
    expected = cli.out("monitor", name, "--json")
    monkeypatch.setattr(Here, "breaks", 1)
    found, warned = cli("monitor", name, "--json", "--jobs", "2")
    assert found == expected
    assert warned == (
        "dpstack: a process that reads the file has ended (out of memory?): the rest is read by this one\n"
    )


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_one_damaged_file_among_many(here: None, cli: Cli, tmp_path: Path, jobs: str) -> None:
    first, second, third = ring(tmp_path, sound(), [90, 180])
    whole = cli.json("monitor", str(tmp_path))["telegrams"]
    os.truncate(second, os.path.getsize(second) - 5)
    out, err = cli("monitor", str(tmp_path), "--jobs", jobs, "--json", code=1)
    left = 32 + len(sound()[179].octets) + (-len(sound()[179].octets) & 3) - 5
    assert err == f"dpstack: {second}: the file ends within a block: {left} octets of a last block are not read\n"
    assert f'"telegrams":{whole - 1},' in out
    names = f"{os.path.basename(second)} and {os.path.basename(third)}"
    assert f"a file is damaged or missing between {names}" in out
    report = tmp_path / "report.html"
    cli("monitor", first, second, third, "--report", str(report), code=1)
    assert f'<p class="remark">{err.removeprefix("dpstack: ").strip()}</p>' in report.read_text()
    os.unlink(report)
    # its beginning is no pcapng
    Path(second).write_bytes(b"\n\r\r\n" + bytes(200))
    assert f"dpstack: {second}: a section without the magic number of pcapng (at octet 0)\n" in cli.err(
        "monitor", first, second, third, "--jobs", jobs, code=1
    )


def test_a_ring_that_is_being_written(here: None, tmp_path: Path) -> None:
    """Its oldest file is removed after it was found, and the newest one grows while it is read."""
    files = ring(tmp_path, sound(), [90, 180])
    found = captures_in([str(tmp_path)], pytest.fail)
    assert found == files
    os.unlink(files[0])
    more = tmp_path / "more"
    write(more, [one._replace(t_ns=(one.t_ns or 0) + 50 * MS) for one in sound()])
    blocks = more.read_bytes()
    grown: list[str] = []

    def grow(name: str, octets: int) -> None:
        if name == files[2] and not grown:
            grown.append(name)
            with open(name, "ab") as file:
                file.write(blocks)

    monitor = Monitor(LineTiming(FILE, None))
    judged = JudgedFiles(found, monitor, on_octets=grow)
    judged.read()
    assert judged.damage == [f"{files[0]}: cannot be read (No such file or directory); name a capture file"]
    assert monitor.counters.telegrams > len(sound()) - 90 + 20


def test_a_folder_with_other_files(cli: Cli, tmp_path: Path) -> None:
    (file,) = ring(tmp_path, sound(), [])
    for name in ("notes.txt", "b\x1b[2J.csv", "empty.pcapng"):
        (tmp_path / name).write_bytes(b"" if name[0] == "e" else b"68 05 05 68\n")
    (tmp_path / "sub").mkdir()
    out, err = cli("monitor", str(tmp_path), "--json")
    assert err == f"dpstack: {tmp_path}: left out, no telegrams in pcapng: b\\x1b[2J.csv, empty.pcapng, notes.txt\n"
    assert out == cli.out("monitor", file, "--json")
    os.unlink(file)
    nothing = f"{tmp_path}: no capture file (pcapng) in this folder; name one that dpstack capture wrote to"
    assert cli.err("monitor", str(tmp_path)) == f"dpstack: {nothing}\n"
    (file,) = ring(tmp_path, sound(), [])
    assert "files of another kind are judged one at a time" in cli.err("monitor", file, str(tmp_path / "notes.txt"))
    assert "cannot be read (No such file or directory)" in cli.err("monitor", file, str(tmp_path / "none.pcapng"))


def test_files_of_a_folder_that_cannot_be_read_are_named(cli: Cli, tmp_path: Path) -> None:
    folder, report = tmp_path / "ring", tmp_path / "report.html"
    folder.mkdir()
    for name, target in {"b\x1b[2J.pcapng": "gone.pcapng", "loop.pcapng": "loop.pcapng", "up": ".."}.items():
        (folder / name).symlink_to(target)
    os.mkfifo(folder / "pipe")
    reasons = "b\\x1b[2J.pcapng (No such file or directory), loop.pcapng (Too many levels of symbolic links)"
    unread = f"{folder}: left out, cannot be read: {reasons}"
    err = cli.err("monitor", str(folder))
    assert err.splitlines() == [
        f"dpstack: {unread}",
        f"dpstack: {folder}: no capture file (pcapng) in this folder; name one that dpstack capture wrote to",
    ]
    (file,) = ring(folder, sound(), [])
    out, err = cli("monitor", str(folder), "--json", "--report", str(report))
    assert err.splitlines() == [
        f"dpstack: {unread}",
        f"dpstack: {folder}: left out, no telegrams in pcapng: pipe",
    ]
    assert out == cli.out("monitor", file, "--json")
    page = report.read_text()
    assert f'<p class="remark">{unread}</p>' in page
    assert "left out, no telegrams in pcapng: pipe" in page


def test_files_of_one_time_and_files_that_overlap(cli: Cli, tmp_path: Path) -> None:
    heard = sound()
    b, a = write(tmp_path / "b.pcapng", heard[:90]), write(tmp_path / "a.pcapng", heard[:90])
    out, err = cli("monitor", b, a, "--json")
    assert err == (
        f"dpstack: {a} and {b} begin at the same time: they are read in the order of their names\n"
        f"dpstack: {b} begins before {a} ends: telegrams of the time between count twice\n"
    )
    assert out == cli.out("monitor", a, b, "--json")
    assert cli.json("monitor", a, str(tmp_path / "." / "a.pcapng"))["telegrams"] == 90  # it is one file


def test_a_ring_of_a_port_without_octet_times_overlaps_nowhere(cli: Cli, tmp_path: Path) -> None:
    """Its telegrams follow each other sooner than their octets need at the rate, also from one file to the next."""
    first, *others = sound()
    begin = first.t_ns or 0
    hurried = [first, *(one._replace(t_ns=begin + n * 50_000) for n, one in enumerate(others, 1))]
    whole = write(tmp_path / "whole.pcapng", hurried)
    folder = tmp_path / "ring"
    folder.mkdir()
    ring(folder, hurried, [30, 31, 90])
    for jobs in ("1", "2"):
        out, err = cli("monitor", str(folder), "--json", "--jobs", jobs)
        assert err == ""
        assert out.splitlines()[1:] == cli.out("monitor", whole, "--json").splitlines()[1:]


def test_files_of_two_days_and_of_another_port(cli: Cli, tmp_path: Path) -> None:
    heard = sound()
    write(tmp_path / "b.pcapng", heard[:160])
    write(tmp_path / "a.pcapng", [one._replace(t_ns=(one.t_ns or 0) + 86_400 * S) for one in heard[160:]])
    write(tmp_path / "c.pcapng", heard[:50], port="other")
    lines, err = cli("monitor", str(tmp_path), "--json")
    assert "only the port 'bus' is read; left out: 'other'" in err
    assert '"text":"nothing was captured between b.pcapng and a.pcapng"' in lines
    summary = cli.json("monitor", str(tmp_path))
    assert summary["seconds"] < 1  # the day between is no time of listening
    assert all(not one["lost"] for one in summary["stations"].values())


def test_the_start_names_the_files(cli: Cli, tmp_path: Path) -> None:
    files = ring(tmp_path, sound(), [90])
    start = cli.jsons("monitor", str(tmp_path))[0]
    assert (start["file"], start["files"], start["port"]) == (files[0], files, "bus")
    assert cli.out("monitor", str(tmp_path)).startswith(f"{files[0]} and 1 more, port bus, 1.5 Mbit/s, from ")


def test_interfaces_without_end_are_no_reason_to_copy_them(tmp_path: Path, here: None, cli: Cli) -> None:
    path = tmp_path / "a.pcapng"
    with path.open("wb") as file:
        writer = Writer(file, "a test")
        for one in sound()[:20]:
            writer.packet(writer.interface("bus", one.baud, "x" * 65_000), one.t_ns or 0, one.octets)
    err = cli.err("monitor", str(path), "--jobs", "2", code=1)
    assert "more than 1048576 octets describe interfaces: read it in one process" in err
    assert cli.json("monitor", str(path))["telegrams"] == 20
    shutil.rmtree(tmp_path)
