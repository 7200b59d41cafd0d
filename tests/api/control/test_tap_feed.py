"""The command ``tap`` of running programs, as a client of another program uses it: lines of JSON on a socket."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from time import monotonic_ns, time_ns
from typing import Any

import pytest
from api_kit import RAW, bus_of, in_virtual_time, slave_in
from cli_kit import Cli
from control_kit import OctetClient, octet_client
from far_ends import open_slave, until
from process_kit import DRIVERS, SPEC, VALVES, Driver, bus_on, octet_slaves, process_of, stopped
from support_responder import Responder

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.config.config import make_config
from dpstack.api.control import control_server as server_module
from dpstack.api.control import tap_feed
from dpstack.api.control.commands import KINDS
from dpstack.api.control.control_server import ControlServer, Sender
from dpstack.api.control.handlers import control_run
from dpstack.api.control.simulation_handlers import control_segment, control_sim
from dpstack.api.control.tap_feed import TapFeed
from dpstack.api.slave_side.simulation import Segment, Simulation
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.drivers.tap import Tap
from dpstack.sim.world import World
from dpstack.units import NS_PER_MS, NS_PER_S, chars_to_ns

REQUEST = b'{"command":"tap"}'


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Signs of life come soon, portions too."""
    monkeypatch.setattr(tap_feed, "_SIGN_OF_LIFE_S", 0.02)
    monkeypatch.setattr(tap_feed, "TAP_PAUSE_NS", 5 * NS_PER_MS)


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    return Cli(capsys)


class TapClient:
    """Speaks lines of JSON. ``entries``: time, rate, octets, sent by the program; ``lost``: what it was told."""

    def __init__(self, client: OctetClient) -> None:
        self._client = client
        self.abouts: list[dict[str, Any]] = []
        self.entries: list[tuple[int, int, bytes, bool]] = []
        self.lost = 0
        self.signs_of_life = 0

    async def begin(self) -> None:
        self._take(await self._client.ask(REQUEST))

    async def read(self) -> bool:
        """The next line; False at the end."""
        line = await self._client.line()
        if line:
            self._take(line)
        return bool(line)

    async def until(self, count: int) -> None:
        while len(self.entries) < count:
            assert await self.read()

    async def to_the_end(self) -> None:
        with contextlib.suppress(ConnectionResetError):
            while await self.read():
                pass

    def _take(self, line: bytes) -> None:
        answer = json.loads(line)
        assert answer.keys() == {"item"}
        item = answer["item"]
        if "epoch_ns" in item:
            self.abouts.append(item)
            return
        assert item.keys() == {"lost", "octets"}
        self.lost += item["lost"]
        self.signs_of_life += not item["octets"]
        for end_ns, baud, octets, sent in item["octets"]:
            self.entries.append((end_ns, baud, bytes.fromhex(octets), sent))

    @property
    def octets(self) -> bytes:
        return b"".join(octets for _, _, octets, _ in self.entries)


@contextlib.asynccontextmanager
async def tapping(port: str) -> AsyncIterator[TapClient]:
    async with octet_client(port) as client:
        tap = TapClient(client)
        await tap.begin()
        yield tap


# --- everything that is on the line, and nothing else ---


async def test_a_run_on_virtual_gives_what_is_in_the_worlds_log_with_its_times() -> None:
    world = World(keep=100_000)
    slave_in(world, MirrorDevice(0x1234, bytes.fromhex("20 10")), 9)
    async with bus_of(RAW, world=world) as bus, control_run(bus, "virtual") as server:
        await bus.ready()
        before = time_ns()
        async with tapping(server.name) as tap:
            begun = world.now
            await tap.until(600)
            (about,) = tap.abouts
            assert (about["baud"], about["paced"], about["exact"]) == (500_000, True, True)
            assert before - NS_PER_S < about["epoch_ns"] + begun < time_ns()
        log = [(one.end_ns, one.octets) for one in world.log if one.end_ns <= tap.entries[-1][0]]
        got = [(end_ns, octets) for end_ns, _, octets, _ in tap.entries]
        assert got == log[-len(got) :]
        assert got[0][0] <= begun + 200_000_000
        assert tap.lost == 0
        count = world.transmissions
        await until(lambda: world.transmissions > count + 20, "the bus runs on")


