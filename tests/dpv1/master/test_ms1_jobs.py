"""Jobs of MS1 as the queue of services sees them: lanes, times, reasons to wait, warnings."""

from __future__ import annotations

from typing import Any

import pytest
from alarm_kit import ALL, AlarmBus, block
from ms1_kit import MS, SC, Ms1Bus, answer
from support import present

from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.dp.pdu.alarm_blocks import Alarm
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.alarm_handler import AckJob, Alarms, OpenAlarm, Stage
from dpstack.dpv1.master.ms1 import Ms1, RecordJob, Turn
from dpstack.dpv1.master.orders import RecordDone, RecordOrder
from dpstack.dpv1.master.plugin_queue import PendingRecord
from dpstack.dpv1.pdu.read_write import Function, ReadReq, WriteReq
from dpstack.units import NEVER


def ms1_of(kit: Ms1Bus) -> Ms1:
    return next(one for one in kit.acyclic.providers if isinstance(one, Ms1))


def job_of(kit: Ms1Bus, **order: Any) -> tuple[int, RecordJob, int]:
    found = present(ms1_of(kit).job_of(RecordOrder(**{"token": 7, "slot": 1, "index": 2, "address": 4, **order})))
    token, job, timeout = found
    assert isinstance(job, RecordJob)
    return token, job, timeout


def test_orders_become_jobs() -> None:
    kit = Ms1Bus()
    token, read, timeout = job_of(kit, function=Function.READ)
    assert (token, read.lane, read.address, timeout) == (7, 4, 4, 10_000 * MS)
    assert (read.title, read.stale, read.timeout_ns) == ("Read of slot 1, index 2", 0, 10_000 * MS)
    assert (read.repeats, read.hint, read.aftermath, read.bar()) == (True, "; try again", "", "")
    token, write, timeout = job_of(kit, function=Function.WRITE, data=b"\1", timeout_ns=5)
    assert (token, write.lane, timeout, write.title) == (7, 4, 5, "Write of slot 1, index 2")
    assert (write.repeats, write.aftermath) == (False, "")  # it was not sent yet
    assert write.hint == "; it may have been carried out: read it back"
    assert ms1_of(kit).job_of(RecordOrder(7, Function.READ, 1, 2, connection=3)) is None
    assert ms1_of(kit).job_of("anything else") is None
    slow = Ms1Bus(dpv1=Dpv1(c1_response_timeout_ns=20_000 * MS))
    assert job_of(slow, function=Function.READ)[1].timeout_ns == 21_000 * MS


def test_an_acknowledgement_has_the_lane_of_its_sap() -> None:
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, extra_alarm_sap=True))
    (alarms,) = (one for one in kit.acyclic.providers if isinstance(one, Alarms))
    handler = alarms._alarms[4]
    known = OpenAlarm(1, Alarm(2, 3, 1, 5), block(2, 3, 1, 5), Stage.WAITING)
    job = AckJob(known, handler, ms1_of(kit))
    assert (job.lane, job.title) == (4 | 50 << 8, "Alarm_Ack of process alarm, slot 3, sequence number 5")
    assert (job.repeats, job.hint, job.settled) == (False, "", False)
    assert job.why_closed == "see Extra_Alarm_SAP_supp of its GSD file (dpv1 = { extra_alarm_sap = ... })"
    handler.extra_sap = False
    assert AckJob(known, handler, ms1_of(kit)).lane == 4
    for late, of_use in (("5C 03 02 28", False), ("DC 80 B5 00", False), ("5E 01 02 00", False), ("5C 03 02 29", True)):
        assert job.accept_late(bytes.fromhex(late)) is of_use
        assert known.answered is of_use
    assert job.settled
    assert job.outcome_of(bytes.fromhex("5C 03 02 29")) == Outcome()
    assert job.outcome_of(bytes.fromhex("5E 03 02 29")) is None
    assert job.outcome_of(bytes.fromhex("DE 80 B5 00")) is None
    refused = present(job.outcome_of(bytes.fromhex("DC 80 B5 07")))
    assert (refused.failure, refused.codes) == (ServiceFailure.NEGATIVE, (0x80, 0xB5, 7))


