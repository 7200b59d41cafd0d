"""The table of confirmations against the clauses of EN 50170-2, and every answer that a station may give."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from dpstack.fdl.interface import Failure
from dpstack.fdl.services.confirmations import ALLOWED, Confirmation, FdlService, confirmation_of
from dpstack.fdl.telegram import SHORT_ACK, Kind, Telegram

#: EN 50170-2 part 3: table 1 (SDA, p59), SRD (p62 and table 4), table 15 (Ident, p76); CP 5412 manual, table 12.6
CLAUSES = {
    "SDA": "OK RR UE RS LS LR NA DS IV",
    "SDN": "OK LS LR DS IV",
    "SRD": "DL DH NR RDL RDH UE RR RS LS LR NA DS IV",
    "MSRD": "DL DH NR RDL RDH UE RR RS LS LR NA DS IV",
    "FDL_STATUS": "OK LR NA DS IV",
    "IDENT": "OK LR NA DS NR IV",
    "LSAP_STATUS": "OK RS NA DS NR LR IV",
}


def test_each_service_has_the_confirmations_of_its_clause() -> None:
    found = {service.value: {one.value for one in allowed} for service, allowed in ALLOWED.items()}
    assert found == {name: set(codes.split()) for name, codes in CLAUSES.items()}


def test_every_confirmation_has_a_text_and_belongs_to_a_service() -> None:
    assert len({one.text for one in Confirmation}) == len(Confirmation) == 14
    assert set().union(*ALLOWED.values()) == set(Confirmation)


def answered(status: int, data: bytes = b"") -> Telegram:
    return Telegram(Kind.SD2 if data else Kind.SD1, 2, 5, status, None, None, data)


@pytest.mark.parametrize("service", FdlService)
@pytest.mark.parametrize("data", [b"", b"\x01"])
def test_no_answer_leads_to_a_confirmation_outside_of_the_clause(service: FdlService, data: bytes) -> None:
    """All sixteen values of the status, known and unknown, in all station types."""
    for status in range(64):
        found, _ = confirmation_of(service, answered(status, data))
        assert found in ALLOWED[service] or service is FdlService.SDN  # which has no answer
    for failure in Failure:
        assert confirmation_of(FdlService.SDA, failure)[0] in ALLOWED[FdlService.SDA]


@pytest.mark.parametrize(
    ("service", "status", "confirmation"),
    [
        ("SDA", 0, "OK"),
        ("SDA", 1, "UE"),
        ("SDA", 2, "RR"),
        ("SDA", 3, "RS"),
        ("SDA", 8, "NA"),
        ("SDA", 9, "NA"),
        ("SRD", 8, "DL"),
        ("SRD", 9, "NR"),
        ("SRD", 10, "DH"),
        ("SRD", 12, "RDL"),
        ("SRD", 13, "RDH"),
        ("SRD", 2, "RR"),
        ("SRD", 0, "NR"),
        ("SRD", 5, "NA"),
        ("MSRD", 8, "DL"),
        ("FDL_STATUS", 0, "OK"),
        ("FDL_STATUS", 8, "NA"),
        ("IDENT", 8, "OK"),
        ("IDENT", 3, "NR"),
        ("IDENT", 9, "NR"),
        ("LSAP_STATUS", 8, "OK"),
        ("LSAP_STATUS", 1, "NR"),
        ("LSAP_STATUS", 3, "RS"),
    ],
)
def test_what_an_answer_means(service: str, status: int, confirmation: str) -> None:
    assert confirmation_of(FdlService(service), answered(status))[0] is Confirmation(confirmation)


@pytest.mark.parametrize(("service", "confirmation"), [("SDA", "OK"), ("SDN", "OK"), ("SRD", "NR"), ("MSRD", "NR")])
def test_the_short_acknowledgement(service: str, confirmation: str) -> None:
    assert confirmation_of(FdlService(service), SHORT_ACK) == (Confirmation(confirmation), "")


def test_an_implausible_answer_is_named() -> None:
    assert confirmation_of(FdlService.SDA, answered(0x38)) == (
        Confirmation.NA,
        "the answer DL is none that SDA may have",
    )


def test_which_are_local_positive_and_temporary() -> None:
    def those(found: Callable[[Confirmation], bool]) -> str:
        return " ".join(one.value for one in Confirmation if found(one))

    assert those(lambda one: one.is_local) == "LS LR NA DS IV"
    assert those(lambda one: one.is_temporary) == "RR NR RDL RDH LR NA"
    assert those(lambda one: one.is_positive(FdlService.SRD)) == "OK DL NR DH"
    assert those(lambda one: one.is_positive(FdlService.IDENT)) == "OK"
