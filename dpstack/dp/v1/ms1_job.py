"""The course of one service at MS1, whichever it is: what an earlier one left behind, the request, polls, the end.

Read and Write are in :mod:`dpstack.dp.v1.ms1`, Alarm_Ack in :mod:`dpstack.dp.v1.alarm_ack`. Decisions where the
sources are silent:

- SC, NR and OK without data mean "not yet"; RR and UE "not now", and the request is repeated; RDL and RDH give away old
  data and have not taken the request (A3).
- An answer to another service is one to an earlier request: counted, dropped, polled again.
- A service that ended without its answer leaves one behind: it is fetched before the next request goes out, for as long
  as a slave may take for an answer, and shown to the service that it answers (:meth:`Ms1Job.late`).
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dpstack.dp.acyclic_job import ATTEMPTS, Outcome, ServiceFailure, Step, Steps
from dpstack.dp.ms0 import refusal_text
from dpstack.dp.slave_handler import SlaveHandler
from dpstack.dp.v1.judging import NO_ANSWERS, NOT_TAKEN, Said, said
from dpstack.dp.v1.times import BUSY_PAUSE, RESPONSE_TIMEOUT, pause_before, polls_within
from dpstack.fdl.telegram import SAP_MS1, Req, Telegram
from dpstack.fdl.user import Failure, Request
from dpstack.units import ns_to_s

if TYPE_CHECKING:
    from dpstack.dp.v1.ms1 import Ms1


@dataclass(frozen=True, slots=True)
class Owed:
    """The answer to a service that is over. ``since``: the slave was in data exchange since then."""

    since: int
    job: Ms1Job


class Ms1Job(abc.ABC):
    """One service of the slave that ``handler`` handles: ``octets`` to ``sap``, with up to ``longest`` octets back."""

    #: a request without any answer is repeated
    repeats = False
    #: what to do when it has no answer
    hint = "; try again"
    #: why the slave might refuse it altogether
    why_closed = ""

    def __init__(self, handler: SlaveHandler, ms1: Ms1, octets: bytes, longest: int, sap: int = SAP_MS1) -> None:
        self.address = handler.setup.address
        #: services at one SAP come one after the other
        self.lane: int | None = self.address | (0 if sap == SAP_MS1 else sap << 8)
        self.stale = 0
        self._octets = octets
        self._handler = handler
        self._ms1 = ms1
        self._sap = sap
        self._longest = longest
        self._since = handler.since
        self._busy = False
        self._sent = False
        told = 0 if handler.setup.dpv1 is None else handler.setup.dpv1.c1_response_timeout_ns
        self._limit_ns = told or RESPONSE_TIMEOUT
        self._limit_of = "its C1_Response_Timeout" if told else "no C1_Response_Timeout is known of it"

    @property
    @abc.abstractmethod
    def title(self) -> str:
        """What is asked."""

    @property
    def aftermath(self) -> str:
        """Nothing is known to have happened to the slave."""
        return ""

    @property
    def overdue(self) -> str:
        """After C1_Response_Timeout."""
        others = f", only {self.stale} to other requests" if self.stale else ""
        why = "it was busy all the time" if self._busy else "it exchanges data, but does not work at this service"
        return (
            f"had no answer{others} within {ns_to_s(self._limit_ns):g} s ({self._limit_of}): {why}; "
            f"try again, or give it longer (dpv1 = {{ response_timeout_ms = ... }})"
        )

    def bar(self) -> str:
        """See :meth:`~dpstack.dp.v1.ms1.Ms1.bar`."""
        why = self._ms1.bar(self._handler, self._since)
        return f"was given up: {why}" if why else ""

    # --- the course ---------------------------------------------------------------------------------------------

    def steps(self) -> Steps[Outcome]:
        """What an earlier service left behind, the request, then polls."""
        yield from self._fetch_owed()
        if self.settled:
            return Outcome()
        request = self._srd(self._octets)
        unanswered = pause = 0
        while True:
            self._sent = True
            self._owe()  # until there is an answer, whatever ends this service
            answer = yield Step(request, pause, self._limit_ns)
            pause = BUSY_PAUSE
            if not isinstance(answer, Telegram):
                unanswered += 1
                if answer is Failure.REFUSED or not self.repeats or unanswered == ATTEMPTS:
                    return self._unanswered(answer)
                continue
            heard, old = said(answer), answer.function in NOT_TAKEN
            self._busy = heard is Said.AGAIN and not old
            if old:
                self.stale += 1
            elif heard is Said.CLOSED:
                return self._refused(answer)
            elif heard is not Said.AGAIN:
                outcome = self._told(answer.data) if heard is Said.DATA else None
                if outcome is not None:
                    return outcome
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
            match said(answer):
                case Said.CLOSED:
                    return self._refused(answer)
                case Said.DATA:
                    outcome = self._told(answer.data)
                    if outcome is not None:
                        return outcome
                case _:
                    pass

    def _fetch_owed(self) -> Steps[None]:
        owed = self._ms1.owed  # until it is fetched, also where this service is cut short meanwhile
        debt = owed.get(self._lane)
        if debt is None or debt.since != self._since:
            return
        poll = self._srd(b"")
        for polls in range(polls_within(self._limit_ns)):
            answer = yield Step(poll, pause_before(polls))
            if isinstance(answer, Telegram) and answer.data:
                if not debt.job.late(answer.data):
                    self.stale += 1
                break
        owed.pop(self._lane, None)

    @property
    def _lane(self) -> int:
        assert self.lane is not None
        return self.lane

    def _owe(self) -> None:
        self._ms1.owed[self._lane] = Owed(self._since, self)

    def _srd(self, octets: bytes) -> Request:
        """High priority as all services of DP here; ``answer`` lets the budget of a fixed cycle know its length."""
        return Request(self.address, Req.SRD_HIGH, octets, self._sap, SAP_MS1, patient=True, answer=self._longest)

    # --- answers ------------------------------------------------------------------------------------------------

    @property
    def settled(self) -> bool:
        """What was left behind was its own answer, given to an earlier request: there is nothing to ask any more."""
        return False

    def late(self, octets: bytes) -> bool:
        """The slave's answer came after this service was over; True where that is still of use."""
        return False

    @abc.abstractmethod
    def judged(self, octets: bytes) -> Outcome | None:
        """The end that ``octets`` are (not empty), None where they answer another request."""

    def _told(self, octets: bytes) -> Outcome | None:
        outcome = self.judged(octets)
        if outcome is None:
            self.stale += 1
        else:
            self._answered()
        return outcome

    def _unanswered(self, why: Failure) -> Outcome:
        what, hint = "gives no readable answer to" if why is not Failure.NO_ANSWER else "does not answer", self.hint
        if why is Failure.REFUSED:
            what, hint = "was not sent", "; this bus is read-only"
            self._answered()
        return Outcome(failure=NO_ANSWERS[why], text=f"slave {self.address} {what} {self.title}{hint}")

    def _refused(self, answer: Telegram) -> Outcome:
        status = refusal_text(answer)
        text = f"slave {self.address} refuses {self.title} ({status}): SAP {self._sap} is closed; {self.why_closed}"
        self._answered()
        return Outcome(failure=ServiceFailure.REFUSED, text=text, status=status)

    def _answered(self) -> None:
        """It owes nothing."""
        self._ms1.owed.pop(self._lane, None)
