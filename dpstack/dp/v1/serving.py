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

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Protocol
from weakref import WeakKeyDictionary

from dpstack.dp.v1.alarm_server import AlarmServer
from dpstack.dp.v1.alarms import Alarm, AlarmAck
from dpstack.dp.v1.codes import Code
from dpstack.dp.v1.im import IM_FI, IM_INDEX, IM_LEN, RECORDS, Im, Im0, build_call, number_of, parse_call
from dpstack.dp.v1.records import MAX_SLOT, Function, Negative, ReadReq, UnacceptableError, WriteReq, parse_request
from dpstack.dp.v1.tickets import Asker, Records, Ticket, Told, put
from dpstack.errors import PduError
from dpstack.fdl.telegram import SAP_MS1, Resp
from dpstack.fdl.user import SC_REPLY, Reply


class Ms1Told(Told, Protocol):
    """Where MS1 tells what it refused, and which alarm is over."""

    def acknowledged(self, alarm: Alarm, master: int, now: int) -> None:
        """An alarm is over."""


class Ms1Server:
    """MS1 of one slave application: ``records`` and ``alarms``, None where the device has none; without both the SAP is
    closed."""

    __slots__ = ("_alarm_answer", "_alarms", "_asker", "_report", "_ticket", "enabled", "records")

    def __init__(self, records: Records | None, report: Ms1Told, alarms: AlarmServer | None = None) -> None:
        self.records = records
        self._alarms = alarms
        self._alarm_answer: AlarmAck | Negative | None = None  # at the extra SAP
        #: DPV1_Enable was in Set_Prm
        self.enabled = False
        self._report = report
        self._ticket: Ticket | None = None
        self._asker: Asker | None = None

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
        self._drop()
        if self._asker is not None:
            self._asker.open = False
            self._asker = None

    def serve(self, octets: bytes, sa: int, now: int) -> Reply:
        """A request, or a poll (no octets)."""
        if not octets:
            answer = None if self._ticket is None else self._ticket.take(self._report, now)
            return SC_REPLY if answer is None else Reply(Resp.DL, answer)
        self._drop()
        if self._asker is None or self._asker.master != sa:
            self._asker = Asker(sa, SAP_MS1)
        if octets[0] == Function.ALARM_ACK and self._alarms is not None:
            self._answer_at_once(self._acknowledge(self._alarms, octets, sa, now), self._asker)
            return SC_REPLY
        try:
            request = parse_request(octets)
        except UnacceptableError as error:
            self._answer_at_once(error.negative, self._asker)
            self._report.refused("MS1", sa, str(error), now)
            return SC_REPLY
        self._ticket = Ticket(request, self._asker, now)
        put(self._ticket, self.records)
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

    def _answer_at_once(self, answer: Negative | AlarmAck, asker: Asker) -> None:
        self._ticket = Ticket(ReadReq(0, 0), asker)
        self._ticket.response = answer

    def _drop(self) -> None:
        ticket, self._ticket = self._ticket, None
        if ticket is not None:
            ticket.drop()


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


class ByIndex:
    """Records of some indexes by servers of their own, everything else handed on to ``others``."""

    def __init__(self, served: Mapping[int, Records], others: Records | None) -> None:
        self._served = dict(served)
        self._others = others

    def ask(self, ticket: Ticket) -> None:
        """By whoever has the index."""
        put(ticket, self._served.get(ticket.request.index, self._others))


#: I&M of every slot alike, or slot -> those of this one
ImOf = Iterable[Im] | Mapping[int, Iterable[Im]]


class ImRecords:
    """I&M at index 255, everything else handed on to ``others``.

    ``records``: I&M0 and whichever else there are, for every slot alike or by slot (0..254; others are refused). I&M1
    to 4 can be written: ``changed`` is told slot and record first, and refuses by raising. The bits of
    ``Im0.supported`` follow from what there is. Raises PduError for what does not fit.
    """

    def __init__(
        self, records: ImOf, others: Records | None = None, changed: Callable[[int, Im], None] | None = None
    ) -> None:
        #: None: of all slots
        self._slots: dict[int | None, dict[int, Im]] = {}
        if isinstance(records, Mapping):
            for slot, found in records.items():
                if not 0 <= slot <= MAX_SLOT:
                    raise PduError(f"I&M of slot {slot}: slots are 0..{MAX_SLOT}")
                self._slots[slot] = _of_one_slot(found)
        else:
            self._slots[None] = _of_one_slot(records)
        self.others = others
        self._changed = changed
        self._called: WeakKeyDictionary[Asker, dict[int, int]] = WeakKeyDictionary()

    def of(self, slot: int = 0) -> tuple[Im, ...]:
        """Those of ``slot`` as they stand now, by number; none where it has none."""
        found = self._found(slot)
        return tuple(found[number] for number in sorted(found))

    def _found(self, slot: int) -> dict[int, Im]:
        return self._slots.get(None) or self._slots.get(slot) or {}

    def ask(self, ticket: Ticket) -> None:
        """I&M at once; what is no call goes on."""
        request = ticket.request
        called = self._called.setdefault(ticket.asker, {})  # each who asks has calls of its own
        if request.index != IM_INDEX:
            self._hand_on(ticket)
        elif isinstance(request, WriteReq):
            self._call(ticket, request, called)
        elif request.slot in called:
            number = called[request.slot]
            ticket.answer(build_call(number, self._found(request.slot)[number]))
        else:
            self._hand_on(ticket)

    def _call(self, ticket: Ticket, request: WriteReq, called: dict[int, int]) -> None:
        try:
            fi_index, data = parse_call(request.data)
        except PduError:
            called.pop(request.slot, None)
            self._hand_on(ticket)
            return
        number = fi_index - IM_FI.start
        found = self._found(request.slot)
        if number not in found:
            ticket.refuse(Code.INVALID_RANGE if found else Code.INVALID_SLOT)
            return
        if data:
            if not number:
                ticket.refuse(Code.ACCESS_DENIED)
                return
            if len(data) != IM_LEN:
                ticket.refuse(Code.WRITE_LENGTH)
                return
            record = RECORDS[number].parse(data)
            if self._changed is not None:
                self._changed(request.slot, record)
            found[number] = record
        called[request.slot] = number
        ticket.answer()

    def _hand_on(self, ticket: Ticket) -> None:
        if self.others is None:
            ticket.refuse(Code.STATE_CONFLICT if ticket.request.index == IM_INDEX else Code.INVALID_INDEX)
        else:
            self.others.ask(ticket)


def _of_one_slot(records: Iterable[Im]) -> dict[int, Im]:
    found = {number_of(record): record for record in records}
    bits = sum(1 << number for number in found if number)
    known = found.get(0, Im0())
    assert isinstance(known, Im0)
    found[0] = dataclasses.replace(known, supported=known.supported | bits)
    for record in found.values():
        record.build()  # raises PduError here, not when it is read
    return found
