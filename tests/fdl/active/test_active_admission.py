"""Requests that may not start now, whose data are too old, or whose answers are odd: every edge of the rules."""

from __future__ import annotations

import pytest
from ring_bus import ListUser

from dpstack.fdl.active.admission import Admission
from dpstack.fdl.active.services import SERVICES, Service
from dpstack.fdl.active.states import State
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.events import DoesNotFit
from dpstack.fdl.interface import LONG_NS, Failure, Request
from dpstack.fdl.telegram import Kind, Req, Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Notice
from tests.fdl.active.exchange_kit import DIAG, DIAG_ANSWER, DX, DX_ANSWER, Slave, bus_with

BIT = 2_000  # at 500 kbit/s; T_SL 200, T_ID1 37, min T_SDR 11
MS = 1_000_000
NOW = 10 * MS
POLL = Request(5, Req.FDL_STATUS, retry=False, answer=0)
PORT = Patience(known_ns=50 * MS, unknown_ns=2 * MS, sending_ns=MS)


def admission_of(patience: Patience = EXACT, *ring: int, known: bool = False) -> Admission:
    station = ActiveStation(BusParams.preset(500_000, address=2), [ListUser()], patience=patience)
    for master in ring:
        station._membership.ring.add(master)
    if known:
        station._peers.fcb.answered(5)
    return station._hold.admission


# --- held back and forced --------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("patience", "known", "takes_bits", "takes_ns", "slack_ns"),
    [
        (EXACT, False, 66 + 200 + 121 + 37, 0, 0),
        (PORT, False, 66 + 211 + 121 + 37, MS, 0),
        (PORT, True, 66 + 211 + 121 + 37, 3 * MS, 2 * MS),
    ],
)
def test_a_request_that_never_fits_is_reported_once_with_its_duration(
    patience: Patience, known: bool, takes_bits: int, takes_ns: int, slack_ns: int
) -> None:
    admission = admission_of(patience, known=known)
    window, told = admission.window, []
    for cycle in range(40):
        window.begin(NOW + 1)
        if admission.admits(POLL, NOW):
            told.append((cycle, window.forced_service))
    assert told == [(n, "FDL_Status to station 5") for n in (8, 17, 26, 35)]
    assert admission.events == [
        DoesNotFit(t_ns=NOW, service="FDL_Status", address=5, takes_ns=takes_bits * BIT + takes_ns, slack_ns=slack_ns)
    ]
    window.begin(NOW + 1)
    assert window.forced_service == ""


def test_another_service_is_reported_too() -> None:
    admission = admission_of()
    for _ in range(60):
        admission.window.begin(NOW)
        for request in (POLL, DIAG, DIAG.replaced(da=9)):
            admission.admits(request, NOW)
    assert [(event.service, event.address) for event in admission.events if isinstance(event, DoesNotFit)] == [
        ("FDL_Status", 5),
        ("Slave_Diag", 3),
    ]


@pytest.mark.parametrize(("room", "fits"), [(424 * BIT + 500, True), (424 * BIT + 499, False)])
def test_the_telegrams_behind_a_request_have_to_fit_too(room: int, fits: bool) -> None:
    admission = admission_of()
    admission.window.begin(NOW + room)
    assert admission.admits(POLL, NOW, 500) is fits
    assert admission.window.forced_service == ""
    assert admission.events == []


def test_a_service_without_answer_is_named_once_the_cycle_was_due() -> None:
    admission = admission_of()
    admission.window.begin(NOW)
    admission.unanswered(DIAG, NOW)
    assert admission.window.unanswered == ""
    admission.unanswered(DIAG, NOW + 1)
    assert admission.window.unanswered == "Slave_Diag to station 3"
    admission.window.begin(NOW)
    assert admission.window.unanswered == ""


def test_the_time_for_which_an_answer_is_kept_back() -> None:
    assert admission_of().kept_back_ns() == 200 * BIT
    assert admission_of(Patience(known_ns=7)).kept_back_ns() == 200 * BIT + 1


@pytest.mark.parametrize(
    ("patient", "known", "long"), [(False, False, False), (True, False, True), (False, True, True)]
)
def test_known_stations_and_patient_requests_get_the_slack(patient: bool, known: bool, long: bool) -> None:
    assert admission_of(known=known).waits_long(POLL.replaced(patient=patient)) is long


# --- the time-out of an unknown address ------------------------------------------------------------------------------
SLOT = 211 * BIT


