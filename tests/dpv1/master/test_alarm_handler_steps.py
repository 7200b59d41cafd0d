"""The handler of one slave's alarms step by step: diagnoses in octets, what it delivers, asks for and acknowledges."""

from __future__ import annotations

from typing import Any

import pytest
from alarm_kit import ALL, block
from bus_kit import setup
from support import present

from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.dp.master.events import SlaveEvent
from dpstack.dp.pdu.alarm_blocks import parse_block
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.alarm_handler import MAX_OPEN, AlarmBook, AlarmHandler, Key, OpenAlarm, Settling, Stage
from dpstack.dpv1.master.alarm_orders import AlarmDone, AlarmRaised, StatusTold
from dpstack.units import NEVER, NS_PER_MS

MS = NS_PER_MS
A, B, STATUS = block(2, 1), block(3, 1), block(0x81, 1, 0)
SILENT = Outcome(ServiceFailure.SILENT, "slave 4 does not answer x")
TAKEN = Outcome()


def diagnosis(*blocks: bytes) -> Diagnosis:
    return present(Diagnosis.parse(bytes.fromhex("08 0C 00 02 12 34") + b"".join(blocks)))


class Steps:
    """A handler in data exchange, and all that it reports; it stands for its slave handler itself."""

    def __init__(self, dpv1: Dpv1 | None = None, book: AlarmBook | None = None) -> None:
        self.setup = setup(4, Dpv1(alarms=ALL, alarm_mode=0) if dpv1 is None else dpv1)
        self.reports = self
        self.exchanges = 0
        self.told: list[str] = []
        self.alarms = AlarmHandler(self, AlarmBook() if book is None else book)  # type: ignore[arg-type]

    def event(self, kind: type[SlaveEvent], now: int, **fields: Any) -> None:
        if kind is AlarmRaised:
            held = " held" if fields["held"] else ""
            self.told.append(f"{now} raised {fields['number']} {fields['alarm'].build().hex()}{held}")
        elif kind is AlarmDone:
            failure = fields["outcome"].failure
            self.told.append(f"{now} done {fields['number']}{f' {failure.value}' if failure else ''}")
        else:
            assert kind is StatusTold
            self.told.append(f"{now} status {fields['status'].build().hex()}")

    def mark_changed(self) -> None:
        pass

    def remark(self, message: str, now: int) -> None:
        self.told.append(f"{now} remark {message.split()[0].rstrip(';')}")

    def want_diagnosis(self, now: int) -> None:
        self.told.append(f"{now} want")

    def read(self, *blocks: bytes, now: int, flagged: bool = True, after: int = 5) -> list[str]:
        """A diagnosis ``after`` more exchanges, asked for in the last of them; all that was reported by it."""
        self.exchanges += after
        at = self.exchanges if flagged else 0
        self.alarms.read(diagnosis(*blocks), at, self.exchanges, now)
        self.exchanges += 1
        return self.take()

    def take(self) -> list[str]:
        told, self.told = self.told, []
        return told

    def ack(self, outcome: Outcome | None, now: int) -> list[str]:
        """The next acknowledgement and its end; None: it goes on."""
        known = present(self.alarms.next_ack(now))
        self.alarms.begin_ack(known)
        assert self.alarms.next_ack(now) is None  # one at a time
        if outcome is not None:
            self.alarms.ended(known, outcome, now)
        return self.take()


@pytest.fixture
def steps() -> Steps:
    return Steps()


def test_the_beginning_of_data_exchange(steps: Steps) -> None:
    steps.alarms.opened(None, 1)
    assert steps.take() == []
    steps.alarms.opened(diagnosis(A, STATUS, block(0x82, 1, 0)), 2)
    assert steps.take() == ["2 want", "2 status 04810100", "2 status 04820100"]
    assert not steps.alarms.busy
    assert steps.read(A, STATUS, block(0x82, 1, 0), now=3) == ["3 raised 1 04020101"]
    assert steps.alarms.busy