class Wire(Responder):
    """The octets on the line as its other end sees them."""

    def __init__(self, path: str, specs: list[str]) -> None:
        super().__init__(path, specs)
        self.log = bytearray()

    def feed(self, chunk: bytes) -> bytes:
        answer = super().feed(chunk)
        self.log += chunk + answer
        return answer


@contextlib.contextmanager
def wire(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, Wire]]:
    monkeypatch.setattr("process_kit.Responder", Wire)
    with octet_slaves(SPEC) as (path, there):
        assert isinstance(there, Wire)
        yield path, there


@pytest.mark.parametrize("driver", DRIVERS)
async def test_a_run_gives_every_octet_of_its_line_up_to_the_end_of_the_bus(
    driver: Driver, monkeypatch: pytest.MonkeyPatch
) -> None:
    with wire(monkeypatch) as (path, there):
        bus = bus_on(path, driver, VALVES)
        async with control_run(bus, path):
            await bus.open()
            await bus.ready(60)
            runtime: Any = core_of(bus).runtime
            async with tapping(path) as tap:
                await tap.until(20)
                assert runtime._tap is not None
            await until(lambda: runtime._tap is None, "the end of the tap")
            assert tap.octets in bytes(there.log)
            pid = os.fork()
            if not pid:
                os._exit(0)
            assert os.waitpid(pid, 0) == (pid, 0)  # noqa: ASYNC222 - it ends at once
            async with tapping(path) as tap, tapping(path) as other:
                await tap.until(200)
                await other.until(200)
                assert tap.abouts[0]["baud"] == 1_500_000
                ending = asyncio.create_task(bus.close())
                while not ending.done():
                    await tap.read()
                await ending
                count = len(there.log)
                end = bytes(there.log)
                while not end.endswith(tap.octets):
                    await tap.read()
                assert len(there.log) == count
            # one of both begins later; from there on they get the same
            assert tap.entries[-len(other.entries) :][:150] == other.entries[:150] or other.octets in end
        assert (tap.lost, other.lost) == (0, 0)
        times = [end_ns for end_ns, *_ in tap.entries]
        assert times == sorted(times)
        assert 0 <= monotonic_ns() - times[-1] < 600 * NS_PER_S
        sent = [octets for _, _, octets, by_itself in tap.entries if by_itself]
        assert {octets[0] for octets in sent} <= {0x10, 0x68, 0xDC}
        assert all(octets[-1] == 0x16 or len(octets) == 3 for octets in sent)


async def test_a_bus_process_that_is_stopped_goes_on_and_dies(monkeypatch: pytest.MonkeyPatch) -> None:
    with wire(monkeypatch) as (path, _there):
        bus = bus_on(path, "process", VALVES)
        async with control_run(bus, path):
            await bus.open()
            await bus.ready(60)
            runtime: Any = core_of(bus).runtime
            async with octet_client(path) as client:
                tap = TapClient(client)
                with stopped(process_of(bus)):
                    await tap.begin()
                    while tap.signs_of_life < 3:
                        await tap.read()
                    assert not tap.entries
                await tap.until(20)
            with stopped(process_of(bus)):
                async with tapping(path):
                    pass
                await until(lambda: runtime._tap is None, "the end of the tap")
            async with tapping(path) as tap:
                await tap.until(20)
                os.kill(process_of(bus), signal.SIGKILL)
                await until(lambda: core_of(bus).runtime.not_running is not None, "the end of the bus process")
                before = tap.signs_of_life
                while tap.signs_of_life < before + 3:
                    await tap.read()
            with contextlib.suppress(dpstack.BusError):
                await bus.close()


def counted(segment: Segment, key: str) -> list[int]:
    stations: Any = segment.stats()["stations"]
    return [station[key] for station in stations]


