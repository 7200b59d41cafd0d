"""The tap of a running program: its CPU time per exchange with a client and without one, in turn, and what the client
gets.

The wire of the other benchmarks: at 500 kbit/s it takes its time, at 12 Mbit/s its octets take none. The client is a
program of its own on the wire's processor, which makes transmissions of what it gets, as ``dpstack capture`` does.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import sys
import time
from typing import Final

from bench.masters import DRIVERS
from bench.paired import interval
from bench.report import Report
from bench.rig import Process, Processors, available, bench, note_disturbance, pinned
from dpstack.api.listen.listening import Listening, OctetsLost
from dpstack.capture.transmission import Transmission
from dpstack.errors import PortError
from dpstack.trace import Event
from dpstack.units import baud_text

_BAUDS: Final = (500_000, 12_000_000)
#: up to this rate the wire takes its time
_PACED: Final = 3_000_000
#: CPU time per exchange with a client to that without one
_GOAL: Final = 1.05
#: after a client has come or gone
_SETTLE_S: Final = 0.05


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench tap")
    parser.add_argument("--bauds", type=int, nargs="*", default=_BAUDS)
    parser.add_argument("--slaves", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=0.2, help="of one slice")
    parser.add_argument("--rounds", type=int, default=60, help="slices with and without a client in turn")
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS)
    args = parser.parse_args(argv)
    report = Report("tap")
    with pinned() as where:
        report.notes.append(where.text)
        for baud in args.bauds:
            for kind in available(args.kinds, report.notes):
                _at(report, kind, baud, args, where)
    return report


def _at(report: Report, kind: str, baud: int, args: argparse.Namespace, where: Processors) -> None:
    """One master, one client that comes and goes."""
    slices: dict[str, list[tuple[int, int]]] = {"on": [], "off": []}
    with bench(kind, args.slaves, baud, where, paced=baud <= _PACED, gap=0, control=True) as running:
        client = Process([sys.executable, "-m", "bench.tap", str(running.facts["port"])], where.wire)
        try:
            for number in range(args.rounds):
                for order in ("off", "on") if number % 2 else ("on", "off"):
                    client.order(order)
                    answer = json.loads(client.line() or '{"error": "it ended"}')
                    if "error" in answer:
                        raise RuntimeError(f"the client of the tap: {answer['error']}")
                    time.sleep(_SETTLE_S)
                    slices[order].append(running.cpu_slice(args.seconds))
        finally:
            told = client.end()
        waited = running.measure(args.seconds)
    title = f"{baud_text(baud)}, {kind}"
    costs = {order: [cpu / max(count, 1) for cpu, count in taken] for order, taken in slices.items()}
    report.measured(f"{title}: CPU time per exchange", [ns / 1000 for ns in costs["off"]], "us")
    ratios = [with_client / without for with_client, without in zip(costs["on"], costs["off"], strict=True)]
    report.measured(f"{title}: CPU time per exchange with a client to without", ratios, "ratio", _GOAL)
    low, high = interval(ratios)
    report.notes.append(f"{title}: with a client to without, the median lies between {low:.3f} and {high:.3f} (99 %)")
    rates = [count / args.seconds for _, count in slices["on"]]
    report.measured(f"{title}: exchanges per second with a client", rates, "1/s", more=True)
    result = told[-1]
    report.add(f"{title}: transmissions that the client got", float(str(result["heard"])), "", more=True)
    report.add(f"{title}: chunks that the client lost", float(str(result["lost"])), "", 0)
    note_disturbance(report, [waited], title)


# --- the client, a process of its own: python -m bench.tap PORT ---


async def _listen(port: str) -> None:
    """Orders from standard input: ``on`` and ``off``. Answers each when it is carried out."""
    heard = lost = 0

    def on_transmission(one: Transmission) -> None:
        nonlocal heard
        heard += 1

    def on_event(event: Event) -> None:
        nonlocal lost
        if isinstance(event, OctetsLost):
            lost += event.count

    async with contextlib.AsyncExitStack() as stack:
        while order := (await asyncio.to_thread(sys.stdin.readline)).strip():
            await stack.aclose()
            if order == "on":
                await stack.enter_async_context(Listening(port, None, on_transmission, on_event, own=False))
            print(json.dumps({"order": order}), flush=True)
    print(json.dumps({"heard": heard, "lost": lost}), flush=True)


if __name__ == "__main__":
    try:
        asyncio.run(_listen(sys.argv[1]))
    except PortError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        sys.exit(1)
