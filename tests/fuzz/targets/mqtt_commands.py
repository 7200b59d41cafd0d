"""Messages of a broker, whatever they hold, for the edge node of Sparkplug B.

The input is pieces: the first octet of each chooses the topic and whether the broker had kept the message, the rest is
its payload. Judged: nothing raises; an order comes only of a message with a time, for a metric that may be written, of
a device in data exchange; the edge node sends what it should, with gapless sequence numbers, and shows printable texts;
a right command is an order afterwards.
"""

from __future__ import annotations

from typing import Any

from dpstack.bridge.mqtt import sparkplug_pb2 as pb
from dpstack.bridge.mqtt.edge_node import EdgeNode
from dpstack.bridge.mqtt.plant_node import Disconnect, NodeOptions, NodeSetup, Phase, Publish
from dpstack.bridge.tree import PlantTree
from tests.fuzz.frame import Cutter, Target

_FINE: dict[str, Any] = {"state": "data_exchange", "inputs_valid": True, "inputs_age_ms": 1.0, "inputs_limit_ms": 100.0}
_OUTPUTS = [{"name": name, "type": type_, "at": f"{type_}@0"} for name, type_ in (("lamp", "bool"), ("level", "i16"))]
_PLANT: dict[str, Any] = {
    "version": 1, "started": 1_700_000_000.0, "port": "/dev/ttyUSB0", "baud": 500_000, "address": 2, "read_only": False,
    "slaves": {
        "3": {"name": "hoist", "watchdog_ms": 200.0, "drive": {"profile": "x"}},
        "8": {"name": "valves", "watchdog_ms": 0, "outputs": _OUTPUTS},
        "9": {"name": "pump", "watchdog_ms": 0, "outputs": _OUTPUTS},
    },
}  # fmt: skip
_ALLOWED = ("valves.lamp", "valves.level", "pump.lamp", "hoist.start", "hoist.speed")
_NOW = 1_700_000_010.0
_TOPICS = (
    "spBv1.0/g/DCMD/n/valves",
    "spBv1.0/g/DCMD/n/hoist",
    "spBv1.0/g/DCMD/n/pump",
    "spBv1.0/g/NCMD/n",
    "spBv1.0/STATE/host",
    "spBv1.0/g/DCMD/n/\x1b",
    "spBv1.0/g/DCMD/n/valves/more",
    "",
)


class _Session:
    """An edge node with its births sent; slave 9 is not in data exchange."""

    def __init__(self) -> None:
        self.tree = PlantTree()
        self.node = EdgeNode(NodeSetup("g", "n", "host"), self.tree, NodeOptions(allowed=lambda: _ALLOWED))
        self.clock, self.seq = 0.0, 0
        slaves = {"3": _FINE | {"drive": {"state": "ready"}}, "8": _FINE, "9": _FINE | {"state": "offline"}}
        whole = {"t": 1.0, "whole": True, "bus": {"stale": False}, "slaves": slaves}
        for item in ({"plant": _PLANT}, {"snapshot": whole}):
            self.node.take(self.tree.apply(item, 0.0), _NOW, 0.0)
        self.connect()

    def connect(self) -> None:
        self.node.connect(1, _NOW)
        self.node.connected()
        self.node.receive("spBv1.0/STATE/host", b'{"online": true, "timestamp": 253402300799999}', _NOW)
        assert self.node.phase is Phase.ONLINE
        self.pump()

    def pump(self) -> None:
        self.clock += 2.0
        while (message := self.node.next(_NOW, self.clock)) is not None:
            if isinstance(message, Disconnect):
                self.node.disconnected()
                return
            self._judge(message)

    def _judge(self, message: Publish) -> None:
        kind = message.topic.split("/")[2]
        payload = pb.Payload.FromString(message.payload)
        if kind != "NDEATH":
            self.seq = 0 if kind == "NBIRTH" else (self.seq + 1) % 256
            assert payload.seq == self.seq
        assert all(metric.string_value.isprintable() for metric in payload.metrics)


def run(octets: bytes) -> None:
    session = _Session()
    for piece in Cutter(octets).pieces():
        choice, payload = piece[0] if piece else 0, piece[1:]
        topic = _TOPICS[choice % 8]
        wishes = session.node.receive(topic, payload, _NOW, retained=bool(choice & 0x80))
        assert not wishes or (choice % 8 < 2 and not choice & 0x80)
        for wish in wishes:
            assert wish.name in _ALLOWED
            assert wish.name.partition(".")[0] == topic.rpartition("/")[2]
            assert isinstance(wish.value, (bool, int, float, str, bytes))
            assert wish.made_at >= 0
            session.node.answer(wish, "refused", "the test", _NOW)
        if choice & 0x40:
            session.pump()
    session.pump()
    if session.node.phase is not Phase.ONLINE:
        session.connect()
    right = pb.Payload(timestamp=1_700_000_010_000, metrics=[pb.Metric(name="Outputs/lamp", boolean_value=True)])
    (wish,) = session.node.receive(_TOPICS[0], right.SerializeToString(), _NOW)
    assert wish == ("valves.lamp", True, _NOW)


TARGET = Target(
    run,
    covers=("dpstack.bridge.mqtt.edge_node", "dpstack.bridge.mqtt.payload"),
    executions=100_000,
    max_len=200,
    words=(b"Outputs/lamp", b"Outputs/level", b"Commands/start", b"Drive/setpoint", b"Node Control/Rebirth",
           b"\x08\x90\xce\xa0\xff\xbc\x31", b"\x12", b"\x0a", b"\x50", b"\x58", b"\x69", b"\x70\x01", b"\x7a", b"\x20",
           b'{"online": false, "timestamp": 253402300799999}'),
)  # fmt: skip
