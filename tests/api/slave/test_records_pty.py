"""Records over a pty, with the bus in this process's loop and with the bus in a process of its own: the same."""

from __future__ import annotations

import asyncio

import pytest
from api_kit import RIG
from process_kit import DRIVERS, UNHURRIED, Driver, unhurried

import dpstack
from dpstack import AcyclicError, Im0, RecordRefused
from dpstack.slave import DpSlave


async def read(slot: int, index: int) -> bytes:
    await asyncio.sleep(0.01)
    if index > 100:
        raise RecordRefused(0xB5)
    return bytes((slot, index)) * 20


@pytest.mark.parametrize("driver", DRIVERS)
async def test_records_over_a_pty(driver: Driver) -> None:
    slave = DpSlave(RIG, lambda outputs, elapsed: outputs, on_read=read, im=[Im0(order_id="RIG")])
    async with (
        dpstack.slave.serve_slave(slave, port="pty", baud=500_000, address=9) as server,
        dpstack.open_bus(
            port=server.port_name, baud=500_000, driver=driver, slaves=[unhurried(RIG.table(9))], **UNHURRIED
        ) as bus,
    ):
        await bus.ready(20)
        found = bus.slave(9)
        assert await asyncio.gather(*(found.read(1, index) for index in range(5))) == [
            bytes((1, index)) * 20 for index in range(5)
        ]
        im0 = await found.im()
        assert isinstance(im0, Im0)
        assert im0.order_id == "RIG"
        with pytest.raises(AcyclicError, match="state conflict") as caught:
            await found.read(1, 101)
        assert (caught.value.code_1, caught.value.index) == (0xB5, 101)
        with pytest.raises(dpstack.UsageError, match="slot 255"):
            await found.read(255, 0)
        assert found.ready_now
