"""The plan and the wire: in virtual time they differ by no more than one bit time a telegram.

``make test`` has every rate with few slaves and a few rates with many; ``make soak`` the whole matrix.
"""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planned_bus import identifiers, setups, undisturbed
from property_kit import soaking
from support import WorldFactory

from dpstack.dp.plan.rotation_time import Case, Figures, rotation
from dpstack.params import BusParams
from dpstack.units import BAUD_RATES

#: in and out: PPO1, PPO3, inputs only, outputs only, neither, long ones
MIXED = [identifiers(*lengths) for lengths in ((12, 12), (4, 4), (1, 0), (0, 1), (0, 0), (32, 16), (3, 64))]
NUMBERS = (1, 2, 3, 10, 32, 100)
FEW = [(baud, number) for baud in BAUD_RATES for number in NUMBERS if number <= 3]
MANY = [(500_000, 10), (12_000_000, 10), (1_500_000, 32), (12_000_000, 100)]
MATRIX = [(baud, number) for baud in BAUD_RATES for number in NUMBERS]


def mixed(number: int) -> list[bytes]:
    return [MIXED[n % len(MIXED)] for n in range(number)]


def hold_shortest(
    world: WorldFactory, params: BusParams, configs: list[bytes], *, min_tsdr: int = 11, rounds: int = 12
) -> None:
    slaves = setups(configs, min_tsdr)
    params = params.replace(t_tr=Figures(params, slaves).t_tr_preset)
    planned = params.ns(rotation(params, slaves, Case.SHORTEST).bits)
    measured = undisturbed(world, params, slaves, rounds=rounds)
    assert len(measured) >= rounds // 2
    telegrams = 2 * len(slaves) + 1
    assert max(abs(ns - planned) for ns in measured) <= telegrams * params.ns(1)


def hold_typical(world: WorldFactory, baud: int, configs: list[bytes]) -> None:
    """A T_TR so short that one pass over the GAP follows the other: a silent poll in each rotation."""
    slaves = setups(configs)
    params = BusParams.preset(baud, gap=1)
    params = params.replace(t_tr=max(256, 3 * rotation(params, slaves, Case.TYPICAL).bits))
    planned = params.ns(rotation(params, slaves, Case.TYPICAL).bits)
    measured = undisturbed(world, params, slaves, t_sdr=60, gap_polls=1, rounds=len(slaves) + 20)
    assert len(measured) >= 5
    telegrams = 2 * len(slaves) + 2
    assert max(abs(ns - planned) for ns in measured) <= telegrams * params.ns(1)


@pytest.mark.parametrize(("baud", "number"), FEW + MANY)
def test_the_shortest_rotation(baud: int, number: int, world: WorldFactory) -> None:
    hold_shortest(world, BusParams.preset(baud, gap=0), mixed(number), rounds=12 if number < 32 else 6)


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_the_typical_rotation(baud: int, world: WorldFactory) -> None:
    hold_typical(world, baud, mixed(3))


@pytest.mark.soak
@pytest.mark.parametrize(("baud", "number"), MATRIX)
def test_the_whole_matrix(baud: int, number: int, world: WorldFactory) -> None:
    hold_shortest(world, BusParams.preset(baud, gap=0), mixed(number))
    hold_typical(world, baud, mixed(number))


LENGTHS = st.tuples(st.integers(0, 64), st.integers(0, 64))


@given(
    st.sampled_from(BAUD_RATES),
    st.lists(LENGTHS, min_size=1, max_size=100 if soaking() else 6),
    st.integers(11, 35),
    st.integers(0, 400),
)
@settings(deadline=None)
def test_other_lengths_other_t_sdr_other_pauses(
    baud: int, lengths: list[tuple[int, int]], min_tsdr: int, extra_idle: int
) -> None:
    factory = WorldFactory()
    params = BusParams.preset(baud, gap=0, extra_idle=extra_idle)
    hold_shortest(factory, params, [identifiers(*each) for each in lengths], min_tsdr=min_tsdr, rounds=6)
    factory.check()
