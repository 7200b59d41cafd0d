"""What people read of telegrams and wire logs."""

from __future__ import annotations

import doctest

import pytest
from hypothesis import given
from hypothesis import strategies as st

import dpstack.fdl.describe as module
from dpstack.fdl.describe import describe, describe_octets, render, service
from dpstack.fdl.telegram import SHORT_ACK, Kind, Telegram, token
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
    ("68 06 06 68 FF 82 46 3A 3E 00 3F 16", "Global_Control 2 -> all, 1 octet (SDN high)"),
    ("00 12", "no telegram: bad start"),
    ("68 05 05 68 82", "no telegram: cut off"),
    ("68 05 05 68 82 E3 6D 3C 3E 4D 16", "no telegram: bad fcs"),
    ("E5 E5", "SC, then other octets"),
    ("", "nothing"),
]


@pytest.mark.parametrize(("octets", "text"), LINES)
def test_one_line_each(octets: str, text: str) -> None:
    assert describe_octets(bytes.fromhex(octets)) == text


@pytest.mark.parametrize(
    ("dsap", "ssap", "name"),
    [
        (None, None, "Data_Exchange"),
        (55, 62, "Set_Slave_Add"),
        (56, 62, "RD_Inp"),
        (57, 62, "RD_Outp"),
        (58, 62, "Global_Control"),
        (59, 62, "Get_Cfg"),
        (60, 62, "Slave_Diag"),
        (61, 62, "Set_Prm"),
        (62, 62, "Chk_Cfg"),
        (53, 62, "Ext_User_Prm"),
        (54, 54, "master-master"),
        (51, 51, "MS1"),
        (50, 51, "MS1 alarm"),
        (49, 50, "MS2 resource manager"),
        (0, 50, "MS2 connection 0"),
        (48, 50, "MS2 connection 48"),
        (0, 62, "SAP 0"),
        (None, 0, "SAP none/0"),
        (63, None, "SAP 63"),
    ],
)
def test_services_by_sap_in_both_directions(dsap: int | None, ssap: int | None, name: str) -> None:
    assert service(Telegram(Kind.SD2, 3, 2, 0x7D, dsap, ssap, b"x")) == name
    assert service(Telegram(Kind.SD2, 2, 3, 0x08, ssap, dsap, b"x")) == name


def test_other_services() -> None:
    assert service(SHORT_ACK) == "SC"
    assert service(token(1, 2)) == "token"
    for fc, name in (
        (0x40, "Time_Event"),
        (0xC0, "Clock_Value"),
        (0x47, "MSRD"),
        (0x4E, "Ident"),
        (0x4F, "LSAP_Status"),
    ):
        assert service(Telegram(Kind.SD1, 3, 2, fc)) == name


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
        f"      start us  gap bits  sender     {'octets':<{pad}}  telegram",
        f"      1000.000            2          {'dc 02 02':<{pad}}  token 2 -> 2 (to itself)",
        f"      1140.000        37  master     {'10 03 02 49 4e 16':<{pad}}  FDL_Status request 2 -> 3 (FC 0x49)",
        f"      1294.500        11  ?          {'10 02 03 00 05 16':<{pad}}  acknowledgement 3 -> 2 (OK, slave)"
        "  [too early]",
        f"      1390.000        -5  3          {hexed}  no telegram: bad start",
    ]
    assert render(log, 500_000).splitlines() == expected


def test_an_empty_log_is_a_heading() -> None:
    assert render([], 500_000).split() == ["start", "us", "gap", "bits", "sender", "octets", "telegram"]


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
