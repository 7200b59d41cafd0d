"""Texts of wire logs for DP-V1: literal telegrams, and a text for any octets."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from octet_slave import DL, sd2
from property_kit import examples

from dpstack.dpv1.describe import inside, pdu_text, render
from dpstack.fdl.codec import decode
from dpstack.fdl.describe import describe
from dpstack.trace import WireEntry

DIAG = "00 0C 00 02 12 34 "


def _telegram(sap: int, master: int, unit: str, *, request: bool) -> bytes:
    """Between master 2 and slave 4."""
    octets = bytes.fromhex(unit)
    return sd2(4, 2, 0x5D, sap, master, octets) if request else sd2(2, 4, DL, master, sap, octets)


@pytest.mark.parametrize(
    ("sap", "master", "way", "unit", "text"),
    [
        (51, 51, "->", "5E 01 2F F0", "Read of slot 1, index 47, up to 240"),
        (51, 51, "<-", "5E 01 2F 02 AA BB", "Read of slot 1, index 47, data 2"),
        (51, 51, "->", "5F 00 FF 04 08 00 FD E8", "Write of slot 0, index 255, data 4"),
        (51, 51, "<-", "5F 00 FF 04", "Write of slot 0, index 255, data 4"),
        (51, 51, "<-", "DE 80 B5 00", "Read refused: state conflict (80 B5 00: class access, code 5)"),
        (51, 51, "->", "5C 02 03 28", "Alarm_Ack of pull alarm, slot 2, sequence number 5"),
        (50, 51, "<-", "5C 02 03 28", "Alarm_Ack of pull alarm, slot 2, sequence number 5"),
        (51, 51, "->", "5E 01", "cannot be read (DP-V1 service ends after 2 octets"),
        (51, 51, "->", "4A", "cannot be read (octet 1: no service 0x4A)"),
        (51, 51, "<-", "5E 01 2F 05 AA", "cannot be read (Read response: octet 4 says 5 octets of data, 1 came)"),
        (
            49,
            50,
            "->",
            "57 00 00 00 00 C8 01 00 00 00 00 00 00 02 00 02 00 00 00 00",
            "Initiate, send time-out 2 s",
        ),
        (49, 50, "<-", "56 30 00 64", "server SAP 48, send time-out 1 s"),
        (48, 50, "<-", "57 F0 01 00 00 00 00 00 00 02 00 02 00 00 00 00", "Initiate, up to 240 octets of data"),
        (48, 50, "<-", "D7 80 C3 00", "Initiate refused: resource unavailable"),
        (0, 50, "->", "51 03 04 02 AA BB", "Data_Transport of slot 3, index 4, data 2"),
        (0, 50, "->", "48 01", "Idle"),
        (17, 50, "<-", "58 02 13", "Abort: nothing was heard from the other end in time (ABT_TO in a remote subnet)"),
        (17, 50, "->", "58 00 25", "Abort: its user, reason 5"),
        (
            60,
            62,
            "<-",
            DIAG + "06 01 02 29 AA BB",
            "diagnosis alarm, slot 2, appears, slot disturbed, sequence number 5",
        ),
        (60, 62, "<-", DIAG + "05 82 00 00 30 04 83 01 02", "module status: slot 3 no module; DXB link status, slot 1"),
        (60, 62, "<-", DIAG + "03 AA BB 41 01", ""),  # of the maker, and of modules
        (60, 62, "<-", "00 0C", ""),
        (60, 62, "->", "AA", ""),
        (61, 62, "->", "88 01 01 0B 12 34 00", ""),
        (17, 62, "->", "58 00 25", ""),  # no class 2 connection
    ],
)
def test_texts_of_telegrams(sap: int, master: int, way: str, unit: str, text: str) -> None:
    octets = _telegram(sap, master, unit, request=way == "->")
    telegram = decode(octets)
    assert telegram is not None
    words = inside(telegram)
    assert words.startswith(text)
    assert bool(words) is bool(text)
    count = len(bytes.fromhex(unit))
    line = describe(telegram, inside)
    assert f", {count} octet{'s' if count > 1 else ''}{': ' if words else ' ('}{words}" in line
    assert line in render([WireEntry(0, 1_000_000, octets, "2")], 500_000)


@examples(300)
@given(st.sampled_from((0x48, 0x51, 0x56, 0x57, 0x58, 0x5C, 0x5E, 0x5F)), st.binary(max_size=30), st.booleans())
def test_there_is_a_text_for_everything(function: int, rest: bytes, request: bool) -> None:
    for first in (function, function | 0x80, function ^ 0x04):
        assert pdu_text(bytes((first,)) + rest, request=request)


@examples(200)
@given(st.binary(max_size=60), st.sampled_from((0, 48, 49, 50, 51, 60)), st.booleans())
def test_any_telegram_has_a_text(unit: bytes, sap: int, request: bool) -> None:
    telegram = decode(_telegram(sap, 50, unit.hex(), request=request))
    assert telegram is not None
    assert describe(telegram, inside)
