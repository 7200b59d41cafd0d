"""The fixed cycle on the simulated wire: what waits between the rounds, what is missed and said, beginnings, ends."""

from __future__ import annotations

import itertools

import pytest
from bus_kit import mirror
from support import MS, US, S, WorldFactory

from dpstack.dp.acyclic.class2 import ReadService, Service, ServiceDone
from dpstack.dp.master.commands import ActivateSlave, AddSlave, DeactivateSlave, Mode, RemoveSlave, SetMode, Shutdown
from dpstack.dp.master.events import CyclesMissed, MasterStopped, SlaveState, SlaveStateChanged
from dpstack.dp.master.fixed_cycle import MissReason
from dpstack.dp.plan.cycle_check import CycleVerdict, least_ns
from dpstack.dp.plan.rotation_time import Figures
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.events import HELD_BACK_CYCLES, DoesNotFit
from dpstack.fdl.livelist import LiveList
from dpstack.params import BusParams
from dpstack.phy.patience import HOST, Patience
from dpstack.units import NS_PER_US
from tests.dp.master.cycle_kit import P500, CycleBus, running, slave, steps

# --- what waits between the rounds ------------------------------------------------------------------------------------


def test_absent_slaves_live_list_and_joining_do_not_move_the_grid(world: WorldFactory) -> None:
    live = LiveList(2, period_ns=S)
    bus = running(world, *(slave(a) for a in range(5, 10)), cycle_ns=8 * MS, silent=(7, 8), more=[live])
    bus.run(300 * MS)
    bus.world.remove(bus.slaves[9])  # a cycle with a time-out, then it is looked for
    bus.run(200 * MS)
    bus.world.add(bus.slaves[9])
    bus.until_exchanging()
    bus.run(200 * MS)
    starts = bus.exchanges(5)
    assert steps(starts) == {8 * MS}
    assert live.done
    assert {5, 6, 9} <= set(live.stations)
    assert bus.master.cycles.missed == 0
    states = [e.state for e in bus.events_of(SlaveStateChanged) if e.address == 9]
    assert states[0] is SlaveState.OFFLINE
    assert states[-1] is SlaveState.DATA_EXCHANGE


def test_bring_up_beside_a_cycle_takes_several_services_a_gap(world: WorldFactory) -> None:
    bus = running(world, cycle_ns=10 * MS)
    bus.world.add(mirror(7, P500))
    began = bus.world.now
    bus.send(AddSlave(slave(7)))
    while bus.state(7) is not SlaveState.DATA_EXCHANGE:
        bus.run(100 * US)
        assert bus.world.now < began + 20 * MS
    bus.run(50 * MS)
    assert steps(bus.exchanges(5)) == {10 * MS}


def test_a_request_that_fits_into_no_gap_goes_out_in_the_end_and_is_told_once(world: WorldFactory) -> None:
    """A diagnosis of unknown length: 11 octets twice with T_SL, 255 octets, T_ID1: 3484 bits, 7 ms; the cycle is 4."""
    class2 = acyclic_services(2)
    bus = running(world, more=[class2])
    for token in range(3):
        bus.send(ReadService(token, 5, Service.DIAGNOSIS))
    bus.run(300 * MS)
    done = bus.events_of(ServiceDone)
    assert [len(e.outcome.data) for e in done] == [6, 6, 6]
    told = bus.events_of(DoesNotFit)
    assert [(e.service, e.address) for e in told] == [("Slave_Diag", 5)]
    assert "Slave_Diag to station 5 fits between no two cycles: it can take 7" in told[0].text
    assert bus.master.window.forced == 3
    gaps = [b.t_ns - a.t_ns for a, b in itertools.pairwise(done)]
    assert min(gaps) >= 8 * 4 * MS - 4 * MS
    assert steps(bus.exchanges(5)) == {4 * MS}  # its answer was short


def test_a_forced_service_that_breaks_the_cycle_is_its_reason(world: WorldFactory) -> None:
    """A silent slave with the slack of a pty: nothing else can have been it."""
    class2 = acyclic_services(2)
    bus = running(world, cycle_ns=10 * MS, patience=HOST, more=[class2])
    bus.run(200 * MS)
    bus.send(ReadService(1, 5, Service.DIAGNOSIS), 150 * MS)
    bus.quiet()
    bus.send(ReadService(2, 5, Service.DIAGNOSIS))  # it is known now: 50 ms for it
    while not bus.requests(60):
        bus.run(10 * US)
    bus.world.silence(bus.slaves[5], 60 * MS, deaf=True)
    bus.run(300 * MS)
    missed = bus.events_of(CyclesMissed)
    assert "Slave_Diag to station 5 fits between no two cycles and was sent before" in missed[0].text
    assert bus.master.cycles.reasons[MissReason.NO_ROOM] >= 5


# --- deadline misses --------------------------------------------------------------------------------------------------


