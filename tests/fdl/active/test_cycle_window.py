"""Requests before the next fixed cycle: those held back and forced, and the longest course of a request to the bit."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ring_bus import ListUser

from dpstack.fdl.active.admission import Admission
from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.events import HELD_BACK_CYCLES
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import Req
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience, slack
from dpstack.units import NEVER

A = (12, 3, 60)
B = (12, 4, 60)


def test_without_a_cycle_everything_fits() -> None:
    assert CycleWindow().admits(A, NEVER - 1)


@pytest.fixture
def window() -> CycleWindow:
    return CycleWindow()


def test_a_request_that_ends_before_the_next_cycle_fits_to_the_nanosecond(window: CycleWindow) -> None:
    window.begin(1000)
    assert window.admits(A, 1000)
    assert not window.admits(A, 1001)
    assert (window.held_back, window.forced) == (1, 0)


def test_a_request_that_never_fits_goes_out_in_every_eighth_cycle(window: CycleWindow) -> None:
    sent = []
    for cycle in range(1, 41):
        window.begin(cycle * 1000)
        for _ in range(3):  # asked in several token holds
            if window.admits(A, cycle * 1000 + 1):
                sent.append(cycle)
                break
    assert sent == [9, 18, 27, 36]  # waits eight cycles, then begins to wait anew
    assert window.forced == 4
    assert window.held_back == 36  # once in each cycle


def test_the_longest_waiting_request_is_first_and_one_in_eight_cycles_may_begin_late(window: CycleWindow) -> None:
    sent = []
    for cycle in range(1, 31):
        window.begin(cycle * 1000)
        wanted = [A, B] if cycle > 1 else [B]
        sent += [(cycle, key) for key in wanted if window.admits(key, cycle * 1000 + 1)]
    assert sent == [(9, B), (17, A), (25, B)]


def test_a_wait_that_was_given_up_does_not_count(window: CycleWindow) -> None:
    for cycle in range(1, 30):
        window.begin(cycle * 1000)
        if cycle % 7:  # nobody asks in every seventh
            assert not window.admits(A, cycle * 1000 + 1)


def test_a_request_that_fitted_in_between_waits_anew(window: CycleWindow) -> None:
    for cycle in range(1, 20):
        window.begin(cycle * 1000)
        assert window.admits(A, cycle * 1000 + (cycle != 7)) is (cycle in (7, 16))


def test_the_end_of_the_cycles_forgets_who_waited(window: CycleWindow) -> None:
    for _ in range(8):
        window.begin(1000)
        assert not window.admits(A, 1001)
    window.forced_service = window.unanswered = "x"
    window.end()
    assert (window.next_at, window.forced_service, window.unanswered) == (NEVER, "", "")
    window.begin(1000)
    assert not window.admits(A, 1001)


def test_a_request_of_the_cycle_before_last_waits_no_longer(window: CycleWindow) -> None:
    """B was held back in cycle 1 and 2 only: in cycle 9 A is the one that waits longest."""
    for cycle in range(1, 12):
        window.begin(1000)
        if cycle < 3:
            assert not window.admits(B, 1001)
        if cycle > 1:
            assert window.admits(A, 1001) is (cycle == 10)


def test_a_window_begins_alone_and_without_a_cycle(window: CycleWindow) -> None:
    assert window.alone is True
    assert (window.next_at, window.held_back, window.forced) == (NEVER, 0, 0)
    assert (window.forced_service, window.unanswered) == ("", "")


@given(st.lists(st.lists(st.tuples(st.integers(0, 5), st.booleans()), max_size=6), min_size=1, max_size=120))
def test_no_request_starves_and_late_cycles_are_bounded(cycles: list[list[tuple[int, bool]]]) -> None:
    """Whoever asks in every cycle waits eight of them for each that waits before it, at most; one in eight is late."""
    window = CycleWindow()
    since: dict[int, int] = {}
    forced: list[int] = []
    for number, asked in enumerate(cycles, 1):
        window.begin(number * 1000)
        who = dict(asked)
        since = {address: first for address, first in since.items() if address in who}
        for address, fits in who.items():
            until = number * 1000 + (0 if fits else 1)
            waited = number - since.setdefault(address, number)
            assert waited <= (HELD_BACK_CYCLES + 1) * 7
            if window.admits((12, address, 60), until):
                del since[address]
                if not fits:
                    forced.append(number)
            else:
                assert not fits
    assert all(later - earlier >= HELD_BACK_CYCLES for earlier, later in itertools.pairwise(forced))
    assert window.forced == len(forced)


# 500 kbit/s: a bit is 2000 ns; T_SL 200, T_ID1 37, T_ID2 100, one repetition
@pytest.mark.parametrize(
    ("request_", "known", "bits"),
    [
        # SD1 (66) and T_SL twice, an answer of 255 octets (2805), T_ID1
        (Request(5, Req.SRD_HIGH, patient=True), True, 2 * (66 + 200) + 2805 + 37),
        # the first request to a station is not repeated; Slave_Diag: 11 octets (121), answered with 6 + 32 - 6
        (Request(5, Req.SRD_HIGH, b"", 60, 62, answer=32), False, 121 + 200 + (32 + 11) * 11 + 37),
        # Set_Prm: 11 + 10 octets; SC is counted as the longest answer without data
        (Request(5, Req.SRD_HIGH, bytes(10), 61, 62, answer=0), True, 2 * (231 + 200) + 121 + 37),
        # taken up afresh: one attempt
        (Request(5, Req.SRD_HIGH, bytes(10), 61, 62, restart=True, answer=0), True, 231 + 200 + 121 + 37),
        # FDL status: nobody repeats it here
        (Request(5, Req.FDL_STATUS, retry=False, answer=0), False, 66 + 200 + 121 + 37),
        # Global_Control: 13 octets and T_ID2
        (Request(127, Req.SDN_HIGH, b"\x00\x00", 58, 62), False, 143 + 100),
    ],
    ids=["data", "diagnosis", "parameters", "restart", "status", "control"],
)
def test_the_longest_course_of_a_request(request_: Request, known: bool, bits: int) -> None:
    admission = admission_of(known=known)
    assert admission.ends_at(request_, NOW) == NOW + bits * 2_000
    admission.line.idle_since = NOW  # the line fell silent only now: T_ID1 comes first
    assert admission.ends_at(request_, NOW) == NOW + (37 + bits) * 2_000


NOW = 10_000_000
POLL = Request(5, Req.FDL_STATUS, retry=False, answer=0)
DATA = Request(5, Req.SRD_HIGH, patient=True)
PORT = Patience(known_ns=50_000_000, unknown_ns=2_000_000, sending_ns=1_000_000)


def admission_of(patience: Patience = EXACT, *, known: bool = True) -> Admission:
    """The admission of a master at 500 kbit/s; ``known``: station 5 has answered it."""
    station = ActiveStation(BusParams.preset(500_000, address=2), [ListUser()], patience=patience)
    admission = station._hold.admission
    if known:
        admission.peers.fcb.answered(5)
    return admission


@pytest.mark.parametrize(
    ("patience", "request_", "known", "bits", "slack_us"),
    [
        # octets are seen at their end: T_SL and one octet more
        (PORT, POLL, False, 66 + 200 + 11 + 121 + 37, 1_000),
        (PORT, DATA, True, 66 + 200 + 11 + 2805 + 37, 1_000 + 2_000),
        (PORT, POLL, True, 66 + 200 + 11 + 121 + 37, 1_000 + 2_000),
        (slack(3_000_000, PORT), DATA, True, 2 * (66 + 200 + 11) + 2805 + 37, 2 * (1_000 + 3_000)),
    ],
    ids=[
        "an unknown address is planned with the wire time alone",
        "a known station is planned with one attempt and the usual lateness of the port",
        "a poll of a known station is planned with the usual lateness of the port",
        "the user's own slack is in every attempt",
    ],
)
def test_the_longest_course_of_a_request_on_a_slow_port(
    patience: Patience, request_: Request, known: bool, bits: int, slack_us: int
) -> None:
    assert admission_of(patience, known=known).ends_at(request_, NOW) - NOW == bits * 2_000 + slack_us * 1_000


def test_an_answer_that_may_be_kept_back_as_a_late_one_needs_that_time_too() -> None:
    admission = admission_of()
    before = admission.ends_at(DATA, NOW)
    admission.peers.due[7] = (Request(7, Req.SRD_HIGH), NOW)
    assert admission.ends_at(DATA, NOW) == before + 200 * 2_000  # T_SL
    assert admission.ends_at(DATA, NOW + 1) == before + 1  # no answer is due any more


@pytest.mark.parametrize(
    ("room_us", "waited_us"),
    [
        (5_000, 2_422),  # T_SL, a character (211 bits at 2 us), 2 ms: all of it
        (2_300, 2_300 - 300 - 74),  # what follows and T_ID1 before the cycle
        (1_000, 422 + 242),  # no less than T_SL and the answer: 11 octets, which may be on the wire
        (-50, 422 + 242),
    ],
)
def test_the_time_out_of_an_unknown_address(room_us: int, waited_us: int) -> None:
    admission = admission_of(Patience(known_ns=50_000_000, unknown_ns=2_000_000), known=False)
    admission.window.next_at = NOW + room_us * 1_000
    assert admission.in_vain_until(POLL, NOW, 300_000) == NOW + waited_us * 1_000
