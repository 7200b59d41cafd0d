"""The course of one service at MS1, whichever it is: what an earlier one left behind, the request, polls, the end.

Read and Write are in :mod:`dpstack.dpv1.master.ms1`, Alarm_Ack in :mod:`dpstack.dpv1.master.alarm_ack`, how a slave is
polled in :mod:`dpstack.dpv1.master.srd_polling`. Decisions where the sources leave something open:
docs/decisions/services.md#ms1-at-the-master.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass

from dpstack.dp.acyclic.job import ATTEMPTS, Outcome, ServiceFailure, Steps
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.services import refusal_text
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.srd_polling import NO_ANSWERS, Course, Said
from dpstack.dpv1.timeouts import RESPONSE_TIMEOUT, service_timeout
from dpstack.errors import UsageError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SAP_MS1, Req, Telegram
from dpstack.units import ns_to_s


@dataclass(frozen=True, slots=True)
class Owed:
    """The answer to a service that is over. ``since``: the slave was in data exchange since then. ``course``: how it is
    fetched, by whoever comes next."""

    since: int
    job: Ms1Job
    course: Course


def need_dpv1(setup: SlaveParams, *, read_only: bool) -> None:
    """Raises UsageError for a slave that has no Read, Write and alarms of this master."""
    if read_only:
        raise UsageError("this bus is read-only: its slaves are not in data exchange with it; leave read_only out")
    if setup.dpv1 is None:
        raise UsageError(
            f"slave {setup.address} ({setup.name}) is not parameterised for DP-V1: no Read, Write, alarms; "
            f"if it has them put dpv1 = true into its [[slave]] table"
        )


class Ms1Access:
    """MS1 between ``master`` and its slaves: who can be asked, and the answers to services that are over."""

    def __init__(self, master: Master | None) -> None:
        self.master = master
        #: answers to services which are over, by lane
        self.owed: dict[int, Owed] = {}

    def slave(self, address: int) -> SlaveHandler:
        """The slave's, whatever it is parameterised for. Raises UsageError."""
        handlers = {} if self.master is None else self.master.handlers
        if address not in handlers:
            raise UsageError(f"station {address} is no slave of this master: MS1 is between a slave and its own master")
        return handlers[address]

    def handler(self, address: int) -> SlaveHandler:
        """The slave's, where it is parameterised for DP-V1. Raises UsageError."""
        handler = self.slave(address)
        need_dpv1(handler.setup, read_only=self.master is not None and self.master.settings.read_only)
        return handler

    def bar(self, handler: SlaveHandler, since: int) -> str:
        """Why no service to the slave of ``handler``, in data exchange ``since`` then, can end: MS1 closes on leaving
        data exchange (docs/protocol.md#ms1), and in Stop nothing is sent to slaves. Empty while it can.
        """
        master = self.master
        if master is None or master.handlers.get(handler.setup.address) is not handler:
            return "the slave was removed from this bus, or parameterised anew; repeat it afterwards"
        if master.mode <= Mode.STOP:
            mode = master.mode.name.capitalize()
            return f"the master is in {mode}, where nothing is sent to slaves; repeat it in Clear or Operate"
        state = handler.state
        if state is SlaveState.DATA_EXCHANGE and handler.since == since:
            return ""
        why = "" if handler.fault is None else f" ({handler.fault.text})"
        if state is SlaveState.DATA_EXCHANGE:
            return f"the slave left data exchange{why} and came back; repeat it"
        return f"the slave is not in data exchange but in {state.value}{why}; repeat it when it is"


