"""Everything a station asks slaves beside the cycle: services of a class 2 master, DP-V1 (MS1, and MS2 connections).

A user of the link layer with a low claim: one request a token hold, in time that is left, whatever service it belongs
to; who waited longest for a turn comes first. The queue is bounded, and every service that was taken has exactly one
end, an event, whatever happens: the slave's answer, its silence, its refusal, a lost token, a lost port. (What the
services are is in :mod:`dpstack.dp.acyclic.class2`, :mod:`dpstack.dpv1.master.ms1` and
:mod:`dpstack.dpv1.master.ms2`.)

A slave that exchanges data and left a service unanswered is asked for no other before its next exchange: to the link
layer silence is silence, the next request to that station is a first one (FCV 0, FCB 1), and after three of these FCV
is probed (docs/protocol.md#slaves-that-know-only-fcv-1). A probe that carries the FCB of the request before is taken
for its repetition. That must never be a Data_Exchange, which several services in vain between two cycles would bring
about: the slave would be given up although it exchanges data.
"""

from __future__ import annotations

import itertools
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Final

from dpstack.dp.acyclic import class2
from dpstack.dp.acyclic.job import Heard, Job, Outcome, ServiceFailure, Step, Steps
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.services import positive
from dpstack.dpv1.master import plugin_jobs
from dpstack.dpv1.master.alarm_ack import ack_jobs
from dpstack.dpv1.master.ms1 import Ms1
from dpstack.dpv1.master.ms2 import Ms2
from dpstack.errors import UsageError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SAP_SLAVE_DIAG, Telegram
from dpstack.machine import LineDown
from dpstack.trace import Event
from dpstack.units import NEVER, ns_to_s

#: ends of a request that the link layer takes for silence
_IN_VAIN = frozenset((Failure.NO_ANSWER, Failure.GARBLED, Failure.WRONG))


class Unheard:
    """``master``: whose slaves they are; None: nobody's, and everybody may be asked."""

    __slots__ = ("_exchanges", "_master")

    def __init__(self, master: Master | None) -> None:
        self._master = master
        #: by address: the exchanges there were when it left a service unanswered
        self._exchanges: dict[int, int] = {}

    def ended(self, address: int, outcome: Telegram | Failure) -> None:
        """A service to ``address`` is over."""
        handler = None if self._master is None else self._master.handlers.get(address)
        if handler is not None and outcome in _IN_VAIN:
            self._exchanges[address] = handler.exchanges
        elif self._exchanges:
            self._exchanges.pop(address, None)

    def bars(self, address: int) -> bool:
        """Whether ``address`` is not to be asked now. In Stop nobody has an exchange to wait for."""
        if not self._exchanges or self._master is None or self._master.mode <= Mode.STOP:
            return False
        handler = self._master.handlers.get(address)
        if handler is None or handler.state is not SlaveState.DATA_EXCHANGE:
            return False
        return handler.exchanges == self._exchanges.get(address)


#: services that may wait at a time: of class 2 in all, of class 1 for each slave, for each connection
CAPACITY: Final = 32


#: the token of services that no program ordered: of cyclic units and connections; acknowledgements of alarms
UNORDERED: Final = -1
ACKS: Final = -2


@dataclass(frozen=True, slots=True)
class CancelService:
    """Nobody waits for the service with ``token`` any more; one that is over already is no error."""

    token: int


@dataclass(slots=True)
class _Entry:
    token: int
    job: Job
    deadline: int
    timeout_ns: int
    steps: Steps[Outcome]
    #: tokens received when it was taken
    since: int
    #: who has the lowest number is next
    turn: int
    step: Step | None = None
    due: int = 0
    asked: bool = False
    #: the first bit of the request of ``step`` was on the wire
    begun: int | None = None
    #: it must end as soon as the request under way does
    over: tuple[ServiceFailure, str] | None = None


