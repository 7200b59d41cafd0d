"""The number of the MQTT session on disk: it goes on across restarts, and nobody else has it."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dpstack.bridge.mqtt.session_file import SessionFile
from dpstack.errors import ConfigError

KILLED = """
import os, signal, sys
from pathlib import Path
from dpstack.bridge.mqtt.session_file import SessionFile
numbers = SessionFile(Path(sys.argv[1]))
for _ in range(int(sys.argv[2])):
    number = numbers.next()
print(number, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_numbers_begin_at_zero_and_wrap_behind_255(tmp_path: Path) -> None:
    numbers = SessionFile(tmp_path / "a" / "b")
    assert [numbers.next() for _ in range(258)] == [*range(256), 0, 1]
    assert not numbers.damaged
    assert oct((tmp_path / "a" / "b").stat().st_mode)[-3:] == "700"
    numbers.close()
    numbers.close()


def test_a_folder_that_nobody_holds_any_more_is_free(tmp_path: Path) -> None:
    """As where the task that took it was cancelled meanwhile."""
    SessionFile(tmp_path)
    gc.collect()
    numbers = SessionFile(tmp_path)
    assert numbers.next() == 0
    numbers.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        numbers.next()


def test_a_number_is_never_given_twice_by_programs_that_are_killed(tmp_path: Path) -> None:
    given = []
    for count in (1, 3):
        run = subprocess.run(
            [sys.executable, "-c", KILLED, str(tmp_path), str(count)], capture_output=True, text=True, check=False
        )
        assert run.returncode == -9, run.stderr
        given.append(int(run.stdout))
    numbers = SessionFile(tmp_path)
    assert [*given, numbers.next()] == [0, 3, 4]
    numbers.close()


def test_the_number_is_on_disk_before_it_is_returned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Octets, then the new name, then the folder that has the name."""
    done: list[str] = []
    numbers = SessionFile(tmp_path)
    sync, replace = os.fsync, os.replace

    def fsync(fd: int) -> None:
        done.append("sync " + Path(os.readlink(f"/proc/self/fd/{fd}")).name)
        sync(fd)

    def renamed(old: str, new: str, *, src_dir_fd: int, dst_dir_fd: int) -> None:
        done.append("rename")
        replace(old, new, src_dir_fd=src_dir_fd, dst_dir_fd=dst_dir_fd)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", renamed)
    numbers.next()
    assert done == ["sync bdseq.new", "rename", f"sync {tmp_path.name}"]
    numbers.close()


def test_a_disk_that_is_full_gives_no_number_and_the_old_one_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers = SessionFile(tmp_path)
    numbers.next()

    def full(fd: int, octets: bytes) -> int:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(OSError, match="No space"):
            numbers.next()
    assert (tmp_path / "bdseq").read_bytes() == b"0\n"
    assert numbers.next() == 1
    numbers.close()


@pytest.mark.parametrize("octets", [b"", b"256\n", b"12", b"-1\n", b"1\n2\n", b"\xff\x00", b"7 \n", b"0" * 100])
def test_a_damaged_file_is_found(tmp_path: Path, octets: bytes) -> None:
    (tmp_path / "bdseq").write_bytes(octets)
    numbers = SessionFile(tmp_path)
    assert numbers.damaged
    assert numbers.next() == 0
    numbers.close()
    again = SessionFile(tmp_path)
    assert not again.damaged
    again.close()


def test_a_second_gateway_with_the_same_id_is_refused(tmp_path: Path) -> None:
    first = SessionFile(tmp_path)
    with pytest.raises(ConfigError, match="another gateway on this computer has the same group and node"):
        SessionFile(tmp_path)
    first.close()
    SessionFile(tmp_path).close()


def test_a_folder_that_cannot_be_used_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "link").mkdir()
    (tmp_path / "link" / "bdseq").symlink_to("/etc/passwd")
    for folder in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / "link"):
        with pytest.raises(ConfigError, match="the state of the MQTT session cannot be kept in"):
            SessionFile(folder)
