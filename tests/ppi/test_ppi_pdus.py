"""PDUs of an S7-200 at octets that are not ours: libnodave's, HslCommunication's, and those of its users."""

from __future__ import annotations

import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.errors import PduError, UsageError
from dpstack.fdl.codec import encode
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.ppi.addresses import AREAS, PpiAddress, parse_address
from dpstack.ppi.pdu import (
    ReturnCode,
    clock_octets,
    fit,
    item_error,
    negotiate_request,
    parse_clock,
    parse_pdu,
    pdu_error,
    read_items,
    read_request,
    run_request,
    set_clock_request,
    stop_request,
    write_request,
)


def telegram(pdu: bytes) -> bytes:
    """The telegram of a request from station 0 to station 2."""
    return encode(Telegram(Kind.SD2, 2, 0, 0x6C, data=pdu))


def test_the_first_telegram_of_libnodave() -> None:
    octets = "68 15 15 68 02 00 6C 32 01 00 00 00 00 00 08 00 00 F0 00 00 01 00 01 03 C0 5E 16"
    assert telegram(negotiate_request(0).octets) == bytes.fromhex(octets)


def test_read_of_an_output_octet() -> None:
    octets = "68 1B 1B 68 02 00 6C 32 01 00 00 00 00 00 0E 00 00 04 01 12 0A 10 02 00 01 00 00 82 00 00 00 65 16"
    request = read_request(0, [parse_address("QB0")])
    assert telegram(request.octets) == bytes.fromhex(octets)


def test_run_and_stop_of_hslcommunication() -> None:
    run = (
        "68 21 21 68 02 00 6C 32 01 00 00 00 00 00 14 00 00 28 00 00 00 00 00 00 FD 00 00 09 50 5F 50 52 4F 47 52 41 4D"
    )
    stop = "68 1D 1D 68 02 00 6C 32 01 00 00 00 00 00 10 00 00 29 00 00 00 00 00 09 50 5F 50 52 4F 47 52 41 4D"
    assert telegram(run_request(0).octets) == bytes.fromhex(run + "AA 16")
    assert telegram(stop_request(0).octets) == bytes.fromhex(stop + "AA 16")


def test_clock_of_libnodave() -> None:
    # its default time stamp: 00 19 05 08 23 04 10 23 67 83, 23 August 2005, 04:10:23.678, Tuesday
    octets = bytes.fromhex("00 19 05 08 23 04 10 23 67 83")
    time = datetime.datetime(2005, 8, 23, 4, 10, 23, 678000)
    assert parse_clock(octets) == time
    assert clock_octets(time)[2:] == octets[2:]
    request = set_clock_request(5, time)
    assert request.parameter == bytes((0, 1, 18, 4, 17, ord("G"), 2, 0))


@pytest.mark.parametrize(
    ("text", "area", "item"),
    [
        ("VW100", "V", "12 0A 10 02 00 02 00 01 84 00 03 20"),
        ("vb0[16]", "V", "12 0A 10 02 00 10 00 01 84 00 00 00"),
        ("M0.3", "M", "12 0A 10 01 00 01 00 00 83 00 00 03"),
        ("SMB28", "SM", "12 0A 10 02 00 01 00 00 05 00 00 E0"),
        ("AIW4", "AI", "12 0A 10 04 00 01 00 00 06 00 00 20"),
        ("T37", "T", "12 0A 10 1F 00 01 00 00 1F 00 00 25"),
        ("C5", "C", "12 0A 10 1E 00 01 00 00 1E 00 00 05"),
    ],
)
def test_items_as_libnodave_builds_them(text: str, area: str, item: str) -> None:
    address = parse_address(text)
    assert address.area is AREAS[area]
    assert address.item == bytes.fromhex(item)


def answer(data: str, items: int) -> bytes:
    octets = bytes.fromhex(data)
    return bytes.fromhex("32 03 0000 0000 0002") + len(octets).to_bytes(2, "big") + bytes((0, 0, 4, items)) + octets


