"""Services of DP-V1 over ptys, with the bus in this process's loop and with the bus in a process of its own: the same.
``bus.class2`` also against slaves of literal octets."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from api_kit import RIG, begun, mirror
from far_ends import until
from process_kit import ANSWER_S, DRIVERS, UNHURRIED, Driver, unhurried
from support import instance
from support_responder import Responder

import dpstack
from dpstack import AcyclicError, AlarmType, ConnectionEnded, Im0, RecordRefused, ServiceRefused, Specifier, StatusType
from dpstack.api.slave_side.slave_server import SlaveServer
from dpstack.dpv1.master.alarm_orders import AlarmRaised, ConnectionOver, StatusTold
from dpstack.drivers.segment.hub import Segment
from dpstack.slave import DpSlave, SlaveDescription

ALARMING = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, alarms=("process", "diagnostic"))


def served(slave: DpSlave) -> SlaveServer:
    """``slave`` on a pty, at address 9."""
    return dpstack.slave.serve_slave(slave, port="pty", baud=500_000, address=9)


def bus_at(server: SlaveServer, driver: Driver, description: SlaveDescription = RIG, **more: Any) -> dpstack.Bus:
    """A bus at the other end of its pty."""
    slaves = [unhurried(description.table(9))]
    return dpstack.open_bus(port=server.port_name, baud=500_000, driver=driver, slaves=slaves, **UNHURRIED, **more)


@pytest.mark.parametrize("driver", DRIVERS)
async def test_alarms_over_a_pty(driver: Driver) -> None:
    told: list[dpstack.Event] = []
    async with (
        served(mirror(ALARMING)) as server,
        bus_at(server, driver, ALARMING, on_event=told.append) as bus,
    ):
        await bus.ready(20)
        found, slave = bus.slave(9), server.slave
        await slave.alarm(AlarmType.PROCESS, 1, timeout=20)  # nobody listens
        statuses = found.status_messages()
        stream = found.alarms(acknowledge=False)
        raising = [asyncio.create_task(slave.alarm(AlarmType.PROCESS, slot, timeout=20)) for slot in (2, 3)]
        first = await anext(stream)
        assert (first.slot, raising[0].done()) == (2, False)
        await first.acknowledge()
        await raising[0]
        second = await anext(stream)
        assert second.slot == 3
        stream.close()  # nobody listens any more
        await raising[1]
        slave.status(StatusType.MESSAGE, 4, Specifier.APPEARS, b"\x55")
        assert (await anext(statuses)).data == b"\x55"
        await until(lambda: found.alarm_counts is not None and found.alarm_counts.acknowledged == 3, "the last answer")
        counts = bus.stats.slaves[9].alarms
        assert counts is not None
        assert (counts.raised, counts.statuses, counts.too_many) == (3, 1, 0)
        assert found.ready_now
    raised = [event for event in told if isinstance(event, AlarmRaised)]
    assert [(event.alarm.slot, event.held) for event in raised] == [(1, False), (2, True), (3, True)]
    assert [event.status.slot for event in told if isinstance(event, StatusTold)] == [4]


async def read(slot: int, index: int) -> bytes:
    await asyncio.sleep(0.01)
    if index > 100:
        raise RecordRefused(0xB5)
    if index == 100:
        await asyncio.sleep(60)
    return bytes((slot, index)) * 20


async def transport(slot: int, index: int, data: bytes) -> bytes:
    return data[::-1]


@pytest.mark.parametrize("driver", DRIVERS)
async def test_connections_over_a_pty(driver: Driver) -> None:
    slave = mirror(on_read=read, on_transport=transport, im=[Im0(order_id="RIG")], ms2=2)
    told: list[dpstack.Event] = []
    async with served(slave) as server:
        async with bus_at(server, driver, on_event=told.append) as bus:
            await bus.ready(20)
            async with bus.class2.connect(9, timeout=20, response_timeout=ANSWER_S) as connection:
                found = await asyncio.gather(*(connection.read(1, index, timeout=20) for index in range(5)))
                assert found == [bytes((1, index)) * 20 for index in range(5)]
                assert await connection.transport(0, 1, b"abc", timeout=20) == b"cba"
                assert instance(await connection.im(timeout=20), Im0).order_id == "RIG"
                with pytest.raises(AcyclicError, match="state conflict") as caught:
                    await connection.read(1, 101, timeout=20)
                assert (caught.value.code_1, caught.value.index) == (0xB5, 101)
                with pytest.raises(dpstack.UsageError, match="slot 255"):
                    await connection.read(255, 0)
                with pytest.raises(dpstack.UsageError, match="241 octets of data, 240"):
                    await connection.write(0, 0, bytes(241))
                other = await bus.class2.connect("rig", timeout=20, response_timeout=ANSWER_S)
                with pytest.raises(ServiceRefused, match="2 of them from here") as refused:
                    await bus.class2.connect(9, timeout=20, response_timeout=ANSWER_S)
                assert refused.value.status == "RS"
                reading = await begun(other.read(1, 100, timeout=20), 0)
                await other.close()
                with pytest.raises(ConnectionEnded, match="it was closed here") as ended:
                    await reading
                assert (ended.value.address, ended.value.abort) == (9, (0, 2, 0))
            assert bus.class2.connections == 0
            left_open = await bus.class2.connect(9, timeout=20, response_timeout=ANSWER_S)
            assert bus.slave(9).ready_now
        assert left_open.reason == "the bus was closed here"
        reasons = [event.reason for event in told if isinstance(event, ConnectionOver)]
        assert reasons == ["it was closed here", "it was closed here", "the bus was closed here"]
        assert not server.slave.connections


@pytest.mark.parametrize("driver", DRIVERS)
async def test_records_over_a_pty(driver: Driver) -> None:
    slave = mirror(on_read=read, im=[Im0(order_id="RIG")])
    async with served(slave) as server, bus_at(server, driver) as bus:
        await bus.ready(20)
        found = bus.slave(9)
        assert await asyncio.gather(*(found.read(1, index) for index in range(5))) == [
            bytes((1, index)) * 20 for index in range(5)
        ]
        assert instance(await found.im(), Im0).order_id == "RIG"
        with pytest.raises(AcyclicError, match="state conflict") as caught:
            await found.read(1, 101)
        assert (caught.value.code_1, caught.value.index) == (0xB5, 101)
        with pytest.raises(dpstack.UsageError, match="slot 255"):
            await found.read(255, 0)
        assert found.ready_now


@pytest.mark.parametrize("class2", [False, True])
@pytest.mark.parametrize("driver", DRIVERS)
async def test_a_slave_that_gets_dpv1_while_the_bus_runs(driver: Driver, class2: bool) -> None:
    """A bus process has no acyclic services before: they come with DP-V1, or with the first order of class 2."""
    async with served(mirror(on_read=read)) as server:
        slaves = [unhurried(RIG.table(9)) | {"dpv1": False}]
        async with dpstack.open_bus(
            port=server.port_name, baud=500_000, driver=driver, slaves=slaves, **UNHURRIED
        ) as bus:
            await bus.ready(20)
            found = bus.slave(9)
            counts = [found.alarm_counts]
            if class2:
                assert not (await bus.class2.diagnosis(9, timeout=20)).prm_req
            await found.reparameterise(dpv1=True, timeout=20)
            counts.append(found.alarm_counts)
            assert [one is None for one in counts] == [True, False]
            assert await found.read(1, 0) == bytes((1, 0)) * 20


async def test_reading_beside_data_exchange(tmp_path: Path) -> None:
    valves: dict[str, object] = {
        "name": "valves",
        "address": 4,
        "ident": 0x1234,
        "config": "21 11",
        "inputs": {"level": "i16@0"},
        "outputs": {"target": "i16@0"},
    }
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        with Responder(segment.paths[1], ["4:1234:2111:2:2", "7:0696:f3f1:12:12,owner=1", "126:4321:10:1:0"]):
            async with dpstack.open_bus(port=segment.paths[0], baud=1_500_000, slaves=[valves], gap=0) as bus:
                await bus.ready()
                await bus.operate()
                own = bus.slave("valves")
                own["target"] = -1234
                while own["level"] != -1234:
                    await bus.rotated(bus.stats.rotations + 1, 10)
                assert (await bus.class2.inputs(4)).values == {"level": -1234}
                assert (await bus.class2.outputs(4)).values == {"target": -1234}
                assert (await bus.class2.config(4)).octets == b"\x21\x11"
                foreign = await bus.class2.diagnosis(7)
                assert (foreign.ident, foreign.master) == (0x0696, 1)
                assert (await bus.class2.inputs(7)).octets == bytes(12)
                with pytest.raises(dpstack.SlaveFault, match="locked by master 1"):
                    await bus.class2.set_address(7, 8)
                with pytest.raises(dpstack.SlaveTimeout, match="slave 99 does not answer RD_Inp"):
                    await bus.class2.inputs(99)
                assert (await bus.class2.set_address(126, 9, ident=0x4321)).ident == 0x4321
                assert (await bus.class2.diagnosis(9)).ident == 0x4321
                assert own.ready_now
                assert own.fault is None
