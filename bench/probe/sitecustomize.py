"""Loaded by an interpreter that has this folder on its PYTHONPATH: notes turn-arounds at one tty, in shared memory.

BENCH_LINE is the tty, BENCH_PROBE a folder. A process that opens the tty with ``os.open`` writes to BENCH_PROBE/PID:
numbers of 64 bits, a count, the time at which the tty was opened (CLOCK_MONOTONIC, ns), then pairs: the time of a write
and the turn-around before it, from the return of the last read to the return of the write, twice its value in ns, plus
1 when the token lay between. The ring has room for CAPACITY pairs.

With BENCH_STEPS it writes to BENCH_PROBE/PID.steps instead: a count, the number of places where it found dpstack's
``pump``, then for each write that follows a read, tokens left out, STEPS numbers: begin and end of the last read, begin
and end of the write, and in ns the time in ``pump`` between them, the time until the deadline that ``pump`` returned
(the idle time of the rules), and the time from that deadline to the next ``pump``. Nothing of the project is imported
here.
"""

from __future__ import annotations

import mmap
import os
import sys
from time import monotonic_ns

TYPE_CHECKING = False
if TYPE_CHECKING:  # at run time these would make the start of a program longer
    from collections.abc import Callable
    from typing import Any

CAPACITY = 1 << 19
#: numbers of a turn-around by steps, and how many turn-arounds have room
STEPS = 7
_CAPACITY_BY_STEPS = 1 << 17
_TOKEN = 0xDC
_PUMP = "dpstack.machine"


def shared(path: str, numbers: int) -> memoryview:
    """A new file of so many 64-bit numbers in memory."""
    file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    os.ftruncate(file, 8 * numbers)
    view = memoryview(mmap.mmap(file, 8 * numbers)).cast("Q")
    os.close(file)
    return view


def install(line: str, folder: str, by_steps: bool) -> None:
    """Put timed functions in place of ``os.read`` and ``os.write`` once ``line`` is opened."""
    read, write, opened = os.read, os.write, os.open

    def timed_open(path: str, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        fd = opened(path, flags, mode, dir_fd=dir_fd)
        if path == line:
            (watch_steps if by_steps else watch)(fd)
        return fd

    def watch(line_fd: int) -> None:
        pairs = shared(os.path.join(folder, str(os.getpid())), 2 + 2 * CAPACITY)
        pairs[1] = monotonic_ns()
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

    def watch_steps(line_fd: int) -> None:
        from array import array

        numbers = shared(os.path.join(folder, f"{os.getpid()}.steps"), 2 + STEPS * _CAPACITY_BY_STEPS)
        read_from = read_until = 0  # of the last octets that came; 0: none since the last write
        pump_from = 0  # while it runs
        pumping = waiting = late = 0
        idle_from = idle_until = 0  # between two calls of pump

        def timed_read(fd: int, count: int) -> bytes:
            nonlocal read_from, read_until, pumping, waiting, late, idle_until
            if fd != line_fd:
                return read(fd, count)
            begin = monotonic_ns()
            octets = read(fd, count)
            if octets:
                read_from, read_until = begin, monotonic_ns()
                pumping = waiting = late = idle_until = 0
            return octets

        def timed_write(fd: int, octets: bytes) -> int:
            nonlocal read_until
            if fd != line_fd:
                return write(fd, octets)
            begin = monotonic_ns()
            done = write(fd, octets)
            if read_until and octets[0] != _TOKEN:
                end = monotonic_ns()
                count = numbers[0]
                place = 2 + STEPS * (count % _CAPACITY_BY_STEPS)
                in_pump = pumping + (begin - pump_from if pump_from else 0)
                numbers[place : place + STEPS] = memoryview(
                    array("Q", (read_from, read_until, begin, end, in_pump, waiting, late))
                )
                numbers[0] = count + 1
            read_until = 0
            return done

        def timed(pump: Callable[..., int]) -> Callable[..., int]:
            def timed_pump(*args: Any) -> int:
                nonlocal pump_from, pumping, waiting, late, idle_from, idle_until
                pump_from = monotonic_ns()
                if idle_until:
                    waiting += max(0, min(pump_from, idle_until) - idle_from)
                    late += max(0, pump_from - max(idle_from, idle_until))
                deadline = pump(*args)
                idle_from, idle_until = monotonic_ns(), deadline
                pumping += idle_from - pump_from
                pump_from = 0
                return deadline

            return timed_pump

        machine = sys.modules.get(_PUMP)
        if machine is not None:
            pump: Callable[..., int] = vars(machine)["pump"]
            for module in list(sys.modules.values()):
                if getattr(module, "pump", None) is pump:
                    vars(module)["pump"] = timed(pump)
                    numbers[1] += 1
        vars(os).update(read=timed_read, write=timed_write)

    vars(os).update(open=timed_open)


if "BENCH_LINE" in os.environ and "BENCH_PROBE" in os.environ:
    install(os.environ["BENCH_LINE"], os.environ["BENCH_PROBE"], "BENCH_STEPS" in os.environ)