@dataclass(slots=True)
class Acyclic:
    """A ``LinkUser``. ``own``: the station's address. ``master``: the class 1 master of the same station, if any."""

    own: int
    master: Master | None = None
    _queue: list[_Entry] = field(default_factory=list)
    _asked: _Entry | None = None
    _turn: bool = False
    _tokens: int = 0
    #: why there is no line, until the next token
    _no_line: str = ""
    #: stations whose last answer came: their silence is news, they are waited for
    _known: set[int] = field(default_factory=set)
    _events: list[Event] = field(default_factory=list)
    _ms1: Ms1 = field(init=False)
    _ms2: Ms2 = field(init=False)
    _unheard: Unheard = field(init=False)
    _turns: itertools.count[int] = field(default_factory=itertools.count)

    def __post_init__(self) -> None:
        self._ms1 = Ms1(self.own, self.master)
        self._ms2 = Ms2(self.own, self.master)
        self._unheard = Unheard(self.master)

    @property
    def waiting(self) -> int:
        """Services that are not over yet."""
        return len(self._queue)

    @property
    def connections(self) -> int:
        """Class 2 connections that slaves may hold for this master."""
        return len(self._ms2.connections)

    # --- orders -------------------------------------------------------------------------------------------------
    def command(self, command: object, now: int) -> bool:
        """Take the orders of :mod:`dpstack.dp.acyclic.class2`, :mod:`dpstack.dpv1.master.ms1`,
        :mod:`dpstack.dpv1.master.alarm_events`, :mod:`dpstack.dpv1.master.ms2_commands`, and CancelService.

        Raises UsageError for what cannot be, or too much.
        """
        match command:
            case CancelService(token):
                for entry in [entry for entry in self._queue if entry.token == token]:
                    self._cut(entry, ServiceFailure.CANCELLED, "was cancelled", now)
            case LineDown(reason):
                self._no_line = reason
                for entry in tuple(self._queue):
                    what = f"was not over when the port vanished ({reason}); it can be repeated when the port is back"
                    self._cut(entry, ServiceFailure.LINE, what, now)
                self._ms2.line_down(reason, now)
                self._take_wanted(now)
                return False
            case _:
                order = self._job_of(command)
                if order is not None:
                    self._take(*order, now)
                elif not (self._ms1.command(command, now) or self._ms2.command(command, now)):
                    return False
        self._take_wanted(now)
        return True

    def _job_of(self, command: object) -> tuple[int, Job, int] | None:
        """Token, job and time-out of a service, whichever way it goes."""
        order = class2.job_of(command, self.own, self.master)
        return order or self._ms1.job_of(command) or self._ms2.job_of(command)

    def _take(self, token: int, job: Job, timeout_ns: int, now: int) -> None:
        if not self._room(job.lane):
            what = "class 2 services are" if job.lane is None else f"services for slave {job.address} are"
            raise UsageError(f"{CAPACITY} {what} waiting already: await their results first")
        self._queue.append(self._entry(token, job, timeout_ns, now))

    def _entry(self, token: int, job: Job, timeout_ns: int, now: int) -> _Entry:
        return _Entry(token, job, now + timeout_ns, timeout_ns, job.steps(), self._tokens, next(self._turns))

    def _take_wanted(self, now: int) -> None:
        """What connections have to say that nobody ordered."""
        wanted = self._ms2.wanted
        while wanted:
            job, timeout_ns = wanted.pop(0)
            self._put_first(self._entry(UNORDERED, job, timeout_ns, now))

    def _put_first(self, new: _Entry) -> None:
        """Before those in its lane that have not begun: a slave may have no further alarm until it is acknowledged, and
        names the connections that it gave out in their order."""
        begun = [entry.job.lane == new.job.lane and entry.step is not None for entry in self._queue]
        at = begun.index(True) + 1 if True in begun else 0
        self._queue.insert(at, new)

    def _room(self, lane: Hashable | None) -> bool:
        return sum(entry.job.lane == lane and entry.token != ACKS for entry in self._queue) < CAPACITY

    # --- link user ----------------------------------------------------------------------------------------------
    def token_received(self, now: int) -> None:
        """One request a hold. What a slave cannot answer any more ends here."""
        self._turn = True
        self._tokens += 1
        self._no_line = ""
        if self._queue:
            self._end_barred(now)

    def next_request(self, now: int, high_only: bool) -> Request | None:
        """The next request of the service that waited longest for a turn, of those that may go on."""
        if high_only or not self._turn:
            return None
        asking = self._ms1.asking()
        if asking:
            self._take_asked(asking, now)
        if self._ms2.connections:
            self._keep_alive(now)
        if not self._queue:
            return None
        self._end_barred(now)
        entry = self._next(now)
        if entry is None:
            return None
        self._turn = False
        if entry.step is None:
            entry.step = next(entry.steps)
        self._asked = entry
        request = entry.step.request
        return request if request.patient else request._replace(patient=request.da in self._known)

    def _take_asked(self, handlers: list[SlaveHandler], now: int) -> None:
        """What a unit wants since the Data_Exchange of this hold goes out in the same one."""
        for ack in ack_jobs(handlers, self._ms1, now):
            self._put_first(self._entry(ACKS, ack, ack.timeout_ns, now))
        for handler, queue in plugin_jobs.asking(handlers):
            if (
                self._room(handler.setup.address)
                and (job := plugin_jobs.unit_job(self._ms1, handler, queue)) is not None
            ):
                self._take(UNORDERED, job, job.timeout_ns, now)

    def _keep_alive(self, now: int) -> None:
        for job in tuple(self._ms2.quiet({entry.job.lane for entry in self._queue}, now)):
            self._queue.append(self._entry(UNORDERED, job, job.timeout_ns, now))

    def _next(self, now: int) -> _Entry | None:
        """Services with the same lane come one after the other: the queue is in the order of their orders."""
        chosen: _Entry | None = None
        lanes: set[Hashable] = set()
        for entry in self._queue:
            lane = entry.job.lane
            if lane is not None:
                if lane in lanes:
                    continue
                lanes.add(lane)
            if entry.due <= now and (chosen is None or entry.turn < chosen.turn):
                chosen = chosen if self._unheard.bars(entry.job.address) else entry
        return chosen

    def _end_barred(self, now: int) -> None:
        for entry in tuple(self._queue):
            bar = entry.job.bar()
            if bar and entry is not self._asked:
                self._cut(entry, ServiceFailure.CLOSED, bar, now)

    def started(self, request: Request, at: int) -> None:
        """It was given time."""
        entry = self._asked
        self._ms2.started(request)
        if entry is not None:
            entry.asked = True
            entry.turn = next(self._turns)
            entry.begun = at

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """The end of a request: on with its service, or its end."""
        entry, self._asked = self._asked, None
        if entry is None:
            return
        self._unheard.ended(request.da, outcome)
        if isinstance(outcome, Telegram):
            self._known.add(request.da)
            self._share(request, outcome, now)
        elif outcome is Failure.NO_ANSWER:
            self._known.discard(request.da)
        elif outcome is Failure.ABANDONED and self._ms2.may_be_taken(request):
            outcome = Failure.NO_ANSWER
        self._ms1.heard(request, outcome)
        self._ms2.heard(request, outcome, now)
        if outcome not in (Failure.ABANDONED, Failure.HELD_BACK):  # else it is asked again
            begun, entry.begun = entry.begun, None
            try:
                entry.step = entry.steps.send(Heard(outcome, now if begun is None else begun, now))
                entry.due = now + entry.step.pause_ns
            except StopIteration as end:
                self._end(entry, end.value, now)
                return
        if entry.over is not None:
            self._cut(entry, *entry.over, now)

    def _share(self, request: Request, answer: Telegram, now: int) -> None:
        """Some slaves show a fault in one diagnosis only (docs/protocol.md#fault-shown-once): their own master must not
        miss it."""
        if self.master is None or request.dsap != SAP_SLAVE_DIAG or not positive(request.dsap, answer):
            return
        handler = self.master.handlers.get(request.da)
        if handler is None:
            return
        if handler.state is SlaveState.DATA_EXCHANGE:
            handler.service_result(request, answer, now)
        else:
            handler.diagnosis_seen(answer.data, now)

    def wake_at(self) -> int:
        """When the time of a service is over."""
        services = NEVER
        for entry in self._queue:
            services = min(services, entry.deadline)
        return min(services, self._ms2.wake_at()) if self._ms2.connections else services

    def tick(self, now: int) -> None:
        """End what had its time; a request under way is waited for."""
        if self._ms2.tick(now):
            self._end_barred(now)
            self._take_wanted(now)
        for entry in [entry for entry in self._queue if entry.deadline <= now]:
            entry.deadline = NEVER
            self._cut(entry, ServiceFailure.LINE if self._no_line else ServiceFailure.LATE, self._why_late(entry), now)

    def _why_late(self, entry: _Entry) -> str:
        after = f"was not over after {ns_to_s(entry.timeout_ns):g} s"
        if self._no_line:
            return f"{after}: the port vanished ({self._no_line}); it can be repeated when the port is back"
        if self._tokens == entry.since:
            return f"{after}: this station was given no token in that time; see whether it is in the ring"
        if not entry.asked:
            return f"{after}: no token hold had time left for it; T_TR is too short, or too many services wait"
        return f"{after}; give it a longer timeout"

    def take_events(self) -> list[Event]:
        """The ends of services."""
        events, self._events = self._events, []
        if self._ms2.told:
            events += self._ms2.take_events()
        return events

    # --- ends ---------------------------------------------------------------------------------------------------
    def _cut(self, entry: _Entry, failure: ServiceFailure, what: str, now: int) -> None:
        """An end from outside: at once, or with the request under way, whose answer may still be the better end."""
        if entry is self._asked:
            entry.over = (failure, what)
            return
        entry.steps.close()
        job = entry.job
        text = f"{job.title} to slave {job.address} {what}"
        if job.aftermath:
            text = f"{text}; {job.aftermath}"
        self._end(entry, Outcome(failure=failure, text=text), now)

    def _end(self, entry: _Entry, outcome: Outcome, now: int) -> None:
        self._queue.remove(entry)
        self._events += entry.job.ends(entry.token, outcome, now)
        self._take_wanted(now)
