"""The answer to Request Ident in `dpstack decode`: its four texts, which are foreign and never reach a terminal raw."""

from __future__ import annotations

import pytest
from octet_slave import frame

from dpstack.capture.transmission import Transmission
from dpstack.decode.telegram import Explained, explain

#: Request Ident and Request LSAP Status of master 2 to station 5, SD1 with FC 4E and 4F
ASK = bytes.fromhex("10 05 02 4E 55 16")
ASK_LSAP = bytes.fromhex("10 05 02 4F 56 16")
TEXTS = b"\x07\x05\x01\x03SIEMENSASPC24" + b"1V1"


def answer(data: bytes) -> bytes:
    return frame(b"\x02\x05\x08" + data)


def seen(*telegrams: bytes) -> list[Explained]:
    return list(explain(Transmission(octets, None, 0) for octets in telegrams))


def test_the_four_texts() -> None:
    _, found = seen(ASK, answer(TEXTS))
    assert found.fields == {
        "Vendor_Name": "SIEMENS",
        "Controller_Type": "ASPC2",
        "HW_Release": "4",
        "SW_Release": "1V1",
    }
    assert found.service == "Ident"
    assert found.text == (
        "Ident answer 5 -> 2, 20 octets: vendor 'SIEMENS', controller 'ASPC2', hardware '4', software '1V1' (DL, slave)"
    )


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"\x01\x02", "Ident: 2 octets; the four lengths alone take 4"),
        (b"\x09\x05\x01\x03abc", "Ident: octets 1 to 4 say lengths 9, 5, 1, 3, and 3 octets follow"),
    ],
)
def test_lengths_that_do_not_fit(data: bytes, says: str) -> None:
    _, found = seen(ASK, answer(data))
    assert (found.fields, found.error) == ({}, says)
    assert found.text.startswith(f"Ident answer 5 -> 2, {len(data)} octets: cannot be read ({says})")


def test_foreign_characters_are_escaped() -> None:
    _, found = seen(ASK, answer(b"\x06\x03\x02\x01\x1b[31m\x07caf\xe9\x80\xad"))
    assert found.fields["Vendor_Name"] == "\\x1b[31m\\x07"
    assert found.fields["SW_Release"] == "\\xad"
    assert found.text.isprintable()


def test_an_answer_without_that_request_is_no_ident() -> None:
    for asked in ((), (frame(bytes.fromhex("05 02 5D 01")),)):
        found = seen(*asked, answer(TEXTS))[-1]
        assert "Vendor_Name" not in found.fields
        assert found.text.startswith("Data_Exchange answer 5 -> 2")


def test_lsap_status_is_named() -> None:
    _, found = seen(ASK_LSAP, answer(b"\x7f\x00\x13"))
    assert found.text.startswith("LSAP_Status answer 5 -> 2, 3 octets")
    assert found.fields == {}
