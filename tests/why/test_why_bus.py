"""``bus.why`` over simulated slaves: the causes that the wire shows, and that asking changes nothing."""

from __future__ import annotations

import asyncio

import pytest
from api_kit import RAW, bench_of, bus_of, in_virtual_time, operating
from faults.slaves import RefusesParameters, refuses_config
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
async def test_a_station_without_a_module_names_the_slot_also_where_it_refuses_set_prm() -> None:
    """The parameters of the I/O station depend on its modules: a missing one shows as Prm_Fault."""
    plugged, configured = ["16 DI", "8 DO"], ["16 DI", "8 DO", "2 AI"]
    world = World()
    table = {"name": "io", "address": 8, "gsd": "io-station", "modules": configured}
    async with (
        dpstack.slave.serve_slave(dpstack.IoStation.of(plugged, name="io"), world=world, address=8),
        dpstack.open_bus(world=world, baud=500_000, slaves=[table]) as bus,
    ):
        await asyncio.sleep(0.5)
        fault = bus.slave("io").fault
        assert fault is not None
        assert fault.kind.value == "prm_fault"
        assert fault.message.startswith(
            "refuses the parameters (Prm_Fault): slot 3 has no module, the configuration 2 AI; Set_Prm was 88"
        )
        assert fault.remedy.endswith('or, if the station is right, write modules = ["16 DI", "8 DO"]')
        assert (fault.actual, bus.slave("io").setup.config) == (b"\x11\x20", b"\x11\x20\x51")
        story = await bus.why("io", ask=False)
    assert story.first.cause == "module_missing"


@in_virtual_time
async def test_swapped_addresses_and_a_station_elsewhere_are_seen_without_asking() -> None:
    world, params = World(), BusParams.preset(500_000)
    for address, ident in ((9, 0x4321), (4, 0x1234), (40, 0x5555)):
        world.add(make_slave(address, MirrorDevice(ident, b"\x20\x10"), params))
    away = {**RAW, "name": "away", "address": 41, "ident": 0x5555}
    slaves = [RAW, {**OTHER, "ident": 0x4321}, away]
    async with dpstack.open_bus(world=world, baud=500_000, slaves=slaves, gap=1) as bus:
        await asyncio.sleep(3)
        assert (await bus.why("raw", ask=False)).first.next == "exchange the addresses 9 and 4 (other)"
        assert (await bus.why("other", ask=False)).first.next == "exchange the addresses 4 and 9 (raw)"
        story = await bus.why("away", ask=False)
    assert any(text.startswith("Address 40 answers, and no slave is") for text in story.first.speaks_for)


@in_virtual_time
async def test_an_empty_bus_names_the_rate_and_a_closed_one_still_tells() -> None:
    async with bus_of() as bus:
        with pytest.raises(dpstack.UsageError, match="no slave"):
            await bus.why("raw")
    async with dpstack.open_bus(world=World(), baud=500_000, slaves=[RAW, OTHER]) as bus:
        await asyncio.sleep(0.5)
        assert (await bus.why("raw", scan=False)).first.cause == "rate_mismatch"
    assert (await bus.why("raw")).steps
