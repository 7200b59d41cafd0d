"""Any TOML text is read or refused with file and line, in time proportional to its size."""

from __future__ import annotations

import contextlib
import tomllib
from collections.abc import Callable
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_kit import assert_linear

from dpstack.api.config.config import parse_config
from dpstack.api.lists.parameter_list import ParameterList
from dpstack.api.lists.record_list import RecordList
from dpstack.errors import ConfigError
from dpstack.toml.reading import MAX_BARE, MAX_DEPTH, MAX_PARTS, TomlError, line_numbers, read_toml

BUS = '[bus]\nport = "virtual"\nbaud = 500000\n'
SLAVE = '[[slave]]\naddress = 8\nident = 0x1234\nconfig = "20 10"\n'

#: texts that are refused in line 4 of a configuration
REFUSED = {
    "a key of 50000 parts": (".".join(["a"] * 50_000) + " = 1", "a key of more than 16 parts"),
    "a header of 50000 parts": (f"[{'.'.join(['a'] * 50_000)}]", "a key of more than 16 parts"),
    "a key of quoted parts": (" . ".join(["'a'", '"b"'] * 500) + " = 1", "a key of more than 16 parts"),
    "an inline table with such a key": ("a = { b = 1, " + ".".join(["a"] * 500) + " = 1 }", "a key of more than 16"),
    "nested arrays": ("a = " + "[" * 100_000, "brackets in each other, more than 32 deep"),
    "nested tables": ("a = " + "{ a = " * 100_000, "brackets in each other, more than 32 deep"),
    "a number of 5000 digits": ("a = " + "9" * 5000, "a number or a key of 5000 characters; 255 is the most"),
    "a hexadecimal number": ("a = 0x" + "f" * 5000, "a number or a key of 5002 characters; 255 is the most"),
    "a key without quotes": ("k" * 5000 + " = 1", "a number or a key of 5000 characters; 255 is the most"),
    "a number behind a string": ("a = [\"[{#=.\", '''\n[[[''', " + "9" * 5000, "a number or a key of 5000 characters"),
}


def read_or_refuse(read: Callable[[str], object], text: str) -> None:
    """Read ``text``; nothing but TomlError and ConfigError may be raised."""
    with contextlib.suppress(TomlError, ConfigError):
        read(text)


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("read", [parse_config, ParameterList.parse, RecordList.parse])
def test_texts_that_are_refused_before_tomllib_reads_them(name: str, read: Callable[[str, str], object]) -> None:
    text, what = REFUSED[name]
    line = 5 if "'''" in text else 4
    with pytest.raises(ConfigError) as caught:
        read(f"{BUS}{text}\n", "plant.toml")
    assert what in str(caught.value)
    assert f":{line}" in str(caught.value) or f"(line {line})" in str(caught.value)
    assert len(str(caught.value)) < 300


def test_texts_at_the_limits_are_read() -> None:
    key = ".".join(["a"] * MAX_PARTS)
    deep = "[" * MAX_DEPTH + "]" * MAX_DEPTH
    number = "1" * MAX_BARE
    data, lines = read_toml(f"[t]\n{key} = 1\nb = {deep}\nc = {number}\n'{'k' * 5000}' = \"{'v' * 100_000}\"\n")
    assert lines["t", "b"] == 3
    assert lines[("t", *["a"] * MAX_PARTS)] == 2
    assert data["t"]["c"] == int(number)


@pytest.mark.parametrize("text", ["a " * 1000 + "= 1\n", "[" + "b " * 1000 + "]\n", "[" + "a[" * 1000 + "]\n"])
def test_words_that_are_no_key_are_not_kept(text: str) -> None:
    lines = line_numbers(text)
    assert len(lines) <= MAX_PARTS + 1
    assert max(map(len, lines), default=0) <= MAX_PARTS + 1
    with pytest.raises(TomlError):
        read_toml(text)


def test_a_file_that_is_too_long() -> None:
    with pytest.raises(ConfigError, match=r"plant\.toml:1: not valid TOML: the file has more than 4 MB"):
        parse_config("#" * 4_000_001, "plant.toml")


