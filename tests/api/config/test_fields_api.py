"""Named inputs and outputs: from the configuration to a program, to ``run --json`` and to ``ctl``."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest
from api_kit import HOIST, RAW, bus_of, in_virtual_time, operating
from control_kit import octet_client
from msgspec import convert

import dpstack
from dpstack.api.config.config import parse_config, slave_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.handlers import control_run
from dpstack.dp.process_data import Field
from dpstack.errors import ConfigError
from dpstack.plant.items import FieldPlant
from dpstack.plant.status_octet import read_octets

VALVES: dict[str, object] = {
    **RAW,
    "name": "valves",
    "address": 8,
    "config": "23 13",
    "inputs": {"limit": "bool@0.3", "status": "u8@0", "level": "i16@2", "level_raw": "bytes@2:2"},
    "outputs": {"open": "bool@0.3", "close": "bool@0.4", "target": "i16@2"},
}

BUS = """[bus]
port = "/dev/ttyX"
baud = 500000

[[slave]]
name = "raw"
address = 9
ident = 0x1234
config = "23 13"
"""


def test_a_configuration() -> None:
    slave = parse_config(BUS + 'inputs = { limit = "bool@0.3", level = "i16@2" }\n', "plant.toml").slaves[0]
    assert slave.input_fields.fields == {
        "limit": Field("limit", "bool", 0, 1, 3),
        "level": Field("level", "i16", 2, 2),
    }
    assert not slave.output_fields
    slave = parse_config(BUS + '[slave.outputs]\n"my valve" = "bool@3.7"\n', "plant.toml").slaves[0]
    assert list(slave.output_fields) == ["my valve"]


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ('inputs = "i16@2"', "inputs = 'i16@2' is a text; it must be a table, for"),
        ("inputs = { level = 2 }", "inputs: level = 2 is an integer; it must be"),
        ('inputs = { level = "int16@2" }', "inputs: level: unknown type 'int16'; did you mean 'i16'?"),
        (
            '[slave.inputs]\na = "u8@0"\nlevel = "i16@3"',
            'inputs: level = "i16@3" ends in octet 4; its configuration has octets 0..3',
        ),
        (
            'outputs = { a = "i16@2", b = "i8@3" }',
            "b (i8@3) and a (i16@2) share bits; move one of them; only a word and some of its bits may share them",
        ),
        (
            'inputs = { a = "u8@0" }\noutputs = { a = "u8@0" }',
            "'a' is an input and an output; give one of them another name",
        ),
        ('inputs = { "a.b" = "u8@0" }', "inputs: 'a.b' is no name for a field; use"),
        (
            'inputs = { level = { at = "i16@2", scael = 0.1 } }',
            "inputs: level: unknown key 'scael'; did you mean 'scale'?",
        ),
        (
            '[slave.inputs.level]\nat = "i16@2"\nscale = "0.1"',
            "inputs: level: scale = '0.1' is a text; it must be a number",
        ),
        ("inputs = { level = { scale = 0.1 } }", "inputs: level: no at; add type"),
        (
            '[slave.inputs.level]\nscale = 2\nat = "i16@3"',
            'inputs: level = "i16@3" ends in octet 4; its configuration has octets 0..3',
        ),
        (
            'inputs = { level = { at = "bool@0.0", unit = "bar" } }',
            "inputs: level: bool has no unit; only numbers have one: leave it out",
        ),
        (
            f'inputs = {{ level = {{ at = "i16@2", unit = "{"x" * 21}" }} }}',
            "inputs: level: unit has 21 characters; at most 20 fit into a table",
        ),
        (
            'inputs = { level = { at = "i16@2", unit = "[bar]" } }',
            "inputs: level: unit = '[bar]' has a bracket; leave it out",
        ),
        ('inputs = { a = "" }', "inputs: a is empty; give it a value or leave it out"),
        ("inputs = { a = [] }", "inputs: a is an empty list; give it places"),
        ('inputs = { a = ["bool@0.0", 3] }', "inputs: a_1 = 3 is an integer; it must be a text in quotes"),
        ('inputs = { a = ["bool@0.0", ["bool@0.1"]] }', "inputs: a_1 = ['bool@0.1'] is a list; it must be a text"),
        ('inputs = { a = ["bool@0.0", "u8@9"] }', 'inputs: a_1 = "u8@9" ends in octet 9'),
        (
            'inputs = { a = ["bool@0.0"], a_0 = "u8@1" }',
            "inputs: 'a_0' is also a place of the list a; give it another name",
        ),
        (
            'outputs = { a = ["i16@0", "i16@1"] }',
            "a_1 (i16@1) and a_0 (i16@0) share bits; move",
        ),
        (
            'inputs = { a = ["u8@0"] }\noutputs = { a_0 = "u8@0" }',
            "'a_0' is an input and an output; give one of them another name",
        ),
    ],
)
def test_refused_fields(keys: str, says: str) -> None:
    line = 10 + keys.count("\n")  # the last one of ``keys``
    with pytest.raises(ConfigError) as caught:
        parse_config(f"{BUS}{keys}\n", "plant.toml")
    assert str(caught.value).startswith(f"plant.toml:{line}: [[slave]] raw: {says}")


def test_a_list_of_places_gives_names_with_numbers() -> None:
    keys = """
