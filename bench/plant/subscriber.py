"""A subscriber that notes every message with its time of arrival, a process of its own:
``python -m bench.plant.subscriber BROKER FILE``.

It connects again at once when the broker is back. As a host does, it asks a node for its births whose data it gets
without (counted). Lines on standard input, each answered by a line of JSON:

- ``state``: the number of messages, of nodes and of devices born in this connection, and of nodes asked for births
- ``write``: write all messages to FILE (pickle of :class:`~bench.plant.judge.Message`)

The end of the input ends it.
"""

from __future__ import annotations

import json
import pickle
import sys
import threading
import time
from pathlib import Path
from typing import Any, Final

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from bench.plant.judge import Message
from bench.plant.stream import GROUP
from dpstack.bridge.mqtt import sparkplug_pb2 as pb

#: s between two tries to connect
_AGAIN_S: Final = 0.02
_REBIRTH: Final = "Node Control/Rebirth"
_BOOLEAN: Final = 11


class Subscriber:
    """``messages``: all that came. ``nodes``, ``devices``: those that were born in this connection."""

    def __init__(self, port: int) -> None:
        self.messages: list[Message] = []
        self.nodes: set[str] = set()
        self.devices: set[str] = set()
        self.asked: set[str] = set()
        self.is_subscribed = False
        self._session = 0
        self._port = port

    def run(self) -> None:
        while True:
            client = mqtt.Client(
                CallbackAPIVersion.VERSION2,
                client_id="bench subscriber",
                protocol=mqtt.MQTTv5,
                reconnect_on_failure=False,
            )
            client.on_message = self._on_message
            client.on_connect = lambda client, *_: client.subscribe([(f"spBv1.0/{GROUP}/#", 1), ("dpstack/#", 1)])
            client.on_subscribe = lambda *_: setattr(self, "is_subscribed", True)
            self._session += 1
            self.nodes, self.devices, self.asked, self.is_subscribed = set(), set(), set(), False
            try:
                client.connect("127.0.0.1", self._port)
                client.loop_forever(timeout=0.2)
            except OSError:
                pass
            time.sleep(_AGAIN_S)

    def _on_message(self, client: mqtt.Client, _: object, message: mqtt.MQTTMessage) -> None:
        topic = message.topic
        self.messages.append(Message(time.monotonic_ns(), self._session, topic, bytes(message.payload), message.qos))
        words = topic.split("/")
        if words[0] != "spBv1.0":
            return
        match words[2]:
            case "NBIRTH":
                self.nodes.add(words[3])
            case "DBIRTH":
                self.devices.add("/".join(words[3:]))
            case "NDATA" | "DDATA" if words[3] not in self.nodes | self.asked:
                self.asked.add(words[3])
                now_ms = round(time.time() * 1000)
                payload = pb.Payload(timestamp=now_ms)
                payload.metrics.add(name=_REBIRTH, datatype=_BOOLEAN, timestamp=now_ms, boolean_value=True)
                client.publish(f"spBv1.0/{GROUP}/NCMD/{words[3]}", payload.SerializeToString())

    def state(self) -> dict[str, Any]:
        return {
            "subscribed": self.is_subscribed,
            "messages": len(self.messages),
            "nodes": len(self.nodes),
            "devices": len(self.devices),
            "asked": len(self.asked),
        }


def _main(port: int, path: Path) -> None:
    subscriber = Subscriber(port)
    threading.Thread(target=subscriber.run, daemon=True).start()
    for order in sys.stdin:
        if order.strip() == "write":
            with path.open("wb") as file:
                pickle.dump([tuple(message) for message in subscriber.messages], file)
        print(json.dumps(subscriber.state()), flush=True)


if __name__ == "__main__":
    _main(int(sys.argv[1]), Path(sys.argv[2]))
