"""The PDUs of Read and Write: requests, responses, negative responses (docs/protocol.md#read-and-write).

Lengths are octets of data. Slots 0..254, indexes 0..255, up to 240 octets of data.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from dpstack.dp.pdu.alarm_blocks import Alarm, Specifier
from dpstack.dp.pdu.layouts import MAX_RECORD, MAX_SLOT
from dpstack.dpv1.pdu.error_codes import Code, Decode, negative_text
from dpstack.dpv1.pdu.layouts import ALARM_ACK, NEGATIVE, RECORD, AlarmAckOctets, NegativeOctets, RecordOctets
from dpstack.errors import PduError

#: the record of PROFIdrive's parameter channel
PARAMETER_INDEX: Final = 47
_HEAD: Final = 4
_NEGATIVE: Final = 0x80


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


@dataclass(frozen=True, slots=True)
class ReadReq:
    """Read up to ``length`` octets of the record ``index`` of ``slot``."""

    slot: int
    index: int
    length: int = MAX_RECORD

    def build(self) -> bytes:
        """The octets. Raises PduError where a value does not fit."""
        _check(self.slot, self.index, self.length)
        return RECORD.build(RecordOctets(Function.READ, self.slot, self.index, self.length, b""))


@dataclass(frozen=True, slots=True)
class WriteReq:
    """Write ``data`` into the record ``index`` of ``slot``."""

    slot: int
    index: int
    data: bytes

    def build(self) -> bytes:
        """The octets. Raises PduError where a value does not fit."""
        _check(self.slot, self.index, len(self.data))
        return RECORD.build(RecordOctets(Function.WRITE, self.slot, self.index, len(self.data), self.data))


@dataclass(frozen=True, slots=True)
class ReadRes:
    """The data of a record: as many octets as it has, never more than were asked for."""

    slot: int
    index: int
    data: bytes

    def build(self) -> bytes:
        """The octets. Raises PduError where a value does not fit."""
        _check(self.slot, self.index, len(self.data))
        return RECORD.build(RecordOctets(Function.READ, self.slot, self.index, len(self.data), self.data))


@dataclass(frozen=True, slots=True)
class WriteRes:
    """``length`` octets were taken."""

    slot: int
    index: int
    length: int

    def build(self) -> bytes:
        """The octets. Raises PduError where a value does not fit."""
        _check(self.slot, self.index, self.length)
        return RECORD.build(RecordOctets(Function.WRITE, self.slot, self.index, self.length, b""))


@dataclass(frozen=True, slots=True)
class Negative:
    """A negative response to ``function``. ``code_1``: class and code; ``code_2``: the device's own."""

    function: int
    code_1: int
    code_2: int = 0
    decode: int = Decode.DPV1

    @property
    def text(self) -> str:
        return negative_text(self.decode, self.code_1, self.code_2)

    def build(self) -> bytes:
        """The octets. Raises PduError where a value does not fit."""
        return NEGATIVE.build(NegativeOctets(self.function | _NEGATIVE, self.decode, self.code_1, self.code_2, b""))


@dataclass(frozen=True, slots=True)
class AlarmAck:
    """Alarm_Ack, request and positive response: slot, type and specifier of the alarm."""

    slot: int
    type: int
    specifier: int = Specifier.NONE
    sequence: int = 0
    add_ack: bool = False

    def build(self) -> bytes:
        """The octets. Raises PduError where a value does not fit."""
        specifier = self.sequence << 3 | self.add_ack << 2 | self.specifier
        return ALARM_ACK.build(AlarmAckOctets(Function.ALARM_ACK, self.slot, self.type, specifier, b""))

    @classmethod
    def of(cls, alarm: Alarm) -> AlarmAck:
        """What acknowledges ``alarm``."""
        return cls(alarm.slot, alarm.type, alarm.specifier, alarm.sequence, alarm.add_ack)

    @classmethod
    def parse(cls, octets: bytes) -> AlarmAck:
        """Raises PduError naming the octet."""
        raw = ALARM_ACK.parse(octets)
        if raw.function != Function.ALARM_ACK:
            raise PduError(f"octet 1 is 0x{raw.function:02X}, Alarm_Ack is 0x{Function.ALARM_ACK:02X}")
        if raw.rest:
            raise PduError(f"Alarm_Ack has {len(octets)} octets, octet {_HEAD} is the last one")
        return cls(raw.slot, raw.kind, raw.specifier & 3, raw.specifier >> 3, bool(raw.specifier & 4))


