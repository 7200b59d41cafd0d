"""MS2 of a slave that a user serves: async functions, I&M, what can be looked at, what ends it."""

from __future__ import annotations

import asyncio
from typing import cast

import pytest
from api_kit import in_virtual_time, operating
from gsd_kit import FILES, device
from octet_class2 import ABORT, INITIATE, RS, SC, Class2
from octet_wire import PARAMS, Wire
from support import WorldFactory

import dpstack
from dpstack import Im0, RecordRefused
from dpstack.api.slave_side.slave_server import ServedSlave
from dpstack.api.streams import Waiters
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.errors import BusError, ConfigError
from dpstack.phy.patience import EXACT
from dpstack.slave import DpSlave, SlaveDescription

RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", ms2=2)


class Rig:
    """Slave 8 with functions that wait until they are let go, and a master of class 2."""

    def __init__(self, *, im: bool = False) -> None:
        self.go = asyncio.Event()
        self.at_work = 0
        self.ended: list[str] = []
        self.served = ServedSlave(
            DpSlave(
                RIG,
                lambda outputs, elapsed: outputs,
                on_read=self.read,
                on_write=self.write,
                on_transport=self.transport,
                im=[Im0(order_id="RIG")] if im else (),
            ),
            8,
            False,
            PARAMS,
            EXACT,
            Waiters(),
        )
        self.wire = Wire(self.served.station)
        self.master = Class2(self.wire)

    async def read(self, slot: int, index: int) -> bytes:
        self.at_work += 1
        try:
            await self.go.wait()
        except asyncio.CancelledError:
            self.ended.append(f"{slot}/{index}")
            raise
        if index == 9:
            raise RecordRefused(0xB5, 3)
        return bytes((slot, index))

    async def write(self, slot: int, index: int, data: bytes) -> None:
        self.at_work += 1

    async def transport(self, slot: int, index: int, data: bytes) -> bytes:
        if index == 8:
            return cast(bytes, "text")
        return bytes(241) if index == 9 else data + b"\x99"

    async def turns(self) -> None:
        """Let every task go as far as it can."""
        for _ in range(5):
            await asyncio.sleep(0)


async def fetch(rig: Rig, sap: int, request: str, master: Class2 | None = None) -> str:
    who = master or rig.master
    assert who.ask(sap, request) == SC
    await rig.turns()
    return who.ask(sap)


async def test_functions_serve_both_classes() -> None:
    rig = Rig(im=True)
    sap, second = rig.master.connect(), Class2(rig.wire, 3)
    other = second.connect()
    assert rig.master.ask(sap, "5E 01 02 F0") == SC
    assert second.ask(other, "5E 03 04 F0") == SC
    await rig.turns()
    assert rig.at_work == 2  # side by side
    assert rig.master.ask(sap) == SC
    rig.go.set()
    await rig.turns()
    assert second.ask(other) == "5E 03 04 02 03 04"
    assert rig.master.ask(sap) == "5E 01 02 02 01 02"
    assert await fetch(rig, sap, "5F 01 02 01 55") == "5F 01 02 01"
    assert await fetch(rig, sap, "5E 01 09 F0") == "DE 80 B5 03"
    assert await fetch(rig, sap, "51 01 02 01 55") == "51 01 02 02 55 99"
    assert await fetch(rig, sap, "51 01 08 00") == "D1 80 A1 00"
    assert await fetch(rig, sap, "51 01 09 00") == "D1 80 A1 00"
    assert await fetch(rig, sap, "5F 00 FF 04 08 00 FD E8") == "5F 00 FF 04"
    assert (await fetch(rig, sap, "5E 00 FF F0"))[12:23] == "08 00 FD E8"
    assert [(one.master, one.sap, one.services) for one in rig.served.connections] == [(1, 48, 8), (3, 47, 1)]
    assert rig.served.connections_free == 0
    told = " ".join(event.text for event in rig.served.station.take_events())
    assert "on_transport returned str, what goes back is bytes" in told


@pytest.mark.parametrize("way", ["abort", "silence", "restart", "end"])
async def test_functions_are_cancelled_when_nobody_wants_the_answer(way: str) -> None:
    rig = Rig()
    sap = rig.master.connect()
    assert rig.master.ask(sap, "5E 01 02 F0") == SC
    await rig.turns()
    match way:
        case "abort":
            assert rig.master.ask(sap, ABORT) == SC
        case "silence":
            rig.wire.pass_time(3_000_000_000)
        case "restart":
            rig.served.restart()
        case "end":
            rig.served.switch_off(BusError("over"), rig.wire.now)
    await rig.turns()
    assert rig.ended == ["1/2"]
    assert rig.served.connections == ()
    assert rig.served.connections_free == 2


