"""A node of plain JSON, a plant with a drive and valves, and a broker with expiry that keeps what is retained."""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Sequence
from typing import Any, Final

from edge_node_rig import GROUP, NODE
from plant_items import HOIST, PLANT, VALVES

from dpstack.bridge.mqtt.json_node import JsonNode
from dpstack.bridge.mqtt.plant_node import Disconnect, NodeOptions, NodeSetup, OrderWish, Publish, Unsubscribe
from dpstack.plant.tree import PlantTree

BASE: Final = f"dpstack/{GROUP}/{NODE}"
ALLOWED: Final = ("valves.lamp", "valves.speed", "hoist.start", "hoist.speed")


class Rig:
    """A node, and a broker that keeps retained messages until they expire. Time passes in :meth:`wait` only."""

    def __init__(
        self, *, interval_s: float = 1.0, discovery_prefix: str = "", allowed: Sequence[str] = ALLOWED
    ) -> None:
        self.prefix = discovery_prefix
        #: subscriptions that the node has left
        self.left: list[str] = []
        self.clock, self.started = 1000.0, 1_700_000_000.0
        self.told: list[str] = []
        #: name, reason and time of each order that the node refused
        self.refused: list[tuple[str, str, str]] = []
        self.plant: dict[str, Any] = copy.deepcopy(PLANT)
        self.values: dict[str, Any] = {"3": copy.deepcopy(HOIST), "8": copy.deepcopy(VALVES)}
        self.tree = PlantTree()
        self.node = JsonNode(
            NodeSetup(GROUP, NODE, "", interval_s, discovery_prefix=discovery_prefix),
            self.tree,
            NodeOptions(
                allowed=lambda: allowed, tell=self.told.append, refused=lambda *order: self.refused.append(order)
            ),
        )
        #: payload and time of expiry by topic
        self.kept: dict[str, tuple[bytes, float]] = {}
        self.sent: list[Publish] = []
        self.will: Publish | None = None
        self.give_plant()

    @property
    def wall(self) -> float:
        return self.started + self.clock - 1000.0

    def give_plant(self) -> None:
        self.node.take(self.tree.apply({"plant": copy.deepcopy(self.plant)}, self.clock), self.wall, 0.0)
        self.give_values()

    def give_values(self) -> None:
        slaves = {one: copy.deepcopy(self.values[one]) for one in self.plant["slaves"]}
        bus = {"stale": False, "mode": "operate"}
        body = {"t": self.clock - 1000.0, "whole": True, "bus": bus, "slaves": slaves}
        self.node.take(self.tree.apply({"snapshot": body}, self.clock), self.wall, 0.0)

    def connect(self) -> None:
        needs = self.node.connect(1, self.wall)
        self.will = needs.will
        self.node.connected()
        subscribed = [re.compile(re.escape(one).replace(r"\+", "[^/]+")) for one in needs.subscriptions]
        for topic, (payload, _) in list(self.kept.items()):
            if any(one.fullmatch(topic) for one in subscribed):
                self.node.receive(topic, payload, self.wall, retained=True)
        self.pump()

    def die(self) -> None:
        """SIGKILL: the broker publishes the will."""
        assert self.will is not None
        self.keep(self.will)
        self.node.disconnected()

    def keep(self, message: Publish) -> None:
        assert message.retain == (message.topic != f"{BASE}/result")
        if message.retain and message.payload:
            self.kept[message.topic] = message.payload, self.clock + (message.expiry_s or math.inf)
        elif message.retain:
            self.kept.pop(message.topic, None)

    def pump(self) -> list[Publish]:
        found: list[Publish] = []
        own = (BASE, *((self.prefix,) if self.prefix else ()))
        while (message := self.node.next(self.wall, self.clock)) is not None:
            if isinstance(message, Disconnect):
                self.die()
                break
            assert message.topic.startswith(tuple(f"{one}/" for one in own))
            if isinstance(message, Unsubscribe):
                self.left.append(message.topic)
                continue
            self.keep(message)
            found.append(message)
            assert len(found) < 1000
        else:
            assert self.node.due(self.clock) > self.clock
        self.sent += found
        return found

    def wait(self, seconds: float, *, stream: bool = True) -> None:
        for _ in range(math.ceil(seconds)):
            self.clock += min(seconds, 1.0)
            if stream:
                self.give_values()
            else:
                self.node.take(self.tree.tick(self.clock), self.wall, 0.0)
            if stream:
                self.pump()
        self.kept = {topic: one for topic, one in self.kept.items() if one[1] > self.clock}

    def seen(self, topic: str) -> Any:
        return json.loads(self.kept[f"{BASE}/{topic}"][0])

    def order(self, topic: str, payload: object, *, retained: bool = False) -> list[OrderWish]:
        octets = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        return list(self.node.receive(f"{BASE}/slave/{topic}", octets, self.wall, retained=retained))

    def result(self) -> Any:
        self.wait(1.0)
        return json.loads([one for one in self.sent if one.topic == f"{BASE}/result"][-1].payload)