def test_status_messages_are_delivered_when_they_are_new_or_changed(steps: Steps) -> None:
    other = block(0x81, 1, 0, data="55")
    assert steps.read(STATUS, block(0x81, 2, 0), now=1) == ["1 status 04810100", "1 status 04810200"]
    assert steps.read(STATUS, now=2) == []
    assert steps.read(other, now=3) == ["3 status 0581010055"]
    assert steps.read(STATUS, block(0x81, 2, 0), now=4) == ["4 status 04810100", "4 status 04810200"]
    assert steps.read(now=5) == []
    assert steps.read(STATUS, now=6) == ["6 status 04810100"]
    assert steps.alarms.counts.statuses == 6
    steps.alarms.closed(7)
    assert steps.read(STATUS, now=8) == ["8 status 04810100"]


def test_an_alarm_from_its_diagnosis_to_its_end(steps: Steps) -> None:
    assert (steps.alarms.busy, steps.alarms.next_ack(0)) == (False, None)
    steps.exchanges = 5
    assert steps.read(A, now=1, after=0) == ["1 raised 1 04020101"]
    steps.exchanges = 5
    assert steps.alarms.next_ack(2) is None  # not before an exchange behind the diagnosis
    steps.exchanges = 6
    assert steps.ack(TAKEN, 3) == ["3 done 1"]
    counts = steps.alarms.counts
    assert (counts.raised, counts.acknowledged, counts.repeated) == (1, 1, 0)
    assert steps.read(A, now=50 * MS, flagged=False) == []  # still there
    assert steps.alarms.busy
    assert steps.read(now=60 * MS) == []
    assert steps.read(A, now=70 * MS) == ["70000000 raised 2 04020101"]


def test_alarms_are_acknowledged_in_the_order_they_came(steps: Steps) -> None:
    assert steps.read(A, now=1) == ["1 raised 1 04020101"]
    assert steps.read(B, now=2) == ["2 raised 2 04030101"]
    assert steps.ack(TAKEN, 3) == ["3 done 1"]
    assert steps.ack(TAKEN, 4) == ["4 done 2"]
    assert steps.alarms.next_ack(5) is None


def test_held_alarms() -> None:
    book = AlarmBook(hold=True)
    steps = Steps(book=book)
    assert steps.read(A, now=1) == ["1 raised 1 04020101 held"]
    assert steps.read(B, now=2) == ["2 raised 2 04030101 held"]
    assert steps.alarms.next_ack(3) is None
    steps.alarms.release(7, 3)  # no such alarm
    assert steps.alarms.next_ack(3) is None
    steps.alarms.release(2, 3)
    assert steps.ack(TAKEN, 4) == ["4 done 2"]
    assert steps.alarms.next_ack(4) is None
    steps.alarms.release(None, 5)
    assert steps.ack(None, 6) == []
    steps.alarms.release(1, 7)  # its acknowledgement is under way
    assert steps.alarms.next_ack(7) is None
    steps.alarms.closed(8)
    assert steps.take() == ["8 done 1 closed"]
    assert book.untaken == set()


@pytest.mark.parametrize("hold", [False, True])
def test_the_end_of_data_exchange(hold: bool) -> None:
    book = AlarmBook(hold=hold)
    steps = Steps(Dpv1(alarms=ALL, alarm_mode=0, extra_alarm_sap=True), book)
    steps.read(A, now=1)
    steps.read(B, now=2)
    steps.alarms.extra_sap = False
    steps.alarms.closed(3)
    assert steps.take() == ["3 done 1 closed", "3 done 2 closed"]
    assert book.untaken == ({1, 2} if hold else set())
    assert (steps.alarms.extra_sap, steps.alarms.busy) == (True, False)
    assert steps.read(B, now=4) == [f"4 raised 3 04030101{' held' if hold else ''}"]  # it counts on
    assert Steps(book=book).alarms.counts.raised == 3


