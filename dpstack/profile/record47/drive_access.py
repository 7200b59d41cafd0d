"""Parameter access of a drive plugin over record 47: parameters by name, scaled values, checks before sending.

The cyclic channel of the telegram is used if the drive has no record 47.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeVar

from dpstack.dpv1.master.plugin_queue import Outcome, ReadReq, RecordQueue, ServiceFailure, WriteReq
from dpstack.dpv1.pdu.error_codes import Decode
from dpstack.profile.channel.base import (
    Clock,
    Found,
    ParameterChannel,
    ParamKey,
    check_write,
    find_parameter,
    outcome,
    refused,
)
from dpstack.profile.channel.stored_writes import StoredWrites
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.param_errors import error_text
from dpstack.profile.model.param_types import ParamType
from dpstack.profile.model.params import ParamSpec, ParamTable
from dpstack.profile.record47.client import NoRecordError, ParameterClient
from dpstack.profile.record47.formats import (
    BIT_STRING,
    DOUBLE_WORD,
    FLOAT,
    FORMATS,
    OCTET_STRING,
    Raw,
    Value,
)
from dpstack.profile.record47.pdu import Address, Answer, ErrorValue, Pause, Refused, Result, Silent, Transport, Values

T = TypeVar("T")
#: octet strings that hold a number: PNU 965 is an OctetString of 2, an Unsigned16 (TR LMP-30 manual p141)
_NUMBERS: Final = frozenset({OCTET_STRING, BIT_STRING})
_LONGEST_NUMBER: Final = 4
_NO_ANSWER: Final = "the drive did not answer over record 47 in time"
#: the bus or the slave went away
_LOST: Final = frozenset({ServiceFailure.LINE, ServiceFailure.CLOSED, ServiceFailure.CANCELLED})


class Place(NamedTuple):
    """A parameter in record 47, with its specification if it is known. ``format`` None: the drive answers it.

    ``number`` and ``data_set`` for messages; ``data_set`` None if the drive has none or the parameter exists once.
    """

    address: Address
    spec: ParamSpec | None
    label: str
    number: int
    data_set: int | None = None
    format: int | None = None


class _Run(NamedTuple):
    address: Address
    places: tuple[Place, ...]


def _runs(places: Sequence[Place]) -> list[_Run]:
    runs: list[_Run] = []
    for place in places:
        address, last = place.address, runs[-1].address if runs else None
        if (
            last is not None
            and last.elements
            and address == last._replace(subindex=last.subindex + last.elements, elements=1)
        ):
            runs[-1] = _Run(last._replace(elements=last.elements + 1), (*runs[-1].places, place))
        else:
            runs.append(_Run(address, (place,)))
    return runs


#: Finds the parameter that a user has named. Raises CommandError.
Placed = Callable[[ParamKey], Place]


def plain_places(table: ParamTable, drive: str) -> Placed:
    """Parameters of ``table`` by name or number, elements of arrays by index; other numbers go without a scale."""

    def placed(key: ParamKey) -> Place:
        spec, number, label = find_parameter(key, table, 0xFFFF)
        if key.data_set is not None or key.ram:
            what = "writes to RAM only" if key.ram else "data sets"
            raise CommandError("usage", f"{label}: {drive} has no {what}")
        subindex = spec.index if spec is not None and key.index is None else key.index or 0
        if subindex > 0xFFFF:
            raise CommandError("usage", f"{label}: indexes are 0..65535")
        elements = 0 if key.index is None and not subindex else 1
        return Place(Address(number, subindex, elements), spec, label, number)

    return placed


class AcyclicAccess(ParameterChannel):
    """Parameters over record 47; jobs queue.

    ``records``: queue of its services. ``cyclic``: the parameter channel of the telegram, None if it has none. Once
    the drive has refused record 47 as such, ``cyclic`` is used until the drive comes back.
    """

    def __init__(self, client: ParameterClient, records: RecordQueue, placed: Placed, clock: Clock) -> None:
        self.client = client
        self.cyclic: ParameterChannel | None = None
        self._absent = False  # the drive has no record 47
        self._records = records
        self._placed = placed
        self._clock = clock
        self._turns: deque[object] = deque()
        self._formats: dict[Address, int] = {}
        self._stored_writes = StoredWrites()

    def take_turns(self, turns: deque[object], references: range) -> None:
        """For one of several drives of a slave: its jobs take turns in ``turns`` with those of the others, and its
        requests have ``references`` of their own."""
        self._turns = turns
        self.client.use_references(references)

    @property
    def octets(self) -> bytes:
        return b"" if self.cyclic is None else self.cyclic.octets

    @property
    def per_request(self) -> int:
        """Parameters of one request over record 47; the cyclic channel takes as many orders."""
        return self.client.limits.parameters

    @property
    def needs_outputs(self) -> bool:
        return self._absent

    @property
    def busy(self) -> bool:
        return self.cyclic is not None and self.cyclic.busy

    def step(self, inputs: bytes, now: int) -> None:
        """Step the cyclic channel."""
        if self.cyclic is not None:
            self.cyclic.step(inputs, now)

    def reset(self) -> None:
        self._absent = False
        self._records.clear()
        self._formats.clear()  # it may be another drive now
        if self.cyclic is not None:
            self.cyclic.reset()

    def read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]:
        return self._choose(self._read(key, deadline), lambda cyclic: cyclic.read(key, deadline))

    def read_many(self, keys: Sequence[ParamKey], deadline: int) -> Steps[Found]:
        return self._choose(self._read_many(keys, deadline), lambda cyclic: cyclic.read_many(keys, deadline))

    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        return self._choose(self._write(key, value, deadline), lambda cyclic: cyclic.write(key, value, deadline))

    def _choose(self, acyclic: Steps[T], over_cyclic: Callable[[ParameterChannel], Steps[T]]) -> Steps[T]:
        """Over record 47, or by the cyclic channel if the drive has no record 47."""
        cyclic = self.cyclic
        if cyclic is None or not self._absent:
            try:
                return (yield from acyclic)
            except NoRecordError as error:
                self._absent = True
                if cyclic is None:
                    text = f"{error.text}; a telegram with a parameter channel needs none"
                    raise CommandError(error.kind, text, error.number) from None
        return (yield from over_cyclic(cyclic))

    def _read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]:
        place = self._placed(key)
        return self._outcome(place, (yield from self._values(place, deadline)))

    def _read_many(self, keys: Sequence[ParamKey], deadline: int) -> Steps[Found]:
        """Read in as few requests as possible; adjacent elements of an array are one address."""
        places = [self._placed(key) for key in keys]
        runs = _runs(places)
        transport = self.client.read([run.address for run in runs], deadline)
        results = yield from self.run(transport, deadline, places[0].label if len(places) == 1 else "read_many")
        found: Found = []
        for run, result in zip(runs, results, strict=True):
            if isinstance(result, Values) and len(result.raws) == len(run.places):
                for place, raw in zip(run.places, result.raws, strict=True):
                    self._formats[place.address] = result.format
                    found.append(self._outcome(place, Values(result.format, (raw,))))
                continue
            for place in run.places:  # one of them is the reason: ask for each by itself
                try:
                    values = yield from self._values(place, deadline, result if len(run.places) == 1 else None)
                    found.append(self._outcome(place, values))
                except CommandError as error:
                    found.append(refused(error))
        return found

    def _write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter, in the format that the drive answers for it."""
        place = self._placed(key)
        spec = place.spec
        check_write(spec, place.label, value)
        number = self._formats.get(place.address, place.format)
        if number is None:
            number = (yield from self._values(place, deadline)).format
        try:
            values = Values(number, (_raw(spec, number, value),))
            self._stored_writes.admit(place.address, place.label, self._clock.now, spec)
            transport = self.client.change([(place.address, values)], deadline)
            (result,) = yield from self.run(transport, deadline, place.label)
        except ValueError as error:
            raise CommandError("usage", f"{place.label}: {error}") from None
        _check_refused(place, result)
        return self._outcome(place, values)

    def run(self, transport: Transport[T], deadline: int, label: str) -> Steps[T]:
        """Run ``transport`` with the drive after those before it. Raises CommandError."""
        turn = object()
        self._turns.append(turn)
        try:
            while self._turns[0] is not turn:
                self._in_time(deadline, f"{label}: {_NO_ANSWER}")
                yield
            silence = _NO_ANSWER
            service = next(transport)
            while True:
                if isinstance(service, Pause):
                    until = self._clock.now + service.ns
                    while self._clock.now < until:
                        yield
                    data: bytes | Refused | Silent = b""
                else:
                    data = yield from self._carried_out(service, deadline, f"{label}: {silence}")
                    silence = data.why if isinstance(data, Silent) else _NO_ANSWER
                service = transport.send(Answer(self._clock.now, data))
        except StopIteration as end:
            result: T = end.value
            return result
        except CommandError as error:
            text = error.text if error.text.startswith(label) else f"{label}: {error.text}"
            raise type(error)(error.kind, text, error.number) from None
        finally:
            transport.close()
            self._turns.remove(turn)

    def _carried_out(self, service: WriteReq | ReadReq, deadline: int, late: str) -> Steps[bytes | Refused | Silent]:
        pending = self._records.submit(service)
        try:
            while pending.outcome is None:
                self._in_time(deadline, late)
                yield
        finally:
            self._records.cancel(pending)
        return answer_of(pending.outcome)

    def _in_time(self, deadline: int, late: str) -> None:
        if self._clock.now >= deadline:
            raise CommandError("timeout", late)

    def _values(self, place: Place, deadline: int, result: Result | None = None) -> Steps[Values]:
        if result is None:
            transport = self.client.read([place.address], deadline)
            (result,) = yield from self.run(transport, deadline, place.label)
        _check_refused(place, result)
        if not isinstance(result, Values) or not result.raws:
            raise CommandError("parameter", f"{place.label}: the drive answered without a value")
        self._formats[place.address] = result.format
        return result

    def _outcome(self, place: Place, values: Values) -> dict[str, object]:
        spec = place.spec
        form = FORMATS[values.format]
        first = values.raws[0]
        octets = form.octets
        if isinstance(first, bytes) and form.number in _NUMBERS and 0 < len(first) <= _LONGEST_NUMBER:
            octets = len(first)
            first = int.from_bytes(first, "big")
        value: Value = first if form.number in _NUMBERS else form.value(first)
        if isinstance(value, (str, bytes)):
            raise CommandError("parameter", f"{place.label} is no number but {form.name}: {value!r}")
        if isinstance(value, float) and not math.isfinite(value):
            raise CommandError("parameter", f"{place.label} is no number: the drive answers {value} ({form.name})")
        raw = first if isinstance(first, int) else int.from_bytes(form.pack((first,)), "big")
        if spec is not None:
            raw = spec.from_wire(raw, 8 * octets) if isinstance(first, int) else raw
            real = isinstance(first, float)
            misfit = spec.misfit(raw, real or (form.number == DOUBLE_WORD and spec.type is ParamType.F32))
            if misfit is not None and spec.type is ParamType.F32:
                raise CommandError("parameter", f"{place.label}: {misfit} ({form.name})")
            self.remark(place.label, misfit and f"{misfit} ({form.name})")
            if not real or (form.number == FLOAT and spec.type is ParamType.F32):
                value = spec.to_value(raw)
        return outcome(spec, place.number, value, raw, place.data_set)


