"""PPI telegrams of an S7-200 explained, at octets that users of real CPUs wrote down.

picproje.org, topic 28390: a SCADA system reads QB0 and QW0. S7PpiMonitor, a monitor for PPI: its conversation with a
CPU. iottree: comments of its PPI driver. libnodave: its first telegram.
"""

from __future__ import annotations

import functools
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import convert

from dpstack.api.config.config import parse_config
from dpstack.api.listen.names import decode_names
from dpstack.capture.transmission import Transmission
from dpstack.decode.names import NO_NAMES, Names
from dpstack.decode.telegram import Explained, explain
from dpstack.decode.words import describe_octets
from dpstack.fdl.codec import encode
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.ppi.addresses import parse_address

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


#: names for the values in the conversations above
PLANT = """
[bus]
port = "virtual"
baud = 9600

[[ppi]]
address = 2
name = "press"
[ppi.values]
outputs = "QB0"
pump = "Q0.3"
mode = { at = "MB10", words = { 0 = "stopped", 1 = "running" } }
flow = { at = "VD300:real", unit = "l/min" }
level = { at = "VW304", scale = 0.01, offset = -100, unit = "cm" }
count = "VD200"
recipe = "VB298[4]"
delay = "T33"
"""


def explained(*telegrams: str | bytes, names: Names = NO_NAMES) -> list[Explained]:
    octets = (bytes.fromhex(one) if isinstance(one, str) else one for one in telegrams)
    return list(explain((Transmission(one) for one in octets), names))


def words(*telegrams: str | bytes, names: Names = NO_NAMES) -> list[str]:
    """What PDUs say, without the addresses, length and control of their telegrams."""
    found = explained(*telegrams, names=names)
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


def test_a_poll_of_the_gap_at_the_address_of_a_cpu_is_none_of_ppi() -> None:
    status = "10 02 00 49 4B 16"
    assert [one.service for one in explained(QB0, "E5", status, POLL)] == ["PPI", "PPI", "FDL_Status", "PPI"]


def test_an_answer_to_a_request_without_a_function() -> None:
    """No CPU is asked so; any octets have words."""
    empty = encode(Telegram(Kind.SD2, 2, 0, 0x6C, data=bytes.fromhex("32 02 0000 0000 0000 0000 0000")))
    assert words(empty, MODE_DONE) == ["done", "go to STOP: done"]


def test_a_telegram_alone_is_described_as_ppi() -> None:
    assert [describe_octets(bytes.fromhex(one)) for one in (QB0, QB0_IS_0, MODE_DONE, POLL)] == [
        "PPI request 0 -> 2, 24 octets: read QB0 (SRD low, FCV=0 FCB=1)",
        "PPI answer 2 -> 0, 19 octets: item 1 = 00 (DL, slave)",
        "PPI answer 2 -> 0, 13 octets: go to STOP: done (DL, slave)",
        "Data_Exchange request 0 -> 2 (SRD low, FCV=1 FCB=0)",
    ]
    other = Telegram(Kind.SD2, 3, 2, 0x6D, data=b"2 rpm")
    assert describe_octets(encode(other)).startswith("Data_Exchange request 2 -> 3, 5 octets (")


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


@functools.cache
def plant_names() -> Names:
    return decode_names(parse_config(PLANT))


@pytest.mark.parametrize(
    ("asked", "answered", "texts"),
    [
        (QB0, QB0_IS_0, ["read QB0 (outputs, pump)", "QB0 = 0 (outputs = 0, pump = off)"]),
        (
            SEVEN,
            SEVEN_VALUES,
            [
                "read IW0, QB0 (outputs, pump), MB0, MB10 (mode), VB100, VB110, VD200 (count)",
                "IW0 = 0, QB0 = 9 (outputs = 9, pump = on), MB0 = 0, MB10 = 0 (mode = stopped (0)), VB100 = 0, "
                "VB110 = 0, VD200 = 4653166 (count = 4653166)",
            ],
        ),
        # of VB298[4] only a part is read
        (
            TWELVE,
            TWELVE_OCTETS,
            [
                "read VB300[12] (flow, level)",
                "VB300[12] = 43 6c 99 b2 43 15 80 0b 43 33 66 76 (flow = 236.6 l/min, level = 71.73 cm)",
            ],
        ),
        (
            WRITE,
            WRITTEN,
            ["write VD300 = 1159757824 (real 2568) (flow = 2568 l/min)", "VD300 (flow) written"],
        ),
        (TIMERS, TIMER_VALUES, ["read T32[3] (delay)", "T32[3] = 32767, 0, 0 (delay = 0)"]),
    ],
)
def test_values_have_the_names_of_the_plant_file(asked: str, answered: str, texts: list[str]) -> None:
    assert words(asked, answered, names=plant_names()) == texts
    found = explained(asked, answered, names=plant_names())
    assert [(one.sender, one.receiver) for one in found] == [("", "press"), ("press", "")]
    other = decode_names(parse_config(PLANT.replace("address = 2", "address = 3")))
    assert words(asked, answered, names=other) == words(asked, answered)


