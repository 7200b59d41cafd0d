"""SIGKILL among DP-V1 services over a pty: of the bus process, or of the process with the slaves.

Every pending service ends with an error, and the slave gets its connections back.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Awaitable
from pathlib import Path

import pytest
from far_ends import until
from process_kit import ANSWER_S, DRIVERS, UNHURRIED, Driver, process_of, unhurried

import dpstack
from dpstack import BusError, DpError
from dpstack.api.slave_side.simulation import Segment
from dpstack.slave import DpSlave, SlaveAppState, SlaveDescription

RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, ms2=2, alarms=("process",))


class Rig:
    """A slave whose records of slot 1 answer at once, those of slot 2 never."""

    def __init__(self) -> None:
        self.at_work = 0
        self.slave = DpSlave(RIG, lambda outputs, elapsed: outputs, on_read=self.read)

    async def read(self, slot: int, index: int) -> bytes:
        if slot == 2:
            self.at_work += 1
            try:
                await asyncio.Event().wait()
            finally:
                self.at_work -= 1
        return bytes((slot, index))


async def listen(bus: dpstack.Bus) -> None:
    async for _alarm in bus.slave(9).alarms(acknowledge=False):
        pass


async def ends(*services: Awaitable[object]) -> list[object]:
    """The results or errors of all ``services``."""
    async with asyncio.timeout(30):
        return await asyncio.gather(*services, return_exceptions=True)


async def test_the_bus_process_is_killed() -> None:
    rig = Rig()
    async with dpstack.slave.serve_slave(rig.slave, port="pty", baud=1_500_000, address=9) as server:
        bus = dpstack.open_bus(
            port=server.port_name, baud=1_500_000, driver="process", slaves=[unhurried(RIG.table(9))], **UNHURRIED
        )
        async with bus:
            await bus.ready(20)
            found = bus.slave(9)
            listening = asyncio.create_task(listen(bus))
            connection = await bus.class2.connect(9, timeout=20, response_timeout=ANSWER_S)
            assert await connection.read(1, 2, timeout=20) == b"\1\2"
            alarm = asyncio.create_task(server.slave.alarm(2, 1, timeout=30))
            services = asyncio.create_task(
                ends(*(found.read(2, index) for index in range(20)), connection.read(2, 0), bus.class2.connect(9))
            )
            await until(lambda: rig.at_work == 2, "one service of each class at work")
            os.kill(process_of(bus), signal.SIGKILL)
            for error in await services:
                assert isinstance(error, (BusError, dpstack.Connection)), repr(error)
            assert not connection.is_open
            await ends(listening)
            with pytest.raises(dpstack.AlarmError):  # its master is gone, data exchange with it
                await asyncio.wait_for(alarm, 20)
        await until(lambda: not server.slave.connections, "its connections given back")
        await server.slave.reached(SlaveAppState.WAIT_PRM, 20)
        assert rig.at_work == 0
        async with dpstack.open_bus(
            port=server.port_name, baud=1_500_000, slaves=[unhurried(RIG.table(9))], **UNHURRIED
        ) as again:
            await again.ready(20)
            assert await again.slave(9).read(1, 3, timeout=20) == b"\1\3"
            async with again.class2.connect(9, timeout=20, response_timeout=ANSWER_S) as connection:
                assert await connection.read(1, 4, timeout=20) == b"\1\4"


SLAVES = """
import asyncio, dpstack
from dpstack.slave import DpSlave, SlaveDescription
RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, ms2=2, alarms=("process",))
async def read(slot, index):
    if slot == 2:
        await asyncio.Event().wait()
    return bytes((slot, index))
async def main():
    slave = DpSlave(RIG, lambda outputs, elapsed: outputs, on_read=read)
    async with dpstack.slave.serve_slave(slave, port="{path}", baud=1_500_000, address=9) as server:
        print("served", flush=True)
        await server.serve_forever()
asyncio.run(main())
"""


@pytest.mark.parametrize("driver", DRIVERS)
async def test_the_slaves_are_killed(driver: Driver, tmp_path: Path) -> None:
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        one, two = segment.paths
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-c", SLAVES.format(path=one), stdout=asyncio.subprocess.PIPE
        )
        try:
            assert process.stdout is not None
            assert await process.stdout.readline() == b"served\n"
            async with dpstack.open_bus(
                port=two, baud=1_500_000, driver=driver, slaves=[unhurried(RIG.table(9))], **UNHURRIED
            ) as bus:
                await bus.ready(20)
                found = bus.slave(9)
                connection = await bus.class2.connect(9, timeout=20, response_timeout=ANSWER_S)
                assert await connection.read(1, 2, timeout=20) == b"\1\2"
                services = asyncio.create_task(
                    ends(*(found.read(2, n, timeout=20) for n in range(9)), connection.read(2, 0, timeout=20))
                )
                await asyncio.sleep(0.1)
                process.kill()
                for error in await services:
                    assert isinstance(error, DpError), repr(error)
                    assert "slave 9" in str(error)
                assert not found.ready_now
                async with asyncio.timeout(20):
                    await connection.ended()
        finally:
            if process.returncode is None:
                process.kill()
            await process.wait()
