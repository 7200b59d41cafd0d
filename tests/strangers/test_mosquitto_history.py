"""Store and forward with mosquitto: broker and gateway are killed, the primary host goes; a counter of the plant has no
hole. A host that knows only the specification judges."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from pathlib import Path
from typing import Final

import pytest
from edge_node_rig import GROUP, NODE
from far_ends import until
from history_rig import COUNTER
from sparkplug_host import Host

from tests.strangers.mosquitto_kit import Mosquitto, Plant, following, plain, run, valves_file

pytestmark = pytest.mark.strangers

TICK_S: Final = 0.25


class Counting:
    """A plant that counts."""

    def __init__(self, folder: Path, broker: Mosquitto) -> None:
        self.plant = Plant(folder, plain(broker), primary_host="scada", store_mb=1)
        self.plant.plant["slaves"]["8"]["inputs"].append(COUNTER)
        self.plant.values["8"]["fields"]["number"] = 0

    async def count(self, times: int) -> None:
        fields = self.plant.values["8"]["fields"]
        for _ in range(times):
            await asyncio.sleep(TICK_S)
            fields["number"] += 1


def arrived(host: Host, name: str, device: str) -> list[tuple[int, int, bool]]:
    """Values of a metric with times as they arrived, and whether they are history. History is behind the births."""
    found: list[tuple[int, int, bool]] = []
    alias = datatype = None
    births = 0
    for kind, one, payload in host.messages:
        births = 0 if kind == "NBIRTH" else births + (kind == "DBIRTH")
        if one != device:
            continue
        for metric in payload.metrics:
            if kind == "DBIRTH" and metric.name == name:
                alias, datatype = metric.alias, metric.datatype
            if alias is None or metric.alias != alias or metric.null:
                continue
            assert datatype is not None
            assert metric.timestamp is not None
            assert births or not metric.historical
            found.append((metric.value(datatype), metric.timestamp, metric.historical))
    return found


def connections(plant: Plant) -> int:
    return sum(text.startswith("connected") for text in plant.told)


async def state(broker: Mosquitto, *, online: bool, time: int) -> None:
    text = f'{{"online": {str(online).lower()}, "timestamp": {time}}}'
    await run(broker.clients("mosquitto_pub", "-q", "1", "-t", "spBv1.0/STATE/scada", "-m", text))


async def test_the_broker_is_killed_and_the_primary_host_goes_and_no_number_is_missing(
    tmp_path: Path, broker: Mosquitto
) -> None:
    counting = Counting(tmp_path, broker)
    plant = counting.plant
    found: list[tuple[int, int, bool]] = []
    wanted = 1
    async with plant.running():
        for turn in range(1, 4):
            async with following(broker) as subscriber:
                host = subscriber.host
                # births wait for the host, so the subscriber is there before them
                await plant.until(
                    lambda: connections(plant) >= wanted  # noqa: B023
                )
                await asyncio.sleep(0.5)
                await state(broker, online=True, time=turn * 1000)
                await plant.until(lambda: host.alive == {"hoist", "valves"})  # noqa: B023
                await counting.count(4)
                if turn == 2:
                    await state(broker, online=False, time=turn * 1000 + 1)
                    await plant.until(lambda: not host.online)  # noqa: B023
                    await counting.count(4)
                    await asyncio.sleep(1.5)
                    await state(broker, online=True, time=turn * 1000 + 2)
                    await plant.until(lambda: host.alive == {"hoist", "valves"})  # noqa: B023
                last = plant.values["8"]["fields"]["number"]

                def complete() -> bool:
                    numbers = {one for one, _, _ in [*found, *arrived(host, "Inputs/number", "valves")]}  # noqa: B023
                    return numbers >= set(range(last + 1))  # noqa: B023

                await plant.until(complete)
                if turn < 3:
                    await counting.count(2)
                    broker.kill()
                    found += arrived(host, "Inputs/number", "valves")
                    host.lose_broker()
            if turn < 3:
                await counting.count(6)
                wanted = connections(plant) + 1
                broker.start()
        history = [(number, time) for number, time, old in arrived(host, "Inputs/number", "valves") if old]
        assert history == sorted(history, key=lambda one: one[1])
        assert [number for number, _ in history] == sorted(number for number, _ in history)
        assert len(history) >= 6
        assert plant.connector.dropped == 0
        all_of = [*found, *arrived(host, "Inputs/number", "valves")]
        times = {number: time for number, time, old in all_of if old}
        steps = [times[number + 1] - times[number] for number in times if number + 1 in times]
        assert all(step > TICK_S * 500 for step in steps), steps  # each has the time at which it came


async def test_values_of_a_run_that_was_killed_without_a_broker_follow_in_the_next_one(
    tmp_path: Path, broker: Mosquitto
) -> None:
    config = valves_file(tmp_path, broker, store_mb=1)
    environment = os.environ | {"XDG_STATE_HOME": str(tmp_path / "state"), "XDG_RUNTIME_DIR": str(tmp_path)}
    words = (sys.executable, "-m", "dpstack")
    null = asyncio.subprocess.DEVNULL
    broker.kill()
    run_ = await asyncio.create_subprocess_exec(*words, "run", config, env=environment, stdout=null)
    try:
        for speed in range(6):
            ctl = (*words, "ctl", "virtual", "set", f"valves.speed={speed}")
            while True:  # the run may not listen yet
                asked = await asyncio.create_subprocess_exec(*ctl, env=environment, stdout=null, stderr=null)
                if await asked.wait() == 0:
                    break
                assert speed == 0
            await asyncio.sleep(0.4 if speed else 1.5)  # at first the slave is not in data exchange
        store = tmp_path / "state" / "dpstack" / f"{GROUP}.{NODE}" / "history.sqlite"
        await until(store.exists)
        await asyncio.sleep(1.5)
        run_.send_signal(signal.SIGKILL)
        await run_.wait()
        broker.start()
        async with following(broker) as subscriber:
            host = subscriber.host
            run_ = await asyncio.create_subprocess_exec(*words, "run", config, env=environment, stdout=null)
            await until(lambda: host.alive == {"valves"})
            speeds = list[int]()

            def complete() -> bool:
                values = arrived(host, "Outputs/speed", "valves")
                speeds[:] = [value for value, _, old in values if old]
                return speeds[-1:] == [5]

            await until(complete)
            assert [one for one in dict.fromkeys(speeds) if one] == [1, 2, 3, 4, 5]
            run_.send_signal(signal.SIGINT)
            assert await run_.wait() == 0
    finally:
        if run_.returncode is None:
            run_.kill()
            await run_.wait()