@pytest.mark.parametrize(("paced", "noise"), [(False, 0.0), (True, 0.0), (False, 3e-3), (True, 3e-3)])
async def test_a_segment_gives_what_its_stations_hear(tmp_path: Path, paced: bool, noise: float) -> None:
    telegrams = [bytes.fromhex("68 05 05 68 82 E3 6D 3C 3E 4C 16"), bytes.fromhex("DC 02 02"), b"\xe5"] * 12
    baud = 187_500
    async with (
        Segment(3, tmp_path / "bus", baud=baud, paced=paced, error_rate=noise) as segment,
        control_segment(segment) as server,
    ):
        ends = [open_slave(path) for path in segment.paths]
        async with tapping(server.name) as tap:
            assert tap.abouts[0] | {"epoch_ns": 0} == {"epoch_ns": 0, "baud": baud, "paced": paced}
            before, total = monotonic_ns(), 0
            for number, telegram in enumerate(telegrams):
                ends[number % 2].send(telegram)
                total += len(telegram)
                await until(lambda: sum(counted(segment, "sent")) == total, "the telegram is sent")  # noqa: B023
                await asyncio.sleep(chars_to_ns(len(telegram), baud) * 2 / NS_PER_S if paced else 0)
            heard = b""
            while sum(counted(segment, "telegrams")) < len(telegrams) or len(heard) < counted(segment, "received")[2]:
                await asyncio.sleep(0.001)
                heard += ends[2].take()
            while len(tap.octets) < len(heard):
                await tap.read()
            after = monotonic_ns()
        for end in ends:
            end.hang_up()
    assert tap.octets == heard
    assert noise or heard == b"".join(telegrams)
    times = [end_ns for end_ns, *_ in tap.entries]
    assert times == sorted(times)
    assert before < times[0] < times[-1] <= after
    if paced:
        assert all(
            late[0] - early[0] >= chars_to_ns(len(late[2]), baud)
            for early, late in zip(tap.entries, tap.entries[1:], strict=False)
        )


async def test_simulated_slaves_that_search_their_rate_are_tapped_once_it_is_found() -> None:
    config = make_config("pty", 500_000, 2, (RAW,), bus={})
    async with Simulation(config, "pty", "auto") as simulation, control_sim(simulation, "pty"):
        end = open_slave(simulation.port_name)
        async with tapping(simulation.port_name) as tap:
            assert tap.abouts[0]["baud"] is None
            status = bytes.fromhex("10 09 02 49 54 16")  # a request to station 9
            for _ in range(3):
                end.send(bytes.fromhex("68 05 05 68 82 E3 6D 3C 3E 4C 16"))
                await tap.read()
            assert not tap.entries  # octets at a rate that is a guess
            while simulation.baud is None:
                end.send(status)
                await asyncio.sleep(0.002)
            while len(tap.abouts) < 2:
                await tap.read()
            assert tap.abouts[1]["baud"] == simulation.baud
            end.take()
            end.send(status)
            await tap.until(2)
        end.hang_up()
    assert [(octets, sent) for _, _, octets, sent in tap.entries][-2:] == [
        (status, False), (bytes.fromhex("10 02 09 00 0B 16"), True)
    ]  # fmt: skip
    assert {baud for _, baud, _, _ in tap.entries} == {tap.abouts[1]["baud"]}


@in_virtual_time
async def test_a_run_in_unpaced_virtual_time() -> None:
    world = World(keep=100_000)
    lines: list[bytes] = []

    class Kept(Sender):
        def __init__(self) -> None: ...

        def offer(self, line: bytes) -> bool:
            lines.append(line)
            return True

        unread = 0

        def check(self) -> None: ...

    slave_in(world, MirrorDevice(0x1234, bytes.fromhex("20 10")), 9)
    async with bus_of(RAW, world=world) as bus:
        await bus.ready()
        feed: Any = control_run(bus, "virtual")._handlers["tap"]([])
        begun = world.now
        task = asyncio.create_task(feed(Kept()))
        await asyncio.sleep(1)
        task.cancel()
        await asyncio.wait([task])
        ended = world.now
    got = [(one[0], one[2]) for line in lines for one in json.loads(line)["item"].get("octets", [])]
    log = [(one.end_ns, one.octets.hex()) for one in world.log if begun < one.end_ns <= ended]
    assert log
    assert got == log


# --- clients ---


class Rig:
    """A program whose line is this test; the clients of its control socket."""

    def __init__(self) -> None:
        self.taps: list[Tap | None] = []
        self.baud: int | None = 500_000
        self.server = ControlServer(
            "segment",
            "COM3",
            KINDS["segment"],
            {"tap": TapFeed(self.taps.append, lambda: 5, lambda: {"baud": self.baud, "paced": True}).handler},
        )

    @property
    def tap(self) -> Tap:
        tap = self.taps[-1]
        assert tap is not None
        return tap

    def put(self, first: int, count: int, size: int = 250) -> None:
        for number in range(first, first + count):
            self.tap.add((number, 500_000, number.to_bytes(size, "big"), False))


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    rig = Rig()
    async with rig.server:
        yield rig


