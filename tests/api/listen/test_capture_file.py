"""Files of a capture: a new one, a ring that stays within its size, a disk that is full or slow."""

from __future__ import annotations

import errno
import os
import threading
from pathlib import Path

import pytest

from dpstack.api.listen import capture_file
from dpstack.api.listen.capture_file import CaptureFile, Ring
from dpstack.capture.pcapng import Reader, Writer
from dpstack.errors import CaptureFileError, UsageError

T = 1_790_000_000_000_000_000


def telegrams(path: Path) -> int:
    with path.open("rb") as file:
        reader = Reader(file, path.name)
        count = sum(1 for _ in reader)
        assert reader.cut == ""
    return count


async def test_a_new_file(tmp_path: Path) -> None:
    path = tmp_path / "a.pcapng"
    with CaptureFile(str(path)) as file:
        writer = Writer(file, "a test")
        writer.packet(writer.interface("p", 9_600, ""), T, b"\xe5")
        assert path.read_bytes() == b""
        await file.flush()
        assert telegrams(path) == 1


def test_only_an_empty_file_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "a.pcapng"
    path.touch()
    with CaptureFile(str(path)):
        pass
    assert not path.exists()
    for name, text in (
        (str(tmp_path), "is a directory"),
        ("/dev/null", "is a device or a pipe; name an ordinary file, or - for standard output"),
        (str(tmp_path / "none" / "a"), "cannot be written"),
        (str(tmp_path / "a\0"), "null"),
    ):
        with pytest.raises(UsageError, match=text), CaptureFile(name):
            pass
        if name != "/dev/null":
            with pytest.raises(UsageError), CaptureFile(name, Ring(2, 1)):
                pass


async def _fill(file: CaptureFile, count: int) -> None:
    """Write ``count`` packets of 100 octets as a capture does, each file with its section."""
    writer: Writer | None = None
    for n in range(count):
        if writer is None or file.is_full:
            file.begin(T + n)
            writer = Writer(file, "a test")
            writer.interface("p", 9_600, "")
        writer.packet(0, T + n, bytes(100))
        if n % 7 == 0:
            await file.flush()
    await file.flush()


async def test_a_ring_has_so_many_files_of_such_a_size(tmp_path: Path) -> None:
    path = tmp_path / "bus.pcapng"
    other = tmp_path / "bus_00001_of_mine.pcapng"
    other.write_text("mine")
    with CaptureFile(str(path), Ring(3, 0.001)) as file:
        await _fill(file, 100)
    files = sorted(tmp_path.glob("bus_*Z.pcapng"))
    assert files == file.paths
    assert len(files) == 3
    assert all(telegrams(one) for one in files)
    assert all(one.stat().st_size <= 1_000 + 132 for one in files)
    assert files[-1].name.endswith("_20260921T141320Z.pcapng")
    numbers = [int(one.name.split("_")[1]) for one in files]
    assert numbers == [numbers[0], numbers[0] + 1, numbers[0] + 2]
    # the next capture goes on with this ring
    with CaptureFile(str(path), Ring(2, 0.001)) as file:
        await _fill(file, 1)
    names = sorted(one.name for one in tmp_path.glob("bus_*Z.pcapng"))
    assert names == [files[-1].name, f"bus_{numbers[-1] + 1:05}_20260921T141320Z.pcapng"]
    assert other.read_text() == "mine"
    assert not path.exists()


async def test_a_full_disk_ends_the_file_after_a_whole_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.pcapng"
    left = [250]
    really = os.write

    def write(fd: int, octets: bytes) -> int:
        if not left[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        done = really(fd, octets[: left[0]])
        left[0] -= done
        return done

    with CaptureFile(str(path)) as file:
        writer = Writer(file, "a test")
        interface = writer.interface("p", 9_600, "")
        for n in range(20):
            writer.packet(interface, T + n, bytes(n))
        monkeypatch.setattr(os, "write", write)
        with pytest.raises(CaptureFileError, match=r"a\.pcapng: cannot be written \(No space left.*make room there"):
            await file.flush()
        monkeypatch.undo()
    assert 0 < telegrams(path) < 20
    assert path.stat().st_size <= 250


async def test_a_slow_disk_takes_no_more_memory_than_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()
    really = os.write

    def write(fd: int, octets: bytes) -> int:
        go_on.wait()
        return really(fd, octets)

    monkeypatch.setattr(os, "write", write)
    monkeypatch.setattr(capture_file, "MOST_WAITING", 1_000)
    with CaptureFile(str(tmp_path / "a")) as file:
        file.write(bytes(600))
        room = [file.has_room]
        file.write(bytes(600))
        room.append(file.has_room)
        go_on.set()
        await file.flush()
        room.append(file.has_room)
    assert room == [True, False, True]
