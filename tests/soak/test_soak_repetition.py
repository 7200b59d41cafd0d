"""Whatever a program does again and again while a bus runs leaves no object of the stack behind; the counters of
memory and leftovers in the long runs find leftovers, and the judge of results reports them."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import mmap
import os
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from api_kit import HOIST, RAW, bench_of, mirror, off_and_on, operating, serving, virtual
from soak import results
from soak.leftovers import belongings, memory, rss_of, stack_objects

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.trace import WireLog

Act = Callable[[dpstack.Bus, int], Awaitable[object]]

#: filled to a limit, or counted by address
_BOUNDED = ("dpstack.trace.WireEntry", "dpstack.fdl.telegram.Telegram")
_TIMES = 12


async def stack_without_events(bus: dpstack.Bus) -> Counter[str]:
    """The objects of the stack, once the last events, which the bus keeps, are all alike."""
    await asyncio.sleep(2)  # in virtual time: answers and pauses of the last act are over
    for _ in range(1000):
        core_of(bus).notice("soak", "it fills the last events")
    return stack_objects()


async def repeat(bus: dpstack.Bus, act: Act) -> dict[str, int]:
    """Kinds of objects of which there is one more, or more, for every time ``act`` was done."""
    for number in range(4):
        await act(bus, number)
    before = await stack_without_events(bus)
    for number in range(4, 4 + _TIMES):
        await act(bus, number)
    left = await stack_without_events(bus) - before
    return {kind: count for kind, count in left.items() if count >= _TIMES and kind not in _BOUNDED}


async def add_and_remove(bus: dpstack.Bus, number: int) -> None:
    slave = await bus.add_slave(RAW | {"name": f"n{number}", "address": 20 + number % 3})
    await slave.ready()
    await bus.remove(slave)
    await asyncio.sleep(0.5)


async def power_off_and_on(bus: dpstack.Bus, number: int) -> None:
    await off_and_on(bus, 3)


async def scan(bus: dpstack.Bus, number: int) -> None:
    await bus.scan()


async def sync(bus: dpstack.Bus, number: int) -> None:
    with contextlib.suppress(dpstack.DpError):
        await bus.sync()
        await bus.unsync()


async def wait_in_vain(bus: dpstack.Bus, number: int) -> None:
    with contextlib.suppress(TimeoutError):
        await bus.until(lambda: False, 0.01)
    with contextlib.suppress(TimeoutError):
        await bus.rotated(bus.stats.rotations + 10**9, 0.01)


async def clear_and_operate(bus: dpstack.Bus, number: int) -> None:
    await bus.clear()
    await asyncio.sleep(0.1)
    await bus.operate()
    await asyncio.sleep(0.1)


async def reparameterise(bus: dpstack.Bus, number: int) -> None:
    await bus.slave(3).reparameterise(watchdog_ms=500 + number)


async def cancelled_services(bus: dpstack.Bus, number: int) -> None:
    tasks = [
        asyncio.ensure_future(bus.class2.diagnosis(77)),
        asyncio.ensure_future(bus.class2.config(3)),
        asyncio.ensure_future(bus.drive(3).read(400)),
        asyncio.ensure_future(bus.why(3)),
        asyncio.ensure_future(bus.scan()),
    ]
    await asyncio.sleep(0.001 * number)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def orders_too_late(bus: dpstack.Bus, number: int) -> None:
    bench_of(bus).power(3, False)
    for call in (bus.drive(3).start(0.01), bus.drive(3).read(400, timeout=0.01), bus.class2.diagnosis(3, timeout=0.01)):
        with contextlib.suppress(dpstack.DpError):
            await call
    bench_of(bus).power(3, True)
    await bus.slave(3).ready(30)


#: a DP-V1 slave with one octet each way and one connection of class 2
RIG = dpstack.slave.SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, ms2=1)

ACTS: tuple[Act, ...] = (
    add_and_remove,
    power_off_and_on,
    scan,
    sync,
    wait_in_vain,
    clear_and_operate,
    reparameterise,
    cancelled_services,
    orders_too_late,
)


@pytest.mark.soak
@pytest.mark.parametrize("act", ACTS)
def test_nothing_grows_by_repetition(act: Act) -> None:
    async def run() -> None:
        async with operating(HOIST) as bus:
            assert await repeat(bus, act) == {}

    virtual(run())


def test_recordings_that_are_over_are_forgotten(tmp_path: Path) -> None:
    async def record(bus: dpstack.Bus, number: int) -> None:
        async with bus.record(tmp_path / f"{number}.csv"):
            await asyncio.sleep(0.1)

    async def run() -> None:
        async with operating(HOIST) as bus:
            assert await repeat(bus, record) == {}

    virtual(run())


async def connect(bus: dpstack.Bus, number: int) -> None:
    async with bus.class2.connect(9) as connection:
        with contextlib.suppress(dpstack.DpError):
            await connection.read(1, 1)


async def listen_to_alarms(bus: dpstack.Bus, number: int) -> None:
    stream = bus.slave(9).alarms()
    del stream
    messages = bus.slave(9).status_messages()
    del messages


async def read_records(bus: dpstack.Bus, number: int) -> None:
    for _ in range(2):
        with contextlib.suppress(dpstack.DpError):
            await bus.slave(9).read(1, number, timeout=1)


@pytest.mark.soak
@pytest.mark.parametrize("act", [connect, listen_to_alarms, read_records])
def test_no_service_of_dp_v1_leaves_anything(act: Act) -> None:
    async def run() -> None:
        async with serving(mirror(RIG)) as (bus, _):
            assert await repeat(bus, act) == {}

    virtual(run())


def child_process() -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)


async def test_every_kind_of_leftover_is_found(tmp_path: Path) -> None:
    before = belongings()
    stop = threading.Event()
    thread = threading.Thread(target=stop.wait, name="a thread")
    thread.start()
    task = asyncio.create_task(asyncio.sleep(60), name="a task")
    child = child_process()
    shared = Path(f"/dev/shm/dpstack-test-of-leftovers-{os.getpid()}")
    shared.write_bytes(b"x")
    with (tmp_path / "locked").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        left = belongings().more_than(before)
    shared.unlink()
    stop.set()
    thread.join()
    task.cancel()
    child.communicate()
    await asyncio.gather(task, return_exceptions=True)
    assert {line.partition(":")[0] for line in left} == {"handles", "threads", "tasks", "shared", "locks", "children"}
    assert f"handles: {tmp_path / 'locked'}" in left
    assert "threads: a thread" in left
    assert "tasks: a task" in left
    assert f"children: {child.pid}" in left
    assert belongings().more_than(before) == []


def test_memory_and_objects_of_the_stack_are_counted() -> None:
    small, objects = memory(), stack_objects()
    kept = mmap.mmap(-1, 8 << 20)  # not from memory that earlier tests have given back to the allocator
    kept.write(b"x" * (8 << 20))
    logs = [WireLog() for _ in range(3)]
    large = memory()
    assert large.rss - small.rss > 7 << 20
    assert large.objects > small.objects
    assert (stack_objects() - objects)["dpstack.trace.WireLog"] == len(logs)
    assert rss_of(1) > 0
    kept.close()


def test_every_kind_of_problem_is_reported() -> None:
    flat: results.Line = {"faults": [], "leftovers": []}
    grid = {"earliest_ns": 0, "drift_ns": 0}
    piece = {**flat, "slice": 1, "rss_warm": 0, "rss_end": 1 << 20, "grid": grid, "before": 1, "objects_left": {}}
    ptys = {**flat, "ptys": "process", "growth": {"rss": 1 << 20, "bus_rss": 0, "handles": 0, "objects": 99}}
    traced = {**flat, "traced": 1, "octets": [0, 5, 1 << 20]}
    assert [results.problems(line) for line in (piece, ptys, traced)] == [[], [], []]
    for line, changes in (
        (piece, {"faults": ["sent: 1 of ours, 2 on the wire"]}),
        (piece, {"leftovers": ["tasks: Task-1"]}),
        (piece, {"rss_end": 2 << 20}),
        (piece, {"grid": {"earliest_ns": -1, "drift_ns": 0}}),
        (piece, {"grid": {"earliest_ns": 0, "drift_ns": 3}}),
        (piece, {"objects_left": {"dpstack.api.bus.bus.Bus": 1}}),
        (ptys, {"growth": {"handles": 1}}),
        (ptys, {"growth": {"bus_rss": 2 << 20}}),
        (traced, {"octets": [0, 2 << 20]}),
    ):
        assert len(results.problems({**line, **changes})) == 1, changes
