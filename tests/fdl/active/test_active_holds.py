"""Token holds of an active station: who is asked when, what is refused or kept, how the token goes on."""

from __future__ import annotations

from itertools import pairwise

import pytest
from ring_bus import ListUser, RingBus, ring_of

from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.fdl.active.states import State
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import AttachUser, DetachUser, GoOffline, GoOnline
from dpstack.fdl.events import AddressCollision, RingLeft, StationFound, TokenLost
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, StationType, Telegram, token
from dpstack.machine import HeldUp, LineDown, LineUp, pump
from dpstack.params import BusParams
from dpstack.phy.patience import HOST, Patience
from dpstack.trace import Notice, Severity
from dpstack.units import NEVER, chars_to_ns
from tests.fdl.active.exchange_kit import DX, DX_ANSWER, Slave, bus_with

BIT = 2_000  # at 500 kbit/s; T_SL 200, T_ID1 37, T_ID2 100
MS = 1_000_000
SDN = Request(9, Req.SDN_HIGH, b"\x01")  # 10 octets
LOW = Request(9, Req.SDN_LOW, b"\x01")


# --- one slave at each end of the addresses -----------------------------------------------------------------------
@pytest.mark.parametrize("address", [0, 126])
def test_a_late_answer_of_the_first_and_the_last_address_is_recognised(address: int) -> None:
    """T_SL is 200 bits: the answer to the first request comes while the second one waits, before its own."""
    bus = RingBus(mode="chunk")
    delays = {1: 420, 2: 200}
    count = [0]

    def say(octets: bytes, now: int) -> tuple[int, bytes]:
        count[0] += 1
        body = bytes((2, address, 8, count[0]))
        return delays.get(count[0], 11), b"\x68\x04\x04\x68" + body + bytes((sum(body) & 0xFF, 0x16))

    bus.slaves[address] = say
    request = Request(address, Req.SRD_HIGH, b"\x01", retry=False)
    user = ListUser(high=[request] * 3)
    station = bus.master(2, user, gap=0, patience=Patience(known_ns=MS // 10, unknown_ns=MS // 10), run_ms=20)
    got = [o.data[0] if isinstance(o, Telegram) else None for o in user.outcomes]
    assert got == [None, 2, 3]
    assert station.stats.stations[address].late == 1


# --- the time of a hold ----------------------------------------------------------------------------------------------
def test_high_priority_once_after_t_th_and_low_priority_never() -> None:
    """T_TR of 256 bits is over with each token: one high-priority request, no low one, no GAP poll."""
    user = ListUser(per_hold=[SDN, SDN], low=[LOW])
    bus = ring_of(2, 5, hsa=6)
    bus.stations[0]._times.t_tr_ns = 0
    bus.stations[0]._users.attach(user)
    before = bus.stations[0].stats.gap_polls
    bus.run_ms(5)
    log = [s for s in bus.log if s.sender == 2 and s.octets[0] != 0x10][-10:]
    assert all(a.octets[0] != b.octets[0] for a, b in pairwise(log))
    assert bus.stations[0].stats.gap_polls == before
    assert set(user.asked) == {True}
    assert len(user.low) == 1


@pytest.mark.parametrize(("skipped", "first"), [(7, "low"), (8, "gap")])
def test_a_gap_poll_that_found_no_time_eight_times_goes_first(bus: RingBus, skipped: int, first: str) -> None:
    user = ListUser()
    station = bus.master(2, user, hsa=6)
    bus.until(station, State.PASS_TOKEN)
    user.low = [LOW] * 3
    user.asked.clear()
    station._gap.skipped = skipped
    station._gap.restart()
    seen = len(bus.log)
    bus.run_ms(1)
    # the token that was under way, then the first telegram of the hold
    kinds = [{0xDC: "token", 0x10: "gap", 0x68: "low"}[s.octets[0]] for s in bus.log[seen:]]
    assert kinds[:2] == ["token", first]
    assert user.asked[0] is (first == "gap")


def test_a_hold_without_time_for_a_gap_poll_counts_once(bus: RingBus) -> None:
    station = bus.master(2, hsa=6)
    bus.until(station, State.PASS_TOKEN)
    station._gap.restart()
    before = station._gap.skipped
    assert not station._poll.start(bus.now, bus.now)
    assert station._gap.skipped == before + 1


def test_rotations_are_measured_from_the_second_hold_on(bus: RingBus) -> None:
    station = bus.master(2, gap=0)
    bus.until(station, State.PASS_TOKEN)
    assert (station.token_rotation.count, station.stats.tokens) == (0, 1)
    bus.run_ms(1)
    assert station.token_rotation.count == station.stats.tokens - 1 > 3


def test_whether_the_station_is_alone_is_read_with_each_token() -> None:
    bus = ring_of(2, 5, hsa=6)
    a, b = bus.stations
    assert (a._hold.window.alone, b._hold.window.alone) == (False, False)
    bus.kill(b)
    bus.run_ms(100)
    assert a._hold.window.alone is True


# --- the guard -------------------------------------------------------------------------------------------------------
def test_the_guard_refuses_and_tells_each_reason_once(bus: RingBus) -> None:
    user = ListUser(high=[DX, SDN, DX, DX.replaced(da=4)])
    params = BusParams.preset(500_000, address=2, gap=0)

    def guard(request: Request) -> str | None:
        return None if request is SDN else f"no write to {request.da}"

    station = ActiveStation(params, [user], guard=guard)
    bus.stations.append(station)
    bus.command(station, GoOnline(), run_ms=10)
    assert user.outcomes == [Failure.REFUSED, SHORT_ACK, Failure.REFUSED, Failure.REFUSED]
    assert station.stats.refused == 3
    assert [(n.message, n.severity, n.source) for n in bus.events_of(Notice)] == [
        ("no write to 3", Severity.ERROR, "fdl"),
        ("no write to 4", Severity.ERROR, "fdl"),
    ]
    assert [n.t_ns for n in bus.events_of(Notice)] == [user.results[0][2], user.results[3][2]]
    assert {s.octets[0] for s in bus.log} == {0xDC, 0x68}
    assert sum(s.octets[0] == 0x68 for s in bus.log) == 1


# --- fixed cycles ----------------------------------------------------------------------------------------------------
def alone_and_passing_the_token() -> tuple[RingBus, ListUser, CycleWindow, ActiveStation]:
    """A lone station with a fixed cycle, in PASS_TOKEN."""
    bus = RingBus()
    user = ListUser()
    window = CycleWindow()
    station = ActiveStation(BusParams.preset(500_000, address=2, gap=0), [user], window=window)
    bus.stations.append(station)
    bus.command(station, GoOnline())
    bus.until(station, State.PASS_TOKEN)
    return bus, user, window, station


@pytest.mark.parametrize(("room_bits", "stays"), [(340, True), (341, False)])
def test_a_lone_station_keeps_the_token_for_a_cycle_that_is_due(room_bits: int, stays: bool) -> None:
    """It keeps it for T_SL and two tokens to itself (33 bits) with T_ID1 each: 200 + 2 x 70 bits."""
    bus, user, window, station = alone_and_passing_the_token()
    last_end = bus.log[-1].end + (37 + 33) * BIT  # of the token that waits for its gate
    assert bus.now < last_end - 33 * BIT
    window.begin(last_end + (37 + room_bits) * BIT)
    bus.run_until(last_end)
    kept = station.state.name == "USE_TOKEN"
    assert kept is stays
    if stays:
        assert station.wake_at() == window.next_at
        before = len(user.tokens)
        user.high = [SDN]
        window.begin(NEVER - 1)
        bus.run_until(last_end + (37 + room_bits) * BIT + 1)
        assert len(user.tokens) == before + 1
        assert bus.log[-1].start == last_end + (37 + room_bits) * BIT


def test_an_order_is_sent_at_once_in_a_hold_that_waits_for_its_cycle() -> None:
    bus, user, window, station = alone_and_passing_the_token()
    window.begin(bus.now + 300 * BIT)
    bus.until(station, State.USE_TOKEN)
    seen = len(bus.log)
    user.high = [SDN.replaced(cyclic=True)]
    bus.command(station, "mine")
    bus.run_bits(80)
    assert bus.log[seen].octets[0] == 0x68
    user.commands.clear()
    bus.command(station, "mine")  # in another state it changes nothing
    assert user.commands == ["mine"]


def test_a_request_that_runs_into_the_cycle_is_held_back() -> None:
    bus, user, station = bus_with(Slave(), DX)
    window = station._hold.window
    bus.until(station, State.CLAIM_TOKEN)
    window.begin(bus.now + 100 * BIT)
    bus.run_bits(90)
    assert user.outcomes == [Failure.HELD_BACK]
    assert window.held_back == 1
    user.high = [DX.replaced(cyclic=True)]
    bus.run_ms(5)
    assert user.starts[0][0].cyclic


# --- GAP polls -------------------------------------------------------------------------------------------------------
def gap_bus(
    answer: str | None, *, mode: str = "whole", delay: int = 11, gap: int = 10, t_tr: int = 5_000
) -> tuple[RingBus, ActiveStation]:
    bus = RingBus(mode=mode)
    if answer is not None:
        bus.slaves[3] = lambda octets, now: (delay, bytes.fromhex(answer))
    return bus, bus.master(2, hsa=3, gap=gap, t_tr=t_tr)


@pytest.mark.parametrize(
    ("answer", "delay", "stations", "late"),
    [
        ("10 02 03 00 05 16", 11, {3: StationType.SLAVE}, 0),
        ("10 02 03 10 15 16", 11, {3: StationType.MASTER_NOT_READY}, 0),
        ("10 02 03 00 05 16", 10, {}, 1),  # before min T_SDR
        ("10 02 00 00 02 16", 11, {}, 1),  # another station
        ("68 04 04 68 02 03 00 AA AF 16", 11, {}, 1),  # with data
        ("68 05 05 68 82 03 00 3C AA 6B 16", 11, {}, 1),
        ("e5", 11, {}, 0),
    ],
)
def test_the_answers_to_a_gap_poll(answer: str, delay: int, stations: dict[int, StationType], late: int) -> None:
    bus, station = gap_bus(answer, delay=delay)
    bus.until(station, State.AWAIT_STATUS_RESPONSE)
    bus.run_bits(230)
    assert station.stations == stations
    assert min(station.stats.late, 1) == late
    assert station.stats.stray == (1 if answer == "e5" else 0)
    assert [e.text for e in bus.events_of(StationFound)] == [
        f"station 3 found: {kind.text}" for kind in stations.values()
    ]


@pytest.mark.parametrize(("kind", "joins"), [("10 02 03 20 25 16", True), ("10 02 03 30 35 16", True)])
def test_a_ready_master_is_passed_the_token_next(kind: str, joins: bool) -> None:
    bus, station = gap_bus(kind)
    bus.until(station, State.AWAIT_STATUS_RESPONSE)
    bus.run_bits(66 + 11 + 66 + 60)
    assert (3 in station.las) is joins
    assert bus.log[-1].octets == b"\xdc\x03\x02"


def test_silence_in_the_gap_is_counted_and_charged() -> None:
    bus, station = gap_bus(None, mode="chunk", gap=1, t_tr=300)
    station.set_patience(Patience(unknown_ns=MS, known_ns=MS, unknown_divisor=10), bus.now)
    bus.run_ms(40)
    allowance = station._gap.allowance
    assert 16 <= station.stats.gap_polls < 22
    assert allowance._credit_ns < 16 * (211 * BIT + MS)
    polls = [s for s in bus.log if s.octets[0] == 0x10]
    assert {s.octets[1] for s in polls} == {0, 1, 3}


def test_a_poll_of_a_known_station_counts_as_a_failed_attempt() -> None:
    bus, station = gap_bus("10 02 03 00 05 16")
    bus.run_ms(30)
    bus.slaves.clear()
    for _ in range(9):
        station._peers.superfluous(3, bus.now)
    polls = station.stats.gap_polls
    while station.stations:
        bus.run_bits(10)
    bus.until(station, State.PASS_TOKEN)
    assert station._peers._odd[3].superfluous == 8
    assert station.stats.gap_polls > polls
    assert station._peers.due[3][0].function is Req.FDL_STATUS


@pytest.mark.parametrize(("slack_ns", "cycles", "late"), [(0, True, False), (MS, True, True), (MS, False, False)])
def test_a_silent_gap_address_may_answer_late_where_a_cycle_cuts_its_time_short(
    slack_ns: int, cycles: bool, late: bool
) -> None:
    bus, station = gap_bus(None, mode="chunk", gap=1, t_tr=300)
    station.set_patience(Patience(unknown_ns=slack_ns, known_ns=slack_ns), bus.now)
    if cycles:
        station._hold.window.begin(10**12)
    bus.run_ms(40)
    assert station.stats.gap_polls > 3
    assert bool(station._peers.due) is late


# --- passing the token on --------------------------------------------------------------------------------------------
def test_three_attempts_then_the_next_station_is_dropped() -> None:
    bus = ring_of(2, 5, 9, hsa=12)
    a, b, _ = bus.stations
    bus.until(a, State.CHECK_TOKEN_PASS)
    while bus.log[-1].octets != b"\xdc\x05\x02":
        bus.run_bits(1)
    bus.kill(b)
    first = len(bus.log) - 1
    bus.run_ms(4)
    sent = [s for s in bus.log[first:] if s.sender == 2][:4]
    assert [s.octets.hex() for s in sent] == ["dc0502"] * 3 + ["dc0902"]
    gaps = [(y.start - x.end) // BIT for x, y in pairwise(sent)]
    assert gaps == [200, 202, 200]  # the last repetition is set apart by TS bits
    assert a.stats.token_retries == 2
    assert a.las == {2, 9}


def test_noise_behind_the_pass_is_activity_and_its_silence_ends_the_hold() -> None:
    bus = ring_of(2, 5, hsa=6, mode="octets")
    a, b = bus.stations
    bus.until(a, State.CHECK_TOKEN_PASS)
    bus.kill(b)
    at = bus.now
    a.activity(at + BIT)
    assert a._machine.deadline == at + BIT + a._times.slot_known_ns
    a.telegram(Telegram(Kind.SD2, 2, 9, 0x08, data=b"\x00"), at + 2 * BIT)  # a late answer proves nothing
    assert (
        (a.state, a._passing_activity) == (State.CHECK_TOKEN_PASS, False) if hasattr(a, "_passing_activity") else True
    )
    assert a.stats.late == 1


@pytest.mark.parametrize(("high", "bits"), [([], 200), ([SDN], 100)])
def test_a_lone_master_without_requests_waits_a_slot_time_on_a_real_port(high: list[Request], bits: int) -> None:
    bus = RingBus(mode="chunk")
    user = ListUser(per_hold=list(high))
    bus.master(2, user, patience=HOST, gap=0, run_ms=400)
    tokens = [(a, b) for a, b in pairwise(bus.log[-30:]) if b.octets[0] == 0xDC]
    assert {b.start - a.end for a, b in tokens} == {bits * BIT}


def test_a_master_suddenly_alone_delays_its_tokens_by_its_address() -> None:
    bus = ring_of(4, 5, hsa=6)
    a, b = bus.stations
    bus.until(a, State.CHECK_TOKEN_PASS)
    bus.kill(b)
    bus.run_ms(30)
    own = [s for s in bus.log if s.octets == b"\xdc\x04\x04"]
    # a poll before each token: T_ID1 behind the silence is over, so only the delay shows after those without a poll
    assert len(own) > 7
    assert a._membership._staggered == 0


# --- leaving ---------------------------------------------------------------------------------------------------------
def test_an_order_to_leave_stops_repetitions_and_passes_the_token() -> None:
    slave = Slave(DX_ANSWER, None, None, None)
    bus, user, station = bus_with(slave, DX, DX, DX)
    while len(slave.heard) < 2:
        bus.run_bits(1)
    bus.command(station, GoOffline(), run_ms=5)
    assert station.state is State.OFFLINE
    assert len(slave.heard) == 2
    assert user.outcomes[1] is Failure.NO_ANSWER
    assert bus.events_of(RingLeft)[-1].reason == "ordered"
    assert not station._membership.leaving
    assert station._peers.due == {}


def test_a_station_that_stays_after_all_repeats_its_request() -> None:
    slave = Slave(DX_ANSWER, None, DX_ANSWER)
    bus, user, station = bus_with(slave, DX, DX)
    while len(slave.heard) < 2:
        bus.run_bits(1)
    bus.command(station, GoOffline())
    bus.command(station, GoOnline(), run_ms=5)
    assert len(slave.heard) == 3
    assert slave.heard[2] == slave.heard[1]
    assert user.outcomes[1] is not Failure.NO_ANSWER
    assert not bus.events_of(RingLeft)


@pytest.mark.parametrize("online", [True, False])
def test_a_line_that_comes_back_starts_the_station_only_if_it_was_online(online: bool) -> None:
    bus, _, station = bus_with(Slave(), DX, run_ms=10)
    assert station._peers.fcb.operational[3]
    if not online:
        bus.command(station, GoOffline(), run_ms=5)
    bus.command(station, LineDown("x"))
    assert station.state is State.OFFLINE
    if online:
        assert not any(station._peers.fcb.operational)
        bus.command(station, GoOnline())
    assert station.state is State.OFFLINE
    bus.command(station, LineUp())
    assert station.state is (State.LISTEN_TOKEN if online else State.OFFLINE)
    reasons = [e.reason for e in bus.events_of(RingLeft)]
    assert reasons == (["the line is down"] if online else ["ordered"])


# --- collision and back-off ------------------------------------------------------------------------------------------
def test_a_collision_keeps_the_station_out_for_ten_t_to(bus: RingBus) -> None:
    user = ListUser()
    station = bus.master(2, user, gap=0, run_ms=20)
    t_to = 10 * 200 * BIT
    own = Telegram(Kind.SD1, 9, 2, 0x49)
    bus.until(station, State.PASS_TOKEN)
    station.telegram(own, bus.now)
    bus.pump(station)
    assert station.state is State.LISTEN_TOKEN
    seen = len(bus.log)
    bus.run(11 * t_to - 40 * BIT)
    assert len(bus.log) == seen
    bus.run(t_to)
    assert len(bus.log) > seen
    assert len(bus.events_of(AddressCollision)) == 1
    assert [e.reason for e in bus.events_of(RingLeft)] == ["another station has the same address"]


def test_no_answer_to_a_status_request_during_the_back_off(bus: RingBus) -> None:
    station = bus.master(2, gap=0, run_ms=20)
    bus.until(station, State.PASS_TOKEN)
    station.telegram(Telegram(Kind.SD1, 9, 2, 0x49), bus.now)
    bus.pump(station)
    end = bus.now + 10 * 10 * 200 * BIT
    for at, answered in ((end - 1, False), (end, True)):
        station.telegram(Telegram(Kind.SD1, 2, 7, 0x49), at)
        assert (station._line.tx is not None) is answered


@pytest.mark.parametrize(("apart_t_to", "collides"), [(10, True), (11, False)])
def test_two_tokens_with_this_address_are_a_collision_within_ten_t_to(apart_t_to: int, collides: bool) -> None:
    bus = RingBus()
    station = bus.master(2, gap=0)
    t_to = 10 * 200 * BIT
    station.telegram(token(7, 2), 1_000)
    assert bus.events_of(AddressCollision) == []
    station.telegram(token(7, 2), 1_000 + apart_t_to * t_to)
    assert bool(station.take_events()) is collides


def test_masters_heard_while_listening_are_noted(bus: RingBus) -> None:
    station = bus.master(2, gap=0)
    for n, telegram in enumerate(
        (token(7, 5), token(5, 7), Telegram(Kind.SD1, 3, 7, 0x49), Telegram(Kind.SD1, 3, 9, 0x49))
    ):
        station.telegram(telegram, 1_000 * (n + 1))
    assert (set(station.stats.token_senders), set(station.stats.requesters)) == ({5, 7}, {7, 9})
    assert station.stats.without_token == [9]


def test_a_lost_token_is_reported_and_the_ring_is_kept() -> None:
    bus = ring_of(2, 5, hsa=6)
    a, b = bus.stations
    bus.until(a, State.ACTIVE_IDLE)
    bus.kill(b)
    bus.log.clear()
    bus.run_ms(5)
    assert [e.address for e in bus.events_of(TokenLost)] == [2]
    assert a.stats.tokens_lost == 1
    # two tokens to itself, then a GAP poll or the pass to the station that was there
    assert [s.octets.hex() for s in bus.log[:2]] == ["dc0202", "dc0202"]
    assert b"\xdc\x05\x02" in [s.octets for s in bus.log]


# --- requests to this station ----------------------------------------------------------------------------------------
def test_a_master_refuses_requests_and_answers_no_broadcasts() -> None:
    bus = ring_of(2, 5, hsa=6)
    a = bus.stations[0]
    bus.until(a, State.ACTIVE_IDLE)
    refusal = bytes.fromhex("10 07 02 33 3C 16")
    for fc, answer in (
        (0x4D, refusal),
        (0x43, refusal),
        (0x4E, refusal),
        (0x44, None),
        (0x46, None),
        (0x40, None),
        (0xC0, None),
    ):
        a.telegram(Telegram(Kind.SD2, 2, 7, fc, data=b"\x00"), bus.now)
        assert a._line.tx == answer
        a.telegram(Telegram(Kind.SD2, 9, 7, 0x4D, data=b"\x00"), bus.now)  # another master is sending
        assert a._line.tx is None


# --- users that come and go ------------------------------------------------------------------------------------------
def test_users_are_attached_and_detached_by_their_token() -> None:
    bus, _, station = bus_with(Slave(delay=60))
    late = ListUser(high=[DX])
    made: list[tuple[BusParams, Patience, int]] = []

    class Attach(AttachUser):
        def link_user(self, params: BusParams, patience: Patience, now: int) -> ListUser:
            made.append((params, patience, now))
            return late

    bus.run_ms(10)
    bus.command(station, Attach(token=7))
    assert made == [(station.params, station.patience, bus.now)]
    bus.until(station, State.AWAIT_DATA_RESPONSE)
    bus.command(station, DetachUser(token=8))
    bus.command(station, DetachUser(token=7), run_ms=5)
    assert late.results == []
    assert station.stats.stations[3].answers == 1
    bus.command(station, DetachUser(token=7))


# --- octets ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("count", "heard"), [(8, 8), (9, 2), (40, 2)])
def test_a_flood_of_acknowledgements_counts_as_stray(count: int, heard: int) -> None:
    station = ActiveStation(BusParams.preset(500_000, address=2, gap=0), [ListUser()])
    station.command(GoOnline(), 0)
    wire: list[bytes] = []
    station.wire = lambda entry: wire.append(entry.octets)
    station.receive(b"\xe5" * count, 10 * MS)
    assert (station.stats.heard, station.stats.stray) == (count, count)
    assert wire == [b"\xe5"] * heard


def test_an_edge_holds_the_queued_telegram_for_the_longest_telegram() -> None:
    station = ActiveStation(BusParams.preset(500_000, address=2, gap=0), [ListUser()])
    station.activity(5)
    assert station.wake_at() == NEVER  # offline
    station.command(GoOnline(), 0)
    due = pump(station, b"", 0, lambda octets, now: now)
    assert due == 10 * 200 * BIT
    station.activity(due)
    assert station.wake_at() == due + chars_to_ns(255, 500_000)
    station.telegram(token(7, 5), due + 3)
    assert station.wake_at() == due  # T_TO is over, but its activity is looked at
    station.wake(due)
    assert station.wake_at() == due + 3 + 10 * 200 * BIT


def test_damage_counts_for_the_station_that_is_asked() -> None:
    bus, _, station = bus_with(Slave(), DX, DX, mode="chunk")
    bus.drop = lambda sent: sent.sender == 3
    bus.run_ms(20)
    assert sum(station.stats.stations[3].bad.values()) > 0
    assert station.stats.stations.keys() == {3}


# --- orders while the token is elsewhere, and the times of events ----------------------------------------------------
def test_a_station_that_leaves_goes_offline_when_it_loses_the_token() -> None:
    """The order comes in a hold; then another station sends with this address."""
    bus, user, station = bus_with(Slave(delay=150), DX)
    bus.until(station, State.AWAIT_DATA_RESPONSE)
    bus.command(station, GoOffline())
    station.telegram(Telegram(Kind.SD1, 9, 2, 0x49), bus.now)
    bus.pump(station)
    assert station.state is State.OFFLINE
    assert not station._membership.leaving
    assert user.outcomes == [Failure.ABANDONED]
    assert [(e.t_ns, e.reason) for e in bus.events_of(RingLeft)] == [(bus.now, "another station has the same address")]


@pytest.mark.parametrize("what", ["telegram", "edge"])
def test_a_pass_between_others_is_repeated_in_vain_only_without_a_telegram_between(what: str) -> None:
    """5 passes the token to 9 twice, then to 2, whose predecessor is 9: its ring has changed."""
    bus = ring_of(2, 5, 9, hsa=12)
    a = bus.stations[0]
    bus.until(a, State.ACTIVE_IDLE)
    bus.stations[1:] = []
    a.telegram(token(9, 5), bus.now + 1)
    if what == "telegram":
        a.telegram(Telegram(Kind.SD1, 9, 7, 0x08), bus.now + 2)
    else:
        a.activity(bus.now + 2)
    a.telegram(token(9, 5), bus.now + 3)
    a.telegram(token(2, 5), bus.now + 4)
    assert (a.state is State.ACTIVE_IDLE) is (what == "telegram")


def test_held_up_reaches_the_users() -> None:
    taken: list[tuple[object, int]] = []

    class Old(ListUser):
        def command(self, command: object, now: int) -> bool:
            taken.append((command, now))
            return len(taken) > 1

    station = ActiveStation(BusParams.preset(500_000, address=2, gap=0), [Old(), Old()])
    gap = HeldUp(1, "x")
    assert station.held_up(gap, 77)
    assert taken == [(gap, 77), (gap, 77)]


@pytest.mark.parametrize("known", [True, False])
def test_damage_in_a_gap_poll_counts_for_a_known_station_only(known: bool) -> None:
    bus, station = gap_bus("10 02 03 00 05 16", mode="chunk", gap=1, t_tr=300)
    if known:
        bus.run_ms(20)
    bus.drop = lambda sent: sent.sender == 3
    bus.run_ms(20)
    assert station.stats.stations.keys() == ({3} if known else set())
    if known:
        assert sum(station.stats.stations[3].bad.values()) > 0


@pytest.mark.parametrize(("late_ns", "asked"), [(MS, False), (MS + 1, True)])
def test_a_request_older_than_a_millisecond_is_asked_whether_it_is_still_good(late_ns: int, asked: bool) -> None:
    calls: list[int] = []

    def still(now: int) -> bool:
        calls.append(now)
        return True

    bus, _, station = bus_with(Slave(), DX.replaced(still=still))
    bus.until(station, State.USE_TOKEN)
    made_at = station._exchange.made_at
    station.take_tx(made_at + late_ns)
    assert calls == ([made_at + late_ns] if asked else [])


def test_an_acknowledgement_before_the_first_request_counts_for_nobody(bus: RingBus) -> None:
    station = bus.master(2, gap=0, run_ms=50)
    assert station.in_ring
    for _ in range(20):
        bus.run(100 * BIT)
        station.telegram(SHORT_ACK, bus.now)
    assert station.stats.stray > 0
    assert station.stats.stations == {}