def numbers(tap: TapClient) -> list[int]:
    assert all(int.from_bytes(octets, "big") == number for number, _, octets, _ in tap.entries)
    return [number for number, *_ in tap.entries]


async def test_a_client_that_does_not_read_loses_what_it_learns_and_the_other_one_nothing(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_module, "_MOST_OFFERED", 10_000)
    async with tapping("COM3") as deaf, tapping("COM3") as other:
        total = 0
        while total < 1_500:
            rig.put(total, 500)
            total += 500
            await other.until(total)
        await deaf.until(1)
        while len(deaf.entries) + deaf.lost < total:
            await deaf.read()
    assert numbers(other) == list(range(total))
    assert other.lost == 0
    assert deaf.lost > 0
    assert len(deaf.entries) + deaf.lost == total
    kept = numbers(deaf)
    assert kept == sorted(set(kept))


async def test_losses_of_the_ring_are_told_to_each_client_once_and_in_their_place(rig: Rig) -> None:
    async with tapping("COM3") as one, tapping("COM3") as other:
        await until(lambda: bool(rig.taps), "the tap")
        capacity = rig.tap.capacity
        rig.put(0, capacity + 70, size=2)
        for client in (one, other):
            while client.lost == 0:
                assert await client.read()
            assert numbers(client) == list(range(capacity))  # no entry behind the gap came before it
            assert client.lost == 70
        rig.put(capacity + 70, 3, size=2)
        async with tapping("COM3") as late:
            for client in (one, other):
                await client.until(capacity + 3)
                assert numbers(client)[-1] == capacity + 72
                assert client.lost == 70
            while late.signs_of_life < 2:
                await late.read()
            assert late.lost == 0


async def test_a_client_that_reads_nothing_for_a_minute_is_disconnected(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_module, "_MOST_OFFERED", 10_000)
    monkeypatch.setattr(tap_feed, "_PATIENCE", 3)
    async with tapping("COM3") as tap:
        await until(lambda: bool(rig.taps), "the tap")
        rig.put(0, 2000)
        await until(lambda: rig.taps[-1] is None, "the end of the tap")
        await tap.to_the_end()
    assert numbers(tap) == list(range(len(tap.entries)))


async def test_a_client_that_goes_ends_the_tap_and_others_go_on(rig: Rig) -> None:
    async with tapping("COM3") as stays:
        for _ in range(3):
            async with tapping("COM3"):
                pass
        rig.put(0, 5)
        await stays.until(5)
        assert len(rig.taps) == 1
    await until(lambda: rig.taps[-1] is None, "the end of the tap")
    async with tapping("COM3") as again:
        assert len(rig.taps) == 3
        rig.put(0, 1)
        await again.until(1)


async def test_a_search_in_the_middle_ends_the_tap_until_the_rate_is_found_again(rig: Rig) -> None:
    async with tapping("COM3") as tap:
        rig.put(0, 3)
        await tap.until(3)
        rig.baud = None
        while len(tap.abouts) < 2:
            await tap.read()
        assert rig.taps[-1] is None
        rig.baud = 19_200
        while len(tap.abouts) < 3:
            await tap.read()
        assert [about["baud"] for about in tap.abouts] == [500_000, None, 19_200]
        rig.put(0, 1)
        await tap.until(4)


async def test_the_end_of_the_program_delivers_the_rest_and_waits_for_nobody() -> None:
    rig = Rig()
    async with contextlib.AsyncExitStack() as stack:
        await stack.enter_async_context(rig.server)
        client = await stack.enter_async_context(octet_client("COM3"))
        tap = TapClient(client)
        await tap.begin()
        rig.put(0, 40)
        async with asyncio.timeout(20):
            await rig.server.__aexit__()
        await tap.to_the_end()
        assert numbers(tap) == list(range(40))
    assert rig.taps[-1] is None


# --- dpstack ctl ---


def test_ctl_refuses_a_stream_without_end_and_help_lists_it(cli: Cli) -> None:
    for port in ("/dev/ttyUSB0", "virtual"):
        assert f"dpstack capture --port {port}\n" in cli.err("ctl", port, "tap")


async def test_help_lists_the_tap(rig: Rig) -> None:
    async with octet_client() as client:
        commands = json.loads(await client.ask(b'{"command":"help"}'))["result"]["commands"]
        assert "tap" in [one["command"] for one in commands]
        assert b"tap takes no arguments" in await client.ask(b'{"command":"tap","args":["1"]}')
