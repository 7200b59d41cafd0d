"""MS1 of a slave: requests come in, records answer now or later, the master polls for the answer.

Decisions where the sources are silent:

- Every request is acknowledged with SC and answered when polled, as slave chips do; a poll before that gets SC, too.
- A request while another one is being worked at, or has an answer that nobody fetched, takes its place: the master has
  given that one up, and whoever works at it is told.
- An answer stays until the next request: a poll whose answer was lost gets it again.
- Leaving data exchange ends everything; an answer that comes after that is dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from weakref import WeakKeyDictionary

from dpstack.dp.v1.codes import Code
from dpstack.dp.v1.im import IM_FI, IM_INDEX, IM_LEN, RECORDS, Im, Im0, build_call, number_of, parse_call
from dpstack.dp.v1.records import ReadReq, UnacceptableError, WriteReq, parse_request
from dpstack.dp.v1.tickets import Asker, Records, Ticket, Told, put
from dpstack.errors import PduError
from dpstack.fdl.telegram import SAP_MS1, Resp
from dpstack.fdl.user import SC_REPLY, Reply


class Ms1Server:
    """MS1 of one slave application. ``records`` None: the device has none, the SAP is closed."""

    __slots__ = ("_asker", "_report", "_ticket", "enabled", "records")

    def __init__(self, records: Records | None, report: Told) -> None:
        self.records = records
        #: DPV1_Enable was in Set_Prm
        self.enabled = False
        self._report = report
        self._ticket: Ticket | None = None
        self._asker: Asker | None = None

    @property
    def open(self) -> bool:
        """The SAP is open, as far as parameters go."""
        return self.enabled and self.records is not None

    def close(self) -> None:
        """Data exchange is over."""
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
        try:
            request = parse_request(octets)
        except UnacceptableError as error:
            self._ticket = Ticket(ReadReq(0, 0), self._asker)
            self._ticket.response = error.negative
            self._report.refused("MS1", sa, str(error), now)
            return SC_REPLY
        self._ticket = Ticket(request, self._asker, now)
        put(self._ticket, self.records)
        return SC_REPLY

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
        self._called: WeakKeyDictionary[Asker, dict[int, int]] = WeakKeyDictionary()

    @property
    def records(self) -> tuple[Im, ...]:
        """As they stand now, by number."""
        return tuple(self._found[number] for number in sorted(self._found))

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
            ticket.answer(build_call(number, self._found[number]))
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
        called[request.slot] = number
        ticket.answer()

    def _hand_on(self, ticket: Ticket) -> None:
        if self._others is None:
            ticket.refuse(Code.STATE_CONFLICT if ticket.request.index == IM_INDEX else Code.INVALID_INDEX)
        else:
            self._others.ask(ticket)
