"""The token ring on a wire: gaps, joining, leaving, losing and claiming the token, GAP, collisions."""

from __future__ import annotations

from itertools import pairwise

import pytest
from ring_bus import ListUser, RingBus, Sent, fixed, ring_of

from dpstack.errors import UsageError
from dpstack.fdl.active.states import (
    ACTIVE_IDLE,
    AWAIT_DATA_RESPONSE,
    CHECK_TOKEN_PASS,
    CLAIM_TOKEN,
    LISTEN_TOKEN,
    State,
)
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.fdl.events import AddressCollision, MasterSeen, RingJoined, RingLeft, StationFound
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, Telegram, token
from dpstack.machine import LineDown, LineUp
from dpstack.params import BusParams
from dpstack.trace import WireEntry
from dpstack.units import BAUD_RATES, NS_PER_MS

MODES = ["whole", "octets", "chunk"]


def in_state(station: ActiveStation, state: State) -> bool:
    return station.state is state


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_a_lone_master_keeps_exact_gaps(baud: int) -> None:
    bus = RingBus(baud)
    station = bus.master(2, gap=0)
    p = station.params
    bus.run_bits(p.t_to + 20_000)
    assert len(bus.log) > 50
    assert all(sent.octets == b"\xdc\x02\x02" for sent in bus.log)
    assert bus.log[0].start == bus.ns(p.t_to)
    gaps = {b.start - a.end for a, b in pairwise(bus.log)}
    assert gaps == {bus.ns(p.t_id1)}
    rotation = station.token_rotation.max_ns
    assert abs(rotation - bus.ns(33 + p.t_id1)) <= 1
    assert station.token_rotation.min_ns == rotation
    assert station.stats.tokens == len(bus.log) - 1  # two tokens claim one hold


def test_a_master_listens_for_t_to_first(bus: RingBus) -> None:
    station = bus.master(9, gap=0, online=False)
    bus.run_ms(50)
    assert station.state is State.OFFLINE
    assert bus.log == []
    start = bus.now
    bus.command(station, GoOnline(), run_ms=50)
    assert bus.log[0].start == start + bus.ns((6 + 2 * 9) * 200)


@pytest.mark.parametrize("mode", MODES)
def test_two_masters_find_each_other(mode: str) -> None:
    bus = ring_of(2, 5, mode=mode, ms=200)
    bus.run_ms(50)
    joined = bus.events_of(RingJoined)
    assert [(e.address, e.claimed, e.masters) for e in joined] == [(2, True, (2,)), (5, False, (2, 5))]
    assert not any(sent.garbled for sent in bus.log)
    # exactly one holder at any time: tokens alternate
    tail = [s.octets for s in bus.log if s.octets[0] == 0xDC][-20:]
    assert set(tail) == {b"\xdc\x05\x02", b"\xdc\x02\x05"}
    assert all(a != b for a, b in pairwise(tail))


def test_the_modes_of_hearing_do_the_same() -> None:
    logs = []
    for mode in MODES:
        bus = ring_of(2, 5, 9, mode=mode, hsa=12)
        bus.run_ms(100)
        logs.append([(s.start, s.octets) for s in bus.log])
    assert logs[0] == logs[1] == logs[2]


def test_the_token_goes_up_and_wraps() -> None:
    bus = ring_of(9, 2, 5, hsa=12, ms=400)
    tokens = [s.octets.hex() for s in bus.log if s.octets[0] == 0xDC][-6:]
    start = tokens.index("dc0502")
    assert tokens[start : start + 3] == ["dc0502", "dc0905", "dc0209"]


def test_a_newcomer_says_not_ready_until_it_knows_the_ring(bus: RingBus) -> None:
    bus.master(2, hsa=6, run_ms=3)
    bus.master(3, hsa=6, run_ms=300)
    answers = [s.octets.hex(" ") for s in bus.log if s.octets[0] == 0x10 and s.sender == 3]
    ready = answers.index("10 02 03 20 25 16")
    assert all(a == "10 02 03 10 15 16" for a in answers[:ready])
    assert bus.healed


