"""dpstack, pyprofibus, profirust and a bare loop as masters of the same slaves at 500 kbit/s, in turn in each round.

That is the table of docs/explanation/comparison.md; docs/development/benchmarks.md says how to repeat it. CPU time is
user and system time of all processes of a master, divided by the Data_Exchanges that the line counted; ratios are to
the bare loop of the same round. A request *sent too soon* came before the answer to the last one had ended: both are
spoilt, as on a real bus.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from statistics import median
from typing import Final

from bench.masters import KINDS
from bench.options import count, duration, slaves
from bench.records import middle, rotations
from bench.report import Report
from bench.rig import (
    NO_GAP,
    MasterFailedError,
    Taken,
    available,
    bench,
    cpu_to_bare,
    note_disturbance,
    one_round,
    pinned,
)

_BAUD: Final = 500_000
#: kind, of profirust with the time in us between two polls: that of its examples, and shorter ones
_TITLES: Final = {
    "bare": "bare loop",
    "process": "dpstack, driver `process`",
    "asyncio": "dpstack, driver `asyncio`",
    "pyprofibus": "pyprofibus",
    "profirust 3500": "profirust, 3.5 ms between two polls",
    "profirust 1000": "profirust, 1 ms",
    "profirust 100": "profirust, 0.1 ms",
    "profirust 0": "profirust, no sleep",
}
_HEAD: Final = """\
| %s | CPU time per exchange, us | to the bare loop's | exchanges per second | time on the wire / rotation \
| system calls per exchange | requests sent too soon |
|---|---|---|---|---|---|---|"""


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench peers")
    parser.add_argument("--profirust", metavar="PROGRAM", help="built from bench/peers/profirust by cargo")
    parser.add_argument("--slaves", type=slaves, nargs="+", default=[16, 1], help="a table for each")
    parser.add_argument("--seconds", type=duration, default=2.0, help="of one measurement")
    parser.add_argument("--rounds", type=count, default=8, help="of all masters in turn")
    args = parser.parse_args(argv)
    report = Report("peers")
    with pinned() as where:
        kinds = [kind for kind in available(list(_TITLES), report.notes) if args.profirust or kind in KINDS]
        cases: dict[tuple[str, int], list[Taken]] = {(kind, n): [] for n in args.slaves for kind in kinds}
        calls: dict[tuple[str, int], list[float]] = {case: [] for case in cases}

        def measure(kind: str, slaves: int) -> Taken:
            try:
                return once(kind, slaves)
            except MasterFailedError as error:  # other programs may have held up the line
                report.notes.append(f"measured again: {error}")
                return once(kind, slaves)

        def once(kind: str, slaves: int) -> Taken:
            name, _, sleep = kind.partition(" ")
            more = ("--program", args.profirust, "--sleep-us", sleep) if sleep else ()
            with bench(name, slaves, _BAUD, where, more=[*NO_GAP, *more], of_wire=["--collide"]) as running:
                found = running.measure(args.seconds)
                if (counted := running.system_calls(0.5)) is not None:
                    calls[kind, slaves].append(counted)
                return found

        for _ in range(args.rounds):
            one_round(cases, measure, report.notes)
    for n in args.slaves:
        report.notes += ["", *(_HEAD % f"{n} slave{'s' if n > 1 else ''}").splitlines()]
        for kind in kinds:
            if (kind, n) in cases:
                report.notes.append(_row(report, kind, n, cases[kind, n], cases.get(("bare", n), []), calls[kind, n]))
    note_disturbance(report, (taken for runs in cases.values() for taken in runs))
    report.notes += ["", where.text]
    return report


def _row(report: Report, kind: str, slaves: int, runs: list[Taken], bare: list[Taken], calls: list[float]) -> str:
    """Add the figures of one master. Returns its line of the table."""
    ratios = cpu_to_bare(runs, bare) if bare else []
    cells = [_TITLES[kind]]
    for name, unit, rounds, digits in (
        ("CPU time per exchange", "us", [taken.cpu_per_exchange[0] / 1000 for taken in runs], 0),
        ("CPU time per exchange to the bare loop's", "ratio", ratios, 2),
        ("exchanges per second", "1/s", [taken.exchanges / taken.seconds for taken in runs], 0),
        ("time on the wire to rotation", "ratio", [_efficiency(taken) for taken in runs], 2),
        ("system calls per exchange", "", calls, 1),
        ("share of requests sent too soon", "", [_too_soon(taken) for taken in runs], 2),
    ):
        report.measured(f"{slaves} slaves, {kind}: {name}", rounds, unit)
        cells.append(f"{median(rounds):.{digits}f}" if rounds else "-")
    if kind != "bare" and ratios:
        cells[2] += f" ({min(ratios):.2f} to {max(ratios):.2f})"
    return f"| {' | '.join(cells)} |"


def _efficiency(taken: Taken) -> float:
    return middle([rotation.wire / max(rotation.took, 1) for rotation in rotations(taken.records, _BAUD)])


def _too_soon(taken: Taken) -> float:
    """The share of requests that were sent before the answer to the last one had ended."""
    return sum(later.read < sooner.answer_end for sooner, later in pairwise(taken.records)) / len(taken.records)
