"""The tables of keys hold at every limit and for every type, in a file and while the bus runs.

Also: no other class, function or call lists the fields of SlaveParams again.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from property_kit import examples

import dpstack
from dpstack.api.config.bus import BusConfig
from dpstack.api.config.config import parse_config
from dpstack.api.config.dpv1 import Dpv1Keys
from dpstack.api.config.slave import Changes, SlaveConfig, SlaveKeys, changed
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import ConfigError
from dpstack.toml.table import Key, keys_of

ROOT = Path(dpstack.__file__).parent.parent
BUS = {"port": '"virtual"', "baud": "500000"}
RAW = {"name": '"raw"', "address": "9", "ident": "0x1234", "config": '"20 10"', "user_prm": '"00 00 00"'}
#: a drive with the option that the key is for
DRIVES = {"reference_hz": "demag-dedrive", "reference_rpm": "imo-hd2"}
TABLES = {
    "bus": keys_of(BusConfig),
    "slave": {**keys_of(SlaveKeys), **keys_of(Changes)},
    "dpv1": keys_of(Dpv1Keys),
}
TITLES = {"bus": "[bus]", "slave": "[[slave]] raw", "dpv1": "[[slave]] raw: dpv1"}
KEYS = [(table, name) for table, keys in TABLES.items() for name in keys]
LIMITED = [(table, name) for table, name in KEYS if not math.isinf(TABLES[table][name].low)]
#: values of types that no key takes
WRONG = ["1979-05-27", "[[1]]", "[{}]"]


def plant(table: str, name: str, value: str, blanks: int = 0) -> tuple[str, int]:
    """A configuration with ``name`` = ``value``, and its line."""
    base = {"bus": dict(BUS), "slave": {} if table == "bus" else dict(RAW), "dpv1": {}}
    if name in DRIVES:
        base["slave"] = {"name": '"raw"', "address": "9", "drive": f'"{DRIVES[name]}"'}
    base[table].pop(name, None)
    lines = ["[bus]", *(f"{key} = {it}" for key, it in base["bus"].items())]
    if base["slave"]:
        lines += ["[[slave]]", *(f"{key} = {it}" for key, it in base["slave"].items())]
    if table == "dpv1":
        lines.append("[slave.dpv1]")
    at = 1 if table == "bus" else len(lines)
    lines[at:at] = [""] * blanks + [f"{name} = {value}"]
    return "\n".join(lines), at + blanks + 1


def refusal(table: str, name: str, value: str, blanks: int = 0) -> tuple[str, int]:
    """(the error message for the key, "" where it is accepted; the line of the key)."""
    text, line = plant(table, name, value, blanks)
    try:
        parse_config(text, "plant.toml")
    except ConfigError as error:
        return str(error), line
    return "", line


def texts(key: Key, value: float) -> str:
    """``value`` as TOML, in the form of the key."""
    number = str(value) if key.kind is float else str(int(value))
    return number if key.kind in (int, float) else f"[{number}]"


@pytest.mark.parametrize(("table", "name"), LIMITED)
@examples(5)
@given(blanks=st.integers(0, 40))
def test_at_the_limits(table: str, name: str, blanks: int) -> None:
    key = TABLES[table][name]
    least = 0.0001 if 0 < key.low < 1 else 1
    for value, inside in ((key.low - least, False), (key.low, True), (key.high, True), (key.high * 1.01 + 1, False)):
        message, line = refusal(table, name, texts(key, value), blanks)
        limits = f"{key.low:g}..{key.high:g}" if key.kind is float else f"{key.low}..{key.high}"
        assert (f" outside {limits}; " in message) is not inside, (value, message)
        if not inside:
            assert message.startswith(f"plant.toml:{line}: {TITLES[table]}: {name} "), message


@pytest.mark.parametrize(("table", "name"), KEYS)
def test_another_type(table: str, name: str) -> None:
    for value in WRONG:
        message, line = refusal(table, name, value)
        assert message.startswith(f"plant.toml:{line}: "), (value, message)
        assert name in message
        assert message.partition("; ")[2]


@pytest.mark.parametrize(("table", "name"), KEYS)
def test_the_message_about_a_misspelt_key_names_the_right_one(table: str, name: str) -> None:
    text, _ = plant(table, name, "1")
    with pytest.raises(ConfigError, match=rf"unknown key '{name}x'; did you mean '{name}'\?"):
        parse_config(text.replace(f"{name} = 1", f"{name}x = 1"), "plant.toml")


def raw() -> SlaveConfig:
    lines = [f"{key} = {value}" for key, value in RAW.items()]
    text = "\n".join(["[bus]", 'port = "virtual"', "baud = 500000", "[[slave]]", *lines])
    return parse_config(text, "plant.toml").slaves[0]


@pytest.mark.parametrize("name", [name for name, key in keys_of(Changes).items() if not math.isinf(key.low)])
def test_a_running_bus_gives_the_same_messages(name: str) -> None:
    key = keys_of(Changes)[name]
    for value in (key.low - 1, key.high + 1):
        given_: Any = {name: int(value) if key.kind is int else [int(value)]}
        message, _ = refusal("slave", name, texts(key, value))
        with pytest.raises(ConfigError) as caught:
            changed(raw(), given_)
        assert str(caught.value).removeprefix("slave 9 (raw): reparameterise: ") == message.partition("raw: ")[2]


def test_none_means_left_out() -> None:
    slave = raw()
    given_: Any = {
        "ident": 7, "watchdog_ms": 100, "groups": [3], "sync": True, "freeze": True, "every": 3, "safe": "01",
        "min_slave_interval": 20, "dpv1": True, "ignore_auto_clear": True, "fail_safe": True, "wd_base_1ms": True,
    }  # fmt: skip
    other = changed(slave, given_)
    assert other.params.min_slave_interval_ns == 2_000_000
    assert (other.params.safe, other.params.groups) == (b"\x01", (3,))
    assert other.params.dpv1 is not None
    nothing: Any = dict.fromkeys(given_)
    assert changed(other, nothing).params == structs.replace(slave.params, ident=None)


# --- stated once ------------------------------------------------------------------------------------------------------

FIELDS = set(SlaveParams.__struct_fields__) - {"address", "name", "ident", "config", "texts"}
#: a list of fewer is none
FEW = 4
#: rooms with fields of other things: slaves of the program, the model of a GSD file, octets of a PDU
OTHERS = ("gsd/", "sim/", "dp/slave/", "dp/pdu/", "dpv1/slave/", "dpv1/pdu/")
#: places that list as many for a reason of their own, with the reason
LISTS = {
    "slave_params.SlaveParams": "the parameters themselves",
    "slave_params": "their limits",
    "services.set_prm": "from the parameters to the octets",
    "slave.Changes": "the keys of the configuration",
    "gsd_source.read_gsd_slave": "from what a GSD file says to the parameters",
    "drive_source.params_by_profile": "from what a drive plugin says to the parameters",
    "drive_source.basis_of_profile": "the parameters that its plugin decides",
    "drive_profile.Profile": "what a drive plugin says",
    "profiles.facts_of": "what a device file says",
    "live.slave_plant": "a slave as the live stream describes it, some of its parameters in JSON",
    "sheet.Sheet": "a slave as its commissioning sheet shows it",
    "sheet._sheet": "the same, from its configuration",
    "sheet._sheet_of_cpu": "the same of a CPU, which has few of them",
    "plan._slave_dict": "a slave as `dpstack plan --json` shows it",
    "items.SlavePlant": "the same with its types, for items that come from outside",
    "drive_profile.Profile.described": "a drive plugin as a GSD file has it",
}


def lists(node: ast.AST, where: str) -> Iterator[tuple[str, set[str]]]:
    """The names that each class, function and call lists."""
    for child in ast.iter_child_nodes(node):
        inside = where
        if isinstance(child, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            inside = f"{where}.{child.name}"
        if isinstance(child, ast.ClassDef):
            yield (
                inside,
                {
                    one.target.id
                    for one in child.body
                    if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)
                },
            )
        elif isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield inside, {one.arg for one in (*child.args.args, *child.args.kwonlyargs)}
        elif isinstance(child, ast.Call):
            yield inside, {one.arg for one in child.keywords if one.arg}
        elif isinstance(child, ast.Dict):
            yield (
                inside,
                {one.value for one in child.keys if isinstance(one, ast.Constant) and isinstance(one.value, str)},
            )
        yield from lists(child, inside)


def test_a_parameter_of_a_slave_is_stated_once() -> None:
    found = {}
    for path in sorted((ROOT / "dpstack").rglob("*.py")):
        place = path.relative_to(ROOT / "dpstack").with_suffix("")
        text = path.read_text(encoding="utf-8")
        # only a text with so many of the names can have a list of them; to parse all takes two seconds
        if not str(place).startswith(OTHERS) and sum(name in text for name in FIELDS) >= FEW:
            for where, names in lists(ast.parse(text), place.name):
                if len(names & FIELDS) >= FEW:
                    found[where] = sorted(names & FIELDS)
    assert set(found) <= set(LISTS), found
    assert {"slave_params.SlaveParams", "slave.Changes"} <= set(found)
