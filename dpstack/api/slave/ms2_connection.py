"""``bus.class2.connect(...)``: a class 2 connection (MS2) to a slave."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Generator
from dataclasses import dataclass, field
from types import TracebackType

from dpstack.api.slave.records import RecordAccess, RecordWay
from dpstack.api.slave.services import ConnectionEnd, Services
from dpstack.api.streams import when_dropped
from dpstack.argcheck import Sealed
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dpv1.master.ms2 import NO_CONNECTION
from dpstack.dpv1.master.orders import CloseConnection, InitiateDone, OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.ms2 import LEAST_INITIATE
from dpstack.dpv1.pdu.read_write import Function
from dpstack.errors import ConnectionEnded, PduError, UsageError
from dpstack.gsd.model import DpV1
from dpstack.units import ns_to_s

#: Slave_Diag of the slave at an address
ReadsDiagnosis = Callable[[int], Awaitable[Diagnosis]]


class Connection(Sealed, RecordAccess):
    """An open connection. Its services queue, up to 32; it is kept alive until it is closed, or the bus is, or nothing
    refers to it any more: slaves have few.

    All raise ConnectionEnded once it is over (also those under way), otherwise as :meth:`Slave.read` does:
    AcyclicError, SlaveTimeout, SlaveFault, UsageError, BusError. ``timeout`` in seconds from the call (None: 10, longer
    where C2_Response_Timeout is); a service that takes the slave longer ends the connection.
    """

    def __init__(self, made: Connecting, done: InitiateDone, ending: ConnectionEnd) -> None:
        services = made.services
        self._made = made
        self._done = done
        self._ending = ending
        longest = min(made.limits.c2_max_data_len or MAX_RECORD, MAX_RECORD, done.max_len)
        self._route = RecordWay(
            services,
            done.address,
            f"slave {done.address} (server SAP {done.server_sap})",
            longest,
            f"it takes {longest} in one service (C2_Max_Data_Len, Max_Len_Data_Unit of Initiate): send less",
            made.order.response_ns,
            asyncio.Lock(),  # the slave keeps the I&M calls of each connection apart
            done.token,
        )
        # a program may drop the connection without close()
        when_dropped(self, services.close_connection, done.token, ending)
        self._seal(Connection)

    def _sealed_name(self) -> str:
        return f"connection to slave {self.address}"

    @property
    def name(self) -> str:
        """The slave's name on this bus, or "slave" and its address."""
        return self._made.name

    @property
    def address(self) -> int:
        return self._done.address

    @property
    def _way(self) -> RecordWay:
        return self._route

    @property
    def server_sap(self) -> int:
        """The SAP of the slave that serves it, 0..48."""
        return self._done.server_sap

    @property
    def send_timeout(self) -> float:
        """The longest silence in seconds, as both ends agreed."""
        return ns_to_s(self._done.send_timeout_ns)

    @property
    def max_data_len(self) -> int:
        """Octets of data in one service, at most: by Initiate and the GSD file."""
        return self._way.longest

    @property
    def profile_ident(self) -> int:
        """The slave's Profile_Ident_Number, 0 for none."""
        return self._done.profile_ident

    @property
    def is_open(self) -> bool:
        """True until either side has ended it."""
        return not self._ending.ended.is_set()

    @property
    def reason(self) -> str | None:
        """Who ended it and why; None while it is open."""
        ending = self._ending
        return ending.over.reason if ending.over is not None else None if ending.lost is None else str(ending.lost)

    async def transport(self, slot: int, index: int, data: bytes = b"", *, timeout: float | None = None) -> bytes:
        """Data_Transport: send ``data``, return the slave's data."""
        return await self._carry_out(Function.DATA_TRANSPORT, slot, index, timeout, data=data)

    async def ident(self) -> int:
        """The slave's ident number, by Slave_Diag."""
        return (await self._made.diagnosis(self.address)).ident

    async def ended(self) -> None:
        """Wait until either side has ended it; then :attr:`reason` says why."""
        await self._ending.ended.wait()

    async def close(self) -> None:
        """End it by Abort, and wait until the slave has confirmed or is out of reach. May be repeated."""
        self._way.services.close_connection(self._done.token, self._ending)
        await self._ending.ended.wait()

    async def __aenter__(self) -> Connection:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def _order(self, order: RecordOrder) -> RecordDone:
        ending = self._ending
        if ending.lost is not None:
            raise ending.lost
        if ending.over is not None:
            text = f"{ending.over.text}; open a new one"
            raise ConnectionEnded(self.address, text, abort=ending.over.abort)
        try:
            return await super()._order(order)
        except UsageError as error:  # it ended before its event came
            if not str(error).startswith(NO_CONNECTION):
                raise
            raise ConnectionEnded(self.address, f"slave {self.address}: {error}") from None


@dataclass(eq=False)
class Connecting:
    """A connection being opened: await it, or enter it with ``async with``, which closes it at the end.

    Once: a second time raises UsageError.
    """

    services: Services
    order: OpenConnection
    name: str
    limits: DpV1
    diagnosis: ReadsDiagnosis
    _begun: bool = field(default=False, init=False)
    _opened: Connection | None = field(default=None, init=False)

    def __await__(self) -> Generator[object, None, Connection]:
        return self._open().__await__()

    async def __aenter__(self) -> Connection:
        self._opened = await self._open()
        return self._opened

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._opened is not None:
            await self._opened.close()

    async def _open(self) -> Connection:
        if self._begun:
            raise UsageError("this connection was opened before: call connect() again for another one")
        self._begun = True
        services, order = self.services, self.order
        self._check()
        ending = services.connections[order.token] = ConnectionEnd()
        try:
            done = await services.do(order, InitiateDone, cancel=CloseConnection(order.token))
        except BaseException:
            services.connections.pop(order.token, None)
            raise
        return Connection(self, done, ending)

    def _check(self) -> None:
        """Raises UsageError for what the GSD file of the slave excludes."""
        who = f"slave {self.order.address} ({self.name})"
        if not self.limits.c2_read_write:
            raise UsageError(f"{who}: its GSD file says C2_Read_Write_supp = 0: it has no class 2 connections")
        try:
            pdu = self.order.request.build()
        except PduError:
            return  # the machine refuses it with the reason
        longest = max(LEAST_INITIATE, self.limits.max_initiate_pdu_length)
        if self.limits.max_initiate_pdu_length and longest < len(pdu):
            raise UsageError(
                f"{who}: Initiate has {len(pdu)} octets with these addresses, its GSD file says "
                f"Max_Initiate_PDU_Length = {longest}: leave network addresses out"
            )
