"""PPI telegrams of an S7-200 explained, at octets that users of real CPUs wrote down.

picproje.org, topic 28390: a SCADA system reads QB0 and QW0. S7PpiMonitor, a monitor for PPI: its conversation with a
CPU. iottree: comments of its PPI driver. libnodave: its first telegram.
"""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import convert

from dpstack.capture.transmission import Transmission
from dpstack.decode.telegram import Explained, explain
from dpstack.fdl.codec import encode
from dpstack.fdl.telegram import Kind, Telegram

QB0 = "68 1B 1B 68 02 00 6C 32 01 00 00 00 00 00 0E 00 00 04 01 12 0A 10 02 00 01 00 00 82 00 00 00 65 16"
QB0_IS_0 = "68 16 16 68 00 02 08 32 03 00 00 00 00 00 02 00 05 00 00 04 01 FF 04 00 08 00 56 16"
QW0 = "68 1B 1B 68 02 00 6C 32 01 00 00 00 00 00 0E 00 00 04 01 12 0A 10 04 00 01 00 00 82 00 00 00 67 16"
QW0_IS_0 = "68 17 17 68 00 02 08 32 03 00 00 00 00 00 02 00 06 00 00 04 01 FF 04 00 10 00 00 5F 16"
POLL, RR = "10 02 00 5C 5E 16", "10 00 02 02 04 16"
SEVEN = (
    "68 63 63 68 02 00 7C 32 01 00 00 26 59 00 56 00 00 04 07 12 0A 10 02 00 02 00 00 81 00 00 00 12 0A 10 02 00 01 00"
    " 00 82 00 00 00 12 0A 10 02 00 01 00 00 83 00 00 00 12 0A 10 02 00 01 00 00 83 00 00 50 12 0A 10 02 00 01 00 01 84"
    " 00 03 20 12 0A 10 02 00 01 00 01 84 00 03 70 12 0A 10 02 00 04 00 01 84 00 06 40 A2 16"
)
SEVEN_VALUES = (
    "68 3D 3D 68 00 02 08 32 03 00 00 26 59 00 02 00 2C 00 00 04 07 FF 04 00 10 00 00 FF 04 00 08 09 00 FF 04 00 08 00"
    " 00 FF 04 00 08 00 00 FF 04 00 08 00 00 FF 04 00 08 00 00 FF 04 00 20 00 47 00 6E 22 16"
)
TWELVE = "68 1B 1B 68 02 00 7C 32 01 00 00 26 58 00 0E 00 00 04 01 12 0A 10 02 00 0C 00 01 84 00 09 60 6A 16"
TWELVE_OCTETS = (
    "68 21 21 68 00 02 08 32 03 00 00 26 58 00 02 00 10 00 00 04 01 FF 04 00 60 43 6C 99 B2 43 15 80 0B 43 33 66 76"
    " 66 16"
)
WRITE = (
    "68 23 23 68 02 00 7C 32 01 00 00 27 34 00 0E 00 08 05 01 12 0A 10 02 00 04 00 01 84 00 09 60 00 04 00 20 45 20 80"
    " 00 51 16"
)
WRITTEN = "68 12 12 68 00 02 08 32 03 00 00 27 34 00 02 00 01 00 00 05 01 FF A2 16"
RUN = (
    "68 21 21 68 02 00 6C 32 01 00 00 00 00 00 14 00 00 28 00 00 00 00 00 00 FD 00 00 09 50 5F 50 52 4F 47 52 41 4D AA"
    " 16"
)
STOP = "68 1D 1D 68 02 00 6C 32 01 00 00 00 00 00 10 00 00 29 00 00 00 00 00 09 50 5F 50 52 4F 47 52 41 4D AA 16"
MODE_DONE = "68 10 10 68 00 02 08 32 03 00 00 00 00 00 01 00 00 00 00 29 69 16"
TIMERS = "68 1B 1B 68 02 00 6C 32 01 00 00 00 00 00 0E 00 00 04 01 12 0A 10 1F 00 03 00 00 1F 00 00 20 41 16"
TIMER_VALUES = (
    "68 24 24 68 00 02 08 32 03 00 00 00 00 00 02 00 13 00 00 04 01 FF 09 00 0F 02 00 00 7F FF 00 00 00 00 00 00 00 00"
    " 00 00 F0 16"
)
FIRST = "68 15 15 68 02 00 6C 32 01 00 00 00 00 00 08 00 00 F0 00 00 01 00 01 03 C0 5E 16"


