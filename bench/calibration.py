"""The two units of durations: a write and read on a pipe (the kernel's speed) and a loop of Python (the interpreter's).

The two vary apart from each other, from day to day and from minute to minute. CPU-bound figures are given in Python
loops, figures that are made of system calls and wake-ups in pipe loops, both of the same round. Changing either loop
makes every stored figure and every goal void.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from statistics import median
from typing import Final, NamedTuple, TypeVar

#: units of figures
PYTHON: Final = "Python loops"
PIPE: Final = "pipe loops"

_OCTETS: Final = bytes(17)
_T = TypeVar("_T")


class Speeds(NamedTuple):
    """Nanoseconds per loop: ``python`` in CPU time, ``pipe`` by the clock."""

    python: float
    pipe: float


def calibrate(rounds: int = 15, loops: int = 2_000) -> float:
    """Nanoseconds per write and read of 17 octets on an ``os.pipe``: the median of ``rounds`` of ``loops`` each."""
    reader, writer = os.pipe()
    read, write, clock = os.read, os.write, time.perf_counter_ns
    results = []
    try:
        for _ in range(rounds):
            begin = clock()
            for _ in range(loops):
                write(writer, _OCTETS)
                read(reader, 64)
            results.append((clock() - begin) / loops)
    finally:
        os.close(reader)
        os.close(writer)
    return median(results)


class _Station:
    """Work of the Python loop: calls, attributes, a dict, bytes made, summed up and compared."""

    __slots__ = ("changes", "data", "frames", "total")

    def __init__(self) -> None:
        self.changes = 0
        self.total = 0
        self.data = bytes(range(12))
        self.frames: dict[int, bytes] = {}

    def step(self, number: int) -> None:
        address = number & 0x3F
        frame = self.frame(address, number & 0xFF)
        if self.frames.get(address) != frame:
            self.frames[address] = frame
            self.changes += 1
        self.total += frame[-2]

    def frame(self, address: int, number: int) -> bytes:
        """An SD2 telegram."""
        body = bytes((address, 2, number)) + self.data
        return b"\x68\x0f\x0f\x68" + body + bytes((sum(body) & 0xFF, 0x16))


def calibrate_python(rounds: int = 5, loops: int = 4_000, clock: Callable[[], int] = time.process_time_ns) -> float:
    """Nanoseconds of CPU time per Python loop: the median of ``rounds`` of ``loops`` each."""
    results = []
    for _ in range(rounds):
        step = _Station().step
        begin = clock()
        for number in range(loops):
            step(number)
        results.append((clock() - begin) / loops)
    return median(results)


class Beside:
    """Measures work with the Python loop before and after it, as a computer's speed may double between two rounds."""

    def __init__(self, calibrate: Callable[[], float] = calibrate_python) -> None:
        self._calibrate = calibrate
        self._before = calibrate()
        #: every calibration, in ns
        self.loops = [self._before]

    def __call__(self, work: Callable[[], _T]) -> tuple[_T, float]:
        """The result of ``work``, and the Python loop beside it in ns."""
        result = work()
        before, self._before = self._before, self._calibrate()
        self.loops.append(self._before)
        return result, (before + self._before) / 2


def wake_up_ns(rounds: int = 200) -> float:
    """CPU time of one sleep of 0.3 ms in ns, with the system call and what the processor does until the program runs:
    the median of ``rounds``."""
    clock = time.thread_time_ns
    took = []
    for _ in range(rounds):
        begin = clock()
        time.sleep(0.0003)
        took.append(clock() - begin)
    return median(took)


def speeds(rounds: int = 15) -> Speeds:
    return Speeds(calibrate_python(rounds), calibrate(rounds))
