"""The time and the rhythm of services beside the cycle, by either way, read off the wire: a slave's time ends at each
step of a service, polls get rarer, and no token hold has two requests.

Slaves are octets; the times are those of the sources' decisions, written down here once more.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest
from ms1_kit import Ms1Bus, answer
from ms1_kit import status as ms1_status
from ms2_kit import DL, MS, SC, Ms2Bus, connected, sd1, sd2
from octet_slave import NR, RR, UE
from ring_bus import RingBus

from dpstack.dp.acyclic.class2 import ReadService, Service
from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordDone

LIMIT = 100 * MS
RDL = 0x0C
#: more than the rest of a token hold, a data exchange and the longest pause
SOON = 15 * MS


def to_sap(bus: RingBus, sap: int, since: int = 0) -> list[int]:
    """When requests and polls to ``sap`` began; what the link layer repeats at once is one."""
    starts: list[int] = []
    last = b""
    for sent in bus.log:
        if sent.sender == 2:
            if sent.octets[0] == 0x68 and sent.octets[7] == sap and sent.start >= since and sent.octets != last:
                starts.append(sent.start)
            last = sent.octets
    return starts


# --- the slave's time -----------------------------------------------------------------------------------------------

#: what a slave says to the request, and then to each poll, for ever; words for the octets below
NEVER_DONE = [
    ("not now", "not now"),
    ("no resource", "no resource"),
    ("taken", "taken"),
    ("taken", "no data"),
    ("taken", "not now"),
    ("taken", "another's"),
    ("old data", "old data"),
    ("another's", "taken"),
]


@pytest.mark.parametrize(("to_request", "to_poll"), NEVER_DONE)
def test_a_slaves_time_ends_at_every_step_of_ms1(to_request: str, to_poll: str) -> None:
    words = {
        "not now": ms1_status(4, RR),
        "no resource": ms1_status(4, UE),
        "no data": ms1_status(4, NR),
        "taken": SC,
        "another's": answer(4, "5E 09 09 01 11"),
        "old data": answer(4, "5E 09 09 01 11", RDL),
    }
    kit = Ms1Bus(dpv1=Dpv1(c1_response_timeout_ns=LIMIT))
    kit.slave.ms1 = lambda data: words[to_request if data else to_poll]
    done = kit.read()
    assert done.outcome.failure is ServiceFailure.LATE
    assert ("busy all the time" in done.text) == (to_request in ("not now", "no resource"))
    assert (done.stale > 0) == ("another's" in (to_request, to_poll) or to_request == "old data")
    in_time(kit.bus, 51, done.t_ns)


@pytest.mark.parametrize(("to_request", "to_poll"), NEVER_DONE)
def test_a_slaves_time_ends_at_every_step_over_a_connection(to_request: str, to_poll: str) -> None:
    kit = connected(send_timeout_ns=2_000 * MS, response_ns=LIMIT)
    begun = kit.bus.now
    kit.slave.says[48] = over_ms2(48, to_request, to_poll, "5E 09 09 01 11")
    done = kit.read(1)
    assert done.outcome.failure is ServiceFailure.LATE
    assert "within 0.1 s (its C2_Response_Timeout)" in done.text
    assert (done.stale > 0) == ("another's" in (to_request, to_poll) or to_request == "old data")
    in_time(kit.bus, 48, done.t_ns, begun)


@pytest.mark.parametrize(("to_request", "to_poll"), NEVER_DONE)
def test_a_slaves_time_ends_at_every_step_of_initiate(to_request: str, to_poll: str) -> None:
    """``another's`` is Idle here: the resource manager has no other services."""
    kit = Ms2Bus()
    kit.slave.says[49] = over_ms2(49, to_request, to_poll, "48 01")
    done = kit.open(response_ns=LIMIT)
    assert done.outcome.failure is ServiceFailure.LATE
    assert "its resource manager has no answer to Initiate within 0.1 s" in done.text
    in_time(kit.bus, 49, done.t_ns)


@pytest.mark.parametrize("to_poll", ["not now", "no data", "taken"])
def test_a_slaves_time_ends_at_the_server_sap(to_poll: str) -> None:
    kit = Ms2Bus()
    kit.slave.says[48] = over_ms2(48, "taken", to_poll, "")
    done = kit.open(response_ns=LIMIT)
    assert done.outcome.failure is ServiceFailure.LATE
    in_time(kit.bus, 48, done.t_ns)


def over_ms2(sap: int, to_request: str, to_poll: str, other: str) -> Callable[[bytes], bytes]:
    words = {
        "not now": sd1(2, 4, RR),
        "no resource": sd1(2, 4, UE),
        "no data": sd1(2, 4, NR),
        "taken": SC,
        "another's": sd2(2, 4, DL, 50, sap, bytes.fromhex(other)),
        "old data": sd2(2, 4, RDL, 50, sap, bytes.fromhex(other)),
    }
    return lambda octets: words[to_request if octets[9:-2] else to_poll]


