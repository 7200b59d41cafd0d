"""Discovery messages for Home Assistant: their content, when they are sent and taken away, and hostile names in them.

What Home Assistant itself makes of them stands in tests/strangers/test_home_assistant_itself.py.
"""

from __future__ import annotations

import ast
import json
import re
from typing import Any

import pytest
from edge_node_rig import GROUP, NODE
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.bridge.homeassistant import discovery, words
from dpstack.bridge.homeassistant.discovery import topic_level
from dpstack.bridge.mqtt.plant_node import NodeSetup
from dpstack.errors import ConfigError
from tests.bridge_mqtt.json_rig import BASE, Rig

#: "plant 1" and "segment 4" in the letters that Home Assistant permits
NODE_LEVEL = "dpstack__plant_201__segment_204"


def rig_with(*allowed: str) -> Rig:
    made = Rig(discovery_prefix="homeassistant", allowed=allowed)
    made.connect()
    made.wait(2.0)
    return made


def configs(rig: Rig) -> dict[str, dict[str, Any]]:
    """What the broker keeps, by component and object id."""
    found = {}
    for topic, (payload, expires) in rig.kept.items():
        if topic.startswith("homeassistant/"):
            prefix, component, node, object_id, last = topic.split("/")
            assert (prefix, node, last, expires) == ("homeassistant", NODE_LEVEL, "config", float("inf"))
            found[f"{component}/{object_id}"] = json.loads(payload)
    return found


def test_a_value_has_unit_class_and_the_availability_of_its_quality() -> None:
    found = configs(rig_with())
    level = found["sensor/slave__8__input__level"]
    name = r"{% set v = (value_json | default({})).get('level') | default({}, true) %}"
    version = level["origin"].pop("sw_version")
    assert version
    assert level == {
        "name": "level",
        "unique_id": f"{BASE}/slave/8/input/level",
        "state_topic": f"{BASE}/slave/valves/inputs",
        "value_template": name + "{{ v.get('value') }}",
        "unit_of_measurement": "bar",
        "device_class": "pressure",
        "state_class": "measurement",
        "suggested_display_precision": 1,
        "expire_after": 30,
        "availability": [
            {"topic": f"{BASE}/online", "payload_available": "true", "payload_not_available": "false"},
            {
                "topic": f"{BASE}/slave/valves/inputs",
                "value_template": name + "{{ 'true' if v.get('quality') in ['good', 'uncertain'] else 'false' }}",
                "payload_available": "true",
                "payload_not_available": "false",
            },
        ],
        "availability_mode": "all",
        "json_attributes_topic": f"{BASE}/slave/valves/inputs",
        "json_attributes_template": name + "{{ {'quality': v.get('quality'), 'reason': v.get('reason')} | tojson }}",
        "device": {"identifiers": [f"{BASE}/slave/8"], "name": "valves", "via_device": BASE},
        "origin": {"name": "dpstack"},
    }
    # without a unit: a number all the same
    assert found["sensor/slave__8__input__count"]["state_class"] == "measurement"
    assert "unit_of_measurement" not in found["sensor/slave__8__input__count"]
    assert found["binary_sensor/slave__8__online"]["device_class"] == "connectivity"
    assert "suggested_display_precision" not in found["sensor/slave__8__input__count"]
    assert found["sensor/slave__3__drive__speed"]["unit_of_measurement"] == "%"
    assert found["sensor/slave__3__drive__frequency_5fhz"]["suggested_display_precision"] == 2
    assert not any("statistics" in one["state_topic"] for one in found.values())


def test_a_number_of_four_octets_has_seven_digits() -> None:
    rig = Rig(discovery_prefix="homeassistant")
    rig.plant["slaves"]["8"]["inputs"].append({"name": "flow", "type": "f32", "at": "f32@8"})
    rig.give_plant()
    rig.connect()
    rig.wait(2.0)
    template = configs(rig)["sensor/slave__8__input__flow"]["value_template"]
    assert "'%.7g' | format(v.value)" in template


def test_without_allow_commands_nothing_can_be_ordered() -> None:
    found = configs(rig_with())
    assert {one.partition("/")[0] for one in found} == {"sensor", "binary_sensor"}
    assert not any("command_topic" in one for one in found.values())
    assert "binary_sensor/slave__8__output__lamp" in found