def test_a_newcomer_does_not_say_that_a_master_joined_which_was_there_before(bus: RingBus) -> None:
    first = bus.master(2, hsa=6, run_ms=100)
    assert first.in_ring
    bus.events.clear()
    second = bus.master(5, hsa=6, run_ms=300)
    assert second.in_ring
    assert sorted(e.text for e in bus.events_of(MasterSeen)) == [
        "master 2 is in the token ring",  # told by station 5
        "master 5 joined the token ring",  # told by station 2
    ]
    bus.master(4, hsa=6)
    bus.events.clear()
    bus.run_ms(300)
    texts = [e.text for e in bus.events_of(MasterSeen)]
    assert texts.count("master 4 joined the token ring") == 2


def test_leaving_hands_the_token_on() -> None:
    bus = ring_of(2, 5, hsa=6)
    a, b = bus.stations
    bus.until(a, State.USE_TOKEN, State.PASS_TOKEN)
    bus.command(a, GoOffline(), run_ms=20)
    assert a.state is State.OFFLINE
    assert b.stats.tokens_lost == 0
    assert b.las == {5}
    assert [e.text for e in bus.events_of(RingLeft)] == ["station 2 left the token ring: ordered"]
    assert MasterSeen(t_ns=0, address=2, present=False).text in [e.text for e in bus.events_of(MasterSeen)]
    bus.command(a, GoOnline(), run_ms=500)
    assert bus.healed


@pytest.mark.parametrize("mode", MODES)
def test_one_lost_token_is_repeated(mode: str) -> None:
    bus = ring_of(2, 5, 9, mode=mode, hsa=12)
    _, a, b = bus.stations
    lost: list[Sent] = []

    def drop(sent: Sent) -> bool:
        if not lost and sent.octets == b"\xdc\x09\x05":
            lost.append(sent)
            bus.deaf.add(b)
            bus.at(sent.end + 1, lambda: bus.deaf.discard(b))
        return False

    bus.drop = drop
    bus.run_ms(20)
    retry = next(s for s in bus.log if s.start > lost[0].start)
    assert retry.octets == b"\xdc\x09\x05"
    assert retry.start - lost[0].end == bus.ns(200)
    assert a.stats.token_retries == 1
    assert bus.healed


def test_noise_after_the_pass_is_taken_for_activity() -> None:
    bus = ring_of(2, 5, hsa=6)
    bus.run_ms(100)
    a, b = bus.stations
    bus.until(a, State.CHECK_TOKEN_PASS)
    bus.kill(b)
    bus.at(bus.now + bus.ns(40), lambda: bus._say(b"\xe5", 99))
    bus.run_bits(100)
    assert a.state is State.ACTIVE_IDLE
    assert a.stats.stray == 1
    bus.run_ms(20)
    assert bus.healed
    assert a.stats.tokens_lost == 1


def test_garbage_after_the_pass_gets_one_more_slot_time() -> None:
    bus = ring_of(2, 5, mode="octets", hsa=6)
    a, b = bus.stations
    bus.until(a, State.CHECK_TOKEN_PASS)
    bus.kill(b)
    bus.at(bus.now + bus.ns(40), lambda: bus._say(b"\x00", 99))
    bus.run_bits(100)
    assert in_state(a, State.CHECK_TOKEN_PASS)
    bus.run_bits(200)
    assert in_state(a, State.ACTIVE_IDLE)
    bus.run_ms(20)
    assert bus.healed


def test_a_master_passed_over_listens_again() -> None:
    bus = ring_of(2, 5, 9, hsa=12)
    a, b, _ = bus.stations
    bus.until(a, State.PASS_TOKEN)
    bus.deaf.add(b)  # b misses what a does and is dropped
    bus.run_ms(3)
    assert a.las == {2, 9}
    bus.deaf.clear()
    bus.run_ms(1)
    assert b.state is State.LISTEN_TOKEN
    assert len(bus.events_of(RingLeft)) == 1
    bus.run_ms(500)
    assert bus.healed


