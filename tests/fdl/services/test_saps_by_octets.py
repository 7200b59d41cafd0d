"""The SAPs of a station, octet by octet: which answer each request gets, what the program learns, and repetitions."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from octet_wire import framed

from dpstack.errors import UsageError
from dpstack.fdl.codec import decode
from dpstack.fdl.services.confirmations import FdlService
from dpstack.fdl.services.identity import Ident
from dpstack.fdl.services.orders import CloseSap, FdlIndicated, OpenSap, TakenIndications, UpdateReply
from dpstack.fdl.services.saps import SapTable

ALL = (FdlService.SDA, FdlService.SDN, FdlService.SRD)
RS = "10 01 02 33 36 16"
RR = "10 01 02 32 35 16"
NR = "10 01 02 39 3C 16"
UE = "10 01 02 31 34 16"


class Table:
    """The SAPs of station 2; requests come from station 1."""

    def __init__(self) -> None:
        self.events: list[Any] = []
        self.saps = SapTable(2, self.events, Ident("a", "b"))

    def open(self, number: int | None, **how: Any) -> None:
        self.saps.command(OpenSap(number, **{"services": ALL} | how))

    def ask(self, fc: int, unit: str = "", *, sa: int = 1) -> str:
        """The answer to a request with ``unit``: DSAP, SSAP and data."""
        telegram = decode(bytes.fromhex(framed(0x80 | 2, 0x80 | sa, fc, unit)))
        assert telegram is not None
        octets = self.saps.answer(telegram, 7)
        return "" if octets is None else octets.hex(" ").upper()

    def sdn(self, da: int, unit: str) -> None:
        telegram = decode(bytes.fromhex(framed(0x80 | da, 0x81, 0x44, unit)))
        assert telegram is not None
        self.saps.indicate(telegram, 7)

    def told(self) -> list[tuple[str, int | None, str]]:
        """Service, SAP and data of the indications since the last call."""
        found = [(one.service.value, one.sap, one.data.hex()) for one in self.events]
        self.events.clear()
        return found


@pytest.fixture
def table() -> Table:
    return Table()


def test_nothing_is_open(table: Table) -> None:
    assert table.ask(0x63, "14 08 AA") == RS
    assert table.ask(0x6C, "14 08") == RS
    table.sdn(2, "14 08 AA")
    assert table.told() == []


def test_data_with_acknowledgement(table: Table) -> None:
    """As Beckhoff's FC310x sends to a controller: DSAP is the sender's address + 1, SSAP the receiver's + 1."""
    table.open(2)
    assert table.ask(0x65, "02 03 11 22") == "E5"
    (indication,) = table.events
    assert indication == FdlIndicated(
        t_ns=7, sap=2, service=FdlService.SDA, source=1, source_sap=3, data=b"\x11\x22", high=True
    )
    assert indication.text == "SDA of station 1 to SAP 2: 11 22"


def test_reply_data(table: Table) -> None:
    table.open(20)
    assert table.ask(0x6C, "14 08 AA") == NR
    table.saps.command(UpdateReply(20, b"\x01\x02"))
    assert table.ask(0x5C, "14 08") == framed(0x81, 0x82, 0x38, "08 14 01 02").upper()
    table.saps.command(UpdateReply(20, b"\x01\x02", high=True))
    assert table.ask(0x7C, "14 08") == framed(0x81, 0x82, 0x3A, "08 14 01 02").upper()
    assert table.told() == [("SRD", 20, "aa"), ("SRD", 20, ""), ("SRD", 20, "")]


def test_a_reply_for_once_is_repeated_and_then_gone(table: Table) -> None:
    table.open(20)
    table.saps.command(UpdateReply(20, b"\x01", once=True))
    first = table.ask(0x6C, "14 08")
    assert first == framed(0x81, 0x82, 0x38, "08 14 01").upper()
    assert table.ask(0x7C, "14 08") == first == table.ask(0x7C, "14 08")
    assert table.ask(0x5C, "14 08") == NR
    table.saps.command(UpdateReply(20, b""))
    assert table.ask(0x7C, "14 08") == framed(0x81, 0x82, 0x38, "08 14").upper()
    table.saps.command(UpdateReply(20, None))
    assert table.ask(0x5C, "14 08") == NR


def test_a_full_queue(table: Table) -> None:
    table.open(20, queue=1)
    assert table.ask(0x63, "14 08 01") == "E5"
    assert table.ask(0x53, "14 08 02") == RR
    assert table.ask(0x7C, "14 08 03") == RR
    table.saps.command(UpdateReply(20, b"\x09"))
    assert table.ask(0x5C, "14 08 04") == framed(0x81, 0x82, 0x3C, "08 14 09").upper()  # RDL
    table.saps.command(UpdateReply(20, b"\x09", high=True))
    assert table.ask(0x7C, "14 08 04") == framed(0x81, 0x82, 0x3D, "08 14 09").upper()  # RDH
    assert table.ask(0x5C, "14 08") == framed(0x81, 0x82, 0x3A, "08 14 09").upper()
    table.sdn(2, "14 08 05")
    table.sdn(127, "14 08 06")
    assert table.told() == [("SDA", 20, "01")]
    table.saps.command(TakenIndications(20, 1))
    assert table.ask(0x73, "14 08 07") == "E5"
    assert [one.lost for one in table.events] == [2]


