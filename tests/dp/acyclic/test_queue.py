"""The acyclic queue with jobs made of octets: turns, lanes, pauses, time limits, and each early end."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

import pytest
from support import present

from dpstack.dp.acyclic.job import ACKS, UNORDERED, CancelService, Job, Outcome, RequestEnd, ServiceFailure, Step, Steps
from dpstack.dp.acyclic.queue import CAPACITY, Acyclic, Provider
from dpstack.errors import UsageError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SHORT_ACK, Req, Telegram
from dpstack.machine import LineDown, Order
from dpstack.trace import Event
from dpstack.units import NEVER

MS = 1_000_000
NONE = Failure.NO_ANSWER


class End(Event):
    token: int
    outcome: Outcome

    def _text(self) -> str:
        return self.outcome.text


class Wanted(Order):
    token: int
    job: Pieces
    timeout_ns: int = NEVER


@dataclass(eq=False)
class Pieces(Job):
    """A job of ``count`` requests with ``pause_ms`` before each; it writes down the end of each."""

    address: int
    count: int = 1
    line: Hashable | None = None
    pause_ms: int = 0
    barred: str = ""
    held: str = ""
    sequel: str = ""
    title: str = "Service"
    ends_of: list[RequestEnd] = field(default_factory=list)

    @property
    def lane(self) -> Hashable | None:
        return self.line

    @property
    def aftermath(self) -> str:
        return self.sequel

    def bar(self) -> str:
        return self.barred

    def held_up(self, now: int) -> str:
        return self.held

    def steps(self) -> Steps[Outcome]:
        for number in range(self.count):
            asked = Request(self.address, Req.SRD_LOW, bytes([number]))
            self.ends_of.append((yield Step(asked, self.pause_ms * MS)))
        return Outcome(data=b"\xaa")

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        return [End(t_ns=now, token=token, outcome=outcome)]


class Plain(Provider):
    def job_of(self, order: object) -> tuple[int, Job, int] | None:
        return (order.token, order.job, order.timeout_ns) if isinstance(order, Wanted) else None


class Full(Plain):
    """Writes down each call."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.at = NEVER
        self.ticked = False
        self.reached = False

    def command(self, order: object, now: int) -> bool:
        return order == "mine"

    def queue_jobs(self, now: int) -> None:
        self.calls.append(f"{now} queue_jobs")

    def started(self, request: Request) -> None:
        self.calls.append(f"started {request.da}")

    def request_ended(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        name = outcome.name if isinstance(outcome, Failure) else "answer"
        self.calls.append(f"{now} ended {request.da} {name}")

    def may_be_taken(self, request: Request) -> bool:
        return self.reached

    def line_down(self, reason: str, now: int) -> None:
        self.calls.append(f"{now} down {reason}")

    def wake_at(self) -> int:
        return self.at

    def tick(self, now: int) -> bool:
        self.calls.append(f"{now} tick")
        return self.ticked


class Holds:
    """Token holds for a queue: each asks for two requests, so that a second one in a hold would show."""

    def __init__(self, *providers: Provider) -> None:
        self.queue = Acyclic(None, providers or (Plain(),))
        self.now = 0
        self.tokens = 0

    def order(self, job: Pieces, timeout_ns: int = NEVER) -> int:
        self.tokens += 1
        assert self.queue.command(Wanted(self.tokens, job, timeout_ns), self.now)
        return self.tokens

    def begin(self) -> Request | None:
        """A hold with its request on the wire 1 ms later."""
        self.queue.token_received(self.now)
        assert self.queue.next_request(self.now, high_only=True) is None
        request = self.queue.next_request(self.now, high_only=False)
        if request is not None:
            assert self.queue.next_request(self.now, high_only=False) is None
            self.queue.started(request, self.now + MS)
        return request

    def hold(self, answer: Telegram | Failure = SHORT_ACK) -> str:
        """A whole hold of 5 ms: address and number of its request, with "p" for a patient one."""
        request = self.begin()
        self.now += 5 * MS
        if request is None:
            return ""
        self.queue.result(request, answer, self.now)
        assert self.queue.next_request(self.now, high_only=False) is None
        return f"{request.da}.{request.data[0]}{'p' * request.patient}"

    def holds(self, count: int) -> str:
        return " ".join(self.hold() for _ in range(count)).strip()

    @property
    def ends(self) -> list[tuple[int, ServiceFailure | None, str]]:
        events = [event for event in self.queue.take_events() if isinstance(event, End)]
        return [(event.token, event.outcome.failure, event.text) for event in events]


@pytest.fixture
def bus() -> Holds:
    return Holds()


def test_services_without_a_lane_take_turns_and_known_stations_are_waited_for(bus: Holds) -> None:
    for address in (3, 4, 5):
        bus.order(Pieces(address, 3))
    assert bus.queue.waiting == 3
    assert bus.holds(10) == "3.0 4.0 5.0 3.1p 4.1p 5.1p 3.2p 4.2p 5.2p"
    assert bus.ends == [(1, None, ""), (2, None, ""), (3, None, "")]
    assert bus.queue.waiting == 0


def test_one_that_comes_later_waits_for_its_turn_once(bus: Holds) -> None:
    bus.order(Pieces(3, 4))
    assert bus.holds(2) == "3.0 3.1p"
    bus.order(Pieces(4, 2))
    assert bus.holds(4) == "3.2p 4.0 3.3p 4.1p"


def test_a_station_that_falls_silent_is_not_waited_for_any_longer(bus: Holds) -> None:
    bus.order(Pieces(3, 6))
    assert [bus.hold(answer) for answer in (SHORT_ACK, NONE, SHORT_ACK, Failure.GARBLED, SHORT_ACK, SHORT_ACK)] == [
        "3.0", "3.1p", "3.2", "3.3p", "3.4p", "3.5p",
    ]  # fmt: skip


def test_services_of_one_lane_run_one_after_the_other(bus: Holds) -> None:
    for count, lane in ((2, "a"), (2, "a"), (3, "b")):
        bus.order(Pieces(3 if lane == "a" else 4, count, lane))
    assert bus.queue.lanes() == {"a", "b"}
    assert bus.holds(8) == "3.0 4.0 3.1p 3.0p 4.1p 3.1p 4.2p"
    assert [token for token, *_ in bus.ends] == [1, 2, 3]
    assert bus.queue.lanes() == set()


def test_a_service_that_may_not_begin_is_overtaken_in_its_lane(bus: Holds) -> None:
    first, second = Pieces(3, 2, "a", held="it waits"), Pieces(4, 2, "a")
    bus.order(first)
    bus.order(second)
    assert bus.hold() == "4.0"
    first.held = ""
    assert bus.holds(4) == "4.1p 3.0 3.1p"
    assert [token for token, *_ in bus.ends] == [2, 1]


def test_a_begun_service_is_not_held_up_any_more(bus: Holds) -> None:
    job = Pieces(3, 3, "a")
    bus.order(job)
    assert bus.hold() == "3.0"
    job.held = "it waits"
    assert bus.holds(3) == "3.1p 3.2p"


def test_first_in_a_lane_is_behind_what_has_begun_and_before_the_rest(bus: Holds) -> None:
    for address in (3, 4):
        bus.order(Pieces(address, 2, "a"))
    assert bus.hold() == "3.0"
    bus.queue.put(Pieces(5, 1, "a"), NEVER, bus.now, token=ACKS, first=True)
    bus.queue.put(Pieces(6, 1, "a"), NEVER, bus.now)
    assert bus.holds(6) == "3.1p 5.0 4.0 4.1p 6.0"
    assert [token for token, *_ in bus.ends] == [1, ACKS, 2, UNORDERED]
    bus.order(Pieces(3, 1, "a"))
    bus.queue.put(Pieces(5, 1, "a"), NEVER, bus.now, first=True)
    assert bus.holds(3) == "5.0p 3.0p"


def test_pauses_begin_with_the_end_of_the_last_request(bus: Holds) -> None:
    """The first request of a service waits for nothing."""
    bus.order(Pieces(3, 3, pause_ms=10))
    assert [bus.hold() for _ in range(10)] == ["3.0", "", "", "3.1p", "", "", "3.2p", "", "", ""]


def test_the_times_of_a_request(bus: Holds) -> None:
    bus.now = 100 * MS
    job = Pieces(3, 3)
    bus.order(job)
    bus.holds(2)
    bus.queue.token_received(bus.now)
    request = present(bus.queue.next_request(bus.now, high_only=False))
    bus.queue.result(request, Failure.REFUSED, 110 * MS)  # never sent
    assert [(end.begun // MS, end.now // MS) for end in job.ends_of] == [(101, 105), (106, 110), (110, 110)]


@pytest.mark.parametrize("answer", [Failure.ABANDONED, Failure.HELD_BACK])
def test_a_request_that_was_not_sent_is_asked_again(bus: Holds, answer: Failure) -> None:
    job = Pieces(3, 2)
    bus.order(job)
    assert [bus.hold(answer), bus.hold(), bus.hold(answer), bus.hold()] == ["3.0", "3.0", "3.1p", "3.1p"]
    assert [end.answer for end in job.ends_of] == [SHORT_ACK] * 2


def test_a_request_that_the_slave_may_have_taken_counts_as_unanswered() -> None:
    provider = Full()
    provider.reached = True
    bus = Holds(provider)
    job = Pieces(3, 3)
    bus.order(job)
    assert [bus.hold(Failure.ABANDONED), bus.hold(Failure.HELD_BACK), bus.hold()] == ["3.0", "3.1", "3.1"]
    assert [end.answer for end in job.ends_of] == [NONE, SHORT_ACK]
    assert "5000000 ended 3 NO_ANSWER" in provider.calls


def test_a_provider_is_called_in_each_step() -> None:
    provider = Full()
    bus = Holds(Plain(), provider)
    assert not bus.queue.command("another", 0)
    assert bus.queue.command("mine", 0)
    bus.order(Pieces(3))
    bus.hold()
    assert provider.calls == ["0 queue_jobs", "started 3", "5000000 ended 3 answer"]
    assert bus.queue.wake_at() == NEVER
    provider.at = 77
    assert bus.queue.wake_at() == 77
    bus.order(Pieces(3), 70 * MS)
    provider.at = NEVER
    assert bus.queue.wake_at() == 75 * MS
    assert not bus.queue.command(LineDown("cut"), 88)
    bus.queue.tick(99)
    assert provider.calls[3:] == ["88 down cut", "99 tick"]
    assert provider.queue is bus.queue


def test_a_slave_that_can_never_answer_ends_the_service_at_once() -> None:
    """Before the next request, at the next token, and where a provider says so."""
    provider = Full()
    for end in ("token", "request", "tick", "tick in vain"):
        bus = Holds(provider)
        job = Pieces(3, 2)
        bus.order(job)
        bus.hold()
        if end == "request":
            bus.queue.token_received(bus.now)
        job.barred = "ended: it left"
        provider.ticked = end == "tick"
        if end == "token":
            bus.queue.token_received(bus.now)
        elif end == "request":
            assert bus.queue.next_request(bus.now, high_only=False) is None
        else:
            bus.queue.tick(bus.now)
        expected = (1, ServiceFailure.CLOSED, "Service to slave 3 ended: it left")
        assert bus.ends == ([] if end == "tick in vain" else [expected])


def test_with_its_request_under_way_a_service_may_still_be_completed() -> None:
    for answer, ends in (
        (SHORT_ACK, [(1, None, "")]),
        (Failure.ABANDONED, [(1, ServiceFailure.CANCELLED, "Service to slave 3 was cancelled; look at it")]),
    ):
        bus = Holds()
        bus.order(Pieces(3, sequel="look at it"))
        request = present(bus.begin())
        bus.queue.command(CancelService(1), bus.now)
        assert bus.ends == []
        bus.queue.result(request, answer, 7 * MS)
        assert bus.ends == ends
        bus.queue.command(CancelService(1), bus.now)
        assert bus.ends == []


def test_cancelled_before_it_was_sent_and_between_two_requests(bus: Holds) -> None:
    for address in (3, 4):
        bus.order(Pieces(address, 2))
    bus.hold()
    assert bus.queue.command(CancelService(1), bus.now)
    assert bus.queue.command(CancelService(9), bus.now)
    assert bus.ends == [(1, ServiceFailure.CANCELLED, "Service to slave 3 was cancelled")]
    assert bus.holds(3) == "4.0 4.1p"


def test_a_lost_port_ends_every_service(bus: Holds) -> None:
    for address in (3, 4):
        bus.order(Pieces(address, 2))
    request = present(bus.begin())
    assert not bus.queue.command(LineDown("unplugged"), 3 * MS)
    text = "was not over when the port vanished (unplugged); it can be repeated when the port is back"
    assert bus.ends == [(2, ServiceFailure.LINE, f"Service to slave 4 {text}")]
    bus.queue.result(request, Failure.ABANDONED, 3 * MS)
    assert bus.ends == [(1, ServiceFailure.LINE, f"Service to slave 3 {text}")]


@pytest.mark.parametrize(
    ("story", "why"),
    [
        ("no token", "this station was given no token in that time; see whether it is in the ring"),
        ("held up", "it waits"),
        ("no room", "no token hold had time left for it; T_TR is too short, or too many services wait"),
        ("asked", ""),
        ("no line", "the port vanished (cut); it can be repeated when the port is back"),
        ("line again", "no token hold had time left for it; T_TR is too short, or too many services"),
    ],
)
def test_why_a_service_is_late(story: str, why: str) -> None:
    bus = Holds()
    bus.queue.token_received(0)
    if story in ("no line", "line again"):
        bus.queue.command(LineDown("cut"), 0)
    bus.order(Pieces(3, 9, "a", held="it waits" if story == "held up" else ""), 2_500 * MS)
    if story == "asked":
        bus.hold()
    elif story not in ("no token", "no line"):
        bus.queue.token_received(1)
    assert bus.queue.wake_at() == 2_500 * MS
    bus.queue.tick(2_500 * MS - 1)
    assert bus.ends == []
    bus.queue.tick(2_500 * MS)
    ((token, found, text),) = bus.ends
    assert (token, found) == (1, ServiceFailure.LINE if story == "no line" else ServiceFailure.LATE)
    if story == "asked":
        assert text == "Service to slave 3 was not over after 2.5 s; give it a longer timeout"
    else:
        assert text.startswith(f"Service to slave 3 was not over after 2.5 s: {why}")


def test_a_late_service_with_its_request_under_way_ends_with_that_request(bus: Holds) -> None:
    bus.order(Pieces(3, 2), 10 * MS)
    request = present(bus.begin())
    bus.queue.tick(10 * MS)
    assert bus.queue.wake_at() == NEVER
    assert bus.ends == []
    bus.queue.result(request, SHORT_ACK, 11 * MS)
    assert bus.ends == [
        (1, ServiceFailure.LATE, "Service to slave 3 was not over after 0.01 s; give it a longer timeout")
    ]


def test_the_queue_is_full_for_each_lane_alone(bus: Holds) -> None:
    """32 services a lane. Acknowledgements of alarms do not count."""
    assert CAPACITY == 32
    for lane in (None, "a", "b"):
        for _ in range(3):
            bus.queue.put(Pieces(3, 1, lane), NEVER, 0, token=ACKS)
        for number in range(32):
            assert bus.queue.room(lane), number
            bus.order(Pieces(3, 1, lane))
        assert not bus.queue.room(lane)
        who = "class 2 services are" if lane is None else "services for slave 3 are"
        with pytest.raises(UsageError, match=rf"^32 {who} waiting already: await their results first$"):
            bus.order(Pieces(3, 1, lane))
    assert bus.queue.waiting == 3 * 35


def test_an_event_of_a_provider_is_reported(bus: Holds) -> None:
    event = End(t_ns=1, token=2, outcome=Outcome())
    bus.queue.report(event)
    assert bus.queue.take_events() == [event]
    assert bus.queue.take_events() == []
