"""MS1 of a slave: requests come in, records answer now or later, the master polls for the answer.

Decisions where the sources are silent:

- Every request is acknowledged with SC and answered when polled, as slave chips do; a poll before that gets SC, too.
- A request while another one is being worked at, or has an answer that nobody fetched, takes its place: the master has
  given that one up, and whoever works at it is told.
- An answer stays until the next request: a poll whose answer was lost gets it again.
- Leaving data exchange ends everything; an answer that comes after that is dropped.
- Alarm_Ack is answered here, and where the device has the extra SAP also there, which then keeps an answer of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from dpstack.dp.v1.alarm_server import AlarmServer
from dpstack.dp.v1.alarms import Alarm, AlarmAck
from dpstack.dp.v1.codes import Code
from dpstack.dp.v1.im import IM_FI, IM_INDEX, IM_LEN, RECORDS, Im, Im0, build_call, number_of, parse_call
from dpstack.dp.v1.records import (
    Function,
    Negative,
    ReadReq,
    ReadRes,
    RecordReq,
    RecordRes,
    UnacceptableError,
    WriteReq,
    WriteRes,
    parse_request,
)
from dpstack.errors import PduError, RecordRefused
from dpstack.fdl.telegram import Resp
from dpstack.fdl.user import SC_REPLY, Reply


class Ticket:
    """One request and the way its answer goes: exactly one of the methods, once, whenever it is known.

    ``open``: the answer is still wanted; ``abandoned`` is called when it is not any more. Then it would be dropped.
    """

    def __init__(self, request: RecordReq) -> None:
        self.request = request
        self.open = True
        self.abandoned: Callable[[], object] | None = None
        self.response: RecordRes | AlarmAck | None = None
        #: what went wrong in the function that should have answered
        self.failure: str | None = None

    @property
    def title(self) -> str:
        """Service, slot and index."""
        function = Function.WRITE if isinstance(self.request, WriteReq) else Function.READ
        return f"{function.title} of slot {self.request.slot}, index {self.request.index}"

    def answer(self, data: bytes = b"") -> None:
        """It is done; ``data`` of a Read: what is longer than was asked for is cut off."""
        request = self.request
        if isinstance(request, WriteReq):
            self._respond(WriteRes(request.slot, request.index, len(request.data)))
        else:
            self._respond(ReadRes(request.slot, request.index, data[: request.length]))

    def refuse(self, code_1: int, code_2: int = 0) -> None:
        """No: ``code_1`` is class and code (:class:`~dpstack.dp.v1.codes.Code`), ``code_2`` the device's own."""
        self._respond(Negative(self._function, code_1 & 0xFF, code_2 & 0xFF))

    def fail(self, error: Exception) -> None:
        """A function raised: RecordRefused says what to answer, anything else is a read or write error, and told."""
        if isinstance(error, RecordRefused):
            self.refuse(error.code_1, error.code_2)
            return
        self.failure = f"{type(error).__name__}: {error}"
        self.refuse(Code.WRITE_ERROR if isinstance(self.request, WriteReq) else Code.READ_ERROR)

    @property
    def _function(self) -> Function:
        return Function.WRITE if isinstance(self.request, WriteReq) else Function.READ

    def _respond(self, response: RecordRes) -> None:
        if self.open and self.response is None:
            self.response = response


class Records(Protocol):
    """The records of a device."""

    def ask(self, ticket: Ticket) -> None:
        """A request: answer the ticket, at once or later. What it raises is answered as :meth:`Ticket.fail` does."""


class Told(Protocol):
    """Where a slave application tells what it refused."""

    def refused(self, service: str, master: int, reason: str, now: int) -> None:
        """Once for the same reason."""

    def acknowledged(self, alarm: Alarm, master: int, now: int) -> None:
        """An alarm is over."""


