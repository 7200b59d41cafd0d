"""The drive's end of record 47: takes a request by Write, carries it out, returns the response by Read.

Source: LS CPDP-S100 manual 6.2.2: 0xB5 while a request is carried out. Readings: a response is given once, after that,
and before any request, a Read is answered 0xB5; a new request drops a response that nobody read; what is no request is
answered 0xB7. Error 05 is a type that the parameter does not have, 17 a format that nobody knows (Siemens SINAMICS DCM
manual p446).

:class:`StoreParameters` has the parameters of a simulated drive's ParamStore at their number; data sets, and subindexes
that the table fixes, are elements. It adds the drive's limits (974) and the lists of its parameters (980 to 989: 300
elements each, the last one is the number of the next list, 0 ends).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

from msgspec import Struct, field

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import ReadReq
from dpstack.dpv1.slave.record_requests import Asker, RecordRequest
from dpstack.errors import PduError
from dpstack.profile.model import param_errors as errors
from dpstack.profile.model.param_store import ParamStore
from dpstack.profile.model.param_types import ParamType
from dpstack.profile.model.params import ParamSpec
from dpstack.profile.record47 import formats
from dpstack.profile.record47.formats import Raw, UnknownFormatError, format_of
from dpstack.profile.record47.param_lists import FIRST_LIST, LAST_LIST, PNU_LIMITS, Description
from dpstack.profile.record47.pdu import (
    HEADER_LEN,
    INDEX,
    Address,
    Attribute,
    ErrorValue,
    Limits,
    Refused,
    Request,
    RequestId,
    Response,
    Result,
    Values,
)
from dpstack.units import NS_PER_MS

_BUSY: Final = Refused(Code.STATE_CONFLICT)
#: time that a response is kept for its asker while others want the drive
_HELD_NS: Final = 2_000_000_000


class ParameterModel(ABC):
    """The parameters of a drive: one call for each parameter of a request."""

    @abstractmethod
    def read(self, address: Address) -> Result: ...

    @abstractmethod
    def change(self, address: Address, values: Values) -> ErrorValue | None:
        """None when all values are written; else none is."""

    def describe(self, address: Address) -> Result:
        """The description, or one element of it; without an own method: refused."""
        return ErrorValue(errors.NO_DESCRIPTION)

    def text(self, address: Address) -> Result:
        """Texts of 16 characters; without an own method: refused."""
        return ErrorValue(errors.NO_TEXT)


class Rules(Struct, frozen=True):
    """Rules of the server. ``slots``: None for any; ``attributes``: others are answered with error 16 hex.

    ``busy_ns``: duration of a request.
    """

    slots: frozenset[int] | None = None
    objects: frozenset[int] = frozenset({0, 1})
    attributes: frozenset[int] = frozenset(Attribute)
    limits: Limits = field(default_factory=Limits)
    busy_ns: int = 0


class ParameterServer:
    """The drive's end of Read and Write for record 47 over the parameters of ``model``. Times (``now``) in ns."""

    def __init__(self, model: ParameterModel, rules: Rules | None = None) -> None:
        self.rules = Rules() if rules is None else rules
        self._model = model
        self._response: bytes | None = None
        self._ready_at = 0

    def reset(self) -> None:
        """Data exchange begins or ends: forget the request."""
        self._response = None

    def write_record(self, slot: int, index: int, data: bytes, now: int) -> Refused | None:
        """None when the request was accepted."""
        wrong = self._elsewhere(slot, index)
        if wrong is not None:
            return wrong
        if self._response is not None and now < self._ready_at:
            return _BUSY
        if len(data) > self.rules.limits.octets:
            return Refused(Code.WRITE_LENGTH_ERROR)
        try:
            request = Request.parse(data)
            formats_known = True
        except UnknownFormatError:
            request, formats_known = Request.parse_addresses(data), False
        except PduError:
            return Refused(Code.INVALID_RANGE)
        if not request.reference or not request.addresses or len(request.addresses) > self.rules.limits.parameters:
            return Refused(Code.INVALID_RANGE)
        response = self._carried_out(request) if formats_known else _failed(request, errors.BAD_FORMAT)
        self._response = response.build()
        self._ready_at = now + self.rules.busy_ns
        return None

    def read_record(self, slot: int, index: int, length: int, now: int) -> bytes | Refused:
        """The response once it is ready, at most ``length`` octets."""
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
            return _failed(request, errors.NO_OBJECT)
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
        """Replace results beyond the longest block by an error; each other result keeps room for its own error."""
        short = ErrorValue(errors.TOO_LONG)
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
            return ErrorValue(errors.BAD_ADDRESS)
        if address.attribute == Attribute.VALUE:
            return self._model.read(address)
        return (
            self._model.describe(address) if address.attribute == Attribute.DESCRIPTION else self._model.text(address)
        )

    def _change(self, address: Address, values: Values) -> Result:
        if not self._permitted(address) or address.attribute != Attribute.VALUE:
            return ErrorValue(errors.BAD_ADDRESS)
        if len(values.raws) != max(address.elements, 1):
            return ErrorValue(errors.BAD_COUNT)
        return self._model.change(address, values) or Values(formats.ZERO)

    def _permitted(self, address: Address) -> bool:
        return address.attribute in self.rules.attributes and address.elements <= self.rules.limits.elements


