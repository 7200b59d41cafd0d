"""Where a turn-around goes, step by step, for both drivers and the bare loop on a wire that takes its time.

A turn-around begins when the wire has written an answer's last octet and ends when it has read the next request. Its
steps sum up to it: *wake-up* (until the master reads; of the bare loop until its waiting read returns), *read*, *pump*
(the protocol machine, before and after the idle time), *T_ID1* (the idle time of the rules, as far as the work before
it left something of it), *late* (from its end to the next call of the machine: a timer, or the clock), *driver* (the
rest in the master's process; of the bare loop its loop), *write*, *to the wire* (until the other process has it).
Means of the middle half of all turn-arounds: pauses of the machine are left out, and the sum stays exact.

The steps are noted inside the master's process by functions in place of ``os.read``, ``os.write`` and ``pump``. Rounds
without them lie between: the turn-around as the wire alone sees it, and the cost of the noting.
"""

from __future__ import annotations

import argparse
from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise
from statistics import mean
from typing import Final, NamedTuple

from bench.masters import DRIVERS, FIRST
from bench.options import count, duration, slaves
from bench.records import Record
from bench.report import Report, Table
from bench.rig import Noted, Processors, Taken, available, bench, note_disturbance, one_round, pinned
from dpstack.params import BusParams
from dpstack.units import baud_text

_BAUDS: Final = (1_500_000, 3_000_000, 6_000_000, 12_000_000)
_KINDS: Final = ("bare", *DRIVERS)
_WHOLE: Final = "turn-around"
_PLAIN: Final = "without noting"


class Steps(NamedTuple):
    """Steps of a turn-around in their order, in ns."""

    wake_up: float
    read: float
    pump: float
    t_id1: float
    late: float
    driver: float
    write: float
    to_the_wire: float


_COLUMNS: Final = ("wake-up", "read", "pump", "T_ID1", "late", "driver", "write", "to the wire")


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench steps")
    parser.add_argument("--bauds", type=int, nargs="*", default=_BAUDS, help="in bit/s (default: %(default)s)")
    parser.add_argument("--slaves", type=slaves, default=10, help="default: %(default)s")
    parser.add_argument("--seconds", type=duration, default=0.5, help="of one measurement")
    parser.add_argument("--rounds", type=count, default=5, help="of all kinds in turn, with and without noting")
    parser.add_argument("--kinds", nargs="*", choices=_KINDS, default=_KINDS, help="default: all")
    args = parser.parse_args(argv)
    report = Report("steps")
    with pinned() as where:
        report.notes.append(where.text)
        kinds = available(args.kinds, report.notes)
        for baud in args.bauds:
            _at(report, baud, args, kinds, where)
    report.notes.append("all in us; a step before the wire has seen its own write return is less than 0")
    return report


def _at(report: Report, baud: int, args: argparse.Namespace, kinds: Sequence[str], where: Processors) -> None:
    noted: dict[tuple[str, int], list[Taken]] = {(kind, args.slaves): [] for kind in kinds}
    plain: dict[tuple[str, int], list[Taken]] = {(kind, args.slaves): [] for kind in kinds}

    def measure(kind: str, slaves: int, steps: bool) -> Taken:
        with bench(kind, slaves, baud, where, gap=0, steps=steps) as running:
            return running.measure(args.seconds)

    for _ in range(args.rounds):
        one_round(noted, lambda kind, slaves: measure(kind, slaves, True), report.notes)
        one_round(plain, lambda kind, slaves: measure(kind, slaves, False), report.notes)
    params = BusParams.preset(baud)
    at = baud_text(baud)
    table = Table(at, (*_COLUMNS, _WHOLE, _PLAIN), tuple(kinds))
    report.tables.append(table)
    for kind in kinds:
        rounds = [turn_arounds(t.records, t.steps, params.ns(params.t_id1)) for t in noted[kind, args.slaves]]
        whole = [turns(t.records) for t in plain[kind, args.slaves]]
        if not all(rounds) or not all(whole):
            raise RuntimeError(f"{at}, {kind}: no turn-around was seen: take more seconds")
        together = _middle([steps for each in rounds for steps in each])
        by_round = [_middle(each) for each in rounds]
        for number, column in enumerate(_COLUMNS):
            values = [steps[number] / 1000 for steps in by_round]
            report.add(table.name(kind, column), together[number] / 1000, "us", rounds=values)
        sums = [sum(steps) / 1000 for steps in by_round]
        report.add(table.name(kind, _WHOLE), sum(together) / 1000, "us", rounds=sums)
        value = mean(_middle_half([ns for each in whole for ns in each])) / 1000
        report.add(table.name(kind, _PLAIN), value, "us", rounds=[mean(_middle_half(each)) / 1000 for each in whole])
    note_disturbance(report, (t for runs in (*noted.values(), *plain.values()) for t in runs), at)


def turn_arounds(records: Sequence[Record], noted: Sequence[Noted], t_id1_ns: int) -> list[Steps]:
    """The turn-arounds that the wire has in ``records`` and the master in ``noted``, both in the order of time.

    Of a program that has no ``pump``, T_ID1 is what lies between read and write, as far as that is so long.
    """
    began = [row.write_from for row in noted]
    found = []
    for answer, request in _pairs(records):
        place = bisect_left(began, answer.written)
        if place == len(noted) or noted[place].write_from > request.read:
            continue
        row = noted[place]
        # a read that waited for the octets was woken up in itself
        reading = row.read_from if row.read_from > answer.written else row.read_until
        inside = row.write_from - row.read_until
        waited = row.waited if row.pumped else min(inside, t_id1_ns)
        found.append(
            Steps(
                reading - answer.written,
                row.read_until - reading,
                row.pumped,
                waited,
                row.late,
                inside - row.pumped - waited - row.late,
                row.write_until - row.write_from,
                request.read - row.write_until,
            )
        )
    return found


def turns(records: Sequence[Record]) -> list[int]:
    """Turn-arounds as the wire alone sees them, in ns."""
    return [request.read - answer.written for answer, request in _pairs(records)]


def _pairs(records: Sequence[Record]) -> list[tuple[Record, Record]]:
    """Exchanges that follow one another within a round: before the first one the token was on the wire."""
    return [(a, b) for a, b in pairwise(records) if a.exchange and a.written and b.exchange and b.to != FIRST]


def _middle(steps: Sequence[Steps]) -> Steps:
    """Means of the steps over the middle half of the turn-arounds, by their whole time."""
    half = sorted(steps, key=sum)[len(steps) // 4 : len(steps) - len(steps) // 4]
    return Steps(*map(mean, zip(*half, strict=True)))


def _middle_half(values: Sequence[float]) -> Sequence[float]:
    return sorted(values)[len(values) // 4 : len(values) - len(values) // 4]
