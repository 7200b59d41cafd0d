"""Class 2 connections (MS2) of a master: opened through the resource manager of a slave (DSAP 49), used at the server
SAP that it gives out, ended by Abort (docs/protocol.md#ms2).

They take nothing away from the slave's own master, and need none. Every connection of a master asks from SSAP 50
(Felser: its only SAP for MS2); the slave's server SAP tells several of them apart. What is to be asked when is
:mod:`dpstack.dp.acyclic.queue`'s, the telegrams are :mod:`dpstack.dpv1.master.ms2_jobs`.

Decisions where the sources leave something open: docs/decisions/ms2.md#connections-at-the-master.
"""

from __future__ import annotations

from typing import Final

from dpstack.dp.acyclic.job import Job
from dpstack.dp.master.master import Master
from dpstack.dpv1.master.ms2_commands import (
    CloseConnection,
    CloseConnections,
    OpenConnection,
    ReadOver,
    TransportOver,
    WriteOver,
)
from dpstack.dpv1.master.ms2_connection import NOT_WANTED, TIMED_OUT, MasterConnection, Phase
from dpstack.dpv1.master.ms2_initiate import InitiateJob
from dpstack.dpv1.master.ms2_jobs import Connections, IdleJob, ServiceJob
from dpstack.dpv1.pdu.ms2 import Address, InitiateReq
from dpstack.dpv1.pdu.read_write import DataTransport, ReadReq, Service, WriteReq
from dpstack.dpv1.timeouts import QUIET_SHARE
from dpstack.errors import PduError, UsageError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Telegram
from dpstack.params import UNADDRESSED
from dpstack.units import NEVER, ns_to_s

#: how the refusal of a service over a connection that is over begins
NO_CONNECTION: Final = "there is no open class 2 connection"
#: connections at a time, to all slaves
CAPACITY: Final = 64
_ADDRESS: Final = 2


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
                self.closed_all(now)
            case _:
                return False
        return True

    def job_of(self, order: object) -> tuple[int, Job, int] | None:
        """OpenConnection, and services over one."""
        match order:
            case OpenConnection(token=token, timeout_ns=timeout_ns):
                return token, self._opening(order), timeout_ns
            case ReadOver(token, ref, slot, index, length, timeout_ns):
                return token, self._service(ref, ReadReq(slot, index, length), length), timeout_ns
            case WriteOver(token, ref, slot, index, data, timeout_ns):
                return token, self._service(ref, WriteReq(slot, index, data), len(data)), timeout_ns
            case TransportOver(token, ref, slot, index, data, timeout_ns):
                return token, self._service(ref, DataTransport(slot, index, data), len(data)), timeout_ns
        return None

    def _opening(self, order: OpenConnection) -> Job:
        address = order.address
        if not 0 <= address <= UNADDRESSED:
            raise UsageError(f"{address} is no address of a slave: 0..{UNADDRESSED} ({UNADDRESSED}: as delivered)")
        if address == self._own:
            raise UsageError(f"{address} is the address of this master itself")
        if self._master is not None and self._master.settings.read_only:
            raise UsageError("this bus is read-only: no connection is opened; leave read_only out")
        if self.closing:
            raise UsageError("the bus is being closed: no connection is opened any more")
        if len(self.connections) >= CAPACITY:
            raise UsageError(f"{CAPACITY} class 2 connections are open already: close one first")
        if order.send_timeout_ns <= 0:
            raise UsageError("a send time-out of 0 s or less ends a connection at once: 0.01 s is the least")
        if order.response_ns < 0:
            raise UsageError(f"{ns_to_s(order.response_ns):g} s is no time for an answer: 0 for as long as is usual")
        request = InitiateReq(
            order.send_timeout_ns,
            features=order.features,
            profile_features=order.profile_features,
            profile_ident=order.profile_ident,
            source=_address_of(order.source),
            destination=_address_of(order.destination),
        )
        connection = MasterConnection(order.token, address, order.send_timeout_ns, order.response_ns)
        try:
            job = InitiateJob(connection, self, request, order.channels)
        except PduError as error:
            raise UsageError(str(error)) from None
        self.connections[order.token] = connection
        return job

    def _service(self, ref: int, service: Service, length: int) -> Job:
        connection = self.connections.get(ref)
        if connection is None or connection.phase is not Phase.OPEN:
            why = f": {connection.reason}" if connection is not None and connection.reason else ""
            raise UsageError(f"{NO_CONNECTION} {ref}{why}; open a new one")
        try:
            octets = service.build()
        except PduError as error:
            raise UsageError(str(error)) from None
        if length > connection.max_len:
            raise UsageError(
                f"slave {connection.address} takes up to {connection.max_len} octets of data in one service "
                f"(Max_Len_Data_Unit of its Initiate), not {length}"
            )
        return ServiceJob(connection, self, service, octets)

    def _close(self, connection: MasterConnection, reason: str, now: int) -> None:
        connection.ordered |= connection.phase is Phase.OPEN
        self.end(connection, reason, NOT_WANTED, now)

    # --- from the queue -------------------------------------------------------------------------------------------

    def ask(self, now: int) -> None:
        """What connections want over which nothing goes: Idle, or the answer to a service that was given up."""
        if not self.connections:
            return
        busy = self.queue.lanes()
        for connection in self.connections.values():
            if connection.phase is Phase.OPEN and connection.lane not in busy:
                quiet_ns = now - connection.heard_at
                if connection.outstanding or quiet_ns >= connection.send_timeout_ns // QUIET_SHARE:
                    job = IdleJob(connection, self)
                    self.queue.put(job, job.timeout_ns, now)

    def started(self, request: Request) -> None:
        """A request is on the wire."""
        if isinstance(request.tag, MasterConnection):
            request.tag.started(request)

    def heard(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """The end of a request to any station."""
        if isinstance(request.tag, MasterConnection) and isinstance(outcome, Telegram):
            request.tag.heard(request, outcome, now)

    def may_be_taken(self, request: Request) -> bool:
        """Whether a request that was given up may have reached the slave: it is not to be sent again."""
        return isinstance(request.tag, MasterConnection) and request.tag.outstanding

    def line_down(self, reason: str, now: int) -> None:
        """The port vanished. Slaves are told when it is back before they give the connections up themselves."""
        for connection in tuple(self.connections.values()):
            self.end(connection, f"the port vanished ({reason})", NOT_WANTED, now)

    def wake_at(self) -> int:
        """When a connection was silent for too long."""
        if not self.connections:
            return NEVER
        return min(
            (c.heard_at + c.send_timeout_ns for c in self.connections.values() if c.phase is Phase.OPEN), default=NEVER
        )

    def tick(self, now: int) -> bool:
        """End the connections that were; whether there were any."""
        if not self.connections:
            return False
        open_ones = [c for c in self.connections.values() if c.phase is Phase.OPEN]
        silent = [c for c in open_ones if now >= c.heard_at + c.send_timeout_ns]
        for connection in silent:
            self.end(connection, connection.silent_text, TIMED_OUT, now)
        return bool(silent)


def _address_of(octets: bytes) -> Address:
    if len(octets) < _ADDRESS:
        raise UsageError(f"an address in Initiate has API and access level, {len(octets)} octets are given")
    return Address(octets[0], octets[1], octets[_ADDRESS:])
