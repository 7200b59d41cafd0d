"""Acyclic traffic without end to eight slaves: what it does to the rotation and to a fixed cycle, and what it carries.

In virtual time, where every figure is exact: Read and Write of 1 to 240 octets, answered at once, when polled, or late;
the rotation beside that without and beside the plan's acyclic service, misses of fixed cycles, services a second.
On a paced pty the same with both drivers: Reads answered when polled.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from typing import Final

from bench.acyclic_plant import LENGTHS, Answers, Load, Plant, Seen, setups
from bench.jitter import Lateness
from bench.masters import DRIVERS
from bench.options import count, duration
from bench.records import fetched, rotations
from bench.report import Report, quantile
from bench.rig import NO_GAP, Processors, Taken, available, bench, note_disturbance, one_round, pinned
from dpstack.dp.plan.cycle_check import CycleVerdict, cycles_for_a_request, least_ns
from dpstack.dp.plan.rotation_time import Case, Figures
from dpstack.fdl.events import HELD_BACK_CYCLES
from dpstack.params import BusParams
from dpstack.units import NS_PER_MS, NS_PER_S, NS_PER_US, baud_text

_BAUDS: Final = (187_500, 500_000, 1_500_000, 3_000_000, 12_000_000)
_PTY_BAUDS: Final = (500_000, 1_500_000)
#: fixed cycles there in ms: what the plan calls undisturbed, and 4 ms for what a pty adds
_PTY_CYCLES: Final = {500_000: 20.0, 1_500_000: 10.0}
#: Global_Control is repeated so often
_CONTROLS_NS: Final = 200 * NS_PER_MS
_SLAVES: Final = 8
#: rotation p99 with records of so many octets to that without
_GOAL_OCTETS: Final = 64
_GOAL_RATIO: Final = 1.3
#: the longest rotation is longer by the plan's acyclic service at most
_GOAL_LONGER: Final = 1.0
_CYCLES: Final = (CycleVerdict.POSSIBLE, CycleVerdict.TYPICAL, CycleVerdict.UNDISTURBED, CycleVerdict.ALWAYS)
#: in these a service fits between two cycles: none may be missed
_KEPT: Final = (CycleVerdict.UNDISTURBED, CycleVerdict.ALWAYS)


def run(argv: Sequence[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench acyclic")
    parser.add_argument("--bauds", type=int, nargs="*", default=_BAUDS, help="in virtual time")
    parser.add_argument("--lengths", type=int, nargs="*", default=LENGTHS, choices=LENGTHS)
    parser.add_argument("--rotations", type=int, default=250, help="of one measurement in virtual time")
    parser.add_argument("--cycles", type=int, default=198, help="of one measurement in virtual time")
    parser.add_argument("--pty-bauds", type=int, nargs="*", default=_PTY_BAUDS)
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS, help="on the pty")
    parser.add_argument("--seconds", type=duration, default=2.0, help="of one measurement on the pty")
    parser.add_argument("--rounds", type=count, default=5, help="on the pty, all kinds in turn; medians are reported")
    args = parser.parse_args(argv)
    report = Report("acyclic")
    for baud in args.bauds:
        _rotations(report, baud, args.lengths, args.rotations)
        if args.cycles:
            _cycles(report, baud, args.cycles)
    if args.pty_bauds and args.rounds:
        with pinned() as where:
            report.notes.append(where.text)
            kinds = available(args.kinds, report.notes)
            for baud in args.pty_bauds:
                _on_a_pty(report, baud, args, kinds, where)
    return report


# --- in virtual time ---


def _rotations(report: Report, baud: int, lengths: Sequence[int], count: int) -> None:
    params = BusParams.preset(baud, gap=0)
    counted = Figures(params, setups(_SLAVES))
    # each measurement has as many Global_Controls as any other: what they cost must not look like a service's
    ns = -(-count * counted.ns(Case.TYPICAL) // _CONTROLS_NS) * _CONTROLS_NS
    service_ns = params.ns(counted.acyclic_bits)
    at = baud_text(baud)
    report.exact(f"{at}: the plan's acyclic service", service_ns / NS_PER_US, "us")
    longer: dict[int, float] = {}
    for answers in Answers:
        plant = Plant(baud, answers, _SLAVES)
        quiet = plant.look(ns)
        if answers is Answers.AT_ONCE:
            _quantiles(report, f"{at}, without", quiet)
        for write in (False, True):
            for octets in lengths:
                load = Load(write, octets, answers)
                seen = plant.look(ns, load)
                more = (seen.rotation.max_ns - quiet.rotation.max_ns) / service_ns
                longer[octets] = max(more, longer.get(octets, 0.0))
                if seen.failed:
                    raise RuntimeError(f"{at}, {load.title}: {seen.failed} of {seen.done} services failed")
                _loaded(report, f"{at}, {load.title}", octets, quiet, seen)
        plant.check()
    for octets, more in longer.items():
        name = f"{at}, {octets} octets: longest rotation longer, in acyclic services of the plan"
        report.exact(name, more, "ratio", _GOAL_LONGER)


def _loaded(report: Report, title: str, octets: int, quiet: Seen, seen: Seen) -> None:
    goal = _GOAL_RATIO if octets == _GOAL_OCTETS else None
    ratio = seen.rotation.quantile_ns(0.99) / quiet.rotation.quantile_ns(0.99)
    report.exact(f"{title}: rotation p99 to that without", ratio, "ratio", goal)
    report.exact(f"{title}: services", seen.per_s, "1/s", more=True)
    if octets in (_GOAL_OCTETS, LENGTHS[-1]):
        report.exact(f"{title}: octets of records", seen.per_s * octets, "octets/s", more=True)
    if octets == _GOAL_OCTETS:
        _quantiles(report, title, seen)


def _quantiles(report: Report, title: str, seen: Seen) -> None:
    for name, q in (("p50", 0.5), ("p99", 0.99), ("max", 1.0)):
        report.exact(f"{title}: rotation {name}", seen.rotation.quantile_ns(q) / NS_PER_US, "us")


def _cycles(report: Report, baud: int, count: int) -> None:
    """Slaves as fast as they may be, so that the shortest possible cycle can be kept without traffic."""
    counted = Figures(BusParams.preset(baud, gap=0), setups(_SLAVES))
    least = least_ns(counted)
    for verdict in _CYCLES:
        cycle_ns = -(-least[verdict] // NS_PER_US) * NS_PER_US
        plant = Plant(baud, Answers.POLLED, _SLAVES, cycle_ns, t_sdr=counted.params.min_tsdr)
        title = f"{baud_text(baud)}, cycle_ms = {cycle_ns / NS_PER_MS:g} ({verdict.value})"
        costs = (
            0 if verdict in _KEPT else cycles_for_a_request(Figures(counted.params, counted.setups, cycle_ns=cycle_ns))
        )
        missed_at_most = -(-count // (HELD_BACK_CYCLES + costs)) * costs
        loads = (None, Load(False, _GOAL_OCTETS, Answers.POLLED), Load(True, LENGTHS[-1], Answers.POLLED))
        for load in loads:
            seen = plant.look(count * cycle_ns, load)
            name = f"{title}, {'without' if load is None else load.title}: cycles missed"
            report.exact(name, 100 * seen.missed / count, "%", 100 * missed_at_most / count)
            if load is not None:
                report.exact(f"{title}, {load.title}: services", seen.per_s, "1/s", more=True)
        plant.check()


# --- on a pty ---


def _on_a_pty(report: Report, baud: int, args: argparse.Namespace, kinds: Sequence[str], where: Processors) -> None:
    """With and without in turn, each with a master of its own."""
    octets, cycle_ms = _GOAL_OCTETS, _PTY_CYCLES.get(baud)

    def measure(records: int, cycle_ms: float | None, kind: str, slaves: int) -> Taken:
        with bench(kind, slaves, baud, where, cycle_ms=cycle_ms, more=[*NO_GAP, "--records", str(records)]) as running:
            return running.measure(args.seconds)

    quiet, loaded, quiet_cycle, loaded_cycle = (
        {(kind, _SLAVES): list[Taken]() for kind in kinds} for _ in ("", "loaded", "cycle", "loaded cycle")
    )
    for _ in range(args.rounds):
        one_round(quiet, partial(measure, 0, None), report.notes)
        one_round(loaded, partial(measure, octets, None), report.notes)
        if cycle_ms is not None:
            one_round(quiet_cycle, partial(measure, 0, cycle_ms), report.notes)
            one_round(loaded_cycle, partial(measure, octets, cycle_ms), report.notes)
    at = baud_text(baud)
    for (kind, _), runs in loaded.items():
        title = f"{at}, pty, {kind}, Read of {octets}"
        before, after = ([_took(t, baud) for t in taken] for taken in (quiet[kind, _SLAVES], runs))
        for name, q, goal in (("p50", 0.5, None), ("p99", 0.99, _GOAL_RATIO)):
            least, most = ([quantile(took, q) / NS_PER_US for took in rounds] for rounds in (before, after))
            report.measured(f"{at}, pty, {kind}, without: rotation {name}", least, "us")
            report.measured(f"{title}: rotation {name}", most, "us")
            ratios = [a / b for a, b in zip(most, least, strict=True)]
            report.measured(f"{title}: rotation {name} to that without", ratios, "ratio", goal)
        services = [fetched(t.records, octets) / t.seconds for t in runs]
        report.measured(f"{title}: services", services, "1/s", more=True)
        report.measured(f"{title}: octets of records", [s * octets for s in services], "octets/s", more=True)
        cpu = [t.cpu / (t.seconds * NS_PER_S) for t in runs]
        report.measured(f"{title}: the master's share of a processor", cpu, "ratio")
        if cycle_ms is not None:
            for name, cycles in (("without", quiet_cycle), (f"Read of {octets}", loaded_cycle)):
                missed = [float(Lateness(t.records, cycle_ms, t.due).missed) for t in cycles[kind, _SLAVES]]
                report.measured(f"{at}, pty, {kind}, cycle_ms = {cycle_ms:g}, {name}: missed rounds", missed, "")
            services = [fetched(t.records, octets) / t.seconds for t in loaded_cycle[kind, _SLAVES]]
            report.measured(f"{title}, cycle_ms = {cycle_ms:g}: services", services, "1/s", more=True)
    everything = (quiet, loaded, quiet_cycle, loaded_cycle)
    note_disturbance(report, (t for taken in everything for runs in taken.values() for t in runs), at)


def _took(taken: Taken, baud: int) -> list[int]:
    """Its rotations. Raises RuntimeError where there are none."""
    found = [r.took for r in rotations(taken.records, baud, services=True)]
    if not found:
        raise RuntimeError("nothing was measured: take more seconds")
    return found
