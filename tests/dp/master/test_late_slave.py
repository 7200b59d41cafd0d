"""A slave that hears late, because it is simulated on a busy computer or stands behind a slow adapter, is found.

It answers no request that has another one behind it, so it has to be waited for: with every so many polls.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from typing import Any

import pytest
from bus_kit import IDENT, PPO1, mirror
from slave_kit import make_slave
from support import MS, S, WorldFactory

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import BusStation
from dpstack.params import BusParams
from dpstack.phy.patience import HOST, Patience, measured
from dpstack.sim.adapter import Adapter
from dpstack.units import NEVER
from tests.dp.master.cycle_kit import CycleBus, slave, steps

P187 = BusParams.preset(187_500, address=2, gap=0)
LATE = pytest.mark.parametrize("late_ms", [2, 3, 5, 10, 20, 35, 48, 50])


class Late(Adapter):
    """A station whose computer looks at its port ``lateness()`` ns after the first octet that it has not read."""

    def __init__(self, station: BusStation, lateness: Callable[[], int]) -> None:
        super().__init__(station)
        self._lateness = lateness
        self._looks_at = NEVER

    def receive(self, chunk: bytes, now: int) -> None:
        if not self._fifo:
            self._looks_at = now + self._lateness()
        super().receive(chunk, now)

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