def _check_refused(place: Place, result: Result) -> None:
    if isinstance(result, ErrorValue):
        raise CommandError("parameter", f"{place.label}: {error_text(*result, {})}", result.number)


def answer_of(outcome: Outcome) -> bytes | Refused | Silent:
    """The answer to a service, for a transport. Raises CommandError if the bus or the slave is lost."""
    if outcome.failure is None:
        return outcome.data
    if outcome.codes is not None and outcome.codes[0] == Decode.DPV1:
        return Refused(outcome.codes[1])
    if outcome.failure in (ServiceFailure.REFUSED, ServiceFailure.NEGATIVE):
        return Refused(0, outcome.text)
    if outcome.failure in _LOST:
        raise CommandError("lost", outcome.text)
    return Silent(outcome.text)


def _raw(spec: ParamSpec | None, number: int, value: float) -> Raw:
    """``value`` in format ``number``. Raises ValueError."""
    form = FORMATS[number]
    if form.code in ("f", "d"):
        raw = form.raw(value)
        return float(raw) if isinstance(raw, int) else raw
    if spec is None:
        raw = form.raw(value)
        if isinstance(raw, float) and raw != int(raw):
            raise ValueError(f"its scale is unknown here, give the integer of format {form.name} on the wire")
        return raw
    integer = spec.to_raw(value)
    if spec.type is ParamType.F32 and number != DOUBLE_WORD:
        raise ValueError(f"{spec.misfit(integer)} ({form.name})")
    if not spec.type.signed or form.low < 0:
        return integer
    half = form.high + 1 >> 1  # two's complement in a format without a sign
    if not -half <= integer < half:
        raise ValueError(f"{value:g} {spec.unit}".rstrip() + f" is more than the drive's format {form.name} can hold")
    return integer & form.high
