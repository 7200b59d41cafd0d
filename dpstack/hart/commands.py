"""The data of HART commands 0 to 3, 11 to 16, 20, 48 decoded: identity, variables, tag, range, status.

Sources: docs/reference/decisions/hart.md. Answers may be longer than the fields of the revision that is known here;
shorter ones than a command has at least raise PduError.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from typing import Final

from msgspec import Struct

from dpstack.errors import PduError
from dpstack.hart.status import additional_status_texts, extended_status_texts
from dpstack.hart.tables import NOT_USED, date_text, latin_text, maker_text, unit_text, unpack_ascii
from dpstack.text import octets_text

READ_IDENTITY: Final = 0
READ_VARIABLE: Final = 1
READ_CURRENT: Final = 2
READ_VARIABLES: Final = 3
IDENTITY_BY_TAG: Final = 11
READ_MESSAGE: Final = 12
READ_TAG: Final = 13
READ_SENSOR: Final = 14
READ_RANGE: Final = 15
READ_ASSEMBLY: Final = 16
READ_LONG_TAG: Final = 20
IDENTITY_BY_LONG_TAG: Final = 21
READ_STATUS: Final = 48
#: commands that change nothing in the device: they may be sent again after a damaged answer
READS: Final = frozenset({0, 1, 2, 3, 7, 8, 9, 11, 12, 13, 14, 15, 16, 20, 21, 33, 48, 50, 54})
#: the first octet of an identity: device type in one or two octets behind it
_EXPANSION: Final = 254
#: the HART revision from which on maker and device type have two octets each
_EXPANDED_SINCE: Final = 7
_DEVICE_IN_ADDRESS: Final = 0x3F
_NAMES: Final = ("PV", "SV", "TV", "QV")
_FLAGS: Final = {0x01: "multi-sensor device", 0x02: "EEPROM control", 0x04: "protocol bridge"}
_SIGNALLING: Final = {
    0: "Bell 202 current",
    1: "Bell 202 voltage",
    2: "RS-485",
    3: "RS-232",
    4: "wireless",
    6: "special",
}
_ALARMS: Final = {0: "high", 1: "low", 239: "hold last value"}
_TRANSFER: Final = {
    0: "linear",
    1: "square root",
    2: "square root of the third power",
    3: "square root of the fifth power",
    4: "special curve",
    5: "square",
    230: "switch",
}
_PROTECTED: Final = {0: "no", 1: "yes"}
_LEAST: Final[Mapping[int, int]] = {
    READ_IDENTITY: 12,
    READ_VARIABLE: 5,
    READ_CURRENT: 8,
    READ_VARIABLES: 9,
    READ_MESSAGE: 24,
    READ_TAG: 21,
    READ_SENSOR: 16,
    READ_RANGE: 17,
    READ_ASSEMBLY: 3,
    READ_LONG_TAG: 32,
    READ_STATUS: 1,
}

#: label and text of each field
Rows = list[tuple[str, str]]


class Identity(Struct, frozen=True):
    """The answer to command 0. ``manufacturer`` and ``device_type``: one octet each up to HART 6; later the type has
    two octets (the expanded device type), and so has the maker."""

    #: manufacturer identification code
    manufacturer: int
    #: device type, or expanded device type
    device_type: int
    #: 5, 6 or 7: HART revision
    revision: int
    #: revision of the device
    device_revision: int
    #: revision of its software
    software_revision: int
    #: revision of its hardware
    hardware_revision: int
    #: code of its physical layer
    signalling: int
    #: flags
    flags: int
    #: device ID, unique for maker and type
    device_id: int
    #: preambles that it needs in a request
    preambles: int
    #: the address of long frames, without the bits of master and burst
    address: bytes
    #: counter of configuration changes; None before HART 7
    configuration_changes: int | None = None
    #: extended device status; None before HART 7
    extended_status: int | None = None

    @classmethod
    def parse(cls, data: bytes) -> Identity:
        """The answer to command 0, 11 or 21. Raises PduError."""
        _least(READ_IDENTITY, data)
        if data[0] != _EXPANSION:
            raise PduError(f"an identity begins with {_EXPANSION}, not with {data[0]}")
        revision = data[4]
        expanded = revision >= _EXPANDED_SINCE
        later = expanded and len(data) >= 19
        return cls(
            int.from_bytes(data[17:19], "big") if later else data[1],
            int.from_bytes(data[1:3], "big") if expanded else data[2],
            revision,
            data[5],
            data[6],
            data[7] >> 3,
            data[7] & 7,
            data[8],
            int.from_bytes(data[9:12], "big"),
            data[3],
            bytes((data[1] & _DEVICE_IN_ADDRESS,)) + data[2:3] + data[9:12],
            int.from_bytes(data[14:16], "big") if later else None,
            data[16] if later else None,
        )

    @property
    def maker(self) -> str:
        """The maker's name with its code."""
        return maker_text(self.manufacturer)

    @property
    def type_text(self) -> str:
        return f"0x{self.device_type:02X}" if self.revision < _EXPANDED_SINCE else f"0x{self.device_type:04X}"

    @property
    def rows(self) -> Rows:
        rows = [
            ("maker", self.maker),
            ("device type", self.type_text),
            ("device ID", f"{self.device_id} (0x{self.device_id:06X})"),
            ("HART revision", str(self.revision)),
            ("device revision", str(self.device_revision)),
            ("software, hardware", f"{self.software_revision}, {self.hardware_revision}"),
            ("physical layer", _SIGNALLING.get(self.signalling, f"code {self.signalling}")),
            ("long address", self.address.hex(" ").upper()),
        ]
        flags = [name for bit, name in _FLAGS.items() if self.flags & bit]
        if flags:
            rows.append(("flags", ", ".join(flags)))
        if self.configuration_changes is not None:
            rows.append(("configuration changes", str(self.configuration_changes)))
        if self.extended_status:
            rows.append(("extended status", ", ".join(extended_status_texts(self.extended_status))))
        return rows


