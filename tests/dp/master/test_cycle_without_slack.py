"""A fixed cycle as long as the shortest rotation: the grid stays, and services cost one cycle in nine."""

from __future__ import annotations

import itertools

import pytest
from support import MS, WorldFactory

from dpstack.dp.acyclic.class2 import ReadService, Service, ServiceDone
from dpstack.dp.plan.cycle_check import CycleVerdict, least_ns
from dpstack.dp.plan.rotation_time import Figures
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.events import HELD_BACK_CYCLES
from tests.dp.master.cycle_kit import P500, CycleBus, running, slave, steps

#: places of the grid that a run counts: a hundred times the eight cycles of waiting and the one left out
PLACES = 100 * (HELD_BACK_CYCLES + 1)


def shortest_rotation(slaves: int) -> int:
    """In ns, by the plan: the slaves answer after min T_SDR, and nothing but their data is sent."""
    return least_ns(Figures(P500, [*map(slave, range(5, 5 + slaves))]))[CycleVerdict.POSSIBLE]


def run_places(bus: CycleBus, places: int, *, waiting: int) -> None:
    """Run for ``places`` of the grid, with ``waiting`` services of a second master waiting at any time."""
    cycle_ns = bus.master.cycles.cycle_ns
    tokens = itertools.count()
    ordered, end = 0, bus.world.now + places * cycle_ns
    while bus.world.now < end:
        while ordered - len(bus.events_of(ServiceDone)) < waiting:
            bus.send(ReadService(next(tokens), 5, Service.DIAGNOSIS))
            ordered += 1
        bus.run(min(cycle_ns // 4, end - bus.world.now))


def test_a_service_costs_one_cycle_and_all_others_begin_in_time(world: WorldFactory) -> None:
    """Each takes a fifth of the cycle: it goes out after eight cycles, the ninth is left out, and the grid stays."""
    cycle_ns = shortest_rotation(2)
    bus = running(world, cycle_ns=cycle_ns, more=[acyclic_services(2)], after_ns=100 * MS)
    book = bus.master.cycles
    begun, begun_late, left_out = book.begun, book.begun_late, book.left_out
    forced = bus.master.window.forced
    run_places(bus, PLACES, waiting=2)
    assert (book.begun - begun, book.begun_late - begun_late, book.left_out - left_out) == (800, 0, 100)
    assert bus.master.window.forced - forced == 100
    assert len(bus.events_of(ServiceDone)) == 100  # Global_Control and GAP polls fit into the cycles that are left out
    starts = bus.exchanges(5)
    assert len(starts) == 800
    assert {round((start - starts[0]) / cycle_ns, 2) % 1 for start in starts} == {0}
    assert max(steps(starts)) == 2 * cycle_ns  # never two in a row


def test_services_that_take_less_than_a_tenth_of_a_cycle_add_up_to_one_that_is_left_out(world: WorldFactory) -> None:
    """Each takes a twentieth: after three of them a cycle is left out, so that no delay stays."""
    slaves = 8
    cycle_ns = shortest_rotation(slaves)
    bus = running(world, *map(slave, range(5, 5 + slaves)), cycle_ns=cycle_ns, more=[acyclic_services(2)])
    book = bus.master.cycles
    begun, missed, left_out, forced = book.begun, book.missed, book.left_out, bus.master.window.forced
    run_places(bus, PLACES, waiting=2)
    count = bus.master.window.forced - forced
    assert count == pytest.approx(PLACES / HELD_BACK_CYCLES, rel=0.1)
    assert book.missed - missed <= count
    assert book.begun - begun + book.left_out - left_out == PLACES
    starts = bus.exchanges(5)
    late = [(start - starts[0]) % cycle_ns for start in starts]
    assert max(late) < cycle_ns // 8
    assert max(steps(starts)) < 2 * cycle_ns + cycle_ns // 8
    assert len(bus.events_of(ServiceDone)) > 0.9 * count


def test_rounds_that_take_longer_than_the_cycle_go_on_as_fast_as_they_can(world: WorldFactory) -> None:
    """No cycle that is left out could keep this grid: the master leaves out only those late by more than half of it."""
    cycle_ns = shortest_rotation(2) * 85 // 100
    bus = running(world, cycle_ns=cycle_ns, after_ns=100 * MS)
    book = bus.master.cycles
    begun, begun_late, left_out = book.begun, book.begun_late, book.left_out
    bus.run(PLACES * cycle_ns)
    # in turn one in time, three late, one left out
    assert (book.begun - begun, book.begun_late - begun_late, book.left_out - left_out) == (720, 540, 180)
