"""PDUs of record 47 (parameter access of PROFIdrive's base mode): requests and responses, both ends; their services.

A :data:`Transport` yields DP-V1 services and is sent an :class:`Answer` for each; it owns no clock and no bus.
``AcyclicAccess`` runs one in the cycle of a drive plugin, :mod:`dpstack.api.slave.record_parameters` in an asyncio
program.

Source: Siemens SINAMICS manual p96 and p97, ABB RETA-02 manual p84 to p88, LS CPDP-S100 manual 6.2.2. By hand, not with
construct: the master's end works between two Data_Exchange, 39 parameters a response; construct judges it in the tests.
"""

from __future__ import annotations

import struct
from collections.abc import Generator, Iterator, Sequence
from enum import IntEnum
from typing import Final, NamedTuple, TypeVar

from msgspec import Struct, structs

from dpstack.dpv1.pdu.error_codes import Code, code_text
from dpstack.dpv1.pdu.read_write import PARAMETER_INDEX, ReadReq, WriteReq
from dpstack.errors import PduError
from dpstack.profile.record47.formats import ERROR, ZERO, Raw, format_of
from dpstack.text import octets_text
from dpstack.units import NS_PER_MS

T = TypeVar("T")
#: the record's index, and its longest content
INDEX: Final = PARAMETER_INDEX
MAX_OCTETS: Final = 240
#: parameters of one request that fit into 240 octets: 4 + 6 n
MAX_PARAMETERS: Final = 39
#: elements of an array, and values, in one request
MAX_ELEMENTS: Final = 234
HEADER_LEN: Final = 4
ADDRESS_LEN: Final = 6
VALUE_HEADER_LEN: Final = 2
_LATENCY_UNIT: Final = 10 * NS_PER_MS
#: the shortest block of a drive: a request and an answer for one parameter of one double word
_LEAST_OCTETS: Final = HEADER_LEN + ADDRESS_LEN + VALUE_HEADER_LEN + 4
_ADDRESS: Final = struct.Struct(">BBHH")
_NEGATIVE: Final = 0x80
#: the id of a response to a request id that the drive does not have, without the bit of a negative one
UNSUPPORTED: Final = 0


class Limits(Struct, frozen=True):
    """Limits of one request and its response (PNU 974, Yaskawa Sigma-7 manual p529).

    ``octets``: of either; ``elements`` of an array. ``latency_ns``: the longest time from request to
    response, 0: unknown.
    """

    octets: int = MAX_OCTETS
    parameters: int = MAX_PARAMETERS
    elements: int = MAX_ELEMENTS
    latency_ns: int = 0

    def of_974(self, words: Sequence[int]) -> Limits:
        """These limits narrowed by PNU 974: octets, parameters, latency in 10 ms; impossible values are ignored."""
        octets, parameters, latency = (*words, 0, 0, 0)[:3]
        return Limits(
            min(self.octets, octets) if octets >= _LEAST_OCTETS else self.octets,
            min(self.parameters, parameters) if parameters else self.parameters,
            self.elements,
            latency * _LATENCY_UNIT or self.latency_ns,
        )


class RequestId(IntEnum):
    READ = 1
    CHANGE = 2


class Attribute(IntEnum):
    """The attributes of a parameter: value, description, text."""

    VALUE = 0x10
    DESCRIPTION = 0x20
    TEXT = 0x30


class Address(NamedTuple):
    """Address of a parameter. ``elements``: 0 for one that is no array, else their number from ``subindex`` on."""

    pnu: int
    subindex: int = 0
    elements: int = 0
    attribute: int = Attribute.VALUE

    def build(self) -> bytes:
        """Attribute, elements, number, subindex. Raises ValueError if one does not fit."""
        try:
            return _ADDRESS.pack(self.attribute, self.elements, self.pnu, self.subindex)
        except struct.error:
            raise ValueError(f"{self}: numbers and subindexes are 0..65535, elements 0..{MAX_ELEMENTS}") from None

    def __str__(self) -> str:
        if not self.elements:
            return f"parameter {self.pnu}" + (f"[{self.subindex}]" if self.subindex else "")
        last = self.subindex + self.elements - 1
        return f"parameter {self.pnu}[{self.subindex}{f'..{last}' if last > self.subindex else ''}]"


class Values(NamedTuple):
    """The values of one parameter on the wire; a string is one value of many octets."""

    format: int
    raws: tuple[Raw, ...] = ()

    @property
    def octets(self) -> int:
        """Octets with format, count and padding."""
        return VALUE_HEADER_LEN + _even(len(format_of(self.format).pack(self.raws)))

    def build(self) -> bytes:
        """Format, count, values. Raises ValueError if one does not fit."""
        form = format_of(self.format)
        octets = form.pack(self.raws)
        count = len(octets) // form.octets if form.octets else 0
        if count > MAX_ELEMENTS:
            raise ValueError(f"{count} values of format {form.name}, {MAX_ELEMENTS} are possible")
        return bytes((self.format, count)) + octets + bytes(len(octets) & 1)


class ErrorValue(NamedTuple):
    """The error of one parameter. ``info``: additional information if the drive gives any."""

    number: int
    info: int | None = None

    def build(self) -> bytes:
        """In format 0x44."""
        words = (self.number,) if self.info is None else (self.number, self.info)
        return Values(ERROR, words).build()


#: the part of a response for one parameter
Result = Values | ErrorValue


