"""Class 2 connections over a pty, with the bus in this loop and with the bus in a process of its own: the same."""

from __future__ import annotations

import asyncio

import pytest
from api_kit import RIG
from process_kit import ANSWER_S, DRIVERS, UNHURRIED, Driver, unhurried

import dpstack
from dpstack import AcyclicError, ConnectionEnded, Im0, RecordRefused, ServiceRefused
from dpstack.dpv1.master.orders import ConnectionOver
from dpstack.slave import DpSlave


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
    slave = DpSlave(
        RIG, lambda outputs, elapsed: outputs, on_read=read, on_transport=transport, im=[Im0(order_id="RIG")], ms2=2
    )
    told: list[dpstack.Event] = []
    async with dpstack.slave.serve_slave(slave, port="pty", baud=500_000, address=9) as server:
        async with dpstack.open_bus(
            port=server.port_name,
            baud=500_000,
            driver=driver,
            slaves=[unhurried(RIG.table(9))],
            on_event=told.append,
            **UNHURRIED,
        ) as bus:
            await bus.ready(20)
            async with bus.class2.connect(9, timeout=20, response_timeout=ANSWER_S) as connection:
                found = await asyncio.gather(*(connection.read(1, index, timeout=20) for index in range(5)))
                assert found == [bytes((1, index)) * 20 for index in range(5)]
                assert await connection.transport(0, 1, b"abc", timeout=20) == b"cba"
                im0 = await connection.im(timeout=20)
                assert isinstance(im0, Im0)
                assert im0.order_id == "RIG"
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
                reading = asyncio.create_task(other.read(1, 100, timeout=20))
                await asyncio.sleep(0)
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
