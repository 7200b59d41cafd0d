"""Telegrams and wire logs in words: literal telegrams, and a text for whatever octets come."""

from __future__ import annotations

import doctest

import pytest
from hypothesis import given
from hypothesis import strategies as st
from octet_slave import DL, sd2
from property_kit import examples
from support import present

import dpstack.decode.words as module
from dpstack.decode.wire_log import render
from dpstack.decode.words import describe, describe_octets
from dpstack.fdl.codec import decode
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.trace import WireEntry, WireLog

LINES = [
    ("68 05 05 68 82 E3 6D 3C 3E 4C 16", "Slave_Diag request 99 -> 2 (SRD high, FCV=0 FCB=1)"),
    ("68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16", "Slave_Diag answer 2 -> 99, 6 octets (DL, slave)"),
    (
        "68 0F 0F 68 82 E3 5D 3D 3E B8 05 01 00 0C DA 01 40 00 00 22 16",
        "Set_Prm request 99 -> 2, 10 octets (SRD high, FCV=1 FCB=0)",
    ),
    ("68 06 06 68 88 82 7D 3E 3E 21 24 16", "Chk_Cfg request 2 -> 8, 1 octet (SRD high, FCV=1 FCB=1)"),
    ("10 02 63 49 AE 16", "FDL_Status request 99 -> 2 (FC 0x49)"),
    ("10 63 02 00 65 16", "acknowledgement 2 -> 99 (OK, slave)"),
    ("10 63 02 03 68 16", "acknowledgement 2 -> 99 (RS, slave)"),
    ("10 63 02 30 95 16", "acknowledgement 2 -> 99 (OK, master in ring)"),
    ("10 63 02 0F 74 16", "acknowledgement 2 -> 99 (status 15, slave)"),
    ("DC 03 02", "token 2 -> 3"),
    ("DC 02 02", "token 2 -> 2 (to itself)"),
    ("E5", "SC"),
    ("68 04 04 68 03 02 5D 11 73 16", "Data_Exchange request 2 -> 3, 1 octet (SRD high, FCV=1 FCB=0)"),
    ("10 03 02 7D 82 16", "Data_Exchange request 2 -> 3 (SRD high, FCV=1 FCB=1)"),
    ("68 04 04 68 02 03 0A 99 A8 16", "Data_Exchange answer 3 -> 2, 1 octet (DH, slave)"),
    ("68 03 03 68 02 03 08 0D 16", "acknowledgement 3 -> 2, LE = 3 (DL, slave)"),
    ("10 03 02 41 46 16", "Data_Exchange request 2 -> 3 (function 1)"),
    ("68 07 07 68 FF 82 46 3A 3E 00 00 3F 16", "Global_Control 2 -> all, Operate, all groups (SDN high)"),
    ("68 07 07 68 FF 82 46 3A 3E 02 00 41 16", "Global_Control 2 -> all, Clear, all groups (SDN high)"),
    ("68 07 07 68 FF 82 46 3A 3E 28 05 6C 16", "Global_Control 2 -> all, Operate Freeze Sync, group 1, 3 (SDN high)"),
    (
        "68 07 07 68 FF 82 46 3A 3E 55 80 14 16",
        "Global_Control 2 -> all, Operate Unfreeze Unsync reserved bits 0x41, group 8 (SDN high)",
    ),
    (
        "68 06 06 68 FF 82 46 3A 3E 00 3F 16",
        "Global_Control 2 -> all, 1 octet: cannot be read (Global_Control ends after 1 octet: octet 2 (group_select) "
        "is missing) (SDN high)",
    ),
    ("00 12", "no telegram: no start octet (10, 68, A2, DC, E5): octet 1 is 00"),
    ("68 05 05 68 82", "no telegram: cut off after 5 octets of 11"),
    ("68 05 06 68 82", "no telegram: LE and LEr differ: octets 2 and 3 are 05 and 06"),
    ("68 02 02", "no telegram: LE outside of 3..249: octet 2 is 02"),
    ("68 05 05 67", "no telegram: the second start octet is not 68: octet 4 is 67"),
    ("10 02 63 49 AE 17", "no telegram: the end octet is not 16: octet 6 is 17"),
    ("10 02 63 49 AF 16", "no telegram: wrong check sequence (FCS): octet 5 is af, the sum is ae"),
    ("68 05 05 68 82 E3 6D 3C 3E 4D 16", "no telegram: wrong check sequence (FCS): octet 10 is 4d, the sum is 4c"),
    ("E5 E5", "a telegram with other octets after it, from octet 2 on"),
    ("", "no octets"),
]


@pytest.mark.parametrize(("octets", "text"), LINES)
def test_one_line_each(octets: str, text: str) -> None:
    assert describe_octets(bytes.fromhex(octets)) == text


