"""The services of a class 2 master, beside any class 1 master: Slave_Diag, Get_Cfg, RD_Inp, RD_Outp, Set_Slave_Add.

A user of the link layer with a low claim: one request a token hold, in time that is left. The queue is bounded, and
every service that was taken has exactly one end, a :class:`ServiceDone`, whatever happens: the slave's answer, its
silence, its refusal, a lost token, a lost port. (What the requests are is :mod:`dpstack.dp.class2_jobs`.)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from dpstack.dp.class2_address import AddressChange
from dpstack.dp.class2_jobs import Job, Outcome, Reading, Service, ServiceFailure, Step, Steps
from dpstack.dp.events import SlaveState
from dpstack.dp.master import Master
from dpstack.dp.ms0 import positive
from dpstack.dp.pdu import SetSlaveAdd
from dpstack.errors import PduError, UsageError
from dpstack.fdl.telegram import Telegram
from dpstack.fdl.user import Failure, Request
from dpstack.machine import LineDown
from dpstack.params import MAX_STATION, UNADDRESSED
from dpstack.trace import Event, Notice
from dpstack.units import NEVER, NS_PER_S, ns_to_s

#: services that may wait at a time
CAPACITY: Final = 32
READ_TIMEOUT: Final = 5 * NS_PER_S
#: a slave that restarts with its new address takes seconds
CHANGE_TIMEOUT: Final = 15 * NS_PER_S


@dataclass(frozen=True, slots=True)
class ReadService:
    """Ask ``address`` (0..126) for ``service``; ``expected`` as in :class:`~dpstack.dp.class2_jobs.Reading`.

    The result is the :class:`ServiceDone` with ``token``.
    """

    token: int
    address: int
    service: Service
    expected: int | None = None
    timeout_ns: int = READ_TIMEOUT


@dataclass(frozen=True, slots=True)
class ChangeAddress:
    """Give the slave at ``old`` (0..126) the address ``new`` (0..125); see :mod:`dpstack.dp.class2_address`."""

    token: int
    old: int
    new: int
    ident: int | None = None
    no_add_chg: bool = False
    rem_slave_data: bytes = b""
    timeout_ns: int = CHANGE_TIMEOUT


@dataclass(frozen=True, slots=True)
class CancelService:
    """Nobody waits for the service with ``token`` any more; one that is over already is no error."""

    token: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceDone(Event):
    """The one end of the service with ``token``."""

    token: int
    address: int
    service: Service
    outcome: Outcome

    @property
    def text(self) -> str:
        """What came of it."""
        done = f"slave {self.address}: {self.service.title}, {len(self.outcome.data)} octets"
        return done if self.outcome.failure is None else self.outcome.text


@dataclass(slots=True)
class _Entry:
    token: int
    job: Job
    deadline: int
    timeout_ns: int
    steps: Steps[Outcome]
    #: tokens received when it was taken
    since: int
    step: Step | None = None
    due: int = 0
    asked: bool = False
    #: it must end as soon as the request under way does
    over: tuple[ServiceFailure, str] | None = None


@dataclass(slots=True)
class Class2:
    """A ``LinkUser``. ``own``: the station's address. ``master``: the class 1 master of the same station, if any."""

    own: int
    master: Master | None = None
    _queue: list[_Entry] = field(default_factory=list)
    _asked: _Entry | None = None
    _turn: bool = False
    _tokens: int = 0
    #: stations whose last answer came: their silence is news, they are waited for
    _known: set[int] = field(default_factory=set)
    _events: list[Event] = field(default_factory=list)

    @property
    def waiting(self) -> int:
        """Services that have no end yet."""
        return len(self._queue)

    # --- orders -------------------------------------------------------------------------------------------------
    def command(self, command: object, now: int) -> bool:
        """Take ReadService, ChangeAddress and CancelService. Raises UsageError for what cannot be, or too much."""
        match command:
            case ReadService(token, address, service, expected, timeout_ns):
                if service is Service.SET_ADDRESS:
                    raise UsageError("Set_Slave_Add does not read: use ChangeAddress")
                self._check(address)
                self._take(token, Reading(address, service, expected), timeout_ns, now)
            case ChangeAddress(token, old, new, ident, no_add_chg, rem_slave_data, timeout_ns):
                self._check(old)
                self._check_new(old, new)
                try:
                    SetSlaveAdd(new, ident or 0, no_add_chg, rem_slave_data).build()
                except PduError as error:
                    raise UsageError(str(error)) from None
                job = AddressChange(self.own, old, new, ident, no_add_chg, rem_slave_data)
                self._take(token, job, timeout_ns, now)
            case CancelService(token):
                for entry in [entry for entry in self._queue if entry.token == token]:
                    self._cut(entry, ServiceFailure.CANCELLED, "was cancelled", now)
            case LineDown(reason):
                for entry in tuple(self._queue):
                    what = f"had no end when the port vanished ({reason}); it can be repeated when the port is back"
                    self._cut(entry, ServiceFailure.LINE, what, now)
                return False
            case _:
                return False
        return True

    def _check(self, address: int) -> None:
        if not 0 <= address <= UNADDRESSED:
            raise UsageError(f"{address} is no address of a slave: 0..{UNADDRESSED} ({UNADDRESSED}: as delivered)")
        if address == self.own:
            raise UsageError(f"{address} is the address of this master itself")

    def _check_new(self, old: int, new: int) -> None:
        if not 0 <= new <= MAX_STATION:
            raise UsageError(f"{new} is no address to give to a slave: 0..{MAX_STATION}")
        if new == self.own:
            raise UsageError(f"{new} is the address of this master itself: give the slave another one")
        if new == old:
            raise UsageError(f"the slave has address {new} already: nothing to do")
        if self.master is not None and old in self.master.handlers and self.master.handlers[old].owned:
            raise UsageError(
                f"slave {old} is parameterised by this master and takes no address meanwhile: "
                f"remove it from the bus first"
            )

    def _take(self, token: int, job: Job, timeout_ns: int, now: int) -> None:
        if len(self._queue) >= CAPACITY:
            raise UsageError(f"{CAPACITY} class 2 services are waiting already: await their results first")
        self._queue.append(_Entry(token, job, now + timeout_ns, timeout_ns, job.steps(), self._tokens))

    # --- link user ----------------------------------------------------------------------------------------------
    def token_received(self, now: int) -> None:
        """One request a hold."""
        self._turn = True
        self._tokens += 1

    def next_request(self, now: int, high_only: bool) -> Request | None:
        """The next request of the oldest service that may go on."""
        if high_only or not self._turn:
            return None
        for entry in self._queue:
            if entry.due <= now:
                break
        else:
            return None
        self._turn = False
        if entry.step is None:
            entry.step = next(entry.steps)
        self._asked = entry
        request = entry.step.request
        return request if request.patient else request._replace(patient=request.da in self._known)

    def started(self, request: Request, at: int) -> None:
        """It was given time."""
        if self._asked is not None:
            self._asked.asked = True

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """The end of a request: on with its service, or its end."""
        entry, self._asked = self._asked, None
        if entry is None:
            return
        if isinstance(outcome, Telegram):
            self._known.add(request.da)
            self._share(request, outcome, now)
        elif outcome is Failure.NO_ANSWER:
            self._known.discard(request.da)
        if outcome not in (Failure.ABANDONED, Failure.HELD_BACK):  # else it is asked again
            try:
                entry.step = entry.steps.send(outcome)
                entry.due = now + entry.step.pause_ns
            except StopIteration as end:
                self._end(entry, end.value, now)
                return
        if entry.over is not None:
            self._cut(entry, *entry.over, now)

    def _share(self, request: Request, answer: Telegram, now: int) -> None:
        """Some slaves show a fault in one diagnosis only (section I): their own master must not miss it."""
        if self.master is None or request.dsap != Service.DIAGNOSIS or not positive(request.dsap, answer):
            return
        handler = self.master.handlers.get(request.da)
        if handler is not None and handler.state is SlaveState.DATA_EXCHANGE:
            handler.service_result(request, answer, now)

    def wake_at(self) -> int:
        """When the time of a service is over."""
        return min((entry.deadline for entry in self._queue), default=NEVER)

    def tick(self, now: int) -> None:
        """End what had its time; a request under way is waited for."""
        for entry in [entry for entry in self._queue if entry.deadline <= now]:
            entry.deadline = NEVER
            self._cut(entry, ServiceFailure.LATE, self._why_late(entry), now)

    def _why_late(self, entry: _Entry) -> str:
        after = f"had no end after {ns_to_s(entry.timeout_ns):g} s"
        if self._tokens == entry.since:
            return f"{after}: this station was given no token in that time; see whether it is in the ring"
        if not entry.asked:
            return f"{after}: no token hold had time left for it; T_TR is too short, or too many services wait"
        return f"{after}; give it a longer timeout"

    def take_events(self) -> list[Event]:
        """The ends of services."""
        events, self._events = self._events, []
        return events

    # --- ends ---------------------------------------------------------------------------------------------------
    def _cut(self, entry: _Entry, failure: ServiceFailure, what: str, now: int) -> None:
        """An end from outside: at once, or with the request under way, whose answer may still be the better end."""
        if entry is self._asked:
            entry.over = (failure, what)
            return
        entry.steps.close()
        job = entry.job
        text = f"{job.service.title} to slave {job.address} {what}"
        if job.aftermath:
            text = f"{text}; {job.aftermath}"
        self._end(entry, Outcome(failure=failure, text=text), now)

    def _end(self, entry: _Entry, outcome: Outcome, now: int) -> None:
        self._queue.remove(entry)
        job = entry.job
        self._events.append(
            ServiceDone(t_ns=now, token=entry.token, address=job.address, service=job.service, outcome=outcome)
        )
        if isinstance(job, AddressChange) and outcome.failure is None:
            message = f"slave {job.address} has address {job.new} now" + (" for good" if job.no_add_chg else "")
            self._events.append(Notice(t_ns=now, source="class 2", message=message))
