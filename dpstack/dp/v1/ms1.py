"""Read and Write of a class 1 master to its slaves (MS1): DSAP 51, SSAP 51, open while the slave is in data exchange.

The request is one SRD. The slave answers in it at once, or acknowledges and is polled with empty SRDs; both are legal
(protocol facts C3, I). One service per slave is outstanding, others wait. What is to be asked when is
:mod:`dpstack.dp.acyclic`'s.

Decisions where the sources are silent:

- SC, NR and OK without data mean "not yet"; RR and UE "not now", and the request is repeated; RDL and RDH give away old
  data and have not taken the request (A3).
- An answer to another service, slot or index is one to an earlier request: counted, dropped, polled again.
- A service that ended without its answer leaves one behind: it is fetched before the next request goes out, for as long
  as a slave may take for an answer.
- A Read without any answer is repeated, a Write is not: it may have been carried out, which is said.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Final

from dpstack.dp.class2_jobs import ATTEMPTS, Job, Outcome, ServiceFailure, Step, Steps
from dpstack.dp.commands import Mode
from dpstack.dp.events import SlaveState
from dpstack.dp.master import Master
from dpstack.dp.ms0 import DATA_STATUS, refusal_text
from dpstack.dp.slave_handler import SlaveHandler
from dpstack.dp.v1.judging import (
    BUSY_PAUSE,
    NO_ANSWERS,
    NOT_NOW,
    NOT_TAKEN,
    NOT_YET,
    PAUSES,
    pause_before,
    service_outcome,
    title_of,
)
from dpstack.dp.v1.records import MAX_RECORD, Function, ReadReq, RecordReq, WriteReq
from dpstack.errors import PduError, UsageError
from dpstack.fdl.telegram import SAP_MS1, Kind, Req, Telegram
from dpstack.fdl.user import Failure, Request
from dpstack.trace import Event
from dpstack.units import NS_PER_S, ns_to_s

#: where the GSD file has no C1_Response_Timeout
RESPONSE_TIMEOUT: Final = NS_PER_S
#: from the order to the end, the time that others take included
SERVICE_TIMEOUT: Final = 10 * NS_PER_S
_HEAD: Final = 4


@dataclass(frozen=True, slots=True)
class ReadRecord:
    """Read up to ``length`` octets of a record of the slave at ``address``; the end is the RecordDone with ``token``.

    ``timeout_ns`` counts from the order, the slave's own time-out from the request.
    """

    token: int
    address: int
    slot: int
    index: int
    length: int = MAX_RECORD
    timeout_ns: int = SERVICE_TIMEOUT


@dataclass(frozen=True, slots=True)
class WriteRecord:
    """Write ``data``, otherwise as :class:`ReadRecord`."""

    token: int
    address: int
    slot: int
    index: int
    data: bytes
    timeout_ns: int = SERVICE_TIMEOUT


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordDone(Event):
    """The one end of the Read or Write with ``token``; the data read are in ``outcome``.

    ``stale``: answers to other requests that came before it.
    """

    token: int
    address: int
    write: bool
    slot: int
    index: int
    outcome: Outcome
    stale: int = 0

    @property
    def service(self) -> str:
        """Read or Write."""
        return (Function.WRITE if self.write else Function.READ).title

    @property
    def text(self) -> str:
        """What came of it."""
        if self.outcome.failure is not None:
            return self.outcome.text
        where = f"slave {self.address}: {self.service} of slot {self.slot}, index {self.index}"
        return f"{where} done" if self.write else f"{where}, {len(self.outcome.data)} octets"


@dataclass(slots=True)
class Ms1:
    """Makes jobs of orders. ``master``: whose slaves they are for."""

    own: int
    master: Master | None
    #: slaves that owe the answer to a service which is over, and since when they were in data exchange then
    owed: dict[int, int] = field(default_factory=dict)

    def job_of(self, order: object) -> tuple[int, Job, int] | None:
        """Token, job and time-out in ns of ``order``; None when it is none for MS1. Raises UsageError."""
        match order:
            case ReadRecord(token, address, slot, index, length, timeout_ns):
                request: RecordReq = ReadReq(slot, index, length)
            case WriteRecord(token, address, slot, index, data, timeout_ns):
                request = WriteReq(slot, index, data)
            case _:
                return None
        try:
            octets = request.build()
        except PduError as error:
            raise UsageError(str(error)) from None
        return token, RecordJob(address, request, octets, self._handler(address), self), timeout_ns

    def _handler(self, address: int) -> SlaveHandler:
        handlers = {} if self.master is None else self.master.handlers
        handler = handlers.get(address)
        if handler is None:
            raise UsageError(f"station {address} is no slave of this master: MS1 is between a slave and its own master")
        if self.master is not None and self.master.read_only:
            raise UsageError("this bus is read-only: its slaves are not in data exchange with it; leave read_only out")
        if handler.setup.dpv1 is None:
            raise UsageError(
                f"slave {address} ({handler.setup.name}) is not parameterised for DP-V1, Read and Write are closed; "
                f"if it has them put dpv1 = true into its [[slave]] table"
            )
        return handler

    def bar(self, handler: SlaveHandler, since: int) -> str:
        """Why no service to the slave of ``handler``, in data exchange ``since`` then, can end: MS1 closes on leaving
        data exchange (section J), and in Stop nothing is sent to slaves. Empty while it can.
        """
        master = self.master
        if master is None or master.handlers.get(handler.setup.address) is not handler:
            return "the slave was removed from this bus, or parameterised anew; repeat it afterwards"
        if master.mode <= Mode.STOP:
            return f"the master is in {master.mode.name.capitalize()}, where nothing is sent to slaves"
        state = handler.state
        if state is SlaveState.DATA_EXCHANGE and handler.since == since:
            return ""
        why = "" if handler.fault is None else f" ({handler.fault.text})"
        if state is SlaveState.DATA_EXCHANGE:
            return f"the slave left data exchange{why} and came back; repeat it"
        return f"the slave is not in data exchange but in {state.value}{why}; repeat it when it is"


class RecordJob:
    """One Read or Write, to the slave that ``handler`` handles."""

    #: nothing is known to have happened to the slave
    aftermath = ""

    def __init__(self, address: int, request: RecordReq, octets: bytes, handler: SlaveHandler, ms1: Ms1) -> None:
        self.address = address
        self.lane: Hashable | None = address
        self._request = request
        self._octets = octets
        self._handler = handler
        self._ms1 = ms1
        self._since = handler.since
        self._stale = 0
        self._busy = False
        self._write = isinstance(request, WriteReq)
        told = 0 if handler.setup.dpv1 is None else handler.setup.dpv1.c1_response_timeout_ns
        self._limit_ns = told or RESPONSE_TIMEOUT
        self._limit_of = "its C1_Response_Timeout" if told else "no C1_Response_Timeout is known of it"
        self._answer = _HEAD if isinstance(request, WriteReq) else _HEAD + request.length

    @property
    def title(self) -> str:
        """With slot and index: they are what a reader looks for."""
        return title_of(self._request)

    @property
    def overdue(self) -> str:
        """After C1_Response_Timeout."""
        others = f", only {self._stale} to other requests" if self._stale else ""
        why = "it was busy all the time" if self._busy else "it exchanges data, but does not work at this record"
        return (
            f"had no answer{others} within {ns_to_s(self._limit_ns):g} s ({self._limit_of}): {why}; "
            f"try again, or give it longer (dpv1 = {{ response_timeout_ms = ... }})"
        )

    def bar(self) -> str:
        """See :meth:`Ms1.bar`."""
        why = self._ms1.bar(self._handler, self._since)
        return f"has no end: {why}" if why else ""

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """One event."""
        request = self._request
        return [
            RecordDone(
                t_ns=now,
                token=token,
                address=self.address,
                write=self._write,
                slot=request.slot,
                index=request.index,
                outcome=outcome,
                stale=self._stale,
            )
        ]

    # --- the course ---------------------------------------------------------------------------------------------

    def steps(self) -> Steps[Outcome]:
        """What an earlier service left behind, the request, then polls."""
        yield from self._fetch_owed()
        owed = self._ms1.owed
        request = self._srd(self._octets)
        unanswered = pause = 0
        while True:
            owed[self.address] = self._since  # until there is an answer, whatever ends this service
            answer = yield Step(request, pause, self._limit_ns)
            pause = BUSY_PAUSE
            if not isinstance(answer, Telegram):
                unanswered += 1
                if answer is Failure.REFUSED or self._write or unanswered == ATTEMPTS:
                    return self._unanswered(answer)
                continue
            self._busy = answer.function in NOT_NOW
            if answer.kind is Kind.SC or answer.function in NOT_YET:
                break
            if answer.function in DATA_STATUS:
                outcome = self._judged(answer.data)
                if outcome is not None:
                    return outcome
                break
            if answer.function not in NOT_NOW and answer.function not in NOT_TAKEN:
                return self._refused(answer)
            self._stale += answer.function in NOT_TAKEN
        return (yield from self._polled())

    def _polled(self) -> Steps[Outcome]:
        poll = self._srd(b"")
        unanswered = polls = 0
        while True:
            answer = yield Step(poll, pause_before(polls))
            polls += 1
            if not isinstance(answer, Telegram):
                unanswered += 1
                if answer is Failure.REFUSED or unanswered == ATTEMPTS:
                    return self._unanswered(answer)
                continue
            unanswered = 0
            if answer.kind is Kind.SC or answer.function in NOT_YET or answer.function in NOT_NOW:
                continue
            if answer.function not in DATA_STATUS and answer.function not in NOT_TAKEN:
                return self._refused(answer)
            outcome = self._judged(answer.data)
            if outcome is not None:
                return outcome

    def _fetch_owed(self) -> Steps[None]:
        owed = self._ms1.owed  # until it is fetched, also where this service is cut short meanwhile
        if owed.get(self.address) != self._since:
            return
        poll = self._srd(b"")
        for polls in range(self._limit_ns // PAUSES[-1] + 1):
            answer = yield Step(poll, pause_before(polls))
            if isinstance(answer, Telegram) and answer.data:
                self._stale += 1
                break
        owed.pop(self.address, None)

    def _srd(self, octets: bytes) -> Request:
        """High priority as all services of DP here; ``answer`` lets the budget of a fixed cycle know its length."""
        return Request(self.address, Req.SRD_HIGH, octets, SAP_MS1, SAP_MS1, patient=True, answer=self._answer)

    # --- answers ------------------------------------------------------------------------------------------------

    def _judged(self, octets: bytes) -> Outcome | None:
        """The end that ``octets`` are, None where they answer another request."""
        if not octets:
            return None
        outcome = service_outcome(self.address, self._request, octets)
        if outcome is None:
            self._stale += 1
        else:
            self._answered()
        return outcome

    def _unanswered(self, why: Failure) -> Outcome:
        what = "gives no readable answer to" if why is not Failure.NO_ANSWER else "does not answer"
        maybe = "; it may have been carried out: read it back" if self._write else "; try again"
        if why is Failure.REFUSED:
            what, maybe = "was not sent", "; this bus is read-only"
            self._ms1.owed.pop(self.address, None)
        return Outcome(failure=NO_ANSWERS[why], text=f"slave {self.address} {what} {self.title}{maybe}")

    def _refused(self, answer: Telegram) -> Outcome:
        status = refusal_text(answer)
        text = (
            f"refuses {self.title} ({status}): SAP {SAP_MS1} is closed; it has no Read and Write (C1_Read_Write_supp "
            f"of its GSD file), or takes them only with other parameters"
        )
        self._answered()
        return Outcome(failure=ServiceFailure.REFUSED, text=f"slave {self.address} {text}", status=status)

    def _answered(self) -> None:
        """It owes nothing."""
        self._ms1.owed.pop(self.address, None)
