"""CPU time, memory and file descriptors of a process of this computer, from ``/proc`` (Linux)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, NamedTuple

_PROC: Final = Path("/proc")
#: fields of /proc/PID/stat behind the name of the program, see proc(5)
_USER, _SYSTEM, _START, _RESIDENT = 11, 12, 19, 21


class Usage(NamedTuple):
    """``started``: in s since 1970. None: this computer does not say it."""

    cpu_s: float
    resident: int
    started: float | None
    open_fds: int | None
    max_fds: int | None


def usage_of(pid: int) -> Usage | None:
    """The use of resources by process ``pid``; None without one, or no ``/proc``."""
    folder = _PROC / str(pid)
    try:
        fields = (folder / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        ticks = os.sysconf("SC_CLK_TCK")
        cpu = (int(fields[_USER]) + int(fields[_SYSTEM])) / ticks
        resident = int(fields[_RESIDENT]) * os.sysconf("SC_PAGE_SIZE")
        booted = _booted()
        started = None if booted is None else booted + int(fields[_START]) / ticks
    except (OSError, ValueError, IndexError):
        return None
    return Usage(cpu, resident, started, _open_fds(folder), _max_fds(folder))


def _booted() -> int | None:
    for line in (_PROC / "stat").read_text(encoding="ascii").splitlines():
        name, _, value = line.partition(" ")
        if name == "btime":
            return int(value)
    return None


def _open_fds(folder: Path) -> int | None:
    try:
        return len(os.listdir(folder / "fd"))
    except OSError:
        return None


def _max_fds(folder: Path) -> int | None:
    try:
        lines = (folder / "limits").read_text(encoding="ascii").splitlines()
        soft = next(line for line in lines if line.startswith("Max open files")).split()[3]
        return int(soft)
    except (OSError, ValueError, StopIteration, IndexError):
        return None
