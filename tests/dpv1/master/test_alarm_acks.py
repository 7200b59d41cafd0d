"""Alarm_Ack of a master: its time, its place between other services, every answer to it."""

from __future__ import annotations

import pytest
from alarm_kit import ALL, AlarmBus, AlarmSlave, block, refusing
from ms1_kit import MS, answer, status
from octet_slave import NR, RR, RS, SC

from dpstack.dp.acyclic.job import ServiceFailure
from dpstack.dp.pdu.dpv1_status import Dpv1

PROCESS = block(2, 3, 1, data="12 34")


@pytest.fixture
def kit() -> AlarmBus:
    return AlarmBus()


@pytest.fixture
def slave(kit: AlarmBus) -> AlarmSlave:
    return kit.alarm_slave


def test_held_until_the_application_has_it(kit: AlarmBus, slave: AlarmSlave) -> None:
    kit.hold()
    kit.raise_and_run(500, PROCESS, block(2, 4))
    assert kit.blocks == [PROCESS]
    assert kit.raised[0].held
    assert not slave.acks
    kit.acknowledge(1)
    kit.acknowledge(1)
    kit.until(lambda: len(kit.raised) == 2)
    assert slave.taken == [PROCESS]
    kit.hold(False)  # nobody listens any more: it is acknowledged
    kit.until_ended(2)
    assert [end.number for end in kit.ends] == [1, 2]


def test_in_sequence_mode_in_the_order_the_application_likes() -> None:
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, alarm_mode=2))
    slave = kit.alarm_slave
    slave.at_a_time = 4
    kit.hold()
    blocks = [block(2, 1, 0, number) for number in range(6)]
    kit.raise_and_run(200, *blocks)
    assert kit.blocks == blocks[:4]
    assert kit.counts.too_many == 0
    for number in (3, 1, 4, 2):
        kit.acknowledge(number)
        kit.run(50)
    assert slave.taken == [blocks[2], blocks[0], blocks[3], blocks[1]]
    assert kit.blocks == blocks


def test_at_sap_50_beside_a_read_that_takes_its_time() -> None:
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, extra_alarm_sap=True))
    slave = kit.alarm_slave
    slave.sap = 50
    token = kit.order_read(run_ms=20)  # the slave acknowledges, and never answers
    slave.raises(PROCESS)
    kit.until_taken(1, 100)
    assert not kit.done
    assert slave.asked[0] == bytes.fromhex("5E 01 02 F0")
    kit.end(token)


def test_at_sap_51_where_sap_50_is_closed_after_all() -> None:
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, extra_alarm_sap=True))
    slave = kit.alarm_slave
    slave.says[50] = lambda octets: status(4, RS)
    kit.raise_and_end(PROCESS, block(2, 4), block(2, 5))
    assert slave.taken == [PROCESS, block(2, 4), block(2, 5)]
    assert (kit.counts.raised, kit.counts.acknowledged, kit.counts.refused) == (3, 3, 0)
    assert len([remark for remark in kit.remarks if "SAP 50 is closed" in remark]) == 1


def test_sap_50_that_is_closed_by_a_second_acknowledgement_has_taken_the_first() -> None:
    """Every response to it was lost. SAP 51 would be closed by a third one (DPC31), and with it Read and Write."""
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, extra_alarm_sap=True, c1_response_timeout_ns=20 * MS))
    slave = kit.alarm_slave
    slave.sap, slave.polls = 50, 1
    kit.raise_and_end(PROCESS)
    slave.raises(block(2, 4))
    slave.lose(["", *"aaaaaaaa"])
    kit.until_taken(2)
    slave.says[50] = lambda octets: status(4, RS) if octets[9:-2] else SC
    at_51: list[bytes] = []

    def say(octets: bytes) -> bytes:
        at_51.append(octets)
        return status(4, RS)

    slave.says[51] = say
    kit.until_ended(2)
    assert (kit.counts.acknowledged, kit.counts.refused, at_51) == (2, 0, [])


def test_at_sap_51_before_reads_that_wait(kit: AlarmBus, slave: AlarmSlave) -> None:
    polls = iter([SC] * 20)
    slave.ms1 = lambda data: next(polls, None) or answer(4, "5E 01 02 01 55")
    tokens = [kit.order_read() for _ in range(32)]
    kit.run(5)
    slave.raises(PROCESS)
    kit.until_taken(1, 200)
    assert len(kit.done) <= 2
    for token in tokens:
        assert kit.end(token).outcome.data == b"\x55"


@pytest.mark.parametrize("polls", [-1, 0, 7])
def test_answered_at_once_or_later(kit: AlarmBus, polls: int) -> None:
    kit.alarm_slave.polls = polls
    kit.raise_and_end(PROCESS, PROCESS)
    assert kit.alarm_slave.acks == [b"\x5c\x03\x02\x01"] * 2
    assert kit.counts.repeated == 0


def test_an_acknowledgement_that_is_lost_is_repeated_the_alarm_is_not() -> None:
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, c1_response_timeout_ns=20 * MS))
    slave = kit.alarm_slave
    slave.raises(PROCESS)
    slave.lose("rrrr")
    kit.until_ended()
    assert slave.acks == [b"\x5c\x03\x02\x01"]
    assert kit.blocks == slave.taken == [PROCESS]
    assert kit.counts.repeated >= 1
    (remark,) = kit.remarks
    assert remark.startswith("does not answer Alarm_Ack of process alarm, slot 3, sequence number 0")


