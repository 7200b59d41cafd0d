"""Turn-around and CPU time per exchange: the asyncio driver at 12 Mbit/s parameters over a pty.

Turn-around is from the return of the read with an answer's last octet to the return of the write of the next request,
with every rule of the standard in force, T_ID1 among them. Once a round the token to itself lies between, with
a T_ID1 of its own: those turn-arounds are reported apart (with one slave there are no others). The other end is a
table of octets in a process of its own. Durations are multiples of the calibration loop of the same run.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Final

from bench.calibration import calibrate
from bench.report import Report, quantile
from dpstack.dp.commands import Mode, SetMode
from dpstack.dp.events import SlaveState
from dpstack.dp.master import Master
from dpstack.dp.setup import SlaveSetup
from dpstack.drivers.aio import AsyncioRuntime, patience_of
from dpstack.drivers.echo import Echo
from dpstack.fdl.active import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams
from dpstack.ports.pty import PtyPort
from dpstack.trace import Event

_BAUD: Final = 12_000_000
_PPO1: Final = bytes((0xF3, 0x71))
_RESPONDER: Final = Path(__file__).resolve().parent.parent / "tests" / "support_responder.py"
_TOKEN: Final = 0xDC
#: turn-around of the asyncio driver in calibration loops
_GOAL: Final = 45.0
_FIRST: Final = 3


class MeasuredPty(PtyPort):
    """A pty that notes when reads and writes return."""

    def __init__(self) -> None:
        super().__init__(_BAUD)
        self.turns: list[int] = []
        self.token_turns: list[int] = []
        self._read_at = 0
        self._token = False

    def _use(self, fd: int) -> None:
        super()._use(fd)
        read, send, clock = os.read, os.write, time.perf_counter_ns

        def timed_read(size: int) -> bytes:
            octets = read(fd, size)
            self._read_at = clock()
            return octets

        def timed_write(octets: bytes) -> int:
            done = send(fd, octets)
            now = clock()
            if octets[0] == _TOKEN:
                self._token = True
            elif self._read_at:
                (self.token_turns if self._token else self.turns).append(now - self._read_at)
                self._read_at = 0
                self._token = False
            return done

        self._read, self._send = timed_read, timed_write


def pin() -> tuple[str, int | None]:
    """Put this process on one processor; the other end gets the next one. (What was done, the other's processor)."""
    if not hasattr(os, "sched_setaffinity"):
        return "processors not pinned", None
    mine, *others = sorted(os.sched_getaffinity(0))
    if not others:
        return "one processor for both ends", None
    os.sched_setaffinity(0, {mine})
    return f"master on processor {mine}, responder on processor {others[0]}", others[0]


@contextlib.contextmanager
def responder(path: str, slaves: int, processor: int | None) -> Iterator[None]:
    """The other end in a process of its own."""
    specs = [f"{_FIRST + i}:0696:f371:12:12" for i in range(slaves)]
    with subprocess.Popen([sys.executable, str(_RESPONDER), path, *specs], stdout=subprocess.PIPE) as process:
        if processor is not None:
            os.sched_setaffinity(process.pid, {processor})
        try:
            if process.stdout is None or not process.stdout.readline():
                raise RuntimeError("the responder did not start")
            yield
        finally:
            process.kill()


@dataclass
class Run:
    """One measurement: turn-arounds in ns without and with the token between, CPU time in ns, exchanges."""

    turns: list[int]
    token_turns: list[int]
    cpu: int
    exchanges: int


async def measure(slaves: int, seconds: float, processor: int | None) -> Run:
    """One measurement with ``slaves`` in data exchange."""
    params = BusParams.preset(_BAUD, address=2, gap=0)
    setups = [SlaveSetup(address=_FIRST + i, name=f"s{i}", ident=0x0696, config=_PPO1) for i in range(slaves)]
    port = MeasuredPty()
    patience = patience_of(port)
    master = Master(params, setups, watchdog_ms=1000, absent_share=patience.unknown_share)
    station = ActiveStation(params, [master], patience=patience)
    events: list[Event] = []
    all_up = asyncio.Event()

    def on_events(new: list[Event]) -> None:
        events.extend(new)
        if all(h.state is SlaveState.DATA_EXCHANGE for h in master.handlers.values()):
            all_up.set()

    runtime = AsyncioRuntime(port, station, on_events, echo=Echo.OFF)
    await runtime.open()
    try:
        with responder(port.name, slaves, processor):
            runtime.command(GoOnline())
            runtime.command(SetMode(Mode.OPERATE))
            await asyncio.wait_for(all_up.wait(), 10)
            await asyncio.sleep(seconds / 4)
            before = sum(h.exchanges for h in master.handlers.values())
            port.turns.clear()
            port.token_turns.clear()
            cpu = time.process_time_ns()
            await asyncio.sleep(seconds)
            cpu = time.process_time_ns() - cpu
            done = sum(h.exchanges for h in master.handlers.values()) - before
            if any(h.state is not SlaveState.DATA_EXCHANGE for h in master.handlers.values()):
                raise RuntimeError("a slave was lost during the measurement: " + "; ".join(e.text for e in events[-5:]))
            return Run(port.turns, port.token_turns, cpu, done)
    finally:
        await runtime.close()


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench cycle")
    parser.add_argument("--slaves", type=int, nargs="*", default=[1, 4, 16])
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--rounds", type=int, default=3, help="runs per number of slaves; the median is reported")
    args = parser.parse_args(argv)
    pinned, processor = pin()
    report = Report("cycle", notes=[pinned])
    loops: list[float] = []
    results: dict[int, list[Run]] = {n: [] for n in args.slaves}
    for _ in range(args.rounds):
        loops.append(calibrate())
        for n in args.slaves:
            results[n].append(asyncio.run(measure(n, args.seconds, processor)))
    loop = median(loops)
    report.add("calibration loop", loop / 1000, "us")
    for n, runs in results.items():
        title = f"asyncio, {n} slave{'s' if n > 1 else ''}"
        # with one slave only those before a Global_Control are left: too few, and another thing
        plain = [r.turns for r in runs if len(r.turns) > len(r.token_turns) // 2]
        if plain:
            report.add(f"{title}: turn-around p50", median(quantile(t, 0.5) for t in plain) / loop, "loops", _GOAL)
            report.add(f"{title}: turn-around p99", median(quantile(t, 0.99) for t in plain) / loop, "loops")
        with_token = median(quantile(r.token_turns, 0.5) for r in runs) / loop
        report.add(f"{title}: with the token to itself between p50", with_token, "loops")
        cpu = median(r.cpu / max(r.exchanges, 1) for r in runs) / loop
        report.add(f"{title}: CPU time per exchange", cpu, "loops")
        report.add(f"{title}: exchanges per second", median(r.exchanges for r in runs) / args.seconds, "1/s")
    idle = BusParams.preset(_BAUD).t_id1
    report.notes.append(f"T_ID1 = {idle} bit times = {idle / 12:.1f} us is part of every turn-around")
    return report