class Variable(Struct, frozen=True):
    """A dynamic variable. ``value``: None if the device gives none (not a number)."""

    #: PV, SV, TV or QV
    name: str
    #: value in ``unit``; None: the device gives none
    value: float | None
    #: code of Common Table 2
    unit_code: int

    @property
    def unit(self) -> str:
        """The unit; a code without a known meaning as its number."""
        return unit_text(self.unit_code)

    @property
    def text(self) -> str:
        return _value_text(self.value, self.unit_code)


class Variables(Struct, frozen=True):
    """The answer to command 3: the loop current in mA (None: the device gives none) and up to four variables."""

    #: mA
    current: float | None
    #: PV first
    variables: tuple[Variable, ...]

    @classmethod
    def parse(cls, data: bytes) -> Variables:
        """Raises PduError."""
        _least(READ_VARIABLES, data)
        found = [
            Variable(name, _number(data, at + 1), data[at])
            for name, at in zip(_NAMES, range(4, len(data) - 4, 5), strict=False)
        ]
        return cls(_number(data, 0), tuple(one for one in found if one.name == "PV" or one.unit_code != NOT_USED))

    @property
    def rows(self) -> Rows:
        return [("loop current", _value_text(self.current, 39)), *((one.name, one.text) for one in self.variables)]


class Tag(Struct, frozen=True):
    """The answer to command 13: tag (8 characters), descriptor (16), date."""

    tag: str
    descriptor: str
    #: ``2026-03-31``; octets that are no date as they are
    date: str

    @classmethod
    def parse(cls, data: bytes) -> Tag:
        """Raises PduError."""
        _least(READ_TAG, data)
        return cls(unpack_ascii(data[:6]), unpack_ascii(data[6:18]), date_text(data[18:21]))

    @property
    def rows(self) -> Rows:
        return [("tag", self.tag), ("descriptor", self.descriptor), ("date", self.date)]