def explained(*telegrams: str | bytes) -> list[Explained]:
    octets = (bytes.fromhex(one) if isinstance(one, str) else one for one in telegrams)
    return list(explain(Transmission(one) for one in octets))


def words(*telegrams: str | bytes) -> list[str]:
    """What PDUs say, without the addresses, length and control of their telegrams."""
    found = explained(*telegrams)
    assert [one.error for one in found] == [None] * len(found)
    return [str(one.fields.get("text", one.text)) for one in found]


def answer(pdu: str) -> bytes:
    return encode(Telegram(Kind.SD2, 0, 2, 0x08, data=bytes.fromhex(pdu)))


def test_a_read_with_its_polls() -> None:
    texts = [one.text for one in explained(QB0, "E5", POLL, RR, "10 02 00 7C 7E 16", QB0_IS_0)]
    assert texts == [
        "PPI request 0 -> 2, 24 octets: read QB0 (SRD low, FCV=0 FCB=1)",
        "SC 2 -> 0, acknowledges PPI",
        "PPI request 0 -> 2 (SRD low, FCV=1 FCB=0)",
        "acknowledgement 2 -> 0 (RR, slave)",
        "PPI request 0 -> 2 (SRD low, FCV=1 FCB=1)",
        "PPI answer 2 -> 0, 19 octets: QB0 = 0 (DL, slave)",
    ]


@pytest.mark.parametrize(
    ("asked", "answered", "texts"),
    [
        (QW0, QW0_IS_0, ["read QW0", "QW0 = 0"]),
        (TWELVE, TWELVE_OCTETS, ["read VB300[12]", "VB300[12] = 43 6c 99 b2 43 15 80 0b 43 33 66 76"]),
        (
            SEVEN,
            SEVEN_VALUES,
            [
                "read IW0, QB0, MB0, MB10, VB100, VB110, VD200",
                "IW0 = 0, QB0 = 9, MB0 = 0, MB10 = 0, VB100 = 0, VB110 = 0, VD200 = 4653166",
            ],
        ),
        (WRITE, WRITTEN, ["write VD300 = 1159757824 (real 2568)", "VD300 written"]),
        (STOP, MODE_DONE, ["go to STOP", "go to STOP: done"]),
        (RUN, MODE_DONE, ["go to RUN", "go to RUN: done"]),
        (TIMERS, TIMER_VALUES, ["read T32[3]", "T32[3] = 32767, 0, 0"]),
    ],
)
def test_what_is_asked_and_answered(asked: str, answered: str, texts: list[str]) -> None:
    assert words(asked, answered) == texts
    assert [one.service for one in explained(asked, "E5", POLL, answered)] == ["PPI"] * 4


def test_fields_are_numbers_and_octets() -> None:
    request, values = explained(SEVEN, SEVEN_VALUES)
    asked, answered = (convert(one.fields["items"], list[dict[str, object]]) for one in (request, values))
    assert asked[0] == {"address": "IW0"}
    assert answered[-1] == {"address": "VD200", "octets": "0047006e", "value": 4653166}
    assert (values.fields["PPI_PDU"], values.fields["Sequence"]) == ("answer", 0x2659)
    json.dumps([one.as_dict() for one in (request, values)])


