"""HART over PROFIBUS: request and response records, directory, features, errors of a module in words.

The layouts of SIMATIC ET 200iSP and ET 200SP HA (PROFIBUS profile HART 3.102 and 2.312); sources and readings:
docs/reference/decisions/hart.md. Request record of a channel at an index, its response at that index + an offset.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Final

from msgspec import Struct

from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.errors import PduError
from dpstack.hart.telegram import Answer, Telegram
from dpstack.text import octets_text

DIRECTORY: Final = 148
FEATURES: Final = 149
#: request record of channel 0; each further channel has the next but one
FIRST_REQUEST: Final = 80
#: preambles: the number that is set in the module
AS_SET: Final = 255
#: "not relevant" in a directory
_NONE: Final = 255
_HEAD: Final = 9
_COMPACT: Final = 0x20
_SHC: Final = 0x40
_RESULT: Final = 0x07
_CHECK_RESULT: Final = 0x02


class Directory(Struct, frozen=True):
    """Record 148. ``requests``: index of the request record of each channel; ``offset`` from it to the response."""

    revision: tuple[int, int]
    clients: int
    offset: int
    requests: tuple[int, ...]
    features: int | None = FEATURES
    #: index of the parameters of the module, and of each channel
    parameters: int | None = None
    channel_parameters: tuple[int, ...] = ()

    @property
    def channels(self) -> int:
        return len(self.requests)

    @classmethod
    def parse(cls, data: bytes) -> Directory:
        """Raises PduError if it is too short for its channels, or points to impossible records.

        After the head come the parameter records of the channels and their request records. An older directory (13
        octets) has the request records only.
        """
        if len(data) < _HEAD:
            raise PduError(f"a HART directory of {octets_text(len(data))}: its head has {_HEAD}")
        channels, offset = data[4], data[5]
        rest = data[_HEAD:]
        if not channels or len(rest) < channels:
            raise PduError(f"a HART directory of {octets_text(len(data))} for {channels} channels")
        with_parameters = len(rest) >= 2 * channels
        requests = rest[channels : 2 * channels] if with_parameters else rest[:channels]
        outside = next((index for index in requests if index + offset >= _NONE), None)
        if outside is not None or not offset:
            where = f"request record {requests[0] if outside is None else outside}, response + {offset}"
            raise PduError(f"a HART directory points outside: {where}")
        return cls(
            (data[0], data[1]),
            data[3],
            offset,
            tuple(requests),
            _index(data[6]),
            _index(data[7]),
            tuple(rest[:channels]) if with_parameters else (),
        )

    def build(self) -> bytes:
        """The octets of the newer layout."""
        indexes = (_NONE if one is None else one for one in (self.features, self.parameters))
        head = (*self.revision, _NONE, self.clients, self.channels, self.offset, *indexes, _NONE)
        return bytes((*head, *self.channel_parameters, *self.requests))


def usual_directory(channels: int) -> Directory:
    """That of modules that have fixed records: 80 + 2 n, parameters at 131 + n."""
    numbers = range(channels)
    requests = tuple(FIRST_REQUEST + 2 * number for number in numbers)
    return Directory((2, 0), 1, 1, requests, channel_parameters=tuple(131 + number for number in numbers))


class Features(Struct, frozen=True):
    """Record 149. ``longest``: octets of a request or response record."""

    compact: bool = False
    shc: bool = False
    check_result: bool = False
    longest: int = MAX_RECORD

    @classmethod
    def parse(cls, data: bytes) -> Features:
        """Raises PduError."""
        if len(data) < 3:
            raise PduError(f"HART features of {octets_text(len(data))}: they have 3")
        flags = data[0]
        longest = min(data[2], MAX_RECORD) or MAX_RECORD
        return cls(bool(flags & _COMPACT), bool(flags & _SHC), bool(flags & _CHECK_RESULT), longest)

    def build(self) -> bytes:
        flags = _COMPACT * self.compact | _SHC * self.shc | _CHECK_RESULT * self.check_result
        return bytes((flags, 0, self.longest))


class Request(Struct, frozen=True):
    """A request record: ``telegram`` in transparent format, or its command and data alone in compact format."""

    telegram: Telegram
    compact: bool = False
    preambles: int = AS_SET

    def build(self) -> bytes:
        """Raises PduError."""
        telegram = self.telegram
        octets = telegram.build()
        if self.compact:
            octets = bytes((telegram.command, len(telegram.data))) + telegram.data
        return bytes((_COMPACT if self.compact else 0, self.preambles)) + octets

    @classmethod
    def parse(cls, data: bytes) -> tuple[int, bytes, Request | None]:
        """The module's end: command, data, and the request with its telegram (None in compact format). Raises
        PduError."""
        if len(data) < 4:
            raise PduError(f"a HART request record of {octets_text(len(data))}")
        control, preambles, rest = data[0], data[1], data[2:]
        if preambles != AS_SET and not 5 <= preambles <= 20:
            raise PduError(f"{preambles} preambles: 5 to 20, or {AS_SET}")
        if not control & _COMPACT:
            telegram = Telegram.parse(rest)
            return telegram.command, telegram.data, cls(telegram, False, preambles)
        if len(rest) < 2 + rest[1]:
            raise PduError(f"a compact HART request of {octets_text(len(rest))} with {rest[1]} octets of data")
        return rest[0], rest[2 : 2 + rest[1]], None


class Result(IntEnum):
    """Bits 2 to 0 of the response control: how far the request is."""

    INACTIVE = 0
    INACTIVE_1 = 1
    WAITING = 2
    EXECUTING = 3
    SUCCESS = 4
    SUCCESS_WITHOUT_DATA = 5
    ERROR = 6
    ERROR_WITHOUT_DATA = 7

    @property
    def is_over(self) -> bool:
        return self >= Result.SUCCESS

    @property
    def is_error(self) -> bool:
        return self >= Result.ERROR

    @property
    def words(self) -> str:
        return _RESULTS[self]


_RESULTS: Final = {
    Result.INACTIVE: "inactive: it has no request",
    Result.INACTIVE_1: "inactive: it has no request",
    Result.WAITING: "waiting for its turn",
    Result.EXECUTING: "being carried out",
    Result.SUCCESS: "successful",
    Result.SUCCESS_WITHOUT_DATA: "successful, without data",
    Result.ERROR: "failed",
    Result.ERROR_WITHOUT_DATA: "failed",
}


class Fault(IntEnum):
    """Bits 7 to 4 of the group display: the kind of an error."""

    UNSPECIFIED = 0
    MASTER = 1
    CHANNEL = 2
    COMMAND = 3
    QUERY = 4
    RESPONSE = 5
    REJECTED = 6
    PROFILE = 7
    MAKER = 8


_FAULTS: Final[Mapping[int, str]] = {
    Fault.UNSPECIFIED: "unspecified error",
    Fault.MASTER: "error of the module's HART master",
    Fault.CHANNEL: "channel fault",
    Fault.COMMAND: "command error",
    Fault.QUERY: "the device has received a damaged request",
    Fault.RESPONSE: "the module has received a damaged answer, or none",
    Fault.REJECTED: "the module rejects the request",
    Fault.PROFILE: "the module rejects a profile request",
    Fault.MAKER: "the module rejects a request of the maker's own",
}
_CODES: Final[Mapping[int, Mapping[int, str]]] = {
    Fault.MASTER: {
        1: "internal communication error",
        2: "parameter assignment error",
        3: "hardware fault",
        4: "wait time expired",
        5: "HART timer expired",
    },
    Fault.CHANNEL: {
        1: "line fault",
        2: "short circuit",
        3: "open line: check wire and supply of the transmitter",
        4: "low current output",
        5: "parameter assignment error",
    },
    Fault.REJECTED: {
        1: "compact format is not supported",
        2: "SHC is not supported",
        3: "command not permitted",
        4: "no resources",
        5: "the channel is in standby: ask the partner module",
    },
}
_RECEPTION: Final[Mapping[int, str]] = {
    0x02: "receive buffer overflow",
    0x08: "checksum error",
    0x10: "framing error",
    0x20: "overflow error",
    0x40: "parity error",
}
_OF_RESPONSES: Final[Mapping[int, str]] = {0x01: "gap timeout", 0x04: "no answer in time"}


class Response(Struct, frozen=True):
    """A response record. ``fault`` and ``code`` if :attr:`result` is an error; ``answer`` of the device, if there is
    one, else None."""

    result: Result
    fault: int = 0
    code: int = 0
    answer: Answer | None = None
    #: HART parameters of the module have changed
    check_parameters: bool = False

    @classmethod
    def parse(cls, data: bytes) -> Response:
        """Raises PduError for a record that is too short, or whose telegram is damaged."""
        if len(data) < 1:
            raise PduError("an empty HART response record")
        result = Result(data[0] & _RESULT)
        if not result.is_over:
            return cls(result)
        if len(data) < (3 if result.is_error else 2):
            raise PduError(f"a HART response record of {octets_text(len(data))} with the result {result.words!r}")
        group, code, rest = data[1], 0, data[2:]
        if result.is_error:
            code, rest = data[2], data[3:]
        answer = None
        if result in (Result.SUCCESS, Result.ERROR):
            try:
                answer = _answer(rest, compact=bool(data[0] & _COMPACT))
            except PduError:
                if not result.is_error:  # its error has already been reported
                    raise
        return cls(result, group >> 4, code, answer, bool(group & 4))

    @property
    def fault_text(self) -> str:
        """The error in words; empty without one."""
        if not self.result.is_error:
            return ""
        text = _FAULTS.get(self.fault, f"error {self.fault}")
        more = self._code_text()
        return f"{text}: {more}" if more else text

    @property
    def is_damage(self) -> bool:
        """Request or answer was damaged on the wires between module and device, or the device did not answer."""
        return self.result.is_error and self.fault in (Fault.QUERY, Fault.RESPONSE)

    def _code_text(self) -> str:
        if self.fault in (Fault.QUERY, Fault.RESPONSE):
            bits = {**_RECEPTION, **(_OF_RESPONSES if self.fault == Fault.RESPONSE else {})}
            return ", ".join(text for bit, text in sorted(bits.items()) if self.code & bit) or f"0x{self.code:02X}"
        if self.fault == Fault.COMMAND:
            return f"response code {self.code}"
        known = _CODES.get(self.fault, {}).get(self.code)
        return known or (f"code {self.code}" if self.code else "")


def _answer(octets: bytes, *, compact: bool) -> Answer:
    """The answer in a response record. Raises PduError."""
    if not compact:
        return Answer.of(Telegram.parse(octets))
    if len(octets) < 2 or len(octets) < 2 + octets[1]:
        raise PduError(f"a compact HART answer of {octets_text(len(octets))}")
    return Answer.of_data(octets[0], octets[2 : 2 + octets[1]])


def build_response(result: Result, group: int = 0, code: int = 0, telegram: bytes = b"") -> bytes:
    """The module's end: a response record; ``code`` counts in an error only."""
    return bytes((result, group)) + (bytes((code,)) if result.is_error else b"") + telegram


def _index(octet: int) -> int | None:
    return None if octet == _NONE else octet
