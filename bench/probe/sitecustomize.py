"""Loaded by an interpreter that has this folder on its PYTHONPATH: notes turn-arounds at one tty, in shared memory.

BENCH_LINE is the tty, BENCH_PROBE a folder. A process that opens the tty with ``os.open`` writes to BENCH_PROBE/PID:
numbers of 64 bits, a count, one that is free, then pairs: the time of a write (CLOCK_MONOTONIC, ns)
and the turn-around before it, from the return of the last read to the return of the write, twice its value in ns, plus
1 when the token lay between. The ring has room for CAPACITY pairs. Nothing of the
project is imported here.
"""

from __future__ import annotations

import mmap
import os
from time import monotonic_ns

CAPACITY = 1 << 19
_TOKEN = 0xDC


def shared(path: str, numbers: int) -> memoryview:
    """A new file of so many 64-bit numbers in memory."""
    file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    os.ftruncate(file, 8 * numbers)
    view = memoryview(mmap.mmap(file, 8 * numbers)).cast("Q")
    os.close(file)
    return view


def install(line: str, folder: str) -> None:
    """Put timed functions in place of ``os.read`` and ``os.write`` once ``line`` is opened."""
    read, write, opened = os.read, os.write, os.open

    def timed_open(path: str, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        fd = opened(path, flags, mode, dir_fd=dir_fd)
        if path == line:
            watch(fd)
        return fd

    def watch(line_fd: int) -> None:
        pairs = shared(os.path.join(folder, str(os.getpid())), 2 + 2 * CAPACITY)
        read_at = 0
        token = False

        def timed_read(fd: int, count: int) -> bytes:
            nonlocal read_at
            octets = read(fd, count)
            if fd == line_fd and octets:
                read_at = monotonic_ns()
            return octets

        def timed_write(fd: int, octets: bytes) -> int:
            nonlocal read_at, token
            done = write(fd, octets)
            if fd == line_fd:
                if octets[0] == _TOKEN:
                    token = True
                elif read_at:
                    now = monotonic_ns()
                    count = pairs[0]
                    place = 2 + 2 * (count % CAPACITY)
                    pairs[place] = now
                    pairs[place + 1] = (now - read_at) * 2 + token
                    pairs[0] = count + 1
                    read_at = 0
                    token = False
            return done

        vars(os).update(read=timed_read, write=timed_write)

    vars(os).update(open=timed_open)


if "BENCH_LINE" in os.environ and "BENCH_PROBE" in os.environ:
    install(os.environ["BENCH_LINE"], os.environ["BENCH_PROBE"])
