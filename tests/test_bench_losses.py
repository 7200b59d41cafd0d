"""A benchmark whose master lost slaves says which, when, and who was kept from running."""

from __future__ import annotations

import os
import signal
import threading
import time

import pytest

from bench.losses import story
from bench.rig import Bench, MasterFailedError, bench, pinned

MS = 1_000_000

TOLD = {
    "lost": {"s1": "offline"},
    "failed": [],
    "ready": 1_000 * MS,
    "end": 1_500 * MS,
    "events": [("SlaveFaulted", 1_204 * MS, "slave 4 (s1): stopped answering during Data_Exchange")],
    "held_up": [],
    "host_us": {"p50": 71.0, "max": 47_642.0},
    "asked": {"s0": (300, 0, 0, 0), "s1": (100, 1, 1, 2)},
}


def test_the_story_of_a_lost_slave() -> None:
    # the first pause was over before all slaves were in data exchange
    wire = {"held_up": [(1_098 * MS, 320 * MS), (500 * MS, 400 * MS)], "over": ""}
    assert story(TOLD, wire, 0) == (
        "lost after 500.0 ms: s1 offline; s1 was asked 100 times, 1 retries, given up 1, late answers 2; "
        "the master's program was held up never for long; the wire's process was held up 320.0 ms at 98.0 ms; "
        "answers came late by (us) p50 71.0, max 47642.0; "
        "204.0 ms SlaveFaulted: slave 4 (s1): stopped answering during Data_Exchange"
    )


def test_a_wire_that_is_no_more_and_a_host_that_takes_processors_away() -> None:
    text = story(TOLD | {"held_up": [(1_100 * MS, 60 * MS)]}, {"over": "BlockingIOError: full"}, 250 * MS)
    assert "the master's program was held up 60.0 ms at 100.0 ms;" in text
    assert "the wire serves no more: BlockingIOError: full;" in text
    assert "the host kept processors from this machine for 250.0 ms;" in text


def stand_still(running: Bench) -> None:
    """The wire's process for 1.8 s, and the master is told to end meanwhile."""
    wire = running._wire.pid
    os.kill(wire, signal.SIGSTOP)
    threading.Timer(1.8, os.kill, (wire, signal.SIGCONT)).start()
    time.sleep(1.4)  # twice two slot times with their slack take 0.2 s; a computer may be busy


def test_slaves_are_lost_when_the_wires_process_stands_still_and_that_is_what_is_told() -> None:
    why = r"lost after .*the wire's process was held up [0-9.]+ ms at .*stopped answering during Data_Exchange"
    with (
        pinned() as where,
        pytest.raises(MasterFailedError, match=why),
        bench("asyncio", 2, 500_000, where, gap=0) as running,
    ):
        stand_still(running)
