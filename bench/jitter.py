"""Lateness of the rounds of a fixed cycle, beside a program that is idle, blocks for 50 ms, or burns CPU.

The wire notes when the first Data_Exchange of every round arrives, and the master tells a due time of its grid (both
CLOCK_MONOTONIC). Lateness is how far a round lies behind its due time; due times without a round are counted as missed.
*Gaps* are pauses of 40 ms and more on
the bus: the kernel takes the processor from real-time processes for about 50 ms in every second when they use more than
sched_rt_runtime_us, and it shows as one gap a second.

The verdicts on the process driver are ratios: its late and missed rounds, by its own books, to those of two loops on
the same grid with the same settings (bench/grid_loop.py), in the same interleaved rounds. The bare loop only sleeps.
The exchanging loop also exchanges data on a wire of its own after each wake-up: its rounds are made late by the pty and
the other end of the line, too, so that the difference to it is the bus process alone. ``--settings`` measures the
settings instead: the bus process with all of them, with none, with all but one, and with one alone.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from statistics import median
from typing import Final, NamedTuple

from bench.machine import realtime
from bench.masters import APPLICATIONS, DRIVERS, FIRST, GRID_KIND, NO_PORT, Line
from bench.options import count, duration, slaves
from bench.records import Record
from bench.report import Report, Table, quantile
from bench.rig import Process, Processors, Taken, available, bench, note_disturbance, pinned, wire_with
from bench.settings import SETTINGS, environment
from dpstack.dp.master.fixed_cycle import tolerance_ns

_GAP_NS: Final = 40_000_000
_QUANTILES: Final = (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999), ("max", 1.0))
_SETTLE_S: Final = 0.2
#: late and missed rounds of the bus process to those of a bare loop
_GOAL_RATIO: Final = 1.5
#: no verdict where the rounds of the bare loop itself differ by more than this share of their median
_STEADY: Final = 0.3
#: of the applications, those beside which the bus process is compared with the loop, and the settings are measured
_COMPARED: Final = ("idle", "burn")


class Cycles(NamedTuple):
    """Places of a grid: rounds that began, of these later than a tenth of the cycle, and places without a round.

    ``overrun``: those of the late ones and of the places without a round that came after a round that was not over in
    time. A bare loop has none; on a pty the other end and workers of the kernel make a round long.
    """

    begun: int
    late: int
    left_out: int
    overrun: int = 0

    @property
    def overrun_percent(self) -> float:
        """After a long round, of all places, in percent."""
        return 100 * self.overrun / max(self.begun + self.left_out, 1)

    @property
    def percent(self) -> float:
        """Late and missed rounds of all places, in percent."""
        return 100 * (self.late + self.left_out) / max(self.begun + self.left_out, 1)


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench jitter")
    parser.add_argument("--cycles", type=duration, nargs="*", default=[2.0, 10.0], help="in ms")
    parser.add_argument("--slaves", type=slaves, default=3, help="default: %(default)s")
    parser.add_argument("--baud", type=int, default=1_500_000, help="in bit/s (default: %(default)s)")
    parser.add_argument("--seconds", type=duration, default=5.0, help="of one measurement")
    parser.add_argument("--rounds", type=count, default=3, help="of all cases in turn (default: %(default)s)")
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS, help="drivers (default: all)")
    parser.add_argument("--apps", nargs="*", choices=APPLICATIONS, default=APPLICATIONS, help="default: all")
    parser.add_argument(
        "--settings", action="store_true", help="each setting of the bus process alone on and alone off"
    )
    args = parser.parse_args(argv)
    report = Report("jitter")
    with pinned() as where:
        rights = realtime()
        report.notes.append(where.text)
        report.notes.append(f"real-time share: {rights['runtime_us']} of every {rights['period_us']} us")
        measure = _settings if args.settings else _drivers
        measure(report, args, where)
    return report


def _drivers(report: Report, args: argparse.Namespace, where: Processors) -> None:
    kinds = available(args.kinds, report.notes, max(args.cycles))
    cases = [(kind, cycle, app) for kind in kinds for cycle in args.cycles for app in args.apps]
    alone: list[Taken] = []  # a burning program stands in its own bus process's way
    runs: dict[tuple[str, float, str], list[Lateness]] = {case: [] for case in cases}
    beside: dict[tuple[float, str], list[Beside]] = {}
    for _ in range(args.rounds):
        for (kind, cycle, app), rounds in runs.items():
            with bench(kind, args.slaves, args.baud, where, cycle_ms=cycle, more=["--app", app]) as running:
                taken = running.measure(args.seconds)
                of_bus = Cycles(*running.cycles(args.seconds)) if kind == "process" and app in _COMPARED else None
            rounds.append(Lateness(taken.records, cycle, taken.due))
            if app != "burn":
                alone.append(taken)
            if of_bus is not None:
                woke = _wake_ups_of_a_bare_loop(args.seconds, cycle, app, where)
                with wire_with(args.slaves, args.baud, where.wire, paced=True) as (_, port):
                    line = Line(port, args.baud, args.slaves)
                    exchanged = _wake_ups_of_a_bare_loop(args.seconds, cycle, app, where, line=line)
                three = Beside(of_bus, cycles_of(woke, cycle), cycles_of(exchanged, cycle))
                beside.setdefault((cycle, app), []).append(three)
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
    for (cycle, app), of_rounds in beside.items():
        compare_with_loops(report, f"{cycle:g} ms, {app}", of_rounds)


# --- beside a bare loop ---


class Beside(NamedTuple):
    """The places of the bus process, of the loop that only sleeps and of the one that exchanges data, in one round."""

    bus: Cycles
    sleeping: Cycles
    exchanging: Cycles


def _wake_ups_of_a_bare_loop(
    seconds: float,
    cycle_ms: float,
    app: str,
    where: Processors,
    env: dict[str, str] | None = None,
    line: Line | None = None,
) -> list[tuple[int, int]]:
    """When a bare loop beside the same application was due, and when it woke up, for ``seconds``; in ns. With ``line``
    it exchanges data there after each wake-up.

    Raises RuntimeError when it does not start.
    """
    port, baud, slaves = line or Line(NO_PORT, 0, 0)
    words = [sys.executable, "-m", "bench.masters", GRID_KIND, port, "--baud", str(baud), "--slaves", str(slaves)]
    words += ["--app", app]
    process = Process([*words, "--cycle-ms", str(cycle_ms)], where.master, env)
    try:
        if "ready" not in process.line():
            raise RuntimeError("the bare loop did not start")
        time.sleep(2 * _SETTLE_S)  # its interpreter starts beside the application
        since = time.monotonic_ns()
        time.sleep(seconds)
        until = time.monotonic_ns()
    finally:
        told = process.end()
    woke = [pair for found in told for pair in _pairs(found.get("woke"))]
    return [(due, now) for due, now in woke if since <= due < until]


def _pairs(found: object) -> Iterator[tuple[int, int]]:
    for due, now in found if isinstance(found, list) else ():
        yield int(due), int(now)


def cycles_of(woke: Sequence[tuple[int, int]], cycle_ms: float) -> Cycles:
    """The places of the grid from wake-ups: when each was due and when it was, in ns."""
    cycle_ns = round(cycle_ms * 1e6)
    late = sum(now - due > tolerance_ns(cycle_ns) for due, now in woke)
    places = (woke[-1][0] - woke[0][0]) // cycle_ns + 1 if woke else 0
    return Cycles(len(woke), late, places - len(woke))


def compare_with_loops(report: Report, title: str, rounds: Sequence[Beside]) -> None:
    """Late and missed rounds of the bus process and of both loops, all in the same rounds; verdicts on the ratios."""
    bus = [each.bus.percent for each in rounds]
    report.measured(f"process, {title}: late and missed rounds", bus, "%")
    overruns = [each.bus.overrun_percent for each in rounds]
    report.measured(f"process, {title}: of these after a round that was not over in time", overruns, "%")
    for name, loops in (("bare", [r.sleeping for r in rounds]), ("exchanging", [r.exchanging for r in rounds])):
        _compare_with_loop(report, title, name, bus, loops)


def _compare_with_loop(report: Report, title: str, name: str, bus: Sequence[float], loops: Sequence[Cycles]) -> None:
    """``bus``: late and missed rounds in percent.

    One round more or less is chance. So a loop that was never late in a round counts as late once, and the rounds of
    the loop differ by that which is left when the greatest count is one less and the least one more. Where that is too
    much, no goal is judged.
    """
    loop = [each.percent for each in loops]
    report.measured(f"{name} loop, {title}: late and missed rounds", loop, "%")
    once = [100 / max(each.begun + each.left_out, 1) for each in loops]
    counted = list(map(max, loop, once))
    spread = max(0.0, max(loop) - min(loop) - 2 * median(once)) / median(counted)
    goal = _GOAL_RATIO if spread <= _STEADY else None
    figure = f"process, {title}: late and missed rounds to those of {'an' if name == 'exchanging' else 'a'} {name} loop"
    ratios = [ours / theirs for ours, theirs in zip(bus, counted, strict=True)]
    report.add(figure, sum(bus) / sum(counted), "ratio", goal, rounds=ratios)
    if goal is None:
        report.notes.append(f"{figure}: no verdict, the rounds of this loop differ by {spread:.0%}")


# --- the settings ---


def variants() -> dict[str, tuple[str, ...]]:
    """Sets of settings by name, and the settings that each does without."""
    found: dict[str, tuple[str, ...]] = {"all": ()}
    found |= {f"without {name}": (name,) for name in SETTINGS}
    found["none"] = SETTINGS
    return found | {f"only {name}": tuple(other for other in SETTINGS if other != name) for name in SETTINGS}


def _settings(report: Report, args: argparse.Namespace, where: Processors) -> None:
    """The process driver, and a bare loop, with each set of settings in turn, all within each round."""
    if not available(("process",), report.notes, max(args.cycles)):
        return
    apps = [app for app in args.apps if app in _COMPARED]
    for cycle in args.cycles:
        seen: dict[tuple[str, str, str], list[float]] = {}
        for _ in range(args.rounds):
            for app in apps:
                for name, without in variants().items():
                    env = environment(without)
                    with bench(
                        "process", args.slaves, args.baud, where, cycle_ms=cycle, env=env, more=["--app", app]
                    ) as running:
                        cycles = Cycles(*running.cycles(args.seconds))
                        taken = running.measure(args.seconds)
                        lateness = Lateness(taken.records, cycle, taken.due)
                    woke = _wake_ups_of_a_bare_loop(args.seconds, cycle, app, where, env)
                    late_us = [(now - due) / 1000 for due, now in woke]
                    for column, value in (
                        ("late and missed %", cycles.percent),
                        ("p50 us", lateness.quantile_us(0.5)),
                        ("p99 us", lateness.quantile_us(0.99)),
                        ("bare loop %", cycles_of(woke, cycle).percent),
                        ("its p50 us", quantile(late_us, 0.5)),
                        ("its p99 us", quantile(late_us, 0.99)),
                    ):
                        seen.setdefault((app, name, column), []).append(value)
        columns = tuple(dict.fromkeys(column for _, _, column in seen))
        for app in apps:
            table = Table(f"settings, {cycle:g} ms, {app}", columns, tuple(variants()))
            report.tables.append(table)
            for name in variants():
                for column in columns:
                    report.measured(table.name(name, column), seen[app, name, column], column.rpartition(" ")[2])


class Lateness:
    """Of the rounds in ``records`` in a cycle of ``cycle_ms``; ``due``: the due time of any round, in ns.

    Raises RuntimeError with fewer than two rounds.
    """

    def __init__(self, records: Sequence[Record], cycle_ms: float, due: int) -> None:
        cycle = cycle_ms * 1e6
        begins = [r.read for r in records if r.exchange and r.to == FIRST]
        if len(begins) < 2:
            raise RuntimeError("not two rounds were seen: take more seconds, or a longer cycle")
        # the wire may read a request before the write has returned to the master, which takes the time then
        early = tolerance_ns(round(cycle))
        places = [int((begin - due + early) // cycle) for begin in begins]
        for n in range(len(places) - 2, -1, -1):  # two rounds at one place: the former is more than a cycle late
            places[n] = min(places[n], places[n + 1] - 1)
        self.late = [begin - due - place * cycle for begin, place in zip(begins, places, strict=True)]
        self.missed = places[-1] - places[0] + 1 - len(places)
        self.gaps = sum(b.read - a.read >= _GAP_NS for a, b in pairwise(records))
        self.seconds = (records[-1].read - records[0].read) / 1e9

    def quantile_us(self, q: float) -> float:
        """Lateness in us."""
        return quantile(self.late, q) / 1000


def _add(report: Report, title: str, rounds: Sequence[Lateness], kind: str) -> None:
    for name, q in _QUANTILES:
        report.measured(f"{title}: lateness {name}", [r.quantile_us(q) for r in rounds], "us")
    report.measured(f"{title}: missed rounds", [float(r.missed) for r in rounds], "")
    goal = 0.0 if kind == "process" else None
    report.measured(f"{title}: gaps a second", [r.gaps / max(r.seconds, 1e-3) for r in rounds], "1/s", goal)