[slave.inputs]
door = [
  "bool@0.0", "bool@0.1",  # one line an octet
  { at = "i16@2", scale = 0.1, unit = "bar" },
]
level = "slot 2 u8@1"
"""
    inputs = parse_config(BUS + keys, "plant.toml").slaves[0].input_fields
    assert [(name, field.spec) for name, field in inputs.fields.items()] == [
        ("door_0", "bool@0.0"),
        ("door_1", "bool@0.1"),
        ("door_2", "i16@2"),
        ("level", "u8@1"),
    ]
    assert inputs.values(bytes.fromhex("02 07 00 20")) == {"door_0": False, "door_1": True, "door_2": 3.2, "level": 7}
    with pytest.raises(ConfigError, match=r"^plant\.toml:12: .*: door_1 = \"u8@9\" ends in octet 9"):
        parse_config(BUS + keys.replace('"bool@0.1"', '"u8@9"'), "plant.toml")


@in_virtual_time
async def test_names_in_a_program() -> None:
    async with operating(VALVES) as bus:
        valves = bus.slave("valves")
        valves.outputs = b"\x81\x55\x00\x00"
        valves["open"] = True
        assert valves.outputs == b"\x89\x55\x00\x00"  # its own bit only
        valves.update({"open": False, "close": 1, "target": -2})
        assert valves.outputs == b"\x91\x55\xff\xfe"
        assert valves.output_values == {"open": False, "close": True, "target": -2}
        await asyncio.sleep(0.05)
        assert (valves["status"], valves["level"], valves["limit"]) == (0x91, -2, False)
        assert valves.input_values == {"limit": False, "status": 0x91, "level": -2, "level_raw": b"\xff\xfe"}
        assert valves["target"] == -2
        assert "level" in valves
        assert "Level" not in valves
        assert list(valves) == ["limit", "status", "level", "level_raw", "open", "close", "target"]


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"close": True, "target": 40000}, r"slave 8 \(valves\): target = 40000 is outside -32768..32767 \(i16\)"),
        ({"close": True, "traget": 1}, r"slave 8 \(valves\): no output is called 'traget'; did you mean target\?"),
        ({"close": True, "xyz": 1}, "no output is called 'xyz'; there are: open, close, target"),
        ({"close": True, "level": 1}, "level is an input: only outputs can be set"),
        ({"open": "yes"}, "open is a bit: 'yes' is neither true nor false"),
    ],
)
@in_virtual_time
async def test_an_update_changes_all_outputs_or_none(values: dict[str, object], text: str) -> None:
    async with bus_of(VALVES) as bus:
        valves = bus.slave("valves")
        with pytest.raises(dpstack.UsageError, match=text):
            valves.update(values)
        assert valves.outputs == bytes(4)
        with pytest.raises(dpstack.UsageError, match=r"no field is called 'lvel'; did you mean level\?"):
            _ = valves["lvel"]


SCALED: dict[str, object] = {
    **VALVES,
    "inputs": {"level": {"at": "i16@2", "scale": 0.1, "unit": "bar"}},
    "outputs": {"target": {"at": "i16@2", "scale": 0.1, "unit": "bar"}},
}


@in_virtual_time
async def test_scaled_values_in_a_program() -> None:
    async with operating(SCALED) as bus:
        valves = bus.slave("valves")
        valves["target"] = 12.34
        assert valves.outputs == bytes.fromhex("0000 007b")  # 123, the nearest to 123.4
        await asyncio.sleep(0.05)
        assert (valves["level"], valves["target"]) == (12.3, 12.3)
        assert valves.input_values == {"level": 12.3}
        async for cycle in bus.cycles():
            assert cycle["valves"] == {"level": 12.3}
            break
        stats = bus.stats.slaves[8].as_dict()
        assert (stats["fields"], stats["units"]) == ({"level": 12.3, "target": 12.3}, {"level": "bar", "target": "bar"})
        with pytest.raises(dpstack.UsageError, match=r"target = 4000 is outside -3276\.8\.\.3276\.7 bar \(i16, scale"):
            valves["target"] = 4000
        assert valves["target"] == 12.3


@in_virtual_time
async def test_slaves_without_names_and_slaves_with_a_plugin() -> None:
    hoist = {**HOIST, "outputs": {"command": "u16@8"}}
    with pytest.raises(dpstack.ConfigError, match="outputs beside drive: its plugin makes the outputs; leave outputs"):
        bus_of(RAW, hoist)
    async with bus_of(RAW, HOIST) as bus:
        with pytest.raises(dpstack.UsageError, match="no field is called 'a'; there are: none"):
            _ = bus.slave("raw")["a"]
        assert (bus.slave("raw").input_values, bus.slave("raw").output_values) == ({}, {})
        with pytest.raises(dpstack.UsageError, match="its drive plugin makes the outputs"):
            bus.slave("hoist").outputs = bytes(12)


async def test_in_the_summary_and_through_the_control_socket() -> None:
    async with (
        bus_of(VALVES, HOIST) as bus,
        control_run(bus, "named"),
        octet_client("named") as client,
    ):
        await bus.ready()
        await bus.operate()

        async def ask(command: str, *args: str) -> Any:
            answer = json.loads(await client.ask(json.dumps({"command": command, "args": args}).encode()))
            return answer["result"] if answer["ok"] else answer["error"]

        assert await ask("set", "valves.open=on", "8.target=-0x10") is None
        valves = bus.slave(8)
        assert valves.outputs == b"\x08\x00\xff\xf0"
        while valves["level"] != -16:
            await bus.rotated(bus.stats.rotations + 1, 10)
        wanted = {"limit": True, "status": 8, "level": -16, "level_raw": "fff0"}
        wanted |= {"open": True, "close": False, "target": -16}
        assert (await ask("stats"))["slaves"]["8"]["fields"] == wanted
        assert (await ask("status"))["slaves"]["8"]["fields"] == wanted
        for args, text in (
            (("8.open=off", "8.nonsense=1"), "no output is called 'nonsense'"),
            (("8.open=off", "8.target=40000"), "target = 40000 is outside -32768..32767"),
            (("8.open=off", "8.target=low"), "target = 'low' is no i16: write a number, for instance 12"),
            (("8.open=off", "7.open=on"), "no slave '7' here; there are: 3 (hoist), 8 (valves)"),
            (("8.open=off", "open=on"), "'open=on' is not SLAVE.FIELD=VALUE; write it as 8.limit=on"),
            (("8.open=off", "3.command=1"), "no output is called 'command'"),
        ):
            assert text in await ask("set", *args)
            assert valves["open"] is True


# --- words for numbers ----------------------------------------------------------------------------------------------

PUMP: dict[str, object] = {"name": "pump", "address": 9, "ident": 1, "config": "10 20"}


def worded(words: object, at: str = "u8@0", **more: object) -> SlaveConfig:
    return slave_config({**PUMP, "outputs": {"mode": {"at": at, "words": words, **more}}})


def test_a_word_stands_for_its_number() -> None:
    field = worded({"0": "off", "1": "Slow speed", "2": "fast"}).output_fields.fields["mode"]
    assert [field.put(b"\0", value).hex() for value in ("off", "slow speed", "fast", 2)] == ["00", "01", "02", "02"]
    assert [field.read(text) for text in ("slow speed", "2", "0x02")] == [1, 2, 2]
    assert field.get(b"\1") == 1
    with pytest.raises(ValueError, match=r"mode is never 'stop': it is off \(0\), Slow speed \(1\), fast \(2\)"):
        field.put(b"\0", "stop")
    assert [read_octets(field, bytes([octet])).text for octet in (1, 7)] == ["Slow speed", "no meaning"]
    # as readers of the live stream get it
    assert field.as_dict()["words"] == {"0": "off", "1": "Slow speed", "2": "fast"}
    seen = convert(field.as_dict(), FieldPlant)
    assert [seen.word(value) for value in (1, 7, True, None, 1.0)] == ["Slow speed", "no meaning", "", "", ""]


@pytest.mark.parametrize(
    ("words", "more", "said"),
    [
        ({"on": "x"}, {}, "write a number and up to 60 characters"),
        ({"1": ""}, {}, "1 is empty"),
        ({"1": "x" * 61}, {}, "write a number and up to 60 characters"),
        ({"1": "on"}, {"at": "bool@0.0"}, "words are for whole numbers without a scale"),
        ({"1": "on"}, {"scale": 0.5}, "words are for whole numbers without a scale"),
    ],
)
def test_words_that_cannot_be(words: object, more: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        worded(words, **more)  # type: ignore[arg-type]
