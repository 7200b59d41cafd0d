"""Stations without DP in virtual time, under the referee: services between two controllers, SAPs, handlers, ends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

import pytest
from octet_slave import frame
from support import present

import dpstack
from dpstack.fdl import Confirmation, FdlAnswer, FdlError, FdlIndicated, FdlStation, Ident, RingJoined, StationType
from dpstack.fdl.decoder import Decoder

Program = Callable[[FdlStation, FdlStation], Coroutine[Any, Any, None]]


@asynccontextmanager
async def two(**how: Any) -> AsyncIterator[tuple[FdlStation, FdlStation]]:
    """Stations 1 and 2 in one ring."""
    world = dpstack.World()
    a = dpstack.open_fdl(world=world, baud=187_500, address=1, hsa=5, **how)
    b = dpstack.open_fdl(world=world, baud=187_500, address=2, hsa=5)
    async with a, b:
        yield a, b
    present(world.referee).check()


def run(program: Program, **how: Any) -> None:
    async def main() -> None:
        async with two(**how) as (a, b):
            await program(a, b)

    dpstack.run_virtual(main())


async def status_of(call: Coroutine[Any, Any, object]) -> str:
    with pytest.raises(FdlError) as error:
        await call
    return error.value.status


def test_services_between_two_controllers() -> None:
    async def program(a: FdlStation, b: FdlStation) -> None:
        async with await b.sap(20) as sap:
            assert await a.srd(2, b"\x01", dsap=20, ssap=8) == FdlAnswer(2, Confirmation.NR)
            await sap.update(b"\xaa\xbb")
            answer = await a.srd(2, b"\x02", dsap=20, ssap=8)
            assert (answer, answer.high) == (FdlAnswer(2, Confirmation.DL, b"\xaa\xbb"), False)
            await sap.update(b"\xcc", high=True, once=True)
            assert (await a.srd(2, dsap=20, high=True)).high
            assert (await a.srd(2, dsap=20)).status is Confirmation.NR
            await a.sda(2, b"\x03", dsap=20, ssap=8)
            await a.sdn(2, b"\x04", dsap=20, high=True)
            await a.sdn(127, b"\x05", dsap=20)
            found = [await sap.receive() for _ in range(6)]
            assert [(one.service.value, one.data, one.broadcast) for one in found] == [
                ("SRD", b"\x01", False),
                ("SRD", b"\x02", False),
                ("SRD", b"", False),
                ("SDA", b"\x03", False),
                ("SDN", b"\x04", False),
                ("SDN", b"\x05", True),
            ]
            assert [one.replied for one in found[:3]] == [None, b"\xaa\xbb", b"\xcc"]
            assert (found[4].high, found[4].source, found[4].source_sap) == (True, 1, None)
            assert sap.waiting == 0
        assert await status_of(a.sda(2, b"\x06", dsap=20)) == "RS"

    run(program)


def test_status_ident_and_live_list() -> None:
    async def program(a: FdlStation, b: FdlStation) -> None:
        await b.sap(20)
        assert await a.fdl_status(2) is StationType.MASTER_IN_RING
        assert await a.ident(2) == Ident("dpstack", "soft master")
        await a.sap(None)
        assert await b.ident(1) == Ident("maker", "gateway", "1", "2.0")
        assert await status_of(a.lsap_status(2, 20)) == "RS"
        assert await status_of(a.fdl_status(4)) == "NA"
        assert await a.live_list(addresses=range(6)) == {2: StationType.MASTER_IN_RING}
        assert await b.live_list() == {1: StationType.MASTER_IN_RING}
        assert b.snapshot.las == {1, 2}
        assert a.stations == {2: StationType.MASTER_READY}

    run(program, ident=Ident("maker", "gateway", "1", "2.0"))


def test_a_station_without_saps_answers_rs() -> None:
    async def program(a: FdlStation, b: FdlStation) -> None:
        assert await status_of(a.sda(2, b"\x01", dsap=1)) == "RS"
        assert await status_of(a.ident(2)) == "NR"
        assert await status_of(a.srd(2)) == "RS"

    run(program)


def test_a_handler_that_raises_or_blocks_changes_nothing_on_the_bus() -> None:
    async def program(a: FdlStation, b: FdlStation) -> None:
        reported: list[str] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: reported.append(context["message"]))
        seen: list[bytes] = []
        blocked = asyncio.Event()

        async def handler(indication: FdlIndicated) -> None:
            seen.append(indication.data)
            if indication.data == b"raise":
                raise ValueError("no")
            if indication.data == b"block":
                await blocked.wait()

        await b.sap(20, on_receive=handler, queue=2)
        await a.sda(2, b"raise", dsap=20)
        await asyncio.sleep(0.01)
        assert reported == ["on_receive of SAP 20 raised ValueError: no"]
        await a.sda(2, b"block", dsap=20)
        await a.sda(2, b"next", dsap=20)
        assert await status_of(a.sda(2, b"more", dsap=20)) == "RR"
        assert await a.fdl_status(2) is StationType.MASTER_IN_RING
        assert await b.fdl_status(1) is StationType.MASTER_IN_RING
        blocked.set()
        await asyncio.sleep(0.01)
        await a.sda(2, b"last", dsap=20)
        await asyncio.sleep(0.01)
        assert seen == [b"raise", b"block", b"next", b"last"]
        texts = [one.text for one in b._core.past_events()]
        assert "fdl: on_receive of SAP 20 raised ValueError: no" in texts

    run(program)


def test_sdn_beyond_a_full_queue_is_counted() -> None:
    async def program(a: FdlStation, b: FdlStation) -> None:
        sap = await b.sap(20, queue=1)
        for octet in range(4):
            await a.sdn(2, bytes((octet,)), dsap=20)
        await asyncio.sleep(0.01)
        assert (await sap.receive()).data == b"\x00"
        await a.sdn(2, b"\x09", dsap=20)
        last = await sap.receive(0.1)
        assert (last.data, last.lost) == (b"\x09", 3)

    run(program)


def test_a_sap_used_twice() -> None:
    async def program(a: FdlStation, b: FdlStation) -> None:
        sap = await a.sap(20)
        with pytest.raises(dpstack.UsageError, match="SAP 20 is in use already"):
            await a.sap(20)
        await sap.close()
        await sap.close()
        with pytest.raises(dpstack.UsageError, match="SAP 20 is closed"):
            await sap.receive()
        with pytest.raises(dpstack.UsageError, match="SAP 20 is closed"):
            await sap.update(b"")
        assert await status_of(a.sda(2, b"\x01", ssap=20)) == "LS"
        again = await a.sap(20, access=2, services=("sda",))
        assert a.saps == (again,)
        assert repr(again) == "<Sap 20 open>"

    run(program)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda a: a.sap(63), "own SAPs are 0..62"),
        (lambda a: a.sap("x"), "no whole number"),
        (lambda a: a.sap(5, services="sdx"), "give some of sda, sdn, srd"),
        (lambda a: a.sap(5, services=()), "give some of sda, sdn, srd"),
        (lambda a: a.sap(5, on_receive=3), "on_receive = 3 is no function"),
        (lambda a: a.sap(5, queue=0), "1..256 indications"),
        (lambda a: a.sda("5", b""), "no whole number"),
        (lambda a: a.sda(5, "text"), "is no octets"),
        (lambda a: a.sda(5, b"", timeout=-1), "is no time"),
    ],
)
def test_arguments_of_another_kind(call: Callable[[FdlStation], Any], text: str) -> None:
    async def program(a: FdlStation, b: FdlStation) -> None:
        with pytest.raises(dpstack.UsageError, match=text):
            await call(a)

    run(program)


def test_too_long_and_to_itself() -> None:
    async def program(a: FdlStation, b: FdlStation) -> None:
        async with await b.sap(None), await b.sap(20):
            await a.sda(2, bytes(246))
            await a.sda(2, bytes(244), dsap=20, ssap=20)
            for call in (
                a.sda(2, bytes(247)),
                a.sda(2, bytes(245), dsap=20, ssap=20),
                a.sda(1, b"\x01"),
                a.srd(127, b"\x01"),
                a.sda(2, b"", dsap=63),
            ):
                assert await status_of(call) == "IV"
        with pytest.raises(dpstack.UsageError, match="245 octets of reply data given; 244 fit"):
            await (await b.sap(20)).update(bytes(245))

    run(program)


def test_many_requests_at_a_time() -> None:
    """32 may wait; each has its own answer, whoever is cancelled."""

    async def program(a: FdlStation, b: FdlStation) -> None:
        sap = await b.sap(20, queue=256)
        await sap.update(b"\x01")
        calls = [asyncio.create_task(a.srd(2, bytes((n,)), dsap=20)) for n in range(32)]
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        calls[31].cancel()
        answers = await asyncio.gather(*calls[:31])
        assert {one.data for one in answers} == {b"\x01"}
        assert [(await sap.receive()).data for _ in range(31)] == [bytes((n,)) for n in range(31)]
        over = await asyncio.gather(*(a.srd(2, dsap=20) for _ in range(40)), return_exceptions=True)
        refused = [one for one in over if isinstance(one, FdlError)]
        assert {one.status for one in refused} == {"LR"}
        assert len(refused) == 8

    run(program)


def test_a_request_of_a_station_that_lost_the_ring() -> None:
    async def program(a: FdlStation, b: FdlStation) -> None:
        assert await status_of(a.srd(3)) == "NA"
        waiting = asyncio.create_task(a.srd(2, dsap=1, timeout=5))
        await asyncio.sleep(0)
        await a.close()
        with pytest.raises(dpstack.UsageError, match="the bus is closed"):
            await waiting
        with pytest.raises(dpstack.UsageError, match="not open any more"):
            await a.sda(2, b"")

    run(program)


def test_the_end_closes_the_saps() -> None:
    async def program(a: FdlStation, b: FdlStation) -> None:
        sap = await a.sap(20)
        seen: list[bytes] = []

        async def read() -> None:
            seen.extend([indication.data async for indication in sap.indications()])

        reader = asyncio.create_task(read())
        await b.sda(1, b"\x01", dsap=20)
        await a.close()
        await reader
        assert seen == [b"\x01"]
        assert not sap.is_open
        await sap.close()

    run(program)


def test_events_and_properties() -> None:
    async def main() -> None:
        seen: list[dpstack.Event] = []
        fdl = dpstack.open_fdl(port="virtual", baud=500_000, address=7, on_event=seen.append)
        assert repr(fdl) == "<FdlStation 7 on virtual 500 kbit/s not open>"
        async with fdl:
            assert (fdl.params.address, fdl.driver, fdl.is_open, fdl.collision) == (7, "virtual", True, None)
            assert any(isinstance(event, RingJoined) for event in seen)
            async for event in fdl.events():
                if isinstance(event, RingJoined):
                    break
            await fdl.until(lambda: fdl.seconds > 0)
            assert fdl.stations == {}
        assert not fdl.is_open

    dpstack.run_virtual(main())


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ({}, "open_fdl: no baud"),
        ({"baud": 500_000}, "open_fdl: no port"),
        ({"baud": 500_000, "port": "virtual", "read_only": True}, "read_only is for a bus with DP slaves"),
        ({"baud": 500_000, "port": "virtual", "hsaa": 3}, "unknown argument 'hsaa'.*hsa"),
        ({"baud": 500_000, "port": "virtual", "ident": "me"}, "is no Ident"),
        ({"baud": 500_000, "port": "virtual", "ident": Ident("x" * 250)}, "196 fit"),
        ({"baud": 500_000, "port": "virtual", "on_event": 3}, "on_event"),
        ({"baud": 500_000, "world": 3}, "is no World"),
    ],
)
def test_arguments_of_open_fdl(how: dict[str, Any], text: str) -> None:
    with pytest.raises(dpstack.ConfigError, match=text):
        dpstack.open_fdl(**how)


class Responder:
    """A passive station of literal octets, which a world drives: answers to requests by their octets."""

    hears_all = False
    held_up = None
    baud = 9_600

    def __init__(self, address: int, answers: dict[str, str]) -> None:
        self.address = address
        self.answers = answers
        self.heard: list[str] = []
        self._decoder = Decoder(stall_ns=0)
        self._tx: bytes | None = None
        self._at = 0

    def telegram(self, telegram: Any, now: int) -> None:
        from dpstack.fdl.codec import encode

        octets = encode(telegram).hex(" ").upper()
        self.heard.append(octets)
        answer = self.answers.get(octets)
        self._tx, self._at = (None, 0) if answer is None else (bytes.fromhex(answer), now + 11 * 1_000_000_000 // 9_600)

    def receive(self, chunk: bytes, now: int) -> int:
        for telegram in self._decoder.feed(chunk, now):
            self.telegram(telegram, now)
        return self.wake_at()

    def activity(self, now: int) -> None: ...

    def take_tx(self, now: int) -> bytes | None:
        if self._tx is None or now < self._at:
            return None
        octets, self._tx = self._tx, None
        return octets

    def sent(self, at: int) -> int:
        return self.wake_at()

    def wake_at(self) -> int:
        return self._at if self._tx is not None else 1 << 62

    def command(self, command: object, now: int) -> None: ...

    def take_events(self) -> list[Any]:
        return []


def test_the_octets_of_ppi() -> None:
    """S7-200: the request in an SRD without SAPs, SC, then polls until the answer comes; RR means not yet.

    The octets are those that libnodave sends (contributions/keith/nodave.c) and an S7-200 answers.
    """
    negotiate = "32 01 00 00 00 00 00 08 00 00 F0 00 00 01 00 01 03 C0"
    answer = frame(bytes.fromhex("00 02 08 32 03 00 00 00 00 00 08 00 00 00 00 F0 00 00 01 00 01 00 F0"))
    cpu = Responder(
        2,
        {
            f"68 15 15 68 02 00 6C {negotiate} 5E 16": "E5",
            "10 02 00 5C 5E 16": "10 00 02 02 04 16",
            "10 02 00 7C 7E 16": answer.hex(),
        },
    )

    async def main() -> None:
        world = dpstack.World()
        world.add(cpu)
        async with dpstack.open_fdl(world=world, baud=9_600, address=0, hsa=2, gap=0) as fdl:
            assert (await fdl.srd(2, bytes.fromhex(negotiate))).status is Confirmation.NR
            assert await status_of(fdl.srd(2)) == "RR"
            assert (await fdl.srd(2)).data.hex(" ").upper().endswith("F0 00 00 01 00 01 00 F0")
        present(world.referee).check()

    dpstack.run_virtual(main())
    assert [octets for octets in cpu.heard if octets[:2] == "68"] == [f"68 15 15 68 02 00 6C {negotiate} 5E 16"]


def test_the_octets_of_msrd() -> None:
    """A publisher, 5, and master 2: its second exchange has the octets of docs/reference/fdl-services.md#msrd."""
    publisher = Responder(
        5,
        {
            "68 05 05 68 05 02 67 01 02 71 16": "68 05 05 68 7F 05 08 0A 0B A1 16",
            "68 05 05 68 05 02 57 01 02 61 16": "10 02 05 03 0A 16",
        },
    )

    async def main() -> None:
        world = dpstack.World()
        world.add(publisher)
        async with dpstack.open_fdl(world=world, baud=9_600, address=2, gap=0) as fdl:
            assert await fdl.msrd(5, b"\x01\x02") == FdlAnswer(5, Confirmation.DL, b"\x0a\x0b")
            assert await status_of(fdl.msrd(5, b"\x01\x02")) == "RS"
            assert await status_of(fdl.msrd(5, b"\x01\x02")) == "NA"
        present(world.referee).check()

    dpstack.run_virtual(main())
    assert publisher.heard[-1] == "68 05 05 68 05 02 77 01 02 81 16"
