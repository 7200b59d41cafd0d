"""``bus.class2``: the services of a class 2 master for its own slaves and those of other masters; their errors."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from api_kit import HOIST, RAW, bus_of, operating, slave_in
from support import instance, present

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.config.config import make_config
from dpstack.api.slave.class2 import Class2, Configuration, ProcessData
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.interface import RS_REPLY, SC_REPLY, Reply, StationControl
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Telegram
from dpstack.params import BusParams
from dpstack.sim.world import World

pytestmark = pytest.mark.virtual_time

NAMED = {**RAW, "config": "21 11", "inputs": {"limit": "bool@0.3", "low": "u8@1"}, "outputs": {"level": "i16@0"}}


async def test_its_own_slaves_by_name_and_address() -> None:
    async with operating(NAMED, HOIST) as bus:
        raw = bus.slave("raw")
        raw["level"] = 0x0805
        await asyncio.sleep(0.05)
        diagnosis = await bus.class2.diagnosis("raw")
        assert (diagnosis.ident, diagnosis.master) == (0x1234, 2)
        config = await bus.class2.config(raw)
        assert (config.octets, config.input_len, config.output_len, config.finding) == (b"\x21\x11", 2, 2, None)
        assert [part.inputs for part in config.identifiers] == [0, 2]
        assert await bus.class2.inputs(9) == ProcessData(b"\x08\x05", {"limit": True, "low": 5})
        assert await bus.class2.outputs(9) == ProcessData(b"\x08\x05", {"level": 0x0805})
        both = await asyncio.gather(*(bus.class2.diagnosis(a) for a in (3, 9, 3, 9)))
        assert [d.ident for d in both] == [0x0696, 0x1234, 0x0696, 0x1234]
        assert all(slave.ready_now and slave.retries == slave.timeouts == 0 for slave in bus.slaves)


@pytest.mark.parametrize("read_only", [False, True])
async def test_the_slaves_of_another_master(read_only: bool) -> None:
    """A read-only bus reads them, too, and refuses the service that writes."""
    async with operating(NAMED, gap=1) as owner:
        owner.slave(9)["level"] = 0x1234
        await asyncio.sleep(0.05)
        world = present(owner.world)
        _, spare = slave_in(world, MirrorDevice(0x4321, b"\x21"), 126)
        config = make_config("virtual", 500_000, 5, bus={"read_only": read_only})
        async with dpstack.open_bus(config, world=world) as bus:
            assert (await bus.class2.diagnosis(9)).master == 2
            assert (await bus.class2.config(9)).octets == b"\x21\x11"
            assert await bus.class2.inputs(9) == ProcessData(b"\x12\x34", {})
            assert (await bus.class2.outputs(9)).octets == b"\x12\x34"
            with pytest.raises(dpstack.DpError) as caught:
                await bus.class2.set_address(9, 7)
            if read_only:
                assert isinstance(caught.value, dpstack.UsageError)
                assert str(caught.value).startswith("this bus is read-only: no slave gets another address;")
            else:
                assert "slave 9 is owned by master 2" in str(instance(caught.value, dpstack.SlaveFault))
            assert core_of(bus).view.link.refused == 0
        slave = owner.slave(9)
        assert (slave.ready_now, slave.retries, slave.timeouts) == (True, 0, 0)
        assert spare.stats.exchanges == 0


class Settable(SlaveApp):
    """Takes each new address, and none after one with No_Add_Chg."""

    __slots__ = ("control", "locked")

    control: StationControl
    locked: bool

    def attached(self, station: StationControl) -> None:
        super().attached(station)
        self.control = station
        self.locked = False

    def serve(self, request: Telegram, now: int) -> Reply | None:
        if request.dsap != 55:
            return super().serve(request, now)
        if self.master is not None:
            return RS_REPLY
        if not self.locked:
            self.control.set_address(request.data[0])
            self.locked = request.data[3] != 0
        return SC_REPLY


def settable(world: World, address: int = 126) -> Settable:
    app = Settable(MirrorDevice(0x1234, bytes.fromhex("21 11")))
    world.add(PassiveStation(address, app, BusParams.preset(500_000)))
    return app


async def test_a_slave_as_delivered_gets_its_address_and_is_taken_up() -> None:
    """The whole commissioning: 126 becomes 9, the address of a slave that the master waits for."""
    world = World()
    app = settable(world)
    async with bus_of(NAMED, world=world) as bus:
        with pytest.raises(dpstack.SlaveTimeout):
            await bus.ready(0.5)
        found = await bus.class2.set_address(126, 9, ident=0x1234)
        assert found.ident == 0x1234
        assert app.control.address == 9
        await bus.ready()
        with pytest.raises(dpstack.UsageError, match="slave 9 is parameterised by this master"):
            await bus.class2.set_address(9, 10)
        await bus.remove(9)
        await asyncio.sleep(0.5)
        await bus.class2.set_address(9, 10, no_change=True)
        with pytest.raises(dpstack.ServiceRefused, match="kept its address; its address was locked") as caught:
            await bus.class2.set_address(10, 11)
        assert (caught.value.service, caught.value.status, caught.value.address) == ("Set_Slave_Add", "ignored", 10)
        assert app.control.address == 10
    present(world.referee).check()


Call = Callable[[Class2], Coroutine[Any, Any, object]]


@pytest.mark.parametrize(
    ("call", "kind", "text"),
    [
        (lambda c: c.diagnosis(77), dpstack.SlaveTimeout, "slave 77 does not answer Slave_Diag; check address and"),
        (lambda c: c.inputs(20), dpstack.ServiceRefused, r"slave 20 refuses RD_Inp \(RS\); it is open in data"),
        (lambda c: c.diagnosis("nobody"), dpstack.UsageError, "no slave 'nobody' on this bus; there are: raw"),
        (lambda c: c.config(127), dpstack.UsageError, "address 127: a slave has 0..126"),
        (lambda c: c.config(2), dpstack.UsageError, "address 2 is that of this master itself"),
        (lambda c: c.set_address(20, 126), dpstack.UsageError, "address 126 cannot be given to a slave: 0..125"),
        (lambda c: c.set_address(20, 9), dpstack.SlaveFault, "address 9 is in use: a station answers there"),
        (
            lambda c: c.set_address(20, 21, ident=1),
            dpstack.SlaveFault,
            "another device: ident 0x4321 instead of 0x0001",
        ),
        (lambda c: c.set_address(20, 21, ident=-1), dpstack.UsageError, "ident = -1 does not fit"),
        (lambda c: c.diagnosis(77, timeout=0.0), dpstack.SlaveTimeout, "was not over after 0 s"),
    ],
)
async def test_every_error_is_typed(call: Call, kind: type[dpstack.DpError], text: str) -> None:
    async with bus_of(NAMED) as bus:
        await bus.ready()
        slave_in(present(bus.world), MirrorDevice(0x4321, b"\x21"), 20)
        with pytest.raises(kind, match=text) as caught:
            await call(bus.class2)
        assert type(caught.value) is kind
        assert bus.slave(9).ready_now


async def test_too_many_at_a_time() -> None:
    async with bus_of(NAMED) as bus:
        await bus.ready()
        ends = await asyncio.gather(*(bus.class2.config(9) for _ in range(40)), return_exceptions=True)
        good = [end for end in ends if isinstance(end, Configuration)]
        bad = [end for end in ends if isinstance(end, dpstack.UsageError)]
        assert (len(good), len(bad)) == (32, 8)
        assert str(bad[0]) == "32 class 2 services are waiting already: await their results first"
        assert (await bus.class2.config(9)).octets == b"\x21\x11"


async def test_services_end_with_the_bus_and_need_an_open_one() -> None:
    bus = bus_of(NAMED)
    with pytest.raises(dpstack.UsageError, match="the bus is not open"):
        await bus.class2.config(9)
    async with bus:
        await bus.ready()
        waiting = [asyncio.create_task(bus.class2.diagnosis(77)) for _ in range(30)]
        await asyncio.sleep(0)
    ends = await asyncio.gather(*waiting, return_exceptions=True)
    assert all(isinstance(end, (dpstack.UsageError, dpstack.SlaveTimeout)) for end in ends)
    assert "the bus is closed" in {str(end) for end in ends}
    with pytest.raises(dpstack.UsageError, match="the bus is not open"):
        await bus.class2.config(9)


async def test_cancelled_services_leave_the_queue() -> None:
    async with bus_of(NAMED) as bus:
        await bus.ready()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.001):
                await asyncio.gather(*(bus.class2.diagnosis(77) for _ in range(32)))
        assert (await bus.class2.config(9)).octets == b"\x21\x11"


def test_identifier_octets_that_cannot_be_read() -> None:
    assert Configuration.of(b"\x21\xc0").finding == (
        "identifier octet 1 (0xc0) announces a length octet that is missing"
    )
    assert Configuration.of(b"\x21\xc0").octets == b"\x21\xc0"


async def test_services_do_not_fill_the_history() -> None:
    told: list[dpstack.Event] = []
    async with bus_of(NAMED, on_event=told.append) as bus:
        await bus.ready()
        for _ in range(5):
            await bus.class2.inputs(9)
        assert not [event for event in told if "RD_Inp" in event.text]
