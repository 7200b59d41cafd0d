"""Many gateways against a real broker on this computer: messages, CPU time, memory, time to DDEATH, recovery.

Two gateways (``--buses``) are programs of their own, each with a real bus: driver process, ten simulated slaves on a
pty. The others are gateways in a few processes, each fed by the recorded live stream of a simulated bus at real speed,
with node id, client id, session file, connection and will of its own. The broker is mosquitto. One subscriber notes
every message with its time of arrival; all clocks are CLOCK_MONOTONIC of this computer. In order:

1. gateways without a connector: CPU time and memory of gateway and tree alone
2. steady traffic: messages, octets, CPU time of all programs, memory of a gateway
3. losses: a slave of a bus loses its power again and again; meanwhile those of the recorded streams go on
4. the broker is killed, and started again ``--down`` seconds later: time until every gateway has its births again
5. one process of gateways is killed: time until their NDEATH

Then a host of Sparkplug B judges the order of all messages.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import pickle
import random
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from bench.options import count, duration, slaves
from bench.plant.judge import Message, Verdict, judge
from bench.plant.programs import Mosquitto, Program, ending, rss_kib, wait_for
from bench.plant.stream import FIRST, GROUP, INTERVAL_S, OFF_S, Recording, device_name, node_name, record
from bench.report import Report, quantile

#: s for births of all gateways
_BIRTHS_S: Final = 120.0
#: s between steady traffic and what came before
_SETTLE_S: Final = 3.0
#: s of a loss, and s until the next one; each up to twice as long
_LOST_S: Final = 0.6
_BACK_S: Final = 1.0
#: s within which a DDEATH, an NDEATH or a DBIRTH follows
_FOLLOWS_S: Final = 10.0
#: s behind which a gateway takes a session for a good one, so that its pauses begin anew
_GOOD_S: Final = 31.0
_RECORDED_LOSSES: Final = 4
_RECORDED_S: Final = 60.0
_KINDS: Final = ("NBIRTH", "DBIRTH", "NDATA", "DDATA", "DDEATH", "NDEATH", "status")
_S: Final = 1e9


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench fleet")
    parser.add_argument("--gateways", type=count, default=50)
    parser.add_argument("--buses", type=int, choices=(0, 1, 2), default=2, help="of them, with real buses")
    parser.add_argument("--slaves", type=slaves, default=10, help="of a gateway")
    parser.add_argument("--processes", type=count, default=4, help="for the gateways with recorded streams")
    parser.add_argument("--seconds", type=duration, default=60.0, help="of steady traffic")
    parser.add_argument("--losses", type=count, default=200, help="of slaves on the buses, in all")
    parser.add_argument("--restarts", type=count, default=3, help="of the broker")
    parser.add_argument("--down", type=duration, default=5.0, help="s from the end of the broker to its start")
    parser.add_argument("--interval-ms", type=count, default=1000, help="the key of [mqtt]")
    parser.add_argument("--recorded", type=duration, default=_RECORDED_S, help="s of the recorded stream")
    args = parser.parse_args(argv)
    args.buses = min(args.buses, args.gateways)
    args.processes = max(1, min(args.processes, args.gateways - args.buses))
    report = Report("fleet")
    with tempfile.TemporaryDirectory(prefix="dpstack-bench-") as folder, contextlib.ExitStack() as stack:
        recording = record(args.slaves, args.recorded, _RECORDED_LOSSES)
        path = Path(folder) / "recording"
        path.write_bytes(pickle.dumps(recording))
        alone = _without_connectors(args, path, folder)
        broker = Mosquitto(Path(folder))
        _Run(args, recording, path, broker, stack, report, alone).measure()
    report.notes += [
        f"{args.gateways} gateways of {args.slaves} slaves: {args.buses} with a bus of their own, the others in "
        f"{args.processes} processes; mosquitto on this computer, QoS 0, without TLS; interval_ms = {args.interval_ms}",
        "four named inputs of eight octets, two named outputs a slave; three values of four always move",
    ]
    return report


def _without_connectors(args: argparse.Namespace, recording: Path, folder: str) -> tuple[float, float]:
    """Percent of a processor, and KiB, of one gateway with its tree alone."""
    number = -(-(args.gateways - args.buses) // args.processes)
    if not number:
        return 0.0, 0.0
    seconds = min(args.seconds, 20.0)
    with ending(Program.of_module("gateways", recording, folder, 0, number, 0, args.interval_ms)) as program:
        before_kib = program.line()["rss_kib"]
        time.sleep(INTERVAL_S + min(_SETTLE_S, args.seconds))
        (before,) = program.cpu_s()
        time.sleep(seconds)
        (after,) = program.cpu_s()
        kib = rss_kib(program.pid) - before_kib
    return 100 * (after - before) / seconds / number, kib / number


class _Run:
    """All programs of a run, and the figures."""

    def __init__(
        self,
        args: argparse.Namespace,
        recording: Recording,
        path: Path,
        broker: Mosquitto,
        stack: contextlib.ExitStack,
        report: Report,
        alone: tuple[float, float],
    ) -> None:
        self._args = args
        self._recording = recording
        self._broker = broker
        self._report = report
        self._alone = alone
        self._folder = path.parent
        self._messages = self._folder / "messages"
        stack.callback(lambda: broker.program.kill())
        port, interval = broker.port, args.interval_ms
        self._subscriber = stack.enter_context(ending(Program.of_module("subscriber", port, self._messages)))
        wait_for(lambda: self._state()["subscribed"], "the subscription", 10.0)
        self._plants = [
            stack.enter_context(ending(Program.of_module("slaves", args.slaves))) for _ in range(args.buses)
        ]
        self._buses = [
            stack.enter_context(
                ending(
                    Program.of_module(
                        "bus", plant.line()["port"], node_name(n), args.slaves, port, interval,
                        env=_environment(self._folder),
                    )
                )
            )
            for n, plant in enumerate(self._plants)
        ]  # fmt: skip
        for bus in self._buses:
            bus.line()
        self._parts = list(parts(args.buses, args.gateways, args.processes))
        self._fleets = [
            stack.enter_context(
                ending(Program.of_module("gateways", path, self._folder, first, number, port, interval))
            )
            for first, number in self._parts
        ]
        self._rss_before = [fleet.line()["rss_kib"] for fleet in self._fleets]
        #: node, device, since when: a slave had no power; the master, or the stream, declared it lost
        self._off: list[tuple[str, str, int]] = []
        self._declared: list[tuple[str, str, int]] = []
        self._streamed: list[tuple[str, str, int]] = []
        self._windows: dict[str, tuple[int, int]] = {}

    def _state(self) -> dict[str, Any]:
        state: dict[str, Any] = self._subscriber.ask("state")
        return state

    def _all_born(self) -> bool:
        state = self._state()
        # of the recorded streams, now and then a slave is lost
        few = self._args.gateways * self._args.slaves * (1 - OFF_S * _RECORDED_LOSSES / self._recording.seconds) * 0.95
        return bool(state["nodes"] == self._args.gateways and state["devices"] >= few)

    def measure(self) -> None:
        args = self._args
        wait_for(self._all_born, "births of all gateways", _BIRTHS_S)
        time.sleep(_SETTLE_S)
        with self._window("steady"):
            self._steady(args.seconds)
        self._memory()
        with self._window("losses"):
            self._lose(args.losses)
        back = [self._restart(number) for number in range(args.restarts)]
        killed = self._kill_one()
        for program in (*self._fleets, *self._buses):
            self._note_end(program.end())
        time.sleep(0.5)
        self._subscriber.ask("write")
        messages = [Message(*row) for row in pickle.loads(self._messages.read_bytes())]
        verdict = judge(messages, GROUP, self._windows)
        self._traffic(verdict)
        self._deaths(verdict)
        self._recovery(verdict, back)
        self._killed(verdict, killed)
        self._report.exact("breaches of Sparkplug B that the host found", verdict.breaches, "", goal=0)
        self._report.exact("NDEATH whose bdSeq is not that of the last NBIRTH", verdict.unpaired, "", goal=0)
        self._report.exact("messages that the host could not judge, as a birth was missed", verdict.unjudged, "")
        self._report.exact("values of history that came after restarts of the broker", verdict.historical, "")
        self._report.notes += verdict.faults

    @contextlib.contextmanager
    def _window(self, name: str) -> Iterator[None]:
        begin = time.monotonic_ns()
        yield
        self._windows[name] = (begin, time.monotonic_ns())

    # --- steady traffic -------------------------------------------------------------------------------------------

    def _steady(self, seconds: float) -> None:
        programs = {
            "fleets": self._fleets,
            "buses": self._buses,
            "broker": [self._broker.program],
            "subscriber": [self._subscriber],
        }
        waited = sum(one.waited_s() for ones in programs.values() for one in ones)
        exchanges = [bus.ask("")["exchanges"] for bus in self._buses]
        before = {name: [one.cpu_s() for one in ones] for name, ones in programs.items()}
        began = time.monotonic()
        time.sleep(seconds)
        took = time.monotonic() - began
        spent = {
            name: [
                [100 * (now - then) / took for now, then in zip(one.cpu_s(), old, strict=True)]
                for one, old in zip(ones, before[name], strict=True)
            ]
            for name, ones in programs.items()
        }
        ran = sum(sum(one) for ones in spent.values() for one in ones) * took / 100
        waited = sum(one.waited_s() for ones in programs.values() for one in ones) - waited
        self._report.notes.append(
            f"of the time in which the programs could run, they waited {waited / (waited + ran):.0%} for a processor"
        )
        exchanges = [bus.ask("")["exchanges"] - old for bus, old in zip(self._buses, exchanges, strict=True)]
        self._report.measured("exchanges on a bus", [one / took for one in exchanges], "1/s", more=True)
        add, replayed = self._report.add, self._args.gateways - self._args.buses
        if replayed:
            all_of = sum(sum(one) for one in spent["fleets"]) / replayed
            add("CPU of a gateway with a recorded stream, all", all_of, "% of a processor")
            add("CPU of a gateway with a recorded stream, stream and tree alone", self._alone[0], "% of a processor")
            add("CPU of a gateway with a recorded stream, so MQTT", all_of - self._alone[0], "% of a processor")
        own = [one[0] for one in spent["buses"]]
        self._report.measured("CPU of a gateway with a bus, its own process", own, "% of a processor")
        of_bus = [sum(one[1:]) for one in spent["buses"]]
        self._report.measured("CPU of a gateway with a bus, the process of the bus", of_bus, "% of a processor")
        add("CPU of the broker", spent["broker"][0][0], "% of a processor")
        add("CPU of the subscriber", spent["subscriber"][0][0], "% of a processor")

    def _memory(self) -> None:
        grown = [rss_kib(one.pid) - old for one, old in zip(self._fleets, self._rss_before, strict=True)]
        replayed = self._args.gateways - self._args.buses
        if replayed:
            kib = sum(grown) / replayed
            self._report.add("memory of a gateway in a process of many, all", kib, "KiB")
            self._report.add("memory of a gateway in a process of many, so MQTT", kib - self._alone[1], "KiB")
        for name, place in (("its own process", 0), ("the process of the bus", 1)):
            found = [rss_kib(one.pids()[place]) / 1024 for one in self._buses if len(one.pids()) > place]
            self._report.measured(f"memory of a gateway with a bus, {name}", found, "MiB")
        self._report.add("memory of the broker", rss_kib(self._broker.program.pid) / 1024, "MiB")

    def _traffic(self, verdict: Verdict) -> None:
        begin, end = self._windows["steady"]
        seconds = (end - begin) / _S
        found = verdict.windows["steady"]
        add = self._report.add
        add("messages", sum(number for number, _ in found.values()) / seconds, "1/s", more=True)
        add("octets of MQTT", sum(octets for _, octets in found.values()) / seconds, "octets/s")
        add("values in data", verdict.metrics["steady"] / seconds, "1/s", more=True)
        for kind in _KINDS:
            if kind in found:
                add(f"{kind}: messages", found[kind][0] / seconds, "1/s")
                add(f"{kind}: octets a message", found[kind][1] / found[kind][0], "octets")
        for kind, (values, octets) in verdict.largest.items():
            add(f"{kind}, the largest: metrics", values, "")
            add(f"{kind}, the largest: octets", octets, "octets")

    # --- losses ---------------------------------------------------------------------------------------------------

    def _lose(self, losses: int) -> None:
        """Take the power of slaves of the buses in turn, and give it back."""
        chance = random.Random(1)
        self._collect()
        self._declared.clear()
        self._streamed.clear()
        if not self._plants:
            time.sleep(min(losses, self._recording.seconds))
        for number in range(-(-losses // len(self._plants)) if self._plants else 0):
            address = FIRST + number % self._args.slaves
            for place, plant in enumerate(self._plants):
                self._off.append((node_name(place), device_name(address), plant.ask(f"off {address}")))
                time.sleep(chance.uniform(0, INTERVAL_S))
            time.sleep(_LOST_S * chance.uniform(1, 2))
            for plant in self._plants:
                plant.ask(f"on {address}")
            time.sleep(_BACK_S * chance.uniform(1, 2))
        time.sleep(1.0)
        self._collect()

    def _collect(self) -> None:
        for number, bus in enumerate(self._buses):
            lost = bus.ask("")["lost"]
            self._declared += [(node_name(number), device_name(address), at) for address, at in lost]
        for fleet in self._fleets:
            self._streamed += [(node, device_name(address), at) for node, address, at in fleet.ask("")]

    def _deaths(self, verdict: Verdict) -> None:
        for name, begins in (
            ("from the loss of a slave's power", self._off),
            ("from the master's event", self._declared),
            ("from the snapshot of a recorded stream", self._streamed),
        ):
            times = followed(begins, verdict.deaths, _FOLLOWS_S)
            if times:
                self._times(f"DDEATH at the subscriber, {name}", times)
            if len(times) < len(begins):
                self._report.add(f"no DDEATH, {name}", len(begins) - len(times), "", goal=0)

    def _times(self, title: str, times: Sequence[float]) -> None:
        for name, q in (("p50", 0.5), ("p99", 0.99), ("max", 1.0)):
            self._report.add(f"{title}: {name}", 1000 * quantile(times, q), "ms")
        self._report.add(f"{title}: samples", len(times), "")

    # --- restart and kill -----------------------------------------------------------------------------------------

    def _restart(self, number: int) -> int:
        """Kill the broker, start it again; the time at which it took connections."""
        self._broker.program.kill()
        time.sleep(self._args.down)
        began = self._broker.start()
        with self._window(f"restart {number}"):
            wait_for(self._all_born, "births of all gateways after the restart of the broker", _BIRTHS_S)
            self._report.notes += [
                f"restart {number + 1}: the subscriber asked {asked} gateways for births that it had missed"
                for asked in [self._state()["asked"]]
                if asked
            ]
            time.sleep(_SETTLE_S)
        if number + 1 < self._args.restarts:
            time.sleep(_GOOD_S)
        return began

    def _recovery(self, verdict: Verdict, back: Sequence[int]) -> None:
        times: list[float] = []
        last: list[float] = []
        for number, began in enumerate(back):
            _, end = self._windows[f"restart {number}"]
            complete: dict[str, int] = {}
            for node, _, at in verdict.births:
                if began <= at < end:
                    complete.setdefault(node, at)
            for node, device, at in verdict.births:
                # devices that come later were lost meanwhile
                if device and node in complete and complete[node] <= at < complete[node] + _S:
                    complete[node] = at
            found = [(at - began) / _S for at in complete.values()]
            times += found
            last += [max(found)]
        title = "broker back to births of a gateway"
        self._report.add(f"{title}: p50", quantile(times, 0.5), "s")
        self._report.measured(f"{title}: the last one", last, "s")
        self._report.add(f"{title}: samples", len(times), "")
        peaks = [float(verdict.peaks[f"restart {number}"]) for number in range(len(back))]
        self._report.measured("messages in the busiest second after a restart", peaks, "1/s")

    def _kill_one(self) -> tuple[int, list[str]] | None:
        """Kill the last process of gateways: when, and their nodes."""
        if not self._fleets:
            return None
        first, number = self._parts.pop()
        killed = time.monotonic_ns()
        self._fleets.pop().kill()
        time.sleep(_SETTLE_S)
        return killed, [node_name(first + n) for n in range(number)]

    def _killed(self, verdict: Verdict, killed: tuple[int, list[str]] | None) -> None:
        if killed is None:
            return
        at, nodes = killed
        times = followed([(node, "", at) for node in nodes], verdict.deaths, _FOLLOWS_S)
        self._times("NDEATH by the broker, from SIGKILL of the gateway", times)
        if len(times) < len(nodes):
            self._report.add("no NDEATH by the broker", len(nodes) - len(times), "", goal=0)

    def _note_end(self, told: Sequence[dict[str, Any]]) -> None:
        for one in told:
            self._report.notes += [f"a gateway has failed: {text}" for text in one.get("failed", ())]


def _environment(folder: Path) -> dict[str, str]:
    return os.environ | {"XDG_STATE_HOME": str(folder)}


def parts(first: int, end: int, processes: int) -> Iterator[tuple[int, int]]:
    """The gateways ``first`` to ``end`` in parts as equal as can be: the first one and the number of each."""
    for place in range(processes):
        here = first + (end - first) * place // processes
        after = first + (end - first) * (place + 1) // processes
        if after > here:
            yield here, after - here


def followed(
    begins: Sequence[tuple[str, str, int]], deaths: Sequence[tuple[str, str, int]], limit_s: float
) -> list[float]:
    """s from each begin to the first death of the same node and device behind it, within ``limit_s``."""
    found: list[float] = []
    for node, device, begin in begins:
        times = [at - begin for of, name, at in deaths if (of, name) == (node, device) and at >= begin]
        if times and min(times) < limit_s * _S:
            found.append(min(times) / _S)
    return found
