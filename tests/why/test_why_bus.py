"""``bus.why`` over simulated slaves: the causes that the wire shows, and that asking changes nothing."""

from __future__ import annotations

import asyncio

import pytest
from api_kit import RAW, bench_of, bus_of, in_virtual_time, operating
from faulty_slaves import RefusesParameters, refuses_config
from slave_kit import make_slave
from virtual_kit import attach

import dpstack
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.params import BusParams
from dpstack.sim.world import World

OTHER = {**RAW, "name": "other", "address": 4}


@in_virtual_time
async def test_a_healthy_slave_is_healthy_and_is_not_disturbed() -> None:
    async with operating(RAW, OTHER) as bus:
        await asyncio.sleep(0.2)
        raw = bus.slave("raw")
        timeouts = bus.stats.timeouts
        story = await bus.why("raw")
        assert (story.first.cause, story.state, story.source) == ("healthy", "data_exchange", "run")
        assert [step["asked"] for step in story.steps] == [
            "Slave_Diag",
            "Set_Prm",
            "Chk_Cfg",
            "Slave_Diag",
            "Data_Exchange",
        ]
        assert bus.stats.timeouts == timeouts
        assert raw.ready_now


@in_virtual_time
async def test_a_slave_without_power_is_not_there_and_with_another_address_has_that() -> None:
    async with operating(RAW, OTHER) as bus:
        bench_of(bus).power(9, False)
        await asyncio.sleep(0.5)
        story = await bus.why(9)
        assert story.first.cause == "not_there"
        assert any("answered before" in text for text in story.first.speaks_for)
        assert bus.world is not None
        bus.world.add(make_slave(40, MirrorDevice(0x1234, bytes.fromhex("2010")), bus.params))
        story = await bus.why(9)
        assert story.first.cause == "wrong_address"
        assert "40" in story.first.speaks_for[0]
        assert bus.slave(4).ready_now


@in_virtual_time
async def test_refusals_are_told_with_their_octets() -> None:
    world = attach(World(referee=False))
    params = BusParams.preset(500_000)
    for address, app in (
        (9, refuses_config(0x1234, b"\x10\x20")),
        (5, SlaveApp(RefusesParameters(0x1234, b"\x20\x10"))),
    ):
        station = make_slave(address, RefusesParameters(0x1234, b"\x20\x10"), params)
        station.responder = app
        world.add(station)
    refused = {**RAW, "name": "refused", "address": 5, "user_prm": "01 02"}
    async with dpstack.open_bus(world=world, baud=500_000, slaves=[RAW, refused]) as bus:
        await asyncio.sleep(0.5)
        story = await bus.why("raw")
        assert story.first.cause == "module_order"
        last = [step for step in story.steps if step.get("refused_by")][-1]
        assert last["refused_by"] == "octet 1 bit 2: Cfg_Fault"
        assert (await bus.why("refused")).first.cause == "user_parameter"


@in_virtual_time
async def test_an_empty_bus_names_the_rate_and_a_closed_one_still_tells() -> None:
    async with bus_of() as bus:
        with pytest.raises(dpstack.UsageError, match="no slave"):
            await bus.why("raw")
    async with dpstack.open_bus(world=World(), baud=500_000, slaves=[RAW, OTHER]) as bus:
        await asyncio.sleep(0.5)
        assert (await bus.why("raw", scan=False)).first.cause == "rate_mismatch"
    assert (await bus.why("raw")).steps