def test_the_alarms_that_the_slave_may_still_have_at_its_end(steps: Steps) -> None:
    """After data exchange the end of an acknowledgement means nothing any more."""
    steps.read(A, now=1)
    known = present(steps.alarms.next_ack(2))
    steps.alarms.begin_ack(known)
    steps.alarms.closed(3)
    assert steps.take() == ["3 done 1 closed"]
    steps.read(A, now=4)
    steps.alarms.ended(known, TAKEN, 5)
    assert steps.take() == ["4 raised 2 04020101"][:0]
    assert steps.ack(TAKEN, 6) == ["6 done 2"]


FAILURES = {
    ServiceFailure.NEGATIVE: (["9 remark slave", "9 done 1 negative"], 1),
    ServiceFailure.LENGTH: (["9 remark slave", "9 done 1 length"], 1),
    ServiceFailure.GUARDED: (["9 remark slave", "9 done 1 guarded"], 1),
    ServiceFailure.REFUSED: (["9 remark slave", "9 done 1 refused"], 1),
    ServiceFailure.SILENT: (["9 remark slave"], 0),
    ServiceFailure.LATE: (["9 remark slave"], 0),
    ServiceFailure.UNREADABLE: (["9 remark slave"], 0),
    ServiceFailure.CLOSED: ([], 0),
}


@pytest.mark.parametrize("failure", FAILURES)
def test_failures_of_an_acknowledgement(failure: ServiceFailure) -> None:
    told, refused = FAILURES[failure]
    steps = Steps()
    steps.read(A, now=1)
    assert steps.ack(Outcome(failure, "slave 5 is another one"), 9) == told
    assert steps.alarms.counts.refused == refused
    ended = told and "done" in told[-1]
    assert steps.alarms.next_ack(9 + 100 * MS - 1) is None
    again = steps.alarms.next_ack(9 + 100 * MS)
    assert (again is None) is bool(ended)
    if again is not None:
        assert again.unanswered is (failure is not ServiceFailure.CLOSED)
        assert again.stage is Stage.WAITING
        # the slave does not know it any more: it has taken the one before
        expected = ["500000000 done 1"] if again.unanswered else ["500000000 remark slave", "500000000 done 1 negative"]
        assert steps.ack(Outcome(ServiceFailure.NEGATIVE, "slave 5"), 500 * MS) == expected


@pytest.mark.parametrize(("code", "ended"), [(0xB5, False), (0xC0, False), (0xC1, False), (0xC2, False), (0xB8, True)])
def test_a_slave_that_is_busy_gets_it_again(steps: Steps, code: int, ended: bool) -> None:
    steps.read(A, now=1)
    told = steps.ack(Outcome(ServiceFailure.NEGATIVE, "slave 4 x", codes=(0x80, code, 0)), 9)
    assert told == (["9 remark x", "9 done 1 negative"] if ended else [])
    assert (steps.alarms.next_ack(9 + 100 * MS) is None) is ended
    assert steps.alarms.counts.refused == int(ended)


def test_refusals_are_remarked_once_and_silence_too(steps: Steps) -> None:
    for now in (10, 20):
        steps.read(now=now)
        steps.read(A, now=now + 1)
        told = steps.ack(Outcome(ServiceFailure.NEGATIVE, "slave 4 x"), now + 2)
        assert told == ["12 remark x"] * (now == 10) + [f"{now + 2} done {now // 10} negative"]
    steps.read(now=30)
    steps.read(A, now=31)
    assert steps.ack(SILENT, 32) == ["32 remark does"]
    assert steps.ack(SILENT, 32 + 100 * MS) == []
    assert steps.alarms.counts.repeated == 1


def test_the_extra_sap() -> None:
    """Closed: SAP 51 from then on. After it took one, or after an acknowledgement without an answer, it has an end."""
    v1 = Dpv1(alarms=ALL, alarm_mode=0, extra_alarm_sap=True)
    closed = Outcome(ServiceFailure.REFUSED, "slave 4 x")
    steps = Steps(v1)
    steps.read(A, now=1)
    assert steps.ack(closed, 2) == ["2 remark SAP"]
    assert steps.alarms.extra_sap is False
    assert steps.ack(TAKEN, 2) == ["2 done 1"]
    took = Steps(v1)
    took.read(A, now=1)
    assert took.ack(TAKEN, 2) == ["2 done 1"]
    took.read(B, now=3)
    assert took.ack(SILENT, 4) == ["4 remark does"]
    assert took.ack(closed, 4 + 100 * MS) == ["100000004 done 2"]
    assert took.alarms.extra_sap
    without = Steps()
    assert not without.alarms.extra_sap
    without.read(A, now=1)
    assert without.ack(closed, 2) == ["2 remark x", "2 done 1 refused"]


