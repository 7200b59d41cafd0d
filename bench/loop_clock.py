"""A CPU clock that counts Python loops; ``PYTHON -P bench/loop_clock.py NAME ...`` runs ``-m bench NAME ...`` on it.

A computer may change its speed by half several times a second, as when a neighbour takes the other half of a processor,
and benchmarks of old commits do not calibrate themselves. On this clock a nanosecond is a thousandth of a Python loop
at the speed of the moment: it runs the loop whenever it is read. Works for what a benchmark measures with
``time.process_time`` or ``process_time_ns`` in its own process.
"""

from __future__ import annotations

import contextlib
import importlib
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


class LoopClock:
    """Called, it gives thousandths of Python loops. ``clock`` and ``calibrate`` are in ns."""

    def __init__(
        self,
        clock: Callable[[], int] = time.process_time_ns,
        calibrate: Callable[[], float] = lambda: _calibrate(3, 3_000),
    ) -> None:
        self._clock = clock
        self._calibrate = calibrate
        self._loops = 0.0
        self._loop = calibrate()
        self._since = clock()

    def __call__(self) -> int:
        """The time now; it takes a calibration."""
        spent = self._clock() - self._since
        before, self._loop = self._loop, self._calibrate()
        self._loops += 2 * spent / (before + self._loop)
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
