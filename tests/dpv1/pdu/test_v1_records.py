"""The octets of Read, Write and I&M, literally; what is answered to requests that cannot be; a text for every error."""

from __future__ import annotations

import contextlib
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.dpv1.pdu.error_codes import Code, class_text, code_text, negative_text, remedy
from dpstack.dpv1.pdu.im import Im, Im0, Im1, Im2, Im3, Im4, build_call, number_of, parse_answer, parse_call
from dpstack.dpv1.pdu.ms2 import (
    IDLE,
    Abort,
    AbortReason,
    Address,
    InitiateReq,
    InitiateRes,
    Instance,
    ResourceManagerRes,
    Subnet,
)
from dpstack.dpv1.pdu.read_write import (
    DataTransport,
    Function,
    Negative,
    ReadReq,
    ReadRes,
    RecordReq,
    RecordRes,
    UnacceptableError,
    WriteReq,
    WriteRes,
    parse_request,
    parse_response,
)
from dpstack.errors import PduError
from dpstack.units import NS_PER_MS

REQUESTS: list[tuple[RecordReq, str]] = [
    (ReadReq(2, 0x2F, 0x40), "5E 02 2F 40"),
    (ReadReq(0, 255, 240), "5E 00 FF F0"),
    # a request for PNU 965 by the parameter channel (Baumer GB/GE manual p26)
    (WriteReq(2, 0x2F, bytes.fromhex("AA 01 00 01 10 01 03 C5 00 00")), "5F 02 2F 0A AA 01 00 01 10 01 03 C5 00 00"),
    (WriteReq(254, 0, b""), "5F FE 00 00"),
]
RESPONSES: list[tuple[RecordRes, str]] = [
    (ReadRes(2, 0x2F, bytes.fromhex("AA 01 00 01 06 01 03 02")), "5E 02 2F 08 AA 01 00 01 06 01 03 02"),
    (ReadRes(1, 7, b""), "5E 01 07 00"),
    (WriteRes(2, 0x2F, 10), "5F 02 2F 0A"),
    (Negative(Function.READ, Code.STATE_CONFLICT), "DE 80 B5 00"),
    (Negative(Function.WRITE, 0xB0, 0x17), "DF 80 B0 17"),
    (Negative(Function.READ, 1, 2, 0xFE), "DE FE 01 02"),
]


@pytest.mark.parametrize(("pdu", "octets"), REQUESTS)
def test_requests(pdu: RecordReq, octets: str) -> None:
    assert pdu.build() == bytes.fromhex(octets)
    assert parse_request(bytes.fromhex(octets)) == pdu


@pytest.mark.parametrize(("pdu", "octets"), RESPONSES)
def test_responses(pdu: RecordRes, octets: str) -> None:
    assert pdu.build() == bytes.fromhex(octets)
    assert parse_response(bytes.fromhex(octets)) == pdu


@pytest.mark.parametrize(
    ("octets", "answer", "what"),
    [
        ("5E", "DE 80 B8 00", "octet 2 (slot) is missing"),
        ("5E 01 02", "DE 80 B8 00", "octet 4 (length) is missing"),
        ("5E 01 02 03 04", "DE 80 B8 00", "1 octet too many"),
        ("5E FF 02 03", "DE 80 B2 00", "there is no slot 255"),
        ("5E 01 02 F1", "DE 80 B1 00", "octet 4: 241 octets"),
        ("5F 01 02 03 04 05", "DF 80 B1 00", "octet 4 says 3 octets of data, 2 came"),
        ("5F 01 02 01 04 05", "DF 80 B1 00", "octet 4 says 1 octet of data, 2 came"),
        ("5C 01 02 03", "DC 80 A9 00", "Alarm_Ack is no service here"),
        ("48 01", "C8 80 A9 00", "Idle is no service here"),
        ("00 01 02 03", "80 80 A9 00", "no service 0x00"),
        ("DE 80 B0 00", "DE 80 A9 00", "no service 0xDE"),
    ],
)
def test_invalid_requests(octets: str, answer: str, what: str) -> None:
    with pytest.raises(UnacceptableError) as raised:
        parse_request(bytes.fromhex(octets))
    assert what in str(raised.value)
    assert raised.value.negative.build() == bytes.fromhex(answer)