def test_an_answer_without_its_request_has_no_addresses() -> None:
    assert words(SEVEN_VALUES)[0].startswith("item 1 = 00 00, item 2 = 09, ")
    # nor one to an earlier request
    assert words(SEVEN, TWELVE_OCTETS)[1] == "item 1 = 43 6c 99 b2 43 15 80 0b 43 33 66 76"
    assert words(WRITTEN) == ["item 1 written"]


def test_refusals_and_lengths() -> None:
    # errors: a read of VB9999 that the CPU does not have, as libnodave's codes are; an acknowledgement with an error
    no_such = answer("32 03 0000 0000 0002 0004 0000 04 01 05 00 0000")
    assert words(QB0, no_such)[1] == "QB0 refused: the address is beyond this CPU's memory (code 05h)"
    refused = answer("32 02 0000 0007 0000 0000 8104")
    assert words(refused)[0].startswith("refused: the CPU does not have this function")
    locked = answer("32 03 0000 0000 0000 0000 8001")
    assert words(RUN, locked)[1] == "refused: not allowed in the present mode of the CPU (error 8001h)"
    assert words(WRITE, answer("32 03 0000 2734 0002 0001 0000 05 01 03"))[1].startswith("VD300 refused: access is not")
    length = answer("32 03 0000 0000 0008 0000 0000 F0 00 00 01 00 01 00 F0")
    assert words(FIRST, length) == ["PDUs of up to 960 octets?", "PDUs of up to 240 octets"]


def test_the_clock() -> None:
    """libnodave's default time stamp: 23 August 2005, 04:10:23.678."""
    time = "00 19 05 08 23 04 10 23 67 83"
    asks = Telegram(
        Kind.SD2, 2, 0, 0x6C, data=bytes.fromhex("32 07 0000 0005 0008 000E 00 01 12 04 11 47 02 00 FF 09 000A" + time)
    )
    read = Telegram(
        Kind.SD2, 2, 0, 0x6C, data=bytes.fromhex("32 07 0000 0006 0008 0004 00 01 12 04 11 47 01 00 0A 00 0000")
    )
    said = answer("32 07 0000 0006 000C 000E 00 01 12 08 12 87 01 00 00 00 00 00 FF 09 000A" + time)
    assert words(encode(asks), encode(read), said) == [
        "set the clock to 2005-08-23 04:10:23.678",
        "read the clock",
        "read the clock: 2005-08-23 04:10:23.678",
    ]


def test_outputs_of_a_dp_slave_are_none() -> None:
    """The slave was parameterised within the log."""
    set_prm = encode(Telegram(Kind.SD2, 2, 0, 0x5D, 61, 62, bytes.fromhex("80 00 00 0B 12 34 00")))
    _, outputs = explained(set_prm, QB0)
    assert (outputs.service, outputs.fields) == ("Data_Exchange", {})


def test_an_address_that_nobody_knows_is_shown_by_its_numbers() -> None:
    other = Telegram(
        Kind.SD2, 2, 0, 0x6C, data=bytes.fromhex("32 01 0000 0000 000E 0000 04 01 12 0A 10 08 00 03 00 05 84 00 00 10")
    )
    assert words(encode(other)) == ["read area 0x84, block 5, bit 16, 3 of size 0x08"]


@given(st.sampled_from([1, 2, 3, 7]), st.binary(max_size=40), st.binary(max_size=40), st.booleans())
def test_any_pdu_has_words(kind: int, parameter: bytes, data: bytes, asked: bool) -> None:
    error = b"\0\0" if kind in (2, 3) else b""
    lengths = len(parameter).to_bytes(2, "big") + len(data).to_bytes(2, "big")
    pdu = bytes((0x32, kind, 0, 0, 0, 0)) + lengths + error + parameter + data
    for one in explained(QB0, encode(Telegram(Kind.SD2, *((2, 0, 0x6C) if asked else (0, 2, 0x08)), data=pdu))):
        assert one.text.isprintable()
        json.dumps(one.as_dict())