def test_more_alarms_than_there_is_room_for() -> None:
    steps = Steps(Dpv1(alarms=ALL, alarm_mode=7), AlarmBook(hold=True))
    for slot in range(MAX_OPEN - 1):
        assert len(steps.read(block(2, slot), now=slot)) == 1 + (slot >= 32)
    steps.alarms._book.untaken.add(1)
    assert steps.read(block(2, 100), now=100) == ["100 remark raises", "100 remark raises"]
    assert (steps.alarms.counts.raised, steps.alarms.counts.dropped) == (MAX_OPEN - 1, 1)
    steps.alarms.release(7, 101)
    assert steps.take() == []  # no room yet
    steps.alarms._book.untaken.clear()
    steps.alarms.release(8, 102)
    assert steps.take() == ["102 want"]
    steps.alarms.release(9, 103)
    assert steps.take() == []
    assert len(steps.read(block(2, 100), now=104)) == 2
    assert MAX_OPEN == 64


@pytest.mark.parametrize("shown", [False, True])
def test_the_diagnosis_is_read_again_where_it_may_hold_another_alarm(steps: Steps, shown: bool) -> None:
    steps.read(A, now=1)
    changed = block(2, 1, data="AA")
    told = steps.read(changed if shown else A, now=2, flagged=shown)
    assert told == (["2 remark raises"] if shown else [])
    assert steps.ack(TAKEN, 3) == ["3 done 1"] + ["3 want"] * shown


def test_requests_without_an_answer() -> None:
    """Only behind a diagnosis, before the next exchange, they leave the slave in doubt."""
    for exchanges, unsure in ((5, True), (6, False)):
        steps = Steps()
        steps.exchanges = 5
        steps.alarms.read(diagnosis(A), 5, 5, 1)
        steps.exchanges = exchanges
        steps.alarms.missed()
        assert steps.alarms._unsure is unsure
        steps.exchanges = 6
        known = present(steps.alarms.next_ack(2))
        steps.alarms.begin_ack(known)
        steps.take()
        steps.alarms.read(diagnosis(A), 6, 7, 3)  # again the same: offered once more, or a new one
        assert steps.take() == ([] if unsure else ["3 done 1", "3 raised 2 04020101"])


@pytest.mark.parametrize(
    ("mode", "instead", "taken"),
    [
        (0, block(2, 2), True),  # of the same type: only after the first was taken
        (0, block(2, 1, data="AA"), True),
        (0, block(3, 1), False),
        (0, A, False),
        (3, block(2, 2), False),
        (3, block(2, 1, 1, 1), False),
        (3, block(3, 1), False),
        (3, block(2, 1, data="AA"), True),  # the same numbers
    ],
)
def test_an_alarm_in_the_place_of_one_whose_acknowledgement_had_no_answer(
    mode: int, instead: bytes, taken: bool
) -> None:
    steps = Steps(Dpv1(alarms=ALL, alarm_mode=mode))
    steps.read(A, now=1)
    steps.ack(SILENT, 2)
    ended = ["3 done 1"] if taken else []
    raised = [] if instead == A else [f"3 raised 2 {instead.hex()}"]
    assert steps.read(instead, now=3, flagged=False) == ended + raised
    assert steps.alarms.counts.acknowledged == int(taken)
    asked = Steps(Dpv1(alarms=ALL, alarm_mode=mode))
    asked.read(A, now=1)
    asked.ack(None, 2)  # under way
    same = Key.of(parse_block(A)) == Key.of(parse_block(instead))  # type: ignore[arg-type]
    told = asked.read(instead, now=3, flagged=False)
    assert told == (["3 done 1", *raised] if same and instead != A else raised)


