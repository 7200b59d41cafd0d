"""Class 2 connections (MS2) of a master: opened through the resource manager of a slave (DSAP 49), used at the server
SAP that it gives out, ended by Abort (docs/reference/protocol.md#ms2).

They take nothing away from the slave's own master, and need none. Every connection of a master asks from SSAP 50
(Felser: its only SAP for MS2); the slave's server SAP distinguishes several of them. The order of requests:
:mod:`dpstack.dp.acyclic.queue`; the telegrams: :mod:`dpstack.dpv1.master.ms2_connection`.

Decisions on points that the sources leave open: docs/reference/decisions/ms2.md#connections-at-the-master.

Initiate: the resource manager (SAP 49) gives out a server SAP, polls of that one bring the slave's answer
(docs/reference/protocol.md#ms2).

Decisions on points that the sources leave open: docs/reference/decisions/ms2.md#initiate-at-the-master.
"""

from __future__ import annotations

from typing import Final

from msgspec import structs

from dpstack.dp.acyclic.class2 import answers_slave_diag, check_address, service_unanswered
from dpstack.dp.acyclic.job import ATTEMPTS, Job, Outcome, ServiceFailure, Steps
from dpstack.dp.master.master import Master
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.services import refusal_text
from dpstack.dpv1.master.alarm_orders import CloseConnection, CloseConnections
from dpstack.dpv1.master.ms2_connection import (
    NOT_WANTED,
    TIMED_OUT,
    ConnectionJob,
    Connections,
    IdleJob,
    MasterConnection,
    Phase,
    ServiceJob,
)
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordOrder
from dpstack.dpv1.master.srd_polling import NO_ANSWERS, Polling, Reply, classify, unreadable_outcome
from dpstack.dpv1.pdu.ms2 import AbortReason, InitiateRes, Instance, ResourceManagerRes
from dpstack.dpv1.pdu.read_write import Function, Negative, ReadReq, parse_response
from dpstack.dpv1.timeouts import QUIET_SHARE
from dpstack.errors import PduError, UsageError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SAP_MS2_RM, Telegram
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_MS, ns_to_s

#: the program gave the connection up, or the slave aborted it
_GIVEN_UP: Final = (ServiceFailure.CANCELLED, ServiceFailure.ABORTED)
#: instance and reason of an Abort: the send time-out is too short
_TOO_SHORT: Final = (Instance.MS2, AbortReason.SEND_TIMEOUT)
_NEGATIVE: Final = 0x80
_WITHOUT_MS2: Final = (
    "it has no class 2 connections (a device of DP-V0, or C2_Read_Write_supp = 0 in its GSD file): records of a DP-V1 "
    "slave can be asked for by its own master, of a DP-V0 slave by nobody"
)
#: octets of Initiate, response, without addresses
_INITIATE_RES: Final = 12


