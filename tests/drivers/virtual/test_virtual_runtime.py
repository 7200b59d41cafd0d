"""The virtual driver: exact in a VirtualLoop, held back to real time in an ordinary loop; one that cannot keep up says
so."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from api_kit import RAW, bus_of, virtual
from bus_kit import mirror, setup
from far_ends import until
from support import MS, Dummy

import dpstack
from dpstack.api.bus.events_json import event_json
from dpstack.cli.terminal.report import Reporter
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState, SlaveStateChanged
from dpstack.dp.master.master import Master
from dpstack.drivers.runtime import BehindRealTime, Runtime
from dpstack.drivers.virtual import runtime as driver
from dpstack.drivers.virtual.loop import run
from dpstack.drivers.virtual.runtime import Pace, VirtualRuntime
from dpstack.errors import UsageError
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event, Notice, Severity
from dpstack.units import NS_PER_S

PARAMS = BusParams.preset(500_000, address=2, hsa=10)
ASK = bytes.fromhex("10 05 02 49 50 16")


class Breaks(Dummy):
    """Its machine raises when it has something to send."""

    def take_tx(self, now: int) -> bytes | None:
        if now >= self.wake_at():
            raise ZeroDivisionError("a defect")
        return None


class Plant:
    """A master on a runtime, slaves in the world."""

    def __init__(self) -> None:
        self.world = World()
        for address in (5, 6):
            self.world.add(mirror(address, PARAMS))
        self.master = Master(PARAMS, [setup(5), setup(6)])
        self.station = ActiveStation(PARAMS, [self.master])
        self.events: list[Event] = []
        self.up = asyncio.Event()
        self.runtime = VirtualRuntime(self.world, self.station, self.take)

    def take(self, events: list[Event]) -> None:
        self.events += events
        states = [event.state for event in self.events if isinstance(event, SlaveStateChanged)]
        if states.count(SlaveState.DATA_EXCHANGE) == 2:
            self.up.set()

    async def bring_up(self) -> None:
        await self.runtime.open()
        self.runtime.command(GoOnline())
        self.runtime.command(SetMode(Mode.OPERATE))
        async with asyncio.timeout(20):
            await self.up.wait()

    def check(self) -> None:
        assert self.world.referee is not None
        self.world.referee.check()


async def story() -> tuple[list[bytes], int]:
    """A program: bring two slaves up, talk to them, go."""
    plant = Plant()
    await plant.bring_up()
    seen = []
    for number in range(3):
        plant.master.images[5].outputs = bytes([number] * 12)
        await asyncio.sleep(0.01)
        seen.append(plant.master.images[5].inputs)
    await plant.runtime.close()
    plant.check()
    return seen, plant.runtime.now()


def test_it_is_a_runtime() -> None:
    runtime: Runtime = VirtualRuntime(World(), Dummy(), list.clear)
    assert runtime.paced
    assert runtime.port_name == "virtual"


def test_in_a_virtual_loop_the_course_is_always_the_same() -> None:
    seen, end = run(story())
    assert seen == [bytes([number] * 12) for number in range(3)]
    assert run(story()) == (seen, end)
    assert run(story(), paced=True) == (seen, end)


async def test_in_an_ordinary_loop_the_world_goes_at_real_time() -> None:
    began = time.monotonic_ns()
    plant = Plant()
    await plant.bring_up()
    await asyncio.sleep(0.1)
    real = time.monotonic_ns() - began
    assert plant.runtime.now() <= real
    assert plant.master.images[5].valid
    await plant.runtime.close()
    stopped = plant.runtime.now()
    await asyncio.sleep(0.02)
    assert plant.runtime.now() == stopped
    plant.check()


async def test_in_an_ordinary_loop_missed_bus_time_is_not_skipped() -> None:
    plant = Plant()
    await plant.bring_up()
    before = plant.runtime.now()
    compute(0.25)  # the application blocks the loop
    await asyncio.sleep(0.05)
    # 200 ms of the 250 were forgotten: virtual time fell behind, and no slave was lost
    assert plant.runtime.now() - before < 200 * MS
    assert not [
        event for event in plant.events if isinstance(event, SlaveStateChanged) and event.state is SlaveState.FAULT
    ]
    await plant.runtime.close()
    plant.check()


def compute(seconds: float) -> None:
    time.sleep(seconds)


async def test_a_world_too_big_for_the_machine_leaves_the_loop_alive() -> None:
    world = World()
    beats = 0

    def beat() -> None:
        nonlocal beats
        beats += 1
        world.call_at(world.now + 1, beat)  # a thousand million a second

    world.call_at(0, beat)
    runtime = VirtualRuntime(world, Dummy(), list.clear)
    await runtime.open()
    turns = 0
    began = time.monotonic()
    while time.monotonic() - began < 0.1:
        await asyncio.sleep(0)
        turns += 1
    await runtime.close()
    assert turns > 10
    assert beats > 1_000
    assert runtime.now() < 50 * MS


async def test_a_command_wakes_a_resting_world() -> None:
    class Obeys(Dummy):
        def command(self, command: object, now: int) -> None:
            assert isinstance(command, bytes)
            self.plan.append((now, command))

    world = World()
    assert world.referee is not None
    world.referee.token_rules = False
    heard = Dummy(5)
    world.add(heard)
    runtime = VirtualRuntime(world, Obeys(2), list.clear)
    await runtime.open()
    await asyncio.sleep(0.03)
    runtime.command(ASK)
    await until(lambda: bool(heard.heard))
    await runtime.close()


@pytest.mark.parametrize("run_in_loop", [run, asyncio.run], ids=["virtual loop", "ordinary loop"])
def test_two_runtimes_share_one_world(run_in_loop: Callable[[Coroutine[Any, Any, None]], None]) -> None:
    async def main() -> None:
        world = World()
        stations = [ActiveStation(PARAMS.replace(address=address), []) for address in (2, 3)]
        runtimes = [VirtualRuntime(world, station, list.clear) for station in stations]
        for runtime in runtimes:
            await runtime.open()
            runtime.command(GoOnline())
        await until(lambda: all(station.las == {2, 3} for station in stations))
        await runtimes[0].close()
        await until(lambda: stations[1].las == {3})
        await runtimes[1].close()

    run_in_loop(main())


@pytest.mark.parametrize("run_in_loop", [run, asyncio.run], ids=["virtual loop", "ordinary loop"])
def test_a_defect_stops_the_world_and_is_reported(run_in_loop: Callable[[Coroutine[Any, Any, None]], None]) -> None:
    async def main() -> None:
        failures: list[Exception] = []
        told = asyncio.Event()

        def failed(exc: Exception) -> None:
            failures.append(exc)
            told.set()

        world = World()
        runtime = VirtualRuntime(world, Breaks(plan=[(5 * MS, b"")]), list.clear, on_failure=failed)
        await runtime.open()
        async with asyncio.timeout(10):
            await told.wait()
        await asyncio.sleep(0.05)
        assert [type(failure) for failure in failures] == [ZeroDivisionError]
        assert world.now == 5 * MS
        await runtime.close()

    run_in_loop(main())


def test_without_on_failure_a_virtual_loop_raises_it() -> None:
    async def main() -> None:
        runtime = VirtualRuntime(World(), Breaks(plan=[(5 * MS, b"")]), list.clear)
        await runtime.open()
        await asyncio.sleep(1)

    with pytest.raises(ZeroDivisionError):
        run(main())


async def test_without_on_failure_the_handler_of_an_ordinary_loop_is_called() -> None:
    contexts: list[dict[str, object]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: contexts.append(context))
    runtime = VirtualRuntime(World(), Breaks(plan=[(1, b"")]), list.clear)
    await runtime.open()
    await asyncio.sleep(0.05)
    await runtime.close()
    assert [context["message"] for context in contexts] == ["the simulated bus stands still"]


def test_an_event_handler_that_raises_does_not_stop_the_bus() -> None:
    contexts: list[dict[str, object]] = []

    async def main() -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, context: contexts.append(context))
        world = World()
        station = Dummy(events=[Notice(t_ns=0, source="x", message="y")])

        def handler(events: list[Event]) -> None:
            raise KeyError("application")

        runtime = VirtualRuntime(world, station, handler)
        await runtime.open()
        await asyncio.sleep(1)
        assert world.now == 1_000 * MS
        await runtime.close()

    run(main())
    assert [context["message"] for context in contexts] == ["virtual: the application's event handler raised"]


async def test_misuse_raises() -> None:
    runtime = VirtualRuntime(World(), Dummy(), list.clear)
    with pytest.raises(UsageError, match="virtual is not open"):
        runtime.command(GoOnline())
    await runtime.close()
    await runtime.open()
    with pytest.raises(UsageError, match="open already"):
        await runtime.open()
    await runtime.close()


def test_a_world_belongs_to_one_loop_at_a_time() -> None:
    world = World()
    first = VirtualRuntime(world, Dummy(5), list.clear)
    second = VirtualRuntime(world, Dummy(6), list.clear)
    loop = asyncio.new_event_loop()
    loop.run_until_complete(first.open())
    with pytest.raises(UsageError, match="driven by another event loop"):
        run(second.open())
    loop.run_until_complete(first.close())
    loop.close()
    run(second.open())  # and never closed: the loop is gone, the world may be taken over
    third = VirtualRuntime(world, Dummy(7), list.clear)
    run(third.open())


Out = pytest.CaptureFixture[str]


def paced(speeds: list[float]) -> list[BehindRealTime]:
    """Events of a bus whose time goes at each of these speeds for one second."""
    pace, real, bus = Pace(7 * NS_PER_S, 0), 7 * NS_PER_S, 0
    told = []
    for speed in speeds:
        for _ in range(10):
            real += NS_PER_S // 10
            bus += round(speed * NS_PER_S / 10)
            event = pace.event_at(real, bus)
            if event is not None:
                told.append(event)
    return told


def test_falling_behind_is_reported_once_and_again_when_the_speed_changes_much() -> None:
    told = paced([1.0, 0.95, 0.4, 0.42, 0.25, 0.15, 0.21, 0.5, 0.92, 1.0, 1.0, 0.5])
    speeds = [(round(one.bus_ns / one.real_ns, 2), one.keeps_up) for one in told]
    assert speeds == [(0.4, False), (0.15, False), (0.5, False), (1.0, True), (0.5, False)]
    first = told[0]
    assert first.behind_ns == round(0.65 * NS_PER_S)
    assert first.text.startswith("the simulated bus falls behind real time: 0.40 s of bus time in the last 1.00 s; ")
    assert event_json(first, 2.0) == {
        "event": "behind",
        "t": 2.0,
        "speed": 0.4,
        "behind_ms": 650.0,
        "keeps_up": False,
        "text": first.text,
    }
    assert first.severity is Severity.WARNING
    assert told[3].severity is Severity.INFO


def test_a_bus_that_keeps_up_reports_nothing() -> None:
    assert paced([1.0, 0.96, 1.04, 0.91]) == []


@pytest.mark.parametrize("loop", ["an ordinary loop", "a virtual loop in real time"])
def test_a_run_on_a_slow_computer_says_so_at_once_and_at_the_end(
    loop: str, monkeypatch: pytest.MonkeyPatch, capsys: Out
) -> None:
    """The clock goes 5000 times as fast: no computer simulates that much."""
    start, now = time.monotonic_ns(), time.monotonic_ns

    def clock() -> int:
        return start + 5000 * (now() - start)

    monkeypatch.setattr(driver, "monotonic_ns", clock)
    told: list[Event] = []

    async def program() -> None:
        async with bus_of(RAW, on_event=told.append) as bus:
            await bus.rotated(10)
            await bus.until(lambda: any(isinstance(event, BehindRealTime) for event in told), 60)
            stats = bus.stats
        assert stats.behind > 0.9
        assert stats.summary()["behind_ms"] == round(stats.behind * 1000, 1)
        assert bus.stats.behind >= stats.behind  # what it was is kept
        Reporter(bus, json=False).summary(stats)

    if loop == "an ordinary loop":
        asyncio.run(program())
    else:
        dpstack.run_virtual(program(), paced=True)
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("simulated "))
    assert line.endswith(" s: the simulated bus did not keep up with real time")


def test_virtual_time_that_is_not_held_to_real_time_is_never_behind(capsys: Out) -> None:
    async def program() -> None:
        async with bus_of(RAW) as bus:
            await bus.rotated(100)
            Reporter(bus, json=False).summary(bus.stats)
            assert bus.stats.behind == 0.0

    virtual(program())
    assert "simulated" not in capsys.readouterr().out
