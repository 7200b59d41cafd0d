"""Messages of a broker, whatever they hold, for the edge node of Sparkplug B.

The input is pieces: the first octet of each chooses the topic and whether the broker had kept the message, the rest is
its payload. Judged: nothing raises; an order comes only of a message with a time, for a metric that may be written, of
a device in data exchange; the edge node sends what it should, with gapless sequence numbers, and shows printable texts;
a right command is an order afterwards.
"""

from __future__ import annotations

from dpstack.bridge.mqtt import sparkplug_pb2 as pb
from dpstack.bridge.mqtt.edge_node import EdgeNode
from dpstack.bridge.mqtt.plant_node import Disconnect, NodeOptions, NodeSetup, Phase, Publish
from dpstack.plant.tree import PlantTree
from tests.fuzz.frame import Cutter, Target
from tests.fuzz.mqtt_plant import NOW, show_plant

_ALLOWED = ("valves.lamp", "valves.level", "pump.lamp", "hoist.start", "hoist.speed")
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
        show_plant(self.tree, self.node)
        self.connect()

    def connect(self) -> None:
        self.node.connect(1, NOW)
        self.node.connected()
        self.node.receive("spBv1.0/STATE/host", b'{"online": true, "timestamp": 253402300799999}', NOW)
        assert self.node.phase is Phase.ONLINE
        self.pump()

    def pump(self) -> None:
        self.clock += 2.0
        while (message := self.node.next(NOW, self.clock)) is not None:
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
        wishes = session.node.receive(topic, payload, NOW, retained=bool(choice & 0x80))
        assert not wishes or (choice % 8 < 2 and not choice & 0x80)
        for wish in wishes:
            assert wish.name in _ALLOWED
            assert wish.name.partition(".")[0] == topic.rpartition("/")[2]
            assert isinstance(wish.value, (bool, int, float, str, bytes))
            assert wish.made_at >= 0
            session.node.answer(wish, "refused", "the test", NOW)
        if choice & 0x40:
            session.pump()
    session.pump()
    if session.node.phase is not Phase.ONLINE:
        session.connect()
    right = pb.Payload(timestamp=1_700_000_010_000, metrics=[pb.Metric(name="Outputs/lamp", boolean_value=True)])
    (wish,) = session.node.receive(_TOPICS[0], right.SerializeToString(), NOW)
    assert (wish.name, wish.value, wish.made_at) == ("valves.lamp", True, NOW)


TARGET = Target(
    run,
    covers=("dpstack.bridge.mqtt.edge_node", "dpstack.bridge.mqtt.payload"),
    executions=100_000,
    max_len=200,
    words=(b"Outputs/lamp", b"Outputs/level", b"Commands/start", b"Drive/setpoint", b"Node Control/Rebirth",
           b"\x08\x90\xce\xa0\xff\xbc\x31", b"\x12", b"\x0a", b"\x50", b"\x58", b"\x69", b"\x70\x01", b"\x7a", b"\x20",
           b'{"online": false, "timestamp": 253402300799999}'),
)  # fmt: skip
