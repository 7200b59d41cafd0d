"""The connectors beside a bus: CPU time per exchange of the master, messages a second and the rounds of a fixed cycle,
with all three connectors and without, in turn.

Each slave has four named values; the application writes an output of each ten times a second, which comes back as an
input. All connectors publish everything. Around them is one of these:

- ``well``: mosquitto, a scraper once a second, an OPC UA client that subscribes to everything
- ``gone``: nobody listens at the address of the broker
- ``stuck``: the broker takes connections, and never reads nor answers
- ``stopped``: mosquitto is stopped when the plant has been published, and answers no more
- ``hostile``: a broker that sends commands of up to a megabyte as fast as they are read
- ``greedy``: two clients that subscribe to everything, one of which never reads; four scrapers without a pause
- ``full``: the broker is gone, and the disk of the state is full (a file system of its own, which needs root)
- ``backlog``: mosquitto comes back when the connectors have kept values for a while, and history flows beside the
others

Those that need mosquitto are left out where it is not installed. The store of MQTT has its default size; its remarks
and the size of its file become notes.

The wire and the masters are those of the benchmark ``record``. With the driver process the bus's own process is
measured for itself; the goals are about that one. Two habits of the computer would change the figures more than the
connectors do, so they are the same with and without them, where that is permitted (root): no processor sleeps, as the
bus process has it for a fixed cycle; and the kernel's workers, which carry the octets of a pty, run beside the master,
because the wire spins and would hold them up, as no real one does.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from bench.jitter import Cycles, Lateness
from bench.masters import DRIVERS
from bench.options import count, duration, slaves
from bench.paired import interval
from bench.plant.backlog import Arrivals, Backlog
from bench.plant.programs import free_port, mosquitto, wait_for
from bench.report import Report
from bench.rig import NO_GAP, Bench, Process, Processors, available, bench, note_disturbance, pinned
from dpstack.bridge.mqtt.history_file import NAME
from dpstack.drivers.realtime.processors import AwakeProcessors
from dpstack.units import baud_text

_BAUDS: Final = (500_000, 12_000_000)
#: up to this rate the wire takes its time
_PACED: Final = 3_000_000
#: processors of the kernel's workers that have no own one, as a hexadecimal mask (Documentation/core-api/workqueue.rst)
_WORKERS: Final = Path("/sys/devices/virtual/workqueue/cpumask")
#: CPU time per exchange of the bus's own process with connectors to that without
_MOST_CPU: Final = 1.05
#: messages a second with connectors to those without
_LEAST_MESSAGES: Final = 0.95
#: after the connectors have begun or ended
_SETTLE_S: Final = 2.0
#: and where clients have to find the plant first
_SUBSCRIBE_S: Final = 5.0
#: octets of the file system that is filled
_DISK: Final = 1 << 20
#: s until the store has met the full disk: it writes once a second
_FULL_S: Final = 2.5
#: s without a broker: for the values of the backlog, of which the connectors keep the first ones; and before each slice
_KEEP_S: Final = 5.0
_OUTAGE_S: Final = 2.0
_BACKLOG: Final = 50_000
#: s from the return of the broker to the first values of the backlog
_BACK_S: Final = 60.0
#: s before the end of a slice at which history still came
_LAST_S: Final = 0.5
_GROUP, _NODE = "bench", "one"
AROUND: Final = ("well", "gone", "stuck", "stopped", "hostile", "greedy", "full", "backlog")
_CLIENTS: Final = {"well": ("scraper", "opcua"), "greedy": (*("scraper",) * 4, "opcua", "opcua-deaf")}
_BROKERS: Final = {"well": "mosquitto", "stopped": "mosquitto", "greedy": "mosquitto", "stuck": "stuck"}
#: those that need it
_MOSQUITTO: Final = {"backlog", *(around for around, kind in _BROKERS.items() if kind == "mosquitto")}


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench connectors")
    parser.add_argument("--bauds", type=int, nargs="*", default=_BAUDS)
    parser.add_argument("--slaves", type=slaves, default=10)
    parser.add_argument("--seconds", type=duration, default=1.0, help="of one slice")
    parser.add_argument("--rounds", type=count, default=10, help="slices with and without the connectors in turn")
    parser.add_argument("--around", nargs="*", choices=AROUND, default=AROUND, help="what is around the connectors")
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=("process",))
    parser.add_argument("--cycle-ms", type=duration, default=10.0, help="of the fixed cycle (default: %(default)s)")
    parser.add_argument("--cycle-baud", type=int, default=1_500_000, help="of the fixed cycle (default: %(default)s)")
    args = parser.parse_args(argv)
    report = Report("connectors")
    args.around = possible(args.around, report.notes)
    with pinned() as where, _steady(where) as but:
        report.notes.append(where.text + but)
        for kind in available(args.kinds, report.notes):
            for around in args.around:
                for baud in args.bauds:
                    _cpu(report, kind, baud, around, args, where)
                _cycles(report, kind, around, args, where)
    return report


def possible(around: Sequence[str], notes: list[str]) -> list[str]:
    """Those of ``around`` that can be made here; the others become a note."""
    left_out = [] if mosquitto() is not None else [one for one in around if one in _MOSQUITTO]
    if left_out:
        notes.append(f"{', '.join(left_out)}: left out, mosquitto is not installed")
    return [one for one in around if one not in left_out]


@contextlib.contextmanager
def _steady(where: Processors) -> Iterator[str]:
    """Within it no processor sleeps, and the kernel's workers are on the master's. Yields words for what is not
    so."""
    processors = AwakeProcessors()
    processors.hold(True)
    before = ""
    with contextlib.suppress(OSError):
        before = _WORKERS.read_text("ascii")
        if where.master is not None:
            _WORKERS.write_text(f"{1 << where.master:x}", "ascii")
    try:
        missing = [
            text
            for text, there in (("processors sleep", processors.is_held()), ("workers are anywhere", before))
            if not there
        ]
        yield f"; {', '.join(missing)}: no right to change it" if missing else ""
    finally:
        processors.hold(False)
        if before:
            _WORKERS.write_text(before, "ascii")


def _cpu(report: Report, kind: str, baud: int, around: str, args: argparse.Namespace, where: Processors) -> None:
    """CPU time and messages of one master, whose connectors come and go."""
    slices: dict[str, list[tuple[int, int, int]]] = {"on": [], "off": []}
    title = f"{baud_text(baud)}, {kind}, {around}"
    with _Plant(around, where, report.notes, title) as plant:
        if not plant.tables:
            return
        words = [*NO_GAP, "--connectors", json.dumps(plant.tables)]
        with bench(kind, args.slaves, baud, where, paced=baud <= _PACED, env=plant.environment, more=words) as running:
            for order in _orders(args.rounds):
                with plant.published(running, on=order == "on"):
                    slices[order].append(running.cpu_slices(args.seconds))
            waited = running.measure(args.seconds)
    for name, place in (("", 0), (" of the bus's own process", 1))[: 2 if kind == "process" else 1]:
        # a slice in which the master did not run at all says nothing
        pairs = [both for both in zip(slices["on"], slices["off"], strict=True) if all(o[2] and o[place] for o in both)]
        costs = {order: [both[n][place] / both[n][2] for both in pairs] for n, order in enumerate(slices)}
        report.measured(f"{title}: CPU time per exchange{name}", [ns / 1000 for ns in costs["off"]], "us")
        ratios = [with_them / without for with_them, without in zip(costs["on"], costs["off"], strict=True)]
        text = f"{title}: CPU time per exchange{name} with connectors to without"
        report.measured(text, ratios, "ratio", _MOST_CPU if place else None)
        _note_interval(report, text, ratios)
    rates = {order: [exchanges / args.seconds for _, _, exchanges in taken] for order, taken in slices.items()}
    report.measured(f"{title}: exchanges a second", rates["off"], "1/s", more=True)
    text = f"{title}: exchanges a second with connectors to without"
    ratios = [with_them / without for with_them, without in zip(rates["on"], rates["off"], strict=True) if without]
    report.measured(text, ratios, "ratio", _LEAST_MESSAGES if kind == "process" else None, more=True)
    _note_interval(report, text, ratios)
    note_disturbance(report, [waited], title)


def _cycles(report: Report, kind: str, around: str, args: argparse.Namespace, where: Processors) -> None:
    """Lateness and missed rounds of a fixed cycle of one master, whose connectors come and go."""
    title = f"{args.cycle_ms:g} ms, {kind}, {around}"
    lateness: dict[str, list[Lateness]] = {"on": [], "off": []}
    books: dict[str, list[Cycles]] = {"on": [], "off": []}
    with _Plant(around, where, report.notes, title) as plant:
        if not plant.tables:
            return
        words = ["--connectors", json.dumps(plant.tables)]
        with bench(
            kind, args.slaves, args.cycle_baud, where, cycle_ms=args.cycle_ms, env=plant.environment, more=words
        ) as running:
            for order in _orders(args.rounds):
                with plant.published(running, on=order == "on"):
                    taken = running.measure(args.seconds)
                    books[order].append(Cycles(*running.cycles(args.seconds)))
                lateness[order].append(Lateness(taken.records, args.cycle_ms, taken.due))
    for order, name in (("off", "without connectors"), ("on", "with connectors")):
        for quantile, q in (("p50", 0.5), ("p99", 0.99), ("max", 1.0)):
            found = [one.quantile_us(q) for one in lateness[order]]
            report.measured(f"{title}: lateness {quantile}, {name}", found, "us")
        report.measured(f"{title}: late and missed rounds, {name}", [one.percent for one in books[order]], "%")


def _orders(rounds: int) -> Iterator[str]:
    for number in range(rounds):
        yield from ("off", "on") if number % 2 else ("on", "off")


def _note_interval(report: Report, text: str, ratios: list[float]) -> None:
    low, high = interval(ratios)
    if high < float("inf"):
        report.notes.append(f"{text}: the median lies between {low:.3f} and {high:.3f} (99 %)")


class _Plant:
    """The surroundings of the connectors. ``tables``: the connectors, empty where these surroundings cannot be made
    here."""

    def __init__(self, around: str, where: Processors, notes: list[str], title: str) -> None:
        self.tables: dict[str, Any] = {}
        self.environment: dict[str, str] = {}
        self._around = around
        self._where = where
        self._notes = notes
        self._title = title
        self._stack = contextlib.ExitStack()
        self._folder = Path()
        self._port = 0
        self._broker: subprocess.Popen[bytes] | None = None
        self._ports = (free_port(), free_port())
        self._backlog: Backlog | None = None
        self._remarks: set[str] = set()
        self._largest = 0

    def __enter__(self) -> _Plant:
        with contextlib.ExitStack() as stack:
            self._folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="dpstack-bench-")))
            self.environment = os.environ | {"XDG_STATE_HOME": str(self._folder / "state")}
            (self._folder / "state").mkdir()
            if self._around == "full" and not self._make_disk(stack):
                return self
            self._port = self._begin_broker(stack)
            metrics, opcua = self._ports
            self.tables = {
                "mqtt": {"url": f"mqtt://127.0.0.1:{self._port}", "group": _GROUP, "node": _NODE, "interval_ms": 100},
                "metrics": {"listen": f"127.0.0.1:{metrics}"},
                "opcua": {"listen": f"127.0.0.1:{opcua}", "anonymous": "read"},
            }
            for name in _CLIENTS.get(self._around, ()):
                port = metrics if name == "scraper" else opcua
                self._begin(stack, name, port, ["--pause", "0" if self._around == "greedy" else "1"])
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
        if self._largest:
            self._notes.append(f"{self._title}: the store of MQTT had {self._largest} octets at most")
        self._notes += [f"{self._title}: {remark}" for remark in sorted(self._remarks)]

    @contextlib.contextmanager
    def published(self, running: Bench, *, on: bool) -> Iterator[None]:
        """Within it the connectors serve where ``on``, and what is around them does its worst."""
        if not on:
            time.sleep(_SETTLE_S)
            yield
            return
        if self._around == "backlog":
            self._wait_with_backlog(running)
        running.switch_connectors(on=True)
        with contextlib.ExitStack() as stack:
            stack.callback(self._end_connectors, running)
            if self._around == "backlog":
                stack.enter_context(self._broker_back())
            else:
                time.sleep(_SUBSCRIBE_S if self._around in _CLIENTS else _SETTLE_S)
            undo = self._do_worst()
            try:
                yield
            finally:
                if undo is not None:
                    undo()

    def _end_connectors(self, running: Bench) -> None:
        self._largest = max(self._largest, *(self._octets(NAME + suffix) for suffix in ("", "-wal")))
        place = str(self._store)
        self._remarks |= {text.replace(place, NAME) for text in running.switch_connectors(on=False) if place in text}

    @property
    def _store(self) -> Path:
        return self._folder / "state" / "dpstack" / f"{_GROUP}.{_NODE}" / NAME

    def _octets(self, name: str) -> int:
        try:
            return self._store.with_name(name).stat().st_size
        except OSError:
            return 0

    def _wait_with_backlog(self, running: Bench) -> None:
        """The values of an outage wait in the store."""
        if self._backlog is None:
            running.switch_connectors(on=True)
            time.sleep(_KEEP_S)
            running.switch_connectors(on=False)
            self._backlog = Backlog(self._store, _BACKLOG)
        self._backlog.put_back()

    @contextlib.contextmanager
    def _broker_back(self) -> Iterator[None]:
        """The broker comes after a while; then history flows. The values that arrive within the block become a note."""
        time.sleep(_OUTAGE_S)
        arrivals = Arrivals(_GROUP)
        with contextlib.ExitStack() as stack:
            self._begin_mosquitto(stack, self._port)
            stack.enter_context(arrivals.counting(self._port, _BACK_S, self._where.wire))
            wait_for(lambda: arrivals.historical, "history", _BACK_S)
            began, historical, live = time.monotonic(), arrivals.historical, arrivals.live
            yield
            ended = time.monotonic()
            over = (
                "" if arrivals.last > ended - _LAST_S else "; the backlog was over before the end: take shorter slices"
            )
            self._notes.append(
                f"{self._title}: in {ended - began:.1f} s {arrivals.historical - historical} values of history "
                f"arrived, and {arrivals.live - live} others{over}"
            )

    def _do_worst(self) -> Callable[[], object] | None:
        if self._around == "stopped" and self._broker is not None:
            broker = self._broker
            broker.send_signal(signal.SIGSTOP)
            return lambda: broker.send_signal(signal.SIGCONT)
        if self._around == "full":
            filler = self._folder / "state" / "filler"
            with contextlib.suppress(OSError), filler.open("wb", buffering=0) as full:
                while full.write(bytes(4096)):
                    pass
            time.sleep(_FULL_S)
            return lambda: filler.unlink(missing_ok=True)
        return None

    def _begin(self, stack: contextlib.ExitStack, kind: str, port: int, words: list[str]) -> None:
        """A program of :mod:`bench.plant.connector_ends`; its counts become a note."""
        program = Process(
            [sys.executable, "-m", "bench.plant.connector_ends", kind, str(port), *words], self._where.wire
        )

        def end() -> None:
            counts = next((line["counts"] for line in program.end() if "counts" in line), "it ended by itself")
            self._notes.append(f"{self._title}: {kind}: {counts}")

        stack.callback(end)

    def _begin_broker(self, stack: contextlib.ExitStack) -> int:
        port = free_port()
        kind = _BROKERS.get(self._around, "")
        if kind == "stuck":
            stuck = stack.enter_context(socket.socket())
            stuck.bind(("127.0.0.1", port))
            stuck.listen()
        elif kind == "mosquitto":
            self._begin_mosquitto(stack, port)
        elif self._around == "hostile":
            self._begin(stack, "hostile", port, [])
        return port

    def _begin_mosquitto(self, stack: contextlib.ExitStack, port: int) -> None:
        config = self._folder / "mosquitto.conf"
        config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n", encoding="utf-8")
        path, quiet = mosquitto(), subprocess.DEVNULL
        assert path is not None, "without it these surroundings are left out"
        self._broker = broker = subprocess.Popen([path, "-c", str(config)], stdout=quiet, stderr=quiet)
        if self._where.wire is not None:
            os.sched_setaffinity(broker.pid, {self._where.wire})
        stack.callback(broker.wait)
        stack.callback(broker.kill)

    def _make_disk(self, stack: contextlib.ExitStack) -> bool:
        """A small file system for the state. False where that is not permitted."""
        place = str(self._folder / "state")
        words = ["mount", "-t", "tmpfs", "-o", f"size={_DISK}", "tmpfs", place]
        try:
            subprocess.run(words, check=True, capture_output=True, text=True)
        except (OSError, subprocess.CalledProcessError) as error:
            why = (getattr(error, "stderr", "") or str(error)).strip()
            self._notes.append(f"{self._title}: left out, no file system can be made here: {why}")
            return False
        stack.callback(subprocess.run, ["umount", "-l", place], check=False, capture_output=True)
        return True
