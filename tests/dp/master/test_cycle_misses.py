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
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.events import DoesNotFit
from dpstack.fdl.livelist import LiveList
from dpstack.phy.patience import HOST, Patience
from tests.dp.master.cycle_kit import P500, running, slave, steps

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
