"""``bus.class2.connect(...)``: a class 2 connection (MS2) to a slave."""

from __future__ import annotations

import asyncio
import contextlib
import weakref
from collections.abc import Awaitable, Callable, Generator
from types import TracebackType
from typing import TypeVar

from dpstack.api.config.dpv1 import Ms2Limits
from dpstack.api.slave.record_parameters import RecordParameters, over_records
from dpstack.api.slave.records import RecordAccess, usual_timeout
from dpstack.api.slave.services import ConnectionEnd, Services
from dpstack.argcheck import Sealed, octets, whole
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dpv1.master.ms1 import RecordDone
from dpstack.dpv1.master.ms2 import NO_CONNECTION
from dpstack.dpv1.master.ms2_commands import (
    CloseConnection,
    InitiateDone,
    OpenConnection,
    ReadOver,
    TransportDone,
    TransportOver,
    WriteOver,
)
from dpstack.dpv1.pdu.ms2 import Address, InitiateReq
from dpstack.errors import ConnectionEnded, PduError, UsageError
from dpstack.units import ns_to_s

#: Slave_Diag of the slave at an address
ReadsDiagnosis = Callable[[int], Awaitable[Diagnosis]]
Done = TypeVar("Done", RecordDone, TransportDone)


class Connection(Sealed, RecordAccess):
    """An open connection. Its services queue, up to 32; it is kept alive until it is closed, or the bus is, or nothing
    refers to it any more: slaves have few.

    All raise ConnectionEnded once it is over (also those under way), otherwise as :meth:`Slave.read` does:
    AcyclicError, SlaveTimeout, SlaveFault, UsageError, BusError. ``timeout`` in seconds from the call (None: 10, longer
    where C2_Response_Timeout is); what takes the slave longer than that ends the connection.
    """

    def __init__(
        self,
        services: Services,
        done: InitiateDone,
        ending: ConnectionEnd,
        name: str,
        longest: int,
        response_ns: int,
        diagnosis: ReadsDiagnosis,
    ) -> None:
        self._services = services
        self._response_ns = response_ns
        self._done = done
        self._diagnosis = diagnosis
        self._ending = ending
        self._longest = min(longest, done.max_len)
        self._im_call = asyncio.Lock()
        #: the slave's name on this bus, or "slave" and its address
        self.name = name
        # a program may drop the connection without close()
        left = weakref.finalize(self, _close_later, services, done.token, ending, asyncio.get_running_loop())
        left.atexit = False
        self._seal(Connection)

    def _sealed_name(self) -> str:
        return f"connection to slave {self.address}"

    @property
    def address(self) -> int:
        return self._done.address

    @property
    def who(self) -> str:
        return f"slave {self.address} (server SAP {self.server_sap})"

    @property
    def im_call(self) -> asyncio.Lock:
        """The slave keeps the calls of each connection apart."""
        return self._im_call

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
        return self.longest

    @property
    def usual_timeout(self) -> float:
        """By C2_Response_Timeout."""
        return usual_timeout(self._response_ns)

    @property
    def longest(self) -> int:
        return self._longest

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

    async def read(self, slot: int, index: int, length: int | None = None, *, timeout: float | None = None) -> bytes:
        """Read a record: up to ``length`` octets (None: the longest possible)."""
        token = self._services.token()
        wanted = self._longest if length is None else whole("length", length)
        order = ReadOver(token, self._done.token, *_place(slot, index), wanted, self._time(timeout))
        return (await self._do(token, order, RecordDone)).outcome.data

    async def write(self, slot: int, index: int, data: bytes, *, timeout: float | None = None) -> None:
        """Write all of ``data`` into a record."""
        data = self._checked(data)
        token = self._services.token()
        order = WriteOver(token, self._done.token, *_place(slot, index), data, self._time(timeout))
        await self._do(token, order, RecordDone)

    async def transport(self, slot: int, index: int, data: bytes = b"", *, timeout: float | None = None) -> bytes:
        """Data_Transport: send ``data``, return the slave's data."""
        data = self._checked(data)
        token = self._services.token()
        order = TransportOver(token, self._done.token, *_place(slot, index), data, self._time(timeout))
        return (await self._do(token, order, TransportDone)).outcome.data

    def parameters(self, slot: int = 1, *, object: int = 1, timeout: float | None = None) -> RecordParameters:
        """PROFIdrive's parameter access over this connection, otherwise as :meth:`Slave.parameters`."""
        return RecordParameters(self.name, over_records(self, timeout), slot, object=object, longest=self.longest)

    async def ident(self) -> int:
        """The slave's ident number, by Slave_Diag."""
        return (await self._diagnosis(self.address)).ident

    async def ended(self) -> None:
        """Wait until either side has ended it; then :attr:`reason` says why."""
        await self._ending.ended.wait()

    async def close(self) -> None:
        """End it by Abort, and wait until the slave has confirmed or is out of reach. May be repeated."""
        self._services.close_connection(self._done.token, self._ending)
        await self._ending.ended.wait()

    async def __aenter__(self) -> Connection:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def _do(self, token: int, order: object, kind: type[Done]) -> Done:
        self._check_open()
        try:
            return await self._services.do(token, order, kind)
        except UsageError as error:  # it ended before its event came
            if not str(error).startswith(NO_CONNECTION):
                raise
            raise ConnectionEnded(self.address, f"slave {self.address}: {error}") from None

    def _check_open(self) -> None:
        ending = self._ending
        if ending.lost is not None:
            raise ending.lost
        if ending.over is not None:
            text = f"{ending.over.text}; open a new one"
            raise ConnectionEnded(self.address, text, abort=ending.over.abort)

    def _checked(self, given: bytes) -> bytes:
        data = octets("data", given)
        if self._longest < len(data) <= MAX_RECORD:
            what = f"{len(data)} octets, it takes {self._longest} in one service"
            raise UsageError(f"{self.who}: {what} (C2_Max_Data_Len, Max_Len_Data_Unit of Initiate): send less")
        return data


