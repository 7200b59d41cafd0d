"""The tap of a running program: its CPU time per exchange with a client and without one, in turn, and what the client
gets. Then a full bus at 12 Mbit/s, which no program of ours could make: telegrams of ten slaves with 12 octets each way
without a pause are put into a tap as they would end on the wire, and the client keeps up with them or not.

The wire of the other benchmarks: at 500 kbit/s it takes its time, at 12 Mbit/s its octets take none. The client is a
program of its own on the wire's processor, which makes transmissions of what it gets, as ``dpstack capture`` does.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import sys
import tempfile
import time
from time import monotonic_ns
from typing import Final

from bench.masters import DRIVERS, FIRST, OCTETS, sd2
from bench.options import count, duration, slaves
from bench.paired import interval
from bench.report import Report
from bench.rig import Process, Processors, available, bench, note_disturbance, pinned
from dpstack.api.control.commands import KINDS
from dpstack.api.control.server import ControlServer
from dpstack.api.control.tap_feed import TapFeed
from dpstack.api.listen.listening import Listening, OctetsLost
from dpstack.capture.transmission import Transmission
from dpstack.drivers.tap import Tap
from dpstack.errors import PortError
from dpstack.params import BusParams
from dpstack.trace import Event
from dpstack.units import NS_PER_S, baud_text, chars_to_ns

_BAUDS: Final = (500_000, 12_000_000)
#: up to this rate the wire takes its time
_PACED: Final = 3_000_000
#: CPU time per exchange with a client to that without one
_GOAL: Final = 1.05
#: after a client has come or gone
_SETTLE_S: Final = 0.05
_OWN: Final = 2
_FULL_BAUD: Final = 12_000_000
_FULL_STEP_S: Final = 0.004
#: until the client has read everything
_FULL_REST_S: Final = 1.0


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench tap")
    parser.add_argument("--bauds", type=int, nargs="*", default=_BAUDS)
    parser.add_argument("--slaves", type=slaves, default=10)
    parser.add_argument("--seconds", type=duration, default=0.2, help="of one slice")
    parser.add_argument("--rounds", type=count, default=60, help="slices with and without a client in turn")
    parser.add_argument("--full-bus", type=float, default=5.0, metavar="SECONDS", help="of the full bus")
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS)
    args = parser.parse_args(argv)
    report = Report("tap")
    with pinned() as where:
        report.notes.append(where.text)
        for baud in args.bauds:
            for kind in available(args.kinds, report.notes):
                _at(report, kind, baud, args, where)
        asyncio.run(_full_bus(report, where, args.full_bus))
    return report


async def _full_bus(report: Report, where: Processors, seconds: float) -> None:
    """A control server whose line is made of telegrams by the clock."""
    params = BusParams.preset(_FULL_BAUD)
    exchanges = [
        (sd2(address, 0x5D, bytes(OCTETS)), sd2(_OWN, 0x08, bytes(OCTETS))) for address in range(FIRST, FIRST + 10)
    ]
    on_wire = chars_to_ns(len(exchanges[0][0]), _FULL_BAUD)
    attached: asyncio.Future[Tap] = asyncio.get_running_loop().create_future()

    def attach(tap: Tap | None) -> None:
        if tap is not None:
            attached.set_result(tap)

    feed = TapFeed(attach, monotonic_ns, lambda: {"baud": _FULL_BAUD, "paced": True})
    with tempfile.TemporaryDirectory() as folder:
        async with ControlServer("segment", folder, KINDS["segment"], {"tap": feed.handler}):
            client = Process([sys.executable, "-m", "bench.tap", folder], where.wire)
            client.order("on")
            tap = await attached
            free, put = monotonic_ns(), 0
            until = free + round(seconds * NS_PER_S)
            while free < until:
                await asyncio.sleep(_FULL_STEP_S)
                now = monotonic_ns()
                while free < now:
                    request, answer = exchanges[put // 2 % len(exchanges)]
                    end = free + on_wire
                    over = end + params.ns(params.min_tsdr) + on_wire
                    tap.add((end, _FULL_BAUD, request, True))
                    tap.add((over, _FULL_BAUD, answer, False))
                    free, put = over + params.ns(params.t_id1), put + 2
            await asyncio.sleep(_FULL_REST_S)
            told = await asyncio.to_thread(client.end)
    title = f"{baud_text(_FULL_BAUD)}, full bus"
    report.add(f"{title}: telegrams per second", put / seconds, "1/s", more=True)
    report.add(f"{title}: share that the client got", float(str(told[-1]["heard"])) / put, "ratio", 1, more=True)
    report.add(f"{title}: chunks that the client lost", float(str(told[-1]["lost"])), "")


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
