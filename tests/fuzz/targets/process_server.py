"""The bus process with an application that lies: any orders, cut in any way, and any octets in the shared memory.

The machines are real, their line has two slaves of octets, time is virtual. The input chooses orders (right ones,
bent ones, octets of its own), pictures of outputs (right, bent, with a right check sum), words, and time. Judged: no
exception leaves the bus process; every answer and event can be sent; outputs on the line are the application's or
safe; and the bus ends in order, with the last outputs safe, when the application is gone or cannot be understood.
"""

from __future__ import annotations

import contextlib
import functools
import heapq
import os
import socket
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import msgspec

from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.settings import MasterSettings, StackSpec
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.line import shutdown
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.port_latency import PortLatency
from dpstack.drivers.process import bus_process as server
from dpstack.drivers.process import messages
from dpstack.drivers.process.bus_process import Host
from dpstack.drivers.process.shared_image import SharedImage, Word
from dpstack.machine import Machine
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT
from dpstack.units import NEVER
from tests.fuzz.bent_channel import LENGTH, framed, make_memory, write_entry
from tests.fuzz.bent_json import bent, sample
from tests.fuzz.frame import Cutter, Target, assert_plain
from tests.fuzz.octet_line import CorrectSlave, Line

MS = 1_000_000
BAUD = 500_000
SAFE, GIVEN = b"\x0f\xf0", b"\x5a\xa5"
SLAVES = tuple(
    SlaveParams(address=a, name=f"s{a}", ident=1, config=b"\x10\x21", safe=SAFE, watchdog_ms=0) for a in (3, 4)
)
SETUP = messages.SetUp(
    "nowhere", False, False, Echo.OFF, False,
    StackSpec(
        params=BusParams.preset(BAUD, address=2, gap=0, extra_idle=1_000), patience=EXACT, slaves=SLAVES,
        master=MasterSettings(), watched=False,
    ),
)  # fmt: skip


class Timer:
    """A timer of the loop."""

    def __init__(self, loop: FakeLoop, callback: Callable[[], object]) -> None:
        self.loop = loop
        self.callback: Callable[[], object] | None = callback

    def set(self, at: int) -> None:
        self.loop.count += 1
        heapq.heappush(self.loop.timers, (at, self.loop.count, self))

    def close(self) -> None:
        self.callback = None

    cancel = close


class FakeLoop:
    """A loop of the bus process in virtual time."""

    def __init__(self) -> None:
        self.now = 1_000 * MS
        self.timers: list[tuple[int, int, Timer]] = []
        self.soon: list[Callable[[], object]] = []
        self.readers: dict[int, Callable[[], object]] = {}
        self.count = 0
        self.stopped = False

    def add_reader(self, fd: int, callback: Callable[[], object]) -> None:
        self.readers[fd] = callback

    def remove_reader(self, fd: int) -> bool:
        return self.readers.pop(fd, None) is not None

    def add_writer(self, _fd: int, _callback: Callable[[], object]) -> None:
        return

    def remove_writer(self, _fd: int) -> bool:
        return True

    def call_soon(self, callback: Callable[[], object]) -> None:
        self.soon.append(callback)

    def call_at(self, at: int, callback: Callable[[], object]) -> Timer:
        timer = Timer(self, callback)
        timer.set(at)
        return timer

    def stop(self) -> None:
        self.stopped = True

    def turn(self) -> None:
        """All that is due now."""
        while self.soon and not self.stopped:
            soon, self.soon = self.soon, []
            for callback in soon:
                callback()
        while self.timers and self.timers[0][0] <= self.now and not self.stopped:
            timer = heapq.heappop(self.timers)[2]
            if timer.callback is not None:
                callback, timer.callback = timer.callback, None
                callback()


