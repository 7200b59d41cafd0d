"""The counters of memory and leftovers in the long runs find leftovers, and the judge of results reports them."""

from __future__ import annotations

import asyncio
import fcntl
import mmap
import os
import subprocess
import sys
import threading
from pathlib import Path

from soak import results
from soak.leftovers import belongings, memory, rss_of, stack_objects

from dpstack.trace import WireLog


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