def test_refusals_of_python_name_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    for error in (ValueError("digits"), RecursionError("too deep")):

        def loads(_text: str, error: Exception = error) -> object:
            raise error

        monkeypatch.setattr(tomllib, "loads", loads)
        with pytest.raises(ConfigError, match=r"plant\.toml:1: not valid TOML: a value cannot be read"):
            parse_config(BUS, "plant.toml")


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ('a = """x""""\nb = 1\n', {("a",): 1, ("b",): 2}),
        ('a = """"x"""""\nb = 1\n', {("a",): 1, ("b",): 2}),
        ("a = '''''x''''\nb = 1\n", {("a",): 1, ("b",): 2}),
        ('a = """\\"""\n"""\nb = 1\n', {("a",): 1, ("b",): 3}),
        ('a = "\u2028 \x85"\nb = 1\n', {("a",): 1, ("b",): 2}),
        ('"a\\u0062\\U00000063" = 1\n"\\u0062" = 2\n', {("a\\u0062\\U00000063",): 1, ("b",): 2}),
        ("a = 1\r\n\r\nb = 2\r\n", {("a",): 1, ("b",): 3}),
        ("[a]  # [b]\n[a.b]\n", {("a",): 1, ("a", "b"): 2}),
        ("a = [ # ]\n1, # [\n]\nb = {c = [1,\n2]}\nd = 1\n", {("a",): 1, ("b",): 4, ("d",): 6}),
        (
            "[[a]]\n[[a.b]]\nc = 1\n",
            {("a",): 1, ("a", 0): 1, ("a", 0, "b", 0): 2, ("a", "b"): 2, ("a", 0, "b", 0, "c"): 3},
        ),
    ],
)
def test_line_numbers_of_texts_that_tomllib_accepts(text: str, lines: dict[tuple[str | int, ...], int]) -> None:
    tomllib.loads(text)
    assert read_toml(text)[1] == lines


#: repeated n times
PARTS: dict[str, Callable[[int], str]] = {
    "keys": lambda n: "".join(f"k{i} = {i}\n" for i in range(n)),
    "tables": lambda n: "".join(f"[t{i}.a]\nb = 1\n" for i in range(n)),
    "arrays of tables": lambda n: "[[t]]\na = 1\n" * n,
    "an array": lambda n: f"a = [{'1, ' * n}]\n",
    "an inline table": lambda n: "a = { " + ", ".join(f"k{i} = 1" for i in range(n)) + " }\n",
    "escapes": lambda n: 'a = "' + "\\n" * n + '"\n',
    "a string of many lines": lambda n: 'a = """' + '"\n\\\\' * n + '"""\n',
    "blanks in a header": lambda n: f"[a{' ' * n}.{' ' * n}b]\n",
    "blanks in a key": lambda n: f"a{' ' * n}.b{' ' * n} = 1\n",
    "remarks": lambda n: "# [[[ = ' \n" * n,
    "quotes": lambda n: "'" * n,
    "quotes in threes": lambda n: '"""' * n,
    "points": lambda n: "." * n,
    "brackets": lambda n: "[]" * n,
    "equal signs": lambda n: "=" * n,
    "backslashes": lambda n: 'a = "' + "\\" * n,
}


@pytest.mark.parametrize("name", PARTS)
def test_twice_the_text_takes_twice_the_steps(name: str) -> None:
    assert_linear(lambda n: partial(read_or_refuse, read_toml, PARTS[name](n)), 100)


FIELDS: dict[str, Callable[[int], str]] = {
    "fields": lambda n: ", ".join(f'k{i} = "bool@{i // 8}.{i % 8}"' for i in range(n)),
    "the same bits": lambda n: ", ".join(f'k{i} = "u8@0"' for i in range(n)),
}


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("key", ["inputs", "outputs"])
def test_many_fields_take_many_steps_and_no_more(name: str, key: str) -> None:
    octets = "EF " * 7 if key == "outputs" else "DF " * 7

    slave = f'[[slave]]\naddress = 8\nident = 0x1234\nconfig = "{octets}"\n'
    assert_linear(
        lambda n: partial(read_or_refuse, parse_config, f"{BUS}{slave}{key} = {{ {FIELDS[name](n)} }}\n"), 200
    )