@pytest.mark.parametrize(
    ("octets", "what"),
    [
        ("", "no octets"),
        ("00 01 02 03", "octet 1 is 0x00"),
        ("5E 01 02", "octet 4 (length) is missing"),
        ("5E 01 02 03 AA BB", "octet 4 says 3 octets of data, 2 came"),
        ("5E 01 02 F1" + " 00" * 241, "octet 4 says 241"),
        ("5F 01 02 03 00", "octet 4 is the last one"),
        ("DE 80", "octet 3 (error_code_1) is missing"),
        ("DE 80 B0 00 00", "octet 4 is the last one"),
        ("57 01 02 03", "octet 1: Initiate answers neither Read nor Write"),
    ],
)
def test_invalid_responses(octets: str, what: str) -> None:
    with pytest.raises(PduError, match=re.escape(what)):
        parse_response(bytes.fromhex(octets))


@pytest.mark.parametrize("pdu", [ReadReq(255, 0), ReadReq(0, 256), ReadReq(0, 0, 241), WriteReq(0, 0, bytes(241))])
def test_requests_with_values_that_do_not_fit(pdu: RecordReq) -> None:
    with pytest.raises(PduError):
        pdu.build()


@given(st.binary(max_size=260))
def test_any_octets_are_read_or_refused(octets: bytes) -> None:
    """Only PduError is raised, and a PDU that was read is built to the same octets."""
    with contextlib.suppress(PduError):
        assert parse_response(octets).build() == octets
    with contextlib.suppress(PduError):
        assert parse_request(octets).build() == octets


def test_every_error_code_has_a_text() -> None:
    texts = [code_text(code) for code in range(256)]
    assert all(texts)
    assert code_text(0xB5) == "state conflict"
    assert code_text(0xB7) == "invalid range"
    assert code_text(0xC2) == "resource busy"
    assert "device specific" in code_text(0xAA)
    assert "reserved" in code_text(0xA3)
    assert "device specific" in code_text(0xD1)
    assert code_text(0x11) == "reserved"
    assert [class_text(c) for c in (0, 10, 11, 12, 13)] == [
        "reserved",
        "application",
        "access",
        "resource",
        "device specific",
    ]
    assert negative_text(0x80, 0xB5, 0) == "state conflict (80 B5 00: class access, code 5)"
    assert negative_text(0x80, 0xB0, 7) == "invalid index (80 B0 07: class access, code 0, second code 0x07)"
    assert "FMS" in negative_text(0xFE, 1, 2)
    assert "HART" in negative_text(0xFF, 1, 2)
    assert "0x00 is unknown" in negative_text(0, 0, 0)
    assert "again" in remedy(Code.STATE_CONFLICT)


IM0 = (
    "00 00 00 00 00 00 00 00 00 00"
    " 01 0C"
    " 4C 53 2D 53 31 30 30 20 20 20 20 20 20 20 20 20 20 20 20 20"
    " 53 4E 31 20 20 20 20 20 20 20 20 20 20 20 20 20"
    " 00 02 56 01 02 03 00 05 3A 00 00 01 01 01 00 1E"
)


def test_im0_octets() -> None:
    im0 = Im0(
        manufacturer_id=0x010C,
        order_id="LS-S100",
        serial_number="SN1",
        hardware_revision=2,
        software_revision="V1.2.3",
        revision_counter=5,
        profile_id=0x3A00,
        profile_type=1,
        version=(1, 1),
        supported=0x1E,
    )
    assert im0.build() == bytes.fromhex(IM0)
    assert parse_answer(bytes.fromhex("08 00 FD E8 " + IM0), 0) == im0


@pytest.mark.parametrize("letter", "VRPUT")
def test_every_letter_of_a_software_revision(letter: str) -> None:
    octets = bytes.fromhex(IM0.replace("00 02 56 01", f"00 02 {ord(letter):02X} 01"))
    found = Im0.parse(octets)
    assert found.software_revision == f"{letter}1.2.3"
    assert found.build() == octets


def test_im0_of_devices_beside_the_rules_is_read() -> None:
    wild = bytearray.fromhex(IM0)
    wild[12:32] = b"  \xb5Drive\0\0".ljust(20, b"\0")  # a blank in front, ISO 8859-1, filled up with zeros
    wild[32:48] = bytes(16)
    wild[50] = 0
    found = Im0.parse(bytes(wild))
    assert (found.order_id, found.serial_number, found.software_revision) == ("  \xb5Drive", "", "0x00 1.2.3")


