"""Codes of PROFIBUS PA parameters in words, as manuals print them; any number has words."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.pa import words
from dpstack.pa.diagnosis import CHECKBACK, checkback_bits, checkback_words


@pytest.mark.parametrize(
    ("octet", "text"),
    [
        (0x08, "AUTO"),  # OXYMAT 6 p60: Actual 08h
        (0x88, "O/S, AUTO"),  # OXYMAT 6 p60: Permitted 88h
        (0x98, "O/S, MAN, AUTO"),  # SITRANS TH400 p45: 152
        (0x80, "O/S"),
        (0, "none"),
        (0xFF, "O/S, IMan, LO, MAN, AUTO, CAS, RCAS, ROUT"),
    ],
)
def test_modes(octet: int, text: str) -> None:
    assert words.mode_words(octet) == text


@pytest.mark.parametrize(
    ("typed", "bit"),
    [("auto", 8), ("AUTO", 8), ("manual", 0x10), ("o/s", 0x80), ("OOS", 0x80), ("out of service", 0x80), ("x", None)],
)
def test_typed_modes(typed: str, bit: int | None) -> None:
    assert words.find_mode(typed) == bit


def test_alarms() -> None:
    # Bürkert 8642 p19: bit 0 (LSB) discrete, 1 HI_HI, 2 HI, 3 LO_LO, 4 LO, 7 the block (ST_REV)
    assert words.alarm_words(bytes.fromhex("96 00 00 00 00 00 00 00")) == (
        "HI_HI alarm",
        "HI alarm",
        "LO alarm",
        "parameters changed (update event)",
    )
    assert words.alarm_words(bytes.fromhex("20 01")) == ("alarm bit 5 (reserved)", "alarm bit 8 (reserved)")
    assert words.alarm_words(b"") == words.alarm_words(bytes(8)) == ()


def test_features() -> None:
    assert words.feature_words(bytes.fromhex("1B 00 00 00")) == (
        "condensed status and diagnosis",
        "classic status and diagnosis",
        "class 1 acyclic connection",
        "PROFIsafe",
    )
    assert words.feature_words(bytes.fromhex("00 80 00 00")) == ("feature bit 15 (reserved)",)


@pytest.mark.parametrize(
    ("feature", "condensed"),
    [
        ("03 00 00 00 01 00 00 00", True),
        ("03 00 00 00 02 00 00 00", False),
        ("03 00 00 00 00 00 00 00", None),
        ("03 00 00 00", None),
        ("", None),
    ],
)
def test_status_in_force(feature: str, condensed: bool | None) -> None:
    assert words.is_condensed(bytes.fromhex(feature)) is condensed


@pytest.mark.parametrize(
    ("parameter", "code", "text"),
    [
        ("WRITE_LOCKING", 2457, "not locked"),  # Knick Protos 3400 p38
        ("WRITE_LOCKING", 0, "locked"),
        ("WRITE_LOCKING", 1, "code 1"),
        ("WRITE_LOCKING", 0x9000, "maker's 36864"),
        ("FACTORY_RESET", 1, "reset to defaults"),
        ("FACTORY_RESET", 2506, "restart"),
        ("FACTORY_RESET", 2712, "reset the bus address"),
        ("IDENT_NUMBER_SELECTOR", 127, "adapts to the master"),
        ("IDENT_NUMBER_SELECTOR", 129, "maker's 129"),  # FCT030 p29: PA profile 3 (9700)
        ("LIN_TYPE", 20, "lying cylinder"),  # VEGABAR 64 p65
        ("LIN_TYPE", 245, "maker's 245"),
        ("MODE_TOT", 3, "hold"),  # Promag 53 p114
        ("FAIL_TOT", 2, "memory"),  # TRICOR TCD p35
        ("POS_D", 3, "intermediate"),  # SIPART PS2 p212
        ("POS_D", 252, "unknown"),
        ("ACTUATOR_ACTION", 2, "closing"),  # Samson 3730-4 p69
        ("CHANNEL", 65530, "not used"),
        ("CHANNEL", 5, "code 5"),
        ("CHANNEL", -1, "code -1"),
    ],
)
def test_codes(parameter: str, code: int, text: str) -> None:
    assert words.code_word(parameter, code) == text


@given(st.sampled_from([*words.CODES, "UNKNOWN"]), st.integers(), st.text(max_size=8))
def test_any_code(parameter: str, code: int, text: str) -> None:
    assert words.code_word(parameter, code)
    assert words.mode_words(code)
    assert words.maker_name(code)
    found = words.find_code(parameter, text)
    assert found is None or found >= 0
    assert words.code_hint(parameter, text)


def test_typed_codes() -> None:
    assert words.find_code("FACTORY_RESET", "Restart") == 2506
    assert words.find_code("FACTORY_RESET", " 2712") == 2712
    assert words.find_code("FACTORY_RESET", "explode") is None
    assert words.code_hint("FACTORY_RESET", "restar") == "did you mean restart?"
    assert words.code_hint("SET_TOT", "xyz") == "possible: totalise, reset, preset"
    for parameter, codes in words.CODES.items():
        assert [words.find_code(parameter, word) for word in codes.values()] == [*codes], parameter


def test_makers() -> None:
    # OXYMAT 6 p60 prints 42 for Siemens; the others: the PNO's table of 2009 (document 6.012)
    known = {42: "Siemens", 17: "Endress+Hauser", 66: "Samson", 98: "VEGA", 109: "PR electronics", 319: "AUMA"}
    assert {number: words.maker_name(number) for number in known} == known
    assert words.maker_name(12345) == "maker 12345"


def test_checkback() -> None:
    # SIPART PS2 p212, p213 and Samson 3730-4 p15, p16
    assert checkback_words(bytes.fromhex("81 08 02")) == (
        "in the fail-safe position",
        "does not reach the position in time",
        "simulation is on",
        "additional input is active",
    )
    assert checkback_words(bytes.fromhex("00 10 80")) == ("octet 1 bit 4 (reserved)", "octet 2 bit 7 (maker's)")
    assert checkback_words(b"") == ()
    whole = checkback_bits(b"\xff\xff\xff")
    assert len(whole) == 24
    assert tuple(bit for bit in whole if bit.name) == CHECKBACK
