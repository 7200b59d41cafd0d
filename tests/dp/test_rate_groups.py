"""Rate groups: which cycles a slave is in, and which cycle is the fullest."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from dpstack.dp.rate_groups import HYPERPERIOD, Share, fullest, offsets, round_interval_ns


def loads(shares: list[Share], chosen: dict[int, int], cycles: int) -> list[int]:
    """Each cycle's load, added up cycle by cycle."""
    return [sum(s.duration_ns for s in shares if c % s.every == chosen[s.address]) for c in range(cycles)]


def test_equal_slaves_of_every_second_cycle_take_turns() -> None:
    shares = [Share(address, 2, 10) for address in (3, 4, 5, 6)]
    assert offsets(shares) == {3: 0, 4: 1, 5: 0, 6: 1}
    assert fullest(shares, offsets(shares)) == {3, 5}


def test_the_longest_has_a_cycle_of_its_own() -> None:
    shares = [Share(3, 2, 10), Share(4, 2, 10), Share(5, 2, 30)]
    assert offsets(shares) == {5: 0, 3: 1, 4: 1}
    assert fullest(shares, offsets(shares)) == {5}


def test_a_slave_of_every_cycle_is_in_each() -> None:
    shares = [Share(3, 1, 100), Share(4, 2, 10), Share(5, 4, 7), Share(6, 4, 6)]
    chosen = offsets(shares)
    assert chosen == {3: 0, 4: 0, 5: 1, 6: 3}
    assert loads(shares, chosen, 4) == [110, 107, 110, 106]
    assert fullest(shares, chosen) == {3, 4}


def test_a_running_slave_keeps_its_offset_when_another_one_comes() -> None:
    shares = [Share(3, 2, 10), Share(4, 2, 20)]
    assert offsets(shares) == {4: 0, 3: 1}
    more = [*shares, Share(5, 2, 50)]
    assert offsets(more) == {5: 0, 4: 1, 3: 1}
    assert offsets(more, {4: 0, 3: 1}) == {4: 0, 3: 1, 5: 1}
    assert offsets(more, {4: 7, 9: 0}) == offsets(more)  # of another every, of a slave that is gone


def test_no_slaves() -> None:
    assert offsets([]) == {}
    assert fullest([], {}) == frozenset()


def test_groups_without_a_common_hyperperiod_meet_some_time() -> None:
    """9973 and 9967 are primes: a table of their cycles would have a hundred million."""
    shares = [Share(3, 9973, 10), Share(4, 9967, 10), Share(5, 9973, 9)]
    chosen = offsets(shares)
    assert chosen == {3: 0, 5: 1, 4: 0}
    assert fullest(shares, chosen) == {3, 4}


def test_min_slave_interval_of_a_slave_that_is_not_in_each_round() -> None:
    assert round_interval_ns([(1, 100_000), (10, 2_000_000), (3, 1_000_000)]) == 333_334
    assert round_interval_ns([]) == 0


EVERY = st.sampled_from([1, 2, 3, 4, 5, 6, 7, 8, 9, 10])
SHARES = st.dictionaries(st.integers(0, 125), st.tuples(EVERY, st.integers(1, 3000)), min_size=1, max_size=12).map(
    lambda d: [Share(address, *rest) for address, rest in d.items()]
)


@given(SHARES)
def test_offsets_are_in_range_and_the_same_in_any_order(shares: list[Share]) -> None:
    chosen = offsets(shares)
    assert all(0 <= chosen[s.address] < s.every for s in shares)
    assert offsets(reversed(shares)) == chosen
    assert offsets(shares, chosen) == chosen


@given(SHARES)
def test_the_fullest_cycle_is_the_fullest_and_no_worse_than_without_offsets(shares: list[Share]) -> None:
    chosen = offsets(shares)
    by_cycle = loads(shares, chosen, HYPERPERIOD)
    together = fullest(shares, chosen)
    assert sum(s.duration_ns for s in shares if s.address in together) == max(by_cycle)
    assert max(by_cycle) <= sum(s.duration_ns for s in shares)


@given(st.integers(2, 10), st.lists(st.integers(1, 1000), min_size=1, max_size=20))
def test_one_group_is_spread_as_evenly_as_greedy_does(every: int, durations: list[int]) -> None:
    """Graham's bound for any order: the mean and (1 - 1/n) of the longest."""
    shares = [Share(3 + n, every, duration) for n, duration in enumerate(durations)]
    worst = max(loads(shares, offsets(shares), every))
    assert worst * every <= sum(durations) + (every - 1) * max(durations)
