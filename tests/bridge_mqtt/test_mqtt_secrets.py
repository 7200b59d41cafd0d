"""The connectors of MQTT at a broker that the test holds: no secret in what they publish; wills, sessions and
expiry."""

from __future__ import annotations

import asyncio
import copy
from pathlib import Path

import pytest
from edge_node_rig import GROUP, NODE
from fake_broker import CONNECT, PUBLISH, FakeBroker, text, user_property
from plant_items import FINE, HOIST, PLANT, VALVES

from dpstack.bridge.mqtt.broker import Broker, read_password
from dpstack.bridge.mqtt.client import MqttConnector
from dpstack.bridge.mqtt.edge_node import EdgeNode
from dpstack.bridge.mqtt.json_node import JsonNode
from dpstack.bridge.mqtt.plant_node import NodeSetup, PlantNode
from dpstack.plant.tree import PlantTree

BASE, SPARKPLUG = f"dpstack/{GROUP}/{NODE}", f"spBv1.0/{GROUP}"
SESSION = user_property("session", "0")
#: topics that are published, the last one last; and the end of the will
JSON = (
    [f"{BASE}/{one}" for one in ("status", "slave/valves/inputs", "slave/hoist/drive", "bus/state", "online")],
    bytes([len(SESSION)]) + SESSION + text(f"{BASE}/online") + text("false"),
)
BIRTHS = (
    [f"{BASE}/status", *(f"{SPARKPLUG}/{one}" for one in (f"NBIRTH/{NODE}", f"DBIRTH/{NODE}/valves"))],
    b"\0" + text(f"{SPARKPLUG}/NDEATH/{NODE}"),
)


@pytest.mark.parametrize(("make_node", "topics", "will"), [(JsonNode, *JSON), (EdgeNode, *BIRTHS)])
async def test_no_secret_is_published_and_a_will_has_the_number_of_its_session(
    tmp_path: Path, make_node: type[PlantNode], topics: list[str], will: bytes
) -> None:
    secret = tmp_path / "hidden.password"
    secret.touch(mode=0o600)
    secret.write_text("sesame opens\n")
    told: list[str] = []
    async with FakeBroker(topics=1) as broker:
        tree = PlantTree()
        connector = MqttConnector(
            tree,
            lambda remark, severity: told.append(remark),
            broker=Broker(url=broker.url, user="the gateway", password=read_password("", secret)),
            setup=NodeSetup(GROUP, NODE),
            folder=tmp_path / "state",
            versions={"dpstack": "0.1.0"},
            make_node=make_node,
        )
        await connector.open()
        slaves = {"3": HOIST, "8": VALVES | FINE}
        for item in (
            {"plant": PLANT},
            {"snapshot": {"t": 1.0, "whole": True, "bus": {"stale": False}, "slaves": slaves}},
        ):
            connector.take(tree.apply(copy.deepcopy(item), 0.0))
        serving = asyncio.create_task(connector.serve())
        async with asyncio.timeout(10):
            while not any(body.startswith(text(topics[-1])) for _, body in broker.received):  # noqa: ASYNC110
                await asyncio.sleep(0.005)  # the broker tells nobody of its packets
        serving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await serving
        connector.close()
    sent = [body for kind, body in broker.received if kind == PUBLISH]
    for topic in topics:
        assert any(body.startswith(text(topic)) for body in sent), topic
    (connect,) = [body for kind, body in broker.received if kind == CONNECT]
    assert text("sesame opens") in connect
    assert will in connect
    # MQTT 5, Clean Start, a Session Expiry Interval of 0 (tck-id-principles-persistence-clean-session-50)
    assert (connect[6], connect[7] & 2) == (5, 2)
    assert b"\x11\0\0\0\0" in connect[11 : 11 + connect[10]]
    # with a Message Expiry Interval of 30 s
    assert any(body.startswith(text(f"{BASE}/status") + b"\x05\x02\0\0\0\x1e") for body in sent)
    for body in (*sent, *(remark.encode() for remark in told)):
        for hidden in (b"sesame", b"the gateway", b"hidden.password", str(tmp_path).encode()):
            assert hidden not in body
