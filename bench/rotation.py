"""The bus rotation time on a wire that takes its time, beside the time on the wire by the rules; CPU time there.

Efficiency is the time on the wire of what was sent in a rotation (11 bits an octet, min T_SDR before each answer, T_ID1
before each telegram) divided by the rotation as the wire saw it: first Data_Exchange of a round to that of the next.
Ten slaves with 12 octets each way, as a drive with PPO1; the GAP is off, rotations with a service are left out.

A bare loop on the same wire in the same rounds loses what every program loses here: two ways over the pty and the
waking of a process, which no stack can avoid and no real UART has. So the goals are ratios to its efficiency, judged
only where the loop itself keeps the wire busy for half of the time. Its time from an answer's last octet to its next
request, without T_ID1, is the pty's own share; the efficiency without that share is given beside the efficiency as
measured. The wire's own lateness is in all of them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Final

from bench.calibration import wake_up_ns
from bench.masters import BARE, DRIVERS
from bench.options import count, duration, slaves
from bench.records import middle, pty_share, rotations
from bench.report import Report, quantile
from bench.rig import NO_GAP, Processors, Taken, available, bench, cpu_to_bare, note_disturbance, one_round, pinned
from dpstack.params import BusParams
from dpstack.units import baud_text

_BAUDS: Final = (187_500, 500_000, 1_500_000, 3_000_000, 12_000_000)
#: efficiency of both drivers to the bare loop's, with ten slaves
_GOALS: Final = {1_500_000: 0.95, 3_000_000: 0.90, 12_000_000: 0.80}
_GOAL_SLAVES: Final = 10
#: where the bare loop's own efficiency is less, the pty and the scheduler decide, and no driver is judged
_LEAST_BARE: Final = 0.5
#: CPU time per exchange to the bare loop's, at this rate
_GOAL_CPU: Final = 1.15
_CPU_BAUD: Final = 500_000
#: processors of the kernel's workers that have no own one, which carry the octets of a pty
_WORKERS: Final = Path("/sys/devices/virtual/workqueue/cpumask")
#: and in Python loops, with ten slaves
_CPU_GOALS: Final = {"asyncio": 500.0, "process": 500.0}


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench rotation")
    parser.add_argument("--bauds", type=int, nargs="*", default=_BAUDS)
    parser.add_argument("--slaves", type=slaves, default=_GOAL_SLAVES)
    parser.add_argument("--seconds", type=duration, default=1.0, help="of one measurement, four rotations at least")
    parser.add_argument("--rounds", type=count, default=9, help="of all kinds in turn; medians are reported")
    parser.add_argument("--kinds", nargs="*", choices=(*DRIVERS, BARE), default=(*DRIVERS, BARE))
    args = parser.parse_args(argv)
    report = Report("rotation")
    with pinned() as where:
        report.notes.append(where.text)
        kinds = available(args.kinds, report.notes)
        for baud in args.bauds:
            _at(report, baud, args, kinds, where)
    return report


def _at(report: Report, baud: int, args: argparse.Namespace, kinds: Sequence[str], where: Processors) -> None:
    params = BusParams.preset(baud)
    ruled = args.slaves * (2 * 21 * 11 + params.min_tsdr + params.t_id1) + 33 + params.t_id1
    seconds = max(args.seconds, 6 * params.ns(ruled) / 1e9)
    cases: dict[tuple[str, int], list[Taken]] = {(kind, args.slaves): [] for kind in kinds}

    calls: dict[str, float] = {}

    def measure(kind: str, slaves: int) -> Taken:
        with bench(kind, slaves, baud, where, more=NO_GAP) as running:
            found = running.measure(seconds)
            if baud == _CPU_BAUD and kind not in calls and (counted := running.system_calls(0.3)) is not None:
                calls[kind] = counted
            return found

    for _ in range(args.rounds):
        one_round(cases, measure, report.notes)
    report.calibrated(f"{baud_text(baud)}: Python", [t.python_loop for runs in cases.values() for t in runs])
    taken = {kind: runs for (kind, _), runs in cases.items()}
    at = baud_text(baud)
    report.add(f"{at}: rotation by the rules", params.ns(ruled) / 1000, "us")
    share = 0.0
    if "bare" in taken:
        shares = [pty_share(t.records, baud) for t in taken["bare"]]
        share = median(shares)
        report.measured(f"{at}: the pty's own share per exchange", [s / 1000 for s in shares], "us")
    efficiencies: dict[str, list[float]] = {}
    for kind, runs in taken.items():
        title = f"{at}, {kind}"
        efficiencies[kind] = _efficiency(report, title, kind, baud, runs, share)
        goal = _CPU_GOALS.get(kind) if baud == _CPU_BAUD and args.slaves == _GOAL_SLAVES else None
        report.in_loops(f"{title}: CPU time per exchange", [t.cpu_per_exchange for t in runs], goal)
    to_bare(report, at, efficiencies, _GOALS.get(baud) if args.slaves == _GOAL_SLAVES else None)
    if baud == _CPU_BAUD:
        add_cpu(report, at, taken, calls)
    late = [t.written - t.due for runs in taken.values() for run in runs for t in run.records if t.written]
    report.add(f"{at}: the wire's own lateness p50", middle(late) / 1000, "us")
    note_disturbance(report, (run for runs in taken.values() for run in runs), at)
    held = sum(run.held for kind in DRIVERS for run in taken.get(kind, []))
    asked = sum(len(run.records) for kind in DRIVERS for run in taken.get(kind, []))
    if held:
        report.notes.append(
            f"{at}: {held} of {asked} telegrams came before their idle time was over and were held back"
        )


def add_cpu(report: Report, at: str, taken: dict[str, list[Taken]], calls: dict[str, float]) -> None:
    """Add what the CPU time of an exchange is made of, and its ratios to the bare loop's."""
    report.add(f"{at}: CPU time of one sleep and wake-up", wake_up_ns() / 1000, "us")
    for kind, runs in taken.items():
        title = f"{at}, {kind}"
        report.measured(f"{title}: sleeps per exchange", [t.wake_ups / t.exchanges for t in runs], "")
        report.measured(f"{title}: preemptions per exchange", [t.preempted / t.exchanges for t in runs], "")
        if kind in calls:
            report.add(f"{title}: system calls per exchange", calls[kind], "")
        report.measured(f"{title}: CPU time to that of the clock", [t.cpu / t.seconds / 1e9 for t in runs], "ratio")
    for kind in DRIVERS:
        if kind in taken and BARE in taken:
            ratios = cpu_to_bare(taken[kind], taken[BARE])
            report.measured(f"{at}, {kind}: CPU time per exchange to the bare loop's", ratios, "ratio", _GOAL_CPU)
    if _WORKERS.exists():
        report.notes.append(f"the kernel's workers may run on processors with the mask {_WORKERS.read_text().strip()}")


