"""Files: only ordinary ones are read, none of somebody else is written over, and no half of one is ever there."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import importlib.util
import os
import socket
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
from api_kit import HOIST
from cli_kit import Cli
from plant_files import plant_file

from dpstack.api.config.config import load_config
from dpstack.api.files import AtomicFile, read_file
from dpstack.api.gsd_info import copy_gsd, read_gsd
from dpstack.api.listen.capture_file import CaptureFile
from dpstack.api.listen.report_file import ReportFile
from dpstack.api.lists.parameter_list import ParameterList
from dpstack.api.lists.record_list import RecordList
from dpstack.api.recording.event_log import EventLog
from dpstack.api.recording.record_file import NO_ROTATION, RecordFile
from dpstack.capture.timing import LineTiming
from dpstack.cli.main import main
from dpstack.errors import ConfigError, UsageError
from dpstack.monitor.monitor import Monitor


def pipe(folder: Path) -> Path:
    path = folder / "pipe"
    os.mkfifo(path)
    return path


def listening(folder: Path) -> Path:
    with contextlib.chdir(folder), socket.socket(socket.AF_UNIX) as made:
        made.bind("socket")  # a whole path may be too long for one
    return folder / "socket"


#: kinds of files that are not ordinary ones, and the message about each
STRANGE: dict[str, tuple[Callable[[Path], Path], str]] = {
    "pipe": (pipe, "is a pipe, no ordinary file"),
    "socket": (listening, "is a socket, no ordinary file"),
    "device": (lambda _: Path("/dev/zero"), "is a device, no ordinary file"),
    "directory": (lambda folder: folder, "directory"),
}


@pytest.mark.parametrize("read", [read_gsd, load_config, ParameterList.load, RecordList.load])
@pytest.mark.parametrize("kind", STRANGE)
def test_a_path_that_is_no_ordinary_file_is_refused_at_once(
    kind: str, read: Callable[[Path], object], tmp_path: Path
) -> None:
    make, what = STRANGE[kind]
    path = make(tmp_path)
    link = tmp_path / "link"
    link.symlink_to(path)
    for name in (path, link):
        with pytest.raises(ConfigError) as caught:
            read(name)
        assert str(caught.value).startswith(f"{name}: ")
        assert what in str(caught.value)


@pytest.mark.parametrize("argv", [["gsd", "show"], ["gsd", "check"], ["gsd", "configure"], ["plan"]])
def test_commands_refuse_a_pipe(argv: list[str], tmp_path: Path, cli: Cli) -> None:
    assert "is a pipe, no ordinary file" in cli.err(*argv, str(pipe(tmp_path)))


def test_a_pipe_in_place_of_the_file_that_was_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the look and the open: the open does not wait for a writer."""
    path = pipe(tmp_path)
    ordinary = tmp_path / "file"
    ordinary.touch()
    found = os.stat(ordinary)
    monkeypatch.setattr(os, "stat", lambda _: found)
    with pytest.raises(OSError, match="is a pipe, no ordinary file"):
        read_file(path, 10)


def test_one_octet_more_than_the_limit_is_read(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"abcd")
    assert [read_file(path, most) for most in (2, 3, 4)] == [b"abc", b"abcd", b"abcd"]


def test_a_name_that_cannot_be() -> None:
    with pytest.raises(ConfigError, match="null"):
        load_config("a\0b")
    with pytest.raises(ConfigError, match="File name too long"):
        load_config("x" * 5000)


