"""Plain JSON: topics, payloads, orders and their refusals, as a broker with expiry and a subscriber sees them;
orders to a run that the test is."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiomqtt
import pytest
from edge_node_rig import GROUP, NODE
from fake_broker import FakeBroker, publish
from far_ends import until
from hypothesis import given
from hypothesis import strategies as st
from plant_items import HOIST, VALVES
from property_kit import examples

from dpstack.bridge.mqtt import sparkplug_pb2 as pb
from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.connection import Inbox
from dpstack.bridge.mqtt.json_payload import read_order
from dpstack.bridge.mqtt.plant_node import OrderWish, Publish
from dpstack.bridge.orders import Orders
from dpstack.plant.orders import DriveOrder, RefusedOrder, SetOutputs
from dpstack.plant.quality import Value
from dpstack.plant.tree import ClockSet, PlantTree
from tests.bridge_mqtt.connector_kit import connector_at, published, serving
from tests.bridge_mqtt.json_rig import BASE, Rig

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "mqtt-json.md"


@pytest.fixture
def rig() -> Rig:
    made = Rig()
    made.connect()
    return made


def test_every_topic_is_in_the_table_of_the_page_and_values_come_before_online(rig: Rig) -> None:
    assert {topic.removeprefix(f"{BASE}/") for topic in rig.kept} == {
        "online", "bus/state", "bus/statistics",
        *(f"slave/{name}/{part}" for name in ("hoist", "valves") for part in ("online", "state", "statistics")),
        "slave/hoist/drive", "slave/valves/inputs", "slave/valves/outputs",
    }  # fmt: skip
    assert rig.sent[-1] == Publish(f"{BASE}/online", b"true", retain=True, expiry_s=30)
    assert rig.seen("slave/valves/inputs")["level"] == {
        "value": 12.5, "unit": "bar", "quality": "good", "reason": "", "time": "2023-11-14T22:13:19.998Z"
    }  # fmt: skip
    page = PAGE.read_text(encoding="utf-8")
    rows = [line.split("|")[1].strip(" `") for line in page.splitlines() if line.startswith("| `")]
    for topic in rig.kept:
        general = topic.removeprefix(f"{BASE}/").replace("hoist", "SLAVE").replace("valves", "SLAVE")
        assert general in rows, general
    example = page.split("```json\n")[1].split("```")[0]
    assert json.loads(example) == rig.seen("slave/valves/inputs")


def test_a_slave_that_leaves_is_stale_with_the_reason_at_once(rig: Rig) -> None:
    rig.values["8"]["state"] = "offline"
    rig.give_values()
    sent = rig.pump()
    assert (sent[0].topic, sent[0].payload) == (f"{BASE}/slave/valves/online", b"false")
    level = rig.seen("slave/valves/inputs")["level"]
    assert (level["value"], level["quality"]) == (12.5, "stale")
    assert level["reason"] == "the slave is not in data exchange: offline"
    assert rig.seen("slave/valves/state")["state"]["quality"] == "good"
    assert rig.seen("slave/valves/condition/fault")["active"] is True
    rig.values["8"]["state"] = "data_exchange"
    rig.give_values()
    assert rig.pump()[-1].payload != b"false"
    assert rig.seen("slave/valves/online") is True
    assert rig.seen("slave/valves/inputs")["level"]["quality"] == "good"
    rig.wait(1.0)
    assert rig.seen("slave/valves/condition/fault")["active"] is False


def test_a_value_is_null_while_it_is_bad_and_has_one_of_four_words_and_its_reason(rig: Rig) -> None:
    rig.values["8"]["qualities"] = {
        "level": {"quality": "bad", "reason": "channel_fault", "text": "line break: slot 3 (2 AI), input channel 0"},
        "count": {"quality": "uncertain", "reason": "channel_limit", "text": "upper limit value exceeded: slot 2"},
    }
    rig.give_values()
    rig.wait(1.0)
    seen = rig.seen("slave/valves/inputs")
    assert {name: (one["value"], one["quality"], one["reason"]) for name, one in seen.items()} == {
        "level": (None, "bad", "line break: slot 3 (2 AI), input channel 0"),
        "limit": (True, "good", ""),
        "count": (-3, "uncertain", "upper limit value exceeded: slot 2"),
    }
    example = PAGE.read_text(encoding="utf-8").split("```json\n")[2].split("```")[0]
    assert json.loads(example)["level"] == seen["level"] | {"time": json.loads(example)["level"]["time"]}
    condition = rig.seen("slave/valves/condition/diagnosis")
    assert condition["severity"] == "error"
    assert condition["text"].startswith("level: line break: slot 3 (2 AI), input channel 0")
    # the slave leaves: its level is the last one that was not of the broken wire
    rig.values["8"]["fields"]["level"] = 3276.7
    rig.wait(1.0)
    rig.values["8"]["state"] = "offline"
    rig.wait(1.0)
    level = rig.seen("slave/valves/inputs")["level"]
    assert (level["value"], level["quality"]) == (12.5, "stale")
    assert level["reason"] == "the slave is not in data exchange: offline"


def test_uncertain_values_are_stale_behind_the_end(rig: Rig) -> None:
    rig.values["8"]["quality"] = {"quality": "uncertain", "reason": "announced", "text": "diagnosis announced"}
    rig.wait(2.0)
    assert rig.seen("slave/valves/inputs")["level"]["quality"] == "uncertain"
    rig.node.end("the run has ended")
    rig.pump()
    level = rig.seen("slave/valves/inputs")["level"]
    assert (level["value"], level["quality"], level["reason"]) == (12.5, "stale", "the run has ended")


def test_topics_without_news_are_renewed_also_where_the_broker_is_slower_than_the_news() -> None:
    rig = Rig(interval_s=0.0)
    rig.connect()
    topics = set(rig.kept)
    for number in range(200):
        rig.clock += 0.5
        rig.values["3"]["drive"]["speed"] = number % 7 / 10
        rig.values["8"]["fields"]["level"] = 10.0 * (number % 7)
        rig.give_values()
        message = rig.node.next(rig.wall, rig.clock)
        assert isinstance(message, Publish)
        rig.keep(message)
        rig.sent.append(message)
        assert {topic for topic, (_, expires) in rig.kept.items() if expires > rig.clock} == topics
    assert {f"{BASE}/slave/valves/inputs", f"{BASE}/slave/hoist/drive"} < {one.topic for one in rig.sent[-20:]}


def test_values_merge_within_the_interval_and_are_renewed_before_they_expire(rig: Rig) -> None:
    rig.values["8"]["fields"]["count"] = 1
    rig.clock += 0.1
    rig.give_values()
    assert rig.pump() == []
    rig.values["8"]["fields"]["count"] = 2
    rig.wait(1.0)
    assert [one.topic for one in rig.sent].count(f"{BASE}/slave/valves/inputs") == 2
    assert rig.seen("slave/valves/inputs")["count"]["value"] == 2
    before = set(rig.kept)
    rig.wait(60.0)
    assert set(rig.kept) == before


def test_after_sigkill_the_will_stays_and_all_else_is_forgotten(rig: Rig) -> None:
    rig.die()
    assert rig.seen("online") is False
    rig.wait(31.0, stream=False)
    assert rig.kept == {f"{BASE}/online": (b"false", math.inf)}


def test_an_ordered_end_says_so_first_and_leaves_nothing_good(rig: Rig) -> None:
    rig.node.end("the run has ended")
    sent = rig.pump()
    assert sent[0] == Publish(f"{BASE}/online", b"false", retain=True)
    for topic, (payload, _) in rig.kept.items():
        assert b'"good"' not in payload, topic
        assert not topic.endswith("online") or payload == b"false"
    assert rig.seen("slave/valves/inputs")["level"]["reason"] == "the run has ended"


def test_a_bus_that_is_silent_is_not_online(rig: Rig) -> None:
    rig.wait(3.0, stream=False)
    sent = rig.pump()
    assert b"good" not in b"".join(one.payload for one in sent)
    assert rig.seen("online") is rig.seen("slave/hoist/online") is False
    assert rig.seen("bus/condition/dead")["severity"] == "error"


def test_a_slave_that_is_removed_or_renamed_leaves_no_topic(rig: Rig) -> None:
    del rig.plant["slaves"]["3"]
    rig.plant["slaves"]["8"]["name"] = "a/b"
    rig.give_plant()
    rig.pump()
    left = {topic.split("/")[4] for topic in rig.kept if topic.startswith(f"{BASE}/slave/")}
    assert left == {"a_b"}
    assert rig.told == ["'a/b' (slave 8) is called 'a_b': MQTT does not permit this name"]


def test_names_that_two_slaves_swap_stay_right(rig: Rig) -> None:
    slaves = rig.plant["slaves"]
    slaves["3"]["name"], slaves["8"]["name"] = "valves", "hoist"
    rig.give_plant()
    rig.pump()
    assert "level" in rig.seen("slave/hoist/inputs")
    assert f"{BASE}/slave/valves/inputs" not in rig.kept


def test_a_clock_that_was_set_gives_new_times(rig: Rig) -> None:
    rig.node.take([ClockSet(-3600.0)], rig.wall, 0.0)
    rig.pump()
    assert rig.seen("slave/valves/inputs")["level"]["time"] == "2023-11-14T21:13:19.998Z"


@pytest.mark.parametrize(
    ("topic", "payload", "wish"),
    [
        ("valves/set/lamp", {"value": True, "time": "2023-11-14T22:13:20Z"}, ("valves.lamp", True)),
        ("valves/set/speed", {"value": 7, "time": 1_700_000_000.0}, ("valves.speed", 7)),
        ("hoist/set/start", {"time": "2023-11-14T23:13:20+01:00"}, ("hoist.start", None)),
        ("hoist/set/speed", {"value": 0.25, "time": 1_700_000_000}, ("hoist.speed", 0.25)),
    ],
)
def test_an_order_that_is_listed(rig: Rig, topic: str, payload: object, wish: tuple[str, Value]) -> None:
    (found,) = rig.order(topic, payload)
    assert (found.name, found.value, found.made_at) == (*wish, 1_700_000_000.0)
    assert isinstance(payload, dict)
    assert found.order_time == str(payload["time"])  # as it was sent
    rig.node.answer(OrderWish(*wish, 1_700_000_000.0), "done", "", rig.wall)
    made = rig.result()
    assert (made["order"], made["result"], made["order_time"]) == (wish[0], "done", "2023-11-14T22:13:20.000Z")


NOW = '"time": 1700000000'
NO_JSON = 'the payload is no JSON: write for instance {"value": true, "time": "2026-11-23T13:00:00Z"}'


@pytest.mark.parametrize(
    ("octets", "reason"),
    [
        (b"", NO_JSON),
        (b"true", 'the payload is no JSON object: write for instance {"value": true, "time": "2026-11-23T13:00:00Z"}'),
        (b"[" * 2000, "the payload is nested too deeply"),
        (b'{"a":' * 400, NO_JSON),
        (bytes(1_000_000), "the payload has 1000000 octets, at most 2048 are taken"),
        (b'{"value": NaN, %s}' % NOW.encode(), "NaN is no number"),
        (b'{"value": -Infinity, %s}' % NOW.encode(), "-Infinity is no number"),
        (b'{"value": 1e999, %s}' % NOW.encode(), "a number of the payload is too great"),
        (b'{"value": 1, "value": 2, %s}' % NOW.encode(), "a member stands twice in the payload"),
        (b'{"value": {"x": 1}, %s}' % NOW.encode(), "its value is neither a number, a text, true nor false"),
        (b'{"valeu": 1, %s}' % NOW.encode(), "unknown member 'valeu': an order has value and time"),
        (b'{"\\u001b[2J": 1}', "unknown member '\\x1b[2J': an order has value and time"),
        (b'{"value": "\xff"}', "the payload is not UTF-8"),
        (b'{"value": 1}', "it has no time: add the time of now, so that no order is carried out late"),
        (b'{"time": "2023-11-14T22:13:20"}', "its time has no time zone: write Z behind one of UTC"),
        (b'{"time": "now"}', "its time is none of ISO 8601, for instance 2026-11-23T13:00:00Z"),
        (b'{"time": 1700000000000}', "its time is too great: a number counts seconds since 1970, not milliseconds"),
        (b'{"time": true}', "its time is neither a text nor a number"),
        (b'{"time": -1}', "its time is before 1970"),
    ],
)  # fmt: skip
def test_an_order_that_cannot_be_is_refused_with_its_reason(rig: Rig, octets: bytes, reason: str) -> None:
    assert rig.order("valves/set/lamp", octets) == []
    made = rig.result()
    assert (made["order"], made["result"], made["reason"]) == ("valves.lamp", "refused", reason)
    ((order, why, _),) = rig.refused
    assert (order, why) == ("valves.lamp", reason)


def test_what_is_kept_or_not_listed_is_refused(rig: Rig) -> None:
    right = {"value": True, "time": 1_700_000_000}
    assert rig.order("valves/set/lamp", right, retained=True) == []
    assert rig.result()["reason"] == "the broker had kept this order: nobody knows how old it is"
    for topic in ("hoist/set/stop", "valves/set/level", "pump/set/lamp"):
        assert rig.order(topic, right) == []
        assert rig.result()["reason"] == "there is no such order, or allow_commands does not list it"
    assert rig.order("valves/set/lamp/more", right) == rig.order("valves/get/lamp", right) == []


def test_the_time_of_a_refused_order_is_shown_as_it_was_sent(rig: Rig) -> None:
    times = ["2023-11-14T23:13:20+01:00", 1_700_000_000.5, "now", True, None]
    shown = []
    for sent in times:
        rig.order("valves/set/level", {"value": True, "time": sent})
        shown.append(rig.result()["order_time"])
    assert [given for _, _, given in rig.refused] == ["2023-11-14T23:13:20+01:00", "1700000000.5", "now", "true", ""]
    assert shown == ["2023-11-14T22:13:20.000Z", "2023-11-14T22:13:20.500Z", None, None, None]


def test_a_flood_of_orders_is_bounded_and_values_do_not_wait_for_it(rig: Rig) -> None:
    rig.clock += 1.0
    rig.values["8"]["state"] = "offline"
    rig.give_values()
    for _ in range(1000):
        rig.order("valves/set/lamp", b"x")
    assert rig.node.lost_results == 1000 - 256
    assert "results of orders came faster" in rig.told[-1]
    first = [one.topic for one in rig.pump()[:2]]
    assert f"{BASE}/slave/valves/online" in first


@examples(100)
@given(
    st.binary(max_size=80) | st.text(max_size=60).map(lambda text: json.dumps({"value": text, "time": text}).encode())
)
def test_garbage_is_no_order(octets: bytes) -> None:
    refused: Callable[[bytes], object] = read_order
    with pytest.raises(ValueError, match=r".") as caught:
        refused(octets)
    assert str(caught.value).isprintable()


async def test_outputs_of_one_command_change_together(tmp_path: Path) -> None:
    carried: list[SetOutputs | DriveOrder] = []
    tree = PlantTree()

    async def carry_out(order: SetOutputs | DriveOrder) -> None:
        carried.append(order)

    async with FakeBroker() as broker:
        orders = Orders(tree, carry_out, ["valves.*"])
        connector = connector_at(tmp_path / "state", broker=Broker(url=broker.url), tree=tree, orders=orders)
        async with serving(connector, tree, s3=HOIST, s8=VALVES):
            await published(broker, f"spBv1.0/{GROUP}/DBIRTH/{NODE}/valves")
            metrics = [pb.Metric(name="Outputs/lamp", boolean_value=True), pb.Metric(name="Outputs/speed", int_value=7)]
            command = pb.Payload(timestamp=round(time.time() * 1000), metrics=metrics)
            broker.send(publish(f"spBv1.0/{GROUP}/DCMD/{NODE}/valves", command.SerializeToString()))
            await until(lambda: carried)
    assert carried == [SetOutputs(8, {"lamp": True, "speed": 7})]


async def test_an_order_to_a_gateway_that_takes_none_is_reported(tmp_path: Path) -> None:
    tree, refused = PlantTree(), list[RefusedOrder]()

    async def carry_out(order: SetOutputs | DriveOrder) -> None:
        raise AssertionError(order)

    async with FakeBroker() as broker:
        orders = Orders(tree, carry_out, [], refused=refused.append, origin="mqtt")
        connector = connector_at(tmp_path / "state", broker=Broker(url=broker.url), tree=tree, orders=orders)
        async with serving(connector, tree, s3=HOIST, s8=VALVES):
            await published(broker, f"spBv1.0/{GROUP}/DBIRTH/{NODE}/valves")
            command = pb.Payload(
                timestamp=1_700_000_000_000, metrics=[pb.Metric(name="Outputs/lamp", boolean_value=True)]
            )
            broker.send(publish(f"spBv1.0/{GROUP}/DCMD/{NODE}/valves", command.SerializeToString()))
            await until(lambda: refused)
    assert refused == [
        RefusedOrder("valves: 'Outputs/lamp'", "this metric cannot be written", "mqtt", "2023-11-14T22:13:20.000Z")
    ]


async def test_messages_that_came_too_fast_are_counted_and_told_while_the_connection_stands(tmp_path: Path) -> None:
    told: list[str] = []
    connector = connector_at(tmp_path, told)
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
        connector = connector_at(tmp_path, told, broker=Broker(url=broker.url), again_s=0.001)
        place = f"broker 127.0.0.1:{broker.port}"
        cause = f"another gateway uses this node's name (group {GROUP!r}, node {NODE!r}); give one of them another node"
        async with serving(connector):
            while f"{place} closes the connection again and again: probably {cause}" not in told:
                if connector.connected:
                    broker.cut()
                await asyncio.sleep(0.002)  # the broker tells nobody of its clients
        assert sum("it is tried again" in text for text in told) == 3
