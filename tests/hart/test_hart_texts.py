"""Packed ASCII, units, makers, response codes and status of HART in words."""

from __future__ import annotations

import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.errors import PduError
from dpstack.hart.status import (
    additional_status_texts,
    device_status_texts,
    extended_status_texts,
    is_warning,
    response_text,
)
from dpstack.hart.tables import (
    date_text,
    known_units,
    latin_text,
    maker_text,
    pack_ascii,
    unit_text,
    unpack_ascii,
)


def test_packed_ascii_as_it_is_described_in_public() -> None:
    """Four blanks are 82 08 20, four question marks FF FF FF."""
    assert pack_ascii("", 4) == bytes.fromhex("82 08 20")
    assert pack_ascii("????", 4) == bytes.fromhex("FF FF FF")
    assert unpack_ascii(bytes.fromhex("FF FF FF")) == "????"
    assert unpack_ascii(bytes.fromhex("E3 2D F1 DF 0C F0")) == "82717030"  # serial number of a Brooks as its tag


@given(st.text(string.ascii_uppercase + string.digits + " !#/-_[]^@?", max_size=16))
def test_packed_ascii_there_and_back(text: str) -> None:
    assert unpack_ascii(pack_ascii(text, 16)) == text.rstrip()


@given(st.binary(max_size=24).map(lambda octets: octets[: len(octets) // 3 * 3]))
def test_any_octets_are_packed_ascii(octets: bytes) -> None:
    text = unpack_ascii(octets)
    assert all(" " <= letter <= "_" for letter in text)
    assert pack_ascii(text, len(octets) * 4 // 3) == octets


@pytest.mark.parametrize(
    ("text", "why"), [("pump", "not 'p'"), ("A" * 9, "9 characters, 8 are possible"), ("Ä", "not 'Ä'")]
)
def test_texts_that_do_not_fit(text: str, why: str) -> None:
    with pytest.raises(PduError, match=why):
        pack_ascii(text, 8)


def test_packed_ascii_of_a_wrong_length() -> None:
    with pytest.raises(PduError, match="4 octets"):
        unpack_ascii(bytes(4))


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (6, "psi"),
        (7, "bar"),
        (12, "kPa"),
        (17, "l/min"),
        (19, "m³/h"),
        (32, "°C"),
        (39, "mA"),
        (45, "m"),
        (57, "%"),
        (75, "kg/h"),
        (89, "datherm"),
        (91, "g/cm³"),
        (119, "rpm"),
        (139, "ppm"),
        (169, "ppb"),
        (237, "MPa"),
        (239, "mmH2O(4C)"),
        (250, "not used"),
        (251, ""),
        (240, "unit 240 (the maker's own)"),
        (249, "unit 249 (the maker's own)"),
        (170, "unit 170 (its meaning depends on the class of the variable)"),
        (225, "unit 225"),
        (0, "unit 0"),
    ],
)
def test_units(code: int, text: str) -> None:
    assert unit_text(code) == text


def test_the_codes_that_have_a_unit() -> None:
    """Common Table 2 as two public tables have it: 1 to 156, 160 to 169, 235 to 239."""
    assert set(known_units()) == {*range(1, 157), *range(160, 170), *range(235, 240)}


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0x26, "Rosemount (0x26)"),
        (0x2A, "Siemens (0x2A)"),
        (0x42, "Samson (0x42)"),
        (0xA6, "Fluid Components (0xA6)"),
        (0xA7, "unknown (0xA7)"),
        (0, "unknown (0x00)"),
        (0x0062, "VEGA (0x62)"),
        (0x6116, "unknown (0x6116)"),
    ],
)
def test_makers(code: int, text: str) -> None:
    assert maker_text(code) == text


@pytest.mark.parametrize(
    ("code", "text", "warning"),
    [
        (0, "success", False),
        (7, "in write protect mode", False),
        (8, "warning: update failure, update in progress, or set to nearest possible value", True),
        (32, "busy", False),
        (64, "command not implemented", False),
        (65, "response code 65: its meaning depends on the command", False),
        (0x88, "communication error in the request (checksum error)", False),
        (0xD2, "communication error in the request (parity error, framing error, receive buffer overflow)", False),
        (0x80, "communication error in the request (0x80)", False),
    ],
)
def test_response_codes(code: int, text: str, warning: bool) -> None:
    assert (response_text(code), is_warning(code)) == (text, warning)


def test_device_status_and_extended_status() -> None:
    """ET 200SP HA manual (6DL1136-6AA00) p82; Beckhoff EL318x."""
    assert device_status_texts(0) == ()
    assert device_status_texts(0xFF)[0] == "device malfunction"
    assert len(device_status_texts(0xFF)) == 8
    assert extended_status_texts(0x41) == ("maintenance required", "bits 0x40 without a standardized meaning")


def test_additional_status_by_the_revision_of_the_device() -> None:
    """Biffi ICON3000 manual p34 and p35: extended status in octet 6, electronic defect in octet 8."""
    data = bytes.fromhex("0000000000 00 01 00 40 00 01 00 00 02 04")
    assert additional_status_texts(data, 7) == (
        "maintenance required",
        "electronic defect",
        "analog channel 1 saturated",
        "analog channel 2 fixed",
        "byte 14: 0x04 (the maker's own)",
    )
    old = additional_status_texts(bytes.fromhex("0180"), 5)
    assert old == ("byte 0: 0x01 (the maker's own)", "byte 1: 0x80 (the maker's own)")
    assert additional_status_texts(bytes(9), 7) == ()
    assert additional_status_texts(bytes.fromhex("000000000000 00 03"), 7) == ("operating mode 3",)


@given(st.binary(max_size=30), st.integers(0, 255))
def test_any_additional_status_is_words(data: bytes, revision: int) -> None:
    assert all(additional_status_texts(data, revision)) or not any(data)


def test_dates_and_latin_texts() -> None:
    assert date_text(bytes((31, 3, 126))) == "2026-03-31"
    assert date_text(bytes((30, 2, 126))) == "no date (1E 02 7E)"
    assert latin_text("Kühler 7".encode("latin-1").ljust(32, b"\0")) == "Kühler 7"
