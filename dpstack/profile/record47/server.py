"""The drive's end of record 47: takes a request by Write, carries it out, gives the response by Read.

Source: LS CPDP-S100 manual 6.2.2: 0xB5 while a request is carried out. Readings: a response is given once, after that,
and before any request, a Read is answered 0xB5; a new request drops a response that nobody read; what is no request is
answered 0xB7. Error 05 is a type that the parameter does not have, 17 a format that nobody knows (Siemens SINAMICS DCM
manual p446).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.dpv1.slave.record_requests import Asker, Ticket
from dpstack.errors import PduError
from dpstack.profile.model.param_errors import BAD_ADDRESS, BAD_COUNT, BAD_FORMAT, NO_OBJECT, TOO_LONG
from dpstack.profile.record47.formats import ZERO, UnknownFormatError
from dpstack.profile.record47.pdu import (
    HEADER_LEN,
    INDEX,
    Address,
    Attribute,
    ErrorValue,
    Request,
    RequestId,
    Response,
    Result,
    Values,
)
from dpstack.profile.record47.split import Limits
from dpstack.profile.record47.transport import Refused

_BUSY: Final = Refused(Code.STATE_CONFLICT)
#: how long a response is kept for whoever asked while others want the drive
_HELD_NS: Final = 2_000_000_000


class RecordServer(Protocol):
    """The drive's end of Read and Write, asked by whoever has the bus. ``now`` in ns."""

    def write_record(self, slot: int, index: int, data: bytes, now: int) -> Refused | None:
        """None when it was taken."""

    def read_record(self, slot: int, index: int, length: int, now: int) -> bytes | Refused:
        """At most ``length`` octets."""


class TimedRecords:
    """Records of a slave application (:class:`~dpstack.dpv1.slave.record_requests.Records`) over a server, for several
    who ask.

    ``clock``: from the bus's time of a request to the drive's, both in ns; default the bus's. The drive carries out one
    request of record 47 at a time: while one is carried out or its response waits for whoever asked (as long as that
    one can fetch it, for 2 s at most), a Write of somebody else is answered 0xC2, a Read 0xB5 as before any request
    (readings).
    """

    def __init__(self, server: RecordServer, clock: Callable[[int], int] = lambda bus: bus) -> None:
        self._server = server
        self._clock = clock
        self._holder: Asker | None = None
        self._held_until = 0

    def ask(self, ticket: Ticket) -> None:
        """At once: what is not ready is refused, and asked again."""
        request, asker, now = ticket.request, ticket.asker, self._clock(ticket.at)
        if request.index == INDEX and self._holder not in (None, asker):
            if isinstance(request, ReadReq):
                ticket.refuse(Code.STATE_CONFLICT)
                return
            if self._is_kept(now):
                ticket.refuse(Code.RESOURCE_BUSY)
                return
        if isinstance(request, WriteReq):
            answer = self._server.write_record(request.slot, request.index, request.data, now) or b""
        else:
            answer = self._server.read_record(request.slot, request.index, request.length, now)
        if isinstance(answer, Refused):
            ticket.refuse(answer.code)
            return
        self._holder = asker if isinstance(request, WriteReq) else None
        self._held_until = now + _HELD_NS
        ticket.answer(answer)

    def _is_kept(self, now: int) -> bool:
        return self._holder is not None and self._holder.open and now < self._held_until


class ParameterModel(Protocol):
    """What a drive has: one call for each parameter of a request."""

    def read(self, address: Address) -> Result: ...

    def change(self, address: Address, values: Values) -> ErrorValue | None:
        """None when all are written; else none is."""

    def describe(self, address: Address) -> Result:
        """The description, or one element of it."""

    def text(self, address: Address) -> Result:
        """Texts of 16 characters."""


@dataclass(frozen=True, slots=True)
class Rules:
    """What the server takes. ``slots``: None for any; ``attributes``: others are answered with error 16 hex.

    ``busy_ns``: what a request takes.
    """

    slots: frozenset[int] | None = None
    objects: frozenset[int] = frozenset({0, 1})
    attributes: frozenset[int] = frozenset(Attribute)
    limits: Limits = field(default_factory=Limits)
    busy_ns: int = 0


