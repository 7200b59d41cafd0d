"""Cost of one exchange at the master, from 1 to 100 slaves: on a medium that costs nothing, and over a pty.

The cost of an exchange must not depend on how many slaves there are. Once a round come the token to itself and what a
round begins and ends with; with one slave that is once an exchange. So beside the mean there is the cost of *one slave
more*: (a round's cost - that of one slave's round) / (slaves - 1).
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from bench.calibration import Beside
from bench.null_medium import NullBus
from bench.options import count, slaves
from bench.report import Report
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.line.asyncio_runtime import AsyncioRuntime
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.port_latency import patience_of
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams
from dpstack.ports.pty import PtyPort
from dpstack.trace import Event

_RESPONDER: Final = Path(__file__).resolve().parent.parent / "tests" / "kits" / "support_responder.py"
_PTY_BAUD: Final = 12_000_000
_FIRST: Final = 3
#: cost of an exchange with the most slaves to that with one
_GOAL: Final = 1.1
_WITHIN_S: Final = 60


@contextlib.contextmanager
def _responder(path: str, slaves: int) -> Iterator[None]:
    specs = [f"{_FIRST + i}:0696:f3f1:12:12" for i in range(slaves)]
    with subprocess.Popen([sys.executable, str(_RESPONDER), path, *specs], stdout=subprocess.PIPE) as process:
        try:
            if process.stdout is None or not process.stdout.readline():
                raise RuntimeError("the responder did not start")
            yield
        finally:
            process.kill()


async def over_pty(slaves: int, seconds: float) -> float:
    """CPU time in ns of one exchange: the asyncio driver, a pty, 12 Mbit/s parameters, the other end a process."""
    params = BusParams.preset(_PTY_BAUD, address=2, gap=0)
    port = PtyPort(_PTY_BAUD)
    patience = patience_of(port)
    setups = [SlaveParams(address=_FIRST + i, name=f"s{i}", ident=0x0696, config=b"\xf3\xf1") for i in range(slaves)]
    master = Master(params, setups, MasterSettings(watchdog_ms=5_000, absent_divisor=patience.unknown_divisor))
    handlers = master.handlers.values()
    up = asyncio.Event()

    def on_events(_: list[Event]) -> None:
        if all(h.state is SlaveState.DATA_EXCHANGE for h in handlers):
            up.set()

    runtime = AsyncioRuntime(port, ActiveStation(params, [master], patience=patience), on_events, echo=Echo.OFF)
    await runtime.open()
    try:
        with _responder(port.name, slaves):
            runtime.command(GoOnline())
            runtime.command(SetMode(Mode.OPERATE))
            await asyncio.wait_for(up.wait(), _WITHIN_S)
            await asyncio.sleep(seconds / 4)
            done, cpu = sum(h.exchanges for h in handlers), time.process_time_ns()
            await asyncio.sleep(seconds)
            cpu = time.process_time_ns() - cpu
            done = sum(h.exchanges for h in handlers) - done
    finally:
        await runtime.close()
    if not done:
        raise RuntimeError("no data were exchanged over the pty")
    return cpu / done


def _over_pty(slaves: int, seconds: float) -> float:
    return asyncio.run(over_pty(slaves, seconds))


def run(argv: Sequence[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench scale")
    parser.add_argument("--slaves", type=slaves, nargs="*", default=[1, 3, 10, 32, 100])
    parser.add_argument("--exchanges", type=int, default=3_000, help="a round on the medium that costs nothing")
    parser.add_argument("--rounds", type=count, default=11, help="interleaved")
    parser.add_argument("--seconds", type=float, default=1.0, help="a round over the pty; 0: without a pty")
    parser.add_argument("--pty-rounds", type=count, default=3)
    args = parser.parse_args(argv)
    counts = sorted({1, *args.slaves})
    report = Report("scale")
    buses = {n: NullBus(n) for n in counts}
    for bus in buses.values():
        bus.bring_up()
    null: dict[int, list[tuple[float, float]]] = {n: [] for n in counts}
    pty: dict[int, list[tuple[float, float]]] = {n: [] for n in counts}
    beside = Beside()
    for _ in range(args.rounds):
        for n, bus in buses.items():
            null[n].append(beside(partial(bus.measure, args.exchanges)))
    if args.seconds and hasattr(os, "openpty"):
        for _ in range(args.pty_rounds):
            for n in counts:
                pty[n].append(beside(partial(_over_pty, n, args.seconds)))
    else:
        report.notes.append("without a pty")
    report.calibrated("Python", beside.loops)
    for medium, times in (("no medium", null), ("pty", pty)):
        for n, each in times.items():
            name = f"{medium}, {n} slave{'s' if n > 1 else ''}: CPU time"
            report.in_loops(f"{name} per exchange", each)
            if n > 1:
                pairs = list(zip(each, times[1], strict=True))
                ratios = [(ns / loop) / (one / one_loop) for (ns, loop), (one, one_loop) in pairs]
                report.measured(f"{name} per exchange to one slave's", ratios, "", _GOAL)
                more = [((n * ns - one * loop / one_loop) / (n - 1), loop) for (ns, loop), (one, one_loop) in pairs]
                report.in_loops(f"{name} of one slave more", more)
    return report
