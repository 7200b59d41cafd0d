"""GAP polls, the time of a token hold, and what a slow port may cost."""

from __future__ import annotations

from itertools import pairwise

import pytest
from ring_bus import ListUser, RingBus, ring_of

from dpstack.fdl.events import StationFound
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import Req, StationType
from dpstack.phy.patience import ADAPTER, HOST, Patience
from dpstack.units import NS_PER_MS


def test_gap_finds_a_slave_and_loses_it(bus: RingBus) -> None:
    station = bus.master(2, hsa=6)

    def slave(octets: bytes, now: int) -> tuple[int, bytes] | None:
        known = octets == bytes.fromhex("10 04 02 49 4F 16")
        return (11, bytes.fromhex("10 02 04 00 06 16")) if known else None

    bus.slaves[4] = slave
    bus.run_ms(300)
    assert station.stations == {4: StationType.SLAVE}
    bus.slaves.clear()
    bus.run_ms(300)
    assert station.stations == {}
    told = [(e.address, e.kind) for e in bus.events_of(StationFound)]
    assert told == [(4, StationType.SLAVE), (4, None)]
    polls = [s.octets[1] for s in bus.log if s.octets[0] == 0x10 and s.sender == 2]
    assert polls[:6] == [3, 4, 5, 6, 0, 1]


def test_one_gap_poll_a_hold_after_the_traffic(bus: RingBus) -> None:
    user = ListUser(per_hold=[Request(9, Req.SDN_HIGH, b"\x01"), Request(9, Req.SDN_HIGH, b"\x02")])
    bus.master(2, user, hsa=20, run_ms=20)
    kinds = "".join({0xDC: "t", 0x10: "g", 0x68: "r"}[s.octets[0]] for s in bus.log[2:])
    assert kinds.startswith("rrgtrrgtrrgt")


def test_an_unreadable_gap_answer_proves_nothing(bus: RingBus) -> None:
    station = bus.master(2, hsa=6)
    bus.slaves[4] = lambda octets, now: (11, bytes.fromhex("10 02 04 00 06 16"))
    bus.run_ms(300)
    bus.drop = lambda sent: sent.sender == 4
    bus.run_ms(500)
    assert station.stations == {4: StationType.SLAVE}
    assert len(bus.events_of(StationFound)) == 1


@pytest.mark.parametrize(
    ("hsa", "baud", "patience", "unknown_ms", "percent"),
    [
        # a silent poll on a pty takes 2 ms and 111 bit times, 2.592 ms: 126 of them in 3 s would be 10.9 %
        (126, 187_500, HOST, 2, 10),
        # 60 x 2.592 ms in 3 s
        (60, 187_500, HOST, 2, 5.2),
        # 6 x 2.592 ms in 3 s would be 0.5 %: no need to dawdle
        (6, 187_500, HOST, 2, 1),
        (126, 500_000, ADAPTER, 20, 10),
        # 20 x 31.563 ms in 3 s would be 21 %
        (20, 9_600, ADAPTER, 20, 10),
    ],
)
def test_a_pass_over_the_gap_takes_3_s_and_1_to_10_percent(
    hsa: int, baud: int, patience: Patience, unknown_ms: int, percent: float
) -> None:
    """The account starts with 16 polls; between two passes are G x T_TR."""
    bus = RingBus(baud, mode="chunk")
    station = bus.master(2, patience=patience, hsa=hsa, run_ms=12_000)
    t_sl = 200 if baud == 500_000 else 100
    silent = unknown_ms * NS_PER_MS + bus.ns(t_sl + 11)
    spent = station.stats.gap_polls * silent / 120_000_000  # percent of 12 s
    extra = 16 * silent / 120_000_000
    assert 0.85 * percent < spent < 1.03 * percent + extra


def test_a_gap_that_grows_is_polled_faster_at_once() -> None:
    """A master left in the middle of a pass: the pass goes on as fast as its new length needs."""
    bus = ring_of(2, 5, baud=187_500, mode="chunk", patience=HOST, ms=8_000)
    station, other = bus.stations
    bus.kill(other)
    bus.run_ms(1_000)
    before = station.stats.gap_polls
    bus.run_ms(3_300)
    assert station.stats.gap_polls - before > 110


@pytest.mark.parametrize("address", [3, 64, 125])
def test_a_second_master_is_in_the_ring_after_one_pass(address: int) -> None:
    """187.5 kbit/s on ptys, HSA 126: T_GUD of 267 ms, a pass of 126 x 2.592 ms / 10 %, a few rotations."""
    bus = RingBus(187_500, mode="chunk")
    bus.master(2, patience=HOST)
    for _ in range(4):
        bus.run_ms(4_700)
        newcomer = bus.master(address, patience=HOST)
        start = bus.now
        while not newcomer.in_ring:
            bus.run_ms(10)
            assert bus.now - start < (267 + 3_266 + 100) * NS_PER_MS
        bus.run_ms(100)
        bus.kill(newcomer)


def test_absent_slaves_do_not_starve_the_gap() -> None:
    """Whoever polls absent slaves keeps to a share of its own: other masters are still found."""
    bus = RingBus(mode="chunk")
    user = ListUser()
    station = bus.master(2, user, patience=ADAPTER)
    polls = []
    for _ in range(30):
        user.high.append(Request(9, Req.SRD_HIGH, b"", 60, 62))
        bus.run_ms(1000)
        polls.append(station.stats.gap_polls)
    assert len(user.results) == 30
    assert polls[29] - polls[9] >= 8


def test_a_lone_idle_master_on_a_real_port_keeps_one_slot_time_between_tokens() -> None:
    bus = RingBus(mode="chunk")
    bus.master(2, patience=HOST, gap=0, run_ms=200)
    gaps = {b.start - a.end for a, b in pairwise(bus.log[2:])}
    assert gaps == {bus.ns(200)}


def test_two_masters_on_slow_ports() -> None:
    bus = ring_of(2, 5, mode="chunk", patience=HOST, hsa=6, ms=3000)
    bus.kill(bus.stations[1])
    bus.run_ms(1000)
    assert bus.healed


def test_low_priority_does_not_starve_the_gap(bus: RingBus) -> None:
    endless = [Request(9, Req.SDN_LOW, bytes(20)) for _ in range(10_000)]
    station = bus.master(2, ListUser(low=endless), hsa=6, t_tr=2000, run_ms=200)
    assert station.stats.gap_polls >= 6
