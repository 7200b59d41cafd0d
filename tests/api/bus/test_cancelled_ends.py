"""Cancellations on the way out, in virtual time: whatever cancels, and however often, the end goes through."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
from api_kit import RAW, begun, bus_of, cancelled, slave_in, virtual
from ends.telegrams import told
from support import WorldFactory, present

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.machine import LineDown
from dpstack.sim.world import World

pytestmark = pytest.mark.virtual_time

PLANT = RAW | {"safe": "11"}
LIVE, SAFE = "77", "11"


class Plant:
    """A bus with one slave at address 9 in ``world``; its safe value is 11 hex."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.events: list[str] = []
        slave_in(
            world, DpSlave(SlaveDescription(ident=0x1234, configs=(bytes.fromhex("20 10"),)), lambda data, _: data), 9
        )
        self.bus = bus_of(PLANT, world=world, on_event=lambda event: self.events.append(event.text))

    async def live(self) -> None:
        await self.bus.operate()
        await self.bus.ready()
        self.bus.slave(9).outputs = b"\x77"
        await self.bus.rotated(self.bus.stats.rotations + 5)

    async def run(self) -> None:
        async with self.bus:
            await self.live()
            await asyncio.sleep(1000)

    @property
    def words(self) -> list[str]:
        return told([entry.octets for entry in self.world.log], 9)

    def ended_in_order(self) -> None:
        words = self.words
        assert LIVE in words
        after = words[words.index(LIVE) + 1 :]
        assert after[0] == SAFE
        assert "clear" in after
        assert LIVE not in after
        assert not self.bus.is_open


@pytest.fixture
def plant(world: WorldFactory) -> Plant:
    return Plant(world())


@pytest.mark.parametrize("times", [1, 2, 50])
async def test_any_number_of_cancellations(plant: Plant, times: int) -> None:
    task = await begun(plant.run(), 0.5)
    for _ in range(times):
        task.cancel()
        await asyncio.sleep(0.001)
    assert not task.done()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert task.cancelling() == times
    plant.ended_in_order()


async def test_a_timeout_around_the_bus_is_a_timeout(plant: Plant) -> None:
    task = present(asyncio.current_task())
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.5):
            await plant.run()
    assert task.cancelling() == 0
    plant.ended_in_order()


async def test_a_timeout_that_runs_out_during_the_end(plant: Plant) -> None:
    async with plant.bus:
        await plant.live()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.0001):
                await plant.bus.close()
    plant.ended_in_order()


async def test_a_timeout_and_a_cancellation_is_a_cancellation(plant: Plant) -> None:
    async def limited() -> None:
        async with asyncio.timeout(0.5):
            await plant.run()

    task = await begun(limited(), 0.51)
    await cancelled(task)
    plant.ended_in_order()


async def test_a_task_group_that_fails_twice(plant: Plant) -> None:
    async def fails() -> None:
        await asyncio.sleep(0.5)
        raise ZeroDivisionError

    async def cancels(task: asyncio.Task[None]) -> None:
        await asyncio.sleep(0.51)
        task.cancel()

    async def grouped() -> None:
        async with asyncio.TaskGroup() as group:
            running = group.create_task(plant.run())
            asyncio.ensure_future(cancels(running)).add_done_callback(lambda done: done.result())
            group.create_task(fails())

    with pytest.raises(ExceptionGroup):
        await grouped()
    plant.ended_in_order()


async def test_cancelled_while_it_opens(plant: Plant) -> None:
    """In Listen_Token, in the ring, and in the end that follows: nobody is left in the ring."""
    for after in (0.0, 0.0005, 0.002, 0.004):
        bus = bus_of(PLANT, world=plant.world)
        task = await begun(bus.open(), after)
        task.cancel()
        await asyncio.sleep(0)
        await cancelled(task)
        assert not bus.is_open
        count = len(plant.world.log)
        await asyncio.sleep(0.1)
        assert len(plant.world.log) == count


async def test_all_tasks_are_cancelled_as_by_asyncio_run(plant: Plant) -> None:
    """The task that carries the end out is one of them."""
    task = await begun(plant.run(), 0.5)
    for _ in range(3):
        for each in asyncio.all_tasks() - {asyncio.current_task()}:
            each.cancel()
        await asyncio.sleep(0.0005)
    with pytest.raises(asyncio.CancelledError):
        await task
    plant.ended_in_order()


async def test_a_generator_that_is_abandoned(plant: Plant) -> None:
    async def values() -> AsyncIterator[bytes]:
        async with plant.bus:
            await plant.live()
            while True:
                yield plant.bus.slave(9).inputs

    async for value in values():
        assert value == b"\x77"
        break
    with pytest.raises(dpstack.UsageError, match="the bus is closed"):
        await plant.bus.until(lambda: False)
    plant.ended_in_order()


def test_a_bus_that_nobody_closes(world: WorldFactory) -> None:
    """run_virtual() closes the asynchronous generators of its loop, as asyncio.run() does."""
    made: list[Plant] = []

    async def program() -> None:
        made.append(Plant(world()))
        await made[0].bus.open()
        await made[0].live()

    virtual(program())
    made[0].ended_in_order()


async def test_the_bound_holds_where_nobody_answers(world: WorldFactory) -> None:
    """All telegrams are lost from the beginning of the end on, and it is cancelled again and again."""
    plant = Plant(world(referee=False))
    async with plant.bus:
        await plant.live()
        loop = asyncio.get_running_loop()
        plant.world.faults.drop(lambda _: True, times=1_000_000)
        begun = loop.time()
        ending = asyncio.ensure_future(plant.bus.close())
        while not ending.done():
            ending.cancel()
            await asyncio.sleep(0.001)
        assert ending.cancelled()
        assert loop.time() - begun <= plant.bus.end_limit_s
    assert plant.words[-1] == "clear"  # nobody has heard it: a slave that is lost is sent nothing more
    assert not plant.bus.is_open


async def test_an_end_that_cannot_be_sent_is_told_once(world: WorldFactory) -> None:
    """Without its port the master has no token."""
    plant = Plant(world(referee=False))
    loop = asyncio.get_running_loop()
    async with plant.bus:
        await plant.live()
        core_of(plant.bus).command(LineDown("unplugged"))
        begun = loop.time()
    assert loop.time() - begun <= plant.bus.end_limit_s
    assert plant.bus.end_failed
    assert [text for text in plant.events if "could not be sent" in text] == [
        "bus: the end could not be sent: the slaves got neither safe values nor Clear. "
        "The slaves' watchdogs make their outputs safe within 200 ms"
    ]


async def test_a_hurried_end_is_over_within_a_second(plant: Plant) -> None:
    async with plant.bus:
        await plant.live()
        loop = asyncio.get_running_loop()
        begun = loop.time()
        plant.bus.hurry()
        plant.bus.hurry()
        await plant.bus.close()
        assert loop.time() - begun < 1
    plant.ended_in_order()
    assert not plant.bus.end_failed
    with pytest.raises(dpstack.UsageError, match="the bus is not open"):
        await plant.bus.operate()