def in_time(bus: RingBus, sap: int, end: int, since: int = 0) -> None:
    """The time counts from the first request's first bit on; what is asked last is asked within it or right after."""
    asked = [start for start in to_sap(bus, sap, since) if start < end]
    assert LIMIT <= end - asked[0] < LIMIT + SOON
    assert asked[-1] - asked[0] < LIMIT + SOON


def busy_at_ms1(limit: int) -> tuple[int, list[int], int]:
    """A slave that never has its answer, at MS1: the first request's first bit, the ends of answers, the service's."""
    kit = Ms1Bus(dpv1=Dpv1(c1_response_timeout_ns=limit))
    kit.bus.run(5 * MS)
    since = kit.bus.now
    end = kit.read().t_ns
    return to_sap(kit.bus, 51, since)[0], answers(kit.bus, since), end


def busy_over_ms2(limit: int) -> tuple[int, list[int], int]:
    """The same over a connection."""
    kit = connected(send_timeout_ns=2_000 * MS, response_ns=limit)
    kit.slave.says[48] = lambda octets: SC
    since = kit.bus.now
    end = kit.read(1).t_ns
    return to_sap(kit.bus, 48, since)[0], answers(kit.bus, since), end


def answers(bus: RingBus, since: int) -> list[int]:
    return [sent.end for sent in bus.log if sent.octets == SC and sent.start >= since]


@pytest.mark.parametrize("busy", [busy_at_ms1, busy_over_ms2])
def test_a_slaves_time_is_exact(busy: Callable[[int], tuple[int, list[int], int]]) -> None:
    """It is over with the answer that ends in that nanosecond; one nanosecond more is another poll."""
    first, found, _ = busy(LIMIT)
    limit = found[5] - first
    assert busy(limit)[::2] == (first, found[5])
    assert busy(limit + 1)[::2] == (first, found[6])


def test_the_time_counts_from_the_request_and_not_from_the_order() -> None:
    """The second Read waits for the first one, and then has all its time."""
    kit = Ms1Bus(dpv1=Dpv1(c1_response_timeout_ns=LIMIT))
    first, second = kit.order_read(), kit.order_read(1, 3)
    kit.bus.run(80 * MS)
    kit.slave.ms1 = lambda data: SC if data else answer(4, "5E 01 02 00")
    assert kit.end(first).outcome.failure is None
    begun = kit.bus.now
    kit.slave.ms1 = lambda data: SC
    assert kit.end(second).outcome.failure is ServiceFailure.LATE
    assert LIMIT - 2 * MS <= kit.bus.now - begun < LIMIT + SOON


@pytest.mark.parametrize("baud", [9_600, 500_000])
def test_an_answer_owed_is_waited_for_as_long_as_the_slave_may_take(baud: int) -> None:
    """Not for a number of polls: at 9600 bit/s each of them takes a rotation of 50 ms."""
    kit = Ms1Bus(dpv1=Dpv1(c1_response_timeout_ns=4 * LIMIT), baud=baud)
    assert kit.read().outcome.failure is ServiceFailure.LATE
    kit.slave.ms1 = lambda data: answer(4, "5E 01 02 01 22") if data else SC
    begun = kit.bus.now
    assert kit.read().outcome.data == b"\x22"
    rotation = 60 * MS * 9_600 // baud
    assert 4 * LIMIT <= kit.bus.now - begun < 4 * LIMIT + SOON + 4 * rotation


# --- the rhythm -----------------------------------------------------------------------------------------------------

#: before each poll, in ms: four in as many token holds, then rarer
PAUSES = [0, 0, 0, 0, 1, 2, 5, 10, 10, 10]
#: before a slave is asked again that says nothing
SILENT = [10, 20, 40, 80, 160, 160]


def gaps_ms(starts: list[int]) -> list[float]:
    return [(late - early) / MS for early, late in pairwise(starts)]


def hold_pauses(starts: list[int], pauses: list[int], more_ms: int) -> int:
    """Each pause is kept, and is at most ``more_ms`` longer; the number of pauses."""
    gaps = gaps_ms(starts)
    assert all(pause <= gap < pause + more_ms for pause, gap in zip(pauses, gaps, strict=False))
    return len(gaps)


def test_polls_get_rarer_at_ms1() -> None:
    kit = Ms1Bus()
    kit.order_read()
    kit.bus.run(60 * MS)
    hold_pauses(to_sap(kit.bus, 51), PAUSES, 3)


def test_polls_get_rarer_over_a_connection() -> None:
    kit = connected(send_timeout_ns=2_000 * MS)
    kit.slave.says[48] = lambda octets: SC
    begun = kit.bus.now
    kit.order_read(1)
    kit.bus.run(60 * MS)
    hold_pauses(to_sap(kit.bus, 48, begun), PAUSES, 3)