@pytest.mark.parametrize(
    ("patience", "ring", "extra_ns", "until"),
    [
        (PORT, (), 0, SLOT + 2 * MS),
        (PORT, (), 30 * MS, SLOT + 32 * MS),
        (PORT, (), 48 * MS, SLOT + 50 * MS),
        (PORT, (), LONG_NS, SLOT + 50 * MS),  # no more than a known station gets
        # T_TO of master 7 is (6 + 14) x 200 bits, 8 ms
        (PORT, (7, 9), LONG_NS, 8 * MS - 2 * MS),
        (PORT, (7, 9), 1 * MS, SLOT + 3 * MS),
        (PORT, (0, 7), LONG_NS, SLOT + 2 * MS),  # T_TO of master 0 leaves nothing
        # without a wire the other masters have slack of their own
        (Patience(known_ns=50 * MS, unknown_ns=2 * MS), (7, 9), LONG_NS, SLOT + 50 * MS),
        (Patience(known_ns=MS, unknown_ns=2 * MS), (), LONG_NS, SLOT + 2 * MS),
    ],
)
def test_more_time_for_an_unknown_address(patience: Patience, ring: tuple[int, ...], extra_ns: int, until: int) -> None:
    admission = admission_of(patience, *ring)
    assert admission.in_vain_until(POLL.replaced(extra_ns=extra_ns), NOW) == NOW + until


@pytest.mark.parametrize("then_ns", [0, 300_000])
def test_the_time_out_ends_before_what_follows_and_the_next_cycle(then_ns: int) -> None:
    """The longest: T_SL with a character and 2 ms; the shortest: T_SL with a character, 1 ms to send, 11 octets."""
    admission = admission_of(PORT)
    after = then_ns + 37 * BIT
    longest, shortest = SLOT + 2 * MS, SLOT + MS + 121 * BIT
    for room, until in (
        (longest + after + 1, longest),
        (longest + after, longest),
        (longest + after - 1, longest - 1),
        (shortest + after + 1, shortest + 1),
        (shortest + after, shortest),
        (shortest + after - 1, shortest),
        (0, shortest),
    ):
        admission.window.next_at = NOW + room
        assert admission.in_vain_until(POLL, NOW, then_ns) == NOW + until
    admission.window.next_at = NOW
    small = Patience(unknown_ns=1)
    assert admission_of(small).in_vain_until(POLL, NOW) == NOW + SLOT + 1


# --- data that are too old -------------------------------------------------------------------------------------------
def test_data_that_are_too_old_are_not_repeated() -> None:
    slave = Slave(DX_ANSWER, None, answer=DX_ANSWER)
    asked: list[int] = []

    def still(now: int) -> bool:
        asked.append(now)
        return False

    _, user, station = bus_with(slave, DX, DX.replaced(still=still), DX, run_ms=20)
    assert user.outcomes[1] is Failure.ABANDONED
    assert len(slave.heard) == 3
    assert asked == [user.results[1][2]]
    assert [station.stats.stations[3].retries, station.stats.stations[3].timeouts] == [0, 1]
    assert slave.fcs == ["6D", "5D", "6D"]  # given up: the next request begins anew


def test_data_that_are_good_are_repeated() -> None:
    slave = Slave(DX_ANSWER, None, answer=DX_ANSWER)
    _, user, _ = bus_with(slave, DX, DX.replaced(still=lambda now: True), run_ms=20)
    assert [isinstance(outcome, Telegram) for outcome in user.outcomes] == [True, True]
    assert slave.fcs == ["6D", "5D", "5D"]


@pytest.mark.parametrize(("late_ns", "good", "sent"), [(MS, False, True), (MS + 1, False, False), (MS + 1, True, True)])
def test_a_driver_that_is_late_sends_no_old_data(late_ns: int, good: bool, sent: bool) -> None:
    bus, user, station = bus_with(Slave(), DX.replaced(still=lambda now: good))
    bus.until(station, State.USE_TOKEN)
    made_at = station._exchange.made_at
    assert (station.take_tx(made_at + late_ns) is not None) is sent
    assert user.outcomes == ([] if sent else [Failure.ABANDONED])
    if not sent:
        assert station._peers.due == {}
        assert station.take_tx(made_at + late_ns) is None or station.state is not State.USE_TOKEN


def test_an_old_repetition_is_dropped_and_its_first_attempt_may_be_answered_late() -> None:
    """The first attempt has no answer, the driver sends the repetition 1 ms and 1 ns after the request was made."""
    good = [True]
    bus, user, station = bus_with(Slave(DX_ANSWER, None), DX, DX.replaced(still=lambda now: good[0]))
    while len(user.starts) < 2:
        bus.run_bits(1)
    bus.until(station, State.AWAIT_DATA_RESPONSE)
    station.wake(station.wake_at())
    good[0] = False
    now = station._exchange.made_at + MS + 1
    assert station.take_tx(now) is None
    assert user.outcomes[-1] is Failure.ABANDONED
    assert station._peers.due == {3: (user.results[-1][0], now + 4 * 200 * BIT)}
    assert not station._peers.fcb.operational[3]


