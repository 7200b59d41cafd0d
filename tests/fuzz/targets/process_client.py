"""The application's end of a bus process that lies: any messages, cut in any way, and any octets in the shared memory.

The input chooses messages (right ones, bent ones, octets of its own), pictures in the shared memory (right, bent,
with a right or wrong check sum) and words, and what the application does between them. Judged: no exception but the
driver's own errors; lengths of inputs and outputs as configured; printable texts of all events; bounded buffers; a
bus process that cannot be understood is given up: told once, all slaves offline, every order an error; one that can
be understood goes on working.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import os
import socket
from collections.abc import Iterator
from typing import Any
from unittest import mock

import msgspec

from dpstack.dp.master.commands import Alive, Mode, RemoveSlave, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.settings import MasterSettings, StackSpec
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.process import channel, client, messages
from dpstack.drivers.process.client import ProcessRuntime
from dpstack.drivers.process.shared_image import Picture, SharedImage, Word
from dpstack.drivers.snapshots import BusSnapshot, Counters, ImageSnapshot, SlaveSnapshot
from dpstack.drivers.tap import Tap
from dpstack.errors import DpError
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT
from dpstack.trace import Event
from tests.fuzz.bent_channel import LENGTH, framed, make_memory, write_entry
from tests.fuzz.bent_json import bent, sample
from tests.fuzz.frame import Cutter, Target, assert_plain
from tests.fuzz.quick_loop import QuickLoop, quick_loop

PARAMS = BusParams.preset(500_000, address=2)
SLAVES = tuple(SlaveParams(address=a, name=f"s{a}", ident=1, config=b"\x10\x21") for a in (3, 4))
SETUP = messages.SetUp(
    "nowhere", False, False, Echo.OFF, False,
    StackSpec(params=PARAMS, patience=EXACT, slaves=SLAVES, master=MasterSettings(), watched=False),
)  # fmt: skip
#: the application reads everything at the end, and before behind one step in so many, as the place in the input has it
_LOOKS = 4


class FakeProcess:
    """A bus process that is only a number."""

    pid = 4242

    def __init__(self) -> None:
        self.code: int | None = None
        self.killed = False

    def poll(self) -> int | None:
        return self.code

    def kill(self) -> None:
        self.killed, self.code = True, -9

    def wait(self, _timeout: float | None = None) -> int:
        self.code = 0 if self.code is None else self.code
        return self.code


@functools.cache
def right_messages() -> tuple[Any, ...]:
    """One of every kind of news, as plain JSON data."""
    bus = BusSnapshot(Mode.OPERATE, EXACT, in_ring=True, las=frozenset((2,)))
    slaves = {3: SlaveSnapshot(SlaveState.DATA_EXCHANGE), 4: SlaveSnapshot(SlaveState.FAULT)}
    made = [
        messages.News(bus=bus, slaves=slaves),
        messages.News(answer=messages.Answer(1)),
        messages.News(answer=messages.Answer(1, error=("UsageError", "no"))),
        messages.News(answer=messages.Answer(2, value={"t_ns": 1})),
        messages.News(round_over=True, cycle=None),
        messages.News(over="the end"),
        messages.News(silence=1, bus=bus, slaves=slaves),
        messages.News(dropped={3: 1}),
        messages.News(tap_lost=3),
    ]
    plain = [msgspec.json.decode(messages._encoder.encode(one)) for one in made]
    plain.append(sample(messages.News))
    plain += [{"events": [[name, sample(kind)]]} for name, kind in sorted(messages.event_classes().items())]
    return tuple(plain)


class Run:
    """One execution."""

    def __init__(self, octets: bytes, loop: QuickLoop) -> None:
        self.script = Cutter(octets)
        self.loop = loop
        self.events: list[Event] = []
        self.failures: list[Exception] = []
        self.refused = 0
        self.process = FakeProcess()
        self.runtime = ProcessRuntime(SETUP, self.on_events, self.failures.append, self.on_refused)
        self.theirs: socket.socket | None = None
        self.image: SharedImage | None = None
        self.awaited: list[Any] = []
        self.sent = bytearray()

    def on_refused(self, _order: object, error: DpError) -> None:
        self.refused += 1
        assert_plain(str(error))

    def on_events(self, events: list[Event]) -> None:
        for event in events:
            assert isinstance(event, Event)
            assert_plain(event.text)
        self.events += events
        del self.events[:-50]

    def start(self, sock: int, memory: int) -> FakeProcess:
        """In place of the start of the bus process."""
        self.theirs = socket.socket(fileno=os.dup(sock))
        self.theirs.setblocking(False)
        self.image = SharedImage(memory)
        self.image.words[Word.HEARTBEAT] = self.loop.now_ns()
        hello: Any = {"answer": {"number": 0, "value": {"port_name": "nowhere", "paced": True}}}
        first = self.script.octet()
        if first & 1:
            hello = bent(hello, self.script)
        self.put(framed(hello) if first & 6 != 6 else self.script.take(8))
        if first & 24 == 24:
            self.theirs.close()
        return self.process

    # --- the bus process ---

    def put(self, octets: bytes) -> None:
        if self.theirs is not None:
            with contextlib.suppress(OSError):
                self.theirs.send(octets)

    def step(self) -> None:
        script = self.script
        head = script.octet()
        match head >> 4:
            case 0 | 1 | 2 | 3:
                known = right_messages()
                self.put(framed(bent(known[script.octet() % len(known)], script)))
            case 4:
                known = right_messages()
                whole = framed(known[script.octet() % len(known)])
                self.put(whole[: script.octet() % len(whole)])
            case 5:
                self.put(LENGTH.pack(script.octet()) + script.take(script.octet() & 31))
            case 6:
                self.put(script.take(head & 15))
            case 7:
                self.put(LENGTH.pack(script.word() << (head & 15)))
            case 8 | 9:
                self.write_picture(head)
            case 10 if self.image is not None:
                self.image.words[script.octet() % len(Word)] = int.from_bytes(script.take(head & 7), "little") & (
                    2**64 - 1
                )
            case 11 if self.image is not None:
                self.image.words[Word.HEARTBEAT] = self.loop.now_ns()
            case 12 | 13:
                self.application(head & 31)
            case 14 if head & 8 and self.theirs is not None:
                self.process.code = (0, 1, -9, None)[head & 3]
                self.theirs.close()
            case 15 if self.image is not None:
                slaves = {3: ImageSnapshot(bytes(script.octet() & 3), bytes(2), bool(head & 1), 1, 2)}
                self.image.inputs.write(Picture(1, 1, slaves))

    def write_picture(self, head: int) -> None:
        image, script = self.image, self.script
        if image is None:
            return
        area: Any = (image.inputs, image.counters, image.drives, image.outputs)[head & 3]
        right: Any = (
            [1, 1, {"3": ["x", "x", True, 1, 2]}],
            msgspec.to_builtins(Counters()),
            {"3": {"state": "running"}},
            {"3": [1, "x"]},
        )[head & 3]
        value = bent(right, script)
        write_entry(area, value, head, script)

    # --- the application ---

    def application(self, what: int) -> None:
        runtime, script = self.runtime, self.script
        with contextlib.suppress(DpError):
            match what & 7:
                case 0:
                    self.awaited.append(runtime.order(SetMode(Mode.OPERATE)))
                case 1:
                    runtime.command(SetMode(Mode.CLEAR))
                case 2:
                    runtime.set_outputs(3, script.take(2).ljust(2, b"\0"))
                case 3:
                    runtime.watch_rounds(lambda: None)
                case 4:
                    runtime.tap(Tap())
                case 5:
                    self.awaited.append(runtime.order(RemoveSlave(4)))
                case 6:
                    runtime.command(Alive())
                case _:
                    self.awaited.append(self.loop.create_task(runtime.history(3)))

    def look(self) -> None:
        """Read all that an application can read."""
        runtime = self.runtime
        for setup in SLAVES:
            image = runtime.image(setup)
            assert (len(image.inputs), len(image.outputs)) == (1, 2)
            assert isinstance(image.valid, bool)
            snapshot = runtime.slave(setup.address)
            assert isinstance(snapshot.state, SlaveState)
            runtime.drive_status(setup.address)
        assert isinstance(runtime.counters(), Counters)
        assert isinstance(runtime.rotations, int)
        assert isinstance(runtime.bus(), BusSnapshot)
        assert len(runtime._slaves) <= 127
        assert len(runtime._channel._frames._rest) <= messages.MAX_MESSAGE + 70_000
        if runtime.not_running is not None:
            for setup in SLAVES:
                assert runtime.slave(setup.address).state in (SlaveState.OFFLINE, SlaveState.DEACTIVATED)
            assert runtime.bus().mode is Mode.OFFLINE

    async def main(self) -> None:
        script, runtime = self.script, self.runtime
        try:
            await runtime.open()
        except DpError as error:
            assert_plain(str(error))
            assert self.process.code is not None
            await runtime.close()
            return
        while script.at < len(script.octets) and not self.failures:
            self.step()
            for _ in range(2):
                await asyncio.sleep(0)
            if script.at % _LOOKS == 0:
                self.look()
            if self.theirs is not None and self.theirs.fileno() >= 0:
                with contextlib.suppress(OSError):
                    self.theirs.recv(1 << 16)
        await self.end()

    async def end(self) -> None:
        runtime, theirs = self.runtime, self.theirs
        self.look()
        if self.image is not None:
            self.image.words[Word.HEARTBEAT] = self.loop.now_ns()
        await asyncio.sleep(0.001)
        whole = runtime._channel.is_open and not runtime._channel._frames._rest
        if not self.failures and whole and theirs is not None and theirs.fileno() >= 0:
            # not the word in the shared memory, which the bus process may have overwritten
            right = dict(right_messages()[0]) | {"silence": runtime._silences}
            self.put(framed(right))
            for _ in range(20):
                await asyncio.sleep(0)
            assert runtime.slave(3).state is SlaveState.DATA_EXCHANGE
            assert runtime.bus().mode is Mode.OPERATE
        assert len(self.failures) <= 1, self.failures
        if self.failures:
            assert_plain(str(self.failures[0]))
            self.look()
            assert runtime.not_running is not None
            for setup in SLAVES:
                assert runtime.slave(setup.address).state in (SlaveState.OFFLINE, SlaveState.DEACTIVATED)
            with contextlib.suppress(DpError):
                await runtime.order(SetMode(Mode.OPERATE))
                raise AssertionError("an order to a bus process that is gone was carried out")
        if theirs is not None:
            theirs.close()
        self.process.code = 0 if self.process.code is None else self.process.code
        await runtime.close()
        await asyncio.sleep(0.01)
        for one in self.awaited:
            assert one.done()
            if not one.cancelled() and (error := one.exception()) is not None:
                assert isinstance(error, DpError), error
                assert_plain(str(error))
        self.look()
        runtime.counters()


@contextlib.contextmanager
def patched(run: Run) -> Iterator[None]:
    """The driver with a stand-in for the bus process, and the time of the loop."""
    with (
        mock.patch.object(channel, "started", run.start),
        mock.patch.object(channel, "monotonic_ns", run.loop.now_ns),
        mock.patch.object(client, "monotonic_ns", run.loop.now_ns),
        mock.patch.object(client, "make_memory", make_memory),
    ):
        yield


def run(octets: bytes) -> None:
    loop = quick_loop()
    one = Run(octets, loop)
    try:
        with patched(one):
            loop.play(one.main())
    finally:
        if one.theirs is not None:
            one.theirs.close()
        if one.image is not None:
            one.image.close()


TARGET = Target(
    run=run,
    covers=("dpstack.drivers.process", "dpstack.drivers.snapshots", "dpstack.trace"),
    executions=100_000,
    compares=False,
    max_len=300,
)