def test_the_answer_to_it_is_lost_and_fetched() -> None:
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, c1_response_timeout_ns=20 * MS))
    slave = kit.alarm_slave
    slave.raises(PROCESS)
    slave.lose("aa")
    kit.until_ended()
    assert slave.acks == [b"\x5c\x03\x02\x01"]  # never a second one: its response was still there
    assert not slave.strays
    assert kit.blocks == slave.taken == [PROCESS]


def test_the_answer_to_it_is_fetched_by_the_read_after_it() -> None:
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, c1_response_timeout_ns=20 * MS))
    slave = kit.alarm_slave
    slave.raises(PROCESS)
    slave.lose("aa")
    kit.until(lambda: bool(kit.remarks))
    slave.ms1 = lambda data: answer(4, "5E 01 02 01 55") if data else SC
    assert kit.read().outcome.data == b"\x55"
    kit.until_ended()
    assert len(slave.acks) == 1
    assert kit.counts.acknowledged == 1


@pytest.mark.parametrize("answers", ["silent", "refused", "again"])
def test_a_second_acknowledgement_that_the_slave_does_not_know(answers: str) -> None:
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, c1_response_timeout_ns=20 * MS))
    slave = kit.alarm_slave
    slave.on_stray = {"silent": lambda ack: None, "refused": refusing("B0"), "again": lambda ack: ack}[answers]
    slave.polls = 1
    slave.raises(PROCESS)
    slave.lose(["", *"aaaaaaaa"])  # all polls: the response is gone
    kit.until(lambda: bool(slave.strays))
    slave.raises(PROCESS)  # the next one, exactly alike
    kit.until_taken(2)
    assert kit.blocks == [PROCESS] * 2


@pytest.mark.parametrize("code", ["B5", "C2"])
def test_busy_is_asked_again(kit: AlarmBus, slave: AlarmSlave, code: str) -> None:
    slave.refuses = [code, code]
    kit.raise_and_end(PROCESS)
    assert kit.ends[0].outcome.failure is None
    assert kit.counts.repeated == 2
    assert kit.blocks == [PROCESS]


def test_busy_and_then_refused_is_refused(kit: AlarmBus) -> None:
    kit.alarm_slave.refuses = ["C2", "B2"]
    kit.raise_and_end(PROCESS)
    assert kit.ends[0].outcome.failure is ServiceFailure.NEGATIVE
    assert (kit.counts.refused, kit.counts.acknowledged) == (1, 0)


def test_a_refused_acknowledgement_ends_the_alarm_and_is_reported_once(kit: AlarmBus, slave: AlarmSlave) -> None:
    slave.refuses = ["B2", "B2"]
    kit.raise_and_run(500, PROCESS)
    slave.open.clear()
    kit.raise_and_run(500, block(2, 4))
    assert [end.outcome.failure for end in kit.ends] == [ServiceFailure.NEGATIVE] * 2
    assert kit.counts.refused == 2
    assert kit.blocks == [PROCESS, block(2, 4)]
    assert kit.remarks[0].startswith(
        "refuses Alarm_Ack of process alarm, slot 3, sequence number 0: invalid slot (80 B2 00"
    )


def test_closed_sap(kit: AlarmBus, slave: AlarmSlave) -> None:
    slave.says[51] = lambda octets: status(4, RS)
    kit.raise_and_end(PROCESS)
    assert kit.ends[0].outcome.failure is ServiceFailure.REFUSED
    assert "SAP 51 is closed; see Extra_Alarm_SAP_supp" in kit.remarks[0]


@pytest.mark.parametrize("octets", ["5C 03 02", "5C 03 02 01 00", "DC 80 B5"])
def test_a_response_that_cannot_be_read(kit: AlarmBus, slave: AlarmSlave, octets: str) -> None:
    slave.says[51] = lambda asked: answer(4, octets)
    kit.raise_and_end(PROCESS)
    assert kit.ends[0].outcome.failure is ServiceFailure.LENGTH
    assert kit.blocks == [PROCESS]


def test_answers_to_others_and_not_now_come_before_it(kit: AlarmBus, slave: AlarmSlave) -> None:
    told = iter(
        [status(4, RR), status(4, NR), answer(4, "5E 01 02 00"), answer(4, "5C 04 02 01"), answer(4, "DE 80 B5 00")]
    )
    slave.says[51] = lambda octets: next(told, None) or answer(4, "5C 03 02 01")
    kit.raise_and_end(PROCESS)
    assert kit.ends[0].outcome.failure is None
    assert not kit.remarks


@pytest.mark.parametrize("offers_again", [False, True])
def test_equal_alarms_after_a_lost_telegram_behind_the_diagnosis(offers_again: bool) -> None:
    """A slave offers a diagnosis again in the first exchange after the silence; a later one is new."""
    kit = AlarmBus()
    slave = kit.alarm_slave
    slave.polls, slave.offers_again = 4, offers_again
    first, alike, other = block(1, 1), block(6, 0), block(32, 1)
    lost: list[str] = []

    def loses() -> str:
        """Both attempts of the poll that comes right behind the diagnosis with ``alike``: the slave has heard it."""
        if len(lost) == 1 or (not lost and slave.unsure and slave.shown == alike):
            lost.append("a")
            return "a"
        return ""

    slave.loses = loses
    slave.raises(first)
    kit.until_taken()
    kit.raise_and_end(alike, alike, other, count=4)  # while the response to the first is fetched
    assert lost == ["a", "a"]
    assert kit.blocks == [first, alike, alike, other]
    assert slave.taken == [first, alike, alike, other]