def test_orders_that_are_listed_have_the_time_and_are_not_retained() -> None:
    found = configs(rig_with("valves.lamp", "hoist.start", "hoist.stop", "hoist.speed"))
    ordered = {name: one for name, one in found.items() if "command_topic" in one}
    time = '"time": {{ now().timestamp() }}'
    assert {name: (one["command_topic"], one["command_template"]) for name, one in ordered.items()} == {
        "switch/slave__8__output__lamp": (f"{BASE}/slave/valves/set/lamp", '{"value": {{ value }}, ' + time + "}"),
        "button/slave__3__order__start": (f"{BASE}/slave/hoist/set/start", "{" + time + "}"),
        "button/slave__3__order__stop": (f"{BASE}/slave/hoist/set/stop", "{" + time + "}"),
        "number/slave__3__drive__setpoint": (
            f"{BASE}/slave/hoist/set/speed",
            '{"value": {{ value / 100 }}, ' + time + "}",
        ),
    }
    assert {one["retain"] for one in ordered.values()} == {False}
    lamp, setpoint = ordered["switch/slave__8__output__lamp"], ordered["number/slave__3__drive__setpoint"]
    assert (lamp["payload_on"], lamp["payload_off"], lamp["optimistic"]) == ("true", "false", False)
    assert (setpoint["min"], setpoint["max"], setpoint["unit_of_measurement"]) == (-1000, 1000, "%")
    # a drive that is away can be stopped, not started
    topics = {
        name: [one["topic"] for one in ordered[f"button/slave__3__order__{name}"]["availability"]]
        for name in ("start", "stop")
    }
    assert topics == {"start": [f"{BASE}/online", f"{BASE}/slave/hoist/online"], "stop": [f"{BASE}/online"]}
    assert found["sensor/bus__result"]["state_topic"] == f"{BASE}/result"
    assert "number/slave__8__output__speed" not in found


@pytest.mark.parametrize(
    ("type_", "scale", "ends"),
    [("u8", 1, (0, 255, 1)), ("i16", 0.5, (-16384.0, 16383.5, 0.5)), ("f32", 1, (-3.4028234e38, 3.4028234e38, 0.001))],
)
def test_limits_and_steps_of_a_number(type_: str, scale: float, ends: tuple[float, ...]) -> None:
    rig = Rig(discovery_prefix="homeassistant", allowed=("valves.speed",))
    rig.plant["slaves"]["8"]["outputs"][1] |= {"type": type_, "scale": scale}
    rig.give_plant()
    rig.connect()
    rig.wait(2.0)
    speed = configs(rig)["number/slave__8__output__speed"]
    assert (speed["min"], speed["max"], speed["step"]) == ends


def test_messages_of_earlier_runs_are_taken_away_and_no_others() -> None:
    rig = Rig(discovery_prefix="homeassistant", allowed=("hoist.start",))
    own, other = f"homeassistant/switch/{NODE_LEVEL}", "homeassistant/sensor/zigbee/lamp/config"
    for topic in (f"{own}/slave__9__output__flap/config", f"{own}/slave__8__output__lamp/config", other):
        rig.kept[topic] = b"{}", float("inf")
    before = dict(rig.kept)
    rig.connect()
    # it waits until the broker has sent what it has
    assert {topic: one for topic, one in rig.kept.items() if topic.startswith("homeassistant")} == before
    rig.wait(2.0)
    assert rig.left == [f"homeassistant/+/{NODE_LEVEL}/+/config"]
    assert rig.kept.pop(other) == (b"{}", float("inf"))
    # the lamp is no switch any more
    assert "binary_sensor/slave__8__output__lamp" in configs(rig)
    assert [name for name in configs(rig) if name.startswith("switch")] == []


def test_a_slave_that_leaves_the_running_configuration_takes_its_entities_along() -> None:
    rig = rig_with("hoist.start")
    assert any("slave__3" in name for name in configs(rig))
    del rig.plant["slaves"]["3"]
    rig.give_plant()
    rig.pump()
    names = list(configs(rig))
    assert not any("slave__3" in name for name in names)
    assert "sensor/slave__8__input__level" in names
    # a new name: the same entity, its history stays
    rig.plant["slaves"]["8"]["name"] = "gate"
    rig.give_plant()
    rig.pump()
    assert list(configs(rig)) == names
    level = configs(rig)["sensor/slave__8__input__level"]
    assert (level["unique_id"], level["device"]["name"]) == (f"{BASE}/slave/8/input/level", "gate")
    assert level["state_topic"] == f"{BASE}/slave/gate/inputs"


