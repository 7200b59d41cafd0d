"""Reading GSD files: a made-up set of 689 files, and the two largest kinds of file known.

The benchmark measures the CPU time from octets to model and diagnostics, in Python loops (reading the disk and
contradictory defaults are not in it).
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from typing import Final

from bench.calibration import Beside
from bench.options import count
from bench.report import Report
from dpstack.gsd.parser import parse_gsd
from tools.make_gsd_set import FILES, make_set

#: Python loops for the whole set and for one file
_SET: Final = 4_500_000
_LARGEST: Final = 270_000


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench gsd")
    parser.add_argument("--files", type=int, default=FILES)
    parser.add_argument("--rounds", type=count, default=5, help="medians are reported")
    args = parser.parse_args(argv)
    made = [octets for _, octets in make_set(args.files)]
    lines = sum(octets.count(b"\n") for octets in made)
    size = sum(map(len, made)) / 1e6
    report = Report("gsd", notes=[f"{len(made)} made-up files, {size:.1f} MB, {lines} lines"])
    beside = Beside()
    times = [beside(partial(_read_ns, made)) for _ in range(args.rounds)]
    report.in_loops(f"{len(made)} files, processor time", times, _SET * len(made) / FILES)
    report.in_loops("per line", [(ns / lines, loop) for ns, loop in times])
    for title, octets in zip(("1295 modules", "679 ExtUserPrmData and 137 PrmText"), made, strict=False):
        times = [beside(partial(_read_ns, [octets])) for _ in range(3 * args.rounds)]
        report.in_loops(f"{title}, processor time", times, _LARGEST)
    report.calibrated("Python", beside.loops)
    seen = sum(_repeated(octets) for octets in made) / lines
    report.notes.append(f"{seen:.0%} of the lines stand in their file more than once; these are read faster")
    return report


def _read_ns(files: list[bytes]) -> float:
    begin = time.process_time_ns()
    for octets in files:
        parse_gsd(octets)
    return time.process_time_ns() - begin


def _repeated(octets: bytes) -> int:
    lines = octets.splitlines()
    return len(lines) - len(set(lines))
