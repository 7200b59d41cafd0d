"""States without the token: late answers, the end of a silence, a token that goes past; and known stations asked."""

from __future__ import annotations

import pytest
from ring_bus import ListUser, RingBus, fixed

from dpstack.fdl.active.states import (
    ACTIVE_IDLE,
    AWAIT_DATA_RESPONSE,
    CHECK_TOKEN_PASS,
    CLAIM_TOKEN,
    LISTEN_TOKEN,
    State,
)
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.events import RingLeft
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, Telegram, token
from dpstack.params import BusParams

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