@pytest.mark.parametrize("what", ["u8@" + "9" * 5000, "bool@0." + "9" * 5000, "bytes@0:" + "9" * 5000, "u8" * 5000])
def test_a_field_of_very_many_digits(what: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(f'{BUS}{SLAVE}inputs = {{ a = "{what}" }}\n', "plant.toml")
    assert str(caught.value).startswith("plant.toml:8: ")
    assert len(str(caught.value)) < 300


@given(st.text(alphabet="[]{}\"'=#.\n ab\\_-0x1e+:T", max_size=80))
def test_any_text_is_read_or_refused(text: str) -> None:
    for read in (read_toml, parse_config, ParameterList.parse, RecordList.parse):
        read_or_refuse(read, text)


@given(st.text(max_size=60))
def test_any_value_is_read_or_refused(text: str) -> None:
    read_or_refuse(parse_config, f"{BUS}{SLAVE}{text}")
    for key in ("inputs", "config", "ident", "modules", "gsd", "name", "user_prm", "drive"):
        quoted = text.replace("\\", "").replace('"', "").replace("\n", "")
        read_or_refuse(parse_config, f'{BUS}[[slave]]\naddress = 8\n{key} = "{quoted}"\n')
        read_or_refuse(parse_config, f'{BUS}{SLAVE}inputs = {{ a = "{quoted}" }}\n')


def test_a_gsd_file_of_a_user_that_does_not_exist() -> None:
    with pytest.raises(ConfigError, match=r"~nobody-has-this-name\.gsd: No such file or directory"):
        parse_config(f'{BUS}[[slave]]\naddress = 8\ngsd = "~nobody-has-this-name.gsd"\n')


# --- The line numbers of all keys and tables of a TOML text ---------------------------------------------------------


TEXT = '''\
# comment [not a table]
[bus]            # a comment behind
port = "a = b"
"quoted key" = 1
text = """
[bus2]
key = 1
"""
list = [
  1,  # ] not the end
  2,
]

[[slave]]
name = 'x'
inputs = { a = "bool@0.3", b = [1, 2] }
[slave.inner]
deep = 1

[[slave]]
a.b.c = 3
'''


def test_lines() -> None:
    tomllib.loads(TEXT)
    assert line_numbers(TEXT) == {
        ("bus",): 2,
        ("bus", "port"): 3,
        ("bus", "quoted key"): 4,
        ("bus", "text"): 5,
        ("bus", "list"): 9,
        ("slave",): 14,
        ("slave", 0): 14,
        ("slave", "inner"): 17,
        ("slave", 0, "name"): 15,
        ("slave", 0, "inputs"): 16,
        ("slave", 0, "inner"): 17,
        ("slave", 0, "inner", "deep"): 18,
        ("slave", 1): 20,
        ("slave", 1, "a"): 21,
        ("slave", 1, "a", "b"): 21,
        ("slave", 1, "a", "b", "c"): 21,
    }


@pytest.mark.parametrize("quote", ['"""', "'''"])
def test_keys_inside_a_string_of_several_lines_do_not_count(quote: str) -> None:
    text = f"a = {quote}x\nb = 1\n{quote}\nc = 2\n"
    tomllib.loads(text)
    assert line_numbers(text) == {("a",): 1, ("c",): 4}


def test_an_escaped_quote_does_not_end_a_string() -> None:
    text = 'a = ["x\\"[", \'[\']\nb = 1\n'
    tomllib.loads(text)
    assert line_numbers(text) == {("a",): 1, ("b",): 2}


@given(st.text(alphabet="[]{}\"'=#.\n ab\\", max_size=60))
def test_any_text_has_line_numbers_within_it(text: str) -> None:
    assert all(1 <= line <= len(text.splitlines()) for line in line_numbers(text).values())