def test_access_by_one_station_and_one_sap(table: Table) -> None:
    table.open(20, access=3, access_sap=8)
    assert table.ask(0x63, "14 08 01") == RS
    assert table.ask(0x63, "14 09 01", sa=3) == "10 03 02 33 38 16"
    assert table.ask(0x63, "14 08 01", sa=3) == "E5"
    table.sdn(2, "14 08 05")
    assert table.told() == [("SDA", 20, "01")]


def test_services_that_a_sap_takes(table: Table) -> None:
    table.open(20, services=(FdlService.SDN,))
    assert table.ask(0x63, "14 08 01") == RS
    assert table.ask(0x7C, "14 08") == RS
    table.sdn(2, "14 08 05")
    assert table.told() == [("SDN", 20, "05")]


def test_the_default_sap(table: Table) -> None:
    table.open(None)
    telegram = decode(bytes.fromhex(framed(2, 1, 0x6C, "41")))
    assert telegram is not None
    table.saps.command(UpdateReply(None, bytes(246)))
    octets = table.saps.answer(telegram, 7)
    assert octets is not None
    assert octets.hex(" ") == framed(1, 2, 0x38, bytes(246).hex(" "))
    assert table.told() == [("SRD", None, "41")]
    from_sap = decode(bytes.fromhex(framed(2, 0x81, 0x6C, "08 41")))
    assert from_sap is not None
    assert from_sap.ssap == 8
    assert (table.saps.answer(from_sap, 7) or b"").hex(" ").upper() == UE  # 246 octets and a SAP do not fit


def test_to_all_saps(table: Table) -> None:
    for number in (5, None, 6):
        table.open(number)
    table.sdn(127, "3F 08 AA")
    assert sorted(table.told(), key=str) == [("SDN", 5, "aa"), ("SDN", 6, "aa"), ("SDN", None, "aa")]


def test_ident_lsap_status_and_msrd(table: Table) -> None:
    table.open(20)
    request = decode(bytes.fromhex("10 02 01 4E 51 16"))
    assert request is not None
    assert (table.saps.answer(request, 7) or b"").hex(" ") == framed(1, 2, 0x38, "01 01 00 00 61 62")
    assert table.ask(0x4F, "14 08") == RS
    assert table.ask(0x67, "14 08") == RS


def test_closed_again(table: Table) -> None:
    table.open(20)
    table.saps.command(CloseSap(20))
    assert table.ask(0x63, "14 08 01") == RS
    assert table.saps.is_deactivated(20)
    table.saps.command(CloseSap(20))
    table.open(20)
    assert not table.saps.is_deactivated(20)


@pytest.mark.parametrize(
    ("order", "text"),
    [
        (OpenSap(63, ALL), "SAP 63: a station's own SAPs are 0..62"),
        (OpenSap(-1, ALL), "SAP -1: "),
        (OpenSap(20, ALL), "SAP 20 is in use already"),
        (OpenSap(21, ALL, access=126), "access by station 126"),
        (OpenSap(21, ALL, queue=0), "a queue of 0"),
        (OpenSap(21, ALL, queue=257), "a queue of 257"),
        (UpdateReply(21, b""), "SAP 21 is not open"),
        (UpdateReply(20, bytes(245)), "245 octets of reply data; 244 fit"),
    ],
)
def test_orders_that_cannot_be(table: Table, order: Any, text: str) -> None:
    table.open(20)
    with pytest.raises(UsageError) as error:
        table.saps.command(order)
    assert text in str(error.value)


@pytest.mark.parametrize("number", [48, 50, 54, 62])
def test_saps_of_the_dp_master(table: Table, number: int) -> None:
    table.saps.guarded = True
    with pytest.raises(UsageError, match="belongs to the DP master"):
        table.open(number)
    table.open(47)


#: station, FCV, FCB, what: SDA or SRD with the step's number as data, FDL status, SDN
STEPS = st.lists(
    st.tuples(st.sampled_from((1, 3)), st.booleans(), st.booleans(), st.sampled_from("AARRSN")), max_size=40
)


@given(STEPS)
def test_a_repetition_gets_the_last_answer_and_is_told_once(steps: list[tuple[int, bool, bool, str]]) -> None:
    """A model of the responder: the last counted request's station, FCB and answer, until another telegram comes."""
    table = Table()
    table.open(20, queue=256)
    kept: tuple[int, bool, str] | None = None
    expected: list[tuple[str, int, str]] = []
    for number, (sa, fcv, fcb, what) in enumerate(steps):
        data = f"{number:02X}"
        table.saps.command(UpdateReply(20, bytes((number,))))
        if what == "S":
            table.saps.forget()  # as the station does for FDL status
            kept = None
        elif what == "N":
            table.sdn(2, f"14 08 {data}")
            expected.append(("SDN", 20, data.lower()))
            kept = None
        else:
            fc = 0x40 | fcv << 4 | fcb << 5 | (0x03 if what == "A" else 0x0C)
            answer = table.ask(fc, f"14 08 {data}", sa=sa)
            if kept is not None and fcv and kept[:2] == (sa, fcb):
                assert answer == kept[2]
                continue
            reply = framed(0x80 | sa, 0x82, 0x38, f"08 14 {data}").upper()
            assert answer == ("E5" if what == "A" else reply)
            expected.append(("SDA" if what == "A" else "SRD", 20, data.lower()))
            kept = (sa, fcb, answer) if fcv or fcb else None
    assert table.told() == expected
