"""The table of faults: each plant is troubled as it claims, and ``bus.why`` names the cause.

The figures: in 23 of 25 faults the true cause, or its group, is the first one; a confidence of 0.9 or more is never
wrong; healthy slaves are called healthy; of two faults at once either is first, and both are in the list.
"""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from fault_score import Outcome, outcome_of, share_right
from fault_table import ALL, FAULTS, FURTHER, HEALTHY, PAIRS, SEEDS

#: of all seeds of a fault, so many must be right for the fault to count as found
FOUND = 0.9
#: so many of the 25 faults must be found, and of all 30
OF_25, OF_30 = 23, 28
#: of the share, so many may be wrong
MAY_FAIL = 3


def check(outcomes: Iterable[Outcome], found: float) -> None:
    """The figures hold for ``outcomes``, in which every plant of the table has the same number of seeds."""
    outcomes = list(outcomes)
    assert [(one.fault, one.seed, one.sure_and_wrong) for one in outcomes if one.sure_and_wrong] == []
    wrong = [(one.fault, one.seed, one.causes[:3]) for one in outcomes if not one.is_right]
    shares = share_right(outcomes)
    right = {fault for fault, share in shares.items() if share >= found}
    assert right >= HEALTHY.keys(), wrong
    assert right >= PAIRS.keys(), wrong
    assert len(right & FAULTS.keys()) >= OF_25, wrong
    assert len(right & (FAULTS | FURTHER).keys()) >= OF_30, wrong


def test_causes_of_a_share() -> None:
    """One seed of every fourth plant; the others in the long runs."""
    outcomes = [outcome_of(fault, number % len(SEEDS)) for number, fault in enumerate(ALL) if number % 4 == 3]
    wrong = [(one.fault, one.seed, one.causes[:3]) for one in outcomes if not one.is_right]
    assert len(wrong) <= MAY_FAIL, wrong


@pytest.mark.soak
def test_causes_of_all_seeds() -> None:
    check((outcome_of(fault, seed) for fault in ALL for seed in SEEDS), FOUND)
