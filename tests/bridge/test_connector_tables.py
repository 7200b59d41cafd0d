"""The tables of connectors in a configuration, and the connectors that are made from them; names of slaves and
values for Sparkplug, OPC UA and Prometheus."""

from __future__ import annotations

from pathlib import Path

import pytest
from api_kit import RAW, in_virtual_time
from hypothesis import given
from hypothesis import strategies as st
from plant_files import plant_text

import dpstack
from dpstack.api.config.config import load_config, parse_config
from dpstack.api.config.connectors import EpicsConfig, MqttConfig
from dpstack.bridge.names import (
    EPICS_PART,
    OPCUA_BROWSE,
    PROMETHEUS_LABEL,
    SPARKPLUG_ID,
    SPARKPLUG_METRIC,
    NameRule,
    unique_names,
)
from dpstack.errors import ConfigError

VALVES: dict[str, object] = {**RAW, "name": "valves", "address": 8, "config": "21 11", "outputs": {"lamp": "bool@0.1"}}
PLANT = plant_text(VALVES, tables={"mqtt": {}}).rstrip() + "\n"
LEAST = 'url = "mqtt://127.0.0.1:1"\ngroup = "plant"\n'


def test_a_table_with_all_keys(tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_text(
        PLANT + 'url = "mqtts://broker:8883"\ngroup = "plant"\nnode = "line 1"\nprimary_host = "scada"\n'
        'allow_commands = ["valves.*"]\ncommand_max_age_s = 0.5\ninterval_ms = 200\nca = "ca.pem"\n'
        'cert = "/etc/c.pem"\nkey = "keys/k.pem"\nuser = "line1"\npassword_file = "secret"\nkeepalive_s = 5\n',
        encoding="utf-8",
    )
    assert load_config(file).connectors == {
        "mqtt": MqttConfig(
            url="mqtts://broker:8883",
            group="plant",
            node="line 1",
            primary_host="scada",
            allow_commands=("valves.*",),
            command_max_age_s=0.5,
            interval_ms=200,
            ca=f"{tmp_path}/ca.pem",
            cert="/etc/c.pem",
            key=f"{tmp_path}/keys/k.pem",
            user="line1",
            password_file=f"{tmp_path}/secret",
            keepalive_s=5,
        )
    }


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ('group = "plant"', "plant:12: [mqtt]: no url; add the key url"),
        (LEAST + "[epics]", "plant:15: [epics]: no prefix; add the key prefix"),
        (LEAST + '[epics]\nprefix = "P:"\nlisten = "here"', "plant:17: [epics]: listen 'here' is not HOST:PORT"),
        (LEAST + 'nod = "x"', "plant:15: [mqtt]: unknown key 'nod'; did you mean 'node'?"),
        (LEAST + 'password = "abc"', "plant:15: [mqtt]: unknown key 'password'; did you mean 'password_env'?"),
        (LEAST + 'discovery = "hass"', "plant:15: [mqtt]: unknown discovery 'hass'; it must be"),
        (LEAST + "interval_ms = 1", "plant:15: [mqtt]: interval_ms = 1 is outside 10..3600000"),
        (
            LEAST + 'allow_commands = "valves.lamp"',
            "plant:15: [mqtt]: allow_commands = 'valves.lamp' is no list of texts",
        ),
        (
            LEAST + "allow_commands = [1]",
            "plant:15: [mqtt]: allow_commands = [1] is no list of texts; write for instance",
        ),
    ],
)
def test_errors_of_reading_name_the_line(text: str, error: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(PLANT + text, "plant")
    assert str(caught.value).startswith(error)
    assert "abc" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (
            'url = "http://x"\ngroup = "plant"',
            "plant:13: [mqtt]: url 'http://x' is no address of a broker; write mqtt://",
        ),
        ('url = "mqtt://anna:abc@x"\ngroup = "p"', "plant:13: [mqtt]: url: user and password have keys of their own"),
        (
            'url = "mqtt://x"\ngroup = "a/b"',
            "plant:14: [mqtt]: group 'a/b': MQTT does not permit this name",
        ),
        (
            LEAST + 'format = "json"\nprimary_host = "scada"',
            "plant:16: [mqtt]: primary_host: plain JSON knows none; take it out, or write format",
        ),
        (
            LEAST + 'format = "json"\ndatatypes = "always"',
            'plant:16: [mqtt]: datatypes: plain JSON has none; take it out, or write format = "sparkplug"',
        ),
        (
            LEAST + 'discovery = "homeassistant"',
            'plant:15: [mqtt]: discovery = "homeassistant": Home Assistant does not read Sparkplug; write format',
        ),
        (
            LEAST + 'format = "json"\ndiscovery = "homeassistant"\ndiscovery_prefix = "a/#"',
            "plant:17: [mqtt]: discovery_prefix 'a/#': MQTT does not permit this topic; take 'a/_'",
        ),
        (LEAST + 'cert = "c.pem"', "plant:12: [mqtt]: ca, cert and key need TLS; write mqtts:// in url"),
        (LEAST.replace("mqtt:", "mqtts:") + 'cert = "c"', "plant:15: [mqtt]: cert and key go together; give both"),
        (
            LEAST.replace("mqtt:", "mqtts:") + 'ca = "none.pem"',
            "plant:15: [mqtt]: ca none.pem: No such file or directory",
        ),
        (LEAST + '[opcua]\ncert = "c.der"', "plant:16: [opcua]: cert and key go together; give both, or neither"),
        (LEAST + "[opcua]", "plant:15: [opcua]: users_file: nobody may connect; give users_file, or anonymous"),
        (LEAST + '[opcua]\nusers_file = "none"', "plant:16: [opcua]: users_file none: there is no such file"),
        (LEAST + 'user = "anna"\npassword_env = "NO_SUCH"', "plant:16: [mqtt]: password_env: the environment has no"),
        (
            LEAST + '[epics]\nprefix = "LAB DP:"',
            "plant:16: [epics]: prefix 'LAB DP:' cannot begin an EPICS name;",
        ),
        (
            LEAST + f'[epics]\nprefix = "{"P" * 38}:"',
            f"plant:15: [epics]: {'P' * 38}:bus:stat:rotation_us:p50 has 63 characters, and an EPICS name at",
        ),
        (
            LEAST + '[epics]\nprefix = "P:"\nbeacons = ["lab"]',
            "plant:17: [epics]: beacons: 'lab' is not an address; write",
        ),
        (
            LEAST + '[epics]\nprefix = "P:"\nallow_commands = ["valves.lmap"]',
            "plant:17: [epics]: allow_commands: 'valves.lmap' fits no order",
        ),
        (LEAST + 'allow_commands = ["valves.lmap"]', "plant:15: [mqtt]: allow_commands: 'valves.lmap' fits no order"),
    ],
)
def test_errors_of_values_name_the_line_too(text: str, error: str) -> None:
    @in_virtual_time
    async def run() -> None:
        bus = dpstack.open_bus(parse_config(PLANT + text, "plant"))
        with pytest.raises(ConfigError) as caught:
            async with dpstack.publish(bus), bus:
                raise AssertionError("it must not begin")
        assert str(caught.value).startswith(error)
        assert "abc" not in str(caught.value)

    run()