def _efficiency(report: Report, title: str, kind: str, baud: int, runs: Sequence[Taken], share: float) -> list[float]:
    """Add the figures of one kind of master. Returns its efficiency in each round."""
    measured = [rotations(t.records, baud) for t in runs]
    if not all(measured):
        raise RuntimeError(f"{title}: a round has no whole rotation: take more seconds")
    for q in (0.5, 0.99):
        values = [quantile([r.took for r in rounds], q) / 1000 for rounds in measured]
        report.measured(f"{title}: rotation p{q * 100:.0f}", values, "us")
    efficiency = [middle([r.wire / r.took for r in rounds]) for rounds in measured]
    report.measured(f"{title}: efficiency p50", efficiency, "ratio", more=True)
    if share and kind in DRIVERS:
        values = [middle([r.wire / max(r.took - r.exchanges * share, r.wire) for r in rounds]) for rounds in measured]
        report.measured(f"{title}: efficiency p50 without the pty's share", values, "ratio", more=True)
    return efficiency


def to_bare(report: Report, at: str, efficiencies: dict[str, list[float]], goal: float | None) -> None:
    """Add the efficiency of the drivers to the bare loop's of the same round, where there is one."""
    bare = efficiencies.get("bare", [])
    if bare and goal is not None and median(bare) < _LEAST_BARE:
        report.notes.append(
            f"{at}: no verdict: the bare loop's own efficiency is {median(bare):.2f}, less than {_LEAST_BARE}"
        )
        goal = None
    for kind in DRIVERS:
        if bare and kind in efficiencies:
            ratios = [ours / its for ours, its in zip(efficiencies[kind], bare, strict=True)]
            report.measured(f"{at}, {kind}: efficiency to the bare loop's", ratios, "ratio", goal, more=True)
