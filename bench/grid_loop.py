"""A bare loop on the grid of a fixed cycle: ``python -m bench.grid_loop CYCLE_MS [PORT BAUD SLAVES]``.

It only sleeps and notes the time. With a port it exchanges data with the slaves after each wake-up, as the bare loop of
bench/masters.py does: request, answer, T_ID1, the token at the end. So its rounds depend on the pty and on the other
end of the line as those of a bus process do, and nothing else is in them.

It has the settings of a bus process before a pty: niceness, locked memory, exact timers, garbage collection at no time,
processors kept awake; BENCH_WITHOUT names those that it does without. A place that is later than half a cycle is left
out, as a master leaves out a round. At the end of standard input it prints for each wake-up the time when it was due
and the time when it was (ns).
"""

from __future__ import annotations

import json
import os
import sys
import tty
from collections.abc import Callable
from time import monotonic_ns, sleep

from bench.masters import FIRST, Ended, Line, bare_bring_up, exchange_round
from bench.settings import switch_off
from dpstack.drivers.realtime import rights
from dpstack.drivers.realtime.gc_control import Collector
from dpstack.drivers.realtime.processors import AwakeProcessors
from dpstack.params import BusParams


def exchanges(line: Line) -> Callable[[], None]:
    """Bring the slaves up. Returns a function that does one round. Raises RuntimeError when a slave refuses."""
    fd = os.open(line.port, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    rounds = bare_bring_up(fd, range(FIRST, FIRST + line.slaves))
    t_id1 = BusParams.preset(line.baud).t_id1
    turn = 0

    def exchange() -> None:
        nonlocal turn
        exchange_round(fd, rounds[turn], line.baud, t_id1)
        turn ^= 1

    return exchange


def main(cycle_ns: int, line: Line | None) -> None:
    """Run until the end of standard input."""
    switch_off(filter(None, os.environ.get("BENCH_WITHOUT", "").split(",")))
    ended = Ended()
    ended.watch()
    rights.become_real_time(pty=True)
    Collector().begin()
    AwakeProcessors().hold(True)
    exchange = exchanges(line) if line else None
    woke = []
    due = monotonic_ns() + cycle_ns
    while not ended.is_set():
        while (now := monotonic_ns()) < due:
            sleep((due - now) / 1e9)
        woke.append((due, now))
        if exchange is not None:
            exchange()
        due += cycle_ns
        while monotonic_ns() - due > cycle_ns // 2:
            due += cycle_ns
    print(json.dumps({"woke": woke}), flush=True)


if __name__ == "__main__":
    cycle_ms, *line = sys.argv[1:]
    main(round(float(cycle_ms) * 1e6), Line(line[0], *map(int, line[1:])) if line else None)
