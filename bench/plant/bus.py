"""A gateway as users run it, a process of its own: ``python -m bench.plant.bus PORT NODE SLAVES BROKER INTERVAL_MS``.

A bus with the driver process, whose outputs change all the time, published by MQTT. It prints a JSON line when all
slaves are in data exchange. Each line on standard input is answered by ``exchanges`` so far, and ``lost`` since the
last one: address and time (CLOCK_MONOTONIC, ns) at which the master declared each slave lost. The end of the input ends
it.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys

from bench.plant.stream import BAUD, GROUP, INTERVAL_S, change_outputs, slave_tables
from dpstack import Bus, SlaveState, open_bus, publish
from dpstack.dp.master.events import SlaveStateChanged


async def _main(port: str, node: str, slaves: int, broker: int, interval_ms: int) -> None:
    lost: list[tuple[int, int]] = []

    def on_event(event: object) -> None:
        if isinstance(event, SlaveStateChanged) and event.state is SlaveState.OFFLINE:
            lost.append((event.address, event.t_ns))

    table = {"url": f"mqtt://127.0.0.1:{broker}", "group": GROUP, "node": node, "interval_ms": interval_ms}
    bus = open_bus(port=port, baud=BAUD, slaves=slave_tables(slaves), driver="process", on_event=on_event)
    async with publish(bus, mqtt=table), bus:
        await bus.operate()
        await bus.ready(60)
        changing = asyncio.create_task(_change(bus))
        print(json.dumps({"ready": node}), flush=True)
        while await asyncio.to_thread(sys.stdin.readline):
            exchanges = sum(slave.exchanges for slave in bus.stats.slaves.values())
            print(json.dumps({"exchanges": exchanges, "lost": lost}), flush=True)
            lost.clear()
        changing.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await changing


async def _change(bus: Bus) -> None:
    number = 0
    while True:
        number += 1
        change_outputs(bus.slaves, number)
        await asyncio.sleep(INTERVAL_S)


if __name__ == "__main__":
    asyncio.run(_main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), int(sys.argv[5])))
