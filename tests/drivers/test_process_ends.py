"""The bus process and its application: whoever dies, the outputs are safe, the port is free, everybody is told."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from far_ends import until
from process_kit import LAMPS, LAMPS_SPEC, SPEC, VALVES, bus_on, octet_slaves, process_of

import dpstack
from dpstack.dp.events import DriveEvent
from dpstack.drivers import messages as m
from dpstack.drivers.echo import Echo
from dpstack.drivers.host import Host
from dpstack.drivers.outbox import FULL, Outbox
from dpstack.drivers.plain_loop import PlainLoop
from dpstack.drivers.shared_image import SharedImage, make_memory
from dpstack.drivers.stack import StackSpec
from dpstack.errors import BusError, ConfigError, PortError, UsageError
from dpstack.params import BusParams
from dpstack.phy.patience import HOST
from dpstack.ports import open_port
from dpstack.trace import Notice

#: safe values reach the outputs, then Clear's zeros
AFTER = (b"\xa5\x5a", bytes(2))
APPLICATION = """
import asyncio, sys
sys.path.insert(0, {tests!r})
from process_kit import VALVES, bus_on, process_of
async def main():
    async with bus_on({path!r}, "process", VALVES) as bus:
        await bus.ready()
        await bus.operate()
        bus.slave("valves").outputs = b"\\x11\\x22"
        while bus.slave("valves").inputs != b"\\x11\\x22":
            await asyncio.sleep(0.005)
        print(process_of(bus), flush=True)
        {then}
asyncio.run(main())
"""


def runs(pid: int) -> bool:
    """Not ended, or not taken notice of by its parent."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def eventually(condition: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end, f"did not happen: {what}"
        time.sleep(0.005)


def is_full(outbox: Outbox) -> bool:
    return outbox.full


async def test_the_bus_process_is_killed() -> None:
    told: list[str] = []
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there):
        lamps = LAMPS | {"watchdog_ms": 0}
        bus = bus_on(path, "process", VALVES | {"watchdog_ms": 200}, lamps, on_event=lambda e: told.append(e.text))
        async with bus:
            await bus.ready()
            await bus.operate()
            bus.slave("lamps").outputs = b"\x11"
            await until(lambda: bus.slave("lamps").inputs == b"\x11", "its mirror")
            waiting = asyncio.gather(
                bus.rotated(None),
                bus.class2.diagnosis(99, timeout=60),
                bus.events().__anext__(),
                return_exceptions=True,
            )
            await asyncio.sleep(0)
            os.kill(process_of(bus), signal.SIGKILL)
            for error in await waiting:
                if isinstance(error, BusError):
                    assert str(error) == (
                        "the bus process was killed by SIGKILL: nothing is sent any more. The slaves' watchdogs make "
                        "their outputs safe within 200 ms; lamps without watchdog keeps the last outputs; "
                        "open the bus anew"
                    )
            assert [type(error) for error in await waiting][:2] == [BusError, BusError]
            with pytest.raises(BusError, match="killed by SIGKILL"):
                await bus.operate()
            with pytest.raises(BusError, match="killed by SIGKILL"):
                await bus.ready()
            assert not bus.station.in_ring
            assert not bus.slave("lamps").ready_now
            assert bus.stats.slaves[5].exchanges > 0  # what is known stays
            async with bus_on(path, "asyncio", VALVES) as again:  # the port is free
                await again.ready()
        assert sum("SIGKILL" in text for text in told) == 1
        assert there.slaves[5].outputs == b"\x11"


async def test_the_bus_process_is_told_to_end() -> None:
    with octet_slaves(SPEC) as (path, there):
        async with bus_on(path, "process", VALVES) as bus:
            await bus.ready()
            await bus.operate()
            bus.slave(4).outputs = b"\x11\x22"
            await until(lambda: bus.slave(4).inputs == b"\x11\x22", "its mirror")
            os.kill(process_of(bus), signal.SIGINT)  # a terminal's Ctrl-C is the application's
            os.kill(process_of(bus), signal.SIGTERM)
            with pytest.raises(BusError, match=r"has ended: it was told to end \(SIGTERM\); outputs were set to their"):
                await bus.rotated(None, 20)
            await until(lambda: there.slaves[4].outputs in AFTER, "safe values")
            await until(lambda: there.slaves[4].control == b"\x02\x00", "Clear")


