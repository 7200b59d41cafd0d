"""Messages of a broker, whatever they hold, for the node of plain JSON, which takes orders.

The input is pieces: the first octet of each chooses the topic, whether the broker had kept the message and whether the
rest bends a right order; else the rest is the payload. Judged: nothing raises; an order comes only of a message that
the broker had not kept, of a listed name, and is the very one that ``json`` of Python reads; each message to a topic of
orders has one result, with printable texts, and results that wait are bounded; a right order is one afterwards.
"""

from __future__ import annotations

import json
import math
from unittest import mock

from dpstack.bridge.mqtt import json_node
from dpstack.bridge.mqtt.json_node import JsonNode
from dpstack.bridge.mqtt.json_payload import MOST_OCTETS
from dpstack.bridge.mqtt.plant_node import NodeOptions, NodeSetup, Publish
from dpstack.plant.tree import PlantTree
from tests.fuzz.bent_json import bent, text_of
from tests.fuzz.frame import Cutter, Target, assert_plain
from tests.fuzz.mqtt_plant import NOW, show_plant

#: by the topic. The pump is not in data exchange: the run refuses its order, not the node
_ORDERS = {
    "valves/set/lamp": "valves.lamp",
    "valves/set/level": "valves.level",
    "hoist/set/start": "hoist.start",
    "hoist/set/speed": "hoist.speed",
    "pump/set/lamp": "pump.lamp",
}
_TOPICS = (*_ORDERS, "hoist/set/stop", "\x1b[2J/set/lamp", "valves/get/lamp")
_BASE = "dpstack/g/n"
_GOOD = {"value": True, "time": NOW}
#: results that wait, at most: fewer than those of the product, so that an input can make more
_MOST_RESULTS = 16


class _Session:
    """A node that has sent all its topics."""

    def __init__(self) -> None:
        tree = PlantTree()
        allowed = tuple(_ORDERS.values())
        self.node = JsonNode(NodeSetup("g", "n"), tree, NodeOptions(allowed=lambda: allowed))
        show_plant(tree, self.node)
        self.node.connect(1, NOW)
        self.node.connected()
        assert self.results() == 0

    def results(self) -> int:
        """Send everything; the number of the results among it, which are judged."""
        count = 0
        while (message := self.node.next(NOW, 2.0)) is not None:
            assert isinstance(message, Publish)
            if message.topic == f"{_BASE}/result":
                count += 1
                result = json.loads(message.payload)
                assert result["result"] == "refused"
                assert result["reason"]
                for text in (result["order"], result["order_time"] or "", result["reason"]):
                    assert_plain(text)
                    assert len(text) <= 300
        return count


def run(octets: bytes) -> None:
    with mock.patch.object(json_node, "_MOST_RESULTS", _MOST_RESULTS):
        _run(octets)


def _run(octets: bytes) -> None:
    session, waiting = _Session(), 0
    for piece in Cutter(octets).pieces():
        choice, payload = piece[0] if piece else 0, piece[1:]
        if choice & 0x40:
            payload = text_of(bent(_GOOD, Cutter(payload))).encode()
        elif choice & 0x20:
            payload *= 1 + MOST_OCTETS // 8
        waiting += _take(session, _TOPICS[choice % 8], payload, retained=bool(choice & 0x80))
        if choice & 0x10:
            assert session.results() == min(waiting, _MOST_RESULTS)
            waiting = 0
    assert session.results() == min(waiting, _MOST_RESULTS)
    wishes = session.node.receive(f"{_BASE}/slave/{_TOPICS[0]}", json.dumps(_GOOD).encode(), NOW)
    assert [wish[:3] for wish in wishes] == [("valves.lamp", True, NOW)]


def _take(session: _Session, topic: str, payload: bytes, *, retained: bool) -> int:
    """Hand over a message, and refuse the order that comes of it. Returns the number of results to come."""
    wishes = session.node.receive(f"{_BASE}/slave/{topic}", payload, NOW, retained=retained)
    for wish in wishes:
        assert not retained
        assert wish.name == _ORDERS[topic]
        assert len(payload) <= MOST_OCTETS
        assert wish.made_at is not None
        assert 0 <= wish.made_at < math.inf
        assert not isinstance(wish.value, float) or math.isfinite(wish.value)
        said = json.loads(payload)
        assert set(said) <= {"value", "time"}
        assert (wish.value, type(wish.value)) == (said.get("value"), type(said.get("value")))
        assert isinstance(said["time"], str) or wish.made_at == said["time"]
        session.node.answer(wish, "refused", "the test", NOW)
    assert len(wishes) <= 1
    return "/set/" in topic


TARGET = Target(
    run,
    covers=("dpstack.bridge.mqtt.json_node", "dpstack.bridge.mqtt.json_payload"),
    executions=100_000,
    max_len=200,
    words=(b'{"value":', b',"time":', b"1700000010", b"true", b"null", b"1e999", b"NaN", b"-Infinity", b"}", b"[", b"{",
           b'"2023-11-14T22:13:30Z"', b'"2023-11-14T22:13:30+23:59"', b'"0001-01-01T00:00Z"', b"\\u001b", b"\\ud800",
           b"\xff", b'"value":', b"9" * 120),
)  # fmt: skip
