"""Class 2 connections (MS2) of a master: opened through the resource manager of a slave (DSAP 49), used at the server
SAP that it gives out, ended by Abort (docs/protocol.md#ms2).

They take nothing away from the slave's own master, and need none. Every connection of a master asks from SSAP 50
(Felser: its only SAP for MS2); the slave's server SAP tells several of them apart. The order of requests:
:mod:`dpstack.dp.acyclic.queue`; the telegrams: :mod:`dpstack.dpv1.master.ms2_connection`.

Decisions where the sources leave something open: docs/decisions/ms2.md#connections-at-the-master.
"""

from __future__ import annotations

from typing import Final

from dpstack.dp.acyclic.class2 import check_address
from dpstack.dp.acyclic.job import Job
from dpstack.dp.master.master import Master
from dpstack.dpv1.master.ms2_connection import (
    NOT_WANTED,
    TIMED_OUT,
    Connections,
    IdleJob,
    MasterConnection,
    Phase,
    ServiceJob,
)
from dpstack.dpv1.master.ms2_initiate import InitiateJob
from dpstack.dpv1.master.orders import CloseConnection, CloseConnections, OpenConnection, RecordOrder
from dpstack.dpv1.master.srd_polling import Reply, classify
from dpstack.dpv1.pdu.read_write import Function, ReadReq
from dpstack.dpv1.timeouts import QUIET_SHARE
from dpstack.errors import PduError, UsageError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Telegram
from dpstack.units import NEVER, ns_to_s

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