def test_im_calls() -> None:
    assert build_call(0) == bytes.fromhex("08 00 FD E8")
    assert build_call(4) == bytes.fromhex("08 00 FD EC")
    assert parse_call(bytes.fromhex("08 00 FD E9 01 02")) == (65001, b"\1\2")
    for wrong in ("09 00 FD E8", "08 00 FD E7", "08 00 FE B0", "08 00 FD"):
        with pytest.raises(PduError):
            parse_call(bytes.fromhex(wrong))
    with pytest.raises(PduError, match="65001, I&M0 is 65000"):
        parse_answer(bytes.fromhex("08 00 FD E9") + bytes(64), 0)
    with pytest.raises(PduError):
        parse_answer(bytes.fromhex("08 00 FD E8") + bytes(63), 0)


@pytest.mark.parametrize(
    ("record", "octets"),
    [
        (Im1("Lüfter", "Halle 3"), bytes(10) + b"L\xfcfter".ljust(32) + b"Halle 3".ljust(22)),
        (Im2("2026-01-31 12:00"), bytes(10) + b"2026-01-31 12:00" + bytes(38)),
        (Im3("by hand"), bytes(10) + b"by hand".ljust(54)),
        (Im4(b"\1\2"), bytes(10) + b"\1\2" + bytes(52)),
    ],
)
def test_im1_to_im4_octets(record: Im, octets: bytes) -> None:
    assert record.build() == octets
    assert len(octets) == 64
    assert parse_answer(build_call(number_of(record), record), number_of(record)) == record


def test_im_that_does_not_fit() -> None:
    for wrong in (Im1(tag_function="x" * 33), Im2("x" * 17), Im3("x" * 55), Im3("Ω")):
        with pytest.raises(PduError):
            wrong.build()
    for revision in ("1.2.3", "V1.2", "V1.2.256", "", "ÄV1.2.3", "X1.2.3", "v1.2.3"):
        with pytest.raises(PduError, match=r"give a letter \(V, R, P, U, T\)"):
            Im0(software_revision=revision).build()
    for text in ("Größe", "a\tb", "\x7f"):
        for wrong_text in (Im0(order_id=text), Im0(serial_number=text)):
            with pytest.raises(PduError, match="VisibleString"):
                wrong_text.build()
    with pytest.raises(PduError):
        Im4(bytes(55))


def test_texts_of_im_are_filled_up_with_blanks_and_keep_their_last_letter() -> None:
    """Ten octets of header, 32 characters of the function, 22 of the place."""
    octets = bytes(10) + b"PUMP X" + b" " * 26 + b"B" * 22
    assert Im1("PUMP X", "B" * 22).build() == octets
    assert Im1.parse(octets) == Im1("PUMP X", "B" * 22)
    assert Im1.parse(bytes(10) + b"PUMP X \0" + bytes(24) + b"B" * 22) == Im1("PUMP X", "B" * 22)
    with pytest.raises(PduError, match="33 characters, 32 are possible"):
        Im1("A" * 33).build()


# --- The octets of the services of MS2 beside Read and Write, literally, and what lies ------------------------------


Pdu = ResourceManagerRes | InitiateReq | InitiateRes | DataTransport | Abort

REMOTE = Address(1, 2, bytes.fromhex("01 02 03 04 05 06 21"))
PDUS: list[tuple[Pdu, str]] = [
    (ResourceManagerRes(48, 1000 * NS_PER_MS), "56 30 00 64"),
    (ResourceManagerRes(0, 0), "56 00 00 00"),
    (InitiateReq(4000 * NS_PER_MS), "57 00 00 00 01 90 01 00 00 00 00 00 00 02 00 02 00 00 00 00"),
    (
        InitiateReq(
            10 * NS_PER_MS,
            features=0x0300,
            profile_features=0x8000,
            profile_ident=0x9700,
            source=Address(5, 1),
            destination=REMOTE,
        ),
        "57 00 00 00 00 01 03 00 80 00 97 00 00 02 01 09 05 01 01 02 01 02 03 04 05 06 21",
    ),
    (InitiateRes(), "57 F0 01 00 00 00 00 00 00 02 00 02 00 00 00 00"),
    (
        InitiateRes(64, profile_ident=0x9700, source=REMOTE),
        "57 40 01 00 00 00 97 00 01 09 00 02 01 02 01 02 03 04 05 06 21 00 00",
    ),
    (DataTransport(1, 7, b"\xaa\xbb"), "51 01 07 02 AA BB"),
    (DataTransport(254, 255, b""), "51 FE FF 00"),
    (Abort(AbortReason.TIMEOUT), "58 00 13"),
    (Abort(AbortReason.RESOURCE, subnet=Subnet.LOCAL), "58 01 1F"),
    (Abort(7, Instance.USER, Subnet.REMOTE), "58 02 27"),
    (Abort(3, Instance.FDL), "58 00 03"),
]


