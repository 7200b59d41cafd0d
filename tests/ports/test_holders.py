"""Who holds a port, from a made-up /proc and from the real one."""

from __future__ import annotations

import os
from pathlib import Path

from far_ends import PtyFarEnd

from dpstack.ports.holders import holder_of_path


def program(proc: Path, pid: int, name: str, *opened: str) -> None:
    (proc / str(pid) / "fd").mkdir(parents=True)
    (proc / str(pid) / "comm").write_text(name + "\n")
    for number, path in enumerate(opened):
        (proc / str(pid) / "fd" / str(number)).symlink_to(path)


def test_the_lock_counts_first(tmp_path: Path) -> None:
    proc, port = tmp_path / "proc", tmp_path / "ttyUSB0"
    port.touch()
    program(proc, 41, "reader", str(port))
    program(proc, 42, "minicom")
    info = port.stat()
    inode = f"{os.major(info.st_dev):02x}:{os.minor(info.st_dev):02x}:{info.st_ino}"
    (proc / "locks").write_text(
        "1: POSIX  ADVISORY  READ 40 00:18:5 0 EOF\n"
        f"2: -> FLOCK  ADVISORY  WRITE 43 {inode} 0 EOF\n"
        f"3: FLOCK  ADVISORY  WRITE 42 {inode} 0 EOF\n"
    )
    assert holder_of_path(str(port), proc) == "minicom (pid 42)"
    (proc / "locks").write_text(f"3: FLOCK  ADVISORY  WRITE 99 {inode} 0 EOF\n")
    assert holder_of_path(str(port), proc) == "pid 99"


def test_without_a_lock_an_open_descriptor_does(tmp_path: Path) -> None:
    proc, port, link = tmp_path / "proc", tmp_path / "ttyUSB0", tmp_path / "by-id"
    port.touch()
    link.symlink_to(port)
    program(proc, 40, "other", "/dev/null")
    program(proc, 41, "reader", "/dev/null", str(port))
    assert holder_of_path(str(link), proc) == "reader (pid 41)"
    assert holder_of_path(str(tmp_path / "ttyUSB1"), proc) is None


def test_the_real_one() -> None:
    far = PtyFarEnd()
    assert holder_of_path(far.path) is None
    fd = os.open(far.path, os.O_RDWR | os.O_NOCTTY)
    assert holder_of_path(far.path) == f"this program itself (pid {os.getpid()})"
    os.close(fd)
    far.hang_up()
