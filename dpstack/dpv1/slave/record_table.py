"""Ready-made records of a slave: a table of octets, and I&M at index 255.

Both answer the requests of MS1 and of class 2 connections (:class:`~dpstack.dpv1.slave.record_requests.Records`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from weakref import WeakKeyDictionary

from msgspec import structs

from dpstack.argcheck import whole_number
from dpstack.dp.pdu.layouts import MAX_SLOT
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.im import IM_FI, IM_INDEX, IM_LEN, RECORDS, Im, Im0, build_call, number_of, parse_call
from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.dpv1.slave.record_requests import Asker, RecordRequest, Records, ask_records
from dpstack.errors import PduError
from dpstack.text import brief


class RecordTable:
    """Records in a table: (slot, index) -> octets; ``writable`` may be written, in their length."""

    def __init__(self, records: Mapping[tuple[int, int], bytes], writable: Iterable[tuple[int, int]] = ()) -> None:
        self.records = dict(records)
        self._writable = frozenset(writable)

    def ask(self, request: RecordRequest) -> None:
        service = request.service
        where = (service.slot, service.index)
        if where not in self.records:
            slots = {slot for slot, _ in self.records}
            request.refuse(Code.INVALID_INDEX if service.slot in slots else Code.INVALID_SLOT)
        elif isinstance(service, ReadReq):
            request.answer(self.records[where])
        elif where not in self._writable:
            request.refuse(Code.ACCESS_DENIED)
        elif len(service.data) != len(self.records[where]):
            request.refuse(Code.WRITE_LENGTH_ERROR)
        else:
            self.records[where] = service.data
            request.answer()


class ByIndex:
    """Records of some indexes by servers of their own, everything else handed on to ``others``."""

    def __init__(self, served: Mapping[int, Records], others: Records | None) -> None:
        self._served = dict(served)
        self._others = others

    def ask(self, request: RecordRequest) -> None:
        """Hand the request to the server of its index."""
        ask_records(request, self._served.get(request.service.index, self._others))


#: I&M of every slot alike, or slot -> those of this one
ImOf = Iterable[Im] | Mapping[int, Iterable[Im]]


class ImRecords:
    """I&M at index 255, everything else handed on to ``others``.

    ``records``: I&M0 and whichever else there are, for every slot alike or by slot (0..254; others are refused). I&M1
    to 4 can be written: ``changed`` is called with slot and record before, and refuses by raising. The bits of
    ``Im0.supported`` follow from what there is. Raises PduError for what does not fit.
    """

    def __init__(
        self, records: ImOf, others: Records | None = None, changed: Callable[[int, Im], None] | None = None
    ) -> None:
        #: None: of all slots
        self._slots: dict[int | None, dict[int, Im]] = {}
        if isinstance(records, Mapping):
            for slot, found in records.items():
                if not 0 <= whole_number("slot of I&M", slot, PduError) <= MAX_SLOT:
                    raise PduError(f"I&M of slot {slot}: slots are 0..{MAX_SLOT}")
                self._slots[slot] = _of_one_slot(found)
        else:
            self._slots[None] = _of_one_slot(records)
        self.others = others
        self._changed = changed
        self._called: WeakKeyDictionary[Asker, dict[int, int]] = WeakKeyDictionary()

    def of(self, slot: int = 0) -> tuple[Im, ...]:
        """Those of ``slot`` as they stand now, by number; none if it has none."""
        found = self._found(slot)
        return tuple(found[number] for number in sorted(found))

    def _found(self, slot: int) -> dict[int, Im]:
        return self._slots.get(None) or self._slots.get(slot) or {}

    def ask(self, request: RecordRequest) -> None:
        """Answer I&M at once, hand on all other requests."""
        service = request.service
        called = self._called.setdefault(request.asker, {})  # each asker has calls of its own
        if service.index != IM_INDEX:
            self._hand_on(request)
        elif isinstance(service, WriteReq):
            self._call(request, service, called)
        elif service.slot in called:
            number = called[service.slot]
            request.answer(build_call(number, self._found(service.slot)[number]))
        else:
            self._hand_on(request)

    def _call(self, request: RecordRequest, service: WriteReq, called: dict[int, int]) -> None:
        try:
            fi_index, data = parse_call(service.data)
        except PduError:
            called.pop(service.slot, None)
            self._hand_on(request)
            return
        number = fi_index - IM_FI.start
        found = self._found(service.slot)
        if number not in found:
            request.refuse(Code.INVALID_RANGE if found else Code.INVALID_SLOT)
            return
        if data:
            if not number:
                request.refuse(Code.ACCESS_DENIED)
                return
            if len(data) != IM_LEN:
                request.refuse(Code.WRITE_LENGTH_ERROR)
                return
            record = RECORDS[number].parse(data)
            if self._changed is not None:
                self._changed(service.slot, record)
            found[number] = record
        called[service.slot] = number
        request.answer()

    def _hand_on(self, request: RecordRequest) -> None:
        if self.others is None:
            request.refuse(Code.STATE_CONFLICT if request.service.index == IM_INDEX else Code.INVALID_INDEX)
        else:
            self.others.ask(request)


def _of_one_slot(records: Iterable[Im]) -> dict[int, Im]:
    if isinstance(records, (*RECORDS, str)) or not isinstance(records, Iterable):
        raise PduError(f"I&M = {brief(records)} is no list: write [Im0(order_id=...), Im1()]")
    given = tuple(records)
    for record in given:
        if not isinstance(record, RECORDS):
            raise PduError(f"{brief(record)} is no I&M record: give Im0(order_id=...), Im1(), Im2(), Im3() or Im4()")
    found = {number_of(record): record for record in given}
    bits = sum(1 << number for number in found if number)
    known = found.get(0, Im0())
    assert isinstance(known, Im0)
    found[0] = structs.replace(known, supported=known.supported | bits)
    for record in found.values():
        record.build()  # raises PduError here, not when it is read
    return found
