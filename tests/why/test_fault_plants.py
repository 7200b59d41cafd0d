"""Each plant of the table of faults is troubled as it claims: by the facts of its devices and of the wire.

(``test_fault_table`` proves each plant that it asks about, too.)
"""

from __future__ import annotations

import pytest
from api_kit import virtual

from tests.why.fault_plants import Plant, bring
from tests.why.fault_proofs import PROOFS
from tests.why.fault_table import ALL, FAULTS, FURTHER, HEALTHY, PAIRS, SEEDS


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