class FakeRuntime:
    """A driver that runs the machine on a line of two slaves."""

    port_name, paced = "nowhere", True

    def __init__(self, _port: object, machine: Machine, on_events: Any, **_more: object) -> None:
        self.machine = machine
        self.on_events = on_events
        self.failed: Exception | None = None
        self.lateness = PortLatency()
        self.slaves = {address: CorrectSlave(address, 1, b"\x10\x21", b"\x07") for address in (3, 4)}
        self.line = Line(machine, BAUD, self.heard)
        self.later: list[Callable[[], object]] = []
        self.is_open = False

    def heard(self, octets: bytes, end: int) -> None:
        if octets[0] == 0xDC:
            return
        slave = self.slaves.get(octets[4 if octets[0] == 0x68 else 1] & 0x7F)
        answer = None if slave is None else slave.answer(octets)
        if answer is not None:
            self.line.say(answer, end, 11)
        if slave is not None and slave.outputs is not None:
            assert slave.outputs in (SAFE, GIVEN, bytes(2), b""), slave.outputs

    def open(self, loop: FakeLoop) -> None:
        self.is_open = True
        self.line.now = loop.now
        self.line.pump()

    def command(self, order: object) -> None:
        self.machine.command(order, self.line.now)
        self.line.pump()
        self.tell()

    def after_step(self, callback: Callable[[], object]) -> None:
        self.later.append(callback)

    def tell(self) -> None:
        if events := self.machine.take_events():
            self.on_events(events)
        later, self.later = self.later, []
        for callback in later:
            callback()

    def run_until(self, at: int) -> None:
        while self.is_open and self.line.step(at):
            self.tell()
        self.line.now = at

    def now(self) -> int:
        return self.line.now

    def damage(self) -> dict[str, int]:
        return {}

    def tap(self, _tap: object) -> None:
        return

    def close(self) -> None:
        self.is_open = False
        self.tell()


@functools.cache
def right_orders() -> tuple[Any, ...]:
    """One order of every kind, and some that work, as plain JSON data."""
    right = [
        ["SetMode", {"mode": 192}], ["SetMode", {"mode": 128}], ["GoOnline", {}], ["TakeOutputs", {}], ["Alive", {}],
        ["ReadHistory", {"address": 3}], ["RemoveSlave", {"address": 4}], ["Shutdown", {}], ["CloseBus", {}],
        ["SendControl", {"token": 1, "groups": [], "sync": True}], ["GoOffline", {}],
        ["AddSlave", {"setup": msgspec.json.decode(messages._encoder.encode(SLAVES[0]))}],
        ["RecordOrder", {"token": 7, "function": 94, "slot": 1, "index": 2, "address": 3}],
        ["DriveCommand", {"address": 3, "op": "read", "args": {"number": 1}, "token": 9}],
    ]  # fmt: skip
    known = messages.order_classes()
    return (*right, *([name, sample(kind)] for name, kind in sorted(known.items()) if name != "SetUp"))


