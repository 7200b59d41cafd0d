"""Words, scales and state tables of dpstack.profile."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.profile import SPEED, State, StateRow, StateTable, Word, drivecom_states, signed16
from dpstack.profile.model.drivecom_states import Command, command


@pytest.mark.parametrize(
    ("fraction", "word"),
    [
        (0.5, 0x2000),
        (1.0, 0x4000),
        (-1.0, 0xC000),
        (-2.0, 0x8000),
        (1.99993896484375, 0x7FFF),
        (0.0, 0),
        (-0.5, 0xE000),
    ],
)
def test_d11_and_f4_scaling(fraction: float, word: int) -> None:
    assert SPEED.encode(fraction) == word
    assert SPEED.decode(word) == fraction


@pytest.mark.parametrize("bad", [2.0, -2.001, 1e30, math.inf, -math.inf, math.nan])
def test_a_value_that_does_not_fit_is_refused_with_the_range(bad: float) -> None:
    with pytest.raises(ValueError, match=r"outside -2\.\.1\.9999"):
        SPEED.encode(bad)


@given(st.integers(0, 0xFFFF))
def test_every_word_decodes_and_comes_back(word: int) -> None:
    assert SPEED.encode(SPEED.decode(word)) == word
    assert signed16(word) == int.from_bytes(word.to_bytes(2, "big"), "big", signed=True)


@given(st.floats(-2, 1.9999, allow_nan=False))
def test_encoding_is_half_a_step_exact(fraction: float) -> None:
    assert abs(SPEED.decode(SPEED.encode(fraction)) - fraction) <= 0.5 / 0x4000


def test_word_bits_by_name() -> None:
    word = Word("w", {"b": 9, "a": 0})
    assert word.mask("a", "b") == 0x0201
    assert word.names(0x0201) == ("a", "b")
    assert word.names(0x0400) == ()
    with pytest.raises(ValueError, match="each once"):
        Word("w", {"a": 1, "b": 1})
    with pytest.raises(ValueError, match=r"0\.\.15"):
        Word("w", {"a": 16})


def test_state_tables_are_checked() -> None:
    with pytest.raises(ValueError, match="can match both"):
        StateTable([StateRow(State.READY, 0x03, 0x03), StateRow(State.RUNNING, 0x07, 0x07)])
    with pytest.raises(ValueError, match="outside mask"):
        StateTable([StateRow(State.READY, 0x01, 0x02)])


@given(st.integers(0, 0xFFFF))
def test_every_control_word_is_exactly_one_drivecom_command(word: int) -> None:
    matching = [c for c in Command if word & c.value[0] == c.value[1]]
    assert matching == [command(word)]


@given(st.integers(0, 0xFFFF))
def test_any_status_word_decodes(word: int) -> None:
    assert isinstance(drivecom_states.STATES.decode(word), State)