RULES = [OPCUA_BROWSE, EPICS_PART, PROMETHEUS_LABEL, SPARKPLUG_ID, SPARKPLUG_METRIC]
_texts = st.one_of(st.sampled_from(["Pump", "pump", "pump 2", "a/b", "a+b", "a_b", "", " "]), st.text(max_size=8))
_given = st.dictionaries(st.sampled_from([str(address) for address in range(12)]), _texts)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.connector)
@given(given_names=_given)
def test_names_are_valid_different_and_independent_of_the_order(rule: NameRule, given_names: dict[str, str]) -> None:
    found = unique_names(rule, given_names.items())
    assert found == unique_names(rule, reversed(given_names.items()))
    names = list(found.names.values())
    assert found.names.keys() == given_names.keys()
    assert len({name.lower() for name in names} if rule.fold else set(names)) == len(names)
    for key, name in found.names.items():
        assert name == name.strip() != ""
        assert not set(name) & set(rule.reserved)
        assert not rule.only or set(name) <= set(rule.only)
        assert len(name.encode()) <= rule.most
        assert "\0" not in name
        # the line has the key, by which a reader finds the slave
        assert name == given_names[key] or any(repr(name) in line and f"({key})" in line for line in found.changed)


def test_rules_one_by_one() -> None:
    assert SPARKPLUG_ID.valid("pump/1 #2+\x00\ud800") == "pump_1 _2___"
    assert SPARKPLUG_ID.valid("Förderband") == "Förderband"
    assert SPARKPLUG_ID.valid("e\u0301") == "\u00e9"
    assert SPARKPLUG_ID.valid("\u202e") == SPARKPLUG_ID.valid("") == "_"
    assert OPCUA_BROWSE.valid("1:level.raw") == "1_level_raw"
    assert EPICS_PART.valid("Förder band:1.2") == "F_rder_band_1_2"
    assert len(SPARKPLUG_METRIC.valid("ä" * 500).encode()) == SPARKPLUG_METRIC.most


def test_the_lower_key_keeps_the_name() -> None:
    found = unique_names(SPARKPLUG_ID, [("10", "pump"), ("9", "Pump"), ("11", "pump 10")])
    assert found.names == {"9": "Pump", "10": "pump 10", "11": "pump 10 11"}
    assert found.changed == (
        "'pump' (10) is called 'pump 10': another one has this name",
        "'pump 10' (11) is called 'pump 10 11': another one has this name",
    )


def test_epics_is_for_this_computer_without_listen() -> None:
    epics = parse_config(PLANT + LEAST + '[epics]\nprefix = "P:"\n', "plant").connectors["epics"]
    assert isinstance(epics, EpicsConfig)
    assert (epics.listen, epics.beacons, epics.allow_commands) == ("127.0.0.1:5064", (), ())
