"""The live stream of a running program: its CPU time per exchange with readers and without, in turn.

The wire and the masters are those of the other benchmarks: at 500 kbit/s the wire takes its time, at 12 Mbit/s its
octets take none. Readers of the control socket (``live``, a snapshot every 0.1 s) are processes of their own on the
wire's processor:

- ``reader``: one that reads and parses every line, as the live screen and the page's server do
- ``stuck``: one that never reads
- ``pages``: the web server of the page with 20 open pages; it is left out where aiohttp is missing

Then the plant of 125 slaves with 244 octets each way (simulated, 12 Mbit/s): octets of a whole snapshot and of the
changes, and the time that they take.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import importlib.util
import json
import sys
import time
from statistics import median
from typing import Any, Final

from bench.masters import DRIVERS
from bench.options import count, duration, slaves
from bench.paired import interval
from bench.report import Report
from bench.rig import NO_GAP, Process, Processors, available, bench, note_disturbance, pinned
from dpstack import open_bus, run_virtual
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.picture import SlavePicture
from dpstack.api.control.client import connect
from dpstack.errors import PortError
from dpstack.plant.pending import portions
from dpstack.text import json_text
from dpstack.units import baud_text

_BAUDS: Final = (500_000, 12_000_000)
#: up to this rate the wire takes its time
_PACED: Final = 3_000_000
#: CPU time per exchange of the bus's own process with a reader to that without one
_GOAL: Final = 1.05
#: after a reader has come or gone
_SETTLE_S: Final = 0.1
READERS: Final = ("reader", "stuck", "pages")
_PAGES: Final = 20
_SNAPSHOTS: Final = 20
_OFF: Final = "off"
#: words without consistency: 128 and 116 octets each way
_CONFIG: Final = "C0 7F 7F C0 79 79"


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench live")
    parser.add_argument("--bauds", type=int, nargs="*", default=_BAUDS)
    parser.add_argument("--slaves", type=slaves, default=10)
    parser.add_argument("--seconds", type=duration, default=0.5, help="of one slice")
    parser.add_argument("--rounds", type=count, default=30, help="slices with each kind of reader and without, in turn")
    parser.add_argument("--readers", nargs="*", choices=READERS, default=READERS)
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS)
    parser.add_argument("--large", type=int, default=125, metavar="SLAVES", help="of the simulated plant; 0: leave out")
    args = parser.parse_args(argv)
    report = Report("live")
    if "pages" in args.readers and importlib.util.find_spec("aiohttp") is None:
        report.notes.append("pages are left out: aiohttp is not installed")
        args.readers = [one for one in args.readers if one != "pages"]
    with pinned() as where:
        report.notes.append(where.text)
        for baud in args.bauds:
            for kind in available(args.kinds, report.notes):
                _at(report, kind, baud, args, where)
        if args.large:
            _large(report, args.large)
    return report


def _at(report: Report, kind: str, baud: int, args: argparse.Namespace, where: Processors) -> None:
    """One master, readers that come and go."""
    slices: dict[str, list[tuple[int, int, int]]] = {order: [] for order in (_OFF, *args.readers)}
    with bench(kind, args.slaves, baud, where, paced=baud <= _PACED, more=[*NO_GAP, "--control"]) as running:
        client = Process([sys.executable, "-m", "bench.live", str(running.facts["port"])], where.wire)
        try:
            for number in range(args.rounds):
                orders = list(slices)
                for order in orders if number % 2 else reversed(orders):
                    client.order(order)
                    answer = json.loads(client.line() or '{"error": "it ended"}')
                    if "error" in answer:
                        raise RuntimeError(f"the client of the stream: {answer['error']}")
                    time.sleep(_SETTLE_S)
                    slices[order].append(running.cpu_slices(args.seconds))
        finally:
            told = client.end()
        waited = running.measure(args.seconds)
    title = f"{baud_text(baud)}, {kind}"
    for own, whose in ((True, "the bus's own process"), (False, "all processes")):
        if not own and kind == "asyncio":
            continue  # there is one only
        costs = {
            order: [(bus if own else cpu) / max(count, 1) for cpu, bus, count in taken]
            for order, taken in slices.items()
        }
        report.measured(f"{title}: CPU time per exchange, {whose}", [ns / 1000 for ns in costs[_OFF]], "us")
        for order in args.readers:
            ratios = [with_one / without for with_one, without in zip(costs[order], costs[_OFF], strict=True)]
            text = f"{title}: CPU time per exchange, {whose}, with {order} to without"
            report.measured(text, ratios, "ratio", _GOAL if own else None)
            low, high = interval(ratios)
            report.notes.append(f"{text}: the median lies between {low:.3f} and {high:.3f} (99 %)")
    rates = {order: median(count / args.seconds for _, _, count in taken) for order, taken in slices.items()}
    for order, rate in rates.items():
        report.add(f"{title}: exchanges per second, {order}", rate, "1/s", more=True)
    report.add(f"{title}: items that the readers got", float(str(told[-1]["items"])), "", more=True)
    note_disturbance(report, [waited], title)


# --- a plant of 125 slaves with 244 octets each way ---


def _large(report: Report, count: int) -> None:
    """Figures of the stream of a simulated plant: octets, and CPU time of this process."""
    slaves = [
        {
            "name": f"slave {address}",
            "address": address,
            "ident": 0x1234,
            "config": _CONFIG,
            "inputs": {f"value {n}": f"i16@{2 * n}" for n in range(4)},
        }
        for address in range(1, count + 1)
    ]
    items, wall = run_virtual(_stream_of(slaves))
    title = f"{count} slaves with 244 octets each way"
    wholes = [len(_encoded(item)) for item in items if item.get("snapshot", {}).get("whole")]
    deltas = [item for item in items if "snapshot" in item and not item["snapshot"]["whole"]]
    report.add(f"{title}: octets of the plant", float(len(_encoded(items[0]))), "")
    report.add(f"{title}: octets of a whole snapshot", float(max(wholes)), "")
    report.measured(f"{title}: octets of the changes", [float(len(_encoded(item))) for item in deltas], "")
    lines = [line for item in items for line in map(_encoded, portions(item))]
    report.add(f"{title}: octets of the longest line", float(max(map(len, lines))), "")
    took = []
    for item in deltas:
        begun = time.process_time_ns()
        _encoded(item)
        took.append((time.process_time_ns() - begun) / 1e6)
    report.measured(f"{title}: time to encode the changes", took, "ms")
    report.measured(f"{title}: time to read the values of all slaves", wall, "ms")


def _encoded(item: dict[str, Any]) -> bytes:
    """As the control socket sends it."""
    return json_text({"item": item}).encode() + b"\n"


async def _stream_of(slaves: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[float]]:
    """The items of some seconds in which all inputs change, and the CPU time (ms) of the values of all slaves."""
    items: list[dict[str, Any]] = []
    took: list[float] = []
    async with open_bus(port="virtual", baud=12_000_000, address=0, slaves=slaves) as bus:
        await bus.operate()
        await bus.ready(60)
        number = 0
        readers = [SlavePicture(core_of(bus), slave) for slave in bus.slaves]
        async for item in bus.live(interval=0.1):
            if "event" in item:
                continue
            items.append(item)
            number += 1
            for slave in bus.slaves:
                slave.outputs = bytes((number + n) & 0xFF for n in range(len(slave.outputs)))
            begun = time.process_time_ns()
            for reader in readers:
                reader.take(bus.snapshot)
            took.append((time.process_time_ns() - begun) / 1e6)
            if len(items) > _SNAPSHOTS:
                break
    return items, took


# --- the readers, a process of its own: python -m bench.live PORT ---


class _Readers:
    """Those that are there; ``items``: the number that they got in all."""

    def __init__(self, port: str) -> None:
        self._port = port
        self._stack = contextlib.AsyncExitStack()
        self.items = 0

    async def set_to(self, order: str) -> None:
        await self._stack.aclose()
        match order:
            case "reader" | "stuck":
                await self._join(reads=order == "reader")
            case "pages":
                await self._open_pages()

    async def _join(self, *, reads: bool) -> None:
        client = connect(self._port)
        client.help()
        connection = client.detach()
        connection.settimeout(None)
        self._stack.callback(client.close)
        reader, writer = await asyncio.open_unix_connection(sock=connection, limit=1 << 24)
        self._stack.callback(writer.close)
        writer.write(b'{"command":"live","args":["0.1"]}\n')
        if reads:
            await self._first(reader)
            self._beside(self._read(reader))
        else:
            writer.transport.pause_reading()  # type: ignore[attr-defined]

    async def _first(self, reader: asyncio.StreamReader) -> None:
        if not (line := await reader.readline()):
            raise PortError(f"{self._port}: no stream")
        json.loads(line)

    async def _read(self, reader: asyncio.StreamReader) -> None:
        while line := await reader.readline():
            json.loads(line)
            self.items += 1

    async def _open_pages(self) -> None:
        import aiohttp

        from dpstack.web.run_source import RunSource
        from dpstack.web.web_server import serve

        server = await self._stack.enter_async_context(serve(RunSource.named(self._port)))
        session = await self._stack.enter_async_context(aiohttp.ClientSession())
        base = server.url.partition("#")[0]
        for _ in range(_PAGES):
            origin = {"Origin": base.rstrip("/")}
            ws = await self._stack.enter_async_context(session.ws_connect(base + "ws", headers=origin, max_msg_size=0))
            await ws.send_json({"hello": {"token": None}})
            self._beside(self._follow(ws))

    async def _follow(self, ws: Any) -> None:
        async for message in ws:
            self.items += "snapshot" in json.loads(message.data)

    def _beside(self, work: Any) -> None:
        task = asyncio.ensure_future(work)
        self._stack.callback(task.cancel)


async def _main(port: str) -> None:
    """Orders from standard input: the kind of readers. Answers each when they are there."""
    readers = _Readers(port)
    while order := (await asyncio.to_thread(sys.stdin.readline)).strip():
        await readers.set_to(order)
        print(json.dumps({"order": order}), flush=True)
    await readers.set_to(_OFF)
    print(json.dumps({"items": readers.items}), flush=True)


if __name__ == "__main__":
    try:
        asyncio.run(_main(sys.argv[1]))
    except (PortError, OSError) as error:
        print(json.dumps({"error": str(error)}), flush=True)
        sys.exit(1)
