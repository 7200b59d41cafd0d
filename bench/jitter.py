"""Lateness of the rounds of a fixed cycle, beside a program that is idle, blocks for 50 ms, or burns CPU.

The wire notes when the first Data_Exchange of every round arrives. The grid of the rounds is found from them: no round
begins before its place, so the grid stands behind the longest stretch of the cycle in which none began. Lateness is how
far a round lies behind its place; places without a round are counted as missed. *Gaps* are pauses of 40 ms and more on
the bus: the kernel takes the processor from real-time processes for about 50 ms in every second when they use more than
sched_rt_runtime_us, and it shows as one gap a second.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from bench.machine import realtime
from bench.masters import APPLICATIONS, DRIVERS, FIRST
from bench.records import Record
from bench.report import Report, quantile
from bench.rig import Taken, available, bench, note_disturbance, pinned

_GAP_NS: Final = 40_000_000
_QUANTILES: Final = (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999), ("max", 1.0))


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench jitter")
    parser.add_argument("--cycles", type=float, nargs="*", default=[2.0, 10.0], help="in ms")
    parser.add_argument("--slaves", type=int, default=3)
    parser.add_argument("--baud", type=int, default=1_500_000)
    parser.add_argument("--seconds", type=float, default=5.0, help="of one measurement")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS)
    parser.add_argument("--apps", nargs="*", choices=APPLICATIONS, default=APPLICATIONS)
    args = parser.parse_args(argv)
    report = Report("jitter")
    with pinned() as where:
        rights = realtime()
        report.notes.append(where.text)
        report.notes.append(f"real-time share: {rights['runtime_us']} of every {rights['period_us']} us")
        kinds = available(args.kinds, report.notes, max(args.cycles))
        cases = [(kind, cycle, app) for kind in kinds for cycle in args.cycles for app in args.apps]
        alone: list[Taken] = []  # a burning program stands in its own bus process's way
        runs: dict[tuple[str, float, str], list[Lateness]] = {case: [] for case in cases}
        for _ in range(args.rounds):
            for (kind, cycle, app), rounds in runs.items():
                with bench(kind, args.slaves, args.baud, where, app=app, cycle_ms=cycle) as running:
                    taken = running.measure(args.seconds)
                rounds.append(Lateness(taken.records, cycle))
                if app != "burn":
                    alone.append(taken)
        note_disturbance(report, alone)
        for (kind, cycle, app), rounds in runs.items():
            _add(report, f"{kind}, {cycle:g} ms, {app}", rounds, kind)
        for kind in kinds:
            for cycle in args.cycles:
                if {"burn", "idle"} <= set(args.apps):
                    busy, idle = ([r.quantile_us(0.999) for r in runs[kind, cycle, app]] for app in ("burn", "idle"))
                    ratios = [b / max(i, 1e-3) for b, i in zip(busy, idle, strict=True)]
                    goal = 2.0 if kind == "process" else None
                    report.measured(f"{kind}, {cycle:g} ms: lateness p99.9, burn to idle", ratios, "ratio", goal)
    return report


class Lateness:
    """Of the rounds in ``records`` in a cycle of ``cycle_ms``. Raises RuntimeError with fewer than two rounds."""

    def __init__(self, records: Sequence[Record], cycle_ms: float) -> None:
        cycle = cycle_ms * 1e6
        begins = [r.read for r in records if r.exchange and r.to == FIRST]
        if len(begins) < 2:
            raise RuntimeError("not two rounds were seen: take more seconds, or a longer cycle")
        anchor = _phase(begins, cycle)
        places = [int((begin - anchor) // cycle) for begin in begins]
        for n in range(len(places) - 2, -1, -1):  # two rounds at one place: the former is more than a cycle late
            places[n] = min(places[n], places[n + 1] - 1)
        self.late = [begin - anchor - place * cycle for begin, place in zip(begins, places, strict=True)]
        self.missed = places[-1] - places[0] + 1 - len(places)
        self.gaps = sum(b.read - a.read >= _GAP_NS for a, b in pairwise(records))
        self.seconds = (records[-1].read - records[0].read) / 1e9

    def quantile_us(self, q: float) -> float:
        """Lateness in us."""
        return quantile(self.late, q) / 1000


def _phase(begins: Sequence[int], cycle: float) -> float:
    """Where the grid of the rounds stands: behind the longest stretch of the cycle in which no round began."""
    first = begins[0]
    residues = sorted({(begin - first) % cycle for begin in begins})
    gaps = [b - a for a, b in pairwise([*residues, residues[0] + cycle])]
    after = (gaps.index(max(gaps)) + 1) % len(residues)
    return first + residues[after] - cycle * (residues[after] > 0)


def _add(report: Report, title: str, rounds: Sequence[Lateness], kind: str) -> None:
    for name, q in _QUANTILES:
        report.measured(f"{title}: lateness {name}", [r.quantile_us(q) for r in rounds], "us")
    report.measured(f"{title}: missed rounds", [float(r.missed) for r in rounds], "")
    goal = 0.0 if kind == "process" else None
    report.measured(f"{title}: gaps a second", [r.gaps / max(r.seconds, 1e-3) for r in rounds], "1/s", goal)
