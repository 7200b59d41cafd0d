"""The makers' printed DIAGNOSIS octets and blocks of Slave_Diag, held to the words."""

from __future__ import annotations

import pytest

from dpstack.dp.pdu.alarm_blocks import parse_block
from dpstack.pa.diagnosis import BITS, diagnosis_bits, diagnosis_words
from tests.pa.makers_octets import DIAG_BLOCKS, DIAGNOSES, DiagBlock, Diagnosis


@pytest.mark.parametrize("row", DIAGNOSES, ids=lambda row: f"{row.source.device}-{row.octets}".replace(" ", "-"))
def test_printed_bit(row: Diagnosis) -> None:
    octets = bytes.fromhex(row.octets)
    (words,) = diagnosis_words(octets)
    assert row.says in words
    (bit,) = diagnosis_bits(octets)
    assert octets[bit.octet - 1] == bit.mask


@pytest.mark.parametrize("row", DIAG_BLOCKS, ids=lambda row: f"{row.source.device}-{row.octets}".replace(" ", "-"))
def test_printed_block(row: DiagBlock) -> None:
    text = parse_block(bytes.fromhex(row.octets)).full_text
    assert [said for said in row.says if said not in text] == []


def test_every_bit_is_printed_by_a_maker() -> None:
    printed = {int.from_bytes(bytes.fromhex(row.octets), "little") for row in DIAGNOSES}
    assert printed == {bit.mask << 8 * (bit.octet - 1) for bit in BITS}
    assert len({row.source.maker for row in DIAGNOSES}) >= 5