def _failed(request: Request, error: int) -> Response:
    """``error`` for each of its parameters."""
    count = len(request.addresses)
    return Response(request.reference, request.id, request.object, count, (ErrorValue(error),) * count, True)


_LIST_LEN: Final = 300
#: substitutes for a format by its octets (Siemens SINAMICS manual p97)
_SUBSTITUTES: Final = {1: formats.BYTE, 2: formats.WORD, 4: formats.DOUBLE_WORD}


class _Place(NamedTuple):
    """An element of a parameter. ``fixed``: the value of an element that is not in the store."""

    spec: ParamSpec
    data_set: int = 1
    fixed: int | None = None


class StoreParameters(ParameterModel):
    """The parameters of ``store``, with the drive's ``limits`` (974) and the lists of its parameters (980 to 989).

    ``live``: the actual integer if it is not stored; ``locked``: error 11 hex now; ``changed``: called after a
    write; ``texts``: names of the values of a parameter from 0 on, by its number.
    """

    def __init__(
        self,
        store: ParamStore,
        *,
        limits: Limits | None = None,
        live: Callable[[ParamSpec], int | None] = lambda spec: None,
        locked: Callable[[ParamSpec], bool] = lambda spec: False,
        changed: Callable[[ParamSpec], None] = lambda spec: None,
        texts: Mapping[int, Sequence[str]] | None = None,
    ) -> None:
        self._texts = {} if texts is None else dict(texts)
        self._store = store
        self._live = live
        self._locked = locked
        self._changed = changed
        self._places: dict[int, dict[int, _Place]] = {}
        for spec in store.table:
            if spec.text:
                continue
            places = self._places.setdefault(spec.number, {})
            if spec.per_set and store.sets > 1:
                places.update((at, _Place(spec, at + 1)) for at in range(store.sets))
            else:
                places[spec.index] = _Place(spec)
        limits = Limits() if limits is None else limits
        lists = _lists(sorted(self._places))
        lists[PNU_LIMITS] = (limits.octets, limits.parameters, -(-limits.latency_ns // (10 * NS_PER_MS)))
        self._own = frozenset(lists)
        for pnu, words in lists.items():
            spec = ParamSpec(number=pnu, name=str(pnu), title="", read_only=True)
            self._places[pnu] = {at: _Place(spec, fixed=word) for at, word in enumerate(words)}

    def read(self, address: Address) -> Result:
        places = self._wanted(address)
        if isinstance(places, ErrorValue):
            return places
        return Values(places[0].spec.type.data_format, tuple(map(self._raw, places)))

    def change(self, address: Address, values: Values) -> ErrorValue | None:
        if address.pnu in self._own:
            return ErrorValue(errors.READ_ONLY, address.subindex)
        places = self._wanted(address)
        if isinstance(places, ErrorValue):
            return places
        raws: list[int] = []
        for at, (place, raw) in enumerate(zip(places, values.raws, strict=True), address.subindex):
            checked = self._checked(place.spec, values.format, raw, at)
            if isinstance(checked, ErrorValue):
                return checked
            raws.append(checked)
        for place, checked in zip(places, raws, strict=True):
            self._store.write(place.spec, checked, place.data_set)
            self._changed(place.spec)
        return None

    def _checked(self, spec: ParamSpec, number: int, raw: Raw, subindex: int) -> int | ErrorValue:
        form = format_of(number)
        if number not in (spec.type.data_format, _SUBSTITUTES[spec.type.bits // 8]):
            return ErrorValue(errors.BAD_TYPE)
        checked = spec.from_wire(int.from_bytes(form.repack((raw,)), "big"), spec.type.bits)
        if (error := spec.write_error(checked)) is not None:
            return ErrorValue(error, subindex)
        return ErrorValue(errors.OPERATING_STATE) if self._locked(spec) else checked

    def describe(self, address: Address) -> Result:
        """The whole description (subindex 0), or one element of it."""
        places = self._places.get(address.pnu)
        if places is None:
            return ErrorValue(errors.ILLEGAL_NUMBER)
        if address.elements > 1:
            return ErrorValue(errors.BAD_ADDRESS)
        spec = next(iter(places.values())).spec
        array = _is_array(places)
        real = spec.type is ParamType.F32
        limit = format_of(formats.FLOAT if real else formats.INTEGER32 if spec.type.signed else formats.UNSIGNED32)
        # as near as four octets can hold the limits
        low, high = (
            limit.pack((value if real else min(max(round(value * spec.counts), limit.low), limit.high),))
            for value in (spec.low, spec.high)
        )
        described = Description(
            spec.type.data_format,
            max(places) + 1 if array else 1,
            spec.title,
            spec.read_only,
            array,
            address.pnu in self._texts,
            1 / spec.counts,
            0,
            low,
            high,
        )
        if not address.subindex:
            return Values(formats.OCTET_STRING, (described.build(),))
        return described.element(address.subindex) or ErrorValue(errors.NO_DESCRIPTION)

    def text(self, address: Address) -> Result:
        """Texts of 16 characters, from ``address.subindex`` on."""
        found = self._texts.get(address.pnu)
        if found is None:
            return ErrorValue(errors.NO_TEXT if address.pnu in self._places else errors.ILLEGAL_NUMBER)
        end = address.subindex + max(address.elements, 1)
        if end > len(found):
            return ErrorValue(errors.BAD_SUBINDEX, max(address.subindex, len(found)))
        octets = "".join(f"{one:16.16}" for one in found[address.subindex : end]).encode("latin-1", "replace")
        return Values(formats.VISIBLE_STRING, (octets,))

    def _raw(self, place: _Place) -> Raw:
        if place.fixed is not None:
            return place.fixed
        spec = place.spec
        live = self._live(spec)
        raw = self._store.raw(spec, place.data_set) if live is None else live
        octets = spec.type.bits // 8
        return format_of(spec.type.data_format).unpack((raw & (1 << 8 * octets) - 1).to_bytes(octets, "big"))[0]

    def _wanted(self, address: Address) -> list[_Place] | ErrorValue:
        places = self._places.get(address.pnu)
        if places is None:
            return ErrorValue(errors.ILLEGAL_NUMBER)
        if not _is_array(places):
            if address.elements > 1:
                return ErrorValue(errors.BAD_ADDRESS)
            if address.subindex:
                return ErrorValue(errors.NO_ARRAY)
        wanted: list[_Place] = []
        for at in range(address.subindex, address.subindex + max(address.elements, 1)):
            if at not in places:
                return ErrorValue(errors.BAD_SUBINDEX, at)
            wanted.append(places[at])
        return wanted


def _is_array(places: dict[int, _Place]) -> bool:
    return len(places) > 1 or 0 not in places


def _lists(numbers: Sequence[int]) -> dict[int, tuple[int, ...]]:
    """The lists 980 and following."""
    found: dict[int, tuple[int, ...]] = {}
    for pnu in range(FIRST_LIST, LAST_LIST + 1):
        here, numbers = numbers[: _LIST_LEN - 1], numbers[_LIST_LEN - 1 :]
        following = pnu + 1 if numbers and pnu < LAST_LIST else 0
        found[pnu] = (*here, *(0,) * (_LIST_LEN - 1 - len(here)), following)
        if not following:
            break
    return found


class TimedRecords:
    """Records of a slave application (:class:`~dpstack.dpv1.slave.record_requests.Records`) with record 47 alone, for
    several askers.

    ``clock``: from the bus's time of a request to the drive's, both in ns; default the bus's. The drive carries out one
    request of record 47 at a time. While it does, or its response waits for the asker (as long as that one can fetch
    it, for 2 s at most), a Write of another asker is answered 0xC2, a Read 0xB5 as before any request (readings).
    """

    def __init__(self, server: ParameterServer, clock: Callable[[int], int] = lambda bus: bus) -> None:
        self._server = server
        self._clock = clock
        self._holder: Asker | None = None
        self._held_until = 0

    def ask(self, request: RecordRequest) -> None:
        """Answer at once. A response that is not ready is refused; the master asks again."""
        service, asker, now = request.service, request.asker, self._clock(request.at)
        if service.index == INDEX and self._holder not in (None, asker):
            if isinstance(service, ReadReq):
                request.refuse(Code.STATE_CONFLICT)
                return
            if self._is_kept(now):
                request.refuse(Code.RESOURCE_BUSY)
                return
        if isinstance(service, ReadReq):
            answer = self._server.read_record(service.slot, service.index, service.length, now)
        else:
            answer = self._server.write_record(service.slot, service.index, service.data, now) or b""
        if isinstance(answer, Refused):
            request.refuse(answer.code)
            return
        self._holder = None if isinstance(service, ReadReq) else asker
        self._held_until = now + _HELD_NS
        request.answer(answer)

    def _is_kept(self, now: int) -> bool:
        return self._holder is not None and self._holder.open and now < self._held_until
