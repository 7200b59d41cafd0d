"""Record 47 in octets: the manuals' examples both ways, construct as the judge, lengths that lie."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import construct as cs
import pytest
from acyclic_kit import octets
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.errors import PduError
from dpstack.profile import error_text
from dpstack.profile.record47.formats import FORMATS, Format, Raw, format_of
from dpstack.profile.record47.pdu import Address, ErrorValue, Request, Response, Values

# -- the manuals' octets ---------------------------------------------------------------------------------------------

REQUESTS = {
    # docs/reference/drives/ls-s100.md#record-47: read 965; Baumer GE/GB p26 with the subindex that the page leaves out
    "01 01 01 01 10 00 03 C5 00 00": Request(1, 1, 1, (Address(965),)),
    "AA 01 00 01 10 01 03 C5 00 00": Request(0xAA, 1, 0, (Address(965, 0, 1),)),
    # SINAMICS S150 p185: read r0002
    "80 01 01 01 10 01 00 02 00 00": Request(0x80, 1, 1, (Address(2, 0, 1),)),
    # Toshiba PDP003Z p32: 927 := 0
    "01 02 01 01 10 01 03 9F 00 00 06 01 00 00": Request(1, 2, 1, (Address(927, 0, 1),), (Values(6, (0,)),)),
    # all addresses, then all values (SINAMICS p96)
    "05 02 01 02 10 00 04 51 00 00 10 02 02 58 00 01 08 01 41 F0 00 00 05 02 07 09": Request(
        5, 2, 1, (Address(1105), Address(600, 1, 2)), (Values(8, (30.0,)), Values(5, (7, 9)))
    ),
    # an odd value is padded; description and text
    "06 02 00 01 10 01 00 10 00 00 05 01 2A 00": Request(6, 2, 0, (Address(16, 0, 1),), (Values(5, (42,)),)),
    "07 01 00 02 20 01 03 C5 00 00 30 03 03 C5 00 02": Request(
        7, 1, 0, (Address(965, 0, 1, 0x20), Address(965, 2, 3, 0x30))
    ),
}
RESPONSES = {
    "01 01 01 01 06 01 03 28": Response(1, 1, 1, 1, (Values(6, (0x328,)),)),
    "AA 01 00 01 06 01 03 02": Response(0xAA, 1, 0, 1, (Values(6, (0x302,)),)),
    "80 01 01 01 03 01 00 1F": Response(0x80, 1, 1, 1, (Values(3, (31,)),)),
    "01 02 01 01": Response(1, 2, 1, 1),
    "01 82 01 01 44 01 00 02": Response(1, 2, 1, 1, (ErrorValue(2),), negative=True),
    # Lenze i550 p474: the second word is additional information
    "01 82 01 02 40 00 44 02 00 03 00 07": Response(1, 2, 1, 2, (Values(0x40), ErrorValue(3, 7)), negative=True),
    "02 81 01 02 06 01 00 05 44 01 00 00": Response(2, 1, 1, 2, (Values(6, (5,)), ErrorValue(0)), negative=True),
    "03 01 00 02 05 01 2A 00 09 03 41 42 43 00": Response(3, 1, 0, 2, (Values(5, (42,)), Values(9, (b"ABC",)))),
    "03 01 00 01 03 02 FF FE 7F FF": Response(3, 1, 0, 1, (Values(3, (-2, 32767)),)),
}


@pytest.mark.parametrize(("text", "pdu"), [*REQUESTS.items(), *RESPONSES.items()])
def test_l8_requests_and_responses_of_the_manuals(text: str, pdu: Request | Response) -> None:
    assert pdu.build() == octets(text)
    assert type(pdu).parse(octets(text)) == pdu


# -- construct as the judge ------------------------------------------------------------------------------------------

_GROUP: Any = cs.Struct(
    "format" / cs.Byte,
    "count" / cs.Byte,
    "octets" / cs.Bytes(lambda this: FORMATS[this.format].octets * this.count),
    "pad" / cs.Bytes(lambda this: len(this.octets) & 1),
)
_ADDRESS: Any = cs.Struct("attribute" / cs.Byte, "elements" / cs.Byte, "pnu" / cs.Int16ub, "subindex" / cs.Int16ub)
_HEADER: Any = ("reference" / cs.Byte, "id" / cs.Byte, "object" / cs.Byte, "count" / cs.Byte)
_CHANGE: Any = cs.Struct(
    *_HEADER, "addresses" / _ADDRESS[cs.this.count], "values" / _GROUP[cs.this.count], cs.Terminated
)
_RESPONSE: Any = cs.Struct(*_HEADER, "values" / _GROUP[cs.this.count], cs.Terminated)


def raws_of(form: Format) -> st.SearchStrategy[tuple[Raw, ...]]:
    """1 to 8 values of a format."""
    if form.string:
        return st.binary(min_size=1, max_size=8).map(lambda one: (one,))
    if not form.code:
        return st.lists(st.binary(min_size=form.octets, max_size=form.octets), min_size=1, max_size=8).map(tuple)
    if form.code in "fd":
        floats = st.floats(width=64 if form.octets == 8 else 32, allow_nan=False, allow_infinity=False)
        return st.lists(floats, min_size=1, max_size=8).map(tuple)
    return st.lists(st.integers(form.low, form.high), min_size=1, max_size=8).map(tuple)


VALUE_FORMATS = [form for form in FORMATS.values() if form.octets and form.name != "Error"]
VALUES = st.sampled_from(VALUE_FORMATS).flatmap(lambda form: raws_of(form).map(lambda raws: Values(form.number, raws)))
ADDRESSES = st.builds(
    Address, st.integers(0, 0xFFFF), st.integers(0, 0xFFFF), st.integers(0, 234), st.sampled_from((0x10, 0x20, 0x30))
)
WORDS = st.integers(0, 0xFFFF)
ERRORS = st.builds(ErrorValue, WORDS, st.none() | WORDS)


@examples(60)
@given(st.integers(1, 255), st.lists(st.tuples(ADDRESSES, VALUES), min_size=1, max_size=6))
def test_changes_as_construct_reads_them(reference: int, parts: list[tuple[Address, Values]]) -> None:
    request = Request(reference, 2, 1, tuple(one for one, _ in parts), tuple(one for _, one in parts))
    built = request.build()
    judged = _CHANGE.parse(built)
    assert len(built) % 2 == 0
    assert [(one.pnu, one.subindex, one.elements, one.attribute) for one in judged.addresses] == [
        tuple(one) for one in request.addresses
    ]
    assert [one.octets for one in judged["values"]] == [FORMATS[one.format].pack(one.raws) for one in request.values]
    assert Request.parse(built) == request


@examples(60)
@given(st.integers(1, 255), st.lists(VALUES | ERRORS, min_size=1, max_size=6))
def test_responses_as_construct_reads_them(reference: int, results: list[Values | ErrorValue]) -> None:
    negative = any(isinstance(one, ErrorValue) for one in results)
    response = Response(reference, 1, 1, len(results), tuple(results), negative)
    judged = _RESPONSE.parse(response.build())
    assert [one.format for one in judged["values"]] == [
        0x44 if isinstance(one, ErrorValue) else one.format for one in results
    ]
    assert Response.parse(response.build()) == response


# -- what cannot be --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "text", "why"),
    [
        (Response, "", "at least 4 octets, there are 0"),
        (Response, "01 01 01", "at least 4 octets, there are 3"),
        (Response, "01 01 01 01 06", "the number of values is missing"),
        (
            Response,
            "01 01 01 01 06 02 03 28",
            "2 values of format Unsigned16 are 4 octets, from octet 7 on there are 2",
        ),
        (Response, "01 01 01 01 06 01 03 28 06 01 00 00", "4 octets too many from octet 9 on"),
        (Response, "01 01 01 01 99 01 03 28", "format 0x99 is none"),
        (Response, "01 81 01 01 44 00", "an error without its number"),
        (Request, "01 03 01 01 10 00 03 C5 00 00", "request id 0x03"),
        (Request, "01 01 01 02 10 00 03 C5 00 00", "2 parameters need 16 octets, there are 10"),
        (Request, "01 01 01 01 10 00 03 C5 00 00 00", "1 octet too many"),
        (Request, "01 02 01 01 10 00 03 C5 00 00", "values of 1 parameters announced, there are 0"),
        (Request, "01 02 01 01 10 00 03 C5 00 00 06 02 00 01", "2 values of format Unsigned16 are 4 octets"),
    ],
)
def test_wrong_lengths_counts_and_formats(kind: type[Request | Response], text: str, why: str) -> None:
    with pytest.raises(PduError, match=why):
        kind.parse(octets(text))


@pytest.mark.parametrize("error", ["44 00", "44 01 00 15"])
def test_an_error_in_a_change_is_no_value_with_or_without_its_number(error: str) -> None:
    request = Request.parse(octets(f"FF 02 03 01 10 01 00 02 00 00 {error}"))
    assert request.values == (Values(0x44),)
    assert Request.parse(request.build()) == request


def test_a_record_filled_up_with_zeros_is_read() -> None:
    assert Response.parse(octets("01 01 01 01 06 01 03 28") + bytes(232)).results == (Values(6, (0x328,)),)


@examples(150)
@given(st.sampled_from([*REQUESTS, *RESPONSES]), st.data())
def test_garbage_is_a_pdu_error_or_read(text: str, data: st.DataObject) -> None:
    whole = bytearray(octets(text))
    for _ in range(data.draw(st.integers(0, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    cut = bytes(whole[: data.draw(st.integers(0, len(whole)))])
    for parse in (Request.parse, Response.parse):
        with contextlib.suppress(PduError):
            parse(cut)


@pytest.mark.parametrize(
    ("pdu", "why"),
    [
        (Request(1, 1, 1, (Address(70000),)), r"0\.\.65535"),
        (Values(6, (65536,)), r"whole numbers 0\.\.65535"),
        (Values(5, (0,) * 235), "234 are possible"),
        (Values(6, (b"ab",)), "takes a number"),
        (Values(9, (65,)), "takes octets"),
        (Values(12, (b"ab",)), "takes 6 octets"),
        (Values(8, (math.nan,)), "finite"),
        (Request(1, 2, 1, (Address(1), Address(2)), (Values(6, (1,)),)), "1 groups of values for 2"),
    ],
)
def test_values_that_do_not_fit_are_refused_at_once(pdu: Request | Values, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        pdu.build()


# -- formats ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "text", "value"),
    [
        (1, "01", True),
        (2, "FF", -1),
        (3, "80 00", -32768),
        (4, "FF FF FF FE", -2),
        (5, "FF", 255),
        (6, "FF FF", 65535),
        (7, "FF FF FF FF", 4294967295),
        (8, "41 F0 00 00", 30.0),
        (9, "4C 53 20 00", "LS"),
        (10, "01 02", b"\x01\x02"),
        (13, "00 00 13 6B", 4971),  # Eaton DS7 p202: 100 ms
        (15, "3F F8 00 00 00 00 00 00", 1.5),
        (54, "00 00 00 64", 100),
        (55, "FF FF FF FF FF FF FF FE", -2),
        (56, "FF FF FF FF FF FF FF FF", 2**64 - 1),
        (116, "12 34", 0x1234),
        (117, "40 00", 0x4000),
        (118, "7F FF", 0x7FFF),
        (119, "80 00 00 00", 0x80000000),
        (120, "FF FF", 0xFFFF),
        (123, "FF FF", -1),
        (124, "FF FF FF FF", -1),
        (33, "40 00", 1.0),  # N2 and N4: TR-Electronic p195, Eaton p202
        (113, "C0 00", -1.0),
        (34, "40 00 00 00", 1.0),
        (114, "C0 00 00 00", -1.0),
        (115, "80 01", 0x8001),
        (121, "00 80", 1.0),
        (42, "00 12 D6 87", pytest.approx(123.4567)),  # C4: TR-Electronic p195
        (122, "00 00 27 10", pytest.approx(1.0)),
        (0x42, "80 00", 0x8000),
        (0x43, "80 00 00 00", 0x80000000),
    ],
)
def test_values_of_each_format(number: int, text: str, value: object) -> None:
    form = format_of(number)
    (raw,) = form.unpack(octets(text))
    assert form.value(raw) == value
    assert form.pack((raw,)) == octets(text)
    if number != 9:
        assert form.pack((form.raw(form.value(raw)),)) == octets(text)


#: formats by their octets, as PROFIdrive 4.2 (OPC 30141 table 59) and V3 number them
SIZES = {
    0: [0x40],
    1: [1, 2, 5, 9, 10, 14, 0x41],
    2: [3, 6, 113, 115, 116, 117, 118, 120, 121, 123, 33, 35, 36, 37, 38, 40, 41, 43, 0x42, 0x44],
    4: [4, 7, 8, 52, 54, 114, 119, 122, 124, 34, 39, 42, 44, 13, 0x43],
    6: [12, 53],
    7: [50],
    8: [15, 55, 56],
}


def test_every_format_has_its_octets() -> None:
    sizes = {number: size for size, numbers in SIZES.items() for number in numbers}
    assert {number: form.octets for number, form in FORMATS.items()} == sizes


ERROR_TEXTS = {
    0x00: "illegal parameter number",
    0x01: "cannot be modified",
    0x02: "limit exceeded",
    0x03: "invalid subindex",
    0x04: "no array",
    0x05: "wrong data type",
    0x06: "only be reset",
    0x07: "description cannot be changed",
    0x09: "no description",
    0x0B: "no operation priority",
    0x0C: "keyword is missing",
    0x0F: "no text array",
    0x10: "protected",
    0x11: "operating mode",
    0x14: "not permitted",
    0x15: "too long",
    0x16: "address not permitted",
    0x17: "illegal format",
    0x18: "number of values",
    0x19: "no such drive object",
    0x20: "text cannot be changed",
    0x21: "service is not supported",
    0x22: "too many parameters",
    0x23: "only one parameter",
    0x65: "the maker's own (Siemens: the parameter is switched off",
    0x6B: "the maker's own (Siemens: no change while the controller is enabled",
    0x7F: "device commissioning only (p0009 is not 0)",
    0x84: "the change is inhibited (p0300, p0400, p0922)",
    0x86: "commissioning only",
    0xC9: "above the limit",
    0xFE: "the maker's own",
    0x08: "which the profile does not define",
    0x24: "which the profile does not define",
}


@pytest.mark.parametrize(("number", "text"), ERROR_TEXTS.items())
def test_every_error_number_has_a_text(number: int, text: str) -> None:
    assert f"error {number}, " in error_text(number)
    assert text in error_text(number)


def test_additional_information_and_a_makers_texts() -> None:
    for number in (1, 2, 3, 6, 7, 0x14):
        assert error_text(number, 5).endswith("(subindex 5)")
    assert error_text(4, 5).endswith("(additional information 5)")
    assert error_text(0x6B, makers={0x6B: "busy"}) == "error 107, busy"


def test_dates_stay_octets() -> None:
    assert format_of(50).unpack(bytes(range(14))) == (bytes(range(7)), bytes(range(7, 14)))
    assert format_of(9).raw("LS") == b"LS"
    with pytest.raises(ValueError, match="takes no text"):
        format_of(6).raw("LS")
