"""Class 2 connections of a master: their state, and the jobs over them: services, Idle, and Abort at the end.

Each job is one entry of the acyclic queue. Initiate is in :mod:`dpstack.dpv1.master.ms2`, the polling in
:mod:`dpstack.dpv1.master.srd_polling`. Decisions on points that the sources leave open:
docs/reference/decisions/ms2.md#connections-at-the-master.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from msgspec import Struct, structs

from dpstack.dp.acyclic.job import ATTEMPTS, Job, Outcome, ServiceFailure, Steps
from dpstack.dp.acyclic.queue import Provider
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.services import refusal_text
from dpstack.dpv1.master.alarm_orders import ConnectionOver, ConnectionsClosed
from dpstack.dpv1.master.orders import RecordDone
from dpstack.dpv1.master.srd_polling import NO_ANSWERS, Polling, Reply, service_outcome
from dpstack.dpv1.pdu.ms2 import HEAD, IDLE, Abort, AbortReason, Instance, ResourceManagerRes
from dpstack.dpv1.pdu.read_write import DataTransport, Function, ReadReq, Service
from dpstack.dpv1.timeouts import RESPONSE_TIMEOUT, service_timeout
from dpstack.errors import PduError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SAP_MS2_RM, SSAP_MS2, Req, Telegram
from dpstack.trace import Event
from dpstack.units import ns_to_s

#: the lane of all Initiates to one slave, in place of a connection's token, which is never negative
RESOURCE_MANAGER: Final = -1
#: Abort to a slave that did not answer, or not in time
TIMED_OUT: Final = Abort(AbortReason.TIMEOUT)
#: Abort of a connection that the program does not want any more
NOT_WANTED: Final = Abort(0, Instance.USER)
_SILENT: Final = {
    Failure.NO_ANSWER: ("does not answer", "check its power and the cable"),
    Failure.GARBLED: (
        "gives no readable answer to",
        "look for a second station with its address, and at cable and termination",
    ),
    Failure.WRONG: ("gives answers that do not belong to", "look for a second station with its address"),
}


class Phase(Enum):
    OPENING = "opening"
    OPEN = "open"
    ENDING = "ending"  # over for its user; the slave does not know yet


class MasterConnection(Struct, eq=False):
    """State of the connection ``ref`` to ``address``."""

    ref: int
    address: int
    send_timeout_ns: int
    response_ns: int
    server_sap: int | None = None
    max_len: int = 0
    phase: Phase = Phase.OPENING
    #: time of the slave's last answer
    answered_at: int = 0
    #: the slave may hold a connection for this master
    taken: bool = False
    #: a request was sent and its answer has not come
    outstanding: bool = False
    #: it was open once: its end is an event
    opened: bool = False
    #: the program ordered its end
    ordered: bool = False
    reason: str = ""
    abort: Abort | None = None
    #: answers to requests that were given up
    stale: int = 0
    #: of the last service: its slave's time is the same for the job that fetches the answer when it was given up
    last: Polling | None = None

    @property
    def lane(self) -> tuple[int, int]:
        """Services of a connection go one after the other. Until it has its server SAP, it shares the lane of all
        connections to the slave: the resource manager has one answer, and the server SAP in it goes to the job that
        polls."""
        return self.address, RESOURCE_MANAGER if self.server_sap is None else self.ref

    @property
    def limit_ns(self) -> int:
        """The time that the slave has for one service."""
        return self.response_ns or max(self.send_timeout_ns, RESPONSE_TIMEOUT)

    @property
    def limit_text(self) -> str:
        of = "its C2_Response_Timeout" if self.response_ns else "no C2_Response_Timeout is known of it"
        return f"{ns_to_s(self.limit_ns):g} s ({of})"


class Connections(Provider):
    """The class 2 connections of one station, by the token they were opened with."""

    def __init__(self) -> None:
        self.connections: dict[int, MasterConnection] = {}
        #: all of them are being closed, and no other is opened
        self.closing = False

    def end(self, connection: MasterConnection, reason: str, abort: Abort | None, now: int) -> None:
        """End it, from either side; if the slave may hold anything it gets ``abort``. More than once is no error,
        the first reason stands."""
        if connection.phase is Phase.ENDING:
            return
        connection.phase = Phase.ENDING
        connection.reason = reason
        if abort is not None and connection.taken:
            connection.abort = abort
            self.queue.put(AbortJob(connection, self, abort), connection.send_timeout_ns, now, first=True)
        else:
            self.forget(connection, now)

    def forget(self, connection: MasterConnection, now: int) -> None:
        """The slave holds nothing any more, or is out of reach."""
        if self.connections.get(connection.ref) is not connection:
            return
        del self.connections[connection.ref]
        if connection.opened:
            self.queue.report(
                ConnectionOver(
                    t_ns=now,
                    connection=connection.ref,
                    address=connection.address,
                    server_sap=connection.server_sap or 0,
                    reason=connection.reason,
                    ordered=connection.ordered,
                    abort=_codes(connection.abort),
                )
            )
        self.report_closed(now)

    def report_closed(self, now: int) -> None:
        """Emit ConnectionsClosed after the last one, if all are being closed."""
        if self.closing and not self.connections:
            self.closing = False
            self.queue.report(ConnectionsClosed(t_ns=now))

    def uses(self, address: int, server_sap: int) -> bool:
        """Whether a connection to the slave has this server SAP."""
        return any(c.address == address and c.server_sap == server_sap for c in self.connections.values())

    def count(self, address: int) -> int:
        """Connections to the slave, those that are being opened or ended included."""
        return sum(c.address == address for c in self.connections.values())


class ConnectionJob(Job):
    """A job over ``connection``, of ``ms2``. Its lane is the connection's: one job at a time, others wait."""

    def __init__(self, connection: MasterConnection, ms2: Connections) -> None:
        self.connection = connection
        self.address = connection.address
        self.ms2 = ms2

    @property
    def lane(self) -> tuple[int, int]:
        """Moves on from the resource manager to the connection's own."""
        return self.connection.lane

    def bar(self) -> str:
        """Jobs end with their connection."""
        if self.connection.phase is not Phase.ENDING:
            return ""
        return f"has no answer, the class 2 connection is over: {self.connection.reason}"

    # --- requests and polls -------------------------------------------------------------------------------------

    def polling(self, answer: int = HEAD, sap: int | None = None) -> Polling:
        """The polling for a service at ``sap`` (None: the server SAP) whose answer has up to ``answer`` octets."""
        connection = self.connection
        dsap = connection.server_sap if sap is None else sap
        assert dsap is not None

        def srd(octets: bytes) -> Request:  # high priority as all services of DP here; slaves take both (VPC3+)
            return Request(self.address, Req.SRD_HIGH, octets, dsap, SSAP_MS2, answer=answer, tag=connection)

        return Polling(srd, connection.limit_ns)

    def exchange(self, polling: Polling, octets: bytes, title: str = "") -> Steps[bytes | Outcome]:
        """Send ``octets`` to the server SAP (empty: poll only) until a PDU is there: Idle only as the answer to Idle.

        An Outcome is the end without an answer; the connection has ended with it, unless this bus is read-only.
        ``title``: for texts, if not that of the job.
        """
        connection = self.connection
        title = title or self.title
        idle = octets[:1] == IDLE[:1]
        connection.last = polling
        reply = yield from polling.send(octets) if octets else polling.poll()
        while True:
            match reply:
                case Reply.CLOSED:
                    return self._closed(title, polling)
                case Reply.GUARDED:
                    text = f"slave {self.address}: {title} was not sent; this bus is read-only"
                    return Outcome(ServiceFailure.GUARDED, text)
                case Reply.LATE:
                    return self._late(title, polling)
                case Reply.DATA | Reply.OLD:
                    pdu = polling.pdu
                    working = pdu[0] == Function.IDLE and not idle
                    connection.outstanding &= working
                    if pdu[0] == Function.ABORT:
                        return self.aborted(pdu, title, polling.now)
                    if reply is Reply.OLD:
                        connection.stale += 1
                        reply = yield from polling.send(octets)
                        continue
                    if not working:
                        return pdu
                    polling.restart_limit()
            # else it was taken, or maybe taken
            reply = yield from self._poll_idle(polling) if idle else polling.poll()

    def _poll_idle(self, polling: Polling) -> Steps[Reply]:
        """Poll for the answer to Idle. If one of both may have been lost, and polls say for a third of the time
        that there is nothing, Idle is sent again: a slave that has it ignores the second (VPC3+)."""
        connection = self.connection
        lost = not isinstance(polling.answer, Telegram)
        octets = b""
        while True:
            reply = yield from polling.send(octets) if octets else polling.ask(octets)
            lost = lost or reply is Reply.NOTHING
            if reply not in (Reply.WAIT, Reply.AGAIN, Reply.NOTHING):
                return reply
            third = min(connection.send_timeout_ns, connection.limit_ns) // 3
            again = lost and reply is Reply.WAIT and polling.now - polling.begun >= third
            octets = IDLE if again else b""
            if again:
                lost = False
                polling.restart_limit()

    def fetch_earlier_answer(self) -> Steps[Outcome | None]:
        """Fetch and drop the answer to a service that was given up, if any: before that, the slave takes no other
        service. An Outcome is the end of this job, too."""
        connection = self.connection
        if connection.outstanding and connection.last is not None:
            found = yield from self.exchange(connection.last, b"", "a service that was given up")
            if isinstance(found, Outcome):
                return found
            connection.stale += 1
        return None

    # --- ends ---------------------------------------------------------------------------------------------------

    def connection_over(self, title: str = "") -> Outcome:
        """The outcome of a service over a connection that is over."""
        text = f"{title or self.title} has no answer, the class 2 connection is over: {self.connection.reason}"
        codes = _codes(self.connection.abort)
        return Outcome(ServiceFailure.ABORTED, f"slave {self.address}: {text}", codes=codes)

    def aborted(self, octets: bytes, title: str, now: int) -> Outcome:
        try:
            self.connection.abort = Abort.parse(octets)
            reason = f"the slave aborted it: {self.connection.abort.text}"
        except PduError as error:
            reason = f"the slave aborted it, but why cannot be read: {error}"
        return self._ended_by_slave(title, reason, now)

    def _closed(self, title: str, polling: Polling) -> Outcome:
        assert isinstance(polling.answer, Telegram)
        sap = f"server SAP {self.connection.server_sap} ({refusal_text(polling.answer)})"
        why = "it was restarted, or gave it up because it heard nothing for too long"
        return self._ended_by_slave(title, f"the slave has closed {sap}: {why}", polling.now)

    def _ended_by_slave(self, title: str, reason: str, now: int) -> Outcome:
        self.connection.reason = reason
        outcome = self.connection_over(title)
        self.ms2.end(self.connection, reason, None, now)
        return outcome

    def _late(self, title: str, polling: Polling) -> Outcome:
        if isinstance(polling.answer, Telegram):
            failure, what = ServiceFailure.LATE, "has no answer to"
            todo = "open a new one, with a longer response_timeout where it needs that"
        else:
            failure, (what, check) = NO_ANSWERS[polling.answer], _SILENT[polling.answer]
            todo = f"{check}, then open a new one"
        limit = self.connection.limit_text
        text = f"slave {self.address} {what} {title} within {limit}; the connection was ended: {todo}"
        self.ms2.end(self.connection, f"{title} had no answer in time", TIMED_OUT, polling.now)
        return Outcome(failure, text)

    def unreadable(self, outcome: Outcome, now: int) -> Outcome:
        """End the connection by Abort, after an answer that cannot be read."""
        self.ms2.end(self.connection, "the slave answered what cannot be read", Abort(AbortReason.RESPONSE_PDU), now)
        return outcome


