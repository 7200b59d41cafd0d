"""What goes over class 2 connections: services, Idle, and Abort at the end; each job is one entry of the acyclic queue.

How one is opened is :mod:`dpstack.dp.v1.ms2_initiate`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable
from typing import TYPE_CHECKING, Final

from dpstack.dp.acyclic_job import ATTEMPTS, Outcome, ServiceFailure, Step, Steps
from dpstack.dp.v1.connection import (
    HEAD,
    IDLE,
    Abort,
    DataTransport,
    ResourceManagerRes,
)
from dpstack.dp.v1.judging import Said, Service, said, service_outcome, title_of
from dpstack.dp.v1.ms1 import RecordDone
from dpstack.dp.v1.ms2_connection import Connection, Ended, Phase
from dpstack.dp.v1.ms2_orders import TransportDone
from dpstack.dp.v1.records import MAX_RECORD, Function, ReadReq, WriteReq
from dpstack.dp.v1.times import pause_before
from dpstack.errors import PduError
from dpstack.fdl.telegram import SAP_MS2_RM, Telegram
from dpstack.fdl.user import Failure
from dpstack.trace import Event
from dpstack.units import NS_PER_MS

if TYPE_CHECKING:
    from dpstack.dp.v1.ms2 import Ms2

#: before an Abort is repeated, growing
_PAUSE: Final = 10 * NS_PER_MS


class ConnectionJob:
    """What the jobs of a connection share. The lane is the connection's: one service at a time, others wait."""

    overdue = ""
    title = ""

    def __init__(self, connection: Connection, ms2: Ms2) -> None:
        self.connection = connection
        self.address = connection.address
        self.ms2 = ms2

    @property
    def lane(self) -> Hashable | None:
        """Moves on from the resource manager to the connection's own."""
        return self.connection.lane

    @property
    def aftermath(self) -> str:
        """Nothing is known to have happened to the slave."""
        return ""

    def bar(self) -> str:
        """Nothing goes over a connection that is over."""
        connection = self.connection
        if connection.phase in (Phase.OPENING, Phase.OPEN):
            return ""
        return f"has no answer, the class 2 connection is over: {connection.reason}"

    def over(self, ended: Ended) -> Outcome:
        """A service that ended so; its connection with it, if need be."""
        if ended.reason:
            self.ms2.end(self.connection, ended.reason, ended.abort)
        return ended.outcome


class ServiceJob(ConnectionJob):
    """Read, Write or Data_Transport over an open connection."""

    def __init__(self, connection: Connection, ms2: Ms2, service: Service, octets: bytes) -> None:
        super().__init__(connection, ms2)
        self._service = service
        self._octets = octets
        self._stale = 0
        self._sent = False
        self.title = title_of(service)
        match service:
            case ReadReq(length=length):
                self._answer = HEAD + length
            case DataTransport():
                self._answer = HEAD + (connection.max_len or MAX_RECORD)
            case _:
                self._answer = HEAD

    @property
    def aftermath(self) -> str:
        """What changes something in the slave may have done so without an answer."""
        return "it may have been carried out" if self._sent and not isinstance(self._service, ReadReq) else ""

    def over(self, ended: Ended) -> Outcome:
        """With what has to be said of it."""
        return self._with_aftermath(super().over(ended))

    def _with_aftermath(self, outcome: Outcome) -> Outcome:
        after = self.aftermath
        return dataclasses.replace(outcome, text=f"{outcome.text}; {after}") if after else outcome

    def steps(self) -> Steps[Outcome]:
        """What an earlier service left behind, the request, then polls."""
        connection = self.connection
        before = connection.stale
        drained = yield from connection.drained()
        if drained is not None:
            return self.over(drained)
        octets, begun = self._octets, connection.clock.now
        self._sent = True
        while True:
            found = yield from connection.asked(octets, self.title, answer=self._answer, begun=begun)
            self._stale = connection.stale - before
            if isinstance(found, Ended):
                return self.over(found)
            outcome = service_outcome(self.address, self._service, found)
            if outcome is None:  # to another request
                connection.stale += 1
                octets = b""
                continue
            if outcome.failure is ServiceFailure.LENGTH:
                return self.over(connection.unreadable(outcome))
            return outcome

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """One event."""
        if outcome.failure is ServiceFailure.CLOSED:
            outcome = self._with_aftermath(self.connection.ended(self.title))
        service = self._service
        if isinstance(service, DataTransport):
            return [
                TransportDone(
                    t_ns=now,
                    token=token,
                    address=self.address,
                    slot=service.slot,
                    index=service.index,
                    outcome=outcome,
                    stale=self._stale,
                )
            ]
        return [
            RecordDone(
                t_ns=now,
                token=token,
                address=self.address,
                write=isinstance(service, WriteReq),
                slot=service.slot,
                index=service.index,
                outcome=outcome,
                stale=self._stale,
            )
        ]


class IdleJob(ConnectionJob):
    """A sign of life from either end where nothing else goes over the connection."""

    title = "Idle"

    def steps(self) -> Steps[Outcome]:
        """Idle, or the answer to a service that was given up."""
        connection = self.connection
        if connection.outstanding:
            drained = yield from connection.drained()
            return Outcome() if drained is None else self.over(drained)
        found = yield from connection.asked(IDLE, self.title)
        if isinstance(found, Ended):
            return self.over(found)
        if found[0] != Function.IDLE:
            connection.stale += 1
        return Outcome()

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """Nobody waits for it."""
        return []


class GiveBackJob(ConnectionJob):
    """Abort, so that the slave keeps nothing: also for an Initiate whose server SAP is still to be fetched.

    It has no answer (Balluff BTL7 p28), but is acknowledged: the server SAPs of slave chips take SRD only (VPC3+).
    """

    title = "Abort"

    def __init__(self, connection: Connection, ms2: Ms2, abort: Abort) -> None:
        super().__init__(connection, ms2)
        self._abort = abort

    def bar(self) -> str:
        """It is what is left to do."""
        return ""

    def steps(self) -> Steps[Outcome]:
        """The server SAP where it is not known yet, then Abort until it is acknowledged."""
        connection = self.connection
        if connection.server_sap is None:
            yield from self._fetch_sap()
        sap = connection.server_sap
        if sap is not None:
            request = connection.request(sap, self._abort.build(), HEAD)
            for attempt in range(ATTEMPTS):
                answer = yield Step(request, _PAUSE << attempt if attempt else 0)
                if isinstance(answer, Telegram) or answer is Failure.REFUSED:
                    break
        return Outcome()

    def _fetch_sap(self) -> Steps[None]:
        connection, clock = self.connection, self.connection.clock
        begun = clock.now
        polls = unanswered = 0
        poll = connection.request(SAP_MS2_RM, b"", HEAD)
        while unanswered < ATTEMPTS:
            answer = yield Step(poll, pause_before(polls))
            polls += 1
            if not isinstance(answer, Telegram):
                unanswered += 1
            elif said(answer) is Said.DATA:
                sap = _server_sap(answer.data)
                if sap is not None and not self.ms2.uses(self.address, sap):
                    connection.server_sap = sap  # else that is another connection's, and stays
                return
            elif said(answer) is Said.CLOSED or clock.now - begun >= connection.limit_ns:
                return

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """The connection is no more."""
        self.ms2.forget(self.connection, now)
        return []


def _server_sap(octets: bytes) -> int | None:
    try:
        return ResourceManagerRes.parse(octets).server_sap
    except PduError:
        return None
