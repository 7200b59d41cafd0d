"""GAP polls, the time of a token hold, and what a slow port may cost."""

from __future__ import annotations

from itertools import pairwise

from ring_bus import ListUser, RingBus

from dpstack.fdl.active import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.events import StationFound
from dpstack.fdl.telegram import Req, StationType
from dpstack.fdl.user import Request
from dpstack.params import BusParams
from dpstack.phy.patience import ADAPTER, HOST
from dpstack.units import NS_PER_MS


def healed(bus: RingBus) -> bool:
    everybody = {station.address for station in bus.stations}
    return all(station.in_ring and station.las == everybody for station in bus.stations)


def test_gap_finds_a_slave_and_loses_it() -> None:
    bus = RingBus()
    station = bus.master(2, hsa=6)

    def slave(octets: bytes, now: int) -> tuple[int, bytes] | None:
        known = octets == bytes.fromhex("10 04 02 49 4F 16")
        return (11, bytes.fromhex("10 02 04 00 06 16")) if known else None

    bus.slaves[4] = slave
    bus.run(300 * NS_PER_MS)
    assert station.stations == {4: StationType.SLAVE}
    bus.slaves.clear()
    bus.run(300 * NS_PER_MS)
    assert station.stations == {}
    told = [(e.address, e.kind) for e in bus.told(StationFound) if isinstance(e, StationFound)]
    assert told == [(4, StationType.SLAVE), (4, None)]
    polls = [s.octets[1] for s in bus.log if s.octets[0] == 0x10 and s.sender == 2]
    assert polls[:6] == [3, 4, 5, 6, 0, 1]


def test_one_gap_poll_a_hold_after_the_traffic() -> None:
    bus = RingBus()
    user = ListUser(per_hold=[Request(9, Req.SDN_HIGH, b"\x01"), Request(9, Req.SDN_HIGH, b"\x02")])
    bus.master(2, user, hsa=20)
    bus.run(20 * NS_PER_MS)
    kinds = "".join({0xDC: "t", 0x10: "g", 0x68: "r"}[s.octets[0]] for s in bus.log[2:])
    assert kinds.startswith("rrgtrrgtrrgt")


def test_gap_off_sends_none() -> None:
    bus = RingBus()
    station = bus.master(2, gap=0)
    bus.run(50 * NS_PER_MS)
    assert station.stats.gap_polls == 0
    assert {s.octets[0] for s in bus.log} == {0xDC}


def test_an_unreadable_gap_answer_proves_nothing() -> None:
    bus = RingBus()
    station = bus.master(2, hsa=6)
    bus.slaves[4] = lambda octets, now: (11, bytes.fromhex("10 02 04 00 06 16"))
    bus.run(300 * NS_PER_MS)
    bus.drop = lambda sent: sent.sender == 4
    bus.run(500 * NS_PER_MS)
    assert station.stations == {4: StationType.SLAVE}
    assert len(bus.told(StationFound)) == 1


def test_the_host_is_patient_with_silence_only_so_long() -> None:
    bus = RingBus(mode="chunk")
    user = ListUser()
    station = bus.master(2, user, patience=HOST)
    bus.run(10_000 * NS_PER_MS)
    spent = station.stats.gap_polls * (2 * NS_PER_MS + bus.ns(200 + 11))
    assert spent < 10_000 * NS_PER_MS // 100 + 17 * 3 * NS_PER_MS


def test_absent_slaves_do_not_starve_the_gap() -> None:
    """Whoever polls absent slaves keeps to a share of its own: other masters are still found."""
    bus = RingBus(mode="chunk")
    user = ListUser()
    station = bus.master(2, user, patience=ADAPTER)
    polls = []
    for _ in range(30):
        user.high.append(Request(9, Req.SRD_HIGH, b"", 60, 62))
        bus.run(1000 * NS_PER_MS)
        polls.append(station.stats.gap_polls)
    assert len(user.results) == 30
    assert polls[29] - polls[9] >= 8


def test_a_lone_idle_master_on_a_real_port_keeps_one_slot_time_between_tokens() -> None:
    bus = RingBus(mode="chunk")
    bus.master(2, patience=HOST, gap=0)
    bus.run(100 * NS_PER_MS)
    gaps = {b.start - a.end for a, b in pairwise(bus.log[2:])}
    assert gaps == {bus.ns(200)}


def test_two_masters_on_slow_ports() -> None:
    bus = RingBus(mode="chunk")
    bus.master(2, patience=HOST, hsa=6)
    bus.master(5, patience=HOST, hsa=6)
    bus.run(3000 * NS_PER_MS)
    assert healed(bus)
    bus.kill(bus.stations[1])
    bus.run(1000 * NS_PER_MS)
    assert healed(bus)


def test_t_th_late_means_one_high_request_a_hold() -> None:
    bus = RingBus()
    user = ListUser()
    params = BusParams.preset(500_000, address=2, gap=1, hsa=6, t_tr=256)
    station = ActiveStation(params, [user])
    bus.stations.append(station)
    user.per_hold = [Request(9, Req.SDN_HIGH, bytes(60)), Request(9, Req.SDN_HIGH, bytes(60))]
    user.low = [Request(9, Req.SDN_LOW, bytes(1)) for _ in range(5)]
    bus.command(station, GoOnline())
    bus.run(50 * NS_PER_MS)
    # every rotation takes longer than T_TR, so each hold has one high-priority request, no low one, no GAP
    kinds = "".join({0xDC: "t", 0x10: "g", 0x68: "r"}[s.octets[0]] for s in bus.log[2:])
    assert "rtrtrtrtrtrt" in kinds
    assert "rr" not in kinds[3:]
    assert station.stats.gap_polls <= 1
    assert set(user.asked[4:]) == {True}


def test_t_tr_is_kept_by_two_masters() -> None:
    bus = RingBus()
    users = []
    for address in (2, 5):
        user = ListUser(low=[Request(9, Req.SDN_LOW, bytes(20)) for _ in range(3000)])
        users.append(user)
        params = BusParams.preset(500_000, address=address, t_tr=5_000, hsa=6)
        station = ActiveStation(params, [user])
        bus.stations.append(station)
        bus.command(station, GoOnline())
    bus.run(600 * NS_PER_MS)
    assert healed(bus)
    longest = 11 * 35 + 100  # a low-priority telegram begun at the last moment, each
    for station in bus.stations:
        assert station.token_rotation.count > 20
        assert station.last_rotation < bus.ns(5_000 + 2 * longest + 200)


def test_low_priority_does_not_starve_the_gap() -> None:
    bus = RingBus()
    endless = [Request(9, Req.SDN_LOW, bytes(20)) for _ in range(10_000)]
    station = bus.master(2, ListUser(low=endless), hsa=6, t_tr=2000)
    bus.run(200 * NS_PER_MS)
    assert station.stats.gap_polls >= 6