def test_one_damaged_token_is_no_collision() -> None:
    bus = ring_of(2, 5, hsa=6)
    b = bus.stations[1]
    bus.until(b, State.ACTIVE_IDLE)
    b.telegram(token(2, 5), bus.now)
    bus.run_ms(20)
    assert bus.events_of(AddressCollision) == []
    assert bus.healed


def test_a_token_with_an_impossible_address_is_noise() -> None:
    bus = ring_of(2, 5, hsa=6)
    b = bus.stations[1]
    bus.until(b, State.ACTIVE_IDLE)
    for da, sa in ((127, 2), (126, 2), (5, 126)):
        b.telegram(token(da, sa), bus.now)
    assert b.las == {2, 5}


def test_line_down_and_up(bus: RingBus) -> None:
    user = ListUser(per_hold=[Request(9, Req.SRD_HIGH)])
    station = bus.master(2, user, gap=0, run_ms=10)
    bus.until(station, State.AWAIT_DATA_RESPONSE)
    bus.command(station, LineDown("unplugged"))
    assert station.state is State.OFFLINE
    assert user.outcomes[-1] is Failure.ABANDONED
    count = len(bus.log)
    bus.run_ms(100)
    bus.command(station, GoOnline(), run_ms=100)
    assert len(bus.log) == count
    bus.command(station, LineUp(), run_ms=10)
    assert station.in_ring
    bus.command(station, GoOffline(), run_ms=10)
    bus.command(station, LineDown("again"))
    bus.command(station, LineUp())
    assert station.state is State.OFFLINE


def test_going_offline_waits_for_the_answer_under_way(bus: RingBus) -> None:
    user = ListUser(high=[Request(9, Req.SRD_HIGH)])
    station = bus.master(2, user, gap=0)
    bus.slaves[9] = lambda octets, now: (60, b"\xe5")
    bus.until(station, State.AWAIT_DATA_RESPONSE)
    user.high.append(Request(9, Req.SRD_HIGH))
    bus.command(station, GoOffline(), run_ms=10)
    assert station.state is State.OFFLINE
    assert len(user.outcomes) == 1
    assert not isinstance(user.outcomes[0], Failure)


def test_commands_ticks_and_events_of_users(bus: RingBus) -> None:
    first, second = ListUser(), ListUser(at=7 * NS_PER_MS)
    station = bus.master(2, first, second, gap=0)
    bus.command(station, "mine")
    assert first.commands == ["mine"]
    with pytest.raises(UsageError, match="nobody on this bus takes the command 'not mine'"):
        station.command("not mine", bus.now)
    first.events.append(StationFound(t_ns=1, address=1, kind=None))
    bus.run_ms(10)
    assert second.ticks == [7 * NS_PER_MS]
    assert len(bus.events_of(StationFound)) == 1
    assert first.tokens == second.tokens


def test_the_wire_tap_gets_every_telegram(bus: RingBus) -> None:
    heard: list[WireEntry] = []
    a = bus.master(2, hsa=6)
    a.wire = heard.append
    bus.master(5, hsa=6, run_ms=100)
    assert [(e.start_ns, e.end_ns, e.octets, e.sender) for e in heard] == [
        (s.start, s.end, s.octets, str(s.sender)) for s in bus.log if s.end <= heard[-1].end_ns
    ]


@pytest.mark.parametrize("count", [4, 8])
def test_many_masters_start_at_once(count: int) -> None:
    bus = ring_of(*range(0, 3 * count, 3), baud=1_500_000, hsa=3 * count, ms=500)
    bus.run_ms(50)
    assert not any(sent.garbled for sent in bus.log)


def test_a_master_answers_rs_to_a_request() -> None:
    bus = ring_of(2, 5, hsa=6)
    a = bus.stations[0]
    bus.until(a, State.ACTIVE_IDLE)
    bus.stations.pop()
    bus._say(bytes.fromhex("68 05 05 68 82 85 6D 3C 3E EE 16"), 5)
    bus.run_bits(11 * 11 + 80)
    assert bus.log[-1].octets.hex(" ") == "10 05 02 33 3a 16"
    assert bus.log[-1].start - bus.log[-2].end == bus.ns(11)


