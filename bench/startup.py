"""CPU time and memory of programs with a bus at their start: until the first octet, and with 32 slaves up.

*Opening* is the CPU time of an application and its bus process from the call of ``open_bus`` until the first octet.
PSS is proportional memory (``/proc/PID/smaps_rollup``) of all processes of a program. ``--connectors`` adds a
``dpstack run`` with each connector, 3 s after its start. ``--version`` and a ``ctl`` that asks a running program have a
goal: they are compared with an interpreter that only loads argparse, json and socket.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from functools import partial
from typing import Final

from bench.calibration import Beside
from bench.commit_probe import at_rest, command_ns, first_octet_ns, opening_ns, plain_ns, running, slaves_up
from bench.masters import DRIVERS
from bench.options import count, slaves
from bench.plant.programs import free_port
from bench.report import Report
from bench.rig import available, pinned

#: CPU time of a plain command at most, as a ratio
_PLAIN_GOAL: Final = 1.6
_KIB_PER_MB: Final = 1024
#: their tables; nobody listens at the port of the broker
_CONNECTORS: Final = {
    "no connector": "",
    "mqtt": '[mqtt]\nurl = "mqtt://127.0.0.1:{port}"\ngroup = "bench"\n',
    "mqtt, homeassistant": '[mqtt]\nurl = "mqtt://127.0.0.1:{port}"\ngroup = "bench"\nformat = "json"\n'
    'discovery = "homeassistant"\n',
    "metrics": '[metrics]\nlisten = "127.0.0.1:{port}"\n',
    "opcua": '[opcua]\nlisten = "127.0.0.1:{port}"\nanonymous = "read"\n',
    "epics": '[epics]\nlisten = "127.0.0.1:{port}"\nprefix = "bench:"\n',
}


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench startup")
    parser.add_argument("--slaves", type=slaves, default=32)
    parser.add_argument("--rounds", type=count, default=9)
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS)
    parser.add_argument("--connectors", nargs="*", choices=[*_CONNECTORS, "all"], default=[])
    args = parser.parse_args(argv)
    report = Report("startup")
    with pinned() as where:
        report.notes.append(where.text)
        kinds = available(args.kinds, report.notes)
        beside = Beside()
        cpu: dict[str, list[tuple[float, float]]] = {}
        memory: dict[str, list[float]] = {}
        for _ in range(args.rounds):
            cpu.setdefault("dpstack --version: CPU time", []).append(beside(partial(command_ns, "--version")))
            for kind in kinds:
                for way, measure in (("dpstack run", first_octet_ns), ("open_bus", opening_ns)):
                    title = f"{way}, {kind}, until the first octet: CPU time"
                    cpu.setdefault(title, []).append(beside(partial(measure, kind)))
                title = f"{kind}, {args.slaves} slaves in data exchange"
                (_, spent, kib), loop = beside(partial(slaves_up, kind, args.slaves))
                cpu.setdefault(f"{title}: CPU time", []).append((spent, loop))
                memory.setdefault(f"{title}: PSS", []).append(kib / _KIB_PER_MB)
        with running() as name:
            plain = _beside_plain({"--version": "--version", "ctl status": f"ctl {name} status"}, args.rounds)
        chosen = {name: _CONNECTORS[name] for name in _CONNECTORS if {name, "all"} & set(args.connectors)}
        with tempfile.TemporaryDirectory(prefix="dpstack-bench-") as state:
            for name, table in chosen.items():
                if name == "opcua":
                    at_rest(table.format(port=free_port()), state)  # its first start makes a certificate
                for _ in range(args.rounds):
                    (spent, pss), loop = beside(partial(at_rest, table.format(port=free_port()), state))
                    cpu.setdefault(f"{name}: CPU time of the application", []).append((spent, loop))
                    for whose, kib in (("of the application", pss[0]), ("with its bus process", sum(pss))):
                        memory.setdefault(f"{name}: PSS {whose}", []).append(kib / _KIB_PER_MB)
        report.calibrated("Python", beside.loops)
        for words, ratios in plain.items():
            title = f"dpstack {words}: CPU time beside python -c 'import argparse, json, socket'"
            report.measured(title, ratios, "ratio", _PLAIN_GOAL)
        for title, taken in cpu.items():
            report.in_loops(title, taken)
        for title, sizes in memory.items():
            report.measured(title, sizes, "MB")
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
