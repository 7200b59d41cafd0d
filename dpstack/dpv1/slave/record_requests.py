"""A request for a record and its answer, the same for MS1 and MS2.

An application answers a request once, now or later. The server (MS1 or MS2) sends the answer when the master polls.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

from msgspec import Struct

from dpstack.dp.error_origin import DEVICE_CALL, failure_text
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.slave.device import DpV0Device
from dpstack.dp.slave.events import Report
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import DataTransport, Negative, ReadReq, Response, Service
from dpstack.errors import PduError, RecordRefused
from dpstack.fdl.telegram import MAX_DATA


class Asker(Struct, eq=False, weakref=True):
    """The origin of requests: ``master`` on ``sap``, 51 for MS1 or the server SAP of a connection; ``open`` until it
    ends."""

    master: int
    sap: int
    open: bool = True


#: of requests that no master on a bus has sent
NOBODY: Final = Asker(-1, -1)


class RecordRequest:
    """A Read, Write or Data_Transport. Its application calls exactly one of :meth:`answer`, :meth:`refuse` and
    :meth:`fail`, once, now or later.

    ``open``: the answer is still wanted; ``abandoned`` is called when it is not any more. Then it would be dropped.
    """

    def __init__(self, service: Service, asker: Asker = NOBODY, at: int = 0) -> None:
        self.service = service
        preposition = "to" if isinstance(service, DataTransport) else "of"
        #: service, slot and index
        self.title = f"{service.function.title} {preposition} slot {service.slot}, index {service.index}"
        self.asker = asker
        #: when it was asked, in ns
        self.at = at
        self.open = True
        self.abandoned: Callable[[], object] | None = None
        self.response: Response | None = None
        #: what went wrong in the function that should have answered
        self.failure: str | None = None

    def answer(self, data: bytes = b"") -> None:
        """Answer positively. ``data``: of a Read, cut to the length that was asked for, or of a Data_Transport. Raises
        PduError if they are longer than any record."""
        service = self.service
        if len(data) > MAX_RECORD:
            raise PduError(f"{len(data)} octets of data, {MAX_RECORD} are possible in one {service.UNIT}")
        self._respond(service.response(data))

    def refuse(self, code_1: int, code_2: int = 0) -> None:
        """Answer negatively: ``code_1`` is class and code (:class:`~dpstack.dpv1.pdu.error_codes.Code`), ``code_2`` the
        device's own."""
        self._respond(Negative(self.service.function, code_1 & 0xFF, code_2 & 0xFF))

    def fail(self, error: BaseException) -> None:
        """Answer for a function that raised ``error``: as RecordRefused says, else a read or write error, reported."""
        if isinstance(error, RecordRefused):
            self.refuse(error.code_1, error.code_2)
            return
        if not self.open:
            return
        self.failure = failure_text(error)
        self.refuse(Code.READ_ERROR if isinstance(self.service, ReadReq) else Code.WRITE_ERROR)

    def drop(self) -> None:
        """Drop the request: the master does not want the answer any more."""
        self.open = False
        if self.response is None and self.abandoned is not None:
            self.abandoned()

    def octets(self, report: Report, now: int) -> bytes | None:
        """The answer in octets once there is one; ``report`` gets what failed."""
        if self.failure is not None:
            report.refused(self.title, self.asker.master, self.failure, now)
            self.failure = None
        return None if self.response is None else self.response.build()

    def _respond(self, response: Response) -> None:
        if self.open and self.response is None:
            self.response = response


class Records(Protocol):
    """The records of a device."""

    def ask(self, request: RecordRequest) -> None:
        """Answer the request, at once or later. An exception is answered as by :meth:`RecordRequest.fail`."""


#: serves Data_Transport: answers the request, at once or later
Transport = Callable[[RecordRequest], None]


class AcyclicDevice(DpV0Device):
    """The part of a device that its acyclic services reach.

    ``ms2``: connections of class 2, 0..49; ``transport`` serves their Data_Transport, ``ms2_max_len``: octets of data
    in one of their services, up to 240; ``ms2_max_initiate``: octets of the longest Initiate, 20..244.
    """

    #: serves Read and Write; None: refused
    records: Records | None = None
    #: serves Data_Transport of class 2; None: refused
    transport: Transport | None = None
    ms2: int = 0
    #: octets of data in one service of class 2, up to 240
    ms2_max_len: int = MAX_RECORD
    ms2_max_initiate: int = MAX_DATA
    #: answers that are known at once stand in the request's own response, not in that of a poll
    ms2_at_once: bool = False

    def initiate(self, master: int, wanted: InitiateReq) -> None:
        """``master`` opens a connection of class 2: raise RecordRefused for a negative response to it."""


def ask_records(request: RecordRequest, records: Records | None) -> None:
    """Let ``records`` answer ``request``; a device that has none refuses."""
    ask(request, None if records is None else records.ask, Code.INVALID_INDEX)


def ask(request: RecordRequest, serve: Transport | None, otherwise: Code) -> None:
    """Let ``serve`` answer ``request``; without it the answer is ``otherwise``."""
    if serve is None:
        request.refuse(otherwise)
        return
    try:
        with DEVICE_CALL:
            serve(request)
    except Exception as error:
        request.fail(error)
