"""Judgements of an active station, one by one: the input that a telegram is, and whose token it accepts."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.fdl.active.las_gap import Announced, Gap, Ring
from dpstack.fdl.active.membership import Membership
from dpstack.fdl.active.states import NONE, Handler, Input, State, StateMachine
from dpstack.fdl.codec import decode
from dpstack.fdl.events import MasterSeen, RingJoined, RingLeft
from dpstack.fdl.interface import DecoderStats
from dpstack.fdl.telegram import Telegram
from dpstack.params import BusParams
from dpstack.trace import Event
from dpstack.units import NEVER

TS = 2


# --- classification --------------------------------------------------------------------------------------------------
def recording(calls: list[tuple[State, Input, Telegram, int]]) -> StateMachine:
    """A machine whose handlers note the state and the input they stand for, and the telegram and the time they got."""

    def handler(state: State, what: Input) -> Handler:
        return lambda telegram, now: calls.append((state, what, telegram, now))

    machine = StateMachine(TS)
    machine.bind({state: tuple(handler(state, what) for what in Input) for state in State})
    return machine


def expected(octets: bytes) -> Input:
    """The same from the octets alone (EN 50170-2, 4.1.4: FC bit 6 is the request, 0x49 the FDL status)."""
    if octets == b"\xe5":
        return Input.RESPONSE
    da, sa = (octets[at] & 0x7F for at in ((1, 2) if octets[0] in (0x10, 0xDC) else (4, 5)))
    if octets[0] == 0xDC:
        if max(da, sa) > 125:
            return Input.ACTIVITY
        return Input.OWN_ADDRESS if sa == TS else Input.TOKEN_TO_ME if da == TS else Input.TOKEN_SEEN
    fc = octets[3 if octets[0] == 0x10 else 6]
    if sa == TS:
        return Input.OWN_ADDRESS
    if fc < 0x40 or 0x80 <= fc < 0xC0:
        return Input.RESPONSE if da == TS else Input.RESPONSE_SEEN
    if da != TS:
        return Input.REQUEST_SEEN
    return Input.STATUS_REQUEST if fc % 0x10 == 9 and fc < 0x80 else Input.REQUEST_TO_ME


def telegrams() -> list[bytes]:
    found = [b"\xe5"]
    for da, sa in product((TS, 7, 125, 126, 127), (TS, 7, 125, 126, 127)):
        found.append(bytes((0xDC, da, sa)))
        for fc in (0x00, 0x08, 0x0A, 0x20, 0x30, 0x43, 0x46, 0x49, 0x4D, 0x69, 0x5D, 0x6D, 0x4F, 0xC0):
            body = bytes((da, sa, fc))
            found.append(b"\x10" + body + bytes((sum(body) % 256, 0x16)))
            body += b"\x55"
            found.append(b"\x68\x04\x04\x68" + body + bytes((sum(body) % 256, 0x16)))
    return found


@pytest.mark.parametrize("state", [State.LISTEN_TOKEN, State.CLAIM_TOKEN, State.PASS_TOKEN, State.USE_TOKEN])
def test_every_telegram_is_one_input(state: State) -> None:
    seen = set()
    for octets in telegrams():
        telegram = decode(octets)
        if telegram is not None:
            calls: list[tuple[State, Input, Telegram, int]] = []
            machine = recording(calls)
            machine.enter(state)
            machine.telegram(telegram, 77)
            assert calls == [(state, expected(octets), telegram, 77)], octets.hex(" ")
            seen.add(expected(octets))
    assert len(seen) == 9


def test_orders_without_a_telegram_reach_the_row_of_the_state() -> None:
    calls: list[tuple[State, Input, Telegram, int]] = []
    machine = recording(calls)
    assert (machine.state, machine.deadline) == (State.OFFLINE, NEVER)
    machine.row[Input.GO_ONLINE](NONE, 5)
    machine.enter(State.ACTIVE_IDLE, 900)
    assert (machine.state, machine.deadline) == (State.ACTIVE_IDLE, 900)
    machine.timeout(6)
    assert (machine.state, machine.deadline) == (State.ACTIVE_IDLE, NEVER)
    machine.enter(State.ACTIVE_IDLE, 900)
    machine.hold(7)
    assert (machine.state, machine.deadline) == (State.USE_TOKEN, NEVER)
    assert calls == [
        (State.OFFLINE, Input.GO_ONLINE, NONE, 5),
        (State.ACTIVE_IDLE, Input.TIMEOUT, NONE, 6),
        (State.USE_TOKEN, Input.HOLD, NONE, 7),
    ]


# --- whose token is accepted -----------------------------------------------------------------------------------------
def membership_of(*masters: int, ts: int = TS, gap: int = 10) -> Membership:
    params = BusParams.preset(500_000, address=ts, gap=gap, hsa=20)
    ring = Ring(ts)
    for master in masters:
        ring.add(master)
    events: list[Event] = []
    return Membership(params, ring, Gap(params), Announced(DecoderStats()), events)


#: a token from a station to this one, a pass between two others, or another telegram (both 0)
STEPS = st.sampled_from([(1, TS), (5, TS), (9, TS), (1, 5), (5, 9), (9, 1), (5, 1), (0, 0)])


@examples(50)
@given(st.lists(STEPS, max_size=14))
def test_a_token_is_accepted_from_the_predecessor_or_the_second_time(steps: list[tuple[int, int]]) -> None:
    """The predecessor of 2 in the ring of 1, 2, 5 and 9 is 1.

    A token of another is refused once: the second one, without a pass between others since the first, is accepted. It
    is accepted at once from a station that repeated its last pass, with nothing between the two.
    """
    membership = membership_of(1, 5, 9)
    history: list[tuple[int, int]] = []  # since the last token that was accepted
    for step in steps:
        sa, da = step
        if step == (0, 0):
            membership.forget_pass()
        elif da != TS:
            membership.saw_pass(sa, da)
        else:
            others = [each for each in history if each[1] != TS]  # a refused token is no telegram between two passes
            repeated = others[-1][0] if others[-2:-1] == others[-1:] != [(0, 0)] and others else -1
            refused_before = [each for each in history if each != (0, 0)][-1:] == [step]
            accepted = membership.accepts(sa)
            assert accepted is (sa in (1, repeated) or refused_before)
            if accepted:
                history.clear()
                continue
        history.append(step)


def test_a_token_of_another_master_ends_the_claim_and_a_refused_one_does_not() -> None:
    membership = membership_of(1, 5)
    membership.claim()
    found = [(membership.claimed, membership.accepts(9)) for _ in range(2)]
    assert [*found, (membership.claimed, True)] == [(True, False), (True, True), (False, True)]


def test_joining_and_leaving_are_reported_once() -> None:
    membership = membership_of(5, 1)
    membership.claim()
    membership.gap._cursor = 4
    membership.join(10)
    assert membership.gap._cursor == -1  # a new pass over the GAP
    was_in_ring = membership.in_ring
    membership.leave(20, "because")
    assert (was_in_ring, membership.in_ring) == (True, False)
    assert membership.ring.members == {2}
    membership.leave(30, "again")
    assert membership.events == [
        RingJoined(t_ns=10, address=2, claimed=True, masters=(1, 2, 5)),
        RingLeft(t_ns=20, address=2, reason="because"),
    ]


def test_leaving_forgets_a_refused_token_and_a_repeated_pass() -> None:
    membership = membership_of(1, 5, 9)
    assert not membership.accepts(9)
    membership.leave(1, "x")
    membership.ring.add(1)
    assert not membership.accepts(9)
    membership.saw_pass(5, 9)
    membership.leave(2, "x")
    membership.ring.add(1)
    membership.saw_pass(5, 9)
    assert not membership.accepts(5)


def test_masters_that_were_there_before_are_reported_as_such() -> None:
    membership = membership_of(5)
    membership.report_master(5, 1)
    membership.in_ring = True
    membership.ring.add(9)
    membership.report_master(9, 2)
    membership.report_master(9, 3)
    membership.ring.drop(5)
    membership.report_master(5, 4)
    membership.listen(5)
    assert membership.events == [
        MasterSeen(t_ns=1, address=5, present=True, before=True),
        MasterSeen(t_ns=2, address=9, present=True),
        MasterSeen(t_ns=4, address=5, present=False),
        MasterSeen(t_ns=5, address=9, present=False),
    ]


@pytest.mark.parametrize(("learned", "in_ring"), [(False, False), (True, False), (False, True)])
def test_tokens_count_once_the_ring_is_known(learned: bool, in_ring: bool) -> None:
    membership = membership_of(5)
    membership.ring.learned, membership.in_ring = learned, in_ring
    for now in range(3):
        membership.report_token(5, now)
    told = [MasterSeen(t_ns=1, address=5, present=True, before=not in_ring)] if learned or in_ring else []
    assert membership.events == told


@pytest.mark.parametrize(("gap", "staggered"), [(10, 21), (0, 0)])
def test_tokens_to_itself_are_staggered_for_one_pass_over_the_gap(gap: int, staggered: int) -> None:
    membership = membership_of(ts=7, gap=gap)
    membership.stagger()
    delays = [membership.stagger_ns() for _ in range(30)]
    assert delays == [7 * 2_000] * staggered + [0] * (30 - staggered)
    membership.claim()
    membership.ring.add(9)
    assert membership.stagger_ns() == 0
    membership.ring.drop(9)
    assert membership.stagger_ns() == 0  # beside another master the delay was over
