"""Finds the program that holds a port: by its lock (dpstack and pyserial set one) or by its open files in /proc; advice
on programs that open serial ports by themselves."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from itertools import pairwise
from typing import Final

from dpstack.text import shortened

PROC: Final = "/proc"
#: a folder like it, for tests
Proc = str | os.PathLike[str]
#: the name of the dpstack program, and the package that a bus process is started as (python -m), in command lines
_OURS: Final = "dpstack"
_BUS_PROCESS: Final = "dpstack.drivers.process"
#: where an own line goes: behind the rules of the programs that follow
_RULES: Final = "this line in /etc/udev/rules.d/99-own.rules keeps it off: "
#: programs that open serial adapters by themselves, and what keeps each off. The rule of brltty starts it at once: only
#: a file of the same name keeps it from that (udev(7))
_KEEP_OFF: Final = {
    "ModemManager": _RULES + 'SUBSYSTEM=="tty", SUBSYSTEMS=="usb", {ids}ENV{{ID_MM_PORT_IGNORE}}="1"',
    "gpsd": _RULES + 'SUBSYSTEM=="tty", SUBSYSTEMS=="usb", {ids}ENV{{SYSTEMD_WANTS}}=""',
    "brltty": "ln -s /dev/null /etc/udev/rules.d/85-brltty.rules keeps it off (the name that its rules have in "
    "/usr/lib/udev/rules.d)",
}
#: characters of a command line in a message at most
_LONGEST: Final = 100


def holder_of(fd: int) -> str:
    """The program that holds the flock on the file of ``fd``: "minicom (pid 4711)"."""
    return _lock_holder(os.fstat(fd), PROC) or "another program"


def holder_of_path(path: str, proc: Proc = PROC) -> str | None:
    """The program that holds the lock on ``path`` or, without a lock, has it open; None if none can be found.

    Only root can see open descriptors of other users' programs, see :func:`hides_programs`.
    """
    with contextlib.suppress(OSError):
        holder = _lock_holder(os.stat(path), proc)
        if holder is not None:
            return holder
    return next((holder for _pid, holder in _opened_by(path, proc)), None)


def other_openers(path: str, proc: Proc = PROC) -> list[str]:
    """All programs that have ``path`` open, but this one and its children; in a bus process also without its
    application and the children of that. Takes some ms: not for the loop of a bus."""
    in_bus_process = _BUS_PROCESS in _command(os.getpid(), proc)
    own = (os.getpid(), os.getppid()) if in_bus_process else (os.getpid(),)
    return [one for pid, one in _opened_by(path, proc) if pid not in own and _parent(pid, proc) not in own]


def hides_programs(proc: Proc = PROC) -> bool:
    """Whether open files of some programs cannot be seen, because they are another user's."""
    return not all(os.access(folder, os.R_OK) for _pid, folder in _open_files(proc))


def is_dpstack(holder: str) -> bool:
    """Whether ``holder``, a text of this module, is a command of dpstack, which listens to ``dpstack ctl``."""
    return holder.startswith(f"`{_OURS} ")


def keep_off(holder: str, usb: str | None = None) -> str:
    """How to keep ``holder``, a text of this module, off the adapter ``usb`` (vendor:product); empty for a program that
    opens a port only when somebody orders it."""
    how = _KEEP_OFF.get(holder.partition(" (pid")[0])
    if how is None:
        return ""
    vendor, _, product = (usb or "").partition(":")
    ids = f'ATTRS{{idVendor}}=="{vendor}", ATTRS{{idProduct}}=="{product}", ' if product else ""
    return f"it opens adapters by itself; {how.format(ids=ids)}"


def _opened_by(path: str, proc: Proc) -> Iterator[tuple[int, str]]:
    """The programs that have ``path`` open: pid and text."""
    device = os.path.realpath(path)
    for pid, folder in _open_files(proc):
        with contextlib.suppress(OSError):
            if any(os.readlink(os.path.join(folder, name)) == device for name in os.listdir(folder)):
                yield pid, _program(pid, proc)


def _open_files(proc: Proc) -> Iterator[tuple[int, str]]:
    """The programs by pid, in order of its digits, and the folder of what each has open."""
    try:
        names = sorted(os.listdir(proc))
    except OSError:  # a system without
        return
    for name in names:
        folder = os.path.join(proc, name, "fd")
        if name.isdecimal() and os.path.exists(folder):
            yield int(name), folder


def _lock_holder(info: os.stat_result, proc: Proc) -> str | None:
    wanted = f"{os.major(info.st_dev):02x}:{os.minor(info.st_dev):02x}:{info.st_ino}"
    with contextlib.suppress(OSError), open(os.path.join(proc, "locks"), encoding="ascii", errors="replace") as locks:
        for line in locks:
            fields = line.split()
            # "1: FLOCK ADVISORY WRITE 4711 00:18:5 0 EOF"; waiting ones have an arrow after the number
            if len(fields) > 5 and fields[1] == "FLOCK" and fields[5] == wanted:
                return _program(int(fields[4]), proc)
    return None


def _program(pid: int, proc: Proc) -> str:
    if pid <= 0:
        return "another program"
    words = _command(pid, proc)
    if _BUS_PROCESS in words:
        parent = _parent(pid, proc)  # of a bus process: the application that its user knows
        if parent is not None:
            pid, words = parent, _command(parent, proc)
    if pid == os.getpid():
        return f"this program itself (pid {pid})"
    name = ""
    with contextlib.suppress(OSError):
        name = _read(pid, "comm", proc).decode("utf-8", "replace").strip()
    as_module = any(pair == ("-m", _OURS) for pair in pairwise(words))  # python -m dpstack
    if name == _OURS or as_module:  # name the command and its configuration
        at = next((n for n, word in enumerate(words) if os.path.basename(word) == _OURS), 0)
        name = f"`{shortened(' '.join((_OURS, *words[at + 1 :])), _LONGEST)}`"
    return f"{name} (pid {pid})" if name else f"pid {pid}"


def _parent(pid: int, proc: Proc) -> int | None:
    """The process that started ``pid``; None if that cannot be read."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        # "4711 (name) S 1234 ..."
        stat = _read(pid, "stat", proc).decode("utf-8", "replace")
        return int(stat.rpartition(")")[2].split()[1])
    return None


def _command(pid: int, proc: Proc) -> list[str]:
    with contextlib.suppress(OSError):
        return _read(pid, "cmdline", proc).decode("utf-8", "replace").rstrip("\0").split("\0")
    return []


def _read(pid: int, name: str, proc: Proc) -> bytes:
    with open(os.path.join(proc, str(pid), name), "rb") as file:
        return file.read()
