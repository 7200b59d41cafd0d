"""The rotation behind a USB adapter's habits, and where its time goes: wire, adapter, stack.

The other end simulates the adapter: what the master writes goes on the wire with the next USB frame (1 ms), answers are
handed over when a packet is full or the latency timer has run out, with a frame. The timer is at 16 ms, as chips come,
or at 1 ms, as dpstack sets it where it may. The GAP is off. Per exchange: *wire* is what the telegrams take by the
rules, *stack* from the answer's last octet handed over to the next request read without T_ID1 (the pty's share is in
it), *adapter* the rest: waiting for frames and timer.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from bench.masters import DRIVERS
from bench.options import count, duration, slaves
from bench.records import Record, middle, rotations
from bench.report import Report, quantile
from bench.rig import NO_GAP, Taken, available, bench, note_disturbance, pinned
from dpstack.params import BusParams
from dpstack.units import baud_text

_TIMERS: Final = (16, 1)


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench usb")
    parser.add_argument("--bauds", type=int, nargs="*", default=[500_000, 1_500_000])
    parser.add_argument("--slaves", type=slaves, default=10)
    parser.add_argument("--timers", type=int, nargs="*", default=_TIMERS, help="the latency timer in ms")
    parser.add_argument("--seconds", type=duration, default=2.0, help="of one measurement")
    parser.add_argument("--rounds", type=count, default=3)
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS)
    args = parser.parse_args(argv)
    report = Report("usb")
    with pinned() as where:
        report.notes.append(where.text)
        kinds = available(args.kinds, report.notes)
        cases = [(baud, timer, kind) for baud in args.bauds for timer in args.timers for kind in kinds]
        runs: dict[tuple[int, int, str], list[Taken]] = {case: [] for case in cases}
        for _ in range(args.rounds):
            for (baud, timer, kind), taken in runs.items():
                adapter = ("--frame-us", "1000", "--latency-ms", str(timer))
                with bench(kind, args.slaves, baud, where, more=NO_GAP, of_wire=adapter) as running:
                    taken.append(running.measure(args.seconds))
        for (baud, timer, kind), taken in runs.items():
            title = f"{baud_text(baud)}, timer {timer} ms, {kind}"
            rounds = [rotations(t.records, baud) for t in taken]
            for q in (0.5, 0.99):
                values = [quantile([r.took for r in each], q) / 1e6 for each in rounds if each]
                report.measured(f"{title}: rotation p{q * 100:.0f}", values, "ms")
            parts = [_parts(t.records, baud) for t in taken]
            for n, name in enumerate(("wire", "adapter", "stack")):
                report.measured(f"{title}: {name} per exchange", [part[n] / 1e6 for part in parts], "ms")
        note_disturbance(report, (t for taken in runs.values() for t in taken))
    return report


def _parts(records: Sequence[Record], baud: int) -> tuple[float, float, float]:
    """Medians in ns of wire, adapter and stack time of one exchange that another telegram follows."""
    params = BusParams.preset(baud)
    idle = params.ns(params.t_id1)
    wire, adapter, stack = [], [], []
    for this, following in pairwise(records):
        if this.exchange and this.written:
            ruled = params.ns(11 * (this.octets + this.answer_octets) + params.min_tsdr) + idle
            ours = following.read - this.written - idle
            wire.append(ruled)
            stack.append(ours)
            adapter.append(following.read - this.read - ruled - ours)
    return middle(wire), middle(adapter), middle(stack)
