"""MS1 of a slave, literally: acknowledged, polled, refused, closed; answers now or later; I&M."""

from __future__ import annotations

import pytest
from slave_kit import CFG, MASTER, OTHER, PRM, UNLOCK, Bench, Recorder

from dpstack.dp.slave.application import SlaveAppState
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.im import Im, Im0, Im1, Im3
from dpstack.dpv1.pdu.read_write import WriteReq
from dpstack.dpv1.slave.record_requests import RecordRequest, Records
from dpstack.dpv1.slave.record_table import ImRecords, RecordTable
from dpstack.errors import RecordRefused
from dpstack.fdl.interface import RS_REPLY, SC_REPLY, Reply
from dpstack.fdl.telegram import Resp
from tests.dpv1.ms2_slave_kit import Later

ENABLE = PRM + b"\x80\0\0"


def bench_with(records: Records | None, prm: bytes = ENABLE) -> Bench:
    device = Recorder()
    device.records = records
    bench = Bench(device)
    bench.prm_and_cfg(prm)
    bench.app.take_events()
    return bench


def ask(bench: Bench, octets: str, sa: int = MASTER) -> Reply:
    return bench.ask(51, bytes.fromhex(octets), sa)


def answer_to(bench: Bench, octets: str) -> str:
    """Acknowledged, and the answer at the first poll."""
    assert ask(bench, octets) == SC_REPLY
    reply = ask(bench, "")
    assert reply.status is Resp.DL
    return reply.data.hex(" ").upper()


TABLE = {(0, 1): b"\x11\x22\x33", (1, 2): b"\xaa"}


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("5E 00 01 F0", "5E 00 01 03 11 22 33"),
        ("5E 00 01 02", "5E 00 01 02 11 22"),
        ("5E 00 02 F0", "DE 80 B0 00"),
        ("5E 02 01 F0", "DE 80 B2 00"),
        ("5F 01 02 01 BB", "5F 01 02 01"),
        ("5F 01 02 02 BB CC", "DF 80 B1 00"),
        ("5F 00 01 03 01 02 03", "DF 80 B6 00"),
        ("5E 00", "DE 80 B8 00"),
        ("5F 01 02 05 BB", "DF 80 B1 00"),
        ("57 00 00 00", "D7 80 A9 00"),
        ("5E 00 01 F1", "DE 80 B1 00"),
    ],
)
def test_requests_and_responses(request_: str, response: str) -> None:
    bench = bench_with(RecordTable(TABLE, [(1, 2)]))
    assert answer_to(bench, request_) == response


@pytest.mark.parametrize("prm", [PRM, PRM + b"\x40\0\0"])
def test_closed_without_dpv1_enable(prm: bytes) -> None:
    bench = bench_with(RecordTable(TABLE), prm)
    assert ask(bench, "5E 00 01 F0") == RS_REPLY


@pytest.mark.parametrize("request_", ["5E 00", "57 00 00 00", "5E 00 01 F0"])
def test_an_answer_that_nobody_fetched_ends_with_data_exchange(request_: str) -> None:
    bench = bench_with(RecordTable(TABLE))
    assert ask(bench, request_) == SC_REPLY
    bench.prm(UNLOCK)
    bench.prm_and_cfg(ENABLE)
    assert ask(bench, "") == SC_REPLY


def test_closed_without_records_and_for_others_and_outside_data_exchange() -> None:
    assert ask(bench_with(None), "5E 00 01 F0") == RS_REPLY
    bench = bench_with(RecordTable(TABLE))
    assert ask(bench, "5E 00 01 F0", OTHER) == RS_REPLY
    assert bench.app.stats.foreign == 1
    bench.prm(UNLOCK)
    assert ask(bench, "5E 00 01 F0") == RS_REPLY


def test_parameters_without_it_close_it_again() -> None:
    bench = bench_with(RecordTable(TABLE))
    bench.prm_and_cfg(PRM)
    assert bench.app.state is SlaveAppState.DATA_EXCH
    assert ask(bench, "5E 00 01 F0") == RS_REPLY


def test_an_answer_that_comes_later() -> None:
    later = Later()
    bench = bench_with(later)
    assert ask(bench, "") == SC_REPLY  # nothing was asked
    assert ask(bench, "5E 00 01 F0") == SC_REPLY
    for _ in range(3):
        assert ask(bench, "") == SC_REPLY
    (request,) = later.requests
    request.answer(b"\x55")
    request.answer(b"\x66")  # once is enough
    for _ in range(2):  # until the next request: a poll whose answer was lost gets it again
        assert ask(bench, "").data == bytes.fromhex("5E 00 01 01 55")
    assert ask(bench, "5E 00 07 F0") == SC_REPLY
    assert ask(bench, "") == SC_REPLY


def test_a_request_takes_the_place_of_the_one_before() -> None:
    later = Later()
    bench = bench_with(later)
    ask(bench, "5E 00 01 F0")
    gone: list[int] = []
    later.requests[0].abandoned = lambda: gone.append(1)
    ask(bench, "5E 00 02 F0")
    assert gone == [1]
    later.requests[0].answer(b"\x11")
    assert ask(bench, "") == SC_REPLY
    later.requests[1].answer(b"\x22")
    assert ask(bench, "").data == bytes.fromhex("5E 00 02 01 22")
    ask(bench, "5E 00 03 F0")
    assert gone == [1]  # the second was answered


def test_leaving_data_exchange_ends_what_is_worked_at() -> None:
    later = Later()
    bench = bench_with(later)
    ask(bench, "5E 00 01 F0")
    bench.prm_and_cfg(ENABLE, CFG)
    (request,) = later.requests
    assert not request.open
    request.answer(b"\x55")
    assert ask(bench, "") == SC_REPLY