# --- States without the token: late answers, the end of a silence, a token that goes past; and known stations asked


TO_4, SLAVE_4 = "10 04 02 49 4F 16", "10 02 04 00 06 16"


@pytest.fixture
def station() -> ActiveStation:
    station = ActiveStation(BusParams.preset(500_000, address=2, gap=0), [ListUser()])
    station.command(GoOnline(), 0)
    return station


@pytest.mark.parametrize("known", [True, False])
def test_the_silence_of_a_station_that_the_gap_knows_is_waited_for(bus: RingBus, known: bool) -> None:
    if known:
        bus.slaves[4] = fixed(TO_4, SLAVE_4)
    user = ListUser()
    station = bus.master(2, user, gap=1, hsa=5, t_tr=300, run_ms=100)
    assert (4 in station.stations) is known
    user.low = [Request(4, Req.FDL_STATUS, retry=False)]
    bus.run_ms(5)
    ((request, _, _),) = user.results
    assert request.patient is known


def test_a_late_answer_is_no_longer_due(station: ActiveStation) -> None:
    peers = station._peers
    for address in (4, 5):
        peers.expect_late(Request(address, Req.SRD_HIGH, b"\x01"), 0, 10**6)
    station._exchange.late(Telegram(Kind.SD2, 2, 4, 8, data=b"\x07"), 1_000)
    assert set(peers.due) == {5}
    assert station.stats.stations[4].late == 1


@pytest.mark.parametrize(
    ("in_ring", "state", "asked", "counts"),
    [
        (True, AWAIT_DATA_RESPONSE, 4, True),
        (True, ACTIVE_IDLE, 4, False),
        (False, LISTEN_TOKEN, 4, False),
        (False, CLAIM_TOKEN, 4, False),
        (True, AWAIT_DATA_RESPONSE, 127, False),
    ],
)
def test_an_acknowledgement_is_that_of_the_station_asked_while_the_token_is_here(
    station: ActiveStation, in_ring: bool, state: State, asked: int, counts: bool
) -> None:
    station._membership.in_ring = in_ring
    station._machine.enter(state)
    station._exchange._asked_da = asked
    station._exchange.late(SHORT_ACK, 1_000)
    assert set(station._peers._odd) == ({4} if counts else set())
    assert station.stats.stray == 1


@pytest.mark.parametrize(("late_ns", "state"), [(0, CLAIM_TOKEN), (1, LISTEN_TOKEN)])
def test_t_to_begins_anew_behind_an_edge_that_outlasts_it(station: ActiveStation, late_ns: int, state: State) -> None:
    """T_TO of station 2 is ten slot times of 200 bits: 4 ms."""
    assert station.wake_at() == 4_000_000
    station._line.busy_until = 4_000_000 + late_ns
    station._machine.timeout(4_000_000)
    assert station.state is state
    if late_ns:
        assert station._machine.deadline == 8_000_000 + late_ns


def test_a_token_that_goes_past_says_who_passed_it_to_whom(bus: RingBus) -> None:
    station = bus.master(2, gap=0, run_ms=50)
    assert station.in_ring
    station.telegram(token(5, 1), bus.now)
    (left,) = [event for event in station.take_events() if isinstance(event, RingLeft)]
    assert (left.address, left.reason) == (2, "station 1 passed the token over us to 5")
    assert left.text == "station 2 left the token ring: station 1 passed the token over us to 5"
    assert station.state is LISTEN_TOKEN


def test_an_acknowledgement_behind_a_pass_counts_as_stray_and_shows_a_master(station: ActiveStation) -> None:
    station.stats.stray = 3
    station._machine.enter(CHECK_TOKEN_PASS)
    station.telegram(SHORT_ACK, 1_000)
    assert (station.stats.stray, station.state) == (4, ACTIVE_IDLE)


def test_another_deadline_does_not_end_a_telegram_that_is_arriving(station: ActiveStation) -> None:
    station.receive(b"\xdc\x02", 100_000)
    station.wake(110_000)
    station.receive(b"\x03", 122_000)
    assert (station.stats.heard, station.decoder_stats.telegrams) == (1, 1)
