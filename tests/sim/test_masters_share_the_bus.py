"""Several masters with the T_TR that the plan names: each gets its whole round in each hold, and sees that rotation."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from bus_kit import IDENT, SimBus
from msgspec.structs import replace
from planned_bus import identifiers
from support import S, WorldFactory

from dpstack.dp.master.fixed_cycle import MissReason
from dpstack.dp.plan.cycle_check import token_wait_ns
from dpstack.dp.plan.rotation_time import Case, Figures, OtherMasters, rotation
from dpstack.dp.slave_params import SlaveParams
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.stats import Histogram
from dpstack.units import ns_to_bits

BAUD = 500_000


def slaves_of(counts: list[int]) -> list[list[SlaveParams]]:
    """The slaves of each master, from address 20 on, with 12 octets each way."""
    found, address = [], 20
    for count in counts:
        numbers = range(address, address + count)
        found.append([SlaveParams(address=n, name=f"s{n}", ident=IDENT, config=identifiers(12, 12)) for n in numbers])
        address += count
    return found


@dataclass
class Seen:
    """What one master saw in half a second: rounds, token holds, rotations in bit times."""

    rounds: int
    holds: int
    shortest: int
    longest: int


def run(world: WorldFactory, counts: list[int], t_tr: int, t_sdr: int) -> list[Seen]:
    """So many masters, with so many slaves each, for half a second of undisturbed data exchange."""
    w = world()
    buses: list[SimBus] = []
    for number, slaves in enumerate(slaves_of(counts)):
        params = BusParams.preset(BAUD, address=2 + number, gap=10, hsa=2 + len(counts), t_tr=t_tr)
        buses.append(SimBus(w, params, slaves, t_sdr=t_sdr, watchdog_ms=650_000))
    assert w.run(3 * S, lambda: all(bus.exchanging for bus in buses))
    w.run_for(S // 5)
    before = [(bus.master.rounds, bus.station.stats.tokens) for bus in buses]
    for bus in buses:
        bus.master.rotation = Histogram()
    w.run_for(S // 2)
    return [
        Seen(
            bus.master.rounds - rounds,
            bus.station.stats.tokens - holds,
            ns_to_bits(bus.master.rotation.min_ns, BAUD),
            ns_to_bits(bus.master.rotation.max_ns, BAUD),
        )
        for bus, (rounds, holds) in zip(buses, before, strict=True)
    ]


def others_of(counts: list[int], number: int, case: Case) -> OtherMasters:
    """What the other masters of one need, as each one's own plan says."""
    params = BusParams.preset(BAUD)
    rounds = [rotation(params, slaves, case).bits for slaves in slaves_of(counts)]
    return OtherMasters(rounds=(*rounds[:number], *rounds[number + 1 :]))


@pytest.mark.parametrize("counts", [[10], [10, 10], [20, 5, 5]])
def test_t_tr_that_every_master_needs(counts: list[int], world: WorldFactory) -> None:
    params = BusParams.preset(BAUD)
    needed = {
        Figures(params, slaves, others_of(counts, number, Case.NORMAL)).t_tr_needed
        for number, slaves in enumerate(slaves_of(counts))
    }
    (t_tr,) = needed  # the same one for all of them
    # every slave as slow as it may be
    for seen in run(world, counts, t_tr, params.max_tsdr):
        assert abs(seen.holds - seen.rounds) <= 1
    # and in one go when they are quick, too
    for number, seen in enumerate(run(world, counts, t_tr, 11)):
        slaves = slaves_of(counts)[number]
        shortest = rotation(params, slaves, Case.SHORTEST, others_of(counts, number, Case.SHORTEST)).bits
        longest = rotation(params, slaves, Case.NORMAL, others_of(counts, number, Case.NORMAL)).bits
        telegrams = 2 * sum(counts) + len(counts)
        assert abs(seen.shortest - shortest) <= telegrams
        assert seen.longest <= longest


def test_with_less_a_round_goes_over_several_holds(world: WorldFactory) -> None:
    """T_TR for the sum of the rounds alone: after a full rotation there is no time left for a hold."""
    counts = [20, 5, 5]
    params = BusParams.preset(BAUD)
    slaves = slaves_of(counts)[0]
    t_tr = rotation(params, slaves, Case.SHORTEST, others_of(counts, 0, Case.SHORTEST)).bits
    first, second, third = run(world, counts, t_tr, 11)
    assert first.holds > 1.5 * first.rounds
    assert min(second.rounds, third.rounds) > 1.2 * first.rounds
    assert first.longest > 1.3 * t_tr


def test_masters_alike_need_no_list() -> None:
    params = BusParams.preset(BAUD)
    slaves = slaves_of([7])[0]
    alone = rotation(params, slaves, Case.NORMAL).bits
    alike, listed = OtherMasters(alike=2), OtherMasters(rounds=(alone, alone))
    assert Figures(params, slaves, alike).t_tr_needed == Figures(params, slaves, listed).t_tr_needed
    for case in Case:
        assert rotation(params, slaves, case, alike).bits == 3 * rotation(params, slaves, case).bits
    assert (alike.count, listed.count) == (2, 2)


@pytest.mark.parametrize("counts", [[5, 5], [5, 20], [3, 4, 5]])
def test_a_fixed_cycle_begins_no_later_than_the_plan_says(w: World, counts: list[int]) -> None:
    """The others run free with slow slaves: they have the token nearly always when the cycle is due."""
    params = BusParams.preset(BAUD, gap=10, hsa=2 + len(counts))
    plants = [[replace(setup, max_diag_len=6) for setup in slaves] for slaves in slaves_of(counts)]
    others = OtherMasters(rounds=tuple(rotation(params, slaves, Case.NORMAL).bits for slaves in plants[1:]))
    cycle_ns = 2 * params.ns(rotation(params, plants[0], Case.NORMAL, others).bits)
    planned = token_wait_ns(Figures(params, plants[0], others=others, cycle_ns=cycle_ns))
    t_tr = Figures(params, plants[0], others).t_tr_needed
    buses: list[SimBus] = []
    for number, slaves in enumerate(plants):
        own = params.replace(address=2 + number, t_tr=t_tr)
        buses.append(SimBus(w, own, slaves, 0 if number else cycle_ns, t_sdr=90, watchdog_ms=650_000))
    assert w.run(3 * S, lambda: all(bus.exchanging for bus in buses))
    w.run_for(S // 5)
    book = buses[0].master.cycles
    book.late, book.left_out = Histogram(), 0
    w.run_for(S)
    assert book.left_out == 0
    assert set(book.reasons) <= {MissReason.TOKEN}
    assert planned // 2 < book.late.max_ns <= planned
