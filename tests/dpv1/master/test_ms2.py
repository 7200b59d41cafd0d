"""Class 2 connections of the master against slaves of octets: literal telegrams, services, Idle, several at once."""

from __future__ import annotations

from typing import Any

import pytest
from ms2_kit import DL, MS, SC, Ms2Bus, connected, connections_of, sd1, sd2, served
from octet_slave import NR, RR, UE

from dpstack.dp.acyclic.job import CancelService, ServiceFailure
from dpstack.dpv1.master.alarm_orders import ConnectionOver
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.ms2 import Address, InitiateReq
from dpstack.dpv1.pdu.read_write import Function
from dpstack.errors import UsageError

RDL = 0x0C


def telegrams(kit: Ms2Bus, start: int) -> list[str]:
    """Telegrams since ``start`` of the log, without tokens and FDL status."""
    return [s.octets.hex(" ") for s in kit.bus.log[start:] if s.octets[0] in (0x68, 0xE5)]


@pytest.fixture
def kit() -> Ms2Bus:
    return Ms2Bus()


def test_literal_telegrams(kit: Ms2Bus) -> None:
    kit.slave.timeout = b"\x00\x64"
    start = len(kit.bus.log)
    done = kit.open(send_timeout_ns=2_000 * MS)
    assert (done.server_sap, done.send_timeout_ns, done.max_len) == (48, 2_000 * MS, 240)
    assert telegrams(kit, start) == [
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
    assert telegrams(kit, start) == [
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
    assert telegrams(kit, start) == ["68 08 08 68 84 82 5d 30 32 58 00 20 3d 16", "e5"]
    assert (over.reason, over.abort, over.server_sap, over.ordered) == ("it was closed here", (0, 2, 0), 48, True)
    kit.freed()


def test_answers_in_the_requests_themselves(kit: Ms2Bus) -> None:
    kit.slave.direct = True
    assert kit.open().server_sap == 48
    assert kit.read(1).outcome.data == b"\1\2"
    assert [pdu[:1].hex() for _, pdu in kit.slave.heard] == ["57", "", "5e"]
    kit.close(1)
    kit.freed()


@pytest.mark.parametrize("sap", [0, 17, 48])
def test_every_server_sap(kit: Ms2Bus, sap: int) -> None:
    kit.slave.free = [sap]
    assert kit.open().server_sap == sap
    assert kit.read(1).outcome.data == b"\1\2"
    kit.close(1)
    kit.freed()


@pytest.mark.parametrize("not_yet", [SC, sd1(2, 4, NR), sd1(2, 4, 0), sd1(2, 4, RR), sd1(2, 4, UE)])
def test_the_slave_answers_not_yet_or_not_now(kit: Ms2Bus, not_yet: bytes) -> None:
    """Each answer of the slave comes after ten polls that say so, in four ways."""
    usual, turns = kit.slave.usual, [0]

    def slow(octets: bytes) -> bytes | None:
        if octets[9:-2]:
            return usual(octets)
        turns[0] += 1
        return usual(octets) if turns[0] % 10 == 0 else not_yet

    kit.slave.says = {48: slow, 49: slow}
    assert kit.open().outcome.failure is None
    assert kit.read(1).outcome.data == b"\1\2"


@pytest.mark.parametrize("busy", [RR, UE])
@pytest.mark.parametrize("sap", [48, 49])
def test_a_request_that_is_not_taken_now_is_repeated(kit: Ms2Bus, busy: int, sap: int) -> None:
    refused = kit.slave.says_first(3, sap, sd1(2, 4, busy))
    kit.open()
    assert kit.read(1).outcome.data == b"\1\2"
    assert len(refused) == 3


def test_old_data_come_before_the_request_is_taken() -> None:
    """RDL: old data, and the request was not taken (docs/reference/protocol.md#function-code)."""
    kit = connected()
    kit.slave.says_first(2, 48, sd2(2, 4, RDL, 50, 48, b"\x5e\x07\x07\x01\x07"))
    done = kit.read(1)
    assert (done.outcome.data, done.stale) == (b"\1\2", 2)


def test_idle_from_the_master() -> None:
    kit = connected()
    kit.run(500)
    assert kit.slave.received(0x48) == [b"\x48\x01"] * 7  # every third of 200 ms
    assert kit.read(1).outcome.data == b"\1\2"
    kit.close(1)
    kit.freed()


def test_services_are_signs_of_life() -> None:
    kit = connected()
    for _ in range(10):
        kit.read(1)
        kit.run(50)
    assert not kit.slave.received(0x48)


@pytest.mark.parametrize("answers", [False, True], ids=["Idle", "its answer"])
def test_an_idle_that_is_lost_is_sent_again(kit: Ms2Bus, answers: bool) -> None:
    """With every attempt, and then the slave says at polls that there is nothing."""
    connection = kit.open(send_timeout_ns=600 * MS).token
    idles = lost = 0

    def say(octets: bytes) -> bytes | None:
        """Every other Idle does not come through, or the poll that has fetched its answer."""
        nonlocal idles, lost
        idle = octets[9:-2] == b"\x48\x01"
        idles += idle
        if lost == 1 or (not answers and idle and lost == 0):
            lost += 1
            return None
        answer = kit.slave.ms2(48, octets[9:-2])
        if answers and answer is not None and lost == 0:
            lost = 1
            return None
        if answer is not None:
            lost = 0
        return SC if answer is None else sd2(2, 4, DL, 50, 48, answer)

    kit.slave.says[48] = say
    kit.run(4_000)
    assert kit.events_of(ConnectionOver) == []
    assert idles in (range(18, 22) if answers else range(27, 31))  # after 200 ms, and 200 ms later again
    lost = 9
    assert kit.read(connection).outcome.failure is None


def test_unanswered_idle_ends_the_connection() -> None:
    kit = connected(response_ns=200 * MS)
    kit.slave.serve = lambda pdu: None
    assert kit.over(1).reason == "Idle had no answer in time"
    kit.freed()


def test_idle_from_the_slave_gives_it_more_time() -> None:
    """A slave that works at it for 400 ms, with 120 ms for an answer, and says so every 80 ms."""
    kit = connected(response_ns=120 * MS, send_timeout_ns=400 * MS)
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


def test_a_cancelled_service_does_not_end_the_connection() -> None:
    """The answer is fetched before anything else is asked: the slave takes one service at a time."""
    kit = connected()
    kit.slave.polls = 12
    for order in ({}, {"timeout_ns": 20 * MS}):
        token = kit.order_read(1, **order, run_ms=20)
        if not order:
            kit.send(CancelService(token))
        failure = kit.end_of(token, RecordDone).outcome.failure
        assert failure is (ServiceFailure.LATE if order else ServiceFailure.CANCELLED)
        done = kit.read(1, 3, 4)
        assert (done.outcome.data, done.stale) == (b"\3\4", 1)
    kit.close(1)
    kit.freed()


def test_the_answer_to_a_cancelled_service_is_fetched_without_another_service() -> None:
    """At once, not with the next Idle."""
    kit = connected()
    kit.slave.polls = 7
    token = kit.order_read(1, run_ms=5)
    kit.send(CancelService(token))
    assert kit.slave.sessions[48].waiting
    kit.run(30)
    assert not kit.slave.sessions[48].waiting
    assert not kit.slave.received(0x48)


def test_a_cancelled_service_that_was_never_sent_leaves_no_answer() -> None:
    kit = connected()
    first, second = kit.order_read(1), kit.order_read(1, 5, 6)
    kit.send(CancelService(second))
    assert kit.end_of(second, RecordDone).outcome.failure is ServiceFailure.CANCELLED
    assert kit.end_of(first, RecordDone).outcome.data == b"\1\2"
    assert kit.read(1, 7, 8).stale == 0


def test_a_cancelled_service_that_the_slave_did_not_take_leaves_no_answer() -> None:
    """The slave answered "not now": waiting for its answer would end the connection."""
    kit = connected()
    kit.slave.says[48] = lambda octets: sd1(2, 4, 0x02)
    token = kit.order_read(1, run_ms=5)
    kit.send(CancelService(token))
    assert kit.end_of(token, RecordDone).outcome.failure is ServiceFailure.CANCELLED
    kit.slave.says.clear()
    done = kit.read(1, 7, 8)
    assert (done.outcome.data, done.stale) == (b"\7\x08", 0)


@pytest.mark.parametrize("lost", [(0,), (1,), (0, 1), (1, 2), (2,), (3,), (2, 3)])
def test_telegrams_of_a_read_are_lost(lost: tuple[int, ...]) -> None:
    """A Read ends once. A request that is lost with its repetition ends the connection: the slave may have taken it."""
    kit = connected(response_ns=200 * MS)
    kit.lose(lost)
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
        ends = [kit.end_of(token, RecordDone) for token in mine]
        assert [(end.address, end.outcome.data) for end in ends] == [
            (done.address, bytes((slot, done.token))) for slot in range(8)
        ]
    assert connections_of(kit.acyclic) == 4
    kit.close(opened[0].token)
    assert kit.read(opened[2].token).outcome.data == b"\1\2"
    for done in opened[1:]:
        kit.close(done.token)
    kit.freed()


def test_a_slow_connection_holds_no_other_one_up() -> None:
    kit = connected()
    kit.open()
    kit.slave.serve = lambda pdu: None if pdu[1:3] == b"\1\1" else served(pdu)
    slow = kit.order_read(1, 1, 1)
    for _ in range(10):
        assert kit.read(2).outcome.data == b"\1\2"
    assert not [done for done in kit.events_of(RecordDone) if done.token == slow]


def test_one_request_a_token_hold() -> None:
    kit = Ms2Bus((4, 5))
    kit.open(4)
    kit.open(5)
    start = len(kit.bus.log)
    for _ in range(10):
        kit.order_read(1)
        kit.order_read(2)
    kit.run(100)
    kinds = "".join("t" if s.octets[0] == 0xDC else "r" for s in kit.bus.log[start:] if s.sender == 2)
    assert kinds.count("r") >= 40
    assert "rr" not in kinds


def test_misuse_raises_at_once(kit: Ms2Bus) -> None:
    kit.slave.initiate = bytes.fromhex("57 20 01 00 00 00 00 00 00 02 00 02 00 00 00 00")
    assert kit.open().max_len == 32
    for wrong, what in [
        (OpenConnection(9, 127), "address 127: a slave has"),
        (OpenConnection(9, 2), "address 2 is that of this master itself"),
        (OpenConnection(9, 4, InitiateReq(700_000 * MS)), r"a send time-out of 700 s is not possible: 0\.\.655\.35 s"),
        (OpenConnection(9, 4, InitiateReq(0)), "a send time-out of 0 s or less ends a connection at once"),
        (OpenConnection(9, 4, response_ns=-MS), "-0.001 s is no time for an answer"),
        (OpenConnection(9, 4, InitiateReq(MS, profile_ident=70_000)), "profile_ident"),
        (RecordOrder(9, Function.READ, 0, 0, connection=7), "there is no open class 2 connection 7; open a new one"),
        (RecordOrder(9, Function.READ, 255, 0, 8, connection=1), "slot 255 does not exist"),
        (RecordOrder(9, Function.READ, 0, 256, 8, connection=1), "index 256 does not exist"),
        (
            RecordOrder(9, Function.READ, 0, 0, 33, connection=1),
            r"takes up to 32 octets of data in one service \(Max_Len_Data_Unit",
        ),
        (RecordOrder(9, Function.WRITE, 0, 0, data=bytes(33), connection=1), "takes up to 32"),
        (RecordOrder(9, Function.WRITE, 0, 0, data=bytes(241), connection=1), "241 octets of data, 240 are possible"),
        (
            RecordOrder(9, Function.DATA_TRANSPORT, 0, 0, data=bytes(241), connection=1),
            "241 octets of data, 240 are possible",
        ),
    ]:
        with pytest.raises(UsageError, match=what):
            kit.send(wrong)
    assert connections_of(kit.acyclic) == 1
    for _ in range(32):
        kit.order_read(1, length=8)
    with pytest.raises(UsageError, match="32 services for slave 4 are waiting already"):
        kit.order_read(1, length=8)
    kit.run(300)
    assert kit.slave.received(0x48)  # and it is kept alive


def test_addresses_and_profile_of_initiate(kit: Ms2Bus) -> None:
    net = bytes.fromhex("05 06 01 02 03 04 05 06 07")
    token = kit.next_token()
    profile: Any = {"profile_ident": 0x9700, "profile_features": 0x0102}
    request = InitiateReq(2_000 * MS, source=Address(7, 8), destination=Address(5, 6, net[2:]), **profile)
    kit.send(OpenConnection(token, 4, request))
    kit.end_of(token, InitiateDone)
    assert kit.slave.heard[0][1] == bytes.fromhex("57 000000 00C8 0100 0102 9700 00 02 01 09 07 08") + net