class Run:
    """One execution."""

    def __init__(self, octets: bytes) -> None:
        self.script = Cutter(octets)
        self.loop = FakeLoop()
        self.ours, self.theirs = socket.socketpair()
        self.ours.setblocking(False)
        self.theirs.setblocking(False)
        memory = make_memory()
        self.there, self.image = SharedImage(memory), SharedImage(memory)
        os.close(memory)
        self.news = messages.Frames(messages.News)
        self.answers: list[messages.Answer] = []
        self.number = 0
        self.gone = False
        #: the bus process may have something to read
        self.waiting = False

    def put(self, octets: bytes) -> None:
        if not self.gone:
            with contextlib.suppress(OSError):
                self.theirs.send(octets)
                self.waiting = True

    def ask(self, name: str, **fields: Any) -> None:
        """Give a right order."""
        self.number += 1
        self.put(framed({"number": self.number, "order": [name, fields]}))

    def step(self) -> None:
        script = self.script
        head = script.octet()
        known = right_orders()
        match head >> 4:
            case 0 | 1 | 2 | 3 | 4:
                self.number += 1
                message = {"number": self.number, "order": known[script.octet() % len(known)]}
                self.put(framed(bent(message, script)))
            case 5:
                self.put(script.take(head & 15))
            case 6:
                self.put(LENGTH.pack(script.word() << (head & 15)))
            case 7:
                self.put(LENGTH.pack(script.octet()) + script.take(script.octet() & 31))
            case 8 | 9:
                self.write_outputs(head)
            case 10:
                self.image.words[script.octet() % len(Word)] = int.from_bytes(script.take(head & 7), "little")
            case 11 if head & 8:
                self.hang_up()
            case 12:
                self.run(script.octet() * MS // 4)
            case _:
                self.ask("SetMode", mode=192)

    def hang_up(self) -> None:
        """The application is gone."""
        self.theirs.close()
        self.gone = self.waiting = True

    def write_outputs(self, head: int) -> None:
        area, script = self.image.outputs, self.script
        value: Any = {"3": [self.loop.now + 10**9, GIVEN], "4": [self.loop.now + 10**9, GIVEN]}
        value = bent(value, script) if head & 1 else value
        write_entry(area, value, head, script)

    def run(self, ns: int) -> None:
        """Time passes in the bus process."""
        loop, runtime = self.loop, self.runtime
        end = loop.now + ns
        while not loop.stopped and loop.now < end:
            if self.waiting and (reader := loop.readers.get(self.ours.fileno())) is not None:
                self.waiting = self.readable()
                if self.waiting:
                    reader()
            loop.turn()
            if not self.runtime.is_open and not loop.timers:
                break
            due = min(loop.timers[0][0] if loop.timers else NEVER, runtime.line.due if runtime.is_open else NEVER, end)
            runtime.run_until(max(loop.now, min(due, end)))
            loop.now = max(loop.now, min(due, end))
        self.read()

    def readable(self) -> bool:
        try:
            self.ours.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except OSError:  # hung up, with octets that were not read
            return True
        return True

    def read(self) -> None:
        """The application reads the news."""
        if self.gone:
            return
        with contextlib.suppress(BlockingIOError, ConnectionResetError):
            for news in self.news.feed(self.theirs.recv(1 << 16)):
                for event in news.events:
                    assert_plain(messages.event_of(event).text)
                if news.answer is not None:
                    self.answers.append(news.answer)
                    if news.answer.error is not None:
                        text = str(messages.error_of(news.answer.error))
                        assert_plain(text)
                        assert "defect in dpstack" not in text, text
                assert not news.defect, news.over

    def begin(self) -> Host:
        """Start the bus process."""
        host = Host(self.loop, self.ours, self.there, SETUP)  # type: ignore[arg-type]
        self.runtime: FakeRuntime = host.runtime  # type: ignore[assignment]
        host.open([])
        return host

    def main(self) -> None:
        host = self.begin()
        if self.script.octet() & 1:
            self.ask("GoOnline")
            handlers = host._master.handlers.values()
            for _ in range(13):
                self.run(10 * MS)
                if all(handler.state is SlaveState.DATA_EXCHANGE for handler in handlers):
                    break
            assert all(handler.state is SlaveState.DATA_EXCHANGE for handler in handlers)
        while self.script.at < len(self.script.octets) and not self.loop.stopped:
            self.step()
            self.run(5 * MS)
        assert len(host._questions) <= 32 + 70_000 // 20
        if not self.gone:
            self.hang_up()
        self.run(120_000 * MS)
        assert self.loop.stopped
        assert not self.runtime.is_open
        for slave in self.runtime.slaves.values():
            assert slave.outputs in (SAFE, None, b"", bytes(2)), slave.outputs

    def close(self) -> None:
        for one in (self.ours, self.theirs):
            one.close()
        self.there.close()
        self.image.close()


@contextlib.contextmanager
def patched(run: Run) -> Iterator[None]:
    """The bus process without a port, in the time of the loop."""

    def now() -> int:
        return run.loop.now

    def do_beside(loop: FakeLoop, work: Callable[[], Any], done: Callable[[Any, Exception | None], object]) -> None:
        result, failed = None, None
        try:
            result = work()
        except Exception as error:
            failed = error
        loop.call_soon(lambda: done(result, failed))

    with (
        mock.patch.object(server, "do_beside", do_beside),
        mock.patch.object(server, "SelectRuntime", FakeRuntime),
        mock.patch.object(server, "open_port", return_value=None),
        mock.patch.object(server, "monotonic_ns", now),
        mock.patch.object(shutdown, "monotonic_ns", now),
    ):
        yield


def run(octets: bytes) -> None:
    one = Run(octets)
    try:
        with patched(one):
            one.main()
    finally:
        one.close()


TARGET = Target(
    run=run,
    covers=("dpstack.drivers.process", "dpstack.drivers.stack", "dpstack.drivers.line.shutdown"),
    executions=100_000,
    compares=False,
    max_len=300,
)
