"""DIAGNOSIS of PROFIBUS PA inside Slave_Diag: printed examples, beside a GSD file, and lengths of other makers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.dp.pdu.alarm_blocks import Status, parse_block
from dpstack.dp.pdu.diag_blocks import DeviceBlock
from dpstack.dp.pdu.diag_texts import texts_of
from dpstack.dp.pdu.pa_diagnosis import BITS, Category, category_of, diagnosis_bits, diagnosis_words, extension_words
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.parser import parse_gsd


@pytest.mark.parametrize(
    ("octets", "text"),
    [
        # Siemens SITRANS F M TRANSMAG 2 (A5E00102775-07) p99: tube empty; memory failure beside it; all gone
        (
            "08 FE 01 01 20 00 00 80",
            "PROFIBUS PA diagnosis, slot 1, a message appears, measurement failed (failure), "
            "more in DIAGNOSIS_EXTENSION",
        ),
        (
            "08 FE 01 01 30 00 00 80",
            "PROFIBUS PA diagnosis, slot 1, a message appears, memory error (failure), measurement failed (failure), "
            "more in DIAGNOSIS_EXTENSION",
        ),
        (
            "08 FE 01 02 00 00 00 80",
            "PROFIBUS PA diagnosis, slot 1, a message disappears, more in DIAGNOSIS_EXTENSION",
        ),
        # Samson 3730-4 (KH 8384-4) p31, p32: 14 octets, with the maker's six; bit 4 of the second of them is
        # "initialization/solenoid valve"
        (
            "0E FE 00 01 00 20 00 80 00 10 00 00 00 00",
            "PROFIBUS PA diagnosis, slot 0, a message appears, maintenance required, more in DIAGNOSIS_EXTENSION, "
            "maker's bit 13",
        ),
        ("08 FE 00 02 00 00 00 00", "PROFIBUS PA diagnosis, slot 0, a message disappears, nothing to report"),
        # Pepperl+Fuchs F2D0-MIO-Ex12.PA (07/2018) p43: one octet of its own, bit 0 hardware error
        (
            "09 FE 00 01 00 20 00 80 01",
            "PROFIBUS PA diagnosis, slot 0, a message appears, maintenance required, more in DIAGNOSIS_EXTENSION, "
            "maker's bit 1",
        ),
        # too short for DIAGNOSIS
        ("07 FE 01 01 20 00 00", "vendor status 126, slot 1, appears, slot disturbed, data 20 00 00"),
        ("04 FE 01 00", "vendor status 126, slot 1"),
    ],
)
def test_printed_blocks(octets: str, text: str) -> None:
    block = parse_block(bytes.fromhex(octets))
    assert isinstance(block, Status)
    assert block.full_text == text
    assert block.build() == bytes.fromhex(octets)


def test_beside_a_gsd_file() -> None:
    """The maker's own texts are more exact: the profile's words are not repeated beside them."""
    block = DeviceBlock(bytes.fromhex("08 FE 01 01 20 00 00 80"))
    assert texts_of([block], None, dpv1=True) == (
        "PROFIBUS PA diagnosis, slot 1, a message appears, measurement failed (failure), more in DIAGNOSIS_EXTENSION",
    )
    gsd = '#Profibus_DP\nGSD_Revision=3\nUnit_Diag_Bit(29)="Tube empty"\n'
    texts = DiagTexts(parse_gsd(gsd.encode()).device)
    assert texts_of([block], texts, dpv1=True) == (
        "PROFIBUS PA diagnosis, slot 1, a message appears",
        "Tube empty",
    )


def test_worst_first() -> None:
    assert diagnosis_words(bytes.fromhex("08 28 04 80")) == (
        "in function check, simulation or local operation",
        "electronics too hot (out of specification)",
        "maintenance required",
        "warm start",
        "more in DIAGNOSIS_EXTENSION",
    )
    assert category_of(bytes.fromhex("08 28 04 80")) is Category.FUNCTION_CHECK
    assert category_of(bytes.fromhex("00 18 00 80")) is None
    assert category_of(b"") is None


def test_condensed_bits() -> None:
    # Siemens SIPART PS2 (A5E00127926-AC) p225, p208: the bits with the condensed status
    names = {bit.name for bit in BITS if bit.condensed}
    assert names == {
        "DIA_WARMSTART",
        "DIA_COLDSTART",
        "DIA_MAINTENANCE",
        "IDENT_NUMBER_VIOLATION",
        "DIA_MAINTENANCE_ALARM",
        "DIA_MAINTENANCE_DEMANDED",
        "DIA_FUNCTION_CHECK",
        "DIA_INV_PRO_COND",
        "UPDATE_EVENT",  # TRICOR TCD p14
        "EXTENSION_AVAILABLE",
    }


def test_extension() -> None:
    names = {1: "run time error", 6: "binary 2\x1b[2J"}
    assert extension_words(bytes.fromhex("21 00 00 00 00 80"), names) == (
        "run time error",
        r"binary 2\x1b[2J",
        "maker's bit 48",
    )
    assert extension_words(b"\x01") == ("maker's bit 1",)


@given(st.binary(max_size=8))
def test_any_octets(octets: bytes) -> None:
    bits = diagnosis_bits(octets)
    assert sum(bit.mask << 8 * (bit.octet - 1) for bit in bits) == int.from_bytes(octets[:4], "little")
    assert len(diagnosis_words(octets)) == len(bits)
    assert len(extension_words(octets)) == sum(octet.bit_count() for octet in octets)
