"""The octets of the services of MS2 beside Read and Write, literally, and what lies."""

from __future__ import annotations

import contextlib
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

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
from dpstack.dpv1.pdu.read_write import DataTransport
from dpstack.errors import PduError
from dpstack.units import NS_PER_MS

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
