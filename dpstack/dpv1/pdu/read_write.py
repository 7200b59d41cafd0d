"""The PDUs of the services for records: Read, Write, Data_Transport, Alarm_Ack, requests and responses, negative
responses (docs/reference/protocol.md#read-and-write).

Lengths are octets of data. Slots 0..254, indexes 0..255, up to 240 octets of data.
"""

from __future__ import annotations

from enum import IntEnum
from types import SimpleNamespace
from typing import ClassVar, Final

from msgspec import Struct

from dpstack.dp.pdu.alarm_blocks import Alarm, Specifier
from dpstack.dp.pdu.layouts import MAX_RECORD, MAX_SLOT, OCTET, REST, Layout, Pdu, adapted, bits, flags
from dpstack.dpv1.pdu.error_codes import Code, Decode, negative_text
from dpstack.errors import PduError
from dpstack.text import octets_text

#: the record of PROFIdrive's parameter channel
PARAMETER_INDEX: Final = 47
_HEAD: Final = 4
_REFUSED: Final = 0x80


class Function(IntEnum):
    """Function numbers; bit 7 makes the negative response."""

    IDLE = 0x48
    DATA_TRANSPORT = 0x51
    RESOURCE_MANAGER = 0x56
    INITIATE = 0x57
    ABORT = 0x58
    ALARM_ACK = 0x5C
    READ = 0x5E
    WRITE = 0x5F

    @property
    def title(self) -> str:
        """The standard's name."""
        return self.name.title()


#: the numbers of functions
FUNCTIONS: Final[frozenset[int]] = frozenset(Function)


#: Read, Write and Data_Transport, requests and positive responses: four octets, and the data if there are any
RECORD: Final = Layout(
    "DP-V1 service",
    SimpleNamespace,
    "function" / OCTET,
    "slot" / OCTET,
    "record" / OCTET,
    "length" / OCTET,
    "data" / REST,
)


class _Service(Struct, frozen=True):
    """A service for the record ``index`` of ``slot``."""

    function: ClassVar[Function]
    #: the unit that its data are limited in, for messages
    UNIT: ClassVar = "record"

    slot: int
    index: int

    @property
    def title(self) -> str:
        """With slot and index: they are what a reader looks for."""
        return f"{self.function.title} of slot {self.slot}, index {self.index}"

    def _octets(self, length: int) -> bytes:
        if not 0 <= self.slot <= MAX_SLOT:
            raise PduError(f"slot {self.slot} does not exist: 0..{MAX_SLOT}")
        if not 0 <= self.index <= 255:
            raise PduError(f"index {self.index} does not exist: 0..255")
        if not 0 <= length <= MAX_RECORD:
            raise PduError(f"{length} octets of data, {MAX_RECORD} are possible in one {self.UNIT}")
        return RECORD.build(self, record=self.index, length=length)


class _WithLength(_Service, frozen=True):
    length: int
    data: ClassVar = b""

    def build(self) -> bytes:
        """The octets. Raises PduError if a value does not fit."""
        return self._octets(self.length)


class _WithData(_Service, frozen=True):
    data: bytes

    def build(self) -> bytes:
        """The octets. Raises PduError if a value does not fit."""
        return self._octets(len(self.data))


class ReadReq(_WithLength, frozen=True):
    """Read up to ``length`` octets of the record ``index`` of ``slot``."""

    function = Function.READ

    length: int = MAX_RECORD

    def response(self, data: bytes) -> ReadRes:
        """The positive response with ``data``, cut to the length that was asked for."""
        return ReadRes(self.slot, self.index, bytes(data[: self.length]))


class WriteReq(_WithData, frozen=True):
    """Write ``data`` into the record ``index`` of ``slot``."""

    function = Function.WRITE

    def response(self, data: bytes) -> WriteRes:
        """The positive response: all its octets were written."""
        return WriteRes(self.slot, self.index, len(self.data))


class ReadRes(_WithData, frozen=True):
    """The data of a record: as many octets as it has, never more than were asked for."""

    function = Function.READ


class WriteRes(_WithLength, frozen=True):
    """``length`` octets were written."""

    function = Function.WRITE


class DataTransport(_WithData, frozen=True):
    """Data_Transport, request and positive response: ``data`` to and from ``slot`` and ``index``."""

    function = Function.DATA_TRANSPORT
    UNIT = "service"

    def response(self, data: bytes) -> DataTransport:
        """The positive response with ``data``."""
        return DataTransport(self.slot, self.index, bytes(data))

    @classmethod
    def parse(cls, octets: bytes) -> DataTransport:
        """Raises PduError naming the octet."""
        raw = RECORD.parse(octets)
        if raw.function != cls.function:
            raise PduError(f"octet 1 is 0x{raw.function:02X}, {cls.function.title} is 0x{cls.function:02X}")
        if raw.length != len(raw.data) or raw.length > MAX_RECORD:
            raise PduError(f"Data_Transport: octet 4 says {octets_text(raw.length)} of data, {len(raw.data)} came")
        return cls(raw.slot, raw.record, raw.data)


