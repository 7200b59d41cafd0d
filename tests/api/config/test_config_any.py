"""Any value of any key is accepted or refused with a ConfigError, in one line of reasonable length."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.api.config.bus import BusConfig
from dpstack.api.config.config import make_config, parse_config
from dpstack.api.config.slave import Changes, SlaveKeys
from dpstack.errors import ConfigError
from dpstack.toml.table import keys_of

#: values as TOML texts
VALUES = st.one_of(
    st.integers(-(2**70), 2**70).map(str),
    st.sampled_from(
        [
            "0x0fff",
            "9999999999999999999999",
            "1e999",
            "-inf",
            "nan",
            "true",
            "[]",
            "{}",
            "1979-05-27",
            "07:32:00",
            '""',
            "''",
            "[[[[]]]]",
            "[{}]",
            "{a=1}",
            "-1",
            "0",
            '"\\u0000"',
            '"\\u001b[2J"',
            '"\\u202e"',
            '"u8@999"',
            '["a"]',
        ]
    ),
    st.text(alphabet="ab8DIO@.:/x \u00e4", max_size=12).map(lambda text: f'"{text}"'),
    st.lists(st.integers(-5, 300), max_size=4).map(str),
)
BUS_KEYS = sorted({*BusConfig.__struct_fields__, "unknown"})
SLAVE_KEYS = sorted({*keys_of(SlaveKeys), *keys_of(Changes), "unknown"})
BASE = {
    "raw": 'address = 8\nident = 0x1234\nconfig = "20 10"\n',
    "drive": 'address = 8\ndrive = "demag-dedrive"\n',
    "gsd": 'address = 8\ngsd = "io-station"\nmodules = ["8 DO"]\n',
}


def read(text: str) -> None:
    """Read ``text``; an error message must be printable and not too long."""
    message = ""
    try:
        parse_config(text, "plant.toml")
    except ConfigError as error:
        message = str(error)
    assert message.isprintable(), message
    assert len(message) < 2000


def without(text: str, key: str) -> str:
    return "".join(line + "\n" for line in text.splitlines() if line.partition(" =")[0] != key)


@pytest.mark.parametrize("key", BUS_KEYS)
@examples(20)
@given(value=VALUES)
def test_a_key_of_the_bus(key: str, value: str) -> None:
    bus = without('port = "virtual"\nbaud = 500000\n', key)
    read(f"[bus]\n{bus}{key} = {value}\n[[slave]]\n{BASE['raw']}")


@pytest.mark.parametrize("key", SLAVE_KEYS)
@examples(20)
@given(value=VALUES, base=st.sampled_from(sorted(BASE)))
def test_a_key_of_a_slave(key: str, value: str, base: str) -> None:
    read(f'[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\n{without(BASE[base], key)}{key} = {value}\n')


@given(values=st.dictionaries(st.sampled_from(SLAVE_KEYS), st.one_of(st.none(), st.integers(), st.text(max_size=9))))
def test_a_slave_of_a_program(values: dict[str, object]) -> None:
    with contextlib.suppress(ConfigError):
        make_config("virtual", 500_000, 2, [{"address": 8, "ident": 1, "config": "20", **values}])
