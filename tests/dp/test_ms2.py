"""Class 2 connections of the master against slaves of octets: literal telegrams, each way they end, nothing is kept."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from ms2_kit import DL, MS, SC, Ms2Bus, OctetMs2Slave, sd1, sd2, served
from octet_slave import NR, RR, UE
from ring_bus import Sent

from dpstack.dp.acyclic import CancelService
from dpstack.dp.acyclic_job import ServiceFailure
from dpstack.dp.reading import reading_only
from dpstack.dp.v1.ms1 import RecordDone
from dpstack.dp.v1.ms2_orders import (
    CloseConnection,
    CloseConnections,
    ConnectionOver,
    ConnectionsClosed,
    InitiateDone,
    OpenConnection,
    ReadOver,
    TransportOver,
    WriteOver,
)
from dpstack.errors import UsageError
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.machine import LineDown, LineUp

RDL = 0x0C


def said(kit: Ms2Bus, start: int) -> list[str]:
    """Telegrams since ``start`` of the log, tokens and FDL status left out."""
    return [s.octets.hex(" ") for s in kit.bus.log[start:] if s.octets[0] in (0x68, 0xE5)]


def test_literal_telegrams() -> None:
    kit = Ms2Bus()
    kit.slave.timeout = b"\x00\x64"
    start = len(kit.bus.log)
    done = kit.open(send_timeout_ns=2_000 * MS)
    assert (done.server_sap, done.send_timeout_ns, done.max_len, done.features) == (48, 2_000 * MS, 240, 0x0100)
    assert said(kit, start) == [
        # SRD high, DSAP 49, SSAP 50: Initiate with a send time-out of 200 x 10 ms, DPV1_RW, S_Len and D_Len 2
        "68 19 19 68 84 82 6d 31 32 57 00 00 00 00 c8 01 00 00 00 00 00 00 02 00 02 00 00 00 00 fa 16",
        "e5",
        "68 05 05 68 84 82 5d 31 32 c6 16",  # polled: server SAP 48, 100 x 10 ms at least
        "68 09 09 68 82 84 08 32 31 56 30 00 64 5b 16",
        "68 05 05 68 84 82 7d 30 32 e5 16",
        "68 15 15 68 82 84 08 32 30 57 f0 01 00 00 00 00 00 00 02 00 02 00 00 00 00 bc 16",
    ]
    start = len(kit.bus.log)
    assert kit.read(1, 1, 2).outcome.data == b"\1\2"
    assert kit.write(1, 0, 47, b"\1\2").outcome.failure is None
    assert kit.transport(1, 0, 47, b"\1\2\3").outcome.data == b"\1\2\3"
    assert said(kit, start) == [
        "68 09 09 68 84 82 5d 30 32 5e 01 02 f0 16 16",
        "e5",
        "68 05 05 68 84 82 7d 30 32 e5 16",
        "68 0b 0b 68 82 84 08 32 30 5e 01 02 02 01 02 d6 16",
        "68 0b 0b 68 84 82 5d 30 32 5f 00 2f 02 01 02 58 16",
        "e5",
        "68 05 05 68 84 82 7d 30 32 e5 16",
        "68 09 09 68 82 84 08 32 30 5f 00 2f 02 00 16",
        "68 0c 0c 68 84 82 5d 30 32 51 00 2f 03 01 02 03 4e 16",
        "e5",
        "68 05 05 68 84 82 7d 30 32 e5 16",
        "68 0c 0c 68 82 84 08 32 30 51 00 2f 03 01 02 03 f9 16",
    ]
    start = len(kit.bus.log)
    over = kit.close(1)
    assert said(kit, start) == ["68 08 08 68 84 82 5d 30 32 58 00 20 3d 16", "e5"]
    assert (over.reason, over.abort, over.server_sap, over.ordered) == ("it was closed here", (0, 2, 0), 48, True)
    kit.freed()


def test_answers_in_the_requests_themselves() -> None:
    kit = Ms2Bus()
    kit.slave.direct = True
    assert kit.open().server_sap == 48
    assert kit.read(1).outcome.data == b"\1\2"
    assert [pdu[:1].hex() for _, pdu in kit.slave.heard] == ["57", "", "5e"]
    kit.close(1)
    kit.freed()


@pytest.mark.parametrize("sap", [0, 17, 48])
def test_every_server_sap(sap: int) -> None:
    kit = Ms2Bus()
    kit.slave.free = [sap]
    assert kit.open().server_sap == sap
    assert kit.read(1).outcome.data == b"\1\2"
    kit.close(1)
    kit.freed()


@pytest.mark.parametrize("not_yet", [SC, sd1(2, 4, NR), sd1(2, 4, 0), sd1(2, 4, RR), sd1(2, 4, UE)])
def test_not_yet_and_not_now(not_yet: bytes) -> None:
    """Each answer of the slave comes after ten polls that say so, in four ways."""
    kit = Ms2Bus()
    usual, turns = usual_of(kit.slave), [0]

    def slow(octets: bytes) -> bytes | None:
        if octets[9:-2]:
            return usual(octets)
        turns[0] += 1
        return usual(octets) if turns[0] % 10 == 0 else not_yet

    kit.slave.says = {48: slow, 49: slow}
    assert kit.open().outcome.failure is None
    assert kit.read(1).outcome.data == b"\1\2"


def usual_of(slave: OctetMs2Slave) -> Callable[[bytes], bytes | None]:
    """What it answers without what ``says`` has."""

    def say(octets: bytes) -> bytes | None:
        says, slave.says = slave.says, {}
        try:
            return slave.service(octets)
        finally:
            slave.says = says

    return say


@pytest.mark.parametrize("busy", [RR, UE])
@pytest.mark.parametrize("sap", [48, 49])
def test_a_request_that_is_not_taken_now_is_repeated(busy: int, sap: int) -> None:
    kit = Ms2Bus()
    usual = usual_of(kit.slave)
    times = [3]

    def say(octets: bytes) -> bytes | None:
        if octets[9:-2] and times[0]:
            times[0] -= 1
            return sd1(2, 4, busy)
        return usual(octets)

    kit.slave.says[sap] = say
    kit.open()
    assert kit.read(1).outcome.data == b"\1\2"
    assert times == [0]


def test_old_data_are_given_away_first() -> None:
    """RDL: old data, and the request was not taken (A3)."""
    kit = Ms2Bus()
    kit.open()
    usual, times = usual_of(kit.slave), [2]

    def say(octets: bytes) -> bytes | None:
        if octets[9:-2] and times[0]:
            times[0] -= 1
            return sd2(2, 4, RDL, 50, 48, b"\x5e\x07\x07\x01\x07")
        return usual(octets)

    kit.slave.says[48] = say
    done = kit.read(1)
    assert (done.outcome.data, done.stale) == (b"\1\2", 2)


# --- how Initiate ends --------------------------------------------------------------------------------------------


def failed(kit: Ms2Bus, **more: int) -> InitiateDone:
    """An Initiate that leaves nothing."""
    done = kit.open(**more)
    kit.freed()
    assert not kit.told(ConnectionOver)
    assert done.outcome.failure is not None
    return done


def test_no_connection_left_or_none_at_all() -> None:
    kit = Ms2Bus()
    kit.slave.free = [48]
    kit.open()
    done = kit.open()
    assert done.outcome.failure is ServiceFailure.REFUSED
    assert done.outcome.status == "RS"
    assert done.text == (
        "slave 4 refuses Initiate (RS at SAP 49): all its class 2 connections are in use (1 of them from here), or it "
        "has none (C2_Read_Write_supp of its GSD file)"
    )
    assert kit.read(1).outcome.data == b"\1\2"
    kit.close(1)
    assert kit.open().server_sap == 48


def test_nobody_there() -> None:
    kit = Ms2Bus(())
    done = failed(kit)
    assert done.outcome.failure is ServiceFailure.SILENT
    assert done.text == "slave 4 does not answer Initiate; check address and power"


@pytest.mark.parametrize(
    ("answer", "failure", "text"),
    [
        ("58 00 1F", ServiceFailure.ABORTED, "it has no connection left (ABT_RES)"),
        ("58 02 12", ServiceFailure.ABORTED, "a request that cannot be read (ABT_FE in a remote subnet)"),
        ("58", ServiceFailure.ABORTED, "the slave aborted it, but why cannot be read"),
        ("D7 80 C3 00", ServiceFailure.NEGATIVE, "slave 4 refuses Initiate: resource unavailable (80 C3 00"),
        ("57 F0", ServiceFailure.LENGTH, "cannot be read"),
        ("56 31 00 64", ServiceFailure.LENGTH, "49 is no server SAP"),
        ("56 30 00", ServiceFailure.LENGTH, "cannot be read"),
        ("5E 01 02 00", ServiceFailure.LENGTH, "octet 1 is 0x5E"),
    ],
)
def test_the_resource_manager_says_something_else(answer: str, failure: ServiceFailure, text: str) -> None:
    kit = Ms2Bus()
    kit.slave.says[49] = lambda octets: SC if octets[9:-2] else sd2(2, 4, DL, 50, 49, bytes.fromhex(answer))
    done = kit.open()
    assert done.outcome.failure is failure
    assert text in done.text
    kit.freed()


@pytest.mark.parametrize(
    ("answer", "failure", "text"),
    [
        (
            "58 00 16",
            ServiceFailure.ABORTED,
            "is too short (ABT_STO); ask for 200 ms or more",
        ),
        ("58 00 17", ServiceFailure.ABORTED, "ABT_IA"),
        ("58 00 25", ServiceFailure.ABORTED, "its user, reason 5"),
        ("D7 80 B2 00", ServiceFailure.NEGATIVE, "slave 4 refuses Initiate: invalid slot"),
        ("57 F0 01 00", ServiceFailure.LENGTH, "cannot be read"),
        ("57 F0 01 00 00 00 00 00 00 02 00 09 00 00 00 00", ServiceFailure.LENGTH, "2 and 9 octets of addresses"),
        ("5E 01 02 00", ServiceFailure.LENGTH, "slave 4 answers Initiate with what cannot be read"),
    ],
)
def test_the_server_sap_refuses(answer: str, failure: ServiceFailure, text: str) -> None:
    kit = Ms2Bus()
    kit.slave.initiate = bytes.fromhex(answer)
    done = failed(kit)
    assert done.outcome.failure is failure
    assert text in done.text
    if failure is ServiceFailure.ABORTED:
        octets = bytes.fromhex(answer)
        assert done.outcome.codes == (octets[1], octets[2] >> 4, octets[2] & 15)
    told = [pdu for sap, pdu in kit.slave.heard if pdu[:1] == b"\x58"]
    assert told == ([b"\x58\x00\x14"] if failure is ServiceFailure.LENGTH else [])  # ABT_RE


def test_the_longer_send_timeout_counts() -> None:
    kit = Ms2Bus()
    kit.slave.timeout = b"\x01\x90"
    assert kit.open(send_timeout_ns=100 * MS).send_timeout_ns == 4_000 * MS
    assert kit.open(send_timeout_ns=5_000 * MS).send_timeout_ns == 5_000 * MS


def test_a_slave_that_never_answers_initiate() -> None:
    kit = Ms2Bus()
    kit.slave.polls = 1 << 20
    done = failed(kit, response_ns=300 * MS)
    assert done.outcome.failure is ServiceFailure.LATE
    assert "has no answer to Initiate within 0.3 s (its C2_Response_Timeout)" in done.text
    assert kit.slave.heard[-1] == (48, b"\x58\x00\x13")  # ABT_TO


def test_a_resource_manager_that_never_answers() -> None:
    kit = Ms2Bus()
    kit.slave.says[49] = lambda octets: SC
    done = failed(kit, response_ns=300 * MS)
    assert done.outcome.failure is ServiceFailure.LATE
    assert "its resource manager has no answer to Initiate within 0.3 s" in done.text


def test_a_server_sap_given_out_twice_stays_whose_it_is() -> None:
    kit = Ms2Bus()
    kit.slave.free = [48, 48]
    kit.open()
    done = kit.open()
    assert done.outcome.failure is ServiceFailure.WRONG
    assert "gives out server SAP 48, which is in use by this master" in done.text
    assert all(pdu[:1] != b"\x58" for _, pdu in kit.slave.heard)


@pytest.mark.parametrize("lost", [(0,), (0, 1), (1,), (1, 2), (2, 3), (3,), (4,), (5,)])
def test_telegrams_of_initiate_are_lost(lost: tuple[int, ...]) -> None:
    """Requests and answers, with their repetitions: there is a connection in the end, and nothing else."""
    kit = Ms2Bus()
    count = [0]

    def drop(sent: Sent) -> bool:
        octets = sent.octets
        if octets[0] not in (0x68, 0xE5):
            return False
        count[0] += 1
        return count[0] - 1 in lost

    kit.bus.drop = drop
    done = kit.open()
    assert done.outcome.failure is None, done.text
    assert kit.read(1).outcome.data == b"\1\2"


@pytest.mark.parametrize("step", range(24))
def test_cancelled_or_closed_at_every_step(step: int) -> None:
    """Of Initiate and the Read after it: the slave keeps nothing, and gives out all its connections again."""
    for order in (CancelService, CloseConnection):
        kit = Ms2Bus()
        kit.slave.polls = 3
        kit.order_open()
        kit.bus.run(step * MS // 4)
        kit.send(order(1))
        kit.bus.run(100 * MS)
        done = kit.end(1, InitiateDone)
        if done.outcome.failure is None and order is CancelService:
            kit.close(1)  # it was too late to cancel it
        kit.freed()
        assert kit.slave.free == [48, 47]
        assert len(kit.told(ConnectionOver)) == (done.outcome.failure is None)


def test_initiate_has_its_time() -> None:
    kit = Ms2Bus()
    kit.slave.polls = 1 << 20
    token = kit.order_open(timeout_ns=50 * MS)
    done = kit.end(token, InitiateDone)
    assert done.outcome.failure is ServiceFailure.LATE
    kit.freed()


# --- how a connection ends ----------------------------------------------------------------------------------------

_ABORTS = [
    ("00 11", "a service that is not allowed in this state (ABT_SE)"),
    ("00 12", "a request that cannot be read (ABT_FE)"),
    ("01 13", "nothing was heard from the other end in time (ABT_TO in its own subnet)"),
    ("00 14", "a response that cannot be read (ABT_RE)"),
    ("00 15", "an impossible service of its user (ABT_IV)"),
    ("00 16", "the send time-out asked for is too short (ABT_STO)"),
    ("00 17", "ABT_IA"),
    ("00 18", "it still waits for the end of a service (ABT_OC)"),
    ("02 1F", "it has no connection left (ABT_RES in a remote subnet)"),
    ("00 1A", "reason 10"),
    ("00 02", "its link layer: no resource (RR)"),
    ("00 24", "its user, reason 4"),
    ("00 3C", "instance 3, reason 12, both reserved"),
    ("00 11 00 00 03 03", "ABT_SE"),
]


@pytest.mark.parametrize(("abort", "text"), _ABORTS)
def test_the_slave_aborts(abort: str, text: str) -> None:
    kit = Ms2Bus()
    kit.open()
    octets = b"\x58" + bytes.fromhex(abort)
    kit.slave.serve = lambda pdu: octets
    first, second = kit.order_read(1), kit.order_read(1)
    done = kit.end(first, RecordDone)
    codes = (octets[1], octets[2] >> 4 & 3, octets[2] & 15)
    assert (done.outcome.failure, done.outcome.codes) == (ServiceFailure.ABORTED, codes)
    assert text in done.text
    assert "Read of slot 1, index 2 has no answer, the class 2 connection is over: the slave aborted it: " in done.text
    assert kit.end(second, RecordDone).outcome == done.outcome
    over = kit.over(1)
    assert (over.abort, over.ordered) == (codes, False)
    assert text in over.text
    assert kit.slave.heard[-1][1][:1] != b"\x58"  # it knows
    kit.freed()
    with pytest.raises(UsageError, match="there is no open class 2 connection 1; open a new one"):
        kit.order_read(1)


def test_a_server_sap_that_is_closed_at_once() -> None:
    """A slave that was restarted knows nothing of the connection."""
    kit = Ms2Bus()
    kit.open()
    kit.slave.sessions.clear()
    done = kit.read(1)
    assert done.outcome.failure is ServiceFailure.ABORTED
    assert "the slave has closed server SAP 48 (RS): it was restarted" in done.text
    kit.over(1)
    kit.freed()


@pytest.mark.parametrize(
    "answer",
    ["5E 01 02 05 01 02", "5E 01 02 00 01", "5E", "5E 01 02 F1" + " 55" * 240, "DE 80", "00", "57 00", "56 30 00 64"],
)
def test_lengths_that_lie_end_it(answer: str) -> None:
    kit = Ms2Bus()
    kit.open()
    kit.slave.serve = lambda pdu: bytes.fromhex(answer)
    done = kit.read(1)
    assert done.outcome.failure is ServiceFailure.LENGTH
    assert kit.over(1).abort == (0, 1, 4)
    assert kit.slave.heard[-1] == (48, b"\x58\x00\x14")  # ABT_RE
    kit.freed()


def test_more_than_was_asked_for() -> None:
    kit = Ms2Bus()
    kit.open()
    kit.slave.serve = lambda pdu: b"\x5e\x01\x02\x03\x01\x02\x03"
    done = kit.read(1, length=2)
    assert "with 3 octets, 2 were asked for" in done.text
    kit.over(1)
    kit.freed()


def test_a_negative_answer_ends_the_service_only() -> None:
    kit = Ms2Bus()
    kit.open()
    kit.slave.serve = lambda pdu: bytes((pdu[0] | 0x80, 0x80, 0xB5, 7))
    for done in (kit.read(1), kit.write(1, 1, 2, b"\1"), kit.transport(1, 1, 2, b"")):
        assert (done.outcome.failure, done.outcome.codes) == (ServiceFailure.NEGATIVE, (0x80, 0xB5, 7))
        assert "state conflict" in done.text
    kit.slave.serve = served
    assert kit.read(1).outcome.data == b"\1\2"


def test_answers_to_other_requests_are_dropped() -> None:
    kit = Ms2Bus()
    kit.open()
    session = kit.slave.sessions[48]

    def serve(pdu: bytes) -> bytes:
        for other in ("5E 09 09 00", "5F 01 02 00", "DF 80 B0 00", "DE 80 B0 00" if pdu[0] == 0x51 else "D1 80 B0 00"):
            if other != "D1 80 B0 00":
                session.waiting.append((1, bytes.fromhex(other)))
        return served(pdu) or b""

    kit.slave.serve = serve
    done = kit.read(1)
    assert (done.outcome.data, done.stale) == (b"\1\2", 3)


def test_a_slave_that_never_answers_a_service() -> None:
    kit = Ms2Bus()
    kit.open(response_ns=400 * MS)
    kit.slave.serve = lambda pdu: None
    begun = kit.bus.now
    done = kit.read(1)
    assert 400 * MS <= kit.bus.now - begun < 450 * MS
    assert done.outcome.failure is ServiceFailure.LATE
    assert done.text == (
        "slave 4 has no answer to Read of slot 1, index 2 within 0.4 s (its C2_Response_Timeout); "
        "the connection was ended"
    )
    assert kit.over(1).reason == "Read of slot 1, index 2 had no answer in time"
    assert kit.slave.heard[-1] == (48, b"\x58\x00\x13")
    kit.freed()


def test_a_write_without_an_answer_may_have_been_carried_out() -> None:
    kit = Ms2Bus()
    kit.open(response_ns=100 * MS)
    kit.slave.serve = lambda pdu: None
    assert kit.write(1, 1, 2, b"\1").text.endswith("; it may have been carried out")
    kit.over(1)
    ref = kit.open().token
    kit.slave.serve = lambda pdu: b"\x58\x00\x11"
    assert kit.transport(ref, 1, 2, b"\1").text.endswith("(ABT_SE); it may have been carried out")
    ref = kit.open().token
    kit.slave.serve = lambda pdu: None
    tokens = [kit.token(), kit.token()]
    for token in tokens:
        kit.send(WriteOver(token, ref, 1, 2, b"\1"))
    kit.bus.run(5 * MS)
    kit.send(CloseConnection(ref))
    under_way, waiting = (kit.end(token, RecordDone).text for token in tokens)
    assert under_way.endswith("is over: it was closed here; it may have been carried out")
    assert waiting.endswith("is over: it was closed here")  # it was never sent
    kit.freed()


def test_the_slave_vanishes() -> None:
    kit = Ms2Bus()
    kit.open()
    kit.slave.mute = True
    begun = kit.bus.now
    done = kit.read(1)
    assert 190 * MS < kit.bus.now - begun < 210 * MS
    assert done.outcome.failure is not None
    assert "nothing was heard of the slave for 0.2 s (the send time-out)" in done.text
    kit.over(1)
    kit.freed()


def test_the_slave_vanishes_while_nothing_is_asked() -> None:
    kit = Ms2Bus()
    kit.open()
    kit.slave.mute = True
    begun = kit.bus.now
    assert kit.over(1).reason == "nothing was heard of the slave for 0.2 s (the send time-out)"
    assert kit.bus.now - begun < 400 * MS
    kit.freed()


def test_idle_from_the_master() -> None:
    kit = Ms2Bus()
    kit.open()
    kit.bus.run(500 * MS)
    idles = [pdu for sap, pdu in kit.slave.heard if pdu[:1] == b"\x48"]
    assert idles == [b"\x48\x01"] * 7  # every third of 200 ms
    assert kit.read(1).outcome.data == b"\1\2"
    kit.close(1)
    kit.freed()


def test_services_are_signs_of_life() -> None:
    kit = Ms2Bus()
    kit.open()
    for _ in range(10):
        kit.read(1)
        kit.bus.run(50 * MS)
    assert all(pdu[:1] != b"\x48" for _, pdu in kit.slave.heard)


def test_idle_that_is_not_answered_ends_it() -> None:
    kit = Ms2Bus()
    kit.open(response_ns=200 * MS)
    kit.slave.serve = lambda pdu: None
    assert kit.over(1).reason == "Idle had no answer in time"
    kit.freed()


def test_idle_from_the_slave_gives_it_more_time() -> None:
    """A slave that works at it for 400 ms, with 120 ms for an answer, and says so every 80 ms."""
    kit = Ms2Bus()
    kit.open(response_ns=120 * MS, send_timeout_ns=400 * MS)
    begun = kit.bus.now
    idled = [0]

    def say(octets: bytes) -> bytes:
        if octets[9:-2]:
            return SC
        if kit.bus.now - begun > 399 * MS:
            return sd2(2, 4, DL, 50, 48, b"\x5e\x01\x02\x01\x55")
        if kit.bus.now - begun > (idled[0] + 1) * 80 * MS:
            idled[0] += 1
            return sd2(2, 4, DL, 50, 48, b"\x48\x01")
        return SC

    kit.slave.says[48] = say
    assert kit.read(1).outcome.data == b"\x55"
    assert idled == [4]


def test_a_service_that_is_given_up_leaves_the_connection() -> None:
    """The answer is fetched before anything else is asked: the slave takes one service at a time."""
    kit = Ms2Bus()
    kit.open()
    kit.slave.polls = 12
    for order in ({}, {"timeout_ns": 20 * MS}):
        token = kit.order_read(1, **order)
        kit.bus.run(20 * MS)
        if not order:
            kit.send(CancelService(token))
        failure = kit.end(token, RecordDone).outcome.failure
        assert failure is (ServiceFailure.LATE if order else ServiceFailure.CANCELLED)
        done = kit.read(1, 3, 4)
        assert (done.outcome.data, done.stale) == (b"\3\4", 1)
    kit.close(1)
    kit.freed()


def test_the_answer_to_a_given_up_service_is_fetched_where_nothing_else_is_asked() -> None:
    kit = Ms2Bus()
    kit.open()
    kit.slave.polls = 12
    token = kit.order_read(1)
    kit.bus.run(20 * MS)
    kit.send(CancelService(token))
    kit.bus.run(150 * MS)
    assert [answer for _, answer in kit.slave.sessions[48].waiting] in ([], [b"\x48\x01"])


def test_a_cancelled_service_that_was_never_sent_owes_nothing() -> None:
    kit = Ms2Bus()
    kit.open()
    first, second = kit.order_read(1), kit.order_read(1, 5, 6)
    kit.send(CancelService(second))
    assert kit.end(second, RecordDone).outcome.failure is ServiceFailure.CANCELLED
    assert kit.end(first, RecordDone).outcome.data == b"\1\2"
    assert kit.read(1, 7, 8).stale == 0


@pytest.mark.parametrize("lost", [(0,), (1,), (0, 1), (1, 2), (2,), (3,), (2, 3)])
def test_telegrams_of_a_read_are_lost(lost: tuple[int, ...]) -> None:
    """It ends once; a request that was lost with its repetition ends the connection, for it may have been taken."""
    kit = Ms2Bus()
    kit.open(response_ns=200 * MS)
    count = [0]

    def drop(sent: Sent) -> bool:
        octets = sent.octets
        if octets[0] not in (0x68, 0xE5):
            return False
        count[0] += 1
        return count[0] - 1 in lost

    kit.bus.drop = drop
    done = kit.read(1)
    if lost == (0, 1):
        assert done.outcome.failure is ServiceFailure.LATE
        kit.over(1)
    else:
        assert done.outcome.data == b"\1\2"
        kit.close(1)
    kit.freed()


# --- several connections ------------------------------------------------------------------------------------------


def test_several_to_several_slaves_and_to_one() -> None:
    kit = Ms2Bus((4, 5))
    opened = [kit.open(address) for address in (4, 5, 4, 5)]
    assert [done.server_sap for done in opened] == [48, 48, 47, 47]
    tokens = [[kit.order_read(done.token, slot, done.token) for slot in range(8)] for done in opened]  # all at once
    for done, mine in zip(opened, tokens, strict=True):
        ends = [kit.end(token, RecordDone) for token in mine]
        assert [(end.address, end.outcome.data) for end in ends] == [
            (done.address, bytes((slot, done.token))) for slot in range(8)
        ]
    assert kit.acyclic.connections == 4
    kit.close(opened[0].token)
    assert kit.read(opened[2].token).outcome.data == b"\1\2"
    for done in opened[1:]:
        kit.close(done.token)
    kit.freed()


def test_a_slow_connection_holds_no_other_one_up() -> None:
    kit = Ms2Bus()
    kit.open()
    kit.open()
    kit.slave.serve = lambda pdu: None if pdu[1:3] == b"\1\1" else served(pdu)
    slow = kit.order_read(1, 1, 1)
    for _ in range(10):
        assert kit.read(2).outcome.data == b"\1\2"
    assert not [done for done in kit.told(RecordDone) if done.token == slow]


def test_one_request_a_token_hold() -> None:
    kit = Ms2Bus((4, 5))
    kit.open(4)
    kit.open(5)
    start = len(kit.bus.log)
    for _ in range(10):
        kit.order_read(1)
        kit.order_read(2)
    kit.bus.run(100 * MS)
    kinds = "".join("t" if s.octets[0] == 0xDC else "r" for s in kit.bus.log[start:] if s.sender == 2)
    assert kinds.count("r") >= 40
    assert "rr" not in kinds


# --- ends from outside --------------------------------------------------------------------------------------------


def test_closed_with_services_waiting() -> None:
    kit = Ms2Bus()
    kit.open()
    kit.slave.polls = 100
    tokens = [kit.order_read(1) for _ in range(3)]
    kit.bus.run(10 * MS)
    kit.send(CloseConnection(1))
    for token in tokens:
        outcome = kit.end(token, RecordDone).outcome
        assert (outcome.failure, outcome.codes) == (ServiceFailure.ABORTED, (0, 2, 0))
        assert outcome.text.endswith("the class 2 connection is over: it was closed here")
    kit.over(1)
    kit.freed()
    kit.send(CloseConnection(1))  # once more is no error
    kit.send(CloseConnection(99))


def test_all_are_closed() -> None:
    kit = Ms2Bus((4, 5))
    kit.send(CloseConnections())
    assert len(kit.told(ConnectionsClosed)) == 1  # there were none
    for address in (4, 5, 4):
        kit.open(address)
    kit.order_open(5)
    kit.send(CloseConnections())
    with pytest.raises(UsageError, match="the bus is being closed"):
        kit.order_open()
    kit.bus.run(50 * MS)
    assert len(kit.told(ConnectionsClosed)) == 2
    kit.freed()
    assert {over.reason for over in kit.told(ConnectionOver)} == {"the bus was closed here"}


def test_the_port_vanishes_and_comes_back() -> None:
    """The slave still holds it: it is told."""
    kit = Ms2Bus()
    kit.open()
    token = kit.order_read(1)
    opening = kit.order_open()
    kit.bus.run(2 * MS)
    kit.send(LineDown("unplugged"))
    assert kit.end(token, RecordDone).outcome.failure is ServiceFailure.LINE
    assert kit.end(opening, InitiateDone).outcome.failure is ServiceFailure.LINE
    kit.bus.run(100 * MS)
    kit.send(LineUp())
    assert "the port vanished (unplugged)" in kit.over(1).reason
    kit.freed()
    assert kit.open().outcome.failure is None


def test_the_port_vanishes_for_good() -> None:
    kit = Ms2Bus()
    kit.open()
    kit.send(LineDown("unplugged"))
    kit.over(1)
    assert kit.acyclic.connections == kit.acyclic.waiting == 0


def test_the_station_leaves_the_ring() -> None:
    kit = Ms2Bus()
    kit.open()
    token = kit.order_read(1)
    kit.send(GoOffline())
    done = kit.end(token, RecordDone)
    assert "nothing was heard of the slave" in done.text
    kit.bus.run(300 * MS)
    kit.send(GoOnline())
    kit.over(1)
    assert kit.acyclic.connections == kit.acyclic.waiting == 0


def test_a_read_only_bus() -> None:
    kit = Ms2Bus(guard=reading_only)
    done = failed(kit)
    assert done.outcome.failure is ServiceFailure.GUARDED
    assert done.text == "slave 4: Initiate was not sent; this bus is read-only"


def test_misuse_raises_at_once() -> None:
    kit = Ms2Bus()
    kit.slave.initiate = bytes.fromhex("57 20 01 00 00 00 00 00 00 02 00 02 00 00 00 00")
    assert kit.open().max_len == 32
    for wrong, what in [
        (OpenConnection(9, 127), "127 is no address of a slave"),
        (OpenConnection(9, 2), "2 is the address of this master itself"),
        (OpenConnection(9, 4, 700_000 * MS), "a send time-out of"),
        (OpenConnection(9, 4, source=b"\0"), "an address in Initiate has API and access level"),
        (OpenConnection(9, 4, profile_ident=70_000), "profile_ident"),
        (ReadOver(9, 7, 0, 0), "there is no open class 2 connection 7; open a new one"),
        (ReadOver(9, 1, 255, 0, 8), "slot 255 does not exist"),
        (ReadOver(9, 1, 0, 256, 8), "index 256 does not exist"),
        (ReadOver(9, 1, 0, 0, 33), r"takes up to 32 octets of data in one service \(Max_Len_Data_Unit"),
        (WriteOver(9, 1, 0, 0, bytes(33)), "takes up to 32"),
        (WriteOver(9, 1, 0, 0, bytes(241)), "241 octets of data, 240 are possible"),
        (TransportOver(9, 1, 0, 0, bytes(241)), "241 octets of data, 240 are possible"),
    ]:
        with pytest.raises(UsageError, match=what):
            kit.send(wrong)
    assert kit.acyclic.connections == 1
    for _ in range(32):
        kit.order_read(1, length=8)
    with pytest.raises(UsageError, match="32 services for slave 4 are waiting already"):
        kit.order_read(1, length=8)
    kit.bus.run(300 * MS)
    assert [pdu for _, pdu in kit.slave.heard if pdu[:1] == b"\x48"]  # and it is kept alive


def test_addresses_and_profile_go_out_as_they_are_given() -> None:
    kit = Ms2Bus()
    net = bytes.fromhex("05 06 01 02 03 04 05 06 07")
    token = kit.token()
    kit.send(OpenConnection(token, 4, profile_ident=0x9700, profile_features=0x0102, source=b"\7\x08", destination=net))
    kit.end(token, InitiateDone)
    assert kit.slave.heard[0][1] == bytes.fromhex("57 000000 00C8 0100 0102 9700 00 02 01 09 07 08") + net
