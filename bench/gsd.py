"""Reading GSD files: a made-up set of 689 files, and the two largest kinds of file known.

What is measured is octets to model and diagnostics (reading the disk and contradictory defaults are not in it).
Durations are wall and processor time, best of several rounds; other programs on the machine make both worse.
"""

from __future__ import annotations

import argparse
import time
from typing import Final

from bench.report import Report
from dpstack.gsd.parser import parse_gsd
from tools.make_gsd_set import FILES, make_set

#: seconds for the whole set, milliseconds for one file
_SET: Final = 2.5
_LARGEST: Final = 150.0


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench gsd")
    parser.add_argument("--files", type=int, default=FILES)
    parser.add_argument("--rounds", type=int, default=5, help="the best one is reported")
    args = parser.parse_args(argv)
    made = [octets for _, octets in make_set(args.files)]
    lines = sum(octets.count(b"\n") for octets in made)
    size = sum(map(len, made)) / 1e6
    report = Report("gsd", notes=[f"{len(made)} made-up files, {size:.1f} MB, {lines} lines"])
    walls, processors = _rounds(made, args.rounds, 1.0)
    report.add(f"{len(made)} files", min(walls), "s", _SET * len(made) / FILES, rounds=walls)
    report.add(f"{len(made)} files, processor time", min(processors), "s", rounds=processors)
    report.add("per line", min(walls) / lines * 1e6, "us", rounds=[wall / lines * 1e6 for wall in walls])
    for title, octets in zip(("1295 modules", "679 ExtUserPrmData and 137 PrmText"), made, strict=False):
        walls, processors = _rounds([octets], 3 * args.rounds, 1e3)
        report.add(title, min(walls), "ms", _LARGEST, rounds=walls)
        report.add(f"{title}, processor time", min(processors), "ms", rounds=processors)
    seen = sum(_repeated(octets) for octets in made) / lines
    report.notes.append(f"{seen:.0%} of the lines stand in their file more than once; these are read faster")
    return report


def _rounds(files: list[bytes], rounds: int, per_second: float) -> tuple[list[float], list[float]]:
    """(wall, processor time) of every round, ``per_second`` being the unit."""
    walls, processors = [], []
    for _ in range(rounds):
        wall, processor = time.perf_counter(), time.process_time()
        for octets in files:
            parse_gsd(octets)
        walls.append((time.perf_counter() - wall) * per_second)
        processors.append((time.process_time() - processor) * per_second)
    return walls, processors


def _repeated(octets: bytes) -> int:
    lines = octets.splitlines()
    return len(lines) - len(set(lines))
