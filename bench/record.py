"""A recording of the running bus: the CPU time per exchange of the master with one and without, in turn.

Each slave has four named values (two inputs, two outputs with scale and unit), every round is a row of CSV. The wire is
that of the benchmark ``tap``: at 500 kbit/s it takes its time, at 12 Mbit/s its octets take none. With the driver
asyncio one process carries the bus, the queue and the thread that writes; with the process driver the bus's own process
is measured for itself, too.
"""

from __future__ import annotations

import argparse
import time
from typing import Final

from bench.masters import DRIVERS
from bench.options import count, duration, slaves
from bench.paired import interval
from bench.report import Report
from bench.rig import Processors, available, bench, note_disturbance, pinned
from dpstack.units import baud_text

_BAUDS: Final = (500_000, 12_000_000)
#: up to this rate the wire takes its time
_PACED: Final = 3_000_000
#: CPU time per exchange with a recording to that without one
_GOAL: Final = 1.05
#: after a recording has begun or ended
_SETTLE_S: Final = 0.3


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench record")
    parser.add_argument("--bauds", type=int, nargs="*", default=_BAUDS)
    parser.add_argument("--slaves", type=slaves, default=10)
    parser.add_argument("--seconds", type=duration, default=0.4, help="of one slice")
    parser.add_argument("--rounds", type=count, default=30, help="slices with and without a recording in turn")
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS)
    args = parser.parse_args(argv)
    report = Report("record")
    with pinned() as where:
        report.notes.append(where.text)
        for baud in args.bauds:
            for kind in available(args.kinds, report.notes):
                _at(report, kind, baud, args, where)
    return report


def _at(report: Report, kind: str, baud: int, args: argparse.Namespace, where: Processors) -> None:
    """One master, whose recording comes and goes."""
    slices: dict[str, list[tuple[int, int, int]]] = {"on": [], "off": []}
    with bench(kind, args.slaves, baud, where, paced=baud <= _PACED, gap=0, recording=True) as running:
        for number in range(args.rounds):
            for order in ("off", "on") if number % 2 else ("on", "off"):
                running.switch(on=order == "on")
                time.sleep(_SETTLE_S)
                slices[order].append(running.cpu_slices(args.seconds))
        running.switch(on=False)
        waited = running.measure(args.seconds)
    title = f"{baud_text(baud)}, {kind}"
    for name, place in (("", 0), (" of the bus's own process", 1))[: 2 if kind == "process" else 1]:
        # a slice in which the master did not run at all says nothing
        pairs = [both for both in zip(slices["on"], slices["off"], strict=True) if all(o[2] and o[place] for o in both)]
        costs = {order: [both[n][place] / both[n][2] for both in pairs] for n, order in enumerate(slices)}
        report.measured(f"{title}: CPU time per exchange{name}", [ns / 1000 for ns in costs["off"]], "us")
        ratios = [with_one / without for with_one, without in zip(costs["on"], costs["off"], strict=True)]
        goal = _GOAL if place or kind != "process" else None
        report.measured(f"{title}: CPU time per exchange{name} with a recording to without", ratios, "ratio", goal)
        low, high = interval(ratios)
        report.notes.append(
            f"{title}{name}: with a recording to without, the median lies between {low:.3f} and {high:.3f} (99 %)"
        )
    note_disturbance(report, [waited], title)