class Ms1Server:
    """MS1 of one slave application: ``records`` and ``alarms``, None where the device has none; without both the SAP is
    closed."""

    __slots__ = ("_alarm_answer", "_alarms", "_report", "_ticket", "enabled", "records")

    def __init__(self, records: Records | None, report: Told, alarms: AlarmServer | None = None) -> None:
        self.records = records
        self._alarms = alarms
        self._alarm_answer: AlarmAck | Negative | None = None  # at the extra SAP
        #: DPV1_Enable was in Set_Prm
        self.enabled = False
        self._report = report
        self._ticket: Ticket | None = None

    @property
    def open(self) -> bool:
        """The SAP is open, as far as parameters go."""
        alarms = self._alarms is not None and bool(self._alarms.support.kinds)
        return self.enabled and (alarms or self.records is not None)

    @property
    def extra_sap(self) -> bool:
        """The extra SAP of alarms is open."""
        return self.enabled and self._alarms is not None and self._alarms.support.extra_sap

    def close(self) -> None:
        """Data exchange is over."""
        self._alarm_answer = None
        self._give_up()

    def _give_up(self) -> None:
        """Another request came."""
        ticket, self._ticket = self._ticket, None
        if ticket is not None:
            ticket.open = False
            if ticket.response is None and ticket.abandoned is not None:
                ticket.abandoned()

    def serve(self, octets: bytes, sa: int, now: int) -> Reply:
        """A request, or a poll (no octets)."""
        ticket = self._ticket
        if not octets:
            return SC_REPLY if ticket is None or ticket.response is None else self._reply(ticket, sa, now)
        self._give_up()
        if octets[0] == Function.ALARM_ACK and self._alarms is not None:
            self._answer_at_once(self._acknowledge(self._alarms, octets, sa, now))
            return SC_REPLY
        try:
            request = parse_request(octets)
        except UnacceptableError as error:
            self._answer_at_once(error.negative)
            self._report.refused("MS1", sa, str(error), now)
            return SC_REPLY
        ticket = self._ticket = Ticket(request)
        if self.records is None:
            ticket.refuse(Code.INVALID_INDEX)
            return SC_REPLY
        try:
            self.records.ask(ticket)
        except Exception as error:
            ticket.fail(error)
        return SC_REPLY

    def serve_alarm(self, octets: bytes, sa: int, now: int) -> Reply:
        """A request at the extra SAP of alarms, or a poll."""
        if self._alarms is not None and octets:
            self._alarm_answer = self._acknowledge(self._alarms, octets, sa, now)
            return SC_REPLY
        answer = self._alarm_answer
        return SC_REPLY if answer is None else Reply(Resp.DL, answer.build())

    def _acknowledge(self, alarms: AlarmServer, octets: bytes, sa: int, now: int) -> AlarmAck | Negative:
        if octets[0] != Function.ALARM_ACK:
            self._report.refused("Alarm_Ack", sa, f"octet 1: no service 0x{octets[0]:02X} at SAP 50", now)
            return Negative(octets[0], Code.NOT_SUPPORTED)
        done = alarms.acknowledge(octets)
        if done.reason is not None:
            self._report.refused("Alarm_Ack", sa, done.reason, now)
        if done.alarm is not None:
            self._report.acknowledged(done.alarm, sa, now)
        return done.answer

    def _answer_at_once(self, answer: RecordRes | AlarmAck) -> None:
        ticket = self._ticket = Ticket(ReadReq(0, 0))
        ticket.response = answer

    def _reply(self, ticket: Ticket, sa: int, now: int) -> Reply:
        if ticket.failure is not None:
            self._report.refused(ticket.title, sa, f"its function failed ({ticket.failure})", now)
            ticket.failure = None
        if ticket.response is None:
            return SC_REPLY
        return Reply(Resp.DL, ticket.response.build())


class RecordTable:
    """Records that just stand there: (slot, index) -> octets; ``writable`` may be written, in their length."""

    def __init__(self, records: Mapping[tuple[int, int], bytes], writable: Iterable[tuple[int, int]] = ()) -> None:
        self.records = dict(records)
        self._writable = frozenset(writable)

    def ask(self, ticket: Ticket) -> None:
        """At once."""
        request = ticket.request
        where = (request.slot, request.index)
        if where not in self.records:
            slots = {slot for slot, _ in self.records}
            ticket.refuse(Code.INVALID_INDEX if request.slot in slots else Code.INVALID_SLOT)
        elif isinstance(request, ReadReq):
            ticket.answer(self.records[where])
        elif where not in self._writable:
            ticket.refuse(Code.ACCESS_DENIED)
        elif len(request.data) != len(self.records[where]):
            ticket.refuse(Code.WRITE_LENGTH)
        else:
            self.records[where] = request.data
            ticket.answer()


class ImRecords:
    """I&M at index 255 of every slot, everything else handed on to ``others``.

    ``records``: I&M0 and whichever else there are, I&M1 to 4 can be written; ``changed`` is told what was. The bits of
    ``Im0.supported`` follow from what there is.
    """

    def __init__(
        self, records: Iterable[Im], others: Records | None = None, changed: Callable[[Im], None] | None = None
    ) -> None:
        found = {number_of(record): record for record in records}
        bits = sum(1 << number for number in found if number)
        known = found.get(0, Im0())
        assert isinstance(known, Im0)
        fields = {name: getattr(known, name) for name in Im0.__dataclass_fields__}
        found[0] = Im0(**(fields | {"supported": known.supported | bits}))
        for record in found.values():
            record.build()  # raises PduError here, not when it is read
        self._found: dict[int, Im] = found
        self._others = others
        self._changed = changed
        self._called: dict[int, int] = {}

    @property
    def records(self) -> tuple[Im, ...]:
        """As they stand now, by number."""
        return tuple(self._found[number] for number in sorted(self._found))

    def ask(self, ticket: Ticket) -> None:
        """I&M at once; what is no call goes on."""
        request = ticket.request
        if request.index != IM_INDEX:
            self._hand_on(ticket)
        elif isinstance(request, WriteReq):
            self._call(ticket, request)
        elif request.slot in self._called:
            number = self._called[request.slot]
            ticket.answer(build_call(number, self._found[number]))
        else:
            self._hand_on(ticket)

    def _call(self, ticket: Ticket, request: WriteReq) -> None:
        try:
            fi_index, data = parse_call(request.data)
        except PduError:
            self._called.pop(request.slot, None)
            self._hand_on(ticket)
            return
        number = fi_index - IM_FI.start
        if number not in self._found:
            ticket.refuse(Code.INVALID_RANGE)
            return
        if data:
            if not number:
                ticket.refuse(Code.ACCESS_DENIED)
                return
            if len(data) != IM_LEN:
                ticket.refuse(Code.WRITE_LENGTH)
                return
            record = self._found[number] = RECORDS[number].parse(data)
            if self._changed is not None:
                self._changed(record)
        self._called[request.slot] = number
        ticket.answer()

    def _hand_on(self, ticket: Ticket) -> None:
        if self._others is None:
            ticket.refuse(Code.STATE_CONFLICT if ticket.request.index == IM_INDEX else Code.INVALID_INDEX)
        else:
            self._others.ask(ticket)
