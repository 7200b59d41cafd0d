"""Durations of an active station and the silence on its line, counted by hand at 500 kbit/s: one bit takes 2000 ns."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.fdl.active.parts import ActiveLine, Times, Users
from dpstack.fdl.allowance import Allowance
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import Telegram
from dpstack.params import BusParams
from dpstack.phy.line import Line
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event
from dpstack.units import NEVER

BIT = 2_000
MS = 1_000_000
PARAMS = BusParams.preset(500_000, address=4).replace(t_tr=5_000, max_retry=3)  # T_SL 200, T_ID1 37, T_ID2 100
T_SL, T_ID1, T_ID2 = 200 * BIT, 37 * BIT, 100 * BIT
LATE = Patience(known_ns=40 * MS, unknown_ns=3 * MS, unknown_divisor=100, stall_ns=7 * MS, sending_ns=MS)


@pytest.mark.parametrize(
    ("patience", "expected"),
    [
        (
            EXACT,
            {
                "exact": True,
                "slot_ns": T_SL,
                "slot_known_ns": T_SL,
                "slot_unknown_ns": T_SL,
                "slot_again_ns": T_SL,
                "t_to_ns": (6 + 2 * 4) * T_SL,
                "keep_ns": T_SL // 4,
                "pass_ns": 33 * BIT + T_ID1,
                "keep_alone_ns": T_SL + 2 * (33 * BIT + T_ID1),
            },
        ),
        (
            LATE,  # without edges an octet is seen at its end: 11 bits more
            {
                "exact": False,
                "slot_ns": 211 * BIT,
                "slot_known_ns": 211 * BIT + 40 * MS,
                "slot_unknown_ns": 211 * BIT + 3 * MS,
                "slot_again_ns": 211 * BIT + 10 * MS,
                "t_to_ns": (6 + 2 * 4) * T_SL + 80 * MS,
                "keep_ns": T_SL // 4,
                "pass_ns": 33 * BIT + T_ID1 + MS,
                "keep_alone_ns": T_SL + 2 * (33 * BIT + T_ID1 + MS),
            },
        ),
        (Patience(known_ns=MS, unknown_ns=MS), {"slot_again_ns": 211 * BIT + MS, "slot_known_ns": 211 * BIT + MS}),
    ],
    ids=["exact", "late", "the slack of unknown stations is the least"],
)
def test_durations(patience: Patience, expected: dict[str, object]) -> None:
    times = Times(PARAMS, patience, Line(PARAMS))
    assert {name: getattr(times, name) for name in expected} == expected
    assert times.patience is patience
    assert (times.t_tr_ns, times.max_retry, times.early_ns) == (5_000 * BIT, 3, 11 * BIT - BIT // 2)


def test_the_idle_times_of_a_line() -> None:
    line = Line(PARAMS, 5)
    assert line.idle_since == 5
    assert Line(PARAMS).idle_since == 0
    found = (line.t_id1_ns, line.t_id2_ns, line.t_sl_ns, line.t_sdr_ns, line.t_to_ns, line.t_stall_ns)
    assert found == (T_ID1, T_ID2, T_SL, 11 * BIT, 14 * T_SL, 33 * BIT)
    for now, idle_since in ((4, 5), (9, 9), (9, 9), (8, 9)):
        line.note_activity(now)
        assert line.idle_since == idle_since
    line.set_params(BusParams.preset(1_500_000, address=4))  # T_SL 300
    assert line.t_sl_ns == 200_000
    assert line.idle_since == 9


def state_of(line: ActiveLine) -> tuple[int, int, int, int]:
    return line.idle_since, line.edge_at, line.busy_until, line.after_ns


def test_an_edge_and_the_telegram_behind_it() -> None:
    line = ActiveLine(PARAMS, 100)
    assert state_of(line) == (100, -1, 0, T_ID1)
    assert (line.tx, line.gate_ns, line.taken_at, line.ts) == (None, 0, 0, 4)
    line.expect_no_answer()
    assert line.after_ns == T_ID2
    line.edge(150, 60)
    assert state_of(line) == (150, 150, 210, T_ID1)
    line.expect_no_answer()
    line.telegram_ended(190)
    assert state_of(line) == (190, 150, 0, T_ID1)
    line.telegram_ended(250)  # without an edge: its begin is not known
    assert state_of(line) == (250, 250, 0, T_ID1)
    line.idle_since = 400  # the end of its own transmission, known in advance
    line.edge(390, 60)
    assert state_of(line) == (400, 390, 450, T_ID1)
    line.telegram_ended(395)
    assert state_of(line) == (400, 390, 0, T_ID1)


@pytest.mark.parametrize(
    ("now", "first_at", "stall_at", "exact", "expected"),
    [
        (150, 120, 0, True, (150, 120, 0, T_ID1)),
        (150, 0, 0, True, (150, 0, 0, T_ID1)),
        (150, -1, 0, True, (150, 7, 0, T_ID1)),
        (150, 120, 190, False, (150, 120, 190, T_ID1)),
        (80, 60, 0, True, (100, 60, 0, T_ID1)),
        (80, 60, 0, False, (80, 60, 0, T_ID1)),  # received while sending: it is sent
    ],
)
def test_octets_on_the_line(
    now: int, first_at: int, stall_at: int, exact: bool, expected: tuple[int, int, int, int]
) -> None:
    line = ActiveLine(PARAMS, 100)
    line.edge_at = 7
    line.expect_no_answer()
    line.octets_ended(now, first_at, stall_at, exact)
    assert state_of(line) == expected


def test_the_edge_counts_until_the_telegram_is_complete() -> None:
    line = ActiveLine(PARAMS, 0)
    line.edge(50, 60)
    line.octets_ended(70, 55, 99, True)
    line.octets_ended(80, 75, 109, True)
    assert line.edge_at == 50
    line.octets_ended(90, 85, 0, True)
    assert line.edge_at == 50
    line.octets_ended(95, 92, 0, True)
    assert line.edge_at == 92
    line.edge(100, 60)
    line.expect_no_answer()
    line.end_arrival()
    assert (line.busy_until, line.after_ns) == (0, T_ID1)
    line.octets_ended(120, 110, 0, True)
    assert line.edge_at == 110


def test_gates() -> None:
    line = ActiveLine(PARAMS, 0)
    line.queue(b"\xe5")
    assert (line.tx, line.gate_ns) == (b"\xe5", T_ID1)
    line.lengthen_gate(T_ID1 - 1)
    assert line.gate_ns == T_ID1
    line.lengthen_gate(T_ID1 + 1)
    assert line.gate_ns == T_ID1 + 1
    line.expect_no_answer()
    line.queue_token(9)
    assert (line.tx, line.gate_ns) == (b"\xdc\x09\x04", T_ID2)
    line.reply(b"\x10")
    assert (line.tx, line.gate_ns) == (b"\x10", 11 * BIT)
    line.queue(b"\x10")
    line.drop()
    assert line.tx is None


# --- users -----------------------------------------------------------------------------------------------------------
class _User(LinkUser):
    def __init__(self, at: int, takes: bool = False) -> None:
        self.at, self.takes = at, takes
        self.ticks: list[int] = []
        self.commands: list[tuple[object, int]] = []

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None: ...

    def next_request(self, now: int, high_only: bool) -> Request | None:
        return None

    def wake_at(self) -> int:
        return self.at

    def tick(self, now: int) -> None:
        self.ticks.append(now)
        self.at = NEVER

    def command(self, command: object, now: int) -> bool:
        self.commands.append((command, now))
        self.at -= 1
        return self.takes


def test_deadlines_and_orders_of_users() -> None:
    first, second, third = _User(50), _User(30, takes=True), _User(40, takes=True)
    own: list[Event] = []
    users = Users([first, second], own)
    assert users.unread == [[], (), ()]
    assert users.due_at == NEVER  # read with the first token
    users.attach(third)
    assert (users.due_at, users.all, len(users.unread)) == (30, (first, second, third), 4)
    assert users.unread[0] is own
    assert users.offer("order", 7)
    assert users.due_at == 29
    assert (first.commands, second.commands, third.commands) == ([("order", 7)], [("order", 7)], [])
    assert users.broadcast("all", 8)
    assert third.commands == [("all", 8)]
    assert users.due_at == 28
    users.tick(39)
    assert ([*first.ticks], second.ticks, third.ticks) == ([], [39], [39])
    assert users.due_at == 48
    users.detach(first)
    assert (users.due_at, users.all) == (NEVER, (second, third))
    users.detach(second)
    users.detach(third)
    assert users.due_at == NEVER
    assert not users.offer("order", 9)
    assert not users.broadcast("all", 9)


# --- the account of silent polls -------------------------------------------------------------------------------------
@examples(50)
@given(
    st.integers(0, 7),
    st.integers(1, 30),
    st.lists(st.tuples(st.integers(0, 400), st.integers(0, 60)), min_size=1, max_size=60),
)
def test_the_account_of_silent_polls(divisor: int, cost: int, steps: list[tuple[int, int]]) -> None:
    """The same with an account in fractions of a nanosecond."""
    allowance = Allowance(divisor, cost, 1_000)
    now, parts = 1_000, 16 * cost * max(1, divisor)  # the account times the divisor
    for wait, charge in steps:
        now += wait
        cap = 16 * cost * divisor
        parts += wait
        whole = parts // divisor if divisor else 0
        if whole >= 16 * cost:
            parts = cap + parts % divisor if divisor else 0
        allowed = allowance.allows(now)
        assert allowed is (not divisor or whole >= cost)
        if allowed:
            allowance.charge(charge)
            if divisor:
                parts = max(-cap + parts % divisor, parts - charge * divisor)