# --- odd answers -----------------------------------------------------------------------------------------------------
def wrong_from(sa: int, data: bytes = b"\x01") -> bytes:
    """A response with the SAPs of no request here."""
    body = bytes((0x82, 0x80 | sa, 0x08, 0x3E, 0x3B)) + data
    return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


@pytest.mark.parametrize(
    ("answer", "delay", "counted"),
    [
        (wrong_from(3), 11, {"wrong": 1}),
        (wrong_from(3), 10, {"late": 1, "early": 1}),
        (wrong_from(9), 11, {}),
        (wrong_from(9), 10, {}),
        (DIAG_ANSWER, 11, {}),
        (DIAG_ANSWER, 10, {"late": 1, "early": 1}),
        (b"\xe5", 10, {"early": 1}),
    ],
)
def test_the_counters_of_odd_answers(answer: bytes, delay: int, counted: dict[str, int]) -> None:
    _, _, station = bus_with(Slave((delay, answer)), DIAG, run_ms=20)
    stats = station.stats.stations[3]
    assert {name: getattr(stats, name) for name in ("wrong", "late", "early") if getattr(stats, name)} == counted
    elsewhere = answer == wrong_from(9)
    assert station.stats.stray == (answer == b"\xe5")
    assert (9 in station.stats.stations) is elsewhere
    assert station.stats.late == (1 if elsewhere or counted.get("late") else 0)


def test_a_wrong_answer_after_an_attempt_without_answer_is_a_late_one() -> None:
    """The second attempt at 3 meets an answer to an earlier request with other SAPs: it was due."""
    slave = Slave(DX_ANSWER, None, (11, DIAG_ANSWER))
    _, user, station = bus_with(slave, DX, DX.replaced(retry=False), DIAG.replaced(dsap=61), run_ms=20)
    assert station.stats.stations[3].wrong == 1
    assert user.outcomes == [user.outcomes[0], Failure.NO_ANSWER, Failure.WRONG]


def test_answers_are_counted_per_station() -> None:
    slave = Slave(DX_ANSWER, None, DX_ANSWER, None, None)
    _, user, station = bus_with(slave, *[DX] * 4, Request(9, Req.SRD_HIGH), Request(9, Req.FDL_STATUS), run_ms=40)
    three = station.stats.stations[3]
    assert (three.requests, three.answers, three.retries, three.timeouts) == (4, 3, 2, 1)
    assert three.telegrams == 4 + 3 + 2
    nine = station.stats.stations[9]
    assert (nine.requests, nine.answers, nine.retries, nine.timeouts) == (2, 0, 1, 1)
    assert len(user.results) == 6


def test_an_unknown_address_that_is_silent_leaves_no_counters() -> None:
    _, user, station = bus_with(Slave(), POLL, DX, POLL.replaced(da=3), run_ms=20)
    assert [isinstance(outcome, Telegram) for outcome in user.outcomes] == [False, True, False]
    assert station.stats.stations.keys() == {3}


def test_an_answer_to_a_station_without_request_is_late() -> None:
    bus, _, station = bus_with(Slave())
    bus.until(station, State.PASS_TOKEN)
    for telegram in (Telegram(Kind.SD2, 2, 3, 0x08, data=b"\x00"), Telegram(Kind.SC, -1, -1)):
        station.telegram(telegram, bus.now)
    assert (station.stats.late, station.stats.stations[3].late, station.stats.stray) == (1, 1, 1)


def test_a_station_that_answers_wrongly_ten_times_is_reported_with_the_time() -> None:
    bus, _, _ = bus_with(Slave(answer=wrong_from(3) + DIAG_ANSWER), *[DIAG] * 12, mode="octets", run_ms=40)
    (told,) = [event for event in bus.events_of(Notice) if "more answers than it gets requests" in event.message]
    assert 0 < told.t_ns < bus.now


@pytest.mark.parametrize(
    ("function", "fc", "counted", "answered"),
    [
        (Req.TIME_EVENT, 0x40, False, False),
        (Req.SDA_LOW, 0x43, True, True),
        (Req.SDN_LOW, 0x44, False, False),
        (Req.SDA_HIGH, 0x45, True, True),
        (Req.SDN_HIGH, 0x46, False, False),
        (Req.MSRD, 0x47, True, True),
        (Req.FDL_STATUS, 0x49, False, True),
        (Req.SRD_LOW, 0x4C, True, True),
        (Req.SRD_HIGH, 0x4D, True, True),
        (Req.IDENT, 0x4E, False, True),
        (Req.LSAP_STATUS, 0x4F, False, True),
        (Req.CLOCK_VALUE, 0xC0, False, False),
    ],
)
def test_the_fc_octet_of_every_service(function: Req, fc: int, counted: bool, answered: bool) -> None:
    assert SERVICES[function] == Service(fc, counted, answered)