def test_named_values_are_scaled_in_the_fields() -> None:
    request, values = explained(TWELVE, TWELVE_OCTETS, names=plant_names())
    assert request.fields["items"] == [{"address": "VB300[12]", "names": ["flow", "level"]}]
    (item,) = convert(values.fields["items"], list[dict[str, object]])
    assert item["values"] == {"flow": pytest.approx(236.6, abs=1e-3), "level": 71.73}
    assert "names" not in item
    assert (item["address"], item["octets"]) == ("VB300[12]", "436c99b24315800b43336676")
    # an octet too few, and no number
    short = answer("32 03 0000 2658 0002 0006 0000 04 01 FF 04 0010 7FC0")
    (item,) = convert(explained(TWELVE, short, names=plant_names())[1].fields["items"], list[dict[str, object]])
    assert item == {"address": "VB300[12]", "names": ["flow", "level"], "octets": "7fc0", "value": 0x7FC0}
    whole = answer("32 03 0000 2658 0002 0008 0000 04 01 FF 04 0020 7FC00000")
    (item,) = convert(explained(TWELVE, whole, names=plant_names())[1].fields["items"], list[dict[str, object]])
    assert item["values"] == {"flow": None}
    no_such = answer("32 03 0000 2658 0002 0004 0000 04 01 05 00 0000")
    assert words(TWELVE, no_such, names=plant_names())[1].startswith("VB300[12] (flow, level) refused: ")


@pytest.mark.parametrize("text", ["VB0", "VW1", "VD2:real", "V1.0", "V3.7", "V0.0", "VB0[4]", "VB1[2]", "VB9"])
@pytest.mark.parametrize("block", ["VB0[4]", "VW1", "VD0", "V1.0", "VB2[2]"])
def test_a_value_has_a_name_in_each_item_with_all_its_octets(block: str, text: str) -> None:
    """By the numbers of octets and bits, for which this test keeps a memory of its own."""
    memory = bytes.fromhex("81 9C 3A F0")
    asked, wanted = parse_address(block), parse_address(text)
    names = decode_names(parse_config(PLANT[: PLANT.index("outputs")] + f'value = "{text}"'))
    pdu = b"\x32\x01" + bytes(4) + b"\x00\x0e\x00\x00\x04\x01" + asked.item
    at, bit = divmod(asked.start, 8)
    data = bytes((memory[at] >> bit & 1,)) if asked.size == 1 else memory[at : at + asked.length]
    bits = (b"\x03\x00\x01" if asked.size == 1 else b"\x04" + (8 * len(data)).to_bytes(2, "big")) + data
    told = answer((b"\x32\x03" + bytes(5) + b"\x02" + bytes((0, 3 + 1 + len(data), 0, 0, 4, 1, 255)) + bits).hex())
    request, answered = explained(encode(Telegram(Kind.SD2, 2, 0, 0x6C, data=pdu)), told, names=names)
    (item,) = convert(answered.fields["items"], list[dict[str, object]])
    spans = [range(one.start, one.start + (1 if one.size == 1 else 8 * one.length)) for one in (asked, wanted)]
    if set(spans[1]) <= set(spans[0]):
        at, bit = divmod(wanted.start, 8)
        own = bytes((memory[at] >> bit & 1,)) if wanted.size == 1 else memory[at : at + wanted.length]
        value = wanted.value(own)
        assert item["values"] == {"value": value.hex() if isinstance(value, bytes) else value}
        assert convert(request.fields["items"], list[dict[str, object]])[0]["names"] == ["value"]
    else:
        assert not item.keys() & {"values", "names"}


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
    telegram = encode(Telegram(Kind.SD2, *((2, 0, 0x6C) if asked else (0, 2, 0x08)), data=pdu))
    for one in explained(QB0, telegram, names=plant_names()):
        assert one.text.isprintable()
        json.dumps(one.as_dict())
