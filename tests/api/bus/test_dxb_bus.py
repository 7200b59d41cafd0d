"""Data exchange broadcast on a bus in virtual time: MSRD, filter, the value in the same cycle, safe values, loss."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

import pytest
from api_kit import bench_of, bus_of

import dpstack
from dpstack.dp.master.events import SlaveStateChanged
from dpstack.errors import UsageError
from dpstack.fdl.codec import decode
from dpstack.fdl.telegram import Req
from dpstack.params import BROADCAST, BusParams
from dpstack.slave import DpSlave, DxbSupport, LinkChanged, SlaveDescription
from dpstack.trace import Event, Notice, Severity

pytestmark = pytest.mark.virtual_time

ENCODER: dict[str, Any] = {
    "name": "encoder",
    "address": 7,
    "ident": 0x1111,
    "config": "13 23",
    "user_prm": "00 00 00",
    "dpv1": True,
}
VALVE: dict[str, Any] = {
    "name": "valve",
    "address": 9,
    "ident": 0x1234,
    "config": "15 21 23",
    "user_prm": "00 00 00",
    "dpv1": True,
    "subscribes": [{"from": "encoder", "octets": "1:3", "to": 3}],
}


def links_of(bus: dpstack.Bus) -> list[tuple[object, ...]]:
    return [(one.publisher, one.name, one.to, one.good, one.text) for one in bus.slave("valve").links]


async def test_a_subscriber_has_the_value_in_the_same_cycle() -> None:
    """The publisher counts its exchanges; the simulated subscriber mirrors its outputs."""
    world = dpstack.World(keep=4_000)
    count = 0

    def encode(outputs: bytes, _: int) -> bytes:
        nonlocal count
        count += 1
        return count.to_bytes(4, "big")

    got: list[tuple[int, int]] = []

    def follow(outputs: bytes, _: int) -> bytes:
        got.append((count, int.from_bytes(outputs[3:5], "big")))
        return outputs

    encoder = DpSlave(
        SlaveDescription(ident=0x1111, configs=(b"\x13\x23",), dpv1=True, dxb=DxbSupport(publisher=True)), encode
    )
    valve = DpSlave(
        SlaveDescription(ident=0x1234, configs=(b"\x15\x21\x23",), dpv1=True, dxb=DxbSupport(links=4)), follow
    )
    events: list[Event] = []
    served = dpstack.slave.serve_slaves({7: encoder, 9: valve}, world=world, baud=500_000, on_event=events.append)
    async with served as server:
        table = {**VALVE, "subscribes": [{"from": "encoder", "octets": "2:4", "to": 3}]}
        async with bus_of(ENCODER, table, world=world) as bus:
            await bus.operate()
            bus.slave("valve").outputs = b"\x01\x02\x03\x04\x05\x06"
            await asyncio.sleep(0.2)
            exchanged = got[20:]
            assert len(exchanged) > 20
            assert all(mine == its for mine, its in exchanged)
            assert bus.slave("valve").inputs[:3] == b"\x01\x02\x03"
            assert bus.slave("valve").inputs[5:] == b"\x06"
            (link,) = server.slaves[1].links
            assert link.good
            assert (link.publisher, link.to) == (7, 3)
    assert [one.good for one in events if isinstance(one, LinkChanged)][:1] == [True]
    assert world.referee is not None
    world.referee.check()
    found = [decode(entry.octets) for entry in world.log]
    asked = {one.function for one in found if one and one.is_request and one.da == 7 and one.dsap is None}
    assert asked <= {Req.MSRD, Req.SRD_HIGH, Req.FDL_STATUS}
    assert Req.MSRD in asked
    params = BusParams.preset(500_000)
    answers = [one for one in found if one and not one.is_request and one.da == BROADCAST]
    assert len(answers) > 20
    for request, answer in zip(list(world.log), list(world.log)[1:], strict=False):
        one = decode(answer.octets)
        if one is not None and one.da == BROADCAST and not one.is_request:
            assert answer.start_ns - request.end_ns >= params.ns(params.publisher_min_tsdr)


async def test_a_lost_publisher_makes_the_outputs_safe() -> None:
    async with bus_of(ENCODER, {**VALVE, "safe": "a0 a1 a2 a3 a4 a5"}) as bus:
        await bus.operate()
        bus.slave("encoder").outputs = b"\x11\x12\x13\x14"
        bus.slave("valve").outputs = b"\x01\x02\x03\x04\x05\x06"
        await asyncio.sleep(0.1)
        assert bus.slave("valve").inputs == b"\x01\x02\x03\x12\x13\x06"
        assert links_of(bus) == [(7, "encoder", 3, True, "valid data")]
        assert (await bus.why("valve", ask=False)).first.cause == "healthy"
        bench_of(bus).power(7, on=False)
        await asyncio.sleep(1)
        assert bus.slave("valve").inputs == b"\x01\x02\x03\x00\x00\x06"
        assert links_of(bus) == [(7, "encoder", 3, False, "no data")]
        story = await bus.why("valve", ask=False)
        assert story.first.cause == "link_without_data"
        assert "Publisher 7 (encoder) is in state offline; link: no data." in story.first.speaks_for
        assert "`dpstack why CONFIG encoder`" in story.first.next
        bench_of(bus).power(7, on=True)
        await bus.ready()
        await bus.operate()
        bus.slave("encoder").outputs = b"\x21\x22\x23\x24"
        await asyncio.sleep(0.1)
        assert bus.slave("valve").inputs == b"\x01\x02\x03\x22\x23\x06"
        assert links_of(bus) == [(7, "encoder", 3, True, "valid data")]
        stream = bus.live()
        item = await anext(item async for item in stream if item.get("snapshot", {}).get("slaves", {}).get("9"))
        assert item["snapshot"]["slaves"]["9"]["links"] == [
            {"publisher": 7, "name": "encoder", "octets": "1:3", "to": 3, "good": True, "text": "valid data"}
        ]


SECOND = VALVE | {"name": "second", "address": 10}


async def test_a_second_subscriber_joins_and_its_publisher_goes_on() -> None:
    events: list[Event] = []
    async with bus_of(ENCODER, VALVE, on_event=events.append) as bus:
        await bus.operate()
        await bus.ready()
        bus.slave("encoder").outputs = b"\x11\x12\x13\x14"
        seen = len(events)
        second = await bus.add_slave(SECOND)
        await second.ready()
        second.outputs = b"\x01\x02\x03\x04\x05\x06"
        await asyncio.sleep(0.1)
        assert second.inputs == b"\x01\x02\x03\x12\x13\x06"
        assert [one.good for one in second.links] == [True]
        assert all(one.good for one in bus.slave("valve").links)
        assert not [one for one in events[seen:] if isinstance(one, SlaveStateChanged) and one.address == 7]


async def test_the_first_subscriber_joins_and_its_publisher_is_brought_up_anew() -> None:
    events: list[Event] = []
    acted: list[bytes] = []

    def encode(outputs: bytes, _: int) -> bytes:
        acted.append(outputs)
        return outputs

    world = dpstack.World()
    encoder = DpSlave(
        SlaveDescription(ident=0x1111, configs=(b"\x13\x23",), dpv1=True, dxb=DxbSupport(publisher=True)), encode
    )
    valve = DpSlave(
        SlaveDescription(ident=0x1234, configs=(b"\x15\x21\x23",), dpv1=True, dxb=DxbSupport(links=4)),
        lambda outputs, _: outputs,
    )
    served = dpstack.slave.serve_slaves({7: encoder, 9: valve}, world=world, baud=500_000)
    async with served, bus_of(ENCODER | {"safe": "a1 a2 a3 a4"}, world=world, on_event=events.append) as bus:
        await bus.operate()
        publisher = bus.slave("encoder")
        publisher.outputs = b"\x11\x12\x13\x14"
        await asyncio.sleep(0.1)
        with pytest.raises(dpstack.ConfigError, match="subscribes to encoder \\(7\\), and Publisher_Enable is not set"):
            await bus.add_slave(VALVE)
        assert (publisher.ready_now, publisher.setup.publishes, len(bus.slaves)) == (True, False, 1)
        seen = len(acted)
        subscriber = await bus.add_slave(VALVE, restart_publishers=True)
        await bus.until(lambda: not publisher.ready_now)
        await bus.ready()
        subscriber.outputs = b"\x01\x02\x03\x04\x05\x06"
        await asyncio.sleep(0.1)
        assert subscriber.inputs == b"\x01\x02\x03\x12\x13\x06"
        assert links_of(bus) == [(7, "encoder", 3, True, "valid data")]
    safe, set_ones = b"\xa1\xa2\xa3\xa4", b"\x11\x12\x13\x14"
    course = [one for one, _ in itertools.groupby(acted[seen:]) if one != bytes(4)]
    assert course == [safe, set_ones, safe], "safe at its farewell, then as before; safe at the end of the bus"
    says = "dxb: slave 7 (encoder) is brought up anew: from now on it publishes its inputs for valve"
    (told,) = [one for one in events if isinstance(one, Notice) and one.source == "dxb"]
    assert (told.text, told.severity) == (says, Severity.WARNING)
    assert world.referee is not None
    world.referee.check()


async def test_a_subscriber_that_does_not_fit_restarts_nobody() -> None:
    async with bus_of(ENCODER, cycle_ms=4.0) as bus:
        await bus.ready()
        long = VALVE | {"config": "15 21 23 " + "FF " * 7}
        with pytest.raises(dpstack.ConfigError, match="cycle"):
            await bus.add_slave(long, restart_publishers=True)
        assert not bus.slave("encoder").setup.publishes
        for wrong, says in (
            ({"subscribes": [{"from": "encoders", "octets": "0:1", "to": 3}]}, "there is no slave 'encoders'; did you"),
            ({"subscribes": [{"from": 7, "octets": "2:5", "to": 3}]}, "octets 2:5, encoder has 4 octets of inputs"),
            ({"watchdog_ms": 0}, "watchdog_ms = 0"),
        ):
            with pytest.raises(dpstack.ConfigError, match=says):
                await bus.add_slave(VALVE | wrong, restart_publishers=True)
        assert bus.slave("encoder").ready_now


async def test_a_publisher_that_is_removed_and_comes_back() -> None:
    async with bus_of(ENCODER, VALVE) as bus:
        await bus.operate()
        await bus.remove("encoder")
        await asyncio.sleep(1)
        assert [one.good for one in bus.slave("valve").links] == [False]
        with pytest.raises(dpstack.ConfigError, match="filter for 4 octets of inputs, this one has 2: remove valve"):
            await bus.add_slave(ENCODER | {"config": "11 23"})
        encoder = await bus.add_slave(ENCODER)
        await encoder.ready()
        encoder.outputs = b"\x31\x32\x33\x34"
        await asyncio.sleep(0.1)
        assert [one.good for one in bus.slave("valve").links] == [True]
        assert bus.slave("valve").inputs[3:5] == b"\x32\x33"


async def test_reparameterise_keeps_what_the_links_need() -> None:
    async with bus_of(ENCODER, VALVE) as bus:
        await bus.operate()
        with pytest.raises((UsageError, dpstack.ConfigError), match="watchdog_ms = 0"):
            await bus.slave("valve").reparameterise(watchdog_ms=0)
        with pytest.raises((UsageError, dpstack.ConfigError), match="dpv1"):
            await bus.slave("encoder").reparameterise(dpv1=False)
        with pytest.raises(UsageError, match="subscribers have a filter for 4 octets"):
            await bus.slave("encoder").reparameterise(config="11 23")
