"""FDL services beside the DP master of the same station: what is refused, what goes on, the share of the token hold."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from api_kit import operating
from process_kit import DRIVERS, SPEC, VALVES, Driver, bus_on, octet_slaves
from support import present

import dpstack
from dpstack.fdl import Confirmation, Fdl, FdlError, StationType
from dpstack.testing import BusFactory

A: dict[str, object] = {"name": "a", "address": 5, "ident": 0x1234, "config": "23 13"}


async def status_of(call: Any) -> str:
    with pytest.raises(FdlError) as error:
        await call
    return error.value.status


@pytest.mark.virtual_time
@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda fdl: fdl.srd(5, b"\x00" * 4), r"the default SAP of its slave is Data_Exchange; set bus.slave\(5\)"),
        (lambda fdl: fdl.msrd(5), "the default SAP of its slave"),
        (lambda fdl: fdl.sda(5, b"\x01"), "the default SAP of its slave"),
        (lambda fdl: fdl.sdn(5, b"\x01"), "the default SAP of its slave"),
        (lambda fdl: fdl.sdn(127, b"\x02\x00", dsap=58, ssap=62), "a telegram to all stations"),
        (lambda fdl: fdl.sdn(127, b"\x02\x00", dsap=20), "a telegram to all stations"),
        (lambda fdl: fdl.sdn(7, b"\x02\x00", dsap=63), "SAPs 48 to 63 are those of DP"),
        *(
            (lambda fdl, sap=sap: fdl.srd(9, b"\x01", dsap=sap), "SAPs 48 to 63 are those of DP")
            for sap in range(48, 63)
        ),
        (lambda fdl: fdl.srd(5, b"\x01", dsap=3, ssap=50), "SAPs 48 to 63 are those of DP"),
        (lambda fdl: fdl.sap(62), "SAP 62 belongs to the DP master"),
        (lambda fdl: fdl.sap(48), "SAP 48 belongs to the DP master"),
    ],
)
async def test_nobody_works_behind_the_masters_back(call: Callable[[Fdl], Any], text: str) -> None:
    async with operating(A) as bus:
        with pytest.raises(dpstack.UsageError, match=text):
            await call(bus.fdl)
        if "SAP 62" not in text:
            assert bus.slave(5).ready_now


@pytest.mark.virtual_time
async def test_a_slave_added_later_is_the_masters_too() -> None:
    async with operating(A) as bus:
        assert await status_of(bus.fdl.srd(6, b"\x01")) == "NA"
        await bus.add_slave({**A, "name": "b", "address": 6})
        await bus.ready()
        with pytest.raises(dpstack.UsageError, match="the default SAP of its slave"):
            await bus.fdl.srd(6, b"\x01")


@pytest.mark.virtual_time
async def test_what_is_allowed() -> None:
    async with operating(A) as bus:
        fdl = bus.fdl
        assert fdl is bus.fdl
        assert await fdl.fdl_status(5) is StationType.SLAVE
        assert await status_of(fdl.ident(5)) == "NR"
        assert await status_of(fdl.lsap_status(5, 60)) == "RS"
        assert await status_of(fdl.srd(5, b"\x01", dsap=20, ssap=20)) == "RS"
        assert repr(fdl) == "<Fdl of virtual>"
        assert bus.slave(5).ready_now


@pytest.mark.virtual_time
async def test_a_read_only_bus_sends_no_data() -> None:
    world = dpstack.World()
    async with dpstack.open_bus(world=world, baud=500_000, slaves=[A], read_only=True) as bus:
        assert await status_of(bus.fdl.fdl_status(9)) == "NA"
        for call in (bus.fdl.sda(9, b"\x01"), bus.fdl.srd(9, dsap=20), bus.fdl.sdn(9, b"\x01", dsap=20)):
            with pytest.raises(dpstack.UsageError, match="this bus is read-only"):
                await call
        with pytest.raises(dpstack.UsageError, match="those of DP"):
            await bus.fdl.srd(9, dsap=60)
    present(world.referee).check()


def test_a_partner_and_the_share_of_the_hold(dpstack_bus: BusFactory) -> None:
    """A hundred requests to another controller: one in a hold, and the rounds go on; both ends of the services."""
    bus = dpstack_bus(slaves=[A], hsa=10)
    fdl = bus.master.fdl

    async def program() -> None:
        async with bus.open_fdl(7, hsa=10) as partner, await partner.sap(20, queue=256) as sap:
            await sap.update(b"\x01")
            own = await fdl.sap(21)
            await own.update(b"\x02")
            rounds = bus.master.stats.rotations
            answers = [await fdl.srd(7, bytes((n,)), dsap=20) for n in range(5)]
            many = await asyncio.gather(*(fdl.srd(7, bytes((n,)), dsap=20, high=n % 2 > 0) for n in range(30)))
            assert {one.status for one in [*answers, *many]} == {Confirmation.DL}
            assert bus.master.stats.rotations - rounds >= 30
            assert (await partner.srd(2, dsap=21)).data == b"\x02"
            await partner.sda(2, b"\x09", dsap=21, ssap=20)
            indication = [await own.receive(), await own.receive()][1]
            assert (indication.data, indication.source, indication.source_sap) == (b"\x09", 7, 20)
            assert bus.slave("a").ready_now

    bus.run(program())


@pytest.mark.virtual_time
async def test_no_fixed_cycle_begins_late() -> None:
    """Requests to silent addresses and long answers, while a cycle of 2 ms leaves them 0.6 ms."""
    async with operating(A, cycle_ms=2, gap=0) as bus:
        calls: list[Any] = [bus.fdl.srd(address, dsap=20, timeout=0.2, reply_max=4) for address in range(20, 30)]
        calls += [bus.fdl.srd(31, dsap=20, timeout=0.2), bus.fdl.sda(32, bytes(200), timeout=0.2)]
        ends = await asyncio.gather(*calls, return_exceptions=True)
        assert [one.status if isinstance(one, FdlError) else "" for one in ends] == ["NA"] * 10 + ["LR"] * 2
        assert "it fitted between no two fixed cycles in 0.2 s" in str(ends[10])
        cycles = present(bus.stats.cycles)
        assert cycles.begun == 100  # exactly, in virtual time: 0.2 s
        assert cycles.missed == 0


@pytest.mark.parametrize("driver", DRIVERS)
async def test_both_drivers_on_a_pty(driver: Driver) -> None:
    with octet_slaves(SPEC) as (path, _):
        async with bus_on(path, driver, VALVES | {"watchdog_ms": 3000}) as bus:
            await bus.ready(60)
            assert await bus.fdl.fdl_status(4, timeout=60) is StationType.SLAVE
            with pytest.raises(dpstack.UsageError, match="Data_Exchange"):
                await bus.fdl.srd(4, b"\x00\x00")
            async with await bus.fdl.sap(20) as sap:
                await sap.update(b"\x01")
                with pytest.raises(dpstack.UsageError, match="in use already"):
                    await bus.fdl.sap(20)
            assert bus.slave("valves").ready_now
