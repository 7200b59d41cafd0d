"""The answers of Request Ident and of Request LSAP Status, at octets put together by hand."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.errors import PduError, UsageError
from dpstack.fdl.services.identity import Ident, SapStatus

OCTETS = bytes.fromhex("07 05 01 03") + b"SIEMENSASPC241V10"


def test_four_texts() -> None:
    assert Ident.parse(OCTETS) == Ident("SIEMENS", "ASPC2", "4", "1V1")
    assert Ident.parse(OCTETS + b"\x00") == Ident.parse(OCTETS)


def test_empty_texts() -> None:
    assert Ident.parse(bytes(4)) == Ident()


@pytest.mark.parametrize("octets", [b"", b"\x01\x00\x00", b"\x01\x00\x00\x00", b"\x00\x00\x00\xff" + b"x" * 200])
def test_lengths_that_do_not_fit(octets: bytes) -> None:
    with pytest.raises(PduError, match="Ident: "):
        Ident.parse(octets)


def test_too_long_and_no_latin_letters() -> None:
    with pytest.raises(UsageError, match="take 197 octets, 196 fit"):
        Ident("x" * 197).build()
    with pytest.raises(UsageError, match="no Latin-1"):
        Ident("\u20ac").build()


LATIN = st.text(st.characters(max_codepoint=255), max_size=49)


@given(LATIN, LATIN, LATIN, LATIN)
def test_there_and_back(vendor: str, controller: str, hardware: str, software: str) -> None:
    ident = Ident(vendor, controller, hardware, software)
    assert Ident.parse(ident.build()) == ident
    assert ident.text.isprintable() or not ident.text.isascii()


@given(st.binary(max_size=246))
def test_any_octets(octets: bytes) -> None:
    """A value, or PduError; and a status of any octets keeps them."""
    with contextlib.suppress(PduError):
        Ident.parse(octets)
    assert SapStatus.parse(octets).octets == octets


def test_the_status_of_a_sap() -> None:
    assert SapStatus.parse(bytes.fromhex("7F 00 10 11 13 30")) == SapStatus(
        bytes.fromhex("7F 00 10 11 13 30"), None, ("none", "responder", "responder", "none")
    )
    assert SapStatus.parse(bytes.fromhex("05 00 20")).access == 5
    assert SapStatus.parse(b"\x05").services == ()
    assert SapStatus.parse(bytes.fromhex("05 00 90")).services == ()
