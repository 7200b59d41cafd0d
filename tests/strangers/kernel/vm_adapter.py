"""The program of the emulated adapters, in the machine: one or two chips on one line, plugged into the kernel.

``vm_adapter.py CHIP[=SERIAL]... [--far TTY [--far-baud B]] [--echo] [--swap] [--noise P --seed N] [--stuck MS]
[--late MS,MS..] [--report] --log FILE``. Two chips share the line. FILE gets each request of the kernel, a JSON object
a line. Commands, one a line, come from standard input: ``octets HEX`` and ``bad HEX`` (the last octet has a parity
error) arrive on the line, ``unplug``, ``plug SLOT``, ``late MS,MS..``, ``count``.
"""

from __future__ import annotations

import argparse
import heapq
import itertools
import json
import os
import selectors
import sys
import time
from collections import deque
from collections.abc import Callable
from random import Random

from vm_chips import CHIPS, CdcCoding, Chip, Ft232r
from vm_line import Line
from vm_usbip import Connection


class Program:
    """Clock, timers and log, for all chips."""

    def __init__(self, log: str) -> None:
        self._log = open(log, "a", buffering=1, encoding="ascii")  # noqa: SIM115 (to the end of the program)
        self._timers: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._rest = b""  # of standard input: the beginning of a line
        self.line = Line(Socket(self))
        self.sockets: list[Socket] = []
        self._select = selectors.SelectSelector()  # epoll would round times to ms

    def now(self) -> float:
        return time.monotonic()

    def later(self, at: float, call: Callable[[], None]) -> None:
        heapq.heappush(self._timers, (at, next(self._order), call))

    def log(self, event: str, **words: object) -> None:
        self._log.write(json.dumps({"t": round(self.now(), 6), "event": event, **words}) + "\n")

    def watch(self, socket: Socket) -> None:
        self._select.register(socket.connection.fd, selectors.EVENT_READ, socket)

    def unwatch(self, socket: Socket) -> None:
        self._select.unregister(socket.connection.fd)

    def run(self) -> None:
        self._select.register(sys.stdin.fileno(), selectors.EVENT_READ, "commands")
        if self.line.far >= 0:
            self._select.register(self.line.far, selectors.EVENT_READ, "far")
        while True:
            wait = max(0.0, self._timers[0][0] - self.now()) if self._timers else None
            for key, _events in self._select.select(wait):
                if isinstance(key.data, Socket):
                    if not key.data.connection.readable():
                        self._select.unregister(key.fd)
                elif key.data == "far":
                    if not self.line.far_readable():
                        self._select.unregister(key.fd)
                elif not self._read_commands():
                    return
            while self._timers and self._timers[0][0] <= self.now():
                heapq.heappop(self._timers)[2]()

    def _read_commands(self) -> bool:
        """Carry out the lines that have come; False at their end. A buffer of Python would hide some of them."""
        chunk = os.read(sys.stdin.fileno(), 4096)
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        for line in lines:
            self._command(line.decode("ascii").split())
        return bool(chunk)

    def _command(self, words: list[str]) -> None:
        name, arguments = words[0], words[1:]
        first = self.sockets[0]
        if name in ("octets", "bad"):
            octets = bytes.fromhex(arguments[0])
            first.chip.receive([(octet, name == "bad" and at + 1 == len(octets)) for at, octet in enumerate(octets)])
        elif name == "unplug":
            self.unwatch(first)
            first.connection.detach()
            self.log("unplug")
        elif name == "plug":
            first.connection.attach(int(arguments[0]))
            self.watch(first)
            self.log("plug")
        elif name == "late" and isinstance(first.chip, CdcCoding):
            first.chip.late = _delays(arguments[0])
        elif name == "count":
            self.log("sent", octets=self.line.sent)


class Socket:
    """One chip in its USB socket: the services that the chip calls."""

    chip: Chip
    connection: Connection

    def __init__(self, program: Program) -> None:
        self._program = program
        self.now, self.later, self.log = program.now, program.later, program.log

    def insert(self, chip: Chip) -> None:
        self.chip, self.connection = chip, Connection(chip)
        self._program.line.chips.append(chip)
        self._program.sockets.append(self)

    def feed(self, endpoint: int) -> None:
        self.connection.feed(endpoint)

    def send(self, octets: bytes) -> float:
        return self._program.line.send(self.chip, octets)


def _delays(words: str) -> deque[float]:
    """Of ms with commas between them."""
    return deque(float(ms) / 1000 for ms in words.split(","))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("chips", nargs="+")
    parser.add_argument("--far")
    parser.add_argument("--far-baud", type=int, default=0)
    parser.add_argument("--echo", action="store_true")
    parser.add_argument("--swap", action="store_true")
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--stuck", type=int, default=0)
    parser.add_argument("--late", default="0")
    parser.add_argument("--report", action="store_true")
    parser.add_argument("--log", required=True)
    return parser.parse_args()


def main() -> None:
    wanted = _arguments()
    program = Program(wanted.log)
    line = program.line
    line.echo, line.swap, line.per_bit, line.random = wanted.echo, wanted.swap, wanted.noise, Random(wanted.seed)
    line.far_baud = wanted.far_baud
    if wanted.far:
        line.open_far(wanted.far)
    for slot, word in enumerate(wanted.chips):
        name, _, serial = word.partition("=")
        socket = Socket(program)
        chip = CHIPS[name](socket, serial or f"N{slot}")
        if isinstance(chip, Ft232r):
            chip.reports, chip.stuck_ms = wanted.report, wanted.stuck
        if isinstance(chip, CdcCoding):
            chip.late = _delays(wanted.late)
        socket.insert(chip)
        socket.connection.attach(slot)
        program.watch(socket)
        program.log("plug")
    program.run()


if __name__ == "__main__":
    main()