def test_polls_get_rarer_at_the_resource_manager() -> None:
    kit = Ms2Bus()
    kit.slave.says[49] = lambda octets: SC
    kit.order_open()
    kit.bus.run(60 * MS)
    hold_pauses(to_sap(kit.bus, 49), PAUSES, 3)


def test_a_silent_slave_is_asked_more_and_more_seldom() -> None:
    """Over a connection the slave is polled for what it may have taken, until its time is over."""
    kit = connected(send_timeout_ns=1_000 * MS, response_ns=600 * MS)
    kit.slave.mute = True
    begun = kit.bus.now
    kit.order_read(1)
    kit.bus.run(600 * MS)
    assert hold_pauses(to_sap(kit.bus, 48, begun), SILENT, 6) >= len(SILENT)


def test_a_read_that_is_not_answered_goes_out_four_times() -> None:
    kit = Ms1Bus()
    kit.slave.ms1 = lambda data: None
    assert kit.read().outcome.failure is ServiceFailure.SILENT
    assert hold_pauses(to_sap(kit.bus, 51), SILENT, 6) == 3


@pytest.mark.parametrize("status", [RR, UE, RDL])
def test_a_request_that_is_not_taken_now_is_repeated_every_10_ms(status: int) -> None:
    """By either way; RDL: old data are given away."""
    old = status == RDL
    ms1 = Ms1Bus()
    ms1.slave.ms1 = lambda data: answer(4, "5E 09 09 01 11", RDL) if old else ms1_status(4, status)
    ms1.order_read()
    ms2 = Ms2Bus()
    ms2.open(send_timeout_ns=2_000 * MS)
    begun = ms2.bus.now
    given = sd2(2, 4, RDL, 50, 48, bytes.fromhex("5E 09 09 01 11"))
    ms2.slave.says[48] = lambda octets: given if old else sd1(2, 4, status)
    ms2.order_read(1)
    for bus, sap, since in ((ms1.bus, 51, 0), (ms2.bus, 48, begun)):
        bus.run(100 * MS)
        found = gaps_ms(to_sap(bus, sap, since))
        assert len(found) >= 7
        assert all(10 <= gap < 13 for gap in found)


def test_a_slave_at_ms1_is_given_up_after_four_polls_without_an_answer_in_a_row() -> None:
    """Three, an answer, three again: it goes on. Each has its repetition."""
    kit = Ms1Bus()
    script = iter("......w......w")

    def ms1(data: bytes) -> bytes | None:
        if data:
            return SC
        return {".": None, "w": SC}.get(next(script, ""), answer(4, "5E 01 02 01 55"))

    kit.slave.ms1 = ms1
    assert kit.read().outcome.data == b"\x55"
    script = iter("......w" + "." * 8)
    assert kit.read().outcome.failure is ServiceFailure.SILENT
    assert next(script, "") == ""


def test_an_initiate_nobody_answers_goes_out_once_and_polls_ask_for_its_answer() -> None:
    """Four without an answer in a row give up. Others follow more and more seldom: the slave may have taken it."""
    kit = Ms2Bus(())
    assert kit.open().outcome.failure is ServiceFailure.SILENT
    asked = [sent.octets for sent in kit.bus.log if sent.octets[0] == 0x68 and sent.octets[7] == 49]
    said = "".join("n" if len(octets) == 11 else "I" for octets in asked)
    assert said.startswith("Innnn")
    assert said.count("I") == 1
    hold_pauses(to_sap(kit.bus, 49)[:7], SILENT, 6)


def test_one_request_a_token_hold_whatever_it_belongs_to() -> None:
    """Read of two slaves, a class 2 service, Initiate to a station that is not there."""
    kit = Ms1Bus((4, 5))
    for _ in range(3):
        kit.order_read(address=4)
        kit.order_read(address=5)
    start = len(kit.bus.log)
    kit.send(ReadService(100, 5, Service.CONFIG))
    kit.send(OpenConnection(101, 9))
    kit.bus.run(100 * MS)
    holds: list[list[bytes]] = [[]]
    for sent in kit.bus.log[start:]:
        if sent.octets[0] == 0xDC:
            holds.append([])
        elif sent.sender == 2 and sent.octets[0] == 0x68 and (not holds[-1] or sent.octets != holds[-1][-1]):
            holds[-1].append(sent.octets)
    acyclic = [[octets[7] for octets in hold if octets[4] & 0x80] for hold in holds]
    assert max(map(len, acyclic)) == 1
    assert {51, 59, 49} <= {sap for hold in acyclic for sap in hold}


def test_ends_are_told_when_they_are() -> None:
    """The time of an end is that of what ended it, for either class."""
    kit = Ms2Bus()
    opened = kit.open()
    done = kit.read(1)
    over = kit.close(1)
    assert isinstance(opened, InitiateDone)
    assert isinstance(done, RecordDone)
    assert opened.outcome == Outcome()
    for event in (opened, done, over):
        assert event.t_ns in [sent.end for sent in kit.bus.log if sent.sender == 4]
    assert opened.t_ns < done.t_ns < over.t_ns
