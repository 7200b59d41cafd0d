#!/bin/sh
# Three cases in which a broker speaks for a gateway that has gone, at the broker amqtt 0.12.1 (Python) and at aedes 1.2.0 (JavaScript, in
# Node-RED). Client: paho-mqtt 2.1.0. Needs Node 20 with npm.
# Guess: a broker of MQTT 3.1.1 publishes the will whenever the connection ends without DISCONNECT: its socket is closed, its keep-alive
# is over by half (3.1.2.10: "MUST disconnect"), or another client takes its identifier (3.1.4, MQTT-3.1.4-2). What was published with
# QoS 0 arrives with QoS 0.
# aedes does that. amqtt publishes it at a closed socket only. A client that is silent (its cable was pulled) is never disconnected: its
# last values stay, "online" too, and Sparkplug's NDEATH never comes. At the same identifier the new connection replaces the old
# one without a will. A message of QoS 0 arrives with QoS 1 if the subscription has QoS 1.
# Pull the plug before you trust a broker with the news that a plant is gone. dpstack wants MQTT 5, which amqtt does not speak, and is
# tested with mosquitto.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install amqtt==0.12.1 paho-mqtt==2.1.0 >/dev/null 2>&1
(cd "$dir" && npm install --silent --no-audit --no-fund --ignore-scripts aedes@1.2.0 >/dev/null 2>&1)
cat >"$dir/aedes.mjs" <<'JS'
import { createServer } from "node:net";
import { Aedes } from "aedes";
const broker = await Aedes.createBroker();
createServer(broker.handle).listen(Number(process.argv[2]), "127.0.0.1");
JS
cat >"$dir/amqtt_broker.py" <<'PY'
import asyncio
import sys

from amqtt.broker import Broker


async def serve():
    await Broker(
        {
            "listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{sys.argv[1]}"}},
            "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}},
        }
    ).start()
    await asyncio.Event().wait()


asyncio.run(serve())
PY
cat >"$dir/try.py" <<'PY'
import socket
import subprocess
import sys
import time

from paho.mqtt.client import CallbackAPIVersion, Client

folder = sys.argv[1]
KEEP_ALIVE_S = 2


class Watcher:
    """A subscriber with QoS 1 that keeps what arrives."""

    def __init__(self, port):
        self.got = []
        self._client = Client(CallbackAPIVersion.VERSION2, client_id="watcher")
        self._client.on_message = lambda client, data, message: self.got.append(
            (message.topic.rpartition("/")[2], int(message.payload), message.qos)
        )
        subscribed = []
        self._client.on_subscribe = lambda *details: subscribed.append(True)
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        self._client.subscribe("plant/#", 1)
        wait_for(lambda: subscribed)

    def heard(self, topic, number, seconds):
        """Whether it arrives in that time."""
        return wait_for(lambda: any(one[:2] == (topic, number) for one in self.got), seconds, must=False)


def wait_for(condition, seconds=20.0, must=True):
    until = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > until:
            assert not must, "nothing came"
            return False
        time.sleep(0.05)
    return True


def gateway(port, watcher, number):
    """A client that says NBIRTH, and whose will is NDEATH, each with a number. Nobody pings for it: it is silent from then on."""
    client = Client(CallbackAPIVersion.VERSION2, client_id="gateway")
    client.will_set("plant/NDEATH", str(number), qos=1)
    client.connect("127.0.0.1", port, keepalive=KEEP_ALIVE_S)
    client.loop_start()
    wait_for(client.is_connected)
    client.publish("plant/NBIRTH", str(number), qos=0)
    assert watcher.heard("NBIRTH", number, 20)
    client.loop_stop()
    return client


def judged(name, command):
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    broker = subprocess.Popen([*command, str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def is_up():
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    try:
        wait_for(is_up, 60)
        watcher = Watcher(port)
        gone = gateway(port, watcher, 1)
        gone.socket().shutdown(socket.SHUT_RDWR)
        found = {"closed": watcher.heard("NDEATH", 1, 10)}
        silent = gateway(port, watcher, 2)
        found["silent"] = watcher.heard("NDEATH", 2, 5 * KEEP_ALIVE_S)
        old = gateway(port, watcher, 3)
        new = gateway(port, watcher, 4)
        found["taken over"] = watcher.heard("NDEATH", 3, 1)
        found["QoS of NBIRTH"] = {qos for topic, number, qos in watcher.got if topic == "NBIRTH"}
        del silent, old, new
    finally:
        broker.kill()
        broker.wait()
    print(f"{name}: {found}")
    return found


print("is the will published?")
right = {"closed": True, "silent": True, "taken over": True, "QoS of NBIRTH": {0}}
assert judged("aedes", ["node", f"{folder}/aedes.mjs"]) == right, "the behaviour has changed"
wrong = {"closed": True, "silent": False, "taken over": False, "QoS of NBIRTH": {1}}
assert judged("amqtt", [sys.executable, f"{folder}/amqtt_broker.py"]) == wrong, "the behaviour has changed"
PY
timeout 300 "$dir/env/bin/python" "$dir/try.py" "$dir"
# output seen:
# is the will published?
# aedes: {'closed': True, 'silent': True, 'taken over': True, 'QoS of NBIRTH': {0}}
# amqtt: {'closed': True, 'silent': False, 'taken over': False, 'QoS of NBIRTH': {1}}