class ParameterServer:
    """A :class:`RecordServer` for record 47 over what the drive has."""

    __slots__ = ("_model", "_ready_at", "_response", "rules")

    def __init__(self, model: ParameterModel, rules: Rules | None = None) -> None:
        self.rules = Rules() if rules is None else rules
        self._model = model
        self._response: bytes | None = None
        self._ready_at = 0

    def reset(self) -> None:
        """Data exchange begins or ends: nothing was asked."""
        self._response = None

    def write_record(self, slot: int, index: int, data: bytes, now: int) -> Refused | None:
        wrong = self._elsewhere(slot, index)
        if wrong is not None:
            return wrong
        if self._response is not None and now < self._ready_at:
            return _BUSY
        if len(data) > self.rules.limits.octets:
            return Refused(Code.WRITE_LENGTH)
        try:
            request = Request.parse(data)
            formats_known = True
        except UnknownFormatError:
            request, formats_known = Request.parse_addresses(data), False
        except PduError:
            return Refused(Code.INVALID_RANGE)
        if not request.reference or not request.addresses or len(request.addresses) > self.rules.limits.parameters:
            return Refused(Code.INVALID_RANGE)
        response = self._carried_out(request) if formats_known else _failed(request, BAD_FORMAT)
        self._response = response.build()
        self._ready_at = now + self.rules.busy_ns
        return None

    def read_record(self, slot: int, index: int, length: int, now: int) -> bytes | Refused:
        """The response once it is ready."""
        wrong = self._elsewhere(slot, index)
        if wrong is not None:
            return wrong
        response = self._response
        if response is None or now < self._ready_at:
            return _BUSY
        if len(response) > length:
            return Refused(Code.INVALID_RANGE)
        self._response = None
        return response

    def _elsewhere(self, slot: int, index: int) -> Refused | None:
        if self.rules.slots is not None and slot not in self.rules.slots:
            return Refused(Code.INVALID_SLOT)
        return None if index == INDEX else Refused(Code.INVALID_INDEX)

    def _carried_out(self, request: Request) -> Response:
        results: Sequence[Result]
        if request.object not in self.rules.objects:
            return _failed(request, NO_OBJECT)
        if request.id == RequestId.READ:
            results = self._fitting([self._read(one) for one in request.addresses])
        else:
            changes = zip(request.addresses, request.values, strict=True)
            results = [self._change(*one) for one in changes]
        negative = any(isinstance(one, ErrorValue) for one in results)
        if request.id == RequestId.CHANGE and not negative:
            results = ()
        return Response(request.reference, request.id, request.object, len(request.addresses), tuple(results), negative)

    def _fitting(self, results: list[Result]) -> list[Result]:
        """What is beyond the longest block becomes an error; the others keep room for theirs."""
        short = ErrorValue(TOO_LONG)
        error = len(short.build())
        room = self.rules.limits.octets - HEADER_LEN - error * len(results)
        fitting: list[Result] = []
        for one in results:
            more = len(one.build()) - error
            if more > room and more > 0:
                fitting.append(short)
                continue
            room -= more
            fitting.append(one)
        return fitting

    def _read(self, address: Address) -> Result:
        if not self._permitted(address):
            return ErrorValue(BAD_ADDRESS)
        if address.attribute == Attribute.VALUE:
            return self._model.read(address)
        return (
            self._model.describe(address) if address.attribute == Attribute.DESCRIPTION else self._model.text(address)
        )

    def _change(self, address: Address, values: Values) -> Result:
        if not self._permitted(address) or address.attribute != Attribute.VALUE:
            return ErrorValue(BAD_ADDRESS)
        if len(values.raws) != max(address.elements, 1):
            return ErrorValue(BAD_COUNT)
        return self._model.change(address, values) or Values(ZERO)

    def _permitted(self, address: Address) -> bool:
        return address.attribute in self.rules.attributes and address.elements <= self.rules.limits.elements


def _failed(request: Request, error: int) -> Response:
    """``error`` for each of its parameters."""
    count = len(request.addresses)
    return Response(request.reference, request.id, request.object, count, (ErrorValue(error),) * count, True)