class InitiateJob(ConnectionJob):
    """Open ``connection`` by ``order``. Raises UsageError, PduError for an Initiate that cannot be encoded."""

    title = "Initiate"

    def __init__(self, connection: MasterConnection, ms2: Connections, order: OpenConnection) -> None:
        super().__init__(connection, ms2)
        request = order.request
        self._channels = order.channels
        self._octets = request.build()
        self._answer = _INITIATE_RES + len(request.source.build()) + len(request.destination.build())
        self._response: InitiateRes | None = None

    def steps(self) -> Steps[Outcome]:
        """SAP 49 until it names a server SAP, then that one until Initiate is answered."""
        connection = self.connection
        managed = yield from self._ask_resource_manager(self.polling(sap=SAP_MS2_RM))
        if isinstance(managed, Outcome):
            if managed.failure is ServiceFailure.SILENT and (yield from answers_slave_diag(self.address, SAP_MS2_RM)):
                return service_unanswered(self.address, f"{self.title} (SAP {SAP_MS2_RM})", _WITHOUT_MS2)
            return managed
        if self.ms2.uses(self.address, managed.server_sap):  # it cannot be another connection's
            connection.taken = False
            text = f"slave {self.address} gives out server SAP {managed.server_sap}, which is in use by this master"
            return Outcome(ServiceFailure.WRONG, f"{text}; close that connection first")
        connection.server_sap = managed.server_sap
        connection.send_timeout_ns = max(connection.send_timeout_ns, managed.send_timeout_ns)
        polling = self.polling(self._answer)
        found = yield from self.exchange(polling, b"")
        return found if isinstance(found, Outcome) else self._outcome_of(found, polling.now)

    def _ask_resource_manager(self, polling: Polling) -> Steps[ResourceManagerRes | Outcome]:
        """Initiate at the resource manager until it names a server SAP."""
        self.connection.taken = True  # as soon as the link layer has the request: it may go out
        reply = yield from polling.send(self._octets)
        while True:
            match reply:
                case Reply.OLD:
                    reply = yield from polling.send(self._octets)
                case Reply.WAIT:
                    reply = yield from polling.poll()
                case Reply.DATA:
                    managed = self._parse_managed(polling.pdu, polling.now)
                    if managed is not None:
                        return managed
                    reply = yield from polling.poll()
                case Reply.NOTHING if polling.unanswered < ATTEMPTS:
                    reply = yield from self._repeat(polling)
                case _:
                    return self._unmanaged(reply, polling.answer)

    def _repeat(self, polling: Polling) -> Steps[Reply]:
        """After an Initiate without an answer: a poll shows whether the slave took it; if not it goes out again.

        Never before a poll is answered: a slave that only answers late would open a second connection, or refuse it.
        """
        reply = Reply.AGAIN
        silent = 0
        while reply is Reply.AGAIN or (reply is Reply.NOTHING and silent < ATTEMPTS):
            reply = yield from polling.ask(b"")
            silent = silent + 1 if reply is Reply.NOTHING else 0
        if reply not in (Reply.WAIT, Reply.CLOSED):
            return reply
        polling.unanswered = 0  # the slave is there, and has nothing
        return (yield from polling.send(self._octets))

    def _parse_managed(self, octets: bytes, now: int) -> ResourceManagerRes | Outcome | None:
        """A PDU of the resource manager, None for Idle."""
        if octets[0] == Function.ABORT:
            return self.aborted(octets, self.title, now)
        if octets[0] == Function.IDLE:
            return None
        if octets[0] == Function.INITIATE | _NEGATIVE:
            return self._outcome_of(octets, now)
        try:
            return ResourceManagerRes.parse(octets)
        except PduError as error:
            who = f"slave {self.address}: its resource manager"
            text = f"{who} answers Initiate with unreadable octets: {error}"
            return Outcome(ServiceFailure.LENGTH, text)

    def _outcome_of(self, octets: bytes, now: int) -> Outcome:
        """The outcome by the slave's answer to Initiate."""
        connection = self.connection
        try:
            if octets[0] == Function.INITIATE | _NEGATIVE:
                response = parse_response(octets)
                assert isinstance(response, Negative)
                connection.taken = False
                codes = (response.decode, response.code_1, response.code_2)
                text = f"slave {self.address} refuses Initiate: {response.text}"
                status = bytes(codes).hex(" ").upper()
                return Outcome(ServiceFailure.NEGATIVE, text, codes=codes, status=status)
            self._response = InitiateRes.parse(octets)
        except PduError as error:
            return self.unreadable(unreadable_outcome(self.address, self.title, error), now)
        if connection.phase is not Phase.OPENING:  # closed meanwhile
            return self.connection_over()
        connection.max_len = min(self._response.max_len or MAX_RECORD, MAX_RECORD)
        connection.phase = Phase.OPEN
        connection.opened = True
        return Outcome()

    def _unmanaged(self, reply: Reply, last: Telegram | Failure) -> Outcome:
        """No server SAP; ``last``: the slave's last answer."""
        who = f"slave {self.address}"
        match last:
            case Telegram():
                if reply is Reply.CLOSED:
                    return self._no_service(last)
                limit = self.connection.limit_text
                todo = "try again, or give it longer (response_timeout)"
                text = f"{who}: its resource manager has no answer to Initiate within {limit}; {todo}"
                return Outcome(ServiceFailure.LATE, text)
            case Failure.REFUSED:
                self.connection.taken = False
                text = f"{who}: Initiate was not sent; this bus is read-only"
            case Failure.NO_ANSWER:
                text = f"{who} does not answer Initiate; check address and power"
            case _:
                todo = "look for a second station with its address, and at cable and termination"
                text = f"{who} gives no readable answer to Initiate; {todo}"
        return Outcome(NO_ANSWERS[last], text)

    def _no_service(self, answer: Telegram) -> Outcome:
        """RS: the resource manager is closed for good, or has no server SAP left (Felser)."""
        self.connection.taken = False
        status = refusal_text(answer)
        own = self.ms2.count(self.address) - 1
        facts = (f"C2_Max_Count_Channels = {self._channels}", f"{own} of them from here")
        mine = ", ".join(fact for fact, known in zip(facts, (self._channels, own), strict=True) if known)
        text = (
            f"slave {self.address} refuses Initiate ({status} at SAP {SAP_MS2_RM}): all its class 2 connections are in "
            f"use{f' ({mine})' if mine else ''}, or it has none (C2_Read_Write_supp of its GSD file); close one, or "
            "wait until another master does"
        )
        return Outcome(ServiceFailure.REFUSED, text, status=status)

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """The InitiateDone. After a failure the slave gets Abort for a connection that it may hold."""
        connection = self.connection
        if outcome.failure is ServiceFailure.CLOSED:
            outcome = self.connection_over()
        elif (
            outcome.failure is ServiceFailure.ABORTED and outcome.codes is not None and outcome.codes[1:] == _TOO_SHORT
        ):
            least = connection.send_timeout_ns // NS_PER_MS
            outcome = structs.replace(outcome, text=f"{outcome.text}; ask for {least} ms or more")
        done = InitiateDone(t_ns=now, token=token, address=self.address, outcome=outcome)
        if outcome.failure is not None:
            self.ms2.end(connection, outcome.text, NOT_WANTED if outcome.failure in _GIVEN_UP else TIMED_OUT, now)
            return [done]
        response = self._response
        assert response is not None
        assert connection.server_sap is not None
        return [
            structs.replace(
                done,
                server_sap=connection.server_sap,
                send_timeout_ns=connection.send_timeout_ns,
                max_len=connection.max_len,
                profile_ident=response.profile_ident,
            )
        ]


