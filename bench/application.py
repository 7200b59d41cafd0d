"""An application in virtual time: a control loop by cycle over two drives and an I/O station at 1.5 Mbit/s, as a test
of the kit runs it.

``PYTHON bench/application.py`` measures the commit of its environment: a pytest of :func:`test_control`, which uses
what all commits have. It prints one JSON object, name of the figure -> CPU time of a cycle in Python loops, without the
start of Python and pytest.
"""

from __future__ import annotations

import argparse
import json
import os
import runpy
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from bench.report import Report

FIGURE: Final = "application in virtual time, two drives and an I/O station at 1.5 Mbit/s: CPU time of a cycle"
_SLAVES: Final = (
    {"name": "hoist", "address": 3, "drive": "demag-dedrive", "telegram": "PPO1"},
    {"name": "fan", "address": 4, "drive": "ls-s100"},
    {
        "name": "io",
        "address": 8,
        "ident": 0x1234,
        "config": "21 11",
        "inputs": {"level": "u16@0"},
        "outputs": {"valve": "u16@0"},
    },
)
#: cycles of a piece of work, and pieces: some 4 s of plant
_CYCLES, _PIECES = 500, 8


async def control(bus: Any, cycles: int) -> list[str]:
    """The service: valve by level, set points in each cycle, a line of its journal every 100 cycles."""
    hoist, fan, io = bus.drive("hoist"), bus.drive("fan"), bus.slave("io")
    lines: list[str] = []
    done = 0
    async for cycle in bus.cycles():
        level = int(cycle["io"]["level"])
        io["valve"] = (level + 1) & 0xFFFF if done % 10 == 0 else level
        fan.speed = 0.5
        hoist.speed = 0.0
        if done % 100 == 0:
            lines.append(json.dumps({"cycle": cycle.number, "level": level, "fan": str(fan.status)}))
        done += 1
        if done == cycles:
            break
    return lines


def test_control(dpstack_bus: Any) -> None:
    """The program, and all that the kit keeps and judges of it, is measured."""
    clock = runpy.run_path(str(Path(__file__).with_name("loop_clock.py")))["LoopClock"]()
    bus = dpstack_bus(slaves=[dict(one) for one in _SLAVES], baud=1_500_000)
    bus.run(bus.drive("fan").start())
    bus.run(control(bus.master, _CYCLES))
    loops = []
    for _ in range(_PIECES):
        begin = clock()
        assert len(bus.run(control(bus.master, _CYCLES))) == _CYCLES // 100
        bus.wire.assert_exchanged("io")
        loops.append((clock() - begin) / 1000 / _CYCLES)
    bus.run(bus.drive("fan").stop())
    bus.wire.assert_last_outputs_safe("fan")
    Path(os.environ["BENCH_RESULT"]).write_text(json.dumps(loops), encoding="ascii")


def measure() -> list[float]:
    """The pieces of one run of the test in this environment. Raises RuntimeError when it fails."""
    words = [sys.executable, "-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull]
    with tempfile.NamedTemporaryFile("r", encoding="ascii") as result:
        ended = subprocess.run(
            [*words, "--import-mode=importlib", __file__],
            env={**os.environ, "BENCH_RESULT": result.name},
            close_fds=False,  # the gate of bench/loop_clock.py
            capture_output=True,
            text=True,
        )
        if ended.returncode:
            raise RuntimeError(f"the test failed: {ended.stdout.strip()[-400:]}")
        found: list[float] = json.load(result)
    return found


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    from bench.calibration import PYTHON
    from bench.options import count
    from bench.report import Report

    parser = argparse.ArgumentParser(prog="python -m bench application")
    parser.add_argument("--rounds", type=count, default=3)
    args = parser.parse_args(argv)
    report = Report("application")
    report.measured(FIGURE, [loops for _ in range(args.rounds) for loops in measure()], PYTHON)
    return report


if __name__ == "__main__":
    from statistics import median

    print(json.dumps({FIGURE: median(measure())}))
