"""One class 2 connection at the master: what is known of it, and the course of every service over it.

How a slave is polled is :mod:`dpstack.dpv1.master.srd_polling`'s. Decisions where the sources leave something open:
docs/decisions/ms2.md#connections-at-the-master.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from dpstack.dp.acyclic.job import Outcome, ServiceFailure, Steps
from dpstack.dp.services import refusal_text
from dpstack.dpv1.master.srd_polling import NO_ANSWERS, Course, Said, said
from dpstack.dpv1.pdu.ms2 import HEAD, IDLE, Abort, AbortReason, Instance
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.timeouts import RESPONSE_TIMEOUT
from dpstack.errors import PduError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SSAP_MS2, Req, Telegram
from dpstack.units import ns_to_s

#: in place of a connection's token, which are not negative: what goes on at the resource manager of a slave
RESOURCE_MANAGER: Final = -1
#: what a slave is told that was not heard, or not in time
TIMED_OUT: Final = Abort(AbortReason.TIMEOUT)
#: the program does not want the connection any more
NOT_WANTED: Final = Abort(0, Instance.USER)
_SILENT: Final = {
    Failure.NO_ANSWER: "does not answer",
    Failure.GARBLED: "gives no readable answer to",
    Failure.WRONG: "gives answers that are none to",
}
_CHECK: Final = {
    Failure.NO_ANSWER: "check its power and the cable",
    Failure.GARBLED: "look for a second station with its address, and at cable and termination",
    Failure.WRONG: "look for a second station with its address",
}


class Phase(Enum):
    OPENING = "opening"
    OPEN = "open"
    ENDING = "ending"  # over for whoever used it; the slave is still to be told


class Ended(NamedTuple):
    """Why a service has no answer: ``outcome``. ``reason``: the connection is over with it, and why; empty: it is not.

    ``abort``: what the slave is to be told; None: it knows.
    """

    outcome: Outcome
    reason: str = ""
    abort: Abort | None = None


@dataclass(slots=True, eq=False)
class MasterConnection:
    """State of the connection ``ref`` to ``address``."""

    ref: int
    address: int
    send_timeout_ns: int
    response_ns: int
    server_sap: int | None = None
    max_len: int = 0
    phase: Phase = Phase.OPENING
    #: the slave was heard last
    heard_at: int = 0
    #: the slave may hold a connection for this master
    taken: bool = False
    #: a request was sent and its answer has not come
    outstanding: bool = False
    #: it was open once: its end is told
    opened: bool = False
    #: its end was ordered
    ordered: bool = False
    reason: str = ""
    abort: Abort | None = None
    #: answers to requests that nobody waited for any more
    stale: int = 0
    #: the last service: its slave's time is the same for whoever fetches the answer when it was given up
    last: Course | None = None

    @property
    def who(self) -> str:
        return f"slave {self.address}"

    @property
    def lane(self) -> tuple[int, int]:
        """Its services go one after the other; until it has its server SAP, all connections to the slave do: the
        resource manager has one answer, and what it names goes to who polls."""
        return self.address, RESOURCE_MANAGER if self.server_sap is None else self.ref

    @property
    def silent_text(self) -> str:
        """Why a silent one is over."""
        return f"nothing was heard of the slave for {ns_to_s(self.send_timeout_ns):g} s (the send time-out)"

    @property
    def limit_ns(self) -> int:
        """How long the slave has for one service."""
        return self.response_ns or max(self.send_timeout_ns, RESPONSE_TIMEOUT)

    @property
    def limit_text(self) -> str:
        of = "its C2_Response_Timeout" if self.response_ns else "no C2_Response_Timeout is known of it"
        return f"{ns_to_s(self.limit_ns):g} s ({of})"

    def started(self, request: Request) -> None:
        """The first bit of one of its requests is on the wire."""
        if request.data:
            self.outstanding = request.data[0] != Function.ABORT

    def heard(self, request: Request, answer: Telegram, now: int) -> None:
        """The slave answered one of its requests."""
        self.heard_at = now
        if request.data and said(answer, requested=True) is Said.AGAIN:
            self.outstanding = False

    # --- the course of a service ----------------------------------------------------------------------------------

    def course(self, sap: int, answer: int = HEAD) -> Course:
        """Of a service at ``sap`` with up to so many octets as its ``answer``."""

        def srd(octets: bytes) -> Request:  # high priority as all services of DP here; slaves take both (VPC3+)
            return Request(self.address, Req.SRD_HIGH, octets, sap, SSAP_MS2, answer=answer, tag=self)

        return Course(srd, self.limit_ns)

    def asked(self, course: Course, octets: bytes, title: str) -> Steps[bytes | Ended]:
        """Send ``octets`` to the server SAP (empty: poll only) until a PDU is there: Idle only as the answer to Idle.

        ``title``: for texts.
        """
        idle = octets[:1] == bytes((Function.IDLE,))
        self.last = course
        found = yield from course.requested(octets) if octets else course.polled()
        while True:
            match found:
                case Said.CLOSED:
                    return self._closed(title, course.answer)
                case Said.GUARDED:
                    return self._guarded(title)
                case Said.LATE:
                    return self._late(title, course.answer)
                case Said.DATA | Said.OLD:
                    pdu = self._read(course.pdu, title, idle=idle)
                    self.outstanding &= pdu is None
                    if found is Said.OLD and not isinstance(pdu, Ended):
                        self.stale += 1
                        found = yield from course.requested(octets)
                        continue
                    if pdu is not None:
                        return pdu
                    course.anew()
                case _:  # taken, or maybe taken
                    pass
            found = yield from self._idled(course) if idle else course.polled()

    def _idled(self, course: Course) -> Steps[Said]:
        """Polls for the answer to Idle. Where one of both may have been lost, and polls say for a third of the time
        that there is nothing, Idle is sent again: a slave that has it ignores the second (VPC3+)."""
        lost = not isinstance(course.answer, Telegram)
        octets = b""
        while True:
            found = yield from course.requested(octets) if octets else course.ask(octets)
            lost = lost or found is Said.NOTHING
            if found not in (Said.WAIT, Said.AGAIN, Said.NOTHING):
                return found
            again = lost and found is Said.WAIT and course.worked_ns >= min(self.send_timeout_ns, self.limit_ns) // 3
            octets = IDLE if again else b""
            if again:
                lost = False
                course.anew()

    @property
    def owed(self) -> Course | None:
        """The service that was given up without its answer, if any: before that is fetched the slave takes no other."""
        return self.last if self.outstanding else None

    def drained(self, owed: Course) -> Steps[Ended | None]:
        """Fetch the answer that nobody waits for any more."""
        found = yield from self.asked(owed, b"", "a service that was given up")
        if isinstance(found, Ended):
            return found
        self.stale += 1
        return None

    def _read(self, octets: bytes, title: str, *, idle: bool) -> bytes | Ended | None:
        """A PDU, the end that an Abort is, None for an Idle between."""
        if octets[0] == Function.IDLE:
            return octets if idle else None
        return self.aborted(octets, title) if octets[0] == Function.ABORT else octets

    def aborted(self, octets: bytes, title: str) -> Ended:
        self.taken = False
        try:
            self.abort = Abort.parse(octets)
        except PduError as error:
            return self._over(title, f"the slave aborted it, but why cannot be read: {error}")
        return self._over(title, f"the slave aborted it: {self.abort.text}")

    def unreadable(self, outcome: Outcome) -> Ended:
        """An answer that cannot be read ends the connection, too."""
        return Ended(outcome, "the slave answered what cannot be read", Abort(AbortReason.RESPONSE_PDU))

    def ended(self, title: str) -> Outcome:
        """The end of a service over a connection that is over."""
        codes = None if self.abort is None else (self.abort.subnet, self.abort.instance, self.abort.reason)
        text = f"{self.who}: {title} has no answer, the class 2 connection is over: {self.reason}"
        return Outcome(failure=ServiceFailure.ABORTED, text=text, codes=codes)

    def _closed(self, title: str, answer: Telegram | Failure) -> Ended:
        self.taken = False
        assert isinstance(answer, Telegram)
        what = f"the slave has closed server SAP {self.server_sap} ({refusal_text(answer)})"
        return self._over(title, f"{what}: it was restarted, or gave it up because it heard nothing for too long")

    def _over(self, title: str, reason: str) -> Ended:
        self.reason = reason
        return Ended(self.ended(title), reason)

    def _late(self, title: str, last: Telegram | Failure) -> Ended:
        """``last``: what came of the last poll."""
        if isinstance(last, Telegram):
            failure, what = ServiceFailure.LATE, "has no answer to"
            todo = "open a new one, with a longer response_timeout where it needs that"
        else:
            failure, what = NO_ANSWERS[last], _SILENT[last]
            todo = f"{_CHECK[last]}, then open a new one"
        text = f"{self.who} {what} {title} within {self.limit_text}; the connection was ended: {todo}"
        return Ended(Outcome(failure=failure, text=text), f"{title} had no answer in time", TIMED_OUT)

    def _guarded(self, title: str) -> Ended:
        text = f"{self.who}: {title} was not sent; this bus is read-only"
        return Ended(Outcome(failure=ServiceFailure.GUARDED, text=text))