@pytest.mark.parametrize("then", ["await asyncio.sleep(60)", "import time; time.sleep(60)"])
def test_the_application_is_killed(then: str) -> None:
    with octet_slaves(SPEC) as (path, there):
        text = APPLICATION.format(tests=str(Path(__file__).parents[1]), path=path, then=then)
        with subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE) as application:
            assert application.stdout is not None
            child = int(application.stdout.readline())
            assert there.slaves[4].outputs == b"\x11\x22"
            application.kill()
            killed = time.monotonic()
            eventually(lambda: there.slaves[4].outputs in AFTER, "safe values")
            assert time.monotonic() - killed < 10  # of what a watchdog of 1 s may need on a busy computer
            eventually(lambda: there.slaves[4].control == b"\x02\x00", "Clear")
            eventually(lambda: not runs(child), "the end of the bus process")
        port = open_port(path, 1_500_000)
        asyncio.run(port.open())  # nobody holds it
        port.close()


async def test_a_port_that_cannot_be_opened_is_told_as_always(tmp_path: Path) -> None:
    with pytest.raises(PortError, match="nowhere"):
        await bus_on(str(tmp_path / "nowhere"), "process", VALVES).open()
    with octet_slaves(SPEC) as (path, _there):
        async with bus_on(path, "process", VALVES):
            with pytest.raises(dpstack.PortBusyError, match=r"held by|in use|busy"):
                await bus_on(path, "process", VALVES).open()


async def test_the_end_of_a_bus_that_was_never_opened() -> None:
    bus = bus_on("/dev/nowhere", "process", VALVES)
    assert bus.stats.slaves[4].outputs == b"\xa5\x5a"
    await bus.close()
    with pytest.raises(UsageError):
        await bus.operate()


async def test_an_application_that_does_not_read_for_a_while() -> None:
    """Its loop is held up while slaves come and go: the bus goes on, and it learns the latest state."""
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there):
        async with bus_on(path, "process", VALVES, LAMPS) as bus:
            await bus.ready()
            await bus.operate()
            exchanges = there.slaves[4].exchanges
            gone = there.slaves.pop(5)
            eventually(lambda: there.slaves[4].exchanges > exchanges + 50, "the bus goes on")
            there.slaves[5] = gone
            gone.prm_ok = gone.cfg_ok = False
            await bus.until(lambda: not bus.slave("lamps").ready_now, 20)
            await bus.slave("lamps").ready(20)
            assert bus.slave("valves").ready_now


def test_nobody_reads_what_the_bus_process_tells() -> None:
    """Bounded: beyond the limit it says so, and what somebody waits for is still taken."""
    loop = PlainLoop()
    ours, theirs = socket.socketpair()
    with theirs:
        ours.setblocking(False)
        outbox = Outbox(loop, ours)
        event = m.named(Notice(t_ns=1, source="x" * 1000, message="y"))
        sent = 0
        while not is_full(outbox):
            outbox.send(m.Message(news=m.News(events=[event])))
            sent += 1
            assert sent < 10 * FULL
        outbox.send(m.Message(answer=m.Answer(7)))
        frames = m.Frames()
        got: list[m.Message] = []

        def read() -> None:
            got.extend(frames.feed(theirs.recv(65_536)))
            if any(message.answer for message in got):
                loop.stop()

        loop.add_reader(theirs.fileno(), read)
        loop.run()
        assert len(got) == sent + 1
        assert [message.answer for message in got if message.answer is not None] == [m.Answer(7)]
        assert not is_full(outbox)
        outbox.close()
    loop.close()


class Rig:
    """A bus process's inside in this process: its host on a pty, and the application's end of its socket."""

    def __init__(self) -> None:
        params = BusParams.preset(1_500_000, address=2, gap=0)
        spec = StackSpec(
            params=params,
            patience=HOST,
            slaves=(),
            watchdog_ms=1000,
            auto_clear=False,
            data_control_ns=10**9,
            read_only=False,
            watched=True,
        )
        self.loop = PlainLoop()
        ours, self.sock = socket.socketpair()
        memory = make_memory()
        self.image = SharedImage(memory)
        os.close(memory)
        setup = m.SetUp(port="pty", event_char=False, rs485=True, echo=Echo.OFF, tune=False, stack=spec)
        self.host = Host(self.loop, ours, self.image, setup)
        self.host.open(["no real-time priority"])
        self.got: list[m.Message] = []
        self.frames = m.Frames()

    def read(self) -> None:
        self.got += self.frames.feed(self.sock.recv(65_536))

    def close(self) -> None:
        self.sock.close()
        if not self.over:
            self.loop.run()  # the ordered end of a bus without an application
        self.loop.close()
        self.image.close()

    @property
    def over(self) -> bool:
        return any(message.news is not None and message.news.over is not None for message in self.got)

    @property
    def told(self) -> list[str]:
        return [m.event_of(event).text for message in self.got if message.news for event in message.news.events]


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.close()


