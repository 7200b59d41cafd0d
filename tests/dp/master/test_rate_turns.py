"""Turns of rate groups while the bus runs: lost ones, slaves that come and go."""

from __future__ import annotations

from collections.abc import Iterable

from hypothesis import given
from hypothesis import strategies as st

from dpstack.dp.master.poll_order import RateTurns
from dpstack.dp.rate_groups import offsets
from dpstack.dp.telegram_times import share
from dpstack.params import BusParams
from tests.dp.master.cycle_kit import slave

P500 = BusParams.preset(500_000, address=2)


def turns(rates: RateTurns, address: int, cycles: Iterable[int]) -> list[int]:
    taken = []
    for number in cycles:
        if rates.due(address, number):
            rates.had_turn(address, number)
            taken.append(number)
    return taken


def test_offsets_decide_the_cycles() -> None:
    rates = RateTurns(P500)
    rates.arrange([slave(5), slave(6, every=3), slave(7, every=3)])
    assert turns(rates, 5, range(1, 5)) == [1, 2, 3, 4]
    assert turns(rates, 6, range(1, 12)) == [3, 6, 9]
    assert turns(rates, 7, range(1, 12)) == [1, 4, 7, 10]


def test_a_turn_whose_cycle_was_left_out_comes_in_the_next_one() -> None:
    rates = RateTurns(P500)
    rates.arrange([slave(6, every=4)])
    assert turns(rates, 6, range(2, 10)) == [4, 8]
    assert not rates.due(6, 11)
    assert rates.due(6, 14)  # 12 and 13 were left out
    rates.had_turn(6, 14)
    assert turns(rates, 6, range(15, 30)) == [16, 20, 24, 28]


def test_a_slave_that_comes_back_takes_a_turn_of_its_own() -> None:
    rates = RateTurns(P500)
    rates.arrange([slave(6, every=4)])
    assert turns(rates, 6, range(1, 6)) == [4]
    rates.left_exchange(6)
    assert turns(rates, 6, range(101, 110)) == [104, 108]


def test_a_running_slave_keeps_its_turns_when_another_one_comes() -> None:
    rates = RateTurns(P500)
    rates.arrange([slave(6, every=2), slave(8, every=2)])
    before = turns(rates, 8, range(1, 10))
    rates.arrange([slave(6, every=2), slave(7, every=2), slave(8, every=2)])
    assert turns(rates, 8, range(10, 14)) == [n for n in range(10, 14) if n % 2 == before[0] % 2]
    assert rates.has_slower_slaves
    rates.arrange([slave(6)])
    assert not rates.has_slower_slaves


@given(
    st.lists(st.integers(2, 9), min_size=1, max_size=6),
    st.integers(1, 60),
    st.lists(st.integers(0, 12), max_size=12),
)
def test_a_turn_is_in_every_nth_cycle_or_in_the_next_one_that_takes_place(
    everies: list[int], first: int, gaps: list[int]
) -> None:
    """The cycles of a slave are those whose numbers leave one remainder; some cycles do not take place."""
    rates = RateTurns(P500)
    setups = [slave(3 + n, every=every) for n, every in enumerate(everies)]
    rates.arrange(setups)
    chosen = offsets(share(P500, setup) for setup in setups)
    cycles = [first]
    for gap in [*gaps, *[0] * 20]:
        cycles.append(cycles[-1] + 1 + gap)
    for setup in setups:
        wanted = [n for n in range(first, cycles[-1] + 1) if n % setup.every == chosen[setup.address]]
        expected = []
        for number in cycles:
            missed = [n for n in wanted if n <= number]
            if missed:
                expected.append(number)
                wanted = wanted[len(missed) :]
        assert turns(rates, setup.address, cycles) == expected
