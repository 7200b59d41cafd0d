"""The end of a bus, of any kind: in order, nobody waits for ever, nothing is lost."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
from api_kit import FAN, RAW, begun, bus_of, cancelled, in_operate, operating, slave_in, stack_of, virtual
from ends.telegrams import told
from foreign_master import ForeignMaster
from support import WorldFactory, present

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.machine import LineDown
from dpstack.sim.world import World
from dpstack.trace import Notice, Severity

pytestmark = pytest.mark.virtual_time

# --- every kind of end ----------------------------------------------------------------------------------------------


class BoomError(Exception):
    """Raised by the program under test."""


@pytest.mark.parametrize("how", ["exit", "exception", "cancelled", "close twice"])
async def test_the_end_is_orderly(w: World, how: str) -> None:
    outputs: list[bytes] = []

    def device(data: bytes, elapsed: int) -> bytes:
        outputs.append(data)
        return data

    _, app = slave_in(w, DpSlave(SlaveDescription(ident=0x1234, configs=(bytes.fromhex("20 10"),)), device), 9)
    bus = bus_of(RAW | {"safe": "11"}, world=w)

    async def use() -> None:
        async with in_operate(bus):
            bus.slave(9).outputs = b"\x77"
            await bus.rotated(bus.stats.rotations + 5)
            if how == "exception":
                raise BoomError
            if how == "cancelled":
                await asyncio.sleep(1000)
            if how == "close twice":
                await bus.close()

    task = asyncio.ensure_future(use())
    if how == "cancelled":
        await asyncio.sleep(0.5)
        task.cancel()
    result = (await asyncio.gather(task, return_exceptions=True))[0]
    wanted = {"exception": BoomError, "cancelled": asyncio.CancelledError}.get(how, type(None))
    assert isinstance(result, wanted)
    assert b"\x77" in outputs
    assert b"\x11" in outputs[outputs.index(b"\x77") :]  # the safe value went out
    assert app.clear  # then Clear
    assert not bus.is_open
    with pytest.raises(dpstack.UsageError, match="the bus is not open"):
        await bus.operate()
    with pytest.raises(dpstack.UsageError, match="opened before"):
        await bus.open()
    log = [entry.octets for entry in w.log]
    clears = [octets for octets in log if octets[:1] == b"\x68" and octets[7:11] == b"\x3a\x3e\x02\x00"]
    assert len(clears) >= 2


async def test_pending_orders_and_readers_end_with_the_bus() -> None:
    async with bus_of(FAN) as bus:
        await bus.operate()
        fan = bus.drive("fan")
        await fan.start()
        waiting = asyncio.ensure_future(fan.reached(tolerance=0.0))
        fan.speed = 0.3333
        reading = await begun(_count(fan), 0.01)
    with pytest.raises(dpstack.DpError):
        await waiting
    assert await reading >= 1


async def _count(drive: dpstack.Drive) -> int:
    return len([status async for status in drive.statuses()])


async def test_a_second_station_with_our_address(world: WorldFactory) -> None:
    w = world(referee=False)
    async with bus_of(RAW, world=w):
        with pytest.raises(dpstack.BusError, match="another station on the bus sends as address 2"):
            async with bus_of(RAW, world=w):
                pass


async def test_without_a_ring_there_is_a_reason(w: World) -> None:
    # master 1 does not look further than its HSA: master 50 is never asked in
    async with bus_of(address=1, world=w, hsa=10):
        bus = bus_of(address=50, world=w, join_timeout=2.0)
        with pytest.raises(dpstack.BusError, match=r"masters 1 do not let it in; their HSA must be 50 or more"):
            await bus.open()


class Tokenless(ForeignMaster):
    """A master that passes no token, as pyprofibus: a request to slave 8 every 200 bits, and never a pause."""

    def sent(self, at: int) -> int:
        self.plan = [(at + self.bits(200), bytes.fromhex("68 04 04 68 08 02 7D 55 DC 16"))]
        return self.wake_at()


async def test_a_master_without_a_token_is_named_as_the_reason(world: WorldFactory) -> None:
    w = world(referee=False)
    master = Tokenless(2, 2)
    master.sent(w.now)
    w.add(master)
    bus = bus_of(address=1, world=w, join_timeout=1.0)
    with pytest.raises(
        dpstack.BusError,
        match=r"\d+ telegrams of other stations are heard, and no token: master 2 that passes none",
    ):
        await bus.open()


async def test_a_master_without_a_token_that_pauses_is_named_when_the_station_joins(world: WorldFactory) -> None:
    """Its requests stop for longer than T_TO: the station claims the token, and says whom it has heard."""

    class Pausing(Tokenless):
        left = 5

        def sent(self, at: int) -> int:
            self.left -= 1
            return super().sent(at) if self.left >= 0 else self.wake_at()

    w = world(referee=False)
    master = Pausing(2, 2, ready=False)
    master.sent(w.now)
    w.add(master)
    seen: list[dpstack.Event] = []
    async with bus_of(address=1, world=w, on_event=seen.append) as bus:
        await bus.until(lambda: bus.snapshot.in_ring, 1)
    heard = [e for e in seen if isinstance(e, Notice) and "listened first" in e.text]
    assert len(heard) == 1
    assert "nobody has address 1; master 2 sends requests and passes no token" in heard[0].text
    assert "stop one of them" in heard[0].text
    assert heard[0].severity is Severity.WARNING


def test_misuse_says_what_to_do() -> None:
    with pytest.raises(dpstack.ConfigError, match="open_bus: no baud"):
        dpstack.open_bus(port="virtual")
    with pytest.raises(dpstack.ConfigError, match="open_bus: no port"):
        dpstack.open_bus(baud=500_000)
    with pytest.raises(dpstack.ConfigError, match="open_bus: unknown argument 'gapp'; did you mean 'gap'"):
        dpstack.open_bus(port="virtual", baud=500_000, gapp=1)
    bus = bus_of(RAW)
    with pytest.raises(dpstack.UsageError, match="the bus is not open: use it inside"):
        core_of(bus).command(object())


def test_missing_port_raises_on_entering() -> None:
    async def program() -> None:
        async with dpstack.open_bus(port="/dev/nosuch-port", baud=500_000, slaves=[RAW]):
            pass

    with pytest.raises(dpstack.PortError, match="/dev/nosuch-port: no such port"):
        asyncio.run(program())


async def test_plan_notes_are_told_at_the_start() -> None:
    seen: list[dpstack.Event] = []
    async with bus_of(RAW | {"watchdog_ms": 0}, on_event=seen.append):
        pass
    assert any(isinstance(e, Notice) and "its watchdog is off" in e.text for e in seen)


# --- what must not be lost, and who must not wait for ever ----------------------------------------------------------


def test_a_handler_that_raises_loses_no_event_and_does_not_hold_up_the_end() -> None:
    seen: list[str] = []
    told: list[str] = []

    def on_event(event: dpstack.Event) -> None:
        seen.append(event.text)
        raise ZeroDivisionError(event.text)

    async def program() -> int:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: told.append(context["message"]))
        async with operating(RAW, on_event=on_event) as bus:
            end = asyncio.get_running_loop().time()
        assert asyncio.get_running_loop().time() - end < 0.2
        assert [event.text async for event in bus.events()] == seen
        return len(seen)

    assert virtual(program()) == len(told) > 8
    assert told[0].startswith("on_event raised at '")
    assert seen[-1] == "station 2 left the token ring: ordered"


async def test_a_waiting_caller_is_told_of_the_end() -> None:
    async with bus_of(RAW) as bus:
        waiting = [
            asyncio.ensure_future(bus.slave("raw").wait_state(dpstack.SlaveState.FAULT)),
            asyncio.ensure_future(bus.rotated(None)),
        ]
        await bus.ready()
    for each in waiting:
        with pytest.raises(dpstack.UsageError, match="the bus is closed"):
            await each
    with pytest.raises(dpstack.UsageError, match="the bus is not open any more"):
        await bus.slave("raw").wait_state(dpstack.SlaveState.FAULT)


async def test_statuses_asked_for_after_the_end_end() -> None:
    async with bus_of(FAN) as bus:
        await bus.ready()
    assert len([status async for status in bus.drive("fan").statuses()]) == 1


async def test_a_defect_ends_streams_and_statuses(monkeypatch: pytest.MonkeyPatch) -> None:
    async with bus_of(FAN) as bus:
        await bus.ready()
        events, statuses = bus.events(), bus.drive("fan").statuses()

        async def texts() -> str:
            return [event.text async for event in events][-1]

        async def count() -> int:
            return len([status async for status in statuses])

        readers = asyncio.gather(texts(), count())
        await asyncio.sleep(0)

        def broken(now: int) -> None:
            raise ZeroDivisionError("a defect")

        monkeypatch.setattr(stack_of(bus).master, "on_round", broken)
        text, number = await readers
        assert "stopped by a defect in dpstack (ZeroDivisionError: a defect)" in text
        assert number >= 1
        with pytest.raises(dpstack.BusError, match="stopped by a defect"):
            await bus.until(lambda: False)


async def test_an_event_stream_may_be_closed_twice() -> None:
    async with bus_of(RAW) as bus:
        stream = bus.events()
        stream.close()
        stream.close()


async def test_the_port_is_released_when_the_end_is_cut_short(monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[bool] = []
    bus = bus_of(RAW)
    await bus.open()
    close = core_of(bus).runtime.close

    async def watched() -> None:
        await close()
        closed.append(True)

    monkeypatch.setattr(core_of(bus).runtime, "close", watched)
    ending = await begun(bus.close(), 0.0001)
    for task in asyncio.all_tasks() - {asyncio.current_task()}:
        task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await ending
    await asyncio.sleep(0)
    assert closed == [True]


async def test_a_slave_that_was_removed_may_come_again() -> None:
    """With port "virtual" there is one simulated slave at the address, not two."""
    async with bus_of(RAW) as bus:
        await bus.ready()
        await bus.remove("raw")
        await asyncio.sleep(0.1)
        again = await bus.add_slave(RAW | {"name": "again", "config": "21 11"})
        await again.ready()
        assert len(again.inputs) == 2
        assert bus.stats.bad == {}


# --- Cancellations on the way out, in virtual time: whatever cancels, and however often, the end goes through -------


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