def test_events_beyond_the_bound_are_dropped_counted_and_told(rig: Rig) -> None:
    event = Notice(t_ns=1, source="x" * 1000, message="y")
    for _ in range(2_000):
        rig.host.on_events([event])
    answer = DriveEvent(t_ns=2, address=3, name="d", payload={"type": "result", "token": 9})
    rig.host.on_events([event, answer])  # somebody waits for this one
    rig.loop.add_reader(rig.sock.fileno(), rig.read)
    dropped = "the application did not read for a while: "

    def look() -> None:
        if any(dropped in text for text in rig.told):
            rig.loop.stop()
        else:
            rig.loop.call_at(time.monotonic_ns() + 10**6, look)

    look()
    rig.loop.run()
    rig.loop.remove_reader(rig.sock.fileno())
    assert rig.told[0] == "bus process: no real-time priority"
    events = rig.told.count(event.text)
    assert 100 < events < 1_000
    assert f"bus process: {dropped}{2_001 - events} events were dropped" in rig.told
    owed = [event for message in rig.got if message.news for event in message.news.events if event[0] == "DriveEvent"]
    assert [m.event_of(event) for event in owed] == [answer]


def test_a_flood_of_orders_is_answered_in_order_and_never_piles_up(rig: Rig) -> None:
    count = 500
    rig.sock.setblocking(False)
    left = b"".join(m.framed(m.Message(question=m.Question(n, m.named(m.AskUnit(77))))) for n in range(1, count + 1))

    def write() -> None:
        nonlocal left
        with contextlib.suppress(BlockingIOError):
            left = left[rig.sock.send(left) :]
        if not left:
            rig.loop.remove_writer(rig.sock.fileno())

    def read() -> None:
        rig.read()
        if rig.got[-1].answer is not None and rig.got[-1].answer.number == count:
            rig.loop.stop()

    rig.loop.add_writer(rig.sock.fileno(), write)
    rig.loop.add_reader(rig.sock.fileno(), read)
    rig.loop.run()
    rig.loop.remove_reader(rig.sock.fileno())
    answers = [message.answer for message in rig.got if message.answer is not None and message.answer.number]
    assert [answer.number for answer in answers] == list(range(1, count + 1))
    assert {answer.error for answer in answers} == {("UsageError", "no slave with address 77 in the bus process")}


def test_garbage_from_the_application_ends_the_bus_in_order(rig: Rig) -> None:
    rig.sock.send(b"\xff" * 8)
    rig.loop.run()
    rig.read()
    assert rig.got[-1].news is not None
    assert "a message of 4294967295 octets" in str(rig.got[-1].news.over)


async def test_a_bus_process_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dpstack.drivers.link.ANSWER_S", 0.05)
    with octet_slaves(SPEC) as (path, _there):
        async with bus_on(path, "process", VALVES) as bus:
            pid = process_of(bus)
            os.kill(pid, signal.SIGSTOP)
            with pytest.raises(BusError, match=rf"the bus process \(pid {pid}\) did not answer within 0.05 s"):
                await bus.operate()
            monkeypatch.setattr("dpstack.drivers.link.ANSWER_S", 5.0)
            os.kill(pid, signal.SIGCONT)
            await bus.ready()
            await bus.until(lambda: bus.mode is dpstack.Mode.OPERATE, 20)  # it was carried out late
            await bus.clear()  # and its answer is not taken for this one's
            await bus.until(lambda: bus.mode is dpstack.Mode.CLEAR, 20)


async def test_a_plugin_that_cannot_be_imported_there(monkeypatch: pytest.MonkeyPatch) -> None:
    from dpstack.profile import registry

    fan = {"name": "fan", "address": 4, "drive": "fuji-frenic"}
    monkeypatch.setattr(registry, "places", lambda: {"fuji-frenic": "elsewhere.module:DRIVE"})
    with pytest.raises(ConfigError, match=r"plugin elsewhere.module:DRIVE cannot be imported in the bus process"):
        await bus_on("/dev/null", "process", fan).open()
    monkeypatch.setattr(registry, "places", dict)
    with pytest.raises(ConfigError, match=r"slave 4 \(fan\): its drive plugin 'fuji-frenic' is an object of this prog"):
        bus_on("/dev/null", "process", fan)


def test_it_runs_in_a_thread_of_the_application() -> None:
    """The bus process ends with the thread that started it only when its loop is over, too."""

    async def program() -> None:
        with octet_slaves(SPEC) as (path, _there):
            async with bus_on(path, "process", VALVES) as bus:
                await bus.ready()

    failed: list[BaseException] = []

    def run() -> None:
        try:
            asyncio.run(program())
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert not failed