def _close_later(services: Services, token: int, ending: ConnectionEnd, loop: asyncio.AbstractEventLoop) -> None:
    """For a finalizer, which may run in any thread."""
    with contextlib.suppress(RuntimeError):  # the loop is over, and the bus with it
        loop.call_soon_threadsafe(services.close_connection, token, ending)


class Connecting:
    """A connection being opened: await it, or enter it with ``async with``, which closes it at the end.

    Once: a second time raises UsageError.
    """

    def __init__(
        self, services: Services, order: OpenConnection, name: str, limits: Ms2Limits, diagnosis: ReadsDiagnosis
    ) -> None:
        self._services = services
        self._diagnosis = diagnosis
        self._order = order
        self._name = name
        self._limits = limits
        self._begun = False
        self._opened: Connection | None = None

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
        services, order, limits = self._services, self._order, self._limits
        who = f"slave {order.address} ({self._name})"
        if not limits.supported:
            raise UsageError(f"{who}: its GSD file says C2_Read_Write_supp = 0: it has no class 2 connections")
        _check_initiate(who, order, limits)
        ending = services.connections[order.token] = ConnectionEnd()
        try:
            done = await services.do(order.token, order, InitiateDone, cancel=CloseConnection(order.token))
        except BaseException:
            services.connections.pop(order.token, None)
            raise
        longest, response_ns = limits.max_data_len, order.response_ns
        return Connection(services, done, ending, self._name, longest, response_ns, self._diagnosis)


def _place(slot: int, index: int) -> tuple[int, int]:
    return whole("slot", slot), whole("index", index)


def _check_initiate(who: str, order: OpenConnection, limits: Ms2Limits) -> None:
    try:
        source, destination = (Address(a[0], a[1], a[2:]) for a in (order.source, order.destination))
        pdu = InitiateReq(order.send_timeout_ns, source=source, destination=destination).build()
    except (PduError, IndexError):
        return  # the machine refuses it with the reason
    if 0 < limits.max_initiate_len < len(pdu):
        raise UsageError(
            f"{who}: Initiate has {len(pdu)} octets with these addresses, its GSD file says "
            f"Max_Initiate_PDU_Length = {limits.max_initiate_len}: leave network addresses out"
        )
