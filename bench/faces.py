"""The face of MQTT beside a bus: CPU time per exchange of the master with it and without, in turn.

Each slave has four named values. The broker is one of these:

- ``mosquitto``: the real one, where it is installed
- ``stuck``: a TCP port that takes connections, and never reads nor answers
- ``gone``: a TCP port on which nobody listens

The wire and the masters are those of the benchmark ``record``. With the driver process the bus's own process is
measured for itself; the goal is about that one.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
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
#: CPU time per exchange of the bus's own process with a face to that without one
_GOAL: Final = 1.05
#: after a face has begun or ended
_SETTLE_S: Final = 1.5
BROKERS: Final = ("mosquitto", "stuck", "gone")


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench faces")
    parser.add_argument("--bauds", type=int, nargs="*", default=_BAUDS)
    parser.add_argument("--slaves", type=slaves, default=10)
    parser.add_argument("--seconds", type=duration, default=1.0, help="of one slice")
    parser.add_argument("--rounds", type=count, default=15, help="slices with and without the face in turn")
    parser.add_argument("--brokers", nargs="*", choices=BROKERS, default=BROKERS)
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS)
    args = parser.parse_args(argv)
    report = Report("faces")
    if "mosquitto" in args.brokers and shutil.which("mosquitto") is None:
        report.notes.append("mosquitto is left out: it is not installed")
        args.brokers = [one for one in args.brokers if one != "mosquitto"]
    with pinned() as where:
        report.notes.append(where.text)
        for baud in args.bauds:
            for kind in available(args.kinds, report.notes):
                for broker in args.brokers:
                    _at(report, kind, baud, broker, args, where)
    return report


def _at(report: Report, kind: str, baud: int, broker: str, args: argparse.Namespace, where: Processors) -> None:
    """One master, whose face comes and goes."""
    slices: dict[str, list[tuple[int, int, int]]] = {"on": [], "off": []}
    with tempfile.TemporaryDirectory(prefix="dpstack-bench-") as folder, _broker(broker, Path(folder)) as port:
        mqtt = {"url": f"mqtt://127.0.0.1:{port}", "group": "bench", "interval_ms": 100}
        env = os.environ | {"XDG_STATE_HOME": folder}
        words = ["--faces", json.dumps({"mqtt": mqtt})]
        with bench(kind, args.slaves, baud, where, paced=baud <= _PACED, gap=0, env=env, more=words) as running:
            for number in range(args.rounds):
                for order in ("off", "on") if number % 2 else ("on", "off"):
                    running.switch(on=order == "on")
                    time.sleep(_SETTLE_S)
                    slices[order].append(running.cpu_slices(args.seconds))
            running.switch(on=False)
            time.sleep(_SETTLE_S)
            waited = running.measure(args.seconds)
    title = f"{baud_text(baud)}, {kind}, broker {broker}"
    for name, place in (("", 0), (" of the bus's own process", 1))[: 2 if kind == "process" else 1]:
        # a slice in which the master did not run at all says nothing
        pairs = [both for both in zip(slices["on"], slices["off"], strict=True) if all(o[2] and o[place] for o in both)]
        costs = {order: [both[n][place] / both[n][2] for both in pairs] for n, order in enumerate(slices)}
        report.measured(f"{title}: CPU time per exchange{name}", [ns / 1000 for ns in costs["off"]], "us")
        ratios = [with_one / without for with_one, without in zip(costs["on"], costs["off"], strict=True)]
        text = f"{title}: CPU time per exchange{name} with a face to without"
        report.measured(text, ratios, "ratio", _GOAL if place else None)
        low, high = interval(ratios)
        report.notes.append(f"{text}: the median lies between {low:.3f} and {high:.3f} (99 %)")
    for order, taken in slices.items():
        rate = sum(count for _, _, count in taken) / (len(taken) * args.seconds)
        report.add(f"{title}: exchanges per second, face {order}", rate, "1/s", more=True)
    note_disturbance(report, [waited], title)


@contextlib.contextmanager
def _broker(kind: str, folder: Path) -> Iterator[int]:
    """The port of a broker of ``kind``."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = int(one.getsockname()[1])
        if kind == "stuck":
            one.listen()
            yield port
            return
    if kind == "gone":
        yield port
        return
    config = folder / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n", encoding="utf-8")
    quiet = subprocess.DEVNULL
    with subprocess.Popen(["mosquitto", "-c", str(config)], stdout=quiet, stderr=quiet) as broker:
        try:
            yield port
        finally:
            broker.kill()
