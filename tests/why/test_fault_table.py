"""The table of faults: each plant is troubled as it claims, and ``bus.why`` names the cause.

The figures: in 23 of 25 faults the true cause, or its group, is the first one; a confidence of 0.9 or more is never
wrong; healthy slaves are called healthy; of two faults at once either is first, and both are in the list.
"""

from __future__ import annotations

import pytest
from api_kit import virtual

from tests.why.fault_plants import Plant, bring
from tests.why.fault_proofs import PROOFS
from tests.why.fault_score import outcome_of, share_right
from tests.why.fault_table import ALL, FAULTS, FURTHER, HEALTHY, PAIRS, SEEDS

#: a fault counts as found if so many of its seeds are right; a pair, for which both causes are wanted
FOUND, PAIR_FOUND = 0.9, 0.8
#: so many of the 25 faults must be found, and of all 30
OF_25, OF_30 = 23, 28


def test_causes_of_a_share() -> None:
    """One seed of every fifth plant; the others in the long runs."""
    outcomes = [outcome_of(fault, number % len(SEEDS)) for number, fault in enumerate(ALL) if number % 5 == 3]
    assert [(one.fault, one.sure_and_wrong) for one in outcomes if one.sure_and_wrong] == []
    wrong = [(one.fault, one.seed, one.causes[:3]) for one in outcomes if not one.is_right]
    assert len(wrong) <= 1, wrong
    assert not [one for one in wrong if one[0] in HEALTHY]


@pytest.mark.soak
def test_causes_of_all_seeds() -> None:
    outcomes = [outcome_of(fault, seed) for fault in ALL for seed in SEEDS]
    assert [(one.fault, one.seed, one.sure_and_wrong) for one in outcomes if one.sure_and_wrong] == []
    wrong = [(one.fault, one.seed, one.causes[:3]) for one in outcomes if not one.is_right]
    right = share_right(outcomes)
    assert all(right[fault] == 1 for fault in HEALTHY), wrong
    assert all(right[fault] >= PAIR_FOUND for fault in PAIRS), wrong
    assert sum(right[fault] >= FOUND for fault in FAULTS) >= OF_25, wrong
    assert sum(right[fault] >= FOUND for fault in FAULTS | FURTHER) >= OF_30, wrong
    # and of the single plants: 23 of 25 of them
    first = [one.first_is_right for one in outcomes if one.fault in FAULTS]
    assert sum(first) >= len(first) * OF_25 / len(FAULTS)


async def proved(plant: Plant) -> None:
    async with bring(plant):
        PROOFS[plant.fault](plant)


def test_table_is_whole() -> None:
    assert (len(FAULTS), len(FURTHER), len(HEALTHY), len(PAIRS)) == (25, 5, 5, 5)
    assert len(ALL) == 40
    assert PROOFS.keys() == ALL.keys()


@pytest.mark.soak
@pytest.mark.parametrize("fault", ALL)
def test_plants_have_their_faults(fault: str) -> None:
    for seed in SEEDS:
        virtual(proved(ALL[fault](seed)))
