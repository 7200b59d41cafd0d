"""Many gateways in one process, each with tree, edge node, session file and connection of its own:
``python -m bench.plant.gateways RECORDING FOLDER FIRST COUNT BROKER INTERVAL_MS``.

Each is fed by the recorded live stream at real speed, from another place of it. BROKER 0: gateways without a connector,
for the cost of gateway and tree alone. It prints a JSON line with its memory before the gateways. Each line on standard
input is answered by the losses since the last one: node, address, and the time (CLOCK_MONOTONIC, ns) at which the
stream declared the slave lost. The end of the input ends it; remarks of the gateways come last.
"""

from __future__ import annotations

import asyncio
import gc
import json
import pickle
import sys
import time
from collections import Counter
from pathlib import Path
from typing import ClassVar, Final

from bench.plant.programs import rss_kib
from bench.plant.stream import GROUP, INTERVAL_S, Recording, node_name, replay
from dpstack.api.config.connectors import MqttConfig
from dpstack.bridge.connector import Connector
from dpstack.bridge.gateway import Gateway
from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.client import MqttConnector
from dpstack.bridge.mqtt.plant_node import NodeSetup
from dpstack.plant.tree import PlantTree
from dpstack.trace import Severity

#: streams begin at so many places of the recording
_PLACES: Final = 50
#: of the store of each, as in a configuration without this key
_STORE_MB: Final = MqttConfig(url="mqtt://localhost", group=GROUP).store_mb


class _NoConnector(Connector):
    """A connector that publishes nothing."""

    name: ClassVar[str] = "none"

    def take(self, changes: object) -> None: ...

    async def serve(self) -> None:
        await asyncio.Event().wait()


class Fleet:
    """The gateways of this process. ``lost``: see the module; ``told``: number of each remark."""

    def __init__(self, recording: Recording, broker: int, interval_ms: int, folder: Path) -> None:
        self.lost: list[tuple[str, int, int]] = []
        self.told: Counter[str] = Counter()
        self._recording = recording
        self._broker = broker
        self._interval_s = interval_ms / 1000
        self._folder = folder

    def _tell(self, text: str, severity: Severity) -> None:
        if severity is not Severity.INFO:
            self.told[text] += 1

    def _connector(self, tree: PlantTree, node: str) -> Connector:
        if not self._broker:
            return _NoConnector(tree, self._tell)
        return MqttConnector(
            tree,
            self._tell,
            broker=Broker(url=f"mqtt://127.0.0.1:{self._broker}"),
            setup=NodeSetup(GROUP, node, interval_s=self._interval_s),
            folder=self._folder / node,
            store_mb=_STORE_MB,
        )

    async def run(self, number: int) -> None:
        """The gateway ``number``, until it is cancelled."""
        node = node_name(number)
        # snapshots of different gateways do not come together
        await asyncio.sleep(INTERVAL_S * (number % _PLACES) / _PLACES)
        tree = PlantTree()
        connector = self._connector(tree, node)
        phase = self._recording.seconds * (number % _PLACES) / _PLACES
        items = replay(self._recording, phase, lambda address: self.lost.append((node, address, time.monotonic_ns())))
        await connector.open()
        try:
            await Gateway(items, [connector], tree=tree, tell=self._tell).run()
        finally:
            connector.close()


async def _main(recording: Recording, folder: Path, first: int, count: int, broker: int, interval_ms: int) -> None:
    fleet = Fleet(recording, broker, interval_ms, folder)
    gc.collect()
    print(json.dumps({"rss_kib": rss_kib("self")}), flush=True)
    tasks = [asyncio.create_task(fleet.run(first + n)) for n in range(count)]
    while await asyncio.to_thread(sys.stdin.readline):
        print(json.dumps(fleet.lost), flush=True)
        fleet.lost.clear()
    for task in tasks:
        task.cancel()
    ends = await asyncio.gather(*tasks, return_exceptions=True)
    failed = [repr(end) for end in ends if not isinstance(end, asyncio.CancelledError)]
    print(json.dumps({"told": fleet.told.most_common(20), "failed": failed}), flush=True)


if __name__ == "__main__":
    asyncio.run(_main(pickle.loads(Path(sys.argv[1]).read_bytes()), Path(sys.argv[2]), *map(int, sys.argv[3:])))
