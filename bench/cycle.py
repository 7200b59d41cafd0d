"""Turn-around, CPU time and whole exchanges at 12 Mbit/s parameters over a pty, which gives octets no time.

Turn-around is from the return of the read with an answer's last octet to the return of the write of the next request,
with every rule of the standard in force, T_ID1 among them; it is taken inside the master's process. Once a round the
token to itself lies between, with a T_ID1 of its own: those turn-arounds are reported apart (with one slave there are
no others). Whole exchanges are counted by the other end, a table of octets in a process of its own, beside a bare loop
and pyprofibus there. Turn-arounds are given in pipe loops of the same round, CPU times in Python loops run directly
before and after each measurement.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Final

from bench.calibration import PIPE, calibrate
from bench.masters import DRIVERS, KINDS
from bench.options import count, duration, slaves
from bench.report import Report, quantile
from bench.rig import NO_GAP, Processors, Taken, available, bench, note_disturbance, one_round, pinned
from dpstack.params import BusParams

_BAUD: Final = 12_000_000
#: turn-around in pipe loops
_GOALS: Final = {"asyncio": 30.0, "process": 18.0}
#: with so many slaves whole exchanges shall be faster than pyprofibus's, and CPU time is judged
_GOAL_SLAVES: Final = 16
#: CPU time per exchange in Python loops
_CPU_GOALS: Final = {"asyncio": 100.0, "process": 120.0}


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench cycle")
    parser.add_argument("--slaves", type=slaves, nargs="*", default=[1, 4, 16, 64])
    parser.add_argument("--seconds", type=duration, default=0.7, help="of one measurement")
    parser.add_argument("--rounds", type=count, default=9, help="of all kinds in turn; medians are reported")
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=KINDS)
    args = parser.parse_args(argv)
    report = Report("cycle")
    with pinned() as where:
        report.notes.append(where.text)
        kinds = available(args.kinds, report.notes)
        loops: list[float] = []
        taken: dict[tuple[str, int], list[Taken]] = {(kind, n): [] for n in args.slaves for kind in kinds}
        for _ in range(args.rounds):
            loops.append(calibrate())
            one_round(taken, lambda kind, n: _measure(kind, n, args.seconds, where), report.notes)
        report.calibrated("Python", [t.python_loop for rounds in taken.values() for t in rounds])
        report.calibrated("pipe", loops)
        for (kind, n), rounds in taken.items():
            _add(report, kind, n, rounds, loops)
        for n in args.slaves:
            _compared(report, n, {kind: taken[kind, n] for kind in kinds if (kind, n) in taken})
        note_disturbance(report, (t for rounds in taken.values() for t in rounds))
        idle = BusParams.preset(_BAUD).t_id1
        report.notes.append(f"T_ID1 = {idle} bit times = {idle / 12:.1f} us is part of every turn-around")
    return report


def _measure(kind: str, slaves: int, seconds: float, where: Processors) -> Taken:
    with bench(kind, slaves, _BAUD, where, paced=False, probe=kind in DRIVERS, more=NO_GAP) as running:
        return running.measure(seconds)


def _add(report: Report, kind: str, slaves: int, rounds: Sequence[Taken], loops: Sequence[float]) -> None:
    title = f"{kind}, {slaves} slave{'s' if slaves > 1 else ''}"
    pairs = list(zip(rounds, loops, strict=True))
    # with one slave only those before a Global_Control are left: too few, and another thing
    plain = [(t.turns, loop) for t, loop in pairs if len(t.turns) > len(t.token_turns) // 2]
    token = [(t.token_turns, loop) for t, loop in pairs if t.token_turns]
    if kind in DRIVERS:
        for name, q, taken, goal in (
            ("turn-around p50", 0.5, plain, _GOALS[kind]),
            ("turn-around p99", 0.99, plain, None),
            ("with the token to itself between p50", 0.5, token, None),
        ):
            times = [(float(quantile(turns, q)), loop) for turns, loop in taken]
            report.in_loops(f"{title}: {name}", times, goal, unit=PIPE)
    goal = _CPU_GOALS.get(kind) if slaves == _GOAL_SLAVES else None
    report.in_loops(f"{title}: CPU time per exchange", [t.cpu_per_exchange for t in rounds], goal)
    report.measured(f"{title}: exchanges per second", [t.exchanges / t.seconds for t in rounds], "1/s", more=True)


def _compared(report: Report, slaves: int, taken: dict[str, list[Taken]]) -> None:
    """Exchanges per second of the drivers as multiples of the others', round by round."""
    for other in ("pyprofibus", "bare"):
        for kind in DRIVERS:
            if kind in taken and other in taken:
                ratios = [
                    (ours.exchanges / ours.seconds) / max(theirs.exchanges / theirs.seconds, 1)
                    for ours, theirs in zip(taken[kind], taken[other], strict=True)
                ]
                goal = 1.0 if other == "pyprofibus" and slaves == _GOAL_SLAVES else None
                name = "a bare loop" if other == "bare" else other
                title = f"{kind}, {slaves} slave{'s' if slaves > 1 else ''}: exchanges per second to {name}'s"
                report.measured(title, ratios, "ratio", goal, more=True)