def test_a_long_round_leaves_out_whole_cycles_and_the_grid_stays(world: WorldFactory) -> None:
    """A slave dies with 20 ms of slack for it and one repetition: 10 cycles of 4 ms are over before the next begins."""
    bus = running(world, patience=Patience(known_ns=20 * MS, unknown_ns=MS, stall_ns=MS), after_ns=40 * MS)
    bus.run(8 * MS)
    origin = bus.exchanges(5)[0]
    before = bus.master.cycles.missed
    bus.world.remove(bus.slaves[6])
    bus.run(400 * MS)
    starts = bus.exchanges(5)
    assert {(start - origin) % (4 * MS) for start in starts} == {0}
    assert max(steps(starts)) >= 40 * MS
    book = bus.master.cycles
    assert book.missed - before == book.left_out == (max(steps(starts)) // (4 * MS)) - 1
    assert book.reasons == {MissReason.OVERRUN: book.left_out}
    (missed,) = bus.events_of(CyclesMissed)
    assert (missed.count, missed.missed) == (book.left_out, book.missed)
    assert "the round before took 4" in missed.text


def test_a_start_late_by_less_than_half_a_cycle_is_no_cycle_less(world: WorldFactory) -> None:
    """Two exchanges and a time-out each with its repetition need more than the cycle, by less than half of it."""
    bus = running(world, *(slave(a) for a in (5, 6, 7)), cycle_ns=int(3.4 * MS))
    bus.run(10 * MS)
    cycle_ns = int(3.4 * MS)
    origin = bus.exchanges(5)[0]
    number = bus.master.cycles.begun
    bus.world.silence(bus.slaves[7], 3 * MS)
    bus.run(100 * MS)
    starts = bus.exchanges(5)
    late = [(start - origin) % cycle_ns for start in starts]
    book = bus.master.cycles
    if max(late) > cycle_ns // 10:
        assert book.begun_late >= 1
    assert book.left_out == 0
    assert book.begun - number == pytest.approx(100 * MS / cycle_ns, abs=2)
    assert min(steps(starts)) >= cycle_ns // 2


def test_misses_are_told_at_once_then_once_a_second(world: WorldFactory) -> None:
    """An overloaded bus: the round takes 1.6 cycles, every second one is left out for ever."""
    bus = running(world, *(slave(a) for a in (5, 6, 7)), cycle_ns=2 * MS, after_ns=2 * S)
    bus.run(3 * S)
    told = bus.events_of(CyclesMissed)
    assert len(told) == 3
    assert all(990 * MS < b.t_ns - a.t_ns < 1010 * MS for a, b in itertools.pairwise(told))
    assert told[-1].text.startswith(f"deadline misses {told[-2].missed + 1} to {told[-1].missed}: cycle ")
    assert told[-1].reason.startswith("the round before took 2.99 ms")
    assert sum(e.count for e in told) == told[-1].missed - told[0].missed + told[0].count
    assert {(b - a) % (2 * MS) for a, b in itertools.pairwise(bus.exchanges(5))} == {0}
    bus.events.clear()
    bus.run(500 * MS)
    bus.send(Shutdown(), S)
    last = bus.events_of(CyclesMissed)
    assert sum(e.count for e in last) + told[-1].missed == bus.master.cycles.missed  # none is kept back


# --- beginnings and ends ----------------------------------------------------------------------------------------------


def test_the_end_does_not_wait_for_the_grid(world: WorldFactory) -> None:
    """Safe values for 50 ms, Clear twice: with a cycle of 500 ms it takes no longer than without."""
    bus = running(world, slave(5, safe=bytes([9]) * 12, watchdog_ms=3000), cycle_ns=500 * MS, after_ns=S)
    began = bus.world.now
    bus.send(Shutdown(), 200 * MS)
    (stopped,) = bus.events_of(MasterStopped)
    assert stopped.t_ns - began < 60 * MS
    first = next(e for e in bus.wire if e.octets[:5] == bytes((0x68, 15, 15, 0x68, 5)))
    assert first.octets[7:19] == bytes([9]) * 12
    assert first.start_ns - began < MS
    assert [e.octets[9:11] for e in bus.requests(58)][-2:] == [b"\x02\x00"] * 2


def test_clear_stop_and_back_begin_a_new_grid(world: WorldFactory) -> None:
    bus = running(world)
    bus.send(SetMode(Mode.STOP), 50 * MS)
    bus.quiet()
    bus.run(50 * MS)
    assert bus.exchanges(5) == []
    assert bus.master.window.next_at > S * 10**6  # nothing is held back for nobody
    bus.send(SetMode(Mode.OPERATE))
    bus.until_exchanging()
    bus.run(20 * MS)
    bus.quiet()
    bus.run(50 * MS)
    assert steps(bus.exchanges(5)) == {4 * MS}
    assert bus.master.cycles.missed == 0


def test_slaves_come_and_go_without_a_miss(world: WorldFactory) -> None:
    bus = running(world, slave(5), slave(6), slave(7, every=3))
    for command in (DeactivateSlave(6), RemoveSlave(7), ActivateSlave(6)):
        bus.send(command, 120 * MS)
    assert steps(bus.exchanges(5)) == {4 * MS}
    assert bus.master.cycles.missed == 0
    assert bus.state(6) is SlaveState.DATA_EXCHANGE


def test_the_only_slave_comes_back_and_the_grid_begins_anew(world: WorldFactory) -> None:
    bus = running(world, slave(5))
    bus.world.remove(bus.slaves[5])
    bus.run(30 * MS)
    bus.world.add(bus.slaves[5])
    bus.until_exchanging()
    bus.run(10 * MS)
    bus.quiet()
    bus.run(40 * MS)
    assert steps(bus.exchanges(5)) == {4 * MS}


# --- Cycles so short that the token is kept from one to the next: for everybody each of them is a hold of its own ---


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


# --- A fixed cycle as long as the shortest rotation: the grid stays, and services cost one cycle in nine ------------


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
