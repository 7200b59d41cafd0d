"""How long it takes from the start of a program until 32 slaves are in data exchange, on a pty that gives no time.

*Program* is the interpreter and its imports; *opening* from there until the port is open: the configuration, and the
start of the bus process where there is one; *listening* until the first telegram; *claim* from there until the token
is this master's; *bring-up* until the last slave is in data exchange, by the times of the events.
"""

from __future__ import annotations

import argparse
from typing import Final, cast

from bench.masters import DRIVERS
from bench.report import Report
from bench.rig import Bench, Processors, available, bench, pinned

_PARTS: Final = ("program", "opening", "listening", "claim", "bring-up", "all")


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench startup")
    parser.add_argument("--slaves", type=int, default=32)
    parser.add_argument("--baud", type=int, default=12_000_000)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS)
    args = parser.parse_args(argv)
    report = Report("startup")
    with pinned() as where:
        report.notes.append(where.text)
        kinds = available(args.kinds, report.notes)
        runs: dict[str, list[dict[str, float]]] = {kind: [] for kind in kinds}
        for _ in range(args.rounds):
            for kind, parts in runs.items():
                parts.append(_measure(kind, args.slaves, args.baud, where))
        for kind, parts in runs.items():
            for name in _PARTS:
                report.measured(f"{kind}, {args.slaves} slaves: {name}", [part[name] for part in parts], "ms")
    return report


def _measure(kind: str, slaves: int, baud: int, where: Processors) -> dict[str, float]:
    with bench(kind, slaves, baud, where, paced=False, probe=True) as running:
        return parts_of(running)


def parts_of(running: Bench) -> dict[str, float]:
    """The parts in ms. Raises RuntimeError when the master does not tell of its slaves."""
    facts = running.facts
    events = cast(list[tuple[str, int, str]], facts["events"])
    states = [t for name, t, text in events if name == "SlaveStateChanged" and "data_exchange" in text]
    joined = [t for name, t, _ in events if name == "RingJoined"]
    if not states or not joined:
        raise RuntimeError("the master's events tell neither of the token nor of slaves in data exchange")
    first = running.first_at()
    stations = (
        running.began,
        cast(int, facts["imported"]),
        running.opened_at(),
        first,
        max(first, joined[0]),
        max(states),
    )
    parts = {name: (b - a) / 1e6 for name, a, b in zip(_PARTS, stations, stations[1:], strict=False)}
    return parts | {"all": (stations[-1] - stations[0]) / 1e6}
