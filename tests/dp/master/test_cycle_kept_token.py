"""Cycles so short that the token is kept from one to the next: for everybody each of them is a hold of its own."""

from __future__ import annotations

import pytest
from support import WorldFactory

from dpstack.dp.acyclic.class2 import ReadService, Service, ServiceDone
from dpstack.dp.plan.cycle_check import CycleVerdict, least_ns
from dpstack.dp.plan.rotation_time import Figures
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.events import HELD_BACK_CYCLES
from dpstack.params import BusParams
from dpstack.units import NS_PER_US
from tests.dp.master.cycle_kit import CycleBus, running, slave

CYCLES = 12 * HELD_BACK_CYCLES


def tight(world: WorldFactory, baud: int) -> CycleBus:
    """Three slaves and the shortest cycle there is: less than T_SL is left of it."""
    params = BusParams.preset(baud, address=2, gap=0)
    setups = [slave(address) for address in (3, 4, 5)]
    least = least_ns(Figures(params, setups))[CycleVerdict.POSSIBLE]
    cycle_ns = -(-least // NS_PER_US) * NS_PER_US
    return running(world, *setups, params=params, cycle_ns=cycle_ns, more=[acyclic_services(2)])


@pytest.mark.parametrize("baud", [500_000, 12_000_000])
def test_the_token_is_kept_and_outputs_are_taken_for_each_cycle(baud: int, world: WorldFactory) -> None:
    bus = tight(world, baud)
    asked: list[int] = []
    bus.master.context.on_begin = lambda: asked.append(bus.world.now)
    begun, tokens = bus.master.cycles.begun, bus.station.stats.tokens
    bus.run(CYCLES * bus.cycle_ns)
    cycles = bus.master.cycles.begun - begun
    assert cycles >= CYCLES - 1
    assert bus.station.stats.tokens - tokens < cycles // 2
    # as it begins: what a program set up to then goes out in it; its first bit may wait for a Global_Control to end
    early = [start - max(at for at in asked if at <= start) for start in bus.exchanges(3)]
    assert max(early) <= bus.params.ns(13 * 11 + bus.params.t_id2)


@pytest.mark.parametrize("baud", [500_000, 12_000_000])
def test_services_have_their_turn_in_one_of_eight_cycles(baud: int, world: WorldFactory) -> None:
    bus = tight(world, baud)
    for token, address in enumerate((3, 4, 5)):
        bus.send(ReadService(token, address, Service.CONFIG))
    forced = bus.master.window.forced
    bus.run(CYCLES * bus.cycle_ns)
    done = bus.events_of(ServiceDone)
    assert [each.outcome.failure for each in done] == [None] * 3
    assert 3 <= bus.master.window.forced - forced <= CYCLES // HELD_BACK_CYCLES
