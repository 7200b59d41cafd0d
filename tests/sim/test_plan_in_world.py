"""The plan and the wire: in virtual time they differ by no more than one bit time a telegram.

``make test`` has every rate with few slaves and a few rates with many; ``make soak`` the whole matrix.
"""

from __future__ import annotations

from collections import defaultdict

import pytest
from bus_kit import SimBus
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from planned_bus import FIRST, identifiers, kind, setups, undisturbed
from property_kit import examples, soaking
from support import S, WorldFactory

from dpstack.dp.plan.plan import make_plan
from dpstack.dp.plan.rotation_time import Case, Figures, rotation
from dpstack.params import BusParams
from dpstack.trace import WireEntry
from dpstack.units import BAUD_RATES, ns_to_bits

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


# --- Rate groups on the wire against the plan: its fullest cycle is the fullest one there is, to the bit ------------


#: in, out, every
SLAVES = st.tuples(st.integers(0, 40), st.integers(0, 40), st.sampled_from((1, 2, 2, 3, 4, 6)))


@examples(10)
@given(st.sampled_from((93_750, 500_000, 1_500_000, 12_000_000)), st.lists(SLAVES, min_size=1, max_size=7))
def test_the_fullest_cycle_is_the_one_of_the_plan(baud: int, given_: list[tuple[int, int, int]]) -> None:
    factory = WorldFactory()
    w = factory()
    params = BusParams.preset(baud, gap=0)
    plain = setups([identifiers(i, o) for i, o, _ in given_])
    slaves = [replace(setup, every=every) for setup, (_, _, every) in zip(plain, given_, strict=True)]
    planned = make_plan(params, slaves).rotations[Case.SHORTEST]
    cycle_ns = 2 * params.ns(planned.bits + 3000)
    params = params.replace(t_tr=max(params.t_tr, 4 * planned.bits))
    bus = SimBus(w, params, slaves, watchdog_ms=650_000, cycle_ns=cycle_ns).until_exchanging(60 * S)
    master = bus.master
    w.run_for(13 * cycle_ns)  # those that came late have found their turns
    entries: list[WireEntry] = []
    w.log.listener = entries.append
    origin = master.cycle.due_ns if master.cycle else master._cadence.due_at
    w.run_for(25 * cycle_ns)
    data: dict[int, list[WireEntry]] = defaultdict(list)
    for entry in entries:
        if kind(entry) in ("request", "answer"):
            data[(entry.start_ns - origin) // cycle_ns].append(entry)
    whole = [data[n] for n in sorted(data)[1:-1]]
    assert len(whole) >= 20 or any(s.every > 1 for s in slaves)
    took = [cycle[-1].end_ns - cycle[0].start_ns for cycle in whole]
    fullest = whole[took.index(max(took))]
    asked = {e.octets[1 if e.octets[0] == 0x10 else 4] for e in fullest if kind(e) == "request"}
    # the idle time after its last answer is part of the plan's
    assert abs(ns_to_bits(max(took), baud) + params.t_id1 - planned.data) <= 1
    assert sum(planned.slaves[a] for a in asked) == sum(planned.slaves[a] for a in planned.together) == planned.data
    assert min(asked) >= FIRST
    assert master.cycles.missed == 0
    factory.check()
