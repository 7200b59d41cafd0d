"""A connector of MQTT at a broker that the test holds."""

from __future__ import annotations

import asyncio
import copy
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from edge_node_rig import GROUP, NODE
from fake_broker import FakeBroker, text
from far_ends import beside, until
from plant_items import PLANT

from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.client import MqttConnector
from dpstack.bridge.mqtt.plant_node import NodeSetup
from dpstack.plant.tree import PlantTree

#: a broker that is not there
NOBODY = Broker(url="mqtt://127.0.0.1:1")


def connector_at(
    folder: Path,
    told: list[str] | None = None,
    *,
    broker: Broker = NOBODY,
    tree: PlantTree | None = None,
    **options: Any,
) -> MqttConnector:
    """A connector of ``tree`` (default: an empty one). ``told`` gets its remarks."""
    return MqttConnector(
        PlantTree() if tree is None else tree,
        lambda remark, severity: None if told is None else told.append(remark),
        broker=broker,
        setup=NodeSetup(GROUP, NODE),
        folder=folder,
        **options,
    )


@asynccontextmanager
async def serving(connector: MqttConnector, tree: PlantTree | None = None, **slaves: Any) -> AsyncIterator[None]:
    """``connector`` serves; with ``tree`` it has a plant whose ``slaves`` (s3, s8) have these values."""
    await connector.open()
    if tree is not None:
        values = {address.removeprefix("s"): one for address, one in slaves.items()}
        whole = {"t": 1.0, "whole": True, "bus": {"stale": False}, "slaves": values}
        for item in ({"plant": PLANT}, {"snapshot": whole}):
            connector.take(tree.apply(copy.deepcopy(item), 0.0))
    try:
        async with beside(connector.serve()) as task, asyncio.timeout(20):
            yield
    finally:
        connector.close()
    assert task.cancelled()


async def published(broker: FakeBroker, topic: str) -> None:
    """Until something was published to ``topic``."""
    await until(lambda: any(body.startswith(text(topic)) for _, body in broker.received))
