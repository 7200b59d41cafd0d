"""A broken wire of a simulated rack, as each connector shows it at the same time: number, quality, reason."""

from __future__ import annotations

import asyncio
import json
from datetime import UTC, datetime
from typing import Any

from api_kit import in_virtual_time
from metrics_kit import read
from rack_kit import LINE_BREAK, device, rack
from sparkplug_host import Host

import dpstack
from dpstack.bridge.epics.alarms import of_reading
from dpstack.bridge.metrics.collector import Collector
from dpstack.bridge.metrics.connector import rendered
from dpstack.bridge.mqtt.edge_node import EdgeNode
from dpstack.bridge.mqtt.json_node import JsonNode
from dpstack.bridge.mqtt.plant_node import NodeOptions, NodeSetup, PlantNode, Publish
from dpstack.bridge.opcua.space import data_value
from dpstack.plant.tree import PlantTree
from dpstack.slave import UserDiag, identifier_block

SETUP = NodeSetup("hall", "line", "", 0.0)


class Connectors:
    """All connectors of a bus. :meth:`see` gives the stream to them until the bus has been heard for a while."""

    def __init__(self, bus: dpstack.Bus) -> None:
        self.bus = bus
        self.tree = PlantTree()
        self.collector = Collector(self.tree, most_values=10)
        self.nodes: list[PlantNode] = [make(SETUP, self.tree, NodeOptions()) for make in (JsonNode, EdgeNode)]
        self.host = Host("hall", "line")
        self.topics: dict[str, bytes] = {}
        for node in self.nodes:
            node.connect(1, 0.0)
            node.connected()

    async def follow(self) -> None:
        loop = asyncio.get_running_loop()
        async for item in self.bus.live(0.05):
            changes = self.tree.apply(item, loop.time())
            self.collector.take(changes)
            for node in self.nodes:
                node.take(changes, self.wall, loop.time())
                while isinstance(message := node.next(self.wall, loop.time()), Publish):
                    if message.topic.startswith("spBv1.0"):
                        self.host.feed(message.topic, message.payload, qos=message.qos, retain=message.retain)
                    else:
                        self.topics[message.topic] = message.payload

    @property
    def wall(self) -> float:
        return 1_700_000_000.0 + asyncio.get_running_loop().time()

    async def shown(self, name: str) -> dict[str, Any]:
        """The input ``name`` of the rack, by connector."""
        slave = self.bus.slaves[0].name
        part = json.loads(self.topics[f"dpstack/hall/line/slave/{slave}/inputs"])[name]
        metric = self.host.metric(f"Inputs/{name}", slave)
        words = [metric.properties[key] for key in ("Quality", "Quality word", "Quality reason")]
        [(node, reading)] = [one for one in self.tree.readings(9) if one[0].id == f"slave/9/input/{name}"]
        value = data_value(node, reading, lambda time: datetime.fromtimestamp(time, UTC))
        assert value.Value is not None
        assert value.StatusCode is not None
        scraped = read(await rendered(self.collector.families()))
        [(series, rank)] = [
            (one, rank) for one, rank in scraped.of("dpstack_slave_value_quality").items() if ("value", name) in one
        ]
        return {
            "json": (part["value"], part["quality"], part["reason"]),
            "sparkplug": (metric.value, *words),
            "opcua": (value.Value.Value, value.StatusCode.value, reading.text),
            "metrics": (scraped.of("dpstack_slave_value").get(series), rank),
            "epics": (reading.value, *of_reading(node, reading)),
        }


@in_virtual_time
async def test_connectors_show_a_broken_wire_each_in_its_way() -> None:
    async with rack() as (bus, slave, served):
        connectors = Connectors(bus)
        following = asyncio.ensure_future(connectors.follow())
        slave["setpoint"] = 77  # its inputs mirror the outputs: the level
        await asyncio.sleep(0.3)
        good = {
            "json": (77, "good", ""),
            "sparkplug": (77, 192, "good", ""),
            "opcua": (77, 0, ""),
            "metrics": (77, 3),
            "epics": (77, 0, 0),
        }
        assert await connectors.shown("level") == good
        device(served).diag = UserDiag.of(identifier_block([2], 5))
        await asyncio.sleep(0.3)
        text = "has a diagnosis: slot 3"
        assert await connectors.shown("level") == {
            "json": (77, "uncertain", text),
            "sparkplug": (77, 500, "uncertain", text),
            "opcua": (77, 0x40950000, text),
            "metrics": (77, 2),
            "epics": (77, 15, 1),  # SOFT, MINOR
        }
        device(served).diag = UserDiag.of(LINE_BREAK)
        slave["setpoint"] = 3276
        await asyncio.sleep(0.3)
        text = "line break: slot 3, input channel 0"
        assert await connectors.shown("level") == {
            "json": (None, "bad", text),
            "sparkplug": (3276, 0, "bad", text),
            "opcua": (3276, 0x808C0000, text),
            "metrics": (None, 0),
            "epics": (3276, 1, 3),  # READ, INVALID
        }
        assert (await connectors.shown("flow"))["json"] == (0, "good", "")
        # the slave is gone: the old value is the one of before
        await slave.deactivate()
        await asyncio.sleep(0.3)
        found = await connectors.shown("level")
        assert found["json"][:2] == (77, "stale")
        assert found["opcua"][:2] == (77, 0x408F0000)
        assert found["metrics"] == (None, 1)
        assert found["epics"] == (77, 9, 3)  # COMM, INVALID
        device(served).diag = UserDiag()
        slave["setpoint"] = 77
        await slave.activate()
        await slave.ready()
        await asyncio.sleep(0.3)
        assert await connectors.shown("level") == good
        following.cancel()
