"""A program that computes and blocks, beside a bus that does not notice: the bus runs in a process of its own.

No hardware needed: the drive is a simulated one, at the other end of a pseudo terminal. On a real line `driver` may be
left out (docs/explanation/drivers.md). Linux only.
"""

import asyncio
import json
import subprocess
import sys
import time

import dpstack

SIMULATION = ["sim", "--drive", "fuji-frenic", "--address", "4", "--port", "pty", "--baud", "1500000", "--json"]
# at the other end is an ordinary program, which a busy computer keeps waiting: a long watchdog, and patience with every
# answer (beside no other master: asking for one, too, would wait so long)
FAN = {"name": "fan", "address": 4, "drive": "fuji-frenic", "watchdog_ms": 5000}


def compute(seconds: float) -> None:
    """Take so much of a processor."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


async def main(port: str) -> None:
    # after_stall="safe" is the default: were the bus held up, too, the fan would stay off until operate()
    bus = dpstack.open_bus(
        port=port, baud=1_500_000, slaves=[FAN], driver="process", host_slack_ms=300, gap=0, after_stall="safe"
    )
    async with bus:  # whatever ends this program: safe values, Clear twice, out of the ring
        await bus.operate()
        await bus.ready(20)
        fan = bus.drive("fan")
        await fan.start(20)
        before = bus.stats.rotations
        for _ in range(5):
            compute(0.1)  # nothing else runs in this program meanwhile
        after = bus.stats.rotations
        print("the bus went round while the program stood still:", after - before > 5)
        print("the fan runs:", fan.status.running)
        await fan.stop(20)


command = [sys.executable, "-m", "dpstack.cli.main", *SIMULATION]
with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as slaves:
    try:
        assert slaves.stdout is not None
        asyncio.run(main(json.loads(slaves.stdout.readline())["port"]))
    finally:
        slaves.terminate()
