"""LAS, GAP and the allowance of silent polls as data."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.fdl.active.las_gap import Gap, Ring, distance
from dpstack.fdl.allowance import Allowance
from dpstack.fdl.telegram import StationType
from dpstack.params import BusParams


def rotate(ring: Ring, members: list[int], rounds: int = 1) -> list[bool]:
    order = sorted(members)
    return [ring.learn(sa, da) for _ in range(rounds) for sa, da in zip(order, order[1:] + order[:1], strict=True)]


def test_distance_goes_up_and_wraps() -> None:
    assert [distance(2, 3), distance(3, 2), distance(5, 5), distance(125, 0)] == [1, 127, 128, 3]


@pytest.fixture
def ring() -> Ring:
    return Ring(4)


def test_las_needs_two_identical_rotations(ring: Ring) -> None:
    learned = rotate(ring, [2, 7, 9], 3)
    assert learned.index(True) == 6  # the token comes by station 2 for the third time
    assert ring.members == {2, 4, 7, 9}
    assert (ring.ps, ring.ns) == (2, 7)


def test_a_changing_ring_is_not_learned(ring: Ring) -> None:
    rotate(ring, [2, 7])
    rotate(ring, [2, 7, 9])
    assert not any(rotate(ring, [2, 9]))


def test_a_repeated_pass_is_no_rotation(ring: Ring) -> None:
    assert not any(ring.learn(2, 7) for _ in range(20))


def test_a_lone_master_is_learned_from_its_third_token(ring: Ring) -> None:
    assert [ring.learn(9, 9) for _ in range(4)] == [False, False, True, True]
    assert (ring.ps, ring.ns, ring.members) == (9, 9, {4, 9})


def test_observed_tokens_keep_the_las(ring: Ring) -> None:
    rotate(ring, [2, 7, 9], 3)
    assert ring.observe(7, 2)
    assert ring.members == {2, 4, 7}
    assert ring.observe(7, 11)
    assert ring.members == {2, 4, 7, 11}
    assert not ring.observe(7, 11)


def test_a_token_over_our_head_skips_us(ring: Ring) -> None:
    assert ring.skips(2, 7)
    assert ring.skips(9, 7)
    assert not ring.skips(2, 4)
    assert not ring.skips(7, 2)


def test_two_tokens_to_itself_are_a_claim_the_third_means_alone(ring: Ring) -> None:
    rotate(ring, [2, 7], 3)
    for _ in range(2):
        ring.observe(7, 7)
        assert not ring.skips(7, 7)
        assert ring.members == {2, 4, 7}
    ring.observe(7, 7)
    assert ring.skips(7, 7)
    assert ring.members == {4, 7}


def test_ts_is_never_dropped(ring: Ring) -> None:
    assert not ring.drop(4)
    assert ring.add(9)
    assert not ring.add(9)
    assert ring.drop(9)
    assert (ring.ps, ring.ns) == (4, 4)


@given(st.integers(0, 125), st.lists(st.tuples(st.integers(0, 127), st.integers(0, 127)), max_size=60))
def test_any_tokens_leave_a_sound_ring(ts: int, tokens: list[tuple[int, int]]) -> None:
    ring = Ring(ts)
    for sa, da in tokens:
        ring.learn(sa, da)
        assert ts in ring.members
        assert {ring.ns, ring.ps} <= ring.members
        assert all(distance(ts, ring.ns) <= distance(ts, m) for m in ring.members if m != ts)


@given(st.integers(0, 125), st.sets(st.integers(0, 125), min_size=1, max_size=8))
def test_every_ring_is_learned_in_three_rotations(ts: int, members: set[int]) -> None:
    ring = Ring(ts)
    assert rotate(ring, sorted(members - {ts}) or [(ts + 1) % 126], 3)[-1]
    assert ring.members == (members | {ts} if members - {ts} else {ts, (ts + 1) % 126})


def gap_addresses(address: int, hsa: int, ns: int) -> list[int]:
    gap = Gap(BusParams.preset(500_000, address=address, hsa=hsa))
    found = []
    while (at := gap.due(ns, 0)) >= 0:
        found.append(at)
        gap.polled(at, None)
    return found


def test_gap_runs_from_ts_to_ns_and_wraps_at_hsa() -> None:
    assert gap_addresses(2, 6, 2) == [3, 4, 5, 6, 0, 1]
    assert gap_addresses(2, 6, 5) == [3, 4]
    assert gap_addresses(5, 6, 2) == [6, 0, 1]
    assert gap_addresses(6, 6, 2) == [0, 1]
    assert gap_addresses(2, 6, 3) == []
    assert gap_addresses(2, 6, 50) == [3, 4, 5, 6]  # a foreign master above our HSA


def test_gap_pass_repeats_after_g_times_t_tr() -> None:
    params = BusParams.preset(500_000, address=2, hsa=3)
    gap = Gap(params)
    t_gud = params.gap * params.ns(params.t_tr)
    while gap.due(2, 1000) >= 0:
        gap.polled(gap.due(2, 1000), None)
    assert gap.due(2, 1000 + t_gud - 1) == -1
    assert gap.due(2, 1000 + t_gud) == 3


def test_gap_can_be_off() -> None:
    gap = Gap(BusParams.preset(500_000, address=2, gap=0))
    assert gap.due(2, 0) == -1
    assert not gap.enabled


def test_the_gap_reports_changes_only() -> None:
    gap = Gap(BusParams.preset(500_000, address=2))
    assert gap.polled(3, StationType.SLAVE)
    assert not gap.polled(3, StationType.SLAVE)
    assert gap.polled(3, StationType.MASTER_NOT_READY)
    assert gap.polled(3, None)
    assert not gap.polled(3, None)


@pytest.mark.parametrize("share", [10, 100])
def test_silent_polls_take_their_share_at_most(share: int) -> None:
    cost, now, spent = 2_400_000, 0, 0
    account = Allowance(share, cost, now)
    while now < 10_000_000_000:
        now += 700_001
        if account.allows(now):
            account.charge(cost)
            spent += cost
    assert spent <= 16 * cost + 10_000_000_000 // share
    assert spent >= 10_000_000_000 // share - cost


def test_no_share_is_no_limit() -> None:
    account = Allowance(0, 1000, 0)
    for _ in range(100):
        account.charge(1000)
    assert account.allows(0)


def test_an_overdrawn_allowance_is_in_debt_for_so_long_only() -> None:
    allowance = Allowance(100, 1_000, 0)
    for _ in range(200):
        allowance.charge(1_000)
    assert not allowance.allows(16 * 1_000 * 100)
    assert allowance.allows(17 * 1_000 * 100)
