"""One request for a record and the way its answer goes: the same for MS1 and MS2, whoever asks.

An application answers a ticket now or later, once; the server that made it hands the answer out when it is polled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol, TypeVar

from dpstack.dp.error_origin import DEVICE_CALL, failure_text
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.slave.events import Report
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import (
    DataTransport,
    Function,
    Negative,
    ReadRes,
    RecordReq,
    RecordRes,
    WriteReq,
    WriteRes,
)
from dpstack.errors import PduError, RecordRefused


@dataclass(eq=False)
class Asker:
    """Who asks: ``master`` on ``sap``, 51 for MS1 or the server SAP of a connection; ``open`` while it can go on."""

    master: int
    sap: int
    open: bool = True


#: of tickets that nobody on a bus has asked for
NOBODY: Final = Asker(-1, -1)


class AnyRequest:
    """What every service has in common; exactly one of the methods is called, once, whenever it is known.

    ``open``: the answer is still wanted; ``abandoned`` is called when it is not any more. Then it would be dropped.
    """

    def __init__(self, function: Function, title: str, asker: Asker, at: int) -> None:
        self.function = function
        #: service, slot and index
        self.title = title
        self.asker = asker
        #: when it was asked, in ns
        self.at = at
        self.open = True
        self.abandoned: Callable[[], object] | None = None
        self.response: RecordRes | DataTransport | None = None
        #: what went wrong in the function that should have answered
        self.failure: str | None = None

    def refuse(self, code_1: int, code_2: int = 0) -> None:
        """No: ``code_1`` is class and code (:class:`~dpstack.dpv1.pdu.error_codes.Code`), ``code_2`` the device's
        own."""
        self._respond(Negative(self.function, code_1 & 0xFF, code_2 & 0xFF))

    def fail(self, error: BaseException) -> None:
        """A function raised: RecordRefused says what to answer, anything else is a read or write error, and told."""
        if isinstance(error, RecordRefused):
            self.refuse(error.code_1, error.code_2)
            return
        if not self.open:
            return
        self.failure = failure_text(error)
        self.refuse(Code.READ_ERROR if self.function is Function.READ else Code.WRITE_ERROR)

    def drop(self) -> None:
        """Nobody wants the answer any more."""
        self.open = False
        if self.response is None and self.abandoned is not None:
            self.abandoned()

    def take(self, report: Report, now: int) -> bytes | None:
        """The answer in octets once there is one; what failed is told to ``report``."""
        if self.failure is not None:
            report.refused(self.title, self.asker.master, self.failure, now)
            self.failure = None
        return None if self.response is None else self.response.build()

    def _respond(self, response: RecordRes | DataTransport) -> None:
        if self.open and self.response is None:
            self.response = response


T = TypeVar("T", bound=AnyRequest)


class RecordRequest(AnyRequest):
    """A Read or Write."""

    def __init__(self, request: RecordReq, asker: Asker = NOBODY, at: int = 0) -> None:
        function = Function.WRITE if isinstance(request, WriteReq) else Function.READ
        super().__init__(function, f"{function.title} of slot {request.slot}, index {request.index}", asker, at)
        self.request = request

    def answer(self, data: bytes = b"") -> None:
        """It is done; ``data`` of a Read: what is longer than was asked for is cut off. Raises PduError where it is
        longer than any record."""
        request = self.request
        if len(data) > MAX_RECORD:
            raise PduError(f"{len(data)} octets of data, {MAX_RECORD} are possible in one record")
        if isinstance(request, WriteReq):
            self._respond(WriteRes(request.slot, request.index, len(request.data)))
        else:
            self._respond(ReadRes(request.slot, request.index, bytes(data[: request.length])))


class TransportRequest(AnyRequest):
    """A Data_Transport."""

    def __init__(self, request: DataTransport, asker: Asker = NOBODY, at: int = 0) -> None:
        where = f"Data_Transport to slot {request.slot}, index {request.index}"
        super().__init__(Function.DATA_TRANSPORT, where, asker, at)
        self.request = request

    def answer(self, data: bytes = b"") -> None:
        """What goes back, nothing included. Raises PduError where it is too long."""
        if len(data) > MAX_RECORD:
            raise PduError(f"{len(data)} octets of data, {MAX_RECORD} are possible in one service")
        self._respond(DataTransport(self.request.slot, self.request.index, bytes(data)))


class Records(Protocol):
    """The records of a device."""

    def ask(self, ticket: RecordRequest) -> None:
        """Answer the request, at once or later. An exception is answered as by :meth:`RecordRequest.fail`."""


#: what serves Data_Transport: answers the ticket, at once or later
Transport = Callable[[TransportRequest], None]


def put(ticket: RecordRequest, records: Records | None) -> None:
    """Let ``records`` answer it; a device that has none refuses."""
    _put(ticket, None if records is None else records.ask, Code.INVALID_INDEX)


def put_transport(ticket: TransportRequest, transport: Transport | None) -> None:
    """Let ``transport`` answer it; a device that has none refuses."""
    _put(ticket, transport, Code.FEATURE_NOT_SUPPORTED)


def _put(ticket: T, serve: Callable[[T], object] | None, otherwise: Code) -> None:
    if serve is None:
        ticket.refuse(otherwise)
        return
    try:
        with DEVICE_CALL:
            serve(ticket)
    except Exception as error:
        ticket.fail(error)
