"""Turns of rate groups while the bus runs: lost ones, slaves that come and go."""

from __future__ import annotations

from cycle_kit import slave

from dpstack.dp.master.poll_order import RateTurns
from dpstack.params import BusParams

P500 = BusParams.preset(500_000, address=2)


def turns(rates: RateTurns, address: int, cycles: range) -> list[int]:
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


def test_who_comes_back_takes_a_turn_of_its_own() -> None:
    rates = RateTurns(P500)
    rates.arrange([slave(6, every=4)])
    assert turns(rates, 6, range(1, 6)) == [4]
    rates.left_exchange(6)
    assert turns(rates, 6, range(101, 110)) == [104, 108]


def test_who_runs_keeps_its_turns_when_another_one_comes() -> None:
    rates = RateTurns(P500)
    rates.arrange([slave(6, every=2), slave(8, every=2)])
    before = turns(rates, 8, range(1, 10))
    rates.arrange([slave(6, every=2), slave(7, every=2), slave(8, every=2)])
    assert turns(rates, 8, range(10, 14)) == [n for n in range(10, 14) if n % 2 == before[0] % 2]
    assert rates.has_slower_slaves
    rates.arrange([slave(6)])
    assert not rates.has_slower_slaves