class ServiceJob(ConnectionJob):
    """Read, Write or Data_Transport over an open connection. Raises PduError for a request that cannot be encoded."""

    def __init__(self, connection: MasterConnection, ms2: Connections, service: Service) -> None:
        super().__init__(connection, ms2)
        self.title = service.title
        self._service = service
        self._octets = service.build()
        self._stale = 0
        self._sent = False
        match service:
            case ReadReq(length=length):
                self._answer = HEAD + length
            case DataTransport():
                self._answer = HEAD + (connection.max_len or MAX_RECORD)
            case _:
                self._answer = HEAD

    @property
    def aftermath(self) -> str:
        """A warning about a Write or Data_Transport without an answer."""
        return "it may have been carried out" if self._sent and not isinstance(self._service, ReadReq) else ""

    def _with_aftermath(self, outcome: Outcome) -> Outcome:
        after = "" if outcome.failure is ServiceFailure.GUARDED else self.aftermath
        return structs.replace(outcome, text=f"{outcome.text}; {after}") if after else outcome

    def steps(self) -> Steps[Outcome]:
        """Fetch the answer that an earlier service left, send the request, then poll."""
        connection = self.connection
        before = connection.stale
        failed = yield from self.fetch_earlier_answer()
        if failed is not None:
            return failed
        polling = self.polling(self._answer)
        octets = self._octets
        self._sent = True
        while True:
            found = yield from self.exchange(polling, octets)
            self._stale = connection.stale - before
            if isinstance(found, Outcome):
                return self._with_aftermath(found)
            outcome = service_outcome(self.address, self._service, found)
            if outcome is None:  # to another request
                connection.stale += 1
                octets = b""
                continue
            if outcome.failure is ServiceFailure.LENGTH:
                return self._with_aftermath(self.unreadable(outcome, polling.now))
            return outcome

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        if outcome.failure is ServiceFailure.CLOSED:
            outcome = self._with_aftermath(self.connection_over())
        return [RecordDone.of(self._service, token, self.address, outcome, self._stale, now)]


