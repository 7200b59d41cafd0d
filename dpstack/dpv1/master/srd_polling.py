"""Polling of a slave for one service of DP-V1, at MS1 or over a class 2 connection, and the check of its answer.

The master sends SRDs with the request until the slave takes it, then empty ones until the answer is there
(docs/reference/protocol.md#ms1, docs/reference/protocol.md#ms2). Decisions on points that the sources leave open:
docs/reference/decisions/services.md#polling.

The jobs decide what silence means: :mod:`dpstack.dpv1.master.ms1`, :mod:`dpstack.dpv1.master.ms2_connection`,
:mod:`dpstack.dpv1.master.ms2`.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Final

from dpstack.dp.acyclic.job import BUSY_PAUSE, Outcome, ServiceFailure, Step, Steps, pause_after_silence
from dpstack.dp.services import DATA_STATUS
from dpstack.dpv1.pdu.error_codes import Decode, remedy
from dpstack.dpv1.pdu.read_write import (
    DataTransport,
    Function,
    Negative,
    ReadReq,
    ReadRes,
    Service,
    WriteReq,
    parse_response,
)
from dpstack.dpv1.timeouts import pause_before
from dpstack.errors import PduError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Kind, Resp, Telegram
from dpstack.text import octets_text
from dpstack.units import NEVER

#: old data are given away, and the request was not taken
_NOT_TAKEN: Final = frozenset((int(Resp.RDL), int(Resp.RDH)))
#: FC status of an answer with a PDU
_WITH_PDU: Final = DATA_STATUS | _NOT_TAKEN
#: without one: "not yet", to a request or a poll
_NOT_YET: Final = DATA_STATUS | {int(Resp.OK), int(Resp.NR)}
#: "not now": the request was not taken
_NOT_NOW: Final = _NOT_TAKEN | {int(Resp.RR), int(Resp.UE)}

#: failures of a service without any usable answer
NO_ANSWERS: Final = {
    Failure.NO_ANSWER: ServiceFailure.SILENT,
    Failure.GARBLED: ServiceFailure.UNREADABLE,
    Failure.WRONG: ServiceFailure.WRONG,
    Failure.REFUSED: ServiceFailure.GUARDED,
}


class Reply(Enum):
    """The result of one request or poll."""

    DATA = "data"  # a PDU
    OLD = "old"  # a PDU of an earlier service; the slave did not take the request
    WAIT = "wait"  # acknowledged, or not yet
    AGAIN = "again"  # not now: the slave did not take the request
    CLOSED = "closed"  # the service access point is closed
    NOTHING = "nothing"  # there is no usable answer
    GUARDED = "guarded"  # not sent: this bus is read-only
    LATE = "late"  # not sent: the slave has had its time


def classify(answer: Telegram | Failure, *, requested: bool) -> Reply:
    """The kind of ``answer`` by its FC (docs/reference/protocol.md#function-code). ``requested``: to a request, not a
    poll."""
    if not isinstance(answer, Telegram):
        return Reply.GUARDED if answer is Failure.REFUSED else Reply.NOTHING
    if answer.kind is Kind.SC:
        return Reply.WAIT
    status = answer.function
    if answer.data and status in _WITH_PDU:
        return Reply.OLD if requested and status in _NOT_TAKEN else Reply.DATA
    if status in _NOT_YET:
        return Reply.WAIT
    return Reply.AGAIN if status in _NOT_NOW else Reply.CLOSED


class Polling:
    """The requests and polls of one service. ``srd`` makes the requests; the slave has ``limit_ns`` to answer."""

    __slots__ = ("_limit_ns", "_pause", "_polls", "_silent", "_srd", "answer", "begun", "busy", "now", "unanswered")

    def __init__(self, srd: Callable[[bytes], Request], limit_ns: int) -> None:
        self._srd = srd
        self._limit_ns = limit_ns
        #: when the slave began to work at the service
        self.begun = NEVER
        self._pause = 0
        self._polls = 0
        #: number of requests and polls without an answer, one after the other
        self._silent = 0
        #: requests without an answer in all
        self.unanswered = 0
        #: the slave did not take the last request: "not now"
        self.busy = False
        #: to the last request or poll, and the time of its end
        self.answer: Telegram | Failure = Failure.NO_ANSWER
        self.now = 0

    @property
    def pdu(self) -> bytes:
        """The PDU after DATA and OLD."""
        return self.answer.data if isinstance(self.answer, Telegram) else b""

    def restart_limit(self) -> None:
        """The slave says that it works at the service: its time begins anew."""
        self.begun = self.now

    def ask(self, octets: bytes) -> Steps[Reply]:
        """Send a request, or a poll (no octets), after the pause that is due."""
        if self.now - self.begun >= self._limit_ns:
            return Reply.LATE
        heard = yield Step(self._srd(octets), self._pause)
        self.answer, self.now = heard.answer, heard.now
        self.begun = min(self.begun, heard.begun)
        reply = classify(heard.answer, requested=bool(octets))
        if reply is Reply.NOTHING:
            self._silent += 1
            self.unanswered += bool(octets)
            self._pause = pause_after_silence(self._silent)
            return reply
        self._silent = 0
        if octets:
            self.busy = reply is Reply.AGAIN
        else:
            self._polls += 1
        self._pause = BUSY_PAUSE if reply in (Reply.AGAIN, Reply.OLD) else pause_before(self._polls)
        return reply

    def send(self, octets: bytes, attempts: int = 1) -> Steps[Reply]:
        """Send the request ``octets`` until the slave takes it (DATA, WAIT) or another end: never AGAIN. NOTHING after
        ``attempts`` requests of this service without an answer."""
        while True:
            reply = yield from self.ask(octets)
            silent = reply is Reply.NOTHING and self.unanswered < attempts
            if reply is not Reply.AGAIN and not silent:
                return reply

    def poll(self, attempts: int = 0) -> Steps[Reply]:
        """Poll until the slave has more to say than "not yet": never WAIT or AGAIN. NOTHING after ``attempts`` polls
        without an answer one after the other, 0: polls go on for all its time."""
        while True:
            reply = yield from self.ask(b"")
            silent = reply is Reply.NOTHING and self._silent != attempts
            if reply not in (Reply.WAIT, Reply.AGAIN) and not silent:
                return reply


def service_outcome(address: int, service: Service, octets: bytes) -> Outcome | None:
    """The outcome of ``service`` by the answer ``octets`` of the slave at ``address``; None if they answer another."""
    who = f"slave {address}"
    title = service.title
    try:
        transports = isinstance(service, DataTransport) and octets[:1] == bytes((Function.DATA_TRANSPORT,))
        response = DataTransport.parse(octets) if transports else parse_response(octets)
    except PduError as error:
        return unreadable_outcome(address, title, error)
    if isinstance(response, Negative):
        return negative_outcome(address, title, response) if response.function == service.function else None
    if (response.slot, response.index) != (service.slot, service.index):
        return None
    match service, response:
        case ReadReq(length=asked), ReadRes(data=data):
            if len(data) > asked:
                text = f"{who} answers {title} with {octets_text(len(data))}, {asked} were asked for"
                return Outcome(ServiceFailure.LENGTH, text)
            return Outcome(data=data)
        case DataTransport(), DataTransport(data=data):
            return Outcome(data=data)
        case WriteReq(data=given), taken if not isinstance(taken, (ReadRes, DataTransport)):
            if taken.length != len(given):
                text = f"{who} says it took {octets_text(taken.length)} by {title}, {len(given)} were given"
                return Outcome(ServiceFailure.LENGTH, text)
            return Outcome()
    return None


def unreadable_outcome(address: int, title: str, error: PduError) -> Outcome:
    """The outcome of the service ``title`` by octets of the slave at ``address`` that are no PDU."""
    return Outcome(ServiceFailure.LENGTH, f"slave {address} answers {title} with unreadable octets: {error}")


def negative_outcome(address: int, title: str, response: Negative) -> Outcome:
    """The outcome of the service ``title`` by a negative response of the slave at ``address``."""
    codes = (response.decode, response.code_1, response.code_2)
    todo = remedy(response.code_1) if response.decode == Decode.DPV1 else ""
    text = f"slave {address} refuses {title}: {response.text}" + (f"; {todo}" if todo else "")
    return Outcome(ServiceFailure.NEGATIVE, text, codes=codes)
