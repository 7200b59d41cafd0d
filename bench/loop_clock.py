"""A CPU clock that counts Python loops; ``PYTHON -P bench/loop_clock.py NAME ...`` runs ``-m bench NAME ...`` on it.

A computer may change its speed by half several times a second, as when a neighbour takes the other half of a processor,
and benchmarks of old commits do not calibrate themselves. On this clock a nanosecond is a thousandth of a Python loop
at the speed of the moment: it runs the loop whenever it is read. Works for what a benchmark measures with
``time.process_time`` or ``process_time_ns`` in its own process, read before and after each piece of work.

Two processes can measure their pieces in turn: with BENCH_GATE=GO,READY (file descriptors) a process writes an octet to
READY before each piece and waits for one from GO.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import runpy
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

#: of this folder, not of the commit's bench
_calibrate: Final[Callable[..., float]] = runpy.run_path(str(Path(__file__).with_name("calibration.py")))[
    "calibrate_python"
]
_SCALE: Final = 1000


def gate() -> None:
    """Wait for this process's turn, if it has to."""
    if "BENCH_GATE" in os.environ:
        go, ready = map(int, os.environ["BENCH_GATE"].split(","))
        os.write(ready, b"r")
        os.read(go, 1)


class LoopClock:
    """Called before and after a piece of work, it gives thousandths of Python loops.

    ``clock`` and ``calibrate`` are in ns; ``wait`` is called before each piece.
    """

    def __init__(
        self,
        clock: Callable[[], int] = time.process_time_ns,
        calibrate: Callable[[], float] = lambda: _calibrate(3, 3_000),
        wait: Callable[[], None] = gate,
    ) -> None:
        self._clock = clock
        self._calibrate = calibrate
        self._wait = wait
        self._loops = 0.0
        self._loop = self._since = 0.0
        self._works = False

    def __call__(self) -> int:
        """The time now; it takes a calibration."""
        spent = self._clock() - self._since
        if self._works:
            self._loops += 2 * spent / (self._loop + self._calibrate())
        else:
            self._wait()
            self._loop = self._calibrate()
        self._works = not self._works
        self._since = self._clock()
        return round(self._loops * _SCALE)


def main() -> None:
    """The script: the commit's bench is found in the current directory."""
    sys.path.insert(0, "")
    with contextlib.suppress(ImportError):
        importlib.import_module("bench.calibration")  # its own calibration keeps the true clock
    clock = LoopClock()
    vars(time).update(process_time_ns=clock, process_time=lambda: clock() / 1e9)
    sys.argv = ["bench", *sys.argv[1:]]
    runpy.run_module("bench", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