class Negative(Pdu, frozen=True):
    """A negative response to ``function``. ``code_1``: class and code; ``code_2``: the device's own."""

    function: int
    code_1: int
    code_2: int = 0
    decode: int = Decode.DPV1

    @property
    def text(self) -> str:
        return negative_text(self.decode, self.code_1, self.code_2)


Negative.LAYOUT = Layout(
    "DP-V1 negative response",
    Negative,
    "function" / adapted(OCTET, lambda octet: octet & ~_REFUSED, lambda function: function | _REFUSED),
    "decode" / OCTET * "error_decode",
    "code_1" / OCTET * "error_code_1",
    "code_2" / OCTET * "error_code_2",
)


class AlarmAck(Pdu, frozen=True):
    """Alarm_Ack, request and positive response: slot, type and specifier of the alarm."""

    slot: int
    type: int
    specifier: int = Specifier.NONE
    sequence: int = 0
    add_ack: bool = False

    @classmethod
    def of(cls, alarm: Alarm) -> AlarmAck:
        """The acknowledgement of ``alarm``."""
        return cls(alarm.slot, alarm.type, alarm.specifier, alarm.sequence, alarm.add_ack)


AlarmAck.LAYOUT = Layout(
    "Alarm_Ack",
    AlarmAck,
    "slot" / OCTET,
    "type" / OCTET * "kind",
    "sequence" / bits(5) * "specifier",
    *flags("add_ack"),
    "specifier" / bits(2),
    function=Function.ALARM_ACK,
)

RecordReq = ReadReq | WriteReq
Service = RecordReq | DataTransport
RecordRes = ReadRes | WriteRes | Negative
Response = RecordRes | DataTransport


class UnacceptableError(PduError):
    """A request that a slave refuses: ``negative`` is its answer. The message names the octet."""

    def __init__(self, message: str, function: int, code: Code) -> None:
        super().__init__(message)
        self.negative = Negative(function, code)


def parse_request(octets: bytes) -> RecordReq:
    """Read a request as a slave does. Raises UnacceptableError with what to answer, PduError for no octets at all."""
    if not octets:
        raise PduError("DP-V1 service: no octets")
    function = octets[0]
    if function not in (Function.READ, Function.WRITE):
        known = function in FUNCTIONS
        what = f"{Function(function).title} is no service here" if known else f"no service 0x{function:02X}"
        raise UnacceptableError(f"octet 1: {what}", function, Code.FEATURE_NOT_SUPPORTED)
    try:
        raw = RECORD.parse(octets)
    except PduError as error:
        raise UnacceptableError(str(error), function, Code.INVALID_PARAMETER) from None
    if raw.slot > MAX_SLOT:
        raise UnacceptableError(f"octet 2: there is no slot {raw.slot}", function, Code.INVALID_SLOT)
    if raw.length > MAX_RECORD:
        reason = f"octet 4: {raw.length} octets of data, {MAX_RECORD} are possible"
        raise UnacceptableError(reason, function, Code.WRITE_LENGTH_ERROR)
    if function == Function.READ:
        if raw.data:
            reason = f"{octets_text(len(raw.data))} too many: octet 4 is the last one of a Read request"
            raise UnacceptableError(reason, function, Code.INVALID_PARAMETER)
        return ReadReq(raw.slot, raw.record, raw.length)
    if raw.length != len(raw.data):
        reason = f"octet 4 says {octets_text(raw.length)} of data, {len(raw.data)} came"
        raise UnacceptableError(reason, function, Code.WRITE_LENGTH_ERROR)
    return WriteReq(raw.slot, raw.record, raw.data)


def parse_response(octets: bytes) -> RecordRes:
    """Read a response as a master does. Raises PduError naming the octet."""
    if not octets:
        raise PduError("DP-V1 response: no octets")
    function = octets[0]
    if function & ~_REFUSED not in FUNCTIONS:
        raise PduError(f"DP-V1 response: octet 1 is 0x{function:02X}, which is no service")
    if function & _REFUSED:
        return Negative.parse(octets)
    name = f"{Function(function).title} response"
    if function not in (Function.READ, Function.WRITE):
        raise PduError(f"DP-V1 response: octet 1: {Function(function).title} answers neither Read nor Write")
    raw = RECORD.parse(octets)
    if function == Function.WRITE:
        if raw.data:
            raise PduError(f"{name} has {len(octets)} octets, octet {_HEAD} is the last one")
        return WriteRes(raw.slot, raw.record, raw.length)
    if raw.length != len(raw.data) or raw.length > MAX_RECORD:
        raise PduError(f"{name}: octet 4 says {octets_text(raw.length)} of data, {len(raw.data)} came")
    return ReadRes(raw.slot, raw.record, raw.data)
