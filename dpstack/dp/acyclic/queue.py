"""The queue of acyclic services: class 2, records of DP-V1 (MS1) and class 2 connections (MS2).

A user of the link layer with low priority: one request a token hold, in the time that is left, for the job that has
waited longest. The queue is bounded. Every accepted service has exactly one end, an event: the slave's answer, its
silence, its refusal, a lost token, a lost port. (The services are in :mod:`dpstack.dp.acyclic.class2`,
:mod:`dpstack.dpv1.master.ms1` and :mod:`dpstack.dpv1.master.ms2`.)

A slave in data exchange that left a service unanswered gets no other service before its next exchange. The reason:
after silence the link layer sends a first request (FCV 0, FCB 1), and after three of these it probes FCV
(docs/reference/protocol.md#slaves-that-know-only-fcv-1). A slave takes a probe with the FCB of the request before for a
repetition. After several unanswered services between two cycles that probe would be a Data_Exchange, and the master
would lose a slave that exchanges data.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Iterable
from typing import Any, Final

from msgspec import Struct

from dpstack.dp.acyclic.job import ACKS, UNORDERED, CancelService, Job, Outcome, RequestEnd, ServiceFailure, Step, Steps
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.services import positive
from dpstack.errors import UsageError
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import SAP_SLAVE_DIAG, Telegram
from dpstack.machine import LineDown
from dpstack.trace import Event
from dpstack.units import NEVER, ns_to_s

#: ends of a request that count as silence for the link layer
_UNANSWERED = frozenset((Failure.NO_ANSWER, Failure.GARBLED, Failure.WRONG))


#: services that may wait at a time: of class 2 in all, of class 1 for each slave, for each connection
CAPACITY: Final = 32


class _Entry(Struct):
    token: int
    job: Job
    deadline: int
    timeout_ns: int
    steps: Steps[Outcome]
    #: tokens received before the job was queued
    since: int
    #: the job with the lowest number is next
    turn: int
    step: Step | None = None
    due: int = 0
    asked: bool = False
    #: the first bit of the request of ``step`` was on the wire
    begun: int | None = None
    #: the end of the job, as soon as the request under way has ended
    over: tuple[ServiceFailure, str] | None = None


class Provider:
    """Services of one kind, for the queue. Subclass it, override what differs."""

    #: set when the queue is made
    queue: Acyclic

    def job_of(self, order: object) -> tuple[int, Job, int] | None:
        """Token, job and time-out in ns of ``order``; None for an order of another provider. Raises UsageError."""
        return None

    def command(self, order: object, now: int) -> bool:
        """Carry out an order that needs no job; False for an order of another provider. Raises UsageError."""
        return False

    def queue_jobs(self, now: int) -> None:
        """Queue jobs that no program ordered; called before each request."""

    def started(self, request: Request) -> None:
        """A request is on the wire."""

    def request_ended(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """The end of a request to any station."""

    def may_be_taken(self, request: Request) -> bool:
        """Whether an abandoned request may have reached the slave and must not be sent again."""
        return False

    def line_down(self, reason: str, now: int) -> None: ...

    def wake_at(self) -> int:
        """The next time for :meth:`tick`, in ns."""
        return NEVER

    def tick(self, now: int) -> bool:
        """Called from :meth:`wake_at` on; True if a slave can never answer some job any more."""
        return False


class Acyclic(LinkUser):
    """A ``LinkUser``. ``master``: the class 1 master of the same station, if any. Orders go to ``providers``."""

    def __init__(self, master: Master | None, providers: Iterable[Provider]) -> None:
        self.master = master
        self.provide(providers)
        self._queue: list[_Entry] = []
        self._asked: _Entry | None = None
        self._turn = False
        self._tokens = 0
        #: the reason of a lost port, empty from the next token on
        self._no_line = ""
        #: stations that answered the last request: the next one waits longer for its answer
        self._known: set[int] = set()
        self.events: list[Event] = []
        #: address -> number of exchanges when the slave left a service unanswered
        self._unanswered: dict[int, int] = {}
        self._turns = itertools.count()

    def provide(self, providers: Iterable[Provider]) -> None:
        """Have orders go to ``providers``, in place of those before, which have no job in the queue."""
        self.providers = tuple(providers)
        for provider in self.providers:
            provider.queue = self
        self._queue_jobs = self._overridden("queue_jobs")
        self._started = self._overridden("started")
        self._request_ended = self._overridden("request_ended")
        self._wakes = self._overridden("wake_at")
        self._ticks = self._overridden("tick")

    def _overridden(self, name: str) -> tuple[Callable[..., Any], ...]:
        """The method ``name`` of all providers that override it, because the queue calls it in every token hold."""
        base = getattr(Provider, name)
        return tuple(getattr(one, name) for one in self.providers if getattr(type(one), name) is not base)

    @property
    def waiting(self) -> int:
        """Services that are not over yet."""
        return len(self._queue)

    # --- orders -------------------------------------------------------------------------------------------------
    def command(self, command: object, now: int) -> bool:
        """Carry out CancelService and the orders of the providers. Raises UsageError."""
        match command:
            case CancelService(token):
                for entry in [entry for entry in self._queue if entry.token == token]:
                    self._cut(entry, ServiceFailure.CANCELLED, "was cancelled", now)
            case LineDown(reason):
                self._no_line = reason
                for entry in tuple(self._queue):
                    what = f"was not over when the port vanished ({reason}); it can be repeated when the port is back"
                    self._cut(entry, ServiceFailure.LINE, what, now)
                for provider in self.providers:
                    provider.line_down(reason, now)
                return False
            case _:
                for provider in self.providers:
                    order = provider.job_of(command)
                    if order is not None:
                        self._take(*order, now)
                        return True
                return any(provider.command(command, now) for provider in self.providers)
        return True

    def _take(self, token: int, job: Job, timeout_ns: int, now: int) -> None:
        if not self.room(job.lane):
            what = "class 2 services are" if job.lane is None else f"services for slave {job.address} are"
            raise UsageError(f"{CAPACITY} {what} waiting already: await their results first")
        self.put(job, timeout_ns, now, token=token)

    # --- providers ----------------------------------------------------------------------------------------------
    def room(self, lane: Hashable | None) -> bool:
        """Whether ``lane`` has room for one more job."""
        return sum(entry.job.lane == lane and entry.token != ACKS for entry in self._queue) < CAPACITY

    def lanes(self) -> set[Hashable | None]:
        """Lanes in which jobs wait."""
        return {entry.job.lane for entry in self._queue}

    def put(self, job: Job, timeout_ns: int, now: int, *, token: int = UNORDERED, first: bool = False) -> None:
        """Queue a job; ``first``: before the jobs of its lane that have not begun.

        A slave may raise no further alarm until the last one is acknowledged, and it expects its connections in the
        order in which it opened them.
        """
        new = _Entry(token, job, now + timeout_ns, timeout_ns, job.steps(), self._tokens, next(self._turns))
        at = len(self._queue)
        if first:
            begun = [entry.job.lane == job.lane and entry.step is not None for entry in self._queue]
            at = begun.index(True) + 1 if True in begun else 0
        self._queue.insert(at, new)

    def report(self, event: Event) -> None:
        """Report ``event`` to the application."""
        self.events.append(event)

    # --- link user ----------------------------------------------------------------------------------------------
    def token_received(self, now: int) -> None:
        """Allow one request in this hold, and end the jobs that their slaves can never answer any more."""
        self._turn = True
        self._tokens += 1
        self._no_line = ""
        if self._queue:
            self._end_barred(now)

    def next_request(self, now: int, high_only: bool) -> Request | None:
        """The next request of the job that has waited longest, among those that may go on."""
        if high_only or not self._turn:
            return None
        for queue_jobs in self._queue_jobs:
            queue_jobs(now)
        if not self._queue:
            return None
        self._end_barred(now)
        entry = self._next(now)
        if entry is None:
            return None
        self._turn = False
        if entry.step is None:
            entry.step = next(entry.steps)
            self._put_before_its_lane(entry)
        self._asked = entry
        request = entry.step.request
        return request if request.patient else request.replaced(patient=request.da in self._known)

    def _put_before_its_lane(self, entry: _Entry) -> None:
        """A job that has begun stands before the jobs of its lane that it has overtaken."""
        lane = entry.job.lane
        at = next((at for at, one in enumerate(self._queue) if one.job.lane == lane), 0)
        if lane is not None and self._queue[at] is not entry:
            self._queue.remove(entry)
            self._queue.insert(at, entry)

    def _next(self, now: int) -> _Entry | None:
        """The next job. Jobs of one lane run one after the other, in the order of the queue."""
        chosen: _Entry | None = None
        lanes: set[Hashable] = set()
        for entry in self._queue:
            lane = entry.job.lane
            if lane is not None:
                if lane in lanes or (entry.step is None and entry.job.held_up(now)):
                    continue
                lanes.add(lane)
            if entry.due <= now and (chosen is None or entry.turn < chosen.turn):
                chosen = chosen if self._awaits_exchange(entry.job.address) else entry
        return chosen

    def _awaits_exchange(self, address: int) -> bool:
        """Whether the slave left a service unanswered and had no exchange since. (In Stop there are no exchanges.)"""
        if not self._unanswered or self.master is None or self.master.mode <= Mode.STOP:
            return False
        handler = self.master.handlers.get(address)
        if handler is None or handler.state is not SlaveState.DATA_EXCHANGE:
            return False
        return handler.exchanges == self._unanswered.get(address)

    def _end_barred(self, now: int) -> None:
        for entry in tuple(self._queue):
            bar = entry.job.bar()
            if bar and entry is not self._asked:
                self._cut(entry, ServiceFailure.CLOSED, bar, now)

    def started(self, request: Request, at: int) -> None:
        entry = self._asked
        for started in self._started:
            started(request)
        if entry is not None:
            entry.asked = True
            entry.turn = next(self._turns)
            entry.begun = at

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """The end of a request: continue its job, or end it."""
        entry, self._asked = self._asked, None
        if entry is None:
            return
        handler = None if self.master is None else self.master.handlers.get(request.da)
        if handler is not None and outcome in _UNANSWERED:
            self._unanswered[request.da] = handler.exchanges
        elif self._unanswered:
            self._unanswered.pop(request.da, None)
        if isinstance(outcome, Telegram):
            self._known.add(request.da)
            if handler is not None and request.dsap == SAP_SLAVE_DIAG and positive(request.dsap, outcome):
                self._share(handler, request, outcome, now)
        elif outcome is Failure.NO_ANSWER:
            self._known.discard(request.da)
        elif outcome is Failure.ABANDONED and any(one.may_be_taken(request) for one in self.providers):
            outcome = Failure.NO_ANSWER
        for request_ended in self._request_ended:
            request_ended(request, outcome, now)
        if outcome not in (Failure.ABANDONED, Failure.HELD_BACK):  # else it is asked again
            begun, entry.begun = entry.begun, None
            try:
                entry.step = entry.steps.send(RequestEnd(outcome, now if begun is None else begun, now))
                entry.due = now + entry.step.pause_ns
            except StopIteration as end:
                self._end(entry, end.value, now)
                return
        if entry.over is not None:
            self._cut(entry, *entry.over, now)

    def _share(self, handler: SlaveHandler, request: Request, answer: Telegram, now: int) -> None:
        """Hand a diagnosis to the class 1 master too: some slaves show a fault in one diagnosis only
        (docs/reference/protocol.md#fault-shown-once)."""
        if handler.state is SlaveState.DATA_EXCHANGE:
            handler.service_result(request, answer, now)
        else:
            handler.diagnosis_seen(answer.data, now)

    def wake_at(self) -> int:
        """The next time limit of a service, or of a provider."""
        at = NEVER
        for entry in self._queue:
            at = min(at, entry.deadline)
        for wake_at in self._wakes:
            at = min(at, wake_at())
        return at

    def tick(self, now: int) -> None:
        """End the jobs whose time is over; a request under way ends first."""
        for tick in self._ticks:
            if tick(now):
                self._end_barred(now)
        for entry in [entry for entry in self._queue if entry.deadline <= now]:
            entry.deadline = NEVER
            self._cut(
                entry, ServiceFailure.LINE if self._no_line else ServiceFailure.LATE, self._why_late(entry, now), now
            )

    def _why_late(self, entry: _Entry, now: int) -> str:
        after = f"was not over after {ns_to_s(entry.timeout_ns):g} s"
        if self._no_line:
            return f"{after}: the port vanished ({self._no_line}); it can be repeated when the port is back"
        if self._tokens == entry.since:
            return f"{after}: this station was given no token in that time; see whether it is in the ring"
        if entry.step is None and (why := entry.job.held_up(now)):
            return f"{after}: {why}"
        if not entry.asked:
            return f"{after}: no token hold had time left for it; T_TR is too short, or too many services wait"
        return f"{after}; give it a longer timeout"

    def take_events(self) -> list[Event]:
        events = self.events.copy()
        self.events.clear()
        return events

    # --- ends ---------------------------------------------------------------------------------------------------
    def _cut(self, entry: _Entry, failure: ServiceFailure, what: str, now: int) -> None:
        """End a job early: at once, or with its request under way, whose answer may still complete the service."""
        if entry is self._asked:
            entry.over = (failure, what)
            return
        entry.steps.close()
        job = entry.job
        text = f"{job.title} to slave {job.address} {what}"
        if job.aftermath:
            text = f"{text}; {job.aftermath}"
        self._end(entry, Outcome(failure, text), now)

    def _end(self, entry: _Entry, outcome: Outcome, now: int) -> None:
        self._queue.remove(entry)
        self.events += entry.job.ends(entry.token, outcome, now)
