"""Time from the start of a program until 32 slaves are in data exchange, on a pty that gives no time.

*Program* is the interpreter and its imports; *opening* from there until the port is open: the configuration, and the
start of the bus process where there is one; *listening* until the first telegram; *claim* from there until the token
is this master's; *bring-up* until the last slave is in data exchange, by the times of the events. Listening and claim
last as long as the bus's timers and are in ms, the rest is in Python loops. ``--version`` and a
``ctl`` that asks a running program have a goal: they are compared with an interpreter that only loads argparse, json
and socket.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from functools import partial
from typing import Final, cast

from bench.calibration import Beside
from bench.commit_probe import command_ns, first_octet_ns, plain_ns, running
from bench.masters import DRIVERS
from bench.options import count, slaves
from bench.report import Report
from bench.rig import Bench, Processors, available, bench, pinned
from dpstack.units import NS_PER_MS

_PARTS: Final = ("program", "opening", "listening", "claim", "bring-up", "all")
#: CPU time of a plain command at most, as a ratio
_PLAIN_GOAL: Final = 1.6
#: these last as long as the bus's timers
_BUS_TIME: Final = ("listening", "claim")


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench startup")
    parser.add_argument("--slaves", type=slaves, default=32)
    parser.add_argument("--baud", type=int, default=12_000_000)
    parser.add_argument("--rounds", type=count, default=9)
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS)
    args = parser.parse_args(argv)
    report = Report("startup")
    with pinned() as where:
        report.notes.append(where.text)
        kinds = available(args.kinds, report.notes)
        beside = Beside()
        version: list[tuple[float, float]] = []
        runs: dict[str, list[tuple[dict[str, float], float]]] = {kind: [] for kind in kinds}
        octets: dict[str, list[tuple[float, float]]] = {kind: [] for kind in kinds}
        for _ in range(args.rounds):
            version.append(beside(partial(command_ns, "--version")))
            for kind, parts in runs.items():
                parts.append(beside(partial(_measure, kind, args.slaves, args.baud, where)))
                octets[kind].append(beside(partial(first_octet_ns, kind)))
        with running() as name:
            plain = _beside_plain({"--version": "--version", "ctl status": f"ctl {name} status"}, args.rounds)
        report.calibrated("Python", beside.loops)
        report.in_loops("dpstack --version: CPU time", version)
        for words, ratios in plain.items():
            title = f"dpstack {words}: CPU time beside python -c 'import argparse, json, socket'"
            report.measured(title, ratios, "ratio", _PLAIN_GOAL)
        for kind, times in octets.items():
            report.in_loops(f"dpstack run, {kind}, until the first octet: CPU time", times)
        for kind, parts in runs.items():
            for name in _PARTS:
                title = f"{kind}, {args.slaves} slaves: {name}"
                if name in _BUS_TIME:
                    report.measured(title, [part[name] for part, _ in parts], "ms")
                else:
                    report.in_loops(title, [(part[name] * NS_PER_MS, loop) for part, loop in parts])
    return report


def _beside_plain(commands: Mapping[str, str], rounds: int) -> dict[str, list[float]]:
    """The CPU time of each command as a ratio to that of the plain interpreter before it."""
    ratios: dict[str, list[float]] = {title: [] for title in commands}
    for words in commands.values():
        command_ns(words)  # with the first call the byte code is written
    for _ in range(rounds):
        for title, words in commands.items():
            plain = plain_ns()
            ratios[title].append(command_ns(words) / plain)
    return ratios


def _measure(kind: str, slaves: int, baud: int, where: Processors) -> dict[str, float]:
    with bench(kind, slaves, baud, where, paced=False, probe=True) as running:
        return parts_of(running)


def parts_of(running: Bench) -> dict[str, float]:
    """The parts in ms. Raises RuntimeError if the master does not report its slaves."""
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
