"""A bus process that sends what cannot be: it is given up at once, nothing of it is alive, and every wait ends. One
whose application sends that ends the bus in order, with safe outputs."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import struct
import zlib
from collections.abc import AsyncIterator, Callable, Iterator
from time import monotonic_ns
from typing import Any

import pytest
from far_ends import until

from dpstack.dp.master.commands import Mode, RemoveSlave, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.settings import MasterSettings, StackSpec
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.ms1 import Ms1
from dpstack.dpv1.master.orders import RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.process import channel, messages
from dpstack.drivers.process.client import ProcessRuntime
from dpstack.drivers.process.shared_image import SharedImage, Word
from dpstack.drivers.snapshots import Counters
from dpstack.errors import BusError, UsageError
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT
from tests.fuzz.targets import process_server
from tests.fuzz.targets.process_server import GIVEN, MS, SAFE

SLAVES = tuple(SlaveParams(address=a, name=f"s{a}", ident=1, config=b"\x10") for a in (3, 4))
SPEC = StackSpec(
    params=BusParams.preset(500_000, address=2), patience=EXACT, slaves=SLAVES, master=MasterSettings(), watched=False
)
HELLO = {"answer": {"number": 0, "value": {"port_name": "nowhere", "paced": True}}}
BUS = {"mode": 192, "patience": {}}
ALIVE = {"bus": BUS, "slaves": {"3": {"state": "data_exchange"}, "4": {"state": "data_exchange"}}}


class Liar:
    """A stand-in for the bus process: a socket, the shared memory, and a process id."""

    pid = 4242

    def __init__(self) -> None:
        self.code: int | None = None
        self.failures: list[Exception] = []
        self.runtime = ProcessRuntime(
            messages.SetUp("nowhere", False, False, Echo.OFF, False, SPEC),
            lambda _: None,
            self.failures.append,
            self.refused,
        )

    def start(self, sock: int, memory: int) -> Liar:
        self.sock = socket.socket(fileno=os.dup(sock))
        self.image = SharedImage(memory)
        self.image.words[Word.HEARTBEAT] = monotonic_ns() + 1_000_000_000_000
        self.say(self.hello)
        return self

    hello: Any = HELLO

    def say(self, message: object) -> None:
        octets = json.dumps(message).encode()
        self.sock.sendall(struct.pack(">I", len(octets)) + octets)

    def refused(self, *_: object) -> None:
        raise AssertionError("nothing was refused")

    def poll(self) -> int | None:
        return self.code

    def kill(self) -> None:
        self.code = -9

    def wait(self, _timeout: float | None = None) -> int:
        self.code = self.code or 0
        return self.code

    def picture(self, octets: bytes) -> None:
        """Put ``octets`` into the first place of the inputs, with the right check sum."""
        words = self.image.inputs._words
        words[1], words[2] = len(octets), zlib.crc32(octets, 4)
        os_at = 4096
        self.image._map[os_at : os_at + len(octets)] = octets
        words[0] = 4


@contextlib.asynccontextmanager
async def opened(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Liar]:
    liar = Liar()
    monkeypatch.setattr(channel, "started", liar.start)
    await liar.runtime.open()
    try:
        yield liar
    finally:
        liar.code = 0
        await liar.runtime.close()
        liar.sock.close()
        liar.image.close()


async def alive(liar: Liar) -> None:
    liar.say(ALIVE)
    for _ in range(2):  # turns of the loop: the socket is ready, then it is read
        await asyncio.sleep(0)
    assert liar.runtime.slave(3).state is SlaveState.DATA_EXCHANGE


def event(kind: str, **fields: object) -> object:
    return {"events": [[kind, {"t_ns": 1, **fields}]]}


LIES: dict[str, Callable[[Liar], object]] = {
    "no news": lambda liar: liar.say(None),
    "no JSON": lambda liar: liar.sock.sendall(b"\0\0\0\1{"),
    "too long": lambda liar: liar.sock.sendall(b"\x7f\xff\xff\xff"),
    "an event that there is not": lambda liar: liar.say(event("Nonsense")),
    "an event without a text": lambda liar: liar.say(event("SlaveEvent", address=3, name="s3")),
    "an event with a number that cannot be": lambda liar: liar.say(
        event("StatusTold", address=3, name="s3", status={"type": 1, "slot": 1, "specifier": 256})
    ),
    "slaves beyond 126": lambda liar: liar.say({"slaves": {"127": {}}}),
    "a picture of another kind": lambda liar: liar.picture(b"\xc0"),
    "half a picture": lambda liar: liar.picture(b"\x93\x01"),
}


@pytest.mark.parametrize("lie", LIES)
async def test_it_is_given_up_at_once(lie: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its process runs on for now: the end of the socket makes it end the bus."""
    async with opened(monkeypatch) as liar:
        runtime = liar.runtime
        await alive(liar)
        order = runtime.order(SetMode(Mode.OPERATE))
        LIES[lie](liar)
        runtime.image(SLAVES[0])
        for _ in range(5):
            await asyncio.sleep(0)
            runtime.image(SLAVES[0])
        (failure,) = liar.failures
        assert "defect in dpstack" in str(failure)
        assert [runtime.slave(a).state for a in (3, 4)] == [SlaveState.OFFLINE] * 2
        assert runtime.bus().mode is Mode.OFFLINE
        assert runtime.not_running == str(failure)
        with pytest.raises(BusError, match="defect in dpstack"):
            await order
        liar.sock.settimeout(1)
        while liar.sock.recv(65_536):
            pass