def test_units_wait_for_record_47() -> None:
    kit = Ms1Bus()
    ms1 = ms1_of(kit)
    since = kit.master.handlers[4].since
    _, mine, _ = job_of(kit, function=Function.READ, index=47, user=1)
    _, other, _ = job_of(kit, function=Function.READ, index=46)
    for user, until, begun, held in (
        (1, NEVER, since, False), (2, NEVER, since, True), (2, 11, since, True), (2, 10, since, False),
        (2, NEVER, since - 1, False), (0, NEVER, since, True), (-1, NEVER, since, True),
    ):  # fmt: skip
        ms1.turns[4] = turn = Turn(user, begun, until)
        assert mine.held_up(10) == ("record 47 of this slave was in use all the time" if held else "")
        assert other.held_up(10) == ""
        over = turn.since != since or turn.until <= 10
        assert (4 in ms1.turns) is not over
    ms1.turns.clear()
    assert mine.held_up(10) == ""
    assert (Turn(1, 2).until, Turn(1, 2).longest) == (NEVER, NEVER)


@pytest.mark.parametrize(
    ("write", "outcome", "cancelled", "longest", "until"),
    [
        (True, Outcome(), False, NEVER, 2_000 * MS),
        (True, Outcome(), True, NEVER, 0),
        (True, Outcome(), False, 1_500 * MS, 1_500 * MS),
        (True, Outcome(ServiceFailure.LATE, "x"), False, NEVER, 0),
        (True, Outcome(ServiceFailure.NEGATIVE, "x", codes=(0x80, 0xB5, 0)), False, NEVER, 0),
        (False, Outcome(data=b"\1"), False, NEVER, 0),
        (False, Outcome(ServiceFailure.NEGATIVE, "x", codes=(0x80, 0xB5, 0)), False, NEVER, 2_000 * MS),
        (False, Outcome(ServiceFailure.NEGATIVE, "x", codes=(0x80, 0xB0, 0)), False, NEVER, 0),
        (False, Outcome(ServiceFailure.SILENT, "x"), False, NEVER, 0),
    ],
)
def test_the_end_of_a_service_and_the_turn(
    write: bool, outcome: Outcome, cancelled: bool, longest: int, until: int
) -> None:
    kit = Ms1Bus()
    ms1, handler = ms1_of(kit), kit.master.handlers[4]
    pending = PendingRecord(WriteReq(1, 47, b"") if write else ReadReq(1, 47))
    pending.cancelled = cancelled
    job = RecordJob(pending.request, handler, ms1, 3, pending)
    assert job.bar() == ("was given up by the drive plugin" if cancelled else "")
    turn = ms1.turns[4] = Turn(3, handler.since, NEVER, longest)
    next(job.steps())
    assert job.bar() == ""  # it has begun
    assert (job.aftermath != "") is write
    assert job.ends(7, outcome, 0) == []
    assert pending.outcome is outcome
    assert (turn.until, turn.longest) == (until, min(longest, 10_000 * MS))
    stranger = ms1.turns[4] = Turn(4, handler.since)
    job.ends(7, outcome, 0)
    assert (stranger.until, stranger.longest) == (NEVER, NEVER)


def test_only_the_first_write_begins_a_turn() -> None:
    kit = Ms1Bus()
    ms1, handler = ms1_of(kit), kit.master.handlers[4]
    for request, begins in ((ReadReq(1, 47), False), (WriteReq(1, 46, b""), False), (WriteReq(1, 47, b""), True)):
        ms1.turns.clear()
        next(RecordJob(request, handler, ms1, 3).steps())
        assert ms1.turns == ({4: Turn(3, handler.since)} if begins else {})
    turn = ms1.turns[4]
    turn.until = 5
    next(RecordJob(ReadReq(1, 47), handler, ms1, 3).steps())
    assert ms1.turns[4] is turn
    assert turn.until == NEVER


def test_an_answer_that_comes_after_the_end_of_its_service() -> None:
    """The next service fetches it; it is no answer to that one."""
    kit = Ms1Bus(dpv1=Dpv1(c1_response_timeout_ns=20 * MS))
    kit.slave.ms1 = lambda data: SC
    assert kit.read(1, 3).outcome.failure is ServiceFailure.LATE
    assert list(ms1_of(kit).unfetched) == [4]
    owed = ["5E 01 03 01 11"]

    def ms1(data: bytes) -> bytes:
        if data:
            return answer(4, "5E 01 02 01 22")
        return answer(4, owed.pop()) if owed else SC

    kit.slave.ms1 = ms1
    done = kit.read(1, 2)
    assert (done.outcome, done.stale) == (Outcome(data=b"\x22"), 1)
    assert ms1_of(kit).unfetched == {}
    assert isinstance(done, RecordDone)
    done = kit.read(1, 2)
    assert done.stale == 0
