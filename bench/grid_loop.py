"""A bare loop on the grid of a fixed cycle: ``python -m bench.grid_loop CYCLE_MS``. It only sleeps and notes the time.

It has the settings of a bus process before a pty: niceness, locked memory, exact timers, garbage collection at no time,
processors kept awake; BENCH_WITHOUT names those that it does without. A place that is later than half a cycle is left
out, as a master leaves out a round. At the end of standard input it prints for each wake-up the time when it was due
and the time when it was (ns).
"""

from __future__ import annotations

import json
import os
import sys
from time import monotonic_ns, sleep

from bench.masters import Ended
from bench.settings import switch_off
from dpstack.drivers.realtime import rights
from dpstack.drivers.realtime.gc_control import Collector
from dpstack.drivers.realtime.processors import AwakeProcessors


def main(cycle_ns: int) -> None:
    """Run until the end of standard input."""
    switch_off(filter(None, os.environ.get("BENCH_WITHOUT", "").split(",")))
    ended = Ended()
    ended.watch()
    rights.become_real_time(pty=True)
    Collector().begin()
    AwakeProcessors().hold(True)
    woke = []
    due = monotonic_ns() + cycle_ns
    while not ended.is_set():
        while (now := monotonic_ns()) < due:
            sleep((due - now) / 1e9)
        woke.append((due, now))
        due += cycle_ns
        while monotonic_ns() - due > cycle_ns // 2:
            due += cycle_ns
    print(json.dumps({"woke": woke}), flush=True)


if __name__ == "__main__":
    main(round(float(sys.argv[1]) * 1e6))
