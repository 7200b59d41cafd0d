"""Lateness of an application's event loop: alone, and beside a bus that it reads and writes all the time.

The application is due every millisecond; lateness is how much later it comes. Every time it reads inputs and sets
outputs of all slaves, every tenth time it takes the statistics; orders are awaited one after the other meanwhile. In
*process, stopped* the bus process is stopped (SIGSTOP) during the measurement: nothing may wait for it.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import signal
from collections.abc import Callable
from time import monotonic_ns
from typing import Any, Final, Literal

from bench.masters import CONFIG, DRIVERS, FIRST, IDENT, OCTETS
from bench.options import count, duration, slaves
from bench.report import Report, quantile
from bench.rig import available, pinned, wire_with
from dpstack.api.bus.bus import core_of

_DUE_NS: Final = 1_000_000
_STATS_EVERY: Final = 10
_QUANTILES: Final = (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999), ("max", 1.0))
_READY_S: Final = 60.0
_ALONE: Final = "alone"
_STOPPED: Final = "process, stopped"


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench loop")
    parser.add_argument("--slaves", type=slaves, default=3)
    parser.add_argument("--baud", type=int, default=1_500_000)
    parser.add_argument("--seconds", type=duration, default=3.0, help="of one measurement")
    parser.add_argument("--rounds", type=count, default=3)
    args = parser.parse_args(argv)
    report = Report("loop")
    with pinned() as where:
        report.notes.append(where.text)
        kinds = available(DRIVERS, report.notes)
        late: dict[str, list[list[int]]] = {kind: [] for kind in (_ALONE, *kinds)}
        if "process" in kinds:
            late[_STOPPED] = []
        for _ in range(args.rounds):
            for kind, rounds in late.items():
                if kind == _ALONE:
                    rounds.append(asyncio.run(_lateness(lambda: None, args.seconds)))
                    continue
                with wire_with(args.slaves, args.baud, where.wire, paced=True) as (_, port):
                    rounds.append(asyncio.run(_beside_a_bus(kind, port, args.slaves, args.baud, args.seconds)))
        for kind, rounds in late.items():
            for name, q in _QUANTILES:
                report.measured(f"{kind}: lateness {name}", [quantile(one, q) / 1000 for one in rounds], "us")
    return report


async def _lateness(act: Callable[[], object], seconds: float) -> list[int]:
    """Lateness of each turn of the application in ns; it calls ``act`` in each turn."""
    late = []
    loop = asyncio.get_running_loop()
    end = monotonic_ns() + round(seconds * 1e9)
    while (now := monotonic_ns()) < end:
        due = now + _DUE_NS
        await asyncio.sleep(due / 1e9 - loop.time())
        late.append(max(0, monotonic_ns() - due))
        act()
    return late


async def _beside_a_bus(kind: str, port: str, slaves: int, baud: int, seconds: float) -> list[int]:
    from dpstack import open_bus

    tables: list[dict[str, Any]] = [
        {"name": f"s{n}", "address": FIRST + n, "ident": IDENT, "config": CONFIG.hex(" "), "watchdog_ms": 0}
        for n in range(slaves)
    ]
    driver: Literal["asyncio", "process"] = "asyncio" if kind == "asyncio" else "process"
    turns = 0
    async with open_bus(port=port, baud=baud, slaves=tables, driver=driver, after_stall="resume") as bus:
        await bus.operate()
        await bus.ready(_READY_S)

        def act() -> None:
            nonlocal turns
            turns += 1
            for slave in bus.slaves:
                slave.outputs = turns.to_bytes(OCTETS, "big")
                _ = slave.inputs, slave.inputs_valid, slave.state
            if turns % _STATS_EVERY == 0:
                _ = bus.stats

        async def order() -> None:
            while True:
                with contextlib.suppress(Exception):
                    await bus.operate()
                await asyncio.sleep(_DUE_NS / 1e9)

        ordering = asyncio.create_task(order())
        pid = getattr(core_of(bus).runtime, "pid", None)
        if kind == _STOPPED and pid is not None:
            os.kill(pid, signal.SIGSTOP)
        try:
            return await _lateness(act, seconds)
        finally:
            if kind == _STOPPED and pid is not None:
                os.kill(pid, signal.SIGCONT)
            ordering.cancel()
