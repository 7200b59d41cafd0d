"""Orders from a broker that the test holds to a run that the test is."""

from __future__ import annotations

import asyncio
import copy
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiomqtt
import pytest
from edge_node_rig import GROUP, NODE
from fake_broker import FakeBroker, publish, text
from plant_items import HOIST, PLANT, VALVES

from dpstack.bridge.mqtt import sparkplug_pb2 as pb
from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.client import MqttConnector
from dpstack.bridge.mqtt.connection import Inbox
from dpstack.bridge.mqtt.plant_node import NodeSetup
from dpstack.bridge.orders import Orders
from dpstack.plant.orders import DriveOrder, SetOutputs
from dpstack.plant.tree import PlantTree


async def test_outputs_of_one_command_change_together(tmp_path: Path) -> None:
    carried: list[SetOutputs | DriveOrder] = []
    tree = PlantTree()

    async def carry_out(order: SetOutputs | DriveOrder) -> None:
        carried.append(order)

    async with FakeBroker() as broker:
        connector = MqttConnector(
            tree,
            lambda remark, severity: None,
            broker=Broker(url=broker.url),
            setup=NodeSetup(GROUP, NODE),
            folder=tmp_path / "state",
            orders=Orders(tree, carry_out, ["valves.*"]),
        )
        await connector.open()
        whole = {"t": 1.0, "whole": True, "bus": {"stale": False}, "slaves": {"3": HOIST, "8": VALVES}}
        for item in ({"plant": PLANT}, {"snapshot": whole}):
            connector.take(tree.apply(copy.deepcopy(item), 0.0))
        serving = asyncio.create_task(connector.serve())
        async with asyncio.timeout(10):
            birth = text(f"spBv1.0/{GROUP}/DBIRTH/{NODE}/valves")
            while not any(body.startswith(birth) for _, body in broker.received):  # noqa: ASYNC110
                await asyncio.sleep(0.005)  # the broker tells nobody of its packets
            metrics = [pb.Metric(name="Outputs/lamp", boolean_value=True), pb.Metric(name="Outputs/speed", int_value=7)]
            command = pb.Payload(timestamp=round(time.time() * 1000), metrics=metrics)
            broker.send(publish(f"spBv1.0/{GROUP}/DCMD/{NODE}/valves", command.SerializeToString()))
            while not carried:  # noqa: ASYNC110
                await asyncio.sleep(0.005)
        serving.cancel()
        with suppress(asyncio.CancelledError):
            await serving
        connector.close()
    assert carried == [SetOutputs(8, {"lamp": True, "speed": 7})]


async def test_messages_that_came_too_fast_are_counted_and_told_while_the_connection_stands(tmp_path: Path) -> None:
    told: list[str] = []
    connector = MqttConnector(
        PlantTree(),
        lambda remark, severity: told.append(remark),
        broker=Broker(url="mqtt://127.0.0.1:1"),
        setup=NodeSetup(GROUP, NODE),
        folder=tmp_path,
    )
    inbox, message = Inbox(1), aiomqtt.Message("t", b"", 0, False, 1, None)
    client: Any = SimpleNamespace(_queue=inbox)
    text = "{} messages of the broker came faster than they could be read: they are lost"
    for told_now, is_end in ((2, False), (None, False), (6, True), (None, True)):
        for _ in range(0 if told_now is None and is_end else 3):
            inbox.put_nowait(message)
        before = len(told)
        connector._count_lost(client, is_end=is_end)
        assert told[before:] == ([] if told_now is None else [text.format(told_now)])
    assert connector.dropped == 8


@pytest.mark.parametrize("good_s", [30.0, 0.0])
async def test_a_broker_that_closes_again_and_again_names_the_likely_cause(
    good_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two gateways of one node, at a broker that does not say why; each has long sessions while the other waits."""
    monkeypatch.setattr("dpstack.bridge.mqtt.client._GOOD_S", good_s)
    told: list[str] = []
    async with FakeBroker() as broker:
        connector = MqttConnector(
            PlantTree(),
            lambda remark, severity: told.append(remark),
            broker=Broker(url=broker.url),
            setup=NodeSetup(GROUP, NODE),
            folder=tmp_path,
            again_s=0.001,
        )
        await connector.open()
        serving = asyncio.create_task(connector.serve())
        place = f"broker 127.0.0.1:{broker.port}"
        cause = f"another gateway uses this node's name (group {GROUP!r}, node {NODE!r}); give one of them another node"
        async with asyncio.timeout(20):
            while f"{place} closes the connection again and again: probably {cause}" not in told:
                if connector.connected:
                    broker.cut()
                await asyncio.sleep(0.002)  # the broker tells nobody of its clients
        assert sum("it is tried again" in text for text in told) == 3
        serving.cancel()
        with suppress(asyncio.CancelledError):
            await serving
        connector.close()
