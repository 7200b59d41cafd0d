"""Cost of one exchange at the master, from 1 to 100 slaves, on a medium that costs nothing.

The cost of an exchange must not depend on how many slaves there are. Once a round come the token to itself and what a
round begins and ends with; with one slave that is once an exchange. So beside the mean there is the cost of *one slave
more*: (a round's cost - that of one slave's round) / (slaves - 1).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from typing import Final

from bench.calibration import Beside
from bench.null_medium import NullBus
from bench.options import count, slaves
from bench.report import Report

#: cost of an exchange with the most slaves to that with one
_GOAL: Final = 1.1


def run(argv: Sequence[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench scale")
    parser.add_argument("--slaves", type=slaves, nargs="*", default=[1, 3, 10, 32, 100])
    parser.add_argument("--exchanges", type=int, default=3_000, help="a round on the medium that costs nothing")
    parser.add_argument("--rounds", type=count, default=11, help="interleaved")
    parser.add_argument("--seconds", type=float, help="does nothing: older commits measured over a pty, too")
    args = parser.parse_args(argv)
    counts = sorted({1, *args.slaves})
    report = Report("scale")
    buses = {n: NullBus(n) for n in counts}
    for bus in buses.values():
        bus.bring_up()
    null: dict[int, list[tuple[float, float]]] = {n: [] for n in counts}
    beside = Beside()
    for _ in range(args.rounds):
        for n, bus in buses.items():
            null[n].append(beside(partial(bus.measure, args.exchanges)))
    report.calibrated("Python", beside.loops)
    for n, each in null.items():
        name = f"no medium, {n} slave{'s' if n > 1 else ''}: CPU time"
        report.in_loops(f"{name} per exchange", each)
        if n > 1:
            pairs = list(zip(each, null[1], strict=True))
            ratios = [(ns / loop) / (one / one_loop) for (ns, loop), (one, one_loop) in pairs]
            report.measured(f"{name} per exchange to one slave's", ratios, "", _GOAL)
            more = [((n * ns - one * loop / one_loop) / (n - 1), loop) for (ns, loop), (one, one_loop) in pairs]
            report.in_loops(f"{name} of one slave more", more)
    return report
