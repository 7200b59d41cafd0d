"""Finds the program that holds a port: by its lock (dpstack and pyserial set one) or by its open files in /proc."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Final

from dpstack.text import shortened

PROC: Final = Path("/proc")
#: the name of the dpstack program, and the package that a bus process is started as (python -m), in command lines
_OURS: Final = "dpstack"
_BUS_PROCESS: Final = "dpstack.drivers.process"
#: characters of a command line in a message at most
_LONGEST: Final = 100


def holder_of(fd: int) -> str:
    """The program that holds the flock on the file of ``fd``: "minicom (pid 4711)"."""
    return _lock_holder(os.fstat(fd), PROC) or "another program"


def holder_of_path(path: str, proc: Path = PROC) -> str | None:
    """The program that holds the lock on ``path`` or, without a lock, has it open; None where none can be found.

    Only root can see open descriptors of other users' programs.
    """
    with contextlib.suppress(OSError):
        holder = _lock_holder(os.stat(path), proc)
        if holder is not None:
            return holder
    device = os.path.realpath(path)
    for folder in sorted(proc.glob("[0-9]*/fd")):
        with contextlib.suppress(OSError):
            if any(os.readlink(entry) == device for entry in folder.iterdir()):
                return _program(int(folder.parent.name), proc)
    return None


def _lock_holder(info: os.stat_result, proc: Path) -> str | None:
    wanted = f"{os.major(info.st_dev):02x}:{os.minor(info.st_dev):02x}:{info.st_ino}"
    with contextlib.suppress(OSError), (proc / "locks").open(encoding="ascii", errors="replace") as locks:
        for line in locks:
            fields = line.split()
            # "1: FLOCK ADVISORY WRITE 4711 00:18:5 0 EOF"; waiting ones have an arrow after the number
            if len(fields) > 5 and fields[1] == "FLOCK" and fields[5] == wanted:
                return _program(int(fields[4]), proc)
    return None


def _program(pid: int, proc: Path) -> str:
    if pid <= 0:
        return "another program"
    words = _command(pid, proc)
    if _BUS_PROCESS in words:
        with contextlib.suppress(OSError, ValueError, IndexError):
            # "4711 (name) S 1234 ...": the parent of a bus process is the application that its user knows
            stat = (proc / str(pid) / "stat").read_text(encoding="utf-8", errors="replace")
            pid = int(stat.rpartition(")")[2].split()[1])
            words = _command(pid, proc)
    if pid == os.getpid():
        return f"this program itself (pid {pid})"
    name = ""
    with contextlib.suppress(OSError):
        name = (proc / str(pid) / "comm").read_text(encoding="utf-8", errors="replace").strip()
    if name == _OURS:  # name the command and its configuration
        at = next((n for n, word in enumerate(words) if os.path.basename(word) == _OURS), 0)
        name = f"`{shortened(' '.join((_OURS, *words[at + 1 :])), _LONGEST)}`"
    return f"{name} (pid {pid})" if name else f"pid {pid}"


def _command(pid: int, proc: Path) -> list[str]:
    with contextlib.suppress(OSError):
        octets = (proc / str(pid) / "cmdline").read_bytes()
        return octets.decode("utf-8", "replace").rstrip("\0").split("\0")
    return []
