"""The tables of connectors in a configuration, and the connectors that are made from them."""

from __future__ import annotations

from pathlib import Path

import pytest
from api_kit import in_virtual_time

import dpstack
from dpstack.api.config.config import load_config, parse_config
from dpstack.api.config.connectors import MqttConfig
from dpstack.errors import ConfigError

PLANT = """[bus]
port = "virtual"
baud = 500000

[[slave]]
name = "valves"
address = 8
ident = 0x1234
config = "21 11"
outputs = { lamp = "bool@0.1" }

[mqtt]
"""
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
        (LEAST + 'nod = "x"', "plant:15: [mqtt]: unknown key 'nod'; did you mean 'node'?"),
        (LEAST + 'password = "abc"', "plant:15: [mqtt]: unknown key 'password'; did you mean 'password_env'?"),
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