def test_an_acknowledged_alarm_that_was_a_new_one_after_all(steps: Steps) -> None:
    """The slave asked for the diagnosis with it, and then another alarm took its place."""
    steps.read(A, now=1)
    assert steps.ack(TAKEN, 2) == ["2 done 1"]
    assert steps.read(A, bytes.fromhex("42 01"), now=3) == []
    assert steps.read(B, now=4) == ["4 raised 2 04020101", "4 raised 3 04030101"]
    quiet = Steps()
    quiet.read(A, now=1)
    quiet.ack(TAKEN, 2)
    assert quiet.read(A, bytes.fromhex("42 01"), now=3, flagged=False) == []
    assert quiet.read(B, now=4) == ["4 raised 2 04030101"]


def test_blocks_that_are_neither_alarm_nor_status_nor_enabled() -> None:
    steps = Steps(Dpv1(alarms=("process",), alarm_mode=0))
    short, other = bytes.fromhex("03 02 01"), block(1, 1)
    assert steps.read(short, short, now=1) == ["1 remark its"]
    assert steps.read(bytes.fromhex("03 02 02"), now=2) == []  # remarked once, counted each time
    assert steps.read(other, A, now=3) == ["3 remark its", "3 raised 1 04020101"]
    assert steps.read(block(3, 1), now=4) == ["4 remark its"]
    counts = steps.alarms.counts
    assert (counts.malformed, counts.not_enabled, counts.raised) == (3, 2, 1)


# --- acknowledged alarms that are still in the diagnosis ------------------------------------------------------------


def settling(in_order: bool = False, again: bool = False) -> tuple[Settling, Any, Any]:
    made = Settling(in_order)
    alarm = parse_block(A)
    made.over(Key.of(alarm), A, again, 0)  # type: ignore[arg-type]
    return made, alarm, diagnosis(A)


def test_an_equal_block_within_100_ms_is_the_old_alarm() -> None:
    for now, still in ((0, True), (100 * MS - 1, True), (100 * MS, False), (101 * MS, False)):
        made, alarm, found = settling()
        assert made.look_at == NEVER
        assert made.still(alarm, A, found, True, now) is still
        assert made.look_at == (100 * MS if still else NEVER)
        # it was asked for: when it goes it was a new one after all
        assert [asked.octets for asked in made.displaced({Key(9, 9, 9)})] == [A]


def test_other_octets_and_other_alarms_are_new() -> None:
    made, alarm, found = settling()
    assert not made.still(alarm, block(2, 1, data="AA"), found, True, 1)
    assert not made.still(parse_block(B), B, found, True, 1)  # type: ignore[arg-type]
    assert made.look_at == NEVER


@pytest.mark.parametrize("in_order", [False, True])
def test_numbered_alarms_are_the_old_ones_for_ever(in_order: bool) -> None:
    made, alarm, found = settling(in_order)
    if not in_order:
        made.raised(parse_block(block(2, 3, 0, 1)))  # type: ignore[arg-type]
    assert made.still(alarm, A, found, True, 10**12)
    assert made.look_at == NEVER
    made.raised(alarm)
    assert not made.still(alarm, A, found, True, 10**12)


@pytest.mark.parametrize("flagged", [False, True])
@pytest.mark.parametrize("again", [False, True])
def test_after_the_time_of_an_alarm_that_nobody_asked_for(flagged: bool, again: bool) -> None:
    """The second time it is the habit of this slave: it keeps its alarms in the diagnosis."""
    made, alarm, found = settling(again=again)
    assert made.doubtful(Key.of(alarm), A)
    assert made.still(alarm, A, found, flagged, 200 * MS) is (again and not flagged)
    assert made.doubtful(Key.of(alarm), A) is not flagged
    assert not made.doubtful(Key.of(alarm), B)
    assert not made.doubtful(Key(9, 9, 9), A)