class Ms1Job(abc.ABC):
    """One service of the slave that ``handler`` handles: ``octets`` to ``sap``, with up to ``longest`` octets back."""

    #: a request without any answer is repeated
    repeats = False
    #: what to do when it has no answer
    hint = "; try again"
    #: why the slave might refuse it altogether
    why_closed = ""

    def __init__(self, handler: SlaveHandler, ms1: Ms1Access, octets: bytes, longest: int, sap: int = SAP_MS1) -> None:
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
        self._sent = False
        told = 0 if handler.setup.dpv1 is None else handler.setup.dpv1.c1_response_timeout_ns
        self._limit_ns = told or RESPONSE_TIMEOUT
        self._limit_of = "its C1_Response_Timeout" if told else "no C1_Response_Timeout is known of it"

    @property
    @abc.abstractmethod
    def title(self) -> str: ...

    @property
    def aftermath(self) -> str:
        """Nothing is known to have happened to the slave."""
        return ""

    def bar(self) -> str:
        """See :meth:`~dpstack.dpv1.master.ms1_job.Ms1Access.bar`."""
        why = self._ms1.bar(self._handler, self._since)
        return f"was given up: {why}" if why else ""

    @property
    def timeout_ns(self) -> int:
        """How long it may wait and take where no program says so."""
        return service_timeout(self._limit_ns)

    # --- the course ---------------------------------------------------------------------------------------------

    def steps(self) -> Steps[Outcome]:
        """What an earlier service left behind, the request, then polls."""
        yield from self._fetch_owed()
        if self.settled:
            return Outcome()
        course = Course(self._srd, self._limit_ns)
        attempts = ATTEMPTS if self.repeats else 1
        self._sent = True
        owed = Owed(self._since, self, Course(self._srd, self._limit_ns))
        self._ms1.owed[self._lane] = owed  # until there is an answer, whatever ends this service
        found = yield from course.requested(self._octets, attempts)
        while True:
            match found:
                case Said.OLD:
                    self.stale += 1
                    found = yield from course.requested(self._octets, attempts)
                case Said.WAIT:
                    found = yield from course.polled(ATTEMPTS)
                case Said.DATA:
                    outcome = self._told(course.pdu)
                    if outcome is not None:
                        return outcome
                    found = yield from course.polled(ATTEMPTS)
                case _:
                    return self._unserved(found, course)

    def _fetch_owed(self) -> Steps[None]:
        owed = self._ms1.owed  # until it is fetched, also where this service is cut short meanwhile
        debt = owed.get(self._lane)
        if debt is None or debt.since != self._since:
            return
        if (yield from debt.course.polled()) is Said.DATA and not debt.job.late(debt.course.pdu):
            self.stale += 1
        owed.pop(self._lane, None)

    @property
    def _lane(self) -> int:
        assert self.lane is not None
        return self.lane

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

    def _unserved(self, found: Said, course: Course) -> Outcome:
        """The end without an answer to it."""
        who = f"slave {self.address}"
        match found, course.answer:
            case Said.GUARDED, _:
                self._answered()
                text = f"{who} was not sent {self.title}; this bus is read-only"
                return Outcome(failure=ServiceFailure.GUARDED, text=text)
            case Said.NOTHING, Failure() as why:
                what = "does not answer" if why is Failure.NO_ANSWER else "gives no readable answer to"
                return Outcome(failure=NO_ANSWERS[why], text=f"{who} {what} {self.title}{self.hint}")
            case Said.CLOSED, Telegram() as answer:
                self._answered()
                status = refusal_text(answer)
                text = f"{who} refuses {self.title} ({status}): SAP {self._sap} is closed; {self.why_closed}"
                return Outcome(failure=ServiceFailure.REFUSED, text=text, status=status)
            case _:
                return Outcome(failure=ServiceFailure.LATE, text=self._late(course))

    def _late(self, course: Course) -> str:
        others = f", only {self.stale} to other requests" if self.stale else ""
        why = "it was busy all the time" if course.busy else "it exchanges data, but does not work at this service"
        return (
            f"{self.title} to slave {self.address} had no answer{others} within {ns_to_s(self._limit_ns):g} s "
            f"({self._limit_of}): {why}; try again, or give it longer (dpv1 = {{ response_timeout_ms = ... }})"
        ) + (f"; {self.aftermath}" if self.aftermath else "")

    def _answered(self) -> None:
        self._ms1.owed.pop(self._lane, None)