class IdleJob(ConnectionJob):
    """A sign of life to the slave, and from it, over a connection without services."""

    title = "Idle"

    @property
    def timeout_ns(self) -> int:
        """The time for waiting and Idle together."""
        return service_timeout(self.connection.limit_ns)

    def steps(self) -> Steps[Outcome]:
        """Idle, or the answer to a service that was given up."""
        if self.connection.outstanding:
            return (yield from self.fetch_earlier_answer()) or Outcome()
        found = yield from self.exchange(self.polling(), IDLE)
        if isinstance(found, Outcome):
            return found
        if found[0] != Function.IDLE:
            self.connection.stale += 1
        return Outcome()


class AbortJob(ConnectionJob):
    """Abort, so that the slave keeps nothing: also for an Initiate whose server SAP is still to be fetched.

    It has no answer (Balluff BTL7 p28), but is acknowledged: the server SAPs of slave chips take SRD only (VPC3+).
    """

    title = "Abort"

    def __init__(self, connection: MasterConnection, ms2: Connections, abort: Abort) -> None:
        super().__init__(connection, ms2)
        self._abort = abort

    def bar(self) -> str:
        """Abort is sent over a connection that is over."""
        return ""

    def steps(self) -> Steps[Outcome]:
        """Fetch the server SAP if it is not known yet, then send Abort until it is acknowledged."""
        if self.connection.server_sap is None:
            yield from self._fetch_sap()
        if self.connection.server_sap is not None:
            yield from self.polling().send(self._abort.build(), ATTEMPTS)
        return Outcome()

    def _fetch_sap(self) -> Steps[None]:
        polling = self.polling(sap=SAP_MS2_RM)
        if (yield from polling.poll(ATTEMPTS)) is Reply.DATA:
            try:
                sap = ResourceManagerRes.parse(polling.pdu).server_sap
            except PduError:
                return
            if not self.ms2.uses(self.address, sap):
                self.connection.server_sap = sap  # else that is another connection's, and stays

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        self.ms2.forget(self.connection, now)
        return []


def _codes(abort: Abort | None) -> tuple[int, int, int] | None:
    return None if abort is None else (abort.subnet, abort.instance, abort.reason)