def test_failures_and_invalid_requests_are_answered_and_reported_and_data_exchange_goes_on() -> None:
    class Broken:
        def ask(self, request: RecordRequest) -> None:
            if isinstance(request.service, WriteReq):
                raise RecordRefused(Code.STATE_CONFLICT, 7)
            raise ZeroDivisionError("records are broken")

    bench = bench_with(Broken())
    assert answer_to(bench, "5E 00 01 F0") == "DE 80 A0 00"
    line = Broken.ask.__code__.co_firstlineno + 3
    assert bench.texts() == [
        "slave 8 (recorder): Read of slot 0, index 1 of master 2 refused: its function failed "
        f"(ZeroDivisionError: records are broken), in ask(), test_ms1_slave.py line {line}"
    ]
    assert answer_to(bench, "5F 00 01 00") == "DF 80 B5 07"
    answer_to(bench, "5F 01 02 05 BB")
    assert bench.texts() == ["slave 8 (recorder): MS1 of master 2 refused: octet 4 says 5 octets of data, 1 came"]
    assert bench.app.state is SlaveAppState.DATA_EXCH
    assert bench.app.failure is None


# --- I&M ----------------------------------------------------------------------------------------------------------


def test_im_by_the_call_function() -> None:
    changed: list[object] = []
    im = ImRecords([Im0(order_id="X"), Im1("fan", "hall")], RecordTable(TABLE), lambda *one: changed.append(one))
    bench = bench_with(im)
    assert answer_to(bench, "5F 00 FF 04 08 00 FD E8") == "5F 00 FF 04"
    read = bytes.fromhex(answer_to(bench, "5E 00 FF F0"))
    assert read[:8] == bytes.fromhex("5E 00 FF 44 08 00 FD E8")
    assert read[8:][12:32] == b"X".ljust(20)
    assert read[-2:] == b"\x00\x02"  # I&M1 is there
    # I&M1 is written whole, then read
    assert answer_to(bench, "5F 00 FF 44 08 00 FD E9" + Im1("pump", "cellar").build().hex()) == "5F 00 FF 44"
    assert changed == [(0, Im1("pump", "cellar"))]
    assert im.of()[1] == Im1("pump", "cellar")
    assert bytes.fromhex(answer_to(bench, "5E 00 FF F0"))[18:22] == b"pump"
    assert answer_to(bench, "5E 00 01 F0") == "5E 00 01 03 11 22 33"  # others as ever


@pytest.mark.parametrize(
    ("write", "response"),
    [
        ("5F 00 FF 04 08 00 FD EB", "DF 80 B7 00"),  # no I&M3
        ("5F 00 FF 05 08 00 FD E9 00", "DF 80 B1 00"),
        ("5F 00 FF 05 08 00 FD E8 00", "DF 80 B6 00"),  # I&M0 is read-only
        ("5F 00 FF 04 09 00 FD E8", "DF 80 B5 00"),  # no call
        ("5F 00 FF 02 08 00", "DF 80 B5 00"),
        ("5E 03 FF F0", "DE 80 B5 00"),  # nothing was called in this slot
    ],
)
def test_im_refusals(write: str, response: str) -> None:
    bench = bench_with(ImRecords([Im0(), Im1()]))
    assert answer_to(bench, write) == response


def test_im_by_slot() -> None:
    changed: list[object] = []
    each: dict[int, list[Im]] = {0: [Im0(order_id="HEAD"), Im1("line", "")], 2: [Im0(order_id="8DI")]}
    im = ImRecords(each, None, lambda *one: changed.append(one))
    bench = bench_with(im)
    assert answer_to(bench, "5F 02 FF 04 08 00 FD E8") == "5F 02 FF 04"
    read = bytes.fromhex(answer_to(bench, "5E 02 FF F0"))
    assert read[20:40] == b"8DI".ljust(20)
    assert read[-2:] == b"\0\0"
    assert answer_to(bench, "5F 01 FF 04 08 00 FD E8") == "DF 80 B2 00"  # nothing is plugged there
    assert answer_to(bench, "5F 02 FF 04 08 00 FD E9") == "DF 80 B7 00"  # no I&M1 there
    assert answer_to(bench, "5F 00 FF 44 08 00 FD E9" + Im1("pump", "cellar").build().hex()) == "5F 00 FF 44"
    assert changed == [(0, Im1("pump", "cellar"))]
    assert (im.of(0)[1:], im.of(1), im.of(2)) == ((Im1("pump", "cellar"),), (), (Im0(order_id="8DI"),))


@pytest.mark.parametrize(
    ("raises", "response"), [(RecordRefused(0xB6, 4), "DF 80 B6 04"), (OSError("disk full"), "DF 80 A1 00")]
)
def test_im_that_cannot_be_kept_is_not_taken(raises: Exception, response: str) -> None:
    def keep(slot: int, record: object) -> None:
        raise raises

    bench = bench_with(ImRecords([Im0(), Im1("fan")], None, keep))
    assert answer_to(bench, "5F 00 FF 44 08 00 FD E9" + Im1("pump").build().hex()) == response
    assert answer_to(bench, "5F 00 FF 04 08 00 FD E9") == "5F 00 FF 04"
    assert bytes.fromhex(answer_to(bench, "5E 00 FF F0"))[18:21] == b"fan"
    assert bool(bench.texts()) is isinstance(raises, OSError)


def test_im_that_do_not_fit_are_refused_at_once() -> None:
    with pytest.raises(ValueError, match=r"slots are 0\.\.254"):
        ImRecords({255: [Im0()]})
    with pytest.raises(ValueError, match="descriptor"):
        ImRecords([Im3("x" * 55)])
