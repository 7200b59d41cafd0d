"""The queue of requests: order, share of the token hold, one end for each request, whatever happens to it."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.errors import UsageError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.services.confirmations import ALLOWED, FdlService
from dpstack.fdl.services.orders import CancelFdl, CloseSap, FdlConfirmed, FdlRequest, OpenSap
from dpstack.fdl.services.requester import FdlUser
from dpstack.fdl.telegram import SHORT_ACK, UNANSWERED, Kind, Req, Telegram
from dpstack.machine import LineDown
from dpstack.params import BusParams

PARAMS = BusParams.preset(500_000, address=2)
MS = 1_000_000
#: ends of a request that can come without an answer being awaited
NOT_SENT = (Failure.HELD_BACK, Failure.REFUSED, Failure.ABANDONED)


class Host:
    """The station of the user."""

    fdl_guard: Any = None
    in_ring = True

    def respond_with(self, responder: Any) -> None:
        pass


class Queue:
    def __init__(self, per_hold: int = 1) -> None:
        self.user = FdlUser(PARAMS, per_hold=per_hold)
        self.host = Host()
        self.user.attached(self.host)
        self.now = 0

    def order(self, token: int, **how: Any) -> None:
        given: dict[str, Any] = {"service": FdlService.SDA, "address": 5, "timeout_ns": MS} | how
        assert self.user.command(FdlRequest(token, **given), self.now)

    def hold(self, *outcomes: Telegram | Failure, high_only: bool = False) -> list[int]:
        """A token hold; the requests end with ``outcomes``, then SC. Returns the first data octet of each."""
        left = list(outcomes)
        self.user.token_received(self.now)
        sent = []
        while (request := self.user.next_request(self.now, high_only)) is not None:
            sent.append(request.data[0] if request.data else -1)
            outcome = left.pop(0) if left else SHORT_ACK
            if request.function in UNANSWERED and outcome not in NOT_SENT:
                outcome = SHORT_ACK
            if outcome is not Failure.HELD_BACK and outcome is not Failure.REFUSED:
                self.user.started(request, self.now)
            self.user.result(request, outcome, self.now)
        return sent

    def ends(self) -> list[tuple[int, str]]:
        return [(one.token, one.status.value) for one in self.user.take_events() if isinstance(one, FdlConfirmed)]


@pytest.fixture
def queue() -> Queue:
    return Queue()


def test_one_request_in_a_hold_beside_a_dp_master(queue: Queue) -> None:
    for token in (1, 2):
        queue.order(token, data=bytes((token,)))
    assert queue.hold() == [1]
    assert queue.hold() == [2]
    assert queue.hold() == []
    assert queue.ends() == [(1, "OK"), (2, "OK")]


def test_high_before_low_and_alone_in_a_late_hold() -> None:
    queue = Queue(per_hold=0)
    for token, high in ((1, False), (2, True), (3, False), (4, True)):
        queue.order(token, data=bytes((token,)), high=high)
    assert queue.hold(high_only=True) == [2, 4]
    assert queue.hold() == [1, 3]


def test_a_request_that_does_not_fit_before_the_next_cycle_waits(queue: Queue) -> None:
    queue.order(1, data=b"\x01")
    queue.order(2, data=b"\x02")
    assert queue.hold(Failure.HELD_BACK) == [1]
    assert queue.ends() == []
    assert queue.hold() == [1]
    assert queue.ends() == [(1, "OK")]


def test_results(queue: Queue) -> None:
    outcomes: list[tuple[Any, str]] = [
        (Failure.NO_ANSWER, "NA"),
        (Failure.GARBLED, "NA"),
        (Failure.WRONG, "NA"),
        (Failure.ABANDONED, "DS"),
        (Failure.REFUSED, "IV"),
        (Telegram(Kind.SD1, 2, 5, 0x02), "RR"),
    ]
    for token, (outcome, status) in enumerate(outcomes):
        queue.order(token)
        queue.hold(outcome)
        assert queue.ends() == [(token, status)]


def test_a_known_station_gets_more_time(queue: Queue) -> None:
    queue.order(1)
    queue.hold()
    queue.order(2)
    queue.user.token_received(0)
    request = queue.user.next_request(0, False)
    assert request is not None
    assert (request.patient, request.extra_ns) == (True, 0)


def test_waiting_too_long(queue: Queue) -> None:
    queue.order(1, timeout_ns=5)
    assert queue.user.wake_at() == 5
    queue.user.tick(5)
    queue.host.in_ring = False
    queue.order(2, timeout_ns=5)
    queue.user.tick(5)
    assert queue.ends() == [(1, "LR"), (2, "DS")]
    assert queue.hold() == []


def test_a_full_queue(queue: Queue) -> None:
    for token in range(33):
        queue.order(token)
    assert queue.ends() == [(32, "LR")]
    assert queue.user.waiting == 32


def test_a_lost_port(queue: Queue) -> None:
    queue.order(1)
    queue.order(2, high=True)
    assert not queue.user.command(LineDown("gone"), 0)
    assert queue.ends() == [(2, "DS"), (1, "DS")]


def test_a_cancelled_request(queue: Queue) -> None:
    queue.order(1)
    assert queue.user.command(CancelFdl(1), 0)
    assert queue.hold() == []
    assert queue.ends() == []


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ({"address": 127}, "SDA goes to 0..126"),
        ({"address": -1}, "SDA goes to 0..126"),
        ({"address": 128, "service": FdlService.SDN}, "SDN goes to 0..127"),
        ({"address": 2}, "that of this station"),
        ({"dsap": 63}, "dsap 63: SDA has 0..62"),
        ({"ssap": 64}, "ssap 64: SDA has 0..62"),
        ({"data": bytes(247)}, "247 octets of data: 246 fit"),
        ({"data": bytes(246), "dsap": 1}, "246 octets of data: 245 fit"),
        ({"data": bytes(245), "dsap": 1, "ssap": 1}, "245 octets of data: 244 fit"),
    ],
)
def test_invalid_parameters(queue: Queue, how: dict[str, Any], text: str) -> None:
    queue.order(1, **how)
    (end,) = queue.user.take_events()
    assert isinstance(end, FdlConfirmed)
    assert (end.status.value, text in end.remark) == ("IV", True)
    assert queue.hold() == []


def test_from_a_sap_that_was_closed(queue: Queue) -> None:
    queue.order(1, ssap=20)
    queue.user.command(OpenSap(20, (FdlService.SDA,)), 0)
    queue.user.command(CloseSap(20), 0)
    queue.order(2, ssap=20)
    assert queue.ends() == [(2, "LS")]


def test_a_guard_refuses_at_once_and_when_it_changes_its_mind(queue: Queue) -> None:
    queue.order(1)
    queue.order(2, address=6)
    queue.host.fdl_guard = lambda order: "its slave" if order.address == 5 else None
    with pytest.raises(UsageError, match="its slave"):
        queue.order(3)
    assert queue.hold() == [-1]
    assert queue.ends() == [(1, "IV"), (2, "OK")]


OUTCOMES = st.sampled_from((*Failure, SHORT_ACK, Telegram(Kind.SD1, 2, 5, 0x03), Telegram(Kind.SD2, 2, 5, 0x08)))
EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just("order"), st.sampled_from(FdlService), st.booleans()),
        st.tuples(st.just("hold"), st.lists(OUTCOMES, max_size=3), st.booleans()),
        st.tuples(st.just("wait"), st.integers(0, 20), st.just(False)),
        st.tuples(st.just("down"), st.just(0), st.just(False)),
    ),
    max_size=60,
)


@given(EVENTS, st.sampled_from((0, 1, 2)))
def test_every_request_has_exactly_one_end(events: list[tuple[Any, ...]], per_hold: int) -> None:
    queue = Queue(per_hold)
    given: dict[int, FdlService] = {}
    ended: dict[int, str] = {}

    def note() -> None:
        for one in queue.user.take_events():
            assert isinstance(one, FdlConfirmed)
            assert one.token not in ended
            assert one.status in ALLOWED[given[one.token]]
            ended[one.token] = one.status.value

    for what, argument, flag in events:
        match what:
            case "order":
                given[len(given)] = argument
                queue.order(len(given) - 1, service=argument, high=flag, timeout_ns=15)
            case "hold":
                sent = queue.hold(*argument, high_only=flag)
                assert per_hold == 0 or len(sent) <= per_hold
            case "wait":
                queue.now += argument
                if queue.user.wake_at() <= queue.now:
                    queue.user.tick(queue.now)
            case _:
                queue.user.command(LineDown("gone"), queue.now)
        note()
        assert len(given) == len(ended) + queue.user.waiting
    queue.now += 100
    queue.user.tick(queue.now)
    note()
    assert given.keys() == ended.keys()


def test_what_a_request_asks_of_the_link_layer(queue: Queue) -> None:
    queue.order(1, service=FdlService.SRD, data=b"\x01", dsap=20, ssap=8, high=True)
    queue.user.token_received(0)
    made = queue.user.next_request(0, False)
    wanted = Request(5, Req.SRD_HIGH, b"\x01", 20, 8, extra_ns=1_000_000_000, answer=244, yields=True)
    assert all(getattr(made, name) == getattr(wanted, name) for name in Request.__slots__)