class Range(Struct, frozen=True):
    """The answer to command 15: range of the primary variable, damping in s, alarm, transfer, write protection."""

    lower: float | None
    upper: float | None
    #: code of Common Table 2
    unit_code: int
    #: seconds
    damping: float | None
    alarm: int
    transfer: int
    write_protected: int

    @classmethod
    def parse(cls, data: bytes) -> Range:
        """Raises PduError."""
        _least(READ_RANGE, data)
        return cls(_number(data, 7), _number(data, 3), data[2], _number(data, 11), data[0], data[1], data[15])

    @property
    def unit(self) -> str:
        return unit_text(self.unit_code)

    @property
    def rows(self) -> Rows:
        lower = _number_text(self.lower)
        return [
            ("range", f"{lower} to {_value_text(self.upper, self.unit_code)}"),
            ("damping", _value_text(self.damping, 51)),
            ("transfer function", _named(_TRANSFER, self.transfer)),
            ("alarm current", _named(_ALARMS, self.alarm)),
            ("write protected", _named(_PROTECTED, self.write_protected)),
        ]


def decoded(command: int, data: bytes, revision: int = 7) -> Rows:
    """The ``data`` of an answer (behind the status octets) as rows; other commands in hex. Raises PduError.

    ``revision``: HART revision of the device, for command 48.
    """
    if command in (IDENTITY_BY_TAG, IDENTITY_BY_LONG_TAG):
        command = READ_IDENTITY
    decode = _DECODED.get(command)
    if decode is not None:
        _least(command, data)
        return decode(data)
    if command == READ_STATUS:
        _least(command, data)
        return [("additional status", text) for text in additional_status_texts(data, revision)] or [
            ("additional status", "none")
        ]
    return [("data", data.hex(" ").upper() or "none")]


def _variable(data: bytes) -> Rows:
    return [("PV", _value_text(_number(data, 1), data[0]))]


def _current(data: bytes) -> Rows:
    return [("loop current", _value_text(_number(data, 0), 39)), ("of range", _value_text(_number(data, 4), 57))]


def _sensor(data: bytes) -> Rows:
    lower, upper, span = (_number(data, at) for at in (8, 4, 12))
    return [
        ("sensor serial number", str(int.from_bytes(data[:3], "big"))),
        ("sensor limits", f"{_number_text(lower)} to {_value_text(upper, data[3])}"),
        ("minimum span", _value_text(span, data[3])),
    ]


_DECODED: Final[Mapping[int, Callable[[bytes], Rows]]] = {
    READ_IDENTITY: lambda data: Identity.parse(data).rows,
    READ_VARIABLE: _variable,
    READ_CURRENT: _current,
    READ_VARIABLES: lambda data: Variables.parse(data).rows,
    READ_MESSAGE: lambda data: [("message", unpack_ascii(data[:24]))],
    READ_TAG: lambda data: Tag.parse(data).rows,
    READ_SENSOR: _sensor,
    READ_RANGE: lambda data: Range.parse(data).rows,
    READ_ASSEMBLY: lambda data: [("final assembly number", str(int.from_bytes(data[:3], "big")))],
    READ_LONG_TAG: lambda data: [("long tag", latin_text(data[:32]))],
}


def _least(command: int, data: bytes) -> None:
    if len(data) < _LEAST[command]:
        raise PduError(
            f"the answer to HART command {command} has {octets_text(len(data))}, at least {_LEAST[command]} are needed"
        )


def _number(data: bytes, at: int) -> float | None:
    """The IEEE 754 number at ``at``; None for what is no finite number (HART: not a number, 7F A0 00 00)."""
    (number,) = struct.unpack_from(">f", data, at)
    return float(number) if math.isfinite(number) else None


def _number_text(number: float | None) -> str:
    return "no value" if number is None else f"{number:.6g}"


def _value_text(number: float | None, unit_code: int) -> str:
    return f"{_number_text(number)} {'' if number is None else unit_text(unit_code)}".rstrip()


def _named(names: Mapping[int, str], code: int) -> str:
    return names.get(code, f"code {code}")
