"""The grid of the fixed cycle to the nanosecond, against a model: due, late, left out, and why."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.dp.master.events import CyclesMissed
from dpstack.dp.master.fixed_cycle import Cadence, CycleData, CycleStats, MissReason, tolerance_ns
from dpstack.dp.master.settings import MasterContext, MasterSettings
from dpstack.params import BusParams
from dpstack.units import NEVER

S = 1_000_000_000


def cadence_of(cycle_ns: int, idle_ns: int = 0) -> tuple[Cadence, MasterContext]:
    """A grid of so few ns that the idle time of the bus would cover it; ``idle_ns`` stands for that."""
    context = MasterContext(BusParams.preset(500_000), MasterSettings(cycle_ns=cycle_ns))
    cadence = Cadence(context)
    cadence._idle = idle_ns
    return cadence, context


def begin(cadence: Cadence, now: int, first_bit: int | None = None) -> None:
    """A round of the fixed cycle begins; its first bit is on the wire at once, or later."""
    cadence.begin(now, fixed=True, interval=0)
    cadence.started(now if first_bit is None else first_bit)


@dataclass
class Model:
    """The grid as a list of times: a round that is late by up to half a cycle begins, a later one is left out.

    So is a late one that fits into a cycle but would leave the next one late by more than a tenth.
    """

    cycle: int
    next: int | None = None
    takes: list[int] = field(default_factory=lambda: [0, 0])
    number: int = 0
    begun: int = 0
    begun_late: int = 0
    left_out: int = 0
    lates: list[int] = field(default_factory=list)

    def due(self, now: int) -> bool:
        if self.next is None:
            return True
        while now - self.next > self.cycle // 2 or self.would_delay_the_next(now):
            self.next += self.cycle
            self.left_out += 1
            self.number += 1
        return now >= self.next

    def would_delay_the_next(self, now: int) -> bool:
        assert self.next is not None
        tenth, takes = self.cycle // 10, min(self.takes[-2:])
        return takes <= self.cycle and now > self.next + tenth and now + takes > self.next + self.cycle + tenth

    def begin(self, first_bit: int) -> None:
        self.number += 1
        due = first_bit if self.next is None else self.next
        self.next = due + self.cycle
        self.begun += 1
        self.lates.append(first_bit - due)
        self.begun_late += first_bit - due > self.cycle // 10


@examples(50)
@given(
    st.sampled_from([10, 11, 100, 1_001]),
    st.lists(st.tuples(st.integers(0, 2_500), st.integers(0, 300), st.integers(0, 1_200)), min_size=1, max_size=40),
)
def test_rounds_begin_on_the_grid_of_the_model(cycle: int, steps: list[tuple[int, int, int]]) -> None:
    """Each step: the token after some time (in thousandths of a cycle), the first bit some time after it, and the last
    answer after that.
    """
    cadence, context = cadence_of(cycle)
    model, now = Model(cycle), 5_000
    for wait, first_bit, takes in steps:
        now += wait * cycle // 1_000
        due = cadence.due(now)
        assert due is model.due(now)
        assert cadence.number == model.number
        if due:
            cadence.begin(now, fixed=True, interval=0)
            now += first_bit * cycle // 1_000
            cadence.started(now)
            model.begin(now)
            began, now = now, now + takes * cycle // 1_000
            cadence.over(now)
            model.takes.append(now - began)
        assert cadence.fixed is (model.next is not None)
        assert cadence.window.next_at == model.next
    book = cadence.book
    assert (book.begun, book.begun_late, book.left_out) == (model.begun, model.begun_late, model.left_out)
    assert book.missed == model.begun_late + model.left_out
    assert (book.late.count, book.late.max_ns) == (model.begun, max(model.lates))
    assert sum(book.reasons.values()) == book.missed
    cadence.stop(now)
    told = [event for event in context.events if isinstance(event, CyclesMissed)]
    assert sum(event.count for event in told) == book.missed
    assert (cadence.fixed, cadence.window.next_at) == (False, NEVER)


@pytest.mark.parametrize(("late", "left_out", "due"), [(50, 0, True), (51, 1, False), (150, 1, True), (151, 2, False)])
def test_half_a_cycle_late_begins_and_more_is_left_out(late: int, left_out: int, due: bool) -> None:
    cadence, _ = cadence_of(100)
    begin(cadence, 1_000)
    assert cadence.due(1_100 + late) is due
    assert (cadence.book.left_out, cadence.number) == (left_out, 1 + left_out)
    assert cadence.window.next_at == 1_100 + 100 * left_out


@pytest.mark.parametrize(
    ("late", "before", "last", "due"),
    [
        (20, 90, 90, True),  # the next one is late by 10 at most: no miss
        (21, 90, 90, False),
        (10, 100, 100, True),  # no miss itself
        (11, 100, 100, False),
        (30, 100, 80, True),  # the shorter of the last two rounds counts
        (30, 80, 120, True),
        (31, 80, 120, False),
        (30, 101, 101, True),  # no grid can hold these
    ],
)
def test_a_late_round_that_makes_the_next_one_late_too_is_left_out(
    late: int, before: int, last: int, due: bool
) -> None:
    cadence, _ = cadence_of(100)
    for began, takes in ((1_000, before), (1_100, last)):
        begin(cadence, began)
        cadence.over(began + takes)
    assert cadence.due(1_200 + late) is due
    assert (cadence.book.left_out, cadence.number) == (not due, 2 + (not due))
    assert cadence.window.next_at == 1_200 + 100 * (not due)


@pytest.mark.parametrize(("late", "due"), [(13, True), (14, False)])
def test_the_idle_time_before_a_late_round_and_after_it_counts(late: int, due: bool) -> None:
    """Decided 13 late, first bit 16 late, over after 91 and 3 of idle time: the next one is late by 10, no miss."""
    cadence, _ = cadence_of(100, idle_ns=3)
    for began in (1_000, 1_100):
        begin(cadence, began)
        cadence.over(began + 91)
    assert cadence.due(1_200 + late) is due


@pytest.mark.parametrize(("late", "missed"), [(10, 0), (11, 1)])
def test_a_tenth_of_a_cycle_late_is_no_miss(late: int, missed: int) -> None:
    assert tolerance_ns(109) == 10
    cadence, context = cadence_of(100)
    begin(cadence, 1_000, 1_003)
    assert (cadence.started_at, cadence.due_at) == (1_003, 1_003)
    begin(cadence, 1_103, 1_103 + late)
    assert (cadence.started_at, cadence.due_at) == (1_103 + late, 1_103)
    assert cadence.book.begun_late == missed
    assert len(context.events) == missed


@pytest.mark.parametrize(
    ("over_at", "forced", "unanswered", "alone", "reason", "why"),
    [
        (1_101, "Set_Prm", "Set_Prm", False, MissReason.OVERRUN, "the round before took 0.000101 ms"),
        (1_100, "Set_Prm to station 5", "x", False, MissReason.NO_ROOM, None),
        (1_100, "", "Slave_Diag to station 5", False, MissReason.SILENCE, "Slave_Diag to station 5 was not answered"),
        (1_100, "", "", False, MissReason.TOKEN, "the token came late from another master"),
        (1_100, "", "", True, MissReason.LATE, "this computer or its port was late"),
    ],
)
def test_the_reason_of_a_miss(
    over_at: int, forced: str, unanswered: str, alone: bool, reason: MissReason, why: str | None
) -> None:
    cadence, context = cadence_of(100)
    begin(cadence, 1_000)
    cadence.over(over_at)
    cadence.window.forced_service, cadence.window.unanswered, cadence.window.alone = forced, unanswered, alone
    assert cadence.due(1_140)
    begin(cadence, 1_140)
    assert cadence.book.reasons == {reason: 1}
    (told,) = context.events
    assert isinstance(told, CyclesMissed)
    assert (told.t_ns, told.count, told.missed, told.number, told.late_ns) == (1_140, 1, 1, 2, 40)
    if why is None:
        why = "Set_Prm to station 5 fits between no two cycles and was sent before"
    if reason is not MissReason.OVERRUN:
        assert told.reason == why
    else:
        assert told.reason.startswith("the round before took ")


def test_misses_of_a_second_are_reported_in_one_line_with_the_worst() -> None:
    cadence, context = cadence_of(100)
    begin(cadence, S)
    due = S
    for late in (20, 30, 40, 30):
        due += 100
        begin(cadence, due + late)
    cadence.due(due + 351)  # 251 late: three more, left out
    told = [(e.count, e.missed, e.number, e.late_ns) for e in context.events if isinstance(e, CyclesMissed)]
    assert told == [(1, 1, 2, 20)]
    cadence.stop(due + 400)
    told = [(e.count, e.missed, e.number, e.late_ns) for e in context.events if isinstance(e, CyclesMissed)]
    assert told[1:] == [(6, 7, 6, 251)]
    cadence.stop(due + 500)
    assert len(context.events) == 2


@pytest.mark.parametrize(("after", "told"), [(S - 1, 1), (S, 2)])
def test_a_good_cycle_a_second_later_tells_what_is_left(after: int, told: int) -> None:
    cadence, context = cadence_of(100)
    begin(cadence, 0)
    for due in (100, 200):
        begin(cadence, due + 20)
    cadence._next = 120 + after
    begin(cadence, 120 + after)
    assert len(context.events) == told


def test_free_running_rounds_keep_the_longer_interval() -> None:
    cadence, _ = cadence_of(0)
    assert cadence.due(0)
    cadence.begin(1_000, fixed=True, interval=50)
    cadence.started(1_004)
    assert (cadence.fixed, cadence.due_at, cadence.started_at, cadence.number) == (False, 1_004, 1_004, 1)
    assert [cadence.due(now) for now in (1_049, 1_050)] == [False, True]
    assert [cadence.due(now, 80) for now in (1_079, 1_080)] == [False, True]
    assert [cadence.due(now, 20) for now in (1_049, 1_050)] == [False, True]
    cadence.forget()
    assert cadence.due(0)
    assert cadence.book.begun == 0


def test_a_round_off_the_grid_ends_it() -> None:
    cadence, _ = cadence_of(100)
    begin(cadence, 1_000)
    cadence.pause(1_050)
    assert cadence.window.next_at == 1_050
    cadence.resume()
    assert cadence.window.next_at == 1_100
    cadence.pause(1_200)
    assert cadence.window.next_at == 1_100
    cadence.begin(1_010, fixed=False, interval=7)
    assert (cadence.fixed, cadence.window.next_at) == (False, NEVER)
    assert [cadence.due(now) for now in (1_016, 1_017)] == [False, True]


def test_the_times_of_a_round_are_published() -> None:
    data = CycleData(number=3, published=2, t_ns=110, due_ns=100, inputs={}, fresh=frozenset(), missed=0)
    assert data.late_ns == 10
    stats = CycleStats(100)
    stats.miss(MissReason.LATE, 3, left_out=True)
    stats.miss(MissReason.LATE, 2, left_out=False)
    stats.miss(MissReason.TOKEN, 1, left_out=False)
    assert (stats.left_out, stats.begun_late, stats.missed) == (3, 3, 6)
    assert stats.reasons == {MissReason.LATE: 5, MissReason.TOKEN: 1}


def test_reasons_in_words() -> None:
    assert {reason.value: reason.text for reason in MissReason} == {
        "overrun": "after a long round",
        "no_room": "after a request that fits between no two cycles",
        "silence": "after a service that was not answered",
        "token": "waiting for the token",
        "late": "by this computer or its port",
    }