@pytest.mark.parametrize(("pdu", "octets"), PDUS)
def test_pdus(pdu: Pdu, octets: str) -> None:
    assert pdu.build() == bytes.fromhex(octets)
    assert type(pdu).parse(bytes.fromhex(octets)) == pdu


def test_idle() -> None:
    assert bytes.fromhex("48 01") == IDLE


@pytest.mark.parametrize(
    ("kind", "octets", "what"),
    [
        (ResourceManagerRes, "56 30 00", "octet 4 (send_timeout) is missing"),
        (ResourceManagerRes, "56 31 00 64", "octet 2: 49 is no server SAP"),
        (ResourceManagerRes, "56 30 00 64 00", "octet 4 is the last one"),
        (ResourceManagerRes, "57 30 00 64", "octet 1 is 0x57"),
        (InitiateReq, "57 00 00 00 01 90 01 00 00 00 00 00 00 02 00", "octet 16 (d_len) is missing"),
        (InitiateReq, "57 00 00 00 01 90 01 00 00 00 00 00 00 02 00 02 00 00 00", "2 and 2 octets of addresses"),
        (InitiateReq, "57 00 00 00 01 90 01 00 00 00 00 00 00 03 00 02 00 00 00 00 00", "S_Addr of type 0 with 3"),
        (InitiateReq, "57 00 00 00 01 90 01 00 00 00 00 00 00 02 01 02 00 00 00 00", "D_Addr of type 1 with 2"),
        (InitiateReq, "57 00 00 00 01 90 01 00 00 00 00 00 02 02 00 02 00 00 00 00", "S_Addr of type 2"),
        (InitiateRes, "57 F0 01 00 00 00 00 00 00 02 00 02 00 00 00 00 00", "5 came"),
        (DataTransport, "51 01 07 03 AA BB", "octet 4 says 3 octets of data, 2 came"),
        (DataTransport, "51 01 07 F1" + " 00" * 241, "octet 4 says 241"),
        (Abort, "58 00", "octet 3"),
    ],
)
def test_invalid_pdus(kind: type[Pdu], octets: str, what: str) -> None:
    with pytest.raises(PduError, match=re.escape(what)):
        kind.parse(bytes.fromhex(octets))


def test_an_abort_may_have_reserved_octets_behind_it() -> None:
    octets = bytes.fromhex("58 00 11 00 00 00 00 00 00 00 03 03 00 00")  # Balluff BTL7-T500 p28 appends some
    assert Abort.parse(octets) == Abort(AbortReason.SEQUENCE)


def test_every_reason_has_a_text_of_its_own() -> None:
    texts = {Abort(reason, instance).text for instance in range(4) for reason in range(16)}
    assert len(texts) == 64
    assert Abort(AbortReason.TIMEOUT).text == "nothing was heard from the other end in time (ABT_TO)"
    assert Abort(AbortReason.RESOURCE, subnet=Subnet.REMOTE).text.endswith("(ABT_RES in a remote subnet)")
    assert Abort(15, Instance.FDL).text == "its link layer: the other station does not answer (NA)"
    assert Abort(1, subnet=9).text


def test_values_that_do_not_fit() -> None:
    for pdu, what in (
        (ResourceManagerRes(49, 0), "49 is no server SAP"),
        (InitiateReq(-1), "not possible"),
        (InitiateReq(655_360 * NS_PER_MS), "not possible"),
        (InitiateReq(0, features=0x10000), "features"),
        (DataTransport(255, 0, b""), "slot 255"),
        (DataTransport(0, 0, bytes(241)), "241 octets"),
        (Abort(16), "reason"),
    ):
        with pytest.raises(PduError, match=re.escape(what)):
            pdu.build()
    assert InitiateReq(11 * NS_PER_MS).build()[4:6] == b"\x00\x02", "rounded up"


@given(st.sampled_from([ResourceManagerRes, InitiateReq, InitiateRes, DataTransport, Abort]), st.binary(max_size=40))
def test_any_octets_are_a_pdu_or_an_error(kind: type[Pdu], octets: bytes) -> None:
    for tried in (octets, bytes.fromhex("57") + octets, bytes.fromhex("58") + octets):
        with contextlib.suppress(PduError):
            assert kind.parse(kind.parse(tried).build()) == kind.parse(tried)
