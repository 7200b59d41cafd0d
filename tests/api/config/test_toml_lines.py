"""The line numbers of all keys and tables of a TOML text."""

from __future__ import annotations

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.api.config.toml import line_numbers

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
