"""Simulated slaves on a pty, a process of its own: ``python -m bench.plant.slaves COUNT``.

It prints one JSON line with the port. Lines on standard input: ``off ADDRESS`` and ``on ADDRESS``; each is answered by
the time at which it happened (CLOCK_MONOTONIC, ns). The end of the input ends it.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time

from bench.plant.stream import BAUD, slave_tables
from dpstack.api.config.config import make_config, slave_config
from dpstack.api.slave_side.simulation import Simulation


async def _main(count: int) -> None:
    slaves = [slave_config(table) for table in slave_tables(count)]
    simulation = Simulation(make_config("pty", BAUD, 2, slaves), "pty", BAUD)
    async with simulation:
        print(json.dumps({"port": simulation.port_name}), flush=True)
        while order := (await asyncio.to_thread(sys.stdin.readline)).split():
            simulation.power(int(order[1]), order[0] == "on")
            print(time.monotonic_ns(), flush=True)


if __name__ == "__main__":
    asyncio.run(_main(int(sys.argv[1])))
