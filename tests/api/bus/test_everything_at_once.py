"""Both ends in virtual time, all at once: MS1, MS2 from two stations, alarms, other parameters, restarts, loss, noise.

Every call comes to one end, what was read is right, and in the end nothing is left.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
from collections.abc import Awaitable

from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

import dpstack
from dpstack import AlarmType, DpError, Im0
from dpstack.slave import DpSlave, SlaveDescription

KINDS = ("pull_plug", "process", "diagnostic", "status")
VALVES = SlaveDescription(
    ident=0x4711, configs=(b"\x11\x20",), name="valves", dpv1=True, alarms=KINDS, alarm_sequence=8, ms2=3
)


class Plant:
    """Slave 9, its master, and a station of class 2."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.world = dpstack.World(seed=seed)
        self.slave = DpSlave(
            VALVES,
            lambda outputs, elapsed: bytes(2),
            on_read=self.read,
            on_write=self.write,
            on_transport=self.transport,
            im=[Im0(order_id="V-8")],
        )
        self.tasks: list[asyncio.Task[None]] = []
        self.alarms: list[bytes] = []

    async def read(self, slot: int, index: int) -> bytes:
        await asyncio.sleep(self.random.choice((0, 0, 0.002, 0.02)))
        return bytes((slot, index))

    async def write(self, slot: int, index: int, data: bytes) -> None:
        await asyncio.sleep(self.random.choice((0, 0.01)))

    async def transport(self, slot: int, index: int, data: bytes) -> bytes:
        return data[::-1]

    # --- what is done -----------------------------------------------------------------------------------------------

    def start(self, call: Awaitable[None]) -> None:
        async def one() -> None:
            with contextlib.suppress(DpError):
                await call

        self.tasks.append(asyncio.create_task(one()))

    async def record(self, slave: dpstack.Slave, index: int) -> None:
        assert await slave.read(1, index) == bytes((1, index))

    async def connection(self, bus: dpstack.Bus, index: int) -> None:
        async with bus.class2.connect(9) as connection:
            for at in range(index, index + 3):
                assert await connection.read(2, at) == bytes((2, at))
            assert await connection.transport(1, 1, b"abc") == b"cba"
            assert isinstance(await connection.im(), Im0)

    async def away(self, slave: dpstack.Slave) -> None:
        await slave.deactivate()
        try:
            await asyncio.sleep(0.05)
        finally:
            await slave.activate()

    async def listen(self, slave: dpstack.Slave) -> None:
        async for alarm in slave.alarms():
            self.alarms.append(alarm.data)

    def step(self, number: int, server: dpstack.slave.SlaveServer, bus: dpstack.Bus, other: dpstack.Bus) -> None:
        rnd, slave, index = self.random, bus.slave(9), number % 250
        match rnd.randrange(16):
            case 0 | 1 | 2:
                self.start(self.record(slave, index))
            case 3:
                self.start(slave.write(1, index, b"\1\2"))
            case 4 | 5:
                self.start(self.connection(rnd.choice((bus, other)), index))
            case 6 | 7:
                kind = rnd.choice((AlarmType.DIAGNOSIS, AlarmType.PROCESS, AlarmType.PULL))
                self.start(server.slave.alarm(kind, 1, data=number.to_bytes(2, "big"), timeout=3))
            case 8 if rnd.random() < 0.3:
                self.start(slave.reparameterise(dpv1={"alarm_mode": rnd.choice((0, 2))}))
            case 9 if rnd.random() < 0.2:
                self.start(self.away(slave))
            case 10:
                self.world.faults.drop(lambda sent: sent.octets[0] == 0x68, times=rnd.randrange(1, 3))
            case 11 if self.tasks:
                rnd.choice(self.tasks).cancel()
            case 12:
                self.world.faults.noise(rnd.choice((0, 0, 1e-4, 3e-4)))
            case 13 if rnd.random() < 0.1:
                server.slave.restart()
            case 14 if server.slave.connections:
                server.slave.abort_connection(rnd.choice(server.slave.connections).sap, 1)

    async def run(self, steps: int) -> None:
        world = self.world
        async with (
            dpstack.slave.serve_slave(self.slave, world=world, address=9) as server,
            dpstack.open_bus(world=world, baud=500_000, gap=1, slaves=[VALVES.table(9)]) as bus,
            dpstack.open_bus(world=world, baud=500_000, gap=1, address=5) as other,
        ):
            await bus.operate()
            await bus.ready()
            listening = asyncio.create_task(self.listen(bus.slave(9)))
            for number in range(steps):
                self.step(number, server, bus, other)
                await asyncio.sleep(self.random.choice((0, 0.001, 0.005, 0.02)))
            world.faults.noise(0)
            async with asyncio.timeout(60):
                results = await asyncio.gather(*self.tasks, return_exceptions=True)
            for result in results:
                assert result is None or isinstance(result, asyncio.CancelledError), repr(result)
            await asyncio.sleep(6)
            assert server.slave.connections == ()
            assert bus.class2.connections == other.class2.connections == 0
            assert len(self.alarms) == len(set(self.alarms))
            await bus.ready(30)
            await self.record(bus.slave(9), 1)
            await self.connection(other, 1)
            listening.cancel()
        names = {task.get_name() for task in asyncio.all_tasks() if task is not asyncio.current_task()}
        assert not names, names


@examples(1, soak=100)
@given(st.integers(0, 1 << 32))
def test_everything_at_once(seed: int) -> None:
    dpstack.run_virtual(Plant(seed).run(80))