#: begin of the refusal of a service over a connection that is over
NO_CONNECTION: Final = "there is no open class 2 connection"
#: connections at a time, to all slaves
CAPACITY: Final = 64


class Ms2(Connections):
    """The connections of the station ``own``. ``master``: of the same station."""

    def __init__(self, own: int, master: Master | None) -> None:
        super().__init__()
        self._own = own
        self._master = master

    # --- orders ---------------------------------------------------------------------------------------------------

    def command(self, order: object, now: int) -> bool:
        match order:
            case CloseConnection(ref):
                connection = self.connections.get(ref)
                if connection is not None:
                    self._close(connection, "it was closed here", now)
            case CloseConnections():
                self.closing = True
                for connection in tuple(self.connections.values()):
                    self._close(connection, "the bus was closed here", now)
                self.report_closed(now)
            case _:
                return False
        return True

    def job_of(self, order: object) -> tuple[int, Job, int] | None:
        """OpenConnection, and services over one."""
        try:
            match order:
                case OpenConnection():
                    return order.token, self._initiate(order), order.timeout_ns
                case RecordOrder(connection=int(ref)):
                    return order.token, self._service(order, ref), order.timeout_ns
        except PduError as error:
            raise UsageError(str(error)) from None
        return None

    def _initiate(self, order: OpenConnection) -> Job:
        check_address(order.address, self._own)
        if self._master is not None and self._master.context.settings.read_only:
            raise UsageError("this bus is read-only: no connection is opened; leave read_only out")
        if self.closing:
            raise UsageError("the bus is being closed: no connection is opened any more")
        if len(self.connections) >= CAPACITY:
            raise UsageError(f"{CAPACITY} class 2 connections are open already: close one first")
        if order.request.send_timeout_ns <= 0:
            raise UsageError("a send time-out of 0 s or less ends a connection at once: 0.01 s is the least")
        if order.response_ns < 0:
            raise UsageError(f"{ns_to_s(order.response_ns):g} s is no time for an answer: 0 for as long as is usual")
        send_timeout_ns = order.request.send_timeout_ns
        connection = MasterConnection(order.token, order.address, send_timeout_ns, order.response_ns)
        job = InitiateJob(connection, self, order)
        self.connections[order.token] = connection
        return job

    def _service(self, order: RecordOrder, ref: int) -> Job:
        connection = self.connections.get(ref)
        if connection is None or connection.phase is not Phase.OPEN:
            why = f": {connection.reason}" if connection is not None and connection.reason else ""
            raise UsageError(f"{NO_CONNECTION} {ref}{why}; open a new one")
        service = order.service
        job = ServiceJob(connection, self, service)
        length = service.length if isinstance(service, ReadReq) else len(service.data)
        if length > connection.max_len:
            raise UsageError(
                f"slave {connection.address} takes up to {connection.max_len} octets of data in one service "
                f"(Max_Len_Data_Unit of its Initiate), not {length}"
            )
        return job

    def _close(self, connection: MasterConnection, reason: str, now: int) -> None:
        connection.ordered |= connection.phase is Phase.OPEN
        self.end(connection, reason, NOT_WANTED, now)

    # --- from the queue -------------------------------------------------------------------------------------------

    def queue_jobs(self, now: int) -> None:
        """Idle over quiet connections, or the poll for the answer to a service that was given up."""
        if not self.connections:
            return
        busy = self.queue.lanes()
        for connection in self.connections.values():
            if connection.phase is Phase.OPEN and connection.lane not in busy:
                quiet_ns = now - connection.answered_at
                if connection.outstanding or quiet_ns >= connection.send_timeout_ns // QUIET_SHARE:
                    job = IdleJob(connection, self)
                    self.queue.put(job, job.timeout_ns, now)

    def started(self, request: Request) -> None:
        """The first bit of a request is on the wire."""
        if request.data and isinstance(request.tag, MasterConnection):
            request.tag.outstanding = request.data[0] != Function.ABORT

    def request_ended(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """The end of a request to any station."""
        if isinstance(request.tag, MasterConnection) and isinstance(outcome, Telegram):
            request.tag.answered_at = now
            if request.data and classify(outcome, requested=True) is Reply.AGAIN:
                request.tag.outstanding = False

    def may_be_taken(self, request: Request) -> bool:
        """Whether a request that was given up may have reached the slave: it is not to be sent again."""
        return isinstance(request.tag, MasterConnection) and request.tag.outstanding

    def line_down(self, reason: str, now: int) -> None:
        """The port vanished. When it is back, slaves that still hold a connection get Abort."""
        for connection in tuple(self.connections.values()):
            self.end(connection, f"the port vanished ({reason})", NOT_WANTED, now)

    def wake_at(self) -> int:
        """The time at which an open connection will have been silent for too long."""
        if not self.connections:
            return NEVER
        ends = (c.answered_at + c.send_timeout_ns for c in self.connections.values() if c.phase is Phase.OPEN)
        return min(ends, default=NEVER)

    def tick(self, now: int) -> bool:
        """End the silent connections; True if there were any."""
        if not self.connections:
            return False
        connections = self.connections.values()
        silent = [c for c in connections if c.phase is Phase.OPEN and now >= c.answered_at + c.send_timeout_ns]
        for connection in silent:
            seconds = ns_to_s(connection.send_timeout_ns)
            reason = f"nothing was heard of the slave for {seconds:g} s (the send time-out)"
            self.end(connection, reason, TIMED_OUT, now)
        return bool(silent)
