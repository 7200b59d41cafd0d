"""The baud rate found at real ports: ptys of a segment that garbles, with a sender that knows only octets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from itertools import cycle
from pathlib import Path
from random import Random

import pytest
from baud_rig import Sent, exchange, lone_token
from far_ends import FarEnd, PtyFarEnd, TcpFarEnd, open_slave, until
from ft12 import CONVERSATIONS
from memory_port import memory_pair

from dpstack.api.bus.find_baud import find_baud, search_baud
from dpstack.drivers.segment.hub import Segment
from dpstack.errors import BaudError, PortError
from dpstack.fdl.baud_search import BaudFound, BaudNotFound, Confidence, Missing
from dpstack.ports import open_port, termios2
from dpstack.ports.tty import TtyPort
from dpstack.units import NS_PER_MS, NS_PER_S


async def talk(master: FarEnd, traffic: Iterator[Sent]) -> None:
    """Send one telegram after the other, without end."""
    for _, octets in traffic:
        master.send(octets)
        await asyncio.sleep(0.001)


@pytest.mark.parametrize(
    ("baud", "traffic", "confidence"),
    [
        (12_000_000, exchange, Confidence.CHECKED),
        (1_500_000, lone_token, Confidence.TOKEN),
        (93_750, exchange, Confidence.CHECKED),
        (45_450, lone_token, Confidence.TOKEN),
        (9_600, exchange, Confidence.CHECKED),
    ],
)
async def test_the_rate_of_a_bus_on_ptys(
    tmp_path: Path, baud: int, traffic: Callable[[Random], Iterator[Sent]], confidence: Confidence
) -> None:
    async with Segment(2, tmp_path / "bus") as segment:
        master = open_slave(segment.paths[0])
        termios2.set_raw(master.fd, baud)
        talking = asyncio.create_task(talk(master, traffic(Random(1))))
        result = await search_baud(open_port(segment.paths[1], 9_600), limit_ns=60 * NS_PER_S)
        talking.cancel()
        assert isinstance(result, BaudFound)
        assert (result.baud, result.confidence) == (baud, confidence)
        master.hang_up()


@pytest.mark.parametrize(("name", "profibus"), [("exchange", True), ("M-Bus writing", False)])
async def test_the_rate_is_named_profibus_only_with_evidence(tmp_path: Path, name: str, profibus: bool) -> None:
    """M-Bus has telegrams of the same form: the rate is found, and the bus gets no name."""
    async with Segment(2, tmp_path / "bus") as segment:
        master = open_slave(segment.paths[0])
        termios2.set_raw(master.fd, 19_200)
        other = ((0, octets) for octets in cycle(CONVERSATIONS["M-Bus writing"]))
        talking = asyncio.create_task(talk(master, exchange(Random(1)) if profibus else other))
        report = await find_baud(str(segment.paths[1]), timeout=60, naming=20 if profibus else 0.2)
        talking.cancel()
        assert (report.baud, report.confidence, report.profibus) == (19_200, "checked", profibus)
        assert report.as_dict().items() >= {"baud": 19_200, "confidence": "checked", "profibus": profibus}.items()
        assert report.evidence.startswith("PROFIBUS: ") == profibus
        master.hang_up()


async def test_a_bus_that_is_garbled_at_every_rate_is_noise(tmp_path: Path) -> None:
    async with Segment(2, tmp_path / "bus") as segment:
        master = open_slave(segment.paths[0])
        termios2.set_raw(master.fd, 500_000)

        async def rattle() -> None:
            rng = Random(2)
            while True:
                master.send(rng.randbytes(20).replace(b"\xe5", b"\x00"))
                await asyncio.sleep(0.001)

        talking = asyncio.create_task(rattle())
        result = await search_baud(open_port(segment.paths[1], 9_600), limit_ns=600 * NS_PER_MS)
        talking.cancel()
        assert isinstance(result, BaudNotFound)
        assert result.why is Missing.NOISE
        master.hang_up()


async def test_silence_and_rates_that_the_port_cannot_do(monkeypatch: pytest.MonkeyPatch) -> None:
    far = PtyFarEnd()
    really = termios2.set_raw
    tried: list[int | None] = []

    def up_to_3m(fd: int, baud: int | None, *, marks: bool) -> termios2.Applied:
        tried.append(baud)
        return really(fd, baud if baud is None or baud <= 3_000_000 else 3_000_000, marks=marks)

    monkeypatch.setattr(termios2, "set_raw", up_to_3m)
    port = open_port(far.path, 9_600)
    result = await search_baud(port, limit_ns=5 * NS_PER_S, silence_ns=100 * NS_PER_MS)
    assert isinstance(result, BaudNotFound)
    assert result.why is Missing.SILENCE
    assert {12_000_000, 6_000_000, 3_000_000} <= set(tried)
    assert port.fd is None  # closed
    far.hang_up()


async def test_a_port_that_knows_none_of_the_rates(monkeypatch: pytest.MonkeyPatch) -> None:
    far = PtyFarEnd()
    port = TtyPort(far.path, 9_600)
    really = port.set_baud

    def only_9600(baud: int) -> None:
        if baud != 9_600:
            raise BaudError("no")
        really(baud)

    monkeypatch.setattr(port, "set_baud", only_9600)
    with pytest.raises(ValueError, match="none of the rates"):
        await search_baud(port, rates=(500_000, 19_200))
    far.hang_up()


async def test_a_port_whose_rate_cannot_be_changed_says_so() -> None:
    far = TcpFarEnd()
    with pytest.raises(PortError, match="give the rate"):
        await search_baud(open_port(far.path, 9_600))
    far.shut()


async def test_a_port_that_vanishes() -> None:
    near, far = memory_pair(9_600)
    await far.open()
    searching = asyncio.create_task(search_baud(near))
    await until(lambda: near.baud != 9_600, "the first change of the rate")
    near.unplug("pulled out")
    with pytest.raises(PortError, match="vanished while listening: pulled out"):
        await searching
    far.close()