def test_alarms_that_go() -> None:
    made, alarm, found = settling()
    assert made.displaced({Key.of(alarm)}) == []
    assert made.still(alarm, A, found, False, 1)
    assert made.displaced({Key(9, 9, 9)}) == []  # nobody asked for it
    made, alarm, found = settling()
    assert made.still(alarm, A, found, True, 1)
    assert made.displaced(set()) == []  # the diagnosis holds no alarm at all
    made, alarm, found = settling()
    made.still(alarm, A, found, True, 1)
    made.clear()
    assert made.look_at == NEVER
    assert made.displaced({Key(9, 9, 9)}) == []
    assert not made.still(alarm, A, found, True, 1)


def test_the_diagnosis_is_read_again_when_the_time_is_over(steps: Steps) -> None:
    steps.read(A, now=1)
    steps.ack(TAKEN, 2)
    assert steps.read(A, now=3, flagged=False) == []
    at = steps.alarms._settling.look_at
    assert at == 2 + 100 * MS
    assert steps.alarms.next_ack(at - 1) is None
    assert steps.take() == []
    assert steps.alarms.next_ack(at) is None
    assert steps.take() == [f"{at} want"]
    assert not steps.alarms.busy
    assert steps.read(A, now=at) == [f"{at} raised 2 04020101"]


def test_a_slave_that_keeps_its_alarms_in_the_diagnosis_brings_each_once_more_at_most(steps: Steps) -> None:
    assert steps.read(A, now=1) == ["1 raised 1 04020101"]
    assert steps.ack(TAKEN, 2) == ["2 done 1"]
    # nobody asked for this diagnosis, and the time is over: a new alarm, or a habit of the slave
    assert steps.read(A, now=200 * MS, flagged=False) == [f"{200 * MS} raised 2 04020101"]
    assert steps.ack(TAKEN, 201 * MS) == [f"{201 * MS} done 2"]
    assert steps.read(A, now=400 * MS, flagged=False) == []
    assert steps.read(A, now=600 * MS, flagged=False) == []
    changed = Steps()
    changed.read(A, now=1)
    changed.ack(TAKEN, 2)
    again = block(2, 1, data="AA")
    assert changed.read(again, now=200 * MS, flagged=False) == [f"{200 * MS} raised 2 {again.hex()}"]
    changed.ack(TAKEN, 201 * MS)
    assert changed.read(again, now=400 * MS, flagged=False) == [f"{400 * MS} raised 3 {again.hex()}"]


def test_the_extra_sap_that_is_closed_after_silence() -> None:
    """It never took an acknowledgement: the slave has not taken this one either."""
    steps = Steps(Dpv1(alarms=ALL, alarm_mode=0, extra_alarm_sap=True))
    steps.read(A, now=1)
    assert steps.ack(SILENT, 2) == ["2 remark does"]
    assert steps.ack(Outcome(ServiceFailure.REFUSED, "slave 4 x"), 2 + 100 * MS) == [f"{2 + 100 * MS} remark SAP"]
    assert not steps.alarms.extra_sap
    assert steps.ack(TAKEN, 2 + 100 * MS) == [f"{2 + 100 * MS} done 1"]


def test_a_new_alarm() -> None:
    alarm = parse_block(A)
    made = OpenAlarm(1, alarm, A, Stage.WAITING)  # type: ignore[arg-type]
    assert (made.doubtful, made.attempts, made.unanswered, made.not_before) == (False, 0, False, 0)
    assert (made.shown, made.answered, made.maybe_taken) == (False, False, False)
    for stage, unanswered, taken in (
        (Stage.HELD, False, False), (Stage.ASKED, False, True), (Stage.WAITING, True, True), (Stage.HELD, True, True),
    ):  # fmt: skip
        made.stage, made.unanswered = stage, unanswered
        assert made.maybe_taken is taken
    assert [stage.value for stage in Stage] == ["held", "waiting", "asked"]
    book = AlarmBook()
    assert (book.number, book.hold, book.untaken) == (0, False, set())
    book.count("raised")
    book.count("raised")
    assert book.counts.raised == 2