def test_segments_are_shown() -> None:
    text = describe(Telegram(Kind.SD2, 3, 2, 0x6D, 60, 62, dseg=1, sseg=2))
    assert text == "Slave_Diag request 2 -> 3, DSEG 1, SSEG 2 (SRD high, FCV=0 FCB=1)"


def test_the_wire_log_to_the_character() -> None:
    log = WireLog()
    log.add(WireEntry(1_000_000, 1_066_000, bytes.fromhex("DC 02 02"), "2"))
    log.add(WireEntry(1_140_000, 1_140_000 + 132_000, bytes.fromhex("10 03 02 49 4E 16"), "master"))
    log.add(WireEntry(1_294_500, 1_400_000, bytes.fromhex("10 02 03 00 05 16"), None, "too early"))
    log.add(WireEntry(1_390_000, 1_700_000, bytes(40), "3"))
    hexed = "00 " * 24 + "... 00 00 00 00 (40 octets)"
    pad = len(hexed)
    expected = [
        f"  no.       start us  gap bits  sender     {'octets':<{pad}}  telegram",
        f"    1       1000.000            2          {'dc 02 02':<{pad}}  token 2 -> 2 (to itself)",
        f"    2       1140.000        37  master     {'10 03 02 49 4e 16':<{pad}}  FDL_Status request 2 -> 3 (FC 0x49)",
        f"    3       1294.500        11  ?          {'10 02 03 00 05 16':<{pad}}  acknowledgement 3 -> 2 (OK, slave)"
        "  [too early]",
        f"    4       1390.000        -5  3          {hexed}  no telegram: no start octet (10, 68, A2, DC, E5)"
        ": octet 1 is 00",
    ]
    assert render(log, 500_000).splitlines() == expected


def test_an_empty_log_is_a_heading() -> None:
    assert render([], 500_000).split() == ["no.", "start", "us", "gap", "bits", "sender", "octets", "telegram"]


@given(st.lists(st.binary(max_size=300), max_size=5))
def test_anything_can_be_shown(parts: list[bytes]) -> None:
    entries = [WireEntry(n * 1_000, n * 1_000 + 500, octets) for n, octets in enumerate(parts)]
    assert len(render(entries, 9_600).splitlines()) == len(parts) + 1


@given(st.integers(-1, 255), st.none() | st.integers(0, 63), st.none() | st.integers(0, 63), st.binary(max_size=4))
def test_every_telegram_has_a_line(fc: int, dsap: int | None, ssap: int | None, data: bytes) -> None:
    kind = Kind.SD2 if fc >= 0 else Kind.SC
    text = describe(Telegram(kind, 3, 2, fc, dsap, ssap, data))
    assert text
    assert "\n" not in text


def test_the_example_in_the_docstring() -> None:
    assert doctest.testmod(module).failed == 0


# --- contents: DP-V1 and diagnosis ---

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
        # of the maker, and of modules: slots count from 1, as the texts of a running bus do
        (60, 62, "<-", DIAG + "03 AA BB 42 02", "device: aa bb; slots with a diagnosis: 2"),
        (60, 62, "<-", DIAG + "82 41 66", "slot 3, input channel 1 (4 bits): line break"),
        (60, 62, "<-", "00 0C", "cannot be read (Slave_Diag has 2 octets"),
        (60, 62, "->", "AA", ""),
        (61, 62, "->", "88 01 01 0B 12 34 00", ""),
        (17, 62, "->", "58 00 25", ""),  # no class 2 connection
    ],
)
def test_texts_of_telegrams(sap: int, master: int, way: str, unit: str, text: str) -> None:
    octets = _telegram(sap, master, unit, request=way == "->")
    telegram = present(decode(octets))
    count = len(bytes.fromhex(unit))
    line = describe(telegram)
    assert f", {count} octet{'s' if count > 1 else ''}{': ' if text else ' ('}{text}" in line
    assert line in render([WireEntry(0, 1_000_000, octets, "2")], 500_000)


@examples(300)
@given(st.sampled_from((0x48, 0x51, 0x56, 0x57, 0x58, 0x5C, 0x5E, 0x5F)), st.binary(max_size=30), st.booleans())
def test_there_is_a_text_for_everything(function: int, rest: bytes, request: bool) -> None:
    for first in (function, function | 0x80, function ^ 0x04):
        telegram = decode(sd2(4, 2, 0x5D if request else DL, 51, 51, bytes((first,)) + rest))
        assert telegram is not None
        assert ": " in describe(telegram)


@examples(200)
@given(st.binary(max_size=60), st.sampled_from((0, 48, 49, 50, 51, 60)), st.booleans())
def test_any_telegram_has_a_text(unit: bytes, sap: int, request: bool) -> None:
    telegram = present(decode(_telegram(sap, 50, unit.hex(), request=request)))
    assert describe(telegram)