@pytest.mark.parametrize("command", ["gsd show", "gsd check", "gsd configure", "plan", "run", "gsd copy io-station"])
@pytest.mark.parametrize("name", ["x" * 300, "x/" * 3000 + "x", "", ".", "loop"], ids=lambda name: name[:4] or "empty")
def test_a_name_of_no_file(
    command: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    loop = tmp_path / "loop"
    loop.symlink_to("loop")
    assert main([*command.split(), name]) in (1, 2)
    told = capsys.readouterr().err
    assert told.startswith("dpstack: ")
    assert told.count("\n") == 1
    assert list(tmp_path.iterdir()) == [loop]
    assert loop.is_symlink()


# --- written ---------------------------------------------------------------------------------------------------------


def test_a_new_file_is_never_written_over(tmp_path: Path) -> None:
    path = tmp_path / "a.gsd"
    copy_gsd("demag-dedrive", path)
    assert path.read_bytes().startswith(b"#Profibus_DP") or b"#Profibus_DP" in path.read_bytes()
    path.write_text("mine")
    with pytest.raises(UsageError, match="there is a file of that name; give the name of a new file"):
        copy_gsd("demag-dedrive", path)
    assert path.read_text() == "mine"


def test_a_copy_on_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fsync(file: int) -> None:
        if os.fstat(file).st_size:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(UsageError, match=r"a\.gsd: cannot be written \(No space left on device\); make room there"):
        copy_gsd("demag-dedrive", tmp_path / "a.gsd")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_comes_meanwhile_stays(tmp_path: Path) -> None:
    path = tmp_path / "file"
    with AtomicFile(path) as file:
        path.write_text("mine")
        with pytest.raises(UsageError, match="there is a file of that name"):
            file.keep(b"ours")
    assert path.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [path]


def test_a_list_under_a_name_of_no_file(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    for name in (".", "/", "..", "x" * 300, "a\0b", tmp_path / "loop", tmp_path / "loop" / "x"):
        with pytest.raises(UsageError), AtomicFile(name, lambda _: True):
            pass
    assert (tmp_path / "loop").is_symlink()


def test_an_empty_file_holds_nothing_to_lose(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch()
    with AtomicFile(path, lambda _: False) as file:
        file.keep(b"ours")
    assert path.read_bytes() == b"ours"


def test_a_file_that_is_replaced_keeps_its_mode(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch()
    path.chmod(0o600)
    with AtomicFile(path, lambda _: True) as file:
        file.keep(b"ours")
    assert path.read_bytes() == b"ours"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_link_laid_beforehand_is_not_followed(tmp_path: Path) -> None:
    """Aside the file has a name that nobody can guess, and is made anew."""
    names = set()
    for _ in range(2):
        with AtomicFile(tmp_path / "file"):
            names |= {one.name for one in tmp_path.iterdir()}
    assert len(names) == 2


@pytest.fixture
def plant(tmp_path: Path, alone: None) -> Path:
    return plant_file(tmp_path, HOIST, {**HOIST, "name": "crane", "address": 5})


def test_dump_replaces_its_own_file_only(plant: Path, capsys: pytest.CaptureFixture[str], cli: Cli) -> None:
    """Not the configuration, not notes, not the dump of another drive; its own earlier dump is."""
    order = ["drive", str(plant), "hoist", "dump"]
    notes, own = plant.with_name("notes.txt"), plant.with_name("hoist.toml")
    notes.write_text("mine", encoding="utf-8")
    earlier = ParameterList(drive="demag-dedrive", name="hoist", address=4, time="", parameters=())
    own.write_text(earlier.text(), encoding="utf-8")
    assert main([*order, str(own), "--data-set", "3"]) == 0, capsys.readouterr()
    assert ParameterList.load(own).address == 3
    crane = own.with_name("crane.toml")
    crane.write_text(own.read_text("utf-8").replace('"hoist"', '"crane"'), encoding="utf-8")
    for path in (plant, notes, crane):
        before = path.read_text("utf-8")
        assert (
            f"{path}: there is a file of that name, and it is no earlier dump of hoist; move it away, or name "
            f"another file" in cli.err(*order, str(path), "--data-set", "3")
        )
        assert path.read_text("utf-8") == before


def test_a_part_file_of_another_program_is_found_before_anything_is_read(plant: Path, cli: Cli) -> None:
    """The file for a dump that is cut short is looked at before anything is read."""
    part = plant.with_name("hoist.toml.part")
    part.write_text("mine", encoding="utf-8")
    assert f"{part}: there is a file of that name" in cli.err(
        "drive", str(plant), "hoist", "dump", str(plant.with_name("hoist.toml"))
    )
    assert part.read_text("utf-8") == "mine"


# --- written line by line -------------------------------------------------------------------------------------------
def _record(path: Path) -> contextlib.AbstractContextManager[object]:
    file = RecordFile(path, NO_ROTATION, 0.0, lambda _: None)
    return contextlib.closing(_Closing(lambda: file.close(0)))


def _log(path: Path) -> contextlib.AbstractContextManager[object]:
    return contextlib.closing(EventLog(path))


def _report(path: Path) -> contextlib.AbstractContextManager[object]:
    return ReportFile(str(path), Monitor(LineTiming("file", None)))


def _capture(path: Path) -> contextlib.AbstractContextManager[object]:
    return CaptureFile(str(path))


class _Closing:
    def __init__(self, close: Callable[[], None]) -> None:
        self.close = close


#: what writes a file that stays open, and the name of its file
WRITERS: dict[str, tuple[Callable[[Path], contextlib.AbstractContextManager[object]], str]] = {
    "record": (_record, "x.jsonl"),
    "parquet": (_record, "x.parquet"),
    "log": (_log, "x.jsonl"),
    "report": (_report, "x.html"),
    "capture": (_capture, "x.pcapng"),
}
WRITER = pytest.mark.parametrize("kind", WRITERS)


@WRITER
def test_a_link_to_a_file_that_stays_open_is_not_followed(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: True)  # of pyarrow
    write, name = WRITERS[kind]
    target, link = tmp_path / "mine", tmp_path / name
    for text in (None, ""):  # it leads nowhere, to an empty file
        if text is not None:
            target.write_text(text)
        link.unlink(missing_ok=True)
        link.symlink_to(target)
        with pytest.raises(UsageError, match=rf"{name}: is a link; name the file itself"), write(link):
            pass
        assert link.is_symlink()
        assert target.exists() is (text is not None)


@WRITER
@pytest.mark.parametrize("other", WRITERS)
def test_a_file_has_one_writer(kind: str, other: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also while it is empty, as a recording is until the first row: two runs, or two options of one run."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: True)  # of pyarrow
    write, name = WRITERS[kind]
    again = WRITERS[other][0] if WRITERS[other][1] == name else write
    path = tmp_path / name
    first = write(path)
    with first, pytest.raises(UsageError, match="it is being written already; name another file"), again(path):
        pass
    assert list(tmp_path.iterdir()) == []
    with again(path):  # its writer has ended
        pass


def test_a_file_that_its_writer_removes_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the look at an empty file and its lock: nothing is written into a file without a name."""
    path = tmp_path / "x.jsonl"
    path.touch()
    flock = fcntl.flock

    def late(fd: int, how: int) -> None:
        path.unlink()
        flock(fd, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with pytest.raises(UsageError, match="it is being written already"), _log(path):
        pass


def test_a_new_file_that_comes_at_the_last_moment_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.gsd"
    fsync = os.fsync

    def late(fd: int) -> None:
        fsync(fd)
        if os.fstat(fd).st_size:
            path.write_text("mine")

    monkeypatch.setattr(os, "fsync", late)
    with pytest.raises(UsageError, match="there is a file of that name"):
        copy_gsd("demag-dedrive", path)
    assert path.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [path]


def test_recording_and_log_in_one_file_leave_none(tmp_path: Path, cli: Cli) -> None:
    plant_file(tmp_path, HOIST)
    path = tmp_path / "y.jsonl"
    argv = ("run", str(tmp_path / "plant.toml"), "--record", str(path), "--log", str(path), "--seconds", "0.1")
    assert "it is being written already; name another file" in cli.err(*argv)
    assert not path.exists()
