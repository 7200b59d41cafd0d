"""How a slave is asked for one service of DP-V1, at MS1 or over a class 2 connection: SRDs with the request until it
takes it, then empty ones until its answer is there (docs/protocol.md#ms1, docs/protocol.md#ms2).

Decisions where the sources leave something open: docs/decisions/services.md#polling.

What a PDU means, and what silence does, is said by whoever asks: :mod:`dpstack.dpv1.master.ms1_job`,
:mod:`dpstack.dpv1.master.ms2_connection`, :mod:`dpstack.dpv1.master.ms2_initiate`.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Final

from dpstack.dp.acyclic.job import BUSY_PAUSE, ServiceFailure, Step, Steps, pause_after_silence
from dpstack.dp.services import DATA_STATUS
from dpstack.dpv1.timeouts import pause_before
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Kind, Resp, Telegram
from dpstack.units import NEVER

#: old data are given away, and the request was not taken
_NOT_TAKEN: Final = frozenset((int(Resp.RDL), int(Resp.RDH)))
#: FC status of an answer with a PDU
_WITH_PDU: Final = DATA_STATUS | _NOT_TAKEN
#: without one: "not yet", to a request or a poll
_NOT_YET: Final = DATA_STATUS | {int(Resp.OK), int(Resp.NR)}
#: "not now": the request was not taken
_NOT_NOW: Final = _NOT_TAKEN | {int(Resp.RR), int(Resp.UE)}

#: what a service without any answer that can be used is called
NO_ANSWERS: Final = {
    Failure.NO_ANSWER: ServiceFailure.SILENT,
    Failure.GARBLED: ServiceFailure.UNREADABLE,
    Failure.WRONG: ServiceFailure.WRONG,
    Failure.REFUSED: ServiceFailure.GUARDED,
}


class Said(Enum):
    """What became of a request or a poll."""

    DATA = "data"  # a PDU
    OLD = "old"  # a PDU, given away instead of taking the request
    WAIT = "wait"  # acknowledged, or not yet
    AGAIN = "again"  # not now: the request was not taken
    CLOSED = "closed"  # the service access point is
    NOTHING = "nothing"  # no answer that can be used
    GUARDED = "guarded"  # it was not sent: this bus is read-only
    LATE = "late"  # it was not sent: the slave has had its time


def said(answer: Telegram | Failure, *, requested: bool) -> Said:
    """By its FC (docs/protocol.md#function-code). ``requested``: it answers a request, not a poll."""
    if not isinstance(answer, Telegram):
        return Said.GUARDED if answer is Failure.REFUSED else Said.NOTHING
    if answer.kind is Kind.SC:
        return Said.WAIT
    status = answer.function
    if answer.data and status in _WITH_PDU:
        return Said.OLD if requested and status in _NOT_TAKEN else Said.DATA
    if status in _NOT_YET:
        return Said.WAIT
    return Said.AGAIN if status in _NOT_NOW else Said.CLOSED


class Course:
    """One service as far as it has come. ``srd`` makes its requests, the slave has ``limit_ns`` for it."""

    __slots__ = ("_begun", "_limit_ns", "_pause", "_polls", "_silent", "_srd", "answer", "busy", "now", "unanswered")

    def __init__(self, srd: Callable[[bytes], Request], limit_ns: int) -> None:
        self._srd = srd
        self._limit_ns = limit_ns
        self._begun = NEVER
        self._pause = 0
        self._polls = 0
        #: without an answer one after the other
        self._silent = 0
        #: requests without an answer in all
        self.unanswered = 0
        #: the last request was not taken: "not now"
        self.busy = False
        #: of the last request or poll, and when that was over
        self.answer: Telegram | Failure = Failure.NO_ANSWER
        self.now = 0

    @property
    def pdu(self) -> bytes:
        """What came, after DATA and OLD."""
        return self.answer.data if isinstance(self.answer, Telegram) else b""

    @property
    def worked_ns(self) -> int:
        """How long the slave has had until now."""
        return self.now - self._begun

    def anew(self) -> None:
        """The slave says that it works at it: its time begins now."""
        self._begun = self.now

    def ask(self, octets: bytes) -> Steps[Said]:
        """One request, or a poll (no octets), after the pause that is due."""
        if self.now - self._begun >= self._limit_ns:
            return Said.LATE
        heard = yield Step(self._srd(octets), self._pause)
        self.answer, self.now = heard.answer, heard.now
        self._begun = min(self._begun, heard.begun)
        found = said(heard.answer, requested=bool(octets))
        if found is Said.NOTHING:
            self._silent += 1
            self.unanswered += bool(octets)
            self._pause = pause_after_silence(self._silent)
            return found
        self._silent = 0
        if octets:
            self.busy = found is Said.AGAIN
        else:
            self._polls += 1
        self._pause = BUSY_PAUSE if found in (Said.AGAIN, Said.OLD) else pause_before(self._polls)
        return found

    def requested(self, octets: bytes, attempts: int = 1) -> Steps[Said]:
        """``octets`` until the slave takes them (DATA, WAIT), or another end: not AGAIN; NOTHING once ``attempts``
        requests of this service had no answer."""
        while True:
            found = yield from self.ask(octets)
            silent = found is Said.NOTHING and self.unanswered < attempts
            if found is not Said.AGAIN and not silent:
                return found

    def polled(self, attempts: int = 0) -> Steps[Said]:
        """Polls until the slave has more to say than "not yet": neither WAIT nor AGAIN; NOTHING after so many
        ``attempts`` without an answer one after the other, 0: it has all its time."""
        while True:
            found = yield from self.ask(b"")
            silent = found is Said.NOTHING and self._silent != attempts
            if found not in (Said.WAIT, Said.AGAIN) and not silent:
                return found
