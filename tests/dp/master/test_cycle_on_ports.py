"""The fixed cycle with a port's patience, in virtual time: what may come between two cycles, what silence costs.

What a port delivers late is the adapter's part here; beside that the wire is exact, so a start that is not on the grid
was put there by the stack.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from typing import Any

import pytest
from adapter_model import FTDI_LOW_LATENCY, Adapter
from bus_kit import IDENT, PPO1, mirror
from slave_kit import make_slave
from support import MS, US, S, WorldFactory

from dpstack.dp.acyclic.class2 import ReadService, Service, ServiceDone
from dpstack.dp.master.commands import Mode, SetMode, Shutdown
from dpstack.dp.master.events import CyclesMissed, SlaveState
from dpstack.dp.master.fixed_cycle import MissReason
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.events import DoesNotFit, StationFound
from dpstack.fdl.interface import BusStation
from dpstack.params import BusParams
from dpstack.phy.patience import HOST, Patience, measured
from dpstack.sim.world import World
from dpstack.units import NEVER
from tests.dp.master.cycle_kit import P500, CycleBus, running, slave, steps

P1500 = BusParams.preset(1_500_000, address=2)


def on_a_port(world: WorldFactory, *setups: SlaveParams, cycle_ns: int = 10 * MS, **more: Any) -> CycleBus:
    """A bus at 1.5 Mbit/s whose port has the patience of a pty."""
    return running(world, *setups, cycle_ns=cycle_ns, params=P1500, patience=HOST, **more)


def gap_polls(bus: CycleBus) -> list[tuple[int, int]]:
    """Begin of each FDL_Status of the master, and its address."""
    return [(e.start_ns, e.octets[1]) for e in bus.wire if e.octets[0] == 0x10 and e.octets[2:4] == b"\x02\x49"]


@pytest.mark.parametrize("cycle_ms", [2, 5])
def test_silent_addresses_on_a_pty_never_break_a_cycle(world: WorldFactory, cycle_ms: int) -> None:
    """Three slaves of 1 ms together; an absent one, the GAP. 2 ms of patience are more than a cycle of 2 ms has."""
    setups = [slave(3), slave(4), slave(5), slave(6)]
    bus = on_a_port(world, *setups, cycle_ns=cycle_ms * MS, silent=(6,), options={"absent_divisor": 100}, after_ns=S)
    missed, forced = bus.master.cycles.missed, bus.master.window.forced
    bus.run(2 * S)
    starts = bus.exchanges(3)
    assert {later - earlier for earlier, later in itertools.pairwise(starts)} == {cycle_ms * MS}
    assert bus.master.cycles.missed == missed
    polled = [address for _, address in gap_polls(bus)]
    assert len(set(polled)) > 50
    # those who are there get 2 ms, more than a cycle of 2 ms has to spare: their polls are sent all the same
    assert bus.master.window.forced - forced == (len(set(polled) & {3, 4, 5}) if cycle_ms == 2 else 0)
    assert len(bus.requests(60)) >= 2  # the absent one is asked for all the time
    told = [(e.service, e.address) for e in bus.events_of(DoesNotFit)]
    assert told == ([("FDL_Status", 3)] if cycle_ms == 2 else [])


def test_a_poll_has_all_the_time_there_is(world: WorldFactory) -> None:
    """A silent poll ends 2.4 ms after it at the latest, sooner where the next cycle needs it."""
    bus = on_a_port(world, slave(3), slave(4), slave(5), cycle_ns=5 * MS, after_ns=S)
    bus.run(S)
    starts = [e.start_ns for e in bus.wire]
    silent = [
        min(s for s in starts if s > begin) - begin
        for begin, address in gap_polls(bus)
        if address not in (3, 4, 5) and begin < starts[-1]
    ]
    assert max(silent) <= P1500.ns(66 + 300 + 11 + 37) + 2 * MS + US
    assert min(silent) >= P1500.ns(66 + 300 + 11 + 121)  # an answer could still be on the line before
    assert len(silent) > 30


def test_a_diagnosis_on_a_pty_does_not_wait_eight_cycles(world: WorldFactory) -> None:
    """50 ms for the silence of a slave in data exchange fit into no cycle of 10 ms; 2 ms, which a pty needs, do."""
    bus = on_a_port(world, slave(3), slave(4), more=[acyclic_services(2)], after_ns=200 * MS)
    began = bus.world.now
    for token in range(5):
        bus.send(ReadService(token, 3, Service.DIAGNOSIS))
    bus.run(150 * MS)
    done = bus.events_of(ServiceDone)
    assert len(done) == 5
    assert done[-1].t_ns - began < 60 * MS
    assert bus.master.window.forced == 0


def test_a_slave_that_dies_at_a_service_costs_cycles_and_is_the_reason(world: WorldFactory) -> None:
    """The GAP asks for it when it is known: 50 ms, as in a Data_Exchange."""
    bus = on_a_port(world, slave(3), slave(4), after_ns=4 * S)
    origin = bus.world.now
    while tuple(bus.wire[-1].octets[1:4] if bus.wire else ()) != (4, 2, 0x49):
        bus.run(20 * US)
    bus.world.silence(bus.slaves[4], 20 * MS, deaf=True)
    bus.run(200 * MS)
    missed = bus.events_of(CyclesMissed)
    assert missed[0].reason == "FDL_Status to station 4 was not answered"
    book = bus.master.cycles
    assert book.reasons == {MissReason.SILENCE: book.missed}
    assert 4 <= book.missed <= 6
    starts = [start for start in bus.exchanges(3) if start > origin]
    late = [(start - starts[0]) % (10 * MS) for start in starts]
    assert sum(map(bool, late)) <= 1  # the first one after it
    assert bus.state(4) is SlaveState.DATA_EXCHANGE


def until_seen(bus: CycleBus, address: int, *, there: bool, within_ns: int) -> None:
    """Run until the GAP has found a station at ``address``, or that nobody is there any more."""
    end = bus.world.now + within_ns
    while address not in {e.address for e in bus.events_of(StationFound) if (e.kind is not None) is there}:
        assert bus.world.now < end
        bus.run(100 * MS)


def test_a_slave_that_went_is_waited_for_once(world: WorldFactory) -> None:
    """Its last exchange with all slack; after that it is an address where nobody is known to be, for the GAP too."""
    bus = CycleBus(world(), P1500, [slave(3), slave(4)], 10 * MS, patience=HOST, options={"absent_divisor": 100})
    bus.until_exchanging()
    until_seen(bus, 4, there=True, within_ns=4 * S)  # by the GAP
    bus.world.remove(bus.slaves[4])
    bus.run(200 * MS)
    missed = bus.master.cycles.missed
    assert missed >= 10
    bus.quiet()
    until_seen(bus, 4, there=False, within_ns=8 * S)
    assert bus.master.cycles.missed == missed


@pytest.mark.parametrize("offset", range(60, 560, 20))
def test_a_control_just_before_a_cycle_does_not_make_it_late(world: WorldFactory, offset: int) -> None:
    """The mode is repeated so many bits before a cycle is due."""
    bus = running(world, slave(5), cycle_ns=10 * MS, after_ns=100 * MS)
    bus.run(10 * MS + 5 * MS)
    start = bus.exchanges(5)[-1]
    bus.master.controls._due = start + 10 * MS - P500.ns(offset)
    bus.run(30 * MS)
    assert {(begin - start) % (10 * MS) for begin in bus.exchanges(5)} == {0}
    assert bus.master.cycles.missed == 0


@pytest.mark.parametrize("before_us", [100, 300, 500, 700, 1000])
def test_the_end_does_not_wait_for_a_cycle_that_the_token_is_kept_for(world: WorldFactory, before_us: int) -> None:
    bus = running(world, slave(5, safe=bytes([9]) * 12), cycle_ns=20 * MS, after_ns=0)
    bus.run(200 * MS)
    due = bus.exchanges(5)[-1] + 20 * MS
    while due - bus.world.now > before_us * US:
        bus.run(10 * US)
    bus.quiet()
    ordered = bus.world.now
    bus.send(Shutdown(), 5 * MS)
    assert bus.data(5)[0].octets[7:19] == bytes([9]) * 12
    # what was under way (a silent poll of 532 us and the token to itself), and T_ID1
    assert bus.exchanges(5)[0] - ordered <= 1100 * US


def test_behind_an_adapter_a_slave_that_comes_later_is_taken_in(w: World) -> None:
    """Answers are 1 to 2 ms late; a poll of the GAP has less time than that in some cycles, and is found out."""
    setups = [slave(5, watchdog_ms=1000), slave(6, watchdog_ms=1000)]
    stations = {s.address: mirror(s.address, P500) for s in setups}
    w.add(stations[5])
    master = Master(P500, setups, MasterSettings(cycle_ns=30 * MS, absent_divisor=100))
    station = ActiveStation(P500, [master], patience=measured(2 * MS), window=master.window)
    plugged = Adapter(station, FTDI_LOW_LATENCY)
    w.add(plugged)
    w.command(plugged, GoOnline())
    w.command(plugged, SetMode(Mode.OPERATE))
    w.run_for(3 * S)
    assert master.handlers[5].state is SlaveState.DATA_EXCHANGE
    w.add(stations[6])
    w.run_for(3 * S)
    assert master.handlers[6].state is SlaveState.DATA_EXCHANGE
    missed = master.cycles.missed
    w.run_for(3 * S)
    assert master.cycles.missed == missed
    assert master.window.forced == 0


# --- A slave that hears late -----------------------------------------------------------------------------------------
# It is simulated on a busy computer or stands behind a slow adapter, and is found. It answers no request that has
# another one behind it, so it has to be waited for: with every so many polls.


P187 = BusParams.preset(187_500, address=2, gap=0)
LATE = pytest.mark.parametrize("late_ms", [2, 3, 5, 10, 20, 35, 48, 50])


class Late(Adapter):
    """A station whose computer looks at its port ``lateness()`` ns after the first octet that it has not read."""

    def __init__(self, station: BusStation, lateness: Callable[[], int]) -> None:
        super().__init__(station)
        self._lateness = lateness
        self._looks_at = NEVER

    def receive(self, chunk: bytes, now: int) -> int:
        if not self._fifo:
            self._looks_at = now + self._lateness()
        return super().receive(chunk, now)

    def _packet_due(self) -> int:
        return self._looks_at if self._fifo else NEVER

    def _frame(self, at: int) -> int:
        return at

    def _deliver(self, now: int) -> None:
        super()._deliver(now)
        if self._fifo:
            self._looks_at = now  # all of it


def fixed(ms: int) -> Callable[[], int]:
    return lambda: ms * MS


def jittering(ms: int) -> Callable[[], int]:
    """Up to a quarter less than that."""
    rng = random.Random(ms)
    return lambda: rng.randrange(ms * MS * 3 // 4, ms * MS)


def bus_beside(world: WorldFactory, cycle_ns: int = 0, patience: Patience = HOST, **more: Any) -> CycleBus:
    """Slave 5 is in data exchange; nobody has station 6 yet, and nobody ever has 7."""
    options = {"absent_divisor": patience.unknown_divisor, "watchdog_ms": 1000}
    setups = (slave(5), slave(6), slave(7))
    w = world(referee=False)  # who answers late breaks T_SL
    bus = CycleBus(w, P187, setups, cycle_ns, silent=(6, 7), patience=patience, options=options, **more)
    bus.until_exchanging()
    return bus


def add_late(bus: CycleBus, lateness: Callable[[], int]) -> Late:
    late = Late(make_slave(6, MirrorDevice(IDENT, PPO1), P187, patience=HOST), lateness)
    bus.world.add(late)
    return late


def exchanging_within(bus: CycleBus, within_ns: int, address: int = 6) -> int:
    """How long it took."""
    began = bus.world.now
    while bus.state(address) is not SlaveState.DATA_EXCHANGE:
        assert bus.world.now < began + within_ns, "never found"
        bus.run(10 * MS)
    return bus.world.now - began


@LATE
@pytest.mark.parametrize("how", [fixed, jittering])
def test_free_running_a_late_slave_is_found_with_its_third_poll(
    world: WorldFactory, late_ms: int, how: Callable[[int], Callable[[], int]]
) -> None:
    bus = bus_beside(world)
    add_late(bus, how(late_ms))
    assert exchanging_within(bus, S) < S


@pytest.mark.parametrize("how", [fixed, jittering])
@pytest.mark.parametrize(("cycle_ms", "late_ms"), [(10, 3), (20, 5), (20, 12), (40, 30), (80, 50)])
def test_in_a_fixed_cycle_a_look_takes_the_gap_and_nothing_else(
    world: WorldFactory, cycle_ms: int, late_ms: int, how: Callable[[int], Callable[[], int]]
) -> None:
    """The slave is later than 2 ms, but not than its gap: it is found, and no cycle is missed until then."""
    bus = bus_beside(world, cycle_ms * MS)
    add_late(bus, how(late_ms))
    bus.events.clear()
    while bus.state(6) is SlaveState.OFFLINE:
        assert bus.world.now < 2 * S, "never found"
        bus.run(MS)
    assert bus.master.cycles.missed == 0
    assert exchanging_within(bus, S) < S


def test_in_a_fixed_cycle_absent_slaves_cost_no_cycle_however_long_they_are_looked_for(world: WorldFactory) -> None:
    bus = bus_beside(world, 10 * MS)
    bus.run(10 * S)
    assert steps(bus.exchanges(5)) == {10 * MS}
    assert bus.master.cycles.missed == bus.master.window.forced == 0


def test_absent_slaves_are_looked_for_within_their_share(world: WorldFactory) -> None:
    """The first time each, then once in 5 s for both: 50 ms of slack, T_SL and a request, a hundred times that."""
    bus = bus_beside(world)
    bus.run(20 * S)
    starts = bus.exchanges(5)
    long = [before for before, after in itertools.pairwise(starts) if after - before > 40 * MS]
    assert max(after - before for before, after in itertools.pairwise(starts)) < 60 * MS
    later = [at for at in long if at > 2 * S]
    assert len(long) - len(later) == 2
    assert 3 <= len(later) <= 4
    assert min(after - before for before, after in itertools.pairwise(later)) > 5 * S
    polled = {a: [e for e in bus.requests(60) if e.octets[4] & 0x7F == a] for a in (6, 7)}
    assert all(len(polls) >= 20 for polls in polled.values())  # about once a second, as ever


@pytest.mark.parametrize(("patience", "late_ms"), [(HOST, 10), (measured(4 * MS), 15)])
def test_a_lost_late_slave_is_found_again(world: WorldFactory, patience: Patience, late_ms: int) -> None:
    """It comes back after 3 s: seven more polls, and the look of the one that is never there, come before it."""
    bus = bus_beside(world, patience=patience)
    late = add_late(bus, jittering(late_ms))
    exchanging_within(bus, 2 * S)
    bus.world.remove(late)
    bus.run(3 * S)
    assert bus.state(6) is SlaveState.OFFLINE
    add_late(bus, jittering(late_ms))
    exchanging_within(bus, 13 * S)


@LATE
def test_a_master_that_hears_late_finds_its_slaves(world: WorldFactory, late_ms: int) -> None:
    """On its own port: the answer that comes too late says that somebody is there."""
    w = world(referee=False)
    slaves = [mirror(address, P187) for address in (5, 6)]
    for station in slaves:
        w.add(station)
    master = Master(P187, (slave(5), slave(6)), MasterSettings(watchdog_ms=1000, absent_divisor=HOST.unknown_divisor))
    active = ActiveStation(P187, [master], patience=HOST, window=master.window)
    port = Late(active, fixed(late_ms))
    w.add(port)
    for order in (GoOnline(), SetMode(Mode.OPERATE)):
        w.command(port, order)
    w.run_for(2 * S)
    assert [h.state for h in master.handlers.values()] == [SlaveState.DATA_EXCHANGE] * 2
    timeouts = [active.stats.stations[address].timeouts for address in (5, 6)]
    assert max(timeouts) == (late_ms > 2)