def test_timers_and_counters_as_users_of_an_s7_200_saw_them() -> None:
    # a public serial driver's notes: the value stands one octet behind the status of a counter, and behind three
    # octets for a timer
    addresses = [parse_address("C0"), parse_address("T0")]
    octets = answer("FF 09 0003 00 1234 00 FF 09 0005 00 00001234", 2)
    assert read_items(parse_pdu(octets), addresses) == [0x1234, 0x1234]


def test_values_of_an_answer_with_a_filling_octet() -> None:
    addresses = [parse_address(text) for text in ("VB0", "VW100:int", "M0.1", "VD8:real", "AIW0", "V9999.0")]
    octets = answer(
        "FF 04 0008 2A 00  FF 04 0010 FFFE  FF 03 0001 01 00  FF 04 0020 3F800000  FF 04 0010 8000  05 00 0000", 6
    )
    values = read_items(parse_pdu(octets), addresses)
    assert values == [42, -2, True, 1.0, -32768, 5]
    assert isinstance(values[-1], ReturnCode)
    assert item_error(values[-1]) == "the address is beyond this CPU's memory (code 05h)"


def test_writes() -> None:
    request = write_request(1, parse_address("V10.3"), True)
    assert request.data == bytes.fromhex("00 03 0001 01")
    assert write_request(1, parse_address("VW2"), 258).data == bytes.fromhex("00 04 0010 0102")


@pytest.mark.parametrize(
    "text",
    ["", "X1", "VW", "V10", "V10.8", "VB0[0]", "VB0[201]", "VW0[2]", "VD0:int", "AIW1", "AI0.1", "T", "V999999.0"],
)
def test_no_addresses(text: str) -> None:
    with pytest.raises(UsageError):
        parse_address(text)


@pytest.mark.parametrize(
    ("text", "value", "message"),
    [
        ("VW0", 65536, "0 to 65535"),
        ("VW0:int", -32769, "-32768 to 32767"),
        ("VB0", 1.5, "whole number"),
        ("VB0", True, "whole number"),
        ("VD0:real", 1e39, "floating point"),
        ("VD0:real", float("nan"), "a number"),
        ("M0.0", 2, "True or False"),
        ("VB0[2]", b"1", "2 octets"),
        ("T37", 1, "program of the CPU"),
    ],
)
def test_values_that_do_not_fit(text: str, value: float | bytes, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        write_request(0, parse_address(text), value)


def test_errors_in_words() -> None:
    refused = parse_pdu(bytes.fromhex("32 02 0000 0007 0000 0000 8104"))
    assert pdu_error(refused.error).startswith("the CPU does not have this function")
    assert pdu_error(0x1234) == "unknown error (error 1234h)"


def test_requests_fit_a_pdu() -> None:
    words = [parse_address(f"VW{at}") for at in range(0, 100, 2)]
    assert fit(words) == 19
    assert fit([parse_address("VB0[200]")] * 2) == 1
    assert len(read_request(0, words[:19]).octets) <= 240


@given(st.binary(max_size=60))
def test_damaged_answers_end_in_one_error(octets: bytes) -> None:
    addresses = [parse_address("VW0"), parse_address("T1")]
    with pytest.raises(PduError):
        read_items(parse_pdu(b"\x32\x03" + octets), addresses)


_ADDRESSES = st.sampled_from(["VB0", "VW0", "VW2:int", "VD4", "VD4:dint", "M0.1", "V3.7", "QB1", "AQW2", "VB0[7]"]).map(
    parse_address
)


@given(_ADDRESSES, st.data())
def test_values_come_back(address: PpiAddress, data: st.DataObject) -> None:
    octets = data.draw(st.binary(min_size=address.length, max_size=address.length))
    if address.size == 1:
        octets = bytes([octets[0] & 1])
    assert address.octets(address.value(octets)) == octets