RecordReq = ReadReq | WriteReq
RecordRes = ReadRes | WriteRes | Negative


class UnacceptableError(PduError):
    """A request that a slave refuses: ``negative`` is its answer. The text names the octet."""

    def __init__(self, message: str, negative: Negative) -> None:
        super().__init__(message)
        self.negative = negative


def parse_request(octets: bytes) -> RecordReq:
    """Read a request as a slave does. Raises UnacceptableError with what to answer, PduError for no octets at all."""
    if not octets:
        raise PduError("DP-V1 service: no octets")
    function = octets[0]
    if function not in (Function.READ, Function.WRITE):
        known = function in Function.__members__.values()
        what = f"{Function(function).title} is no service here" if known else f"no service 0x{function:02X}"
        raise UnacceptableError(f"octet 1: {what}", Negative(function, Code.NOT_SUPPORTED))
    try:
        raw = RECORD.parse(octets)
    except PduError as error:
        raise UnacceptableError(str(error), Negative(function, Code.INVALID_PARAMETER)) from None
    if raw.slot > MAX_SLOT:
        raise UnacceptableError(f"octet 2: there is no slot {raw.slot}", Negative(function, Code.INVALID_SLOT))
    if raw.length > MAX_RECORD:
        reason = f"octet 4: {raw.length} octets of data, {MAX_RECORD} are possible"
        raise UnacceptableError(reason, Negative(function, Code.WRITE_LENGTH))
    if function == Function.READ:
        if raw.data:
            reason = f"{len(raw.data)} octets too many: octet 4 is the last one of a Read request"
            raise UnacceptableError(reason, Negative(function, Code.INVALID_PARAMETER))
        return ReadReq(raw.slot, raw.record, raw.length)
    if raw.length != len(raw.data):
        reason = f"octet 4 says {raw.length} octets of data, {len(raw.data)} came"
        raise UnacceptableError(reason, Negative(function, Code.WRITE_LENGTH))
    return WriteReq(raw.slot, raw.record, raw.data)


def parse_response(octets: bytes) -> RecordRes:
    """Read a response as a master does. Raises PduError naming the octet."""
    if not octets:
        raise PduError("DP-V1 response: no octets")
    function = octets[0]
    if function & ~_NEGATIVE not in Function.__members__.values():
        raise PduError(f"DP-V1 response: octet 1 is 0x{function:02X}, which is no service")
    if function & _NEGATIVE:
        nrs = NEGATIVE.parse(octets)
        if nrs.rest:
            raise PduError(f"DP-V1 negative response has {len(octets)} octets, octet {_HEAD} is the last one")
        return Negative(function & ~_NEGATIVE, nrs.error_code_1, nrs.error_code_2, nrs.error_decode)
    name = f"{Function(function).title} response"
    if function not in (Function.READ, Function.WRITE):
        raise PduError(f"DP-V1 response: octet 1: {Function(function).title} answers neither Read nor Write")
    raw = RECORD.parse(octets)
    if function == Function.WRITE:
        if raw.data:
            raise PduError(f"{name} has {len(octets)} octets, octet {_HEAD} is the last one")
        return WriteRes(raw.slot, raw.record, raw.length)
    if raw.length != len(raw.data) or raw.length > MAX_RECORD:
        raise PduError(f"{name}: octet 4 says {raw.length} octets of data, {len(raw.data)} came")
    return ReadRes(raw.slot, raw.record, raw.data)


def _check(slot: int, index: int, length: int) -> None:
    if not 0 <= slot <= MAX_SLOT:
        raise PduError(f"slot {slot} does not exist: 0..{MAX_SLOT}")
    if not 0 <= index <= 255:
        raise PduError(f"index {index} does not exist: 0..255")
    if not 0 <= length <= MAX_RECORD:
        raise PduError(f"{length} octets of data, {MAX_RECORD} are possible in one record")