class Request(Struct, frozen=True):
    """``reference`` 1..255, mirrored by the response; ``object``: axis or drive object; ``values`` of a change."""

    reference: int
    id: int
    object: int
    addresses: tuple[Address, ...]
    values: tuple[Values, ...] = ()

    def build(self) -> bytes:
        """The octets. Raises ValueError if something does not fit."""
        if self.id == RequestId.CHANGE and len(self.values) != len(self.addresses):
            raise ValueError(f"{len(self.values)} groups of values for {len(self.addresses)} parameters")
        head = bytes((self.reference, self.id, self.object, len(self.addresses)))
        addresses = (one.build() for one in self.addresses)
        values = (one.build() for one in self.values)
        return b"".join((head, *addresses, *values))

    @classmethod
    def parse(cls, octets: bytes) -> Request:
        """Read ``octets``. Raises PduError naming what is wrong."""
        request = cls.parse_addresses(octets)
        count = len(request.addresses)
        end = HEADER_LEN + ADDRESS_LEN * count
        if request.id == RequestId.CHANGE:
            found = tuple(_groups(octets, end, count))
            if len(found) != count:
                raise PduError(f"record 47: values of {count} parameters announced, there are {len(found)}")
            # an error is no value: without one the server finds the number of values wrong
            values = tuple(Values(number, () if number == ERROR else raws) for number, raws in found)
            return structs.replace(request, values=values)
        if len(octets) > end:
            raise PduError(f"record 47: {octets_text(len(octets) - end)} too many after {count} addresses")
        return request

    @classmethod
    def parse_addresses(cls, octets: bytes) -> Request:
        """The same, without the values of a change."""
        reference, ident, drive_object, count = _header(octets, "request")
        if ident not in (RequestId.READ, RequestId.CHANGE):
            raise PduError(f"record 47: request id {ident:#04x} is neither 1 (read) nor 2 (change)")
        end = HEADER_LEN + ADDRESS_LEN * count
        if len(octets) < end:
            raise PduError(f"record 47: {count} parameters need {end} octets, there are {len(octets)}")
        addresses = tuple(
            Address(pnu, subindex, elements, attribute)
            for attribute, elements, pnu, subindex in _ADDRESS.iter_unpack(octets[HEADER_LEN:end])
        )
        return cls(reference, ident, drive_object, addresses)


class Response(Struct, frozen=True):
    """``id``: that of the request; ``negative``: at least one parameter failed. ``count`` as announced.

    ``results``: one for each parameter; none in a positive response to a change.
    """

    reference: int
    id: int
    object: int
    count: int
    results: tuple[Result, ...] = ()
    negative: bool = False

    def build(self) -> bytes:
        head = bytes((self.reference, self.id | (_NEGATIVE if self.negative else 0), self.object, self.count))
        return b"".join((head, *(one.build() for one in self.results)))

    @classmethod
    def parse(cls, octets: bytes) -> Response:
        """Read ``octets``, zeros behind the last value left out. Raises PduError naming what is wrong.

        The caller checks whether it fits a request.
        """
        reference, ident, drive_object, count = _header(octets, "response")
        return cls(
            reference,
            ident & ~_NEGATIVE,
            drive_object,
            count,
            tuple(_result(number, raws) for number, raws in _groups(octets, HEADER_LEN, count)),
            bool(ident & _NEGATIVE),
        )


def _header(octets: bytes, what: str) -> bytes:
    if len(octets) < HEADER_LEN:
        raise PduError(f"record 47: a {what} has at least {HEADER_LEN} octets, there are {len(octets)}")
    return octets[:HEADER_LEN]


def _groups(octets: bytes, at: int, most: int) -> Iterator[tuple[int, tuple[Raw, ...]]]:
    """Format and values of each group (format, count, values): as many as there are octets for, at most ``most``."""
    while at < len(octets) and most:
        if len(octets) - at < VALUE_HEADER_LEN:
            raise PduError(f"record 47: octet {at + 1} (format) is the last one, the number of values is missing")
        number, count = octets[at], octets[at + 1]
        at += VALUE_HEADER_LEN
        form = format_of(number)
        size = form.octets * count
        if len(octets) - at < size:
            raise PduError(
                f"record 47: {count} values of format {form.name} are {size} octets, from octet {at + 1} on there are "
                f"{len(octets) - at}"
            )
        yield number, form.unpack(octets[at : at + size]) if count and number != ZERO else ()
        at += _even(size)
        most -= 1
    if any(octets[at:]):
        raise PduError(f"record 47: {octets_text(len(octets) - at)} too many from octet {at + 1} on")


def _result(number: int, raws: tuple[Raw, ...]) -> Result:
    if number != ERROR:
        return Values(number, raws)
    if not raws:
        raise PduError("record 47: an error without its number")
    words = [one for one in raws if isinstance(one, int)]
    return ErrorValue(words[0], words[1] if len(words) > 1 else None)


def _even(octets: int) -> int:
    """With the padding octet that keeps the words aligned."""
    return octets + (octets & 1)


#: error codes of a missing record; 0: the slave does not support the service at all
ABSENT: Final = frozenset({0, Code.INVALID_INDEX, Code.INVALID_SLOT})


class Pause(Struct, frozen=True):
    """Send nothing for so many ns."""

    ns: int


Service = WriteReq | ReadReq | Pause


class Refused(NamedTuple):
    """A negative answer: Error_Code_1 of DP-V1, or 0 and why the slave does not support the service at all."""

    code: int
    why: str = ""

    def __str__(self) -> str:
        return self.why or f"error {self.code >> 4:X}/{self.code & 15:X}, {code_text(self.code)}"


class Silent(NamedTuple):
    """No answer: the slave may have carried out the service or not."""

    why: str


class Answer(NamedTuple):
    """The answer to a service and its time (ns): the octets read, b"" after a write or a pause, or the failure."""

    now: int
    data: bytes | Refused | Silent = b""


#: Yields services until it returns its result or raises CommandError.
Transport = Generator[Service, Answer, T]
