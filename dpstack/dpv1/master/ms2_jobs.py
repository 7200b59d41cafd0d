"""What goes over class 2 connections: services, Idle, and Abort at the end; each job is one entry of the acyclic queue.

How one is opened is :mod:`dpstack.dpv1.master.ms2_initiate`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable

from dpstack.dp.acyclic.job import ATTEMPTS, Outcome, Provider, ServiceFailure, Steps
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dpv1.master.ms1 import RecordDone
from dpstack.dpv1.master.ms2_commands import ConnectionOver, ConnectionsClosed, TransportDone
from dpstack.dpv1.master.ms2_connection import Ended, MasterConnection, Phase
from dpstack.dpv1.master.response_check import service_outcome
from dpstack.dpv1.master.srd_polling import Course, Said
from dpstack.dpv1.pdu.ms2 import HEAD, IDLE, Abort, ResourceManagerRes
from dpstack.dpv1.pdu.read_write import DataTransport, Function, ReadReq, Service
from dpstack.dpv1.timeouts import service_timeout
from dpstack.errors import PduError
from dpstack.fdl.telegram import SAP_MS2_RM
from dpstack.trace import Event


class Connections(Provider):
    """The class 2 connections of one station, by the token they were opened with."""

    def __init__(self) -> None:
        self.connections: dict[int, MasterConnection] = {}
        #: all of them are being closed, and no other is opened
        self.closing = False

    def end(self, connection: MasterConnection, reason: str, abort: Abort | None, now: int) -> None:
        """It is over, from either end; the slave is told by ``abort`` where it may hold anything. More than once is
        no error, the first reason stands."""
        if connection.phase is Phase.ENDING:
            return
        connection.phase = Phase.ENDING
        connection.reason = reason
        if abort is not None and connection.taken:
            connection.abort = abort
            job = GiveBackJob(connection, self, abort)
            self.queue.put(job, connection.send_timeout_ns, now, first=True)
        else:
            self.forget(connection, now)

    def forget(self, connection: MasterConnection, now: int) -> None:
        """The slave holds nothing any more, or cannot be told."""
        if self.connections.get(connection.ref) is not connection:
            return
        del self.connections[connection.ref]
        if connection.opened:
            told = connection.abort
            self.queue.tell(
                ConnectionOver(
                    t_ns=now,
                    connection=connection.ref,
                    address=connection.address,
                    server_sap=connection.server_sap or 0,
                    reason=connection.reason,
                    ordered=connection.ordered,
                    abort=None if told is None else (told.subnet, told.instance, told.reason),
                )
            )
        self.closed_all(now)

    def closed_all(self, now: int) -> None:
        """Tell that the last one is over, where all are being closed."""
        if self.closing and not self.connections:
            self.closing = False
            self.queue.tell(ConnectionsClosed(t_ns=now))

    def uses(self, address: int, server_sap: int) -> bool:
        """Whether a connection to the slave has this server SAP."""
        return any(c.address == address and c.server_sap == server_sap for c in self.connections.values())

    def count(self, address: int) -> int:
        """Connections to the slave, those that are opened or given back included."""
        return sum(c.address == address for c in self.connections.values())


class ConnectionJob:
    """What the jobs of a connection share. The lane is the connection's: one service at a time, others wait."""

    title = ""

    def __init__(self, connection: MasterConnection, ms2: Connections) -> None:
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

    def course(self, answer: int = HEAD) -> Course:
        """Of a service at its server SAP."""
        sap = self.connection.server_sap
        assert sap is not None
        return self.connection.course(sap, answer)

    def over(self, ended: Ended, now: int) -> Outcome:
        """A service that ended so; its connection with it, if need be."""
        if ended.reason:
            self.ms2.end(self.connection, ended.reason, ended.abort, now)
        return ended.outcome


class ServiceJob(ConnectionJob):
    """Read, Write or Data_Transport over an open connection."""

    def __init__(self, connection: MasterConnection, ms2: Connections, service: Service, octets: bytes) -> None:
        super().__init__(connection, ms2)
        self._service = service
        self._octets = octets
        self._stale = 0
        self._sent = False
        self.title = service.title
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

    def over(self, ended: Ended, now: int) -> Outcome:
        """With what has to be said of it."""
        return self._with_aftermath(super().over(ended, now))

    def _with_aftermath(self, outcome: Outcome) -> Outcome:
        after = self.aftermath
        return dataclasses.replace(outcome, text=f"{outcome.text}; {after}") if after else outcome

    def steps(self) -> Steps[Outcome]:
        """What an earlier service left behind, the request, then polls."""
        connection = self.connection
        before = connection.stale
        owed = connection.owed
        if owed is not None:
            drained = yield from connection.drained(owed)
            if drained is not None:
                return self.over(drained, owed.now)
        course = self.course(self._answer)
        octets = self._octets
        self._sent = True
        while True:
            found = yield from connection.asked(course, octets, self.title)
            self._stale = connection.stale - before
            if isinstance(found, Ended):
                return self.over(found, course.now)
            outcome = service_outcome(self.address, self._service, found)
            if outcome is None:  # to another request
                connection.stale += 1
                octets = b""
                continue
            if outcome.failure is ServiceFailure.LENGTH:
                return self.over(connection.unreadable(outcome), course.now)
            return outcome

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
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
        return [RecordDone.of(service, token, self.address, outcome, self._stale, now)]


class IdleJob(ConnectionJob):
    """A sign of life from either end where nothing else goes over the connection."""

    title = "Idle"

    @property
    def timeout_ns(self) -> int:
        """How long it may wait and take."""
        return service_timeout(self.connection.limit_ns)

    def steps(self) -> Steps[Outcome]:
        """Idle, or the answer to a service that was given up."""
        connection = self.connection
        owed = connection.owed
        if owed is not None:
            drained = yield from connection.drained(owed)
            return Outcome() if drained is None else self.over(drained, owed.now)
        course = self.course()
        found = yield from connection.asked(course, IDLE, self.title)
        if isinstance(found, Ended):
            return self.over(found, course.now)
        if found[0] != Function.IDLE:
            connection.stale += 1
        return Outcome()

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        return []


class GiveBackJob(ConnectionJob):
    """Abort, so that the slave keeps nothing: also for an Initiate whose server SAP is still to be fetched.

    It has no answer (Balluff BTL7 p28), but is acknowledged: the server SAPs of slave chips take SRD only (VPC3+).
    """

    title = "Abort"

    def __init__(self, connection: MasterConnection, ms2: Connections, abort: Abort) -> None:
        super().__init__(connection, ms2)
        self._abort = abort

    def bar(self) -> str:
        """It is what is left to do."""
        return ""

    def steps(self) -> Steps[Outcome]:
        """The server SAP where it is not known yet, then Abort until it is acknowledged."""
        if self.connection.server_sap is None:
            yield from self._fetch_sap()
        if self.connection.server_sap is not None:
            yield from self.course().requested(self._abort.build(), ATTEMPTS)
        return Outcome()

    def _fetch_sap(self) -> Steps[None]:
        course = self.connection.course(SAP_MS2_RM)
        if (yield from course.polled(ATTEMPTS)) is Said.DATA:
            sap = _server_sap(course.pdu)
            if sap is not None and not self.ms2.uses(self.address, sap):
                self.connection.server_sap = sap  # else that is another connection's, and stays

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """The connection is no more."""
        self.ms2.forget(self.connection, now)
        return []


def _server_sap(octets: bytes) -> int | None:
    try:
        return ResourceManagerRes.parse(octets).server_sap
    except PduError:
        return None