def test_home_assistant_that_begins_gets_all_messages_again_at_most_every_10_s() -> None:
    rig = rig_with()

    def begin(*, retained: bool = False) -> int:
        before = len(rig.sent)
        rig.node.receive("homeassistant/status", b"online", rig.wall, retained=retained)
        rig.pump()
        return sum(one.topic.startswith("homeassistant/") for one in rig.sent[before:])

    rig.wait(10.0)
    count = len(configs(rig))
    assert begin() == count
    assert begin() == 0
    rig.wait(10.0)
    assert [one.topic.startswith("homeassistant/") for one in rig.sent].count(True) == 3 * count
    assert begin(retained=True) == 0
    rig.node.receive("homeassistant/status", b"offline", rig.wall)
    rig.wait(20.0)
    assert [one.topic.startswith("homeassistant/") for one in rig.sent].count(True) == 3 * count


def test_a_new_session_sends_all_messages_again() -> None:
    rig = rig_with()
    rig.die()
    wanted = configs(rig)
    rig.kept.clear()  # a broker without a disk
    rig.connect()
    rig.wait(2.0)
    assert configs(rig) == wanted


def test_the_end_leaves_the_messages() -> None:
    rig = rig_with()
    wanted = configs(rig)
    rig.node.end("the run has ended")
    rig.pump()
    assert configs(rig) == wanted


def test_more_entities_than_there_is_room_for_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discovery, "MOST_ENTITIES", 5)
    rig = rig_with()
    assert len(configs(rig)) == 5
    (told,) = rig.told
    assert re.fullmatch(r"Home Assistant gets 5 entities at most: \d+ values have none", told)


def test_a_value_and_a_drive_with_the_names_of_other_entities_are_distinguished() -> None:
    rig = Rig(discovery_prefix="homeassistant")
    rig.plant["slaves"]["8"]["inputs"].append({"name": "state", "type": "bool", "at": "bool@2.1"})
    rig.give_plant()
    rig.connect()
    rig.wait(2.0)
    found = configs(rig)
    assert found["binary_sensor/slave__8__input__state"]["name"] == "state (inputs)"
    assert found["sensor/slave__8__state"]["name"] == "State"
    assert found["sensor/slave__3__state"]["name"] == "State"
    assert found["sensor/slave__3__drive__state"]["name"] == "State (drive)"


HOSTILE = st.text(max_size=30) | st.text("'\"\\{}%#+/ ", max_size=30)


@examples(60)
@given(HOSTILE)
def test_no_name_ends_the_literal_in_a_template(name: str) -> None:
    made = words.literal(name)
    assert re.fullmatch(r"'(?:[A-Za-z0-9 _-]|\\u[0-9a-f]{4}|\\U[0-9a-f]{8})*'", made)
    assert ast.literal_eval(made) == name  # Jinja has the same escapes


@examples(60)
@given(HOSTILE.filter(lambda text: text.isprintable()))
def test_levels_of_topics_are_those_of_home_assistant_and_can_be_read_back(name: str) -> None:
    made = topic_level(name)
    assert re.fullmatch(r"[a-zA-Z0-9_-]*", made)
    octets = re.sub(r"__|_([0-9a-f]{2})", lambda m: "/" if m[1] is None else chr(int(m[1], 16)), made)
    assert octets.encode("latin-1").decode() == name


@pytest.mark.parametrize(
    ("prefix", "valid"), [("home/#", "home/_"), ("a//b", "a/_/b"), (" home", "home"), ("x\n", "x")]
)
def test_a_prefix_that_mqtt_does_not_permit_is_refused_with_one_that_it_does(prefix: str, valid: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"take {valid!r}")):
        NodeSetup(GROUP, NODE, discovery_prefix=prefix)
    assert NodeSetup(GROUP, NODE, discovery_prefix="house/assistant").discovery_prefix == "house/assistant"
