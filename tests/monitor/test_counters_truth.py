"""Counters of a listening station against the world's own account: exact where every transmission arrives intact.

The account (``wire_truth``) is made of the wire log. The masters' and the slaves' own statistics are a third count.
"""

from __future__ import annotations

import pytest
from bus_kit import SimBus, setup
from support import MS, S
from wire_truth import Truth, truth_of

from dpstack.capture.listener import Listener
from dpstack.dp.master.events import SlaveState
from dpstack.monitor.counters import MAX_DEPTH, Change, Counters, State
from dpstack.params import BusParams
from dpstack.sim.faults import Which
from dpstack.sim.world import World

PARAMS = BusParams.preset(500_000, address=2, gap=2, hsa=12)


#: one octet each way: the answer is shorter than T_SL, so that its sender hears the repetition
SHORT = bytes.fromhex("10 20")


class Watched:
    """A world with a monitor in it from the first telegram on."""

    def __init__(self, seed: int = 1, baud: int = 500_000, *, referee: bool = False) -> None:
        self.world = World(seed=seed, keep=1_000_000, referee=referee)
        self.changes: list[Change] = []
        self.counters = Counters(self.changes.append)
        self.world.add(Listener(0, self.counters.add, baud=baud), name="listener")

    def run(self, ns: int) -> None:
        self.world.run_for(ns)

    def truth(self) -> Truth:
        """The world's account up to now; nothing is on the wire at this moment."""
        while self.world.log and list(self.world.log)[-1].end_ns > self.world.now:
            self.world.step()
        return truth_of(self.world.log)

    def check(self) -> Truth:
        """Every counter is the world's."""
        truth, counters = self.truth(), self.counters
        assert (counters.telegrams, counters.octets) == (truth.telegrams, truth.octets)
        assert (counters.damaged, counters.unattributed, counters.strays) == ({}, 0, 0)
        stations = counters.stations
        assert {a: s.requests for a, s in stations.items() if s.requests} == dict(truth.requests)
        for address, one in stations.items():
            assert (one.answers, one.no_answer, one.damaged) == (truth.answers[address], truth.no_answer[address], 0)
            assert (one.late, one.rs, one.rr) == (truth.late[address], truth.rs[address], truth.rr[address])
            assert one.repetitions == truth.repetitions[address]
            assert one.repeated_polls == truth.repeated_polls[address]
            depth = [truth.depth[address, number + 1] for number in range(MAX_DEPTH)]
            assert one.retry_depth == depth
            assert one.requests == one.answers + one.no_answer + (truth.open == address)
            assert one.answer_ns.count == one.answers
        assert (None if counters.asked is None else counters.asked.address) == truth.open
        masters = counters.masters
        assert {a: m.tokens for a, m in masters.items() if m.tokens} == dict(truth.tokens)
        assert {a: m.gap_polls for a, m in masters.items() if m.gap_polls} == dict(truth.status_polls)
        return truth


def of(sender: str) -> Which:
    """Selects the Data_Exchange answers of a station."""
    return lambda tx: tx.sender == sender and tx.octets[0] == 0x68 and tx.octets[4] < 0x80


@pytest.mark.parametrize("max_retry", range(9))
def test_answers_that_get_lost_are_counted_by_depth(max_retry: int) -> None:
    w = Watched()
    slaves = [setup(5, config=SHORT), setup(6)]
    bus = SimBus(w.world, PARAMS.replace(max_retry=max_retry), slaves, silent=[6], watchdog_ms=5_000)
    w.world.run(S, lambda: bus.state(5) is SlaveState.DATA_EXCHANGE)
    w.run(20 * MS)
    for number in range(1, max_retry + 1):
        w.world.faults.drop(of("5"), times=number)
        w.run(20 * MS)
    w.check()
    station = w.counters.stations[5]
    assert station.retry_depth == [int(number < max_retry) for number in range(MAX_DEPTH)]
    assert (station.lost, station.syncs, station.state) == (0, 1, State.DATA_EXCHANGE)
    # the master and the slave counted the same
    asked, slave = bus.station.stats.stations[5], bus.slaves[5].stats
    assert station.repetitions == asked.retries == slave.repeats
    assert station.requests == slave.requests + slave.repeats + slave.status
    # one more: the master's exchange is lost, and begins anew
    w.world.faults.drop(of("5"), times=max_retry + 1)
    w.run(200 * MS)
    w.check()
    assert (station.lost, station.syncs, station.state) == (1, 2, State.DATA_EXCHANGE)