async def test_a_hello_that_is_none_ends_the_start_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    liar = Liar()
    liar.hello = {"answer": {"number": 0, "value": {"port_name": 1}}}
    monkeypatch.setattr(channel, "started", liar.start)
    with pytest.raises(BusError, match="Hello cannot be read"):
        await liar.runtime.open()
    assert liar.code == -9
    liar.sock.close()
    liar.image.close()


async def test_counters_that_are_none_do_not_stop_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    async with opened(monkeypatch) as liar:
        closing = asyncio.ensure_future(liar.runtime.close())
        await asyncio.sleep(0)
        liar.code = 0
        liar.say({"answer": {"number": 1, "value": [1]}})
        await closing
        assert liar.runtime.counters() == Counters()


async def test_an_order_ends_where_the_bus_is_closed_as_its_process_hangs_up(monkeypatch: pytest.MonkeyPatch) -> None:
    async with opened(monkeypatch) as liar:
        order = liar.runtime.order(SetMode(Mode.OPERATE))
        liar.sock.close()
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        liar.code = -11
        await liar.runtime.close()
        assert order.done()
        with pytest.raises(BusError, match="SIGSEGV"):
            await order
        (failure,) = liar.failures
        assert "SIGSEGV" in str(failure)


async def test_a_removed_slave_is_offline_too_when_its_process_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    async with opened(monkeypatch) as liar:
        removed = liar.runtime.order(RemoveSlave(4))
        liar.say({"answer": {"number": 1}})
        await removed
        await alive(liar)
        liar.code = 0
        liar.sock.close()
        await until(lambda: bool(liar.failures), "the end of the bus process is noticed")
        assert liar.runtime.slave(4).state is SlaveState.OFFLINE


async def test_a_message_of_octets_on_the_line_tells_no_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor does one about a round: during a silence that would show slaves as alive."""
    async with opened(monkeypatch) as liar:
        liar.say({"tap_lost": 1, **ALIVE})
        liar.say({"round_over": True, **ALIVE})
        order = liar.runtime.order(SetMode(Mode.OPERATE))
        liar.say({"answer": {"number": 1}})
        await order  # its answer comes last
        assert liar.runtime.slave(3).state is SlaveState.OFFLINE


@pytest.fixture
def run() -> Iterator[process_server.Run]:
    """The bus process in virtual time, with two slaves in data exchange in Operate, whose outputs are ``GIVEN``."""
    one = process_server.Run(b"\x0d")
    with process_server.patched(one):
        host = one.begin()
        one.ask("GoOnline")
        one.ask("SetMode", mode=Mode.OPERATE)
        one.run(130 * MS)
        one.write_outputs(0x0C)
        one.run(40 * MS)
        assert all(handler.state is SlaveState.DATA_EXCHANGE for handler in host._master.handlers.values())
        assert [slave.outputs for slave in one.runtime.slaves.values()] == [GIVEN, GIVEN]
        yield one
    one.close()


def put_picture(one: process_server.Run) -> None:
    """Outputs as a number, with the right check sum."""
    area = one.image.outputs
    number = area._words[0] + 1
    place = number % 4
    area._words[1 + 2 * place], area._words[2 + 2 * place] = 1, zlib.crc32(b"\x07", number)
    area._memory[area._at + place * area._limit] = 7
    area._words[0] = number


LIES_OF_APPLICATIONS: dict[str, Callable[[process_server.Run], object]] = {
    "no question": lambda one: one.put(b"\0\0\0\4null"),
    "a number below 0": lambda one: one.put(b'\0\0\0\x24{"number":-1,"order":["GoOnline",{}]}'[:40]),
    "a picture of another kind": put_picture,
}


@pytest.mark.parametrize("lie", LIES_OF_APPLICATIONS)
def test_the_bus_ends_in_order(run: process_server.Run, lie: str) -> None:
    LIES_OF_APPLICATIONS[lie](run)
    run.run(1_000 * MS)
    assert run.loop.stopped
    assert not run.runtime.is_open
    for slave in run.runtime.slaves.values():  # safe values, then Clear
        assert slave.changes[-3:] == [GIVEN, SAFE, bytes(2)]


def test_data_transport_without_a_connection_is_refused() -> None:
    order = RecordOrder(1, Function.DATA_TRANSPORT, 1, 2, data=b"\1", address=3)
    with pytest.raises(UsageError, match="over a class 2 connection only"):
        Ms1(None).job_of(order)