async def test_a_slave_of_its_description_or_of_its_own_number() -> None:
    def served(ms2: int | None) -> ServedSlave:
        return ServedSlave(DpSlave(RIG, lambda outputs, elapsed: outputs, ms2=ms2), 8, False, PARAMS, EXACT, Waiters())

    assert [served(count).connections_free for count in (None, 0, 5)] == [2, 0, 5]
    master = Class2(Wire(served(0).station))
    assert master.ask(49, INITIATE) == RS
    with pytest.raises(ConfigError, match="0 to 49"):
        served(50)
    with pytest.raises(ConfigError, match="0 to 49"):
        SlaveDescription.simple(1, inputs=1, outputs=1, ms2=50)


@in_virtual_time
async def test_a_slave_refuses_services_that_it_does_not_have(world: WorldFactory) -> None:
    """The master reads why, as one who opens the connection and as one who has it."""
    refused: list[int] = []
    made = world()

    def judge(master: int, wanted: dpstack.slave.InitiateReq) -> None:
        if wanted.profile_ident != 7:
            refused.append(master)
            raise RecordRefused(0xB6)

    slave = DpSlave(RIG, lambda outputs, elapsed: outputs, on_initiate=judge)
    async with (
        dpstack.slave.serve_slave(slave, world=made, address=8) as server,
        dpstack.open_bus(world=made, baud=500_000, address=5, gap=1) as bus,
    ):
        with pytest.raises(dpstack.ServiceRefused, match=r"slave 8 refuses Initiate: .*access denied"):
            await bus.class2.connect(8)
        assert refused == [5]
        connection = await bus.class2.connect(8, profile_ident=7)
        (served,) = server.slave.connections
        server.slave.abort_connection(served.sap, 3)
        await connection.ended()
        assert connection.reason == "the slave aborted it: its user, reason 3"


def test_from_a_gsd_file() -> None:
    whole = device("whole")
    description = slave_description(whole)
    assert (description.ms2, description.ms2_max_len, description.ms2_max_initiate) == (2, 240, 52)
    slave = dpstack.slave.slave_from_gsd(FILES / "whole.gsd", lambda outputs, elapsed: outputs, ["8 DO", "8 DI"])
    assert slave.ms2 == 2


@in_virtual_time
async def test_three_masters_at_once_beside_its_own(world: WorldFactory) -> None:
    """Both ends of ours: connections of two stations and of its class 1 master, MS1 beside them; the cycle goes on."""
    plant = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, ms2=3)
    told: list[str] = []
    at_work = most = 0

    async def read(slot: int, index: int) -> bytes:
        nonlocal at_work, most
        at_work += 1
        most = max(most, at_work)
        await asyncio.sleep(0.05)
        at_work -= 1
        return bytes((slot, index))

    made = world()

    async def busy(bus: dpstack.Bus, slot: int) -> None:
        async with bus.class2.connect(9) as connection:
            for index in range(5):
                assert await connection.read(slot, index) == bytes((slot, index))

    async def records(bus: dpstack.Bus) -> None:
        for index in range(5):
            assert await bus.slave(9).read(7, index) == bytes((7, index))

    slave = DpSlave(plant, lambda outputs, elapsed: outputs, on_read=read)
    async with (
        dpstack.slave.serve_slave(
            slave, world=made, address=9, on_event=lambda event: told.append(event.text)
        ) as server,
        operating(plant.table(9), world=made, gap=1) as owner,
    ):
        owner.slave(9).outputs = b"\x55"
        async with (
            dpstack.open_bus(world=made, baud=500_000, address=5) as one,
            dpstack.open_bus(world=made, baud=500_000, address=6) as two,
        ):
            await asyncio.gather(busy(owner, 1), busy(one, 2), busy(two, 3), records(owner))
            with pytest.raises(dpstack.ServiceRefused):
                async with (
                    one.class2.connect(9),
                    one.class2.connect(9),
                    two.class2.connect(9),
                    owner.class2.connect(9),
                ):
                    raise AssertionError("there are three connections")
        assert most == 4  # side by side
        found = owner.slave(9)
        assert (found.ready_now, found.retries, found.timeouts, found.inputs) == (True, 0, 0, b"\x55")
        assert server.slave.connections == ()
        assert server.slave.connections_free == 3
        assert server.slave.stats.connections == server.slave.stats.closed == 6
    assert sum("its master aborted it: its user" in text for text in told) == 6
