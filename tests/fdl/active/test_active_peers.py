"""Book-keeping of the stations asked: known, slow and doubted ones, answers that may still come, odd answers."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from ring_bus import ListUser

from dpstack.fdl.active.peers import Peers
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, StationType, Telegram
from dpstack.params import BusParams
from dpstack.trace import Notice, Severity

DX = Request(3, Req.SRD_HIGH, b"\x01")
STATUS = Request(3, Req.FDL_STATUS)


@pytest.fixture
def peers() -> Peers:
    return ActiveStation(BusParams.preset(500_000, address=2), [ListUser()])._peers


def data_from(address: int) -> Telegram:
    return Telegram(Kind.SD2, 2, address, 0x08, data=b"\x00")


# --- known and slow stations -----------------------------------------------------------------------------------------
#: what happens to station 3, and whether the station knows it then, and regards it as slow
STORIES = [
    ("", False, False),
    ("found", True, False),
    ("found silent", False, False),
    ("found silent poll-answered", True, False),
    ("found silent poll-silent", True, False),  # the list of stations is changed by the GAP itself
    ("answers", True, False),
    ("answers silent", True, False),  # the frame count says when it is given up
    ("answers given-up", False, False),
    ("late", True, True),
    ("late silent", False, False),
    ("late poll-answered", True, True),
    ("late poll-silent", False, False),
    ("late found left-ring", False, False),
    ("found left-ring", False, False),
]


@pytest.mark.parametrize(("story", "known", "slow"), STORIES, ids=[each[0] for each in STORIES])
def test_known_and_slow_stations(peers: Peers, story: str, known: bool, slow: bool) -> None:
    acts: dict[str, Callable[[], object]] = {
        "found": lambda: peers.gap.polled(3, StationType.SLAVE),
        "silent": lambda: peers.silent(3),
        "poll-answered": lambda: peers.polled(3, True),
        "poll-silent": lambda: peers.polled(3, False),
        "answers": lambda: peers.fcb.answered(3),
        "given-up": lambda: peers.fcb.given_up(3),
        "late": lambda: peers.late(3, 1),
        "left-ring": lambda: peers.left_ring(3),
    }
    for act in story.split():
        acts[act]()
    assert (peers.knows(3), peers.is_slow(3)) == (known, slow)
    assert not peers.knows(4)
    assert not peers.is_slow(4)


# --- answers that may still come -------------------------------------------------------------------------------------
def test_an_answer_may_be_late_by_four_slot_times(peers: Peers) -> None:
    peers.expect_late(DX, 1_000, 50)
    assert peers.due == {3: (DX, 1_200)}
    assert peers.due_from(data_from(4), 1_200) == -1
    assert peers.due_from(data_from(3), 1_200) == 3
    assert peers.due_from(SHORT_ACK, 1_200) == 3
    assert peers.may_confuse(DX, 1_200)
    assert not peers.may_confuse(DX, 1_201)
    assert peers.due_from(data_from(3), 1_201) == -1
    assert peers.due == {}
    peers.expect_late(DX, 0, 50)
    peers.expect_none(4)
    assert peers.due == {3: (DX, 200)}
    peers.expect_none(3)
    peers.expect_none(3)
    assert peers.due == {}


@pytest.mark.parametrize(
    ("due", "request_", "confuses"),
    [
        (DX, DX, True),
        (DX, STATUS, True),  # the same station
        (DX, DX.replaced(da=4), True),  # SC has no sender
        (DX, STATUS.replaced(da=4), False),
        (STATUS, DX.replaced(da=4), False),
        (STATUS, STATUS.replaced(da=4), False),
        (STATUS, STATUS, True),
    ],
)
def test_a_late_answer_may_fit_two_requests(peers: Peers, due: Request, request_: Request, confuses: bool) -> None:
    peers.expect_late(due, 0, 50)
    assert peers.may_confuse(request_, 100) is confuses


# --- odd answers -----------------------------------------------------------------------------------------------------
def notices(peers: Peers) -> list[str]:
    found = [event for event in peers.events if isinstance(event, Notice)]
    assert all((event.source, event.severity, event.t_ns) == ("fdl", Severity.WARNING, 77) for event in found)
    return [event.message.split(":")[0] for event in found]


DOUBLED = "station 3 gives more answers than it gets requests (10 more)"
UNREADABLE = "half of the answers of station 3 cannot be read"


@pytest.mark.parametrize(("count", "told"), [(9, []), (10, [DOUBLED]), (40, [DOUBLED])])
def test_ten_surplus_answers_are_two_stations(peers: Peers, count: int, told: list[str]) -> None:
    for _ in range(count):
        peers.superfluous(3, 77)
    assert notices(peers) == told


def test_an_answer_without_request_makes_up_for_a_failed_attempt(peers: Peers) -> None:
    peers.attempt_failed(3)
    for _ in range(9):
        peers.superfluous(3, 77)
    for _ in range(30):
        peers.attempt_failed(3)  # not below none
    for _ in range(9):
        peers.superfluous(3, 77)
    assert notices(peers) == []
    peers.superfluous(3, 77)
    assert notices(peers) == [DOUBLED]


def test_late_answers_are_counted_for_the_station(peers: Peers) -> None:
    for _ in range(10):
        peers.late(3, 77)
    assert (peers.stats.late, peers.stats.station(3).late, peers.stats.station(4).late) == (10, 10, 0)
    assert notices(peers) == [DOUBLED]


@pytest.mark.parametrize(("first", "repeated", "told"), [(49, 500, []), (50, 0, [UNREADABLE]), (80, 0, [UNREADABLE])])
def test_fifty_requests_with_unreadable_answers(peers: Peers, first: int, repeated: int, told: list[str]) -> None:
    for _ in range(repeated):
        peers.unreadable(3, False, 77)
    for _ in range(first):
        peers.unreadable(3, True, 77)
    assert notices(peers) == told


@pytest.mark.parametrize(("requests", "told"), [(100, [DOUBLED, UNREADABLE]), (101, [])])
def test_the_counts_begin_anew_after_a_hundred_requests(peers: Peers, requests: int, told: list[str]) -> None:
    peers.stats.station(3).requests = 5
    for _ in range(9):
        peers.superfluous(3, 77)
    for _ in range(49):
        peers.unreadable(3, True, 77)
    peers.stats.station(3).requests += requests
    peers.superfluous(3, 77)
    peers.unreadable(3, True, 77)
    assert notices(peers) == told
    if not told:
        assert (peers._odd[3].since, peers._odd[3].superfluous, peers._odd[3].unreadable) == (106, 1, 1)


def test_le_3_is_reported_once_for_each_station(peers: Peers) -> None:
    for address in (3, 4, 3):
        peers.empty_le3(address, 77)
    assert [(event.t_ns, event.source, event.message[:16]) for event in peers.events if isinstance(event, Notice)] == [
        (77, "fdl", "station 3 sends "),
        (77, "fdl", "station 4 sends "),
    ]


def test_texts(peers: Peers) -> None:
    peers.knows_only_fcv(3, 77)
    assert [event.text for event in peers.events] == [
        "fdl: station 3 answered a request with FCV = 1 after three silent ones with FCV = 0: it was switched on just "
        "then, its answers came too late, or it does not know the standard's first request"
    ]
