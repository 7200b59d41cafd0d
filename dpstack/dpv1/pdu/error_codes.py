"""Codes of a negative response: Error_Decode, error class and code, with texts
(docs/reference/protocol.md#negative-response).

Error_Code_1 is class (bits 7..4) and code (bits 3..0); Error_Code_2 is the device's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Final


class Decode(IntEnum):
    """Error_Decode: whose codes follow."""

    DPV1 = 0x80
    FMS = 0xFE
    HART = 0xFF


class ErrorClass(IntEnum):
    """Error_Class of DP-V1; 0..9 are reserved, 13..15 the device's own."""

    APPLICATION = 0xA
    ACCESS = 0xB
    RESOURCE = 0xC


class Code(IntEnum):
    """Error_Code_1 of DP-V1 if the standard gives it a meaning. Its name is its text."""

    READ_ERROR = 0xA0
    WRITE_ERROR = 0xA1
    MODULE_FAILURE = 0xA2
    VERSION_CONFLICT = 0xA8
    FEATURE_NOT_SUPPORTED = 0xA9
    INVALID_INDEX = 0xB0
    WRITE_LENGTH_ERROR = 0xB1
    INVALID_SLOT = 0xB2
    TYPE_CONFLICT = 0xB3
    INVALID_AREA = 0xB4
    STATE_CONFLICT = 0xB5
    ACCESS_DENIED = 0xB6
    INVALID_RANGE = 0xB7
    INVALID_PARAMETER = 0xB8
    INVALID_TYPE = 0xB9
    READ_CONSTRAINT_CONFLICT = 0xC0
    WRITE_CONSTRAINT_CONFLICT = 0xC1
    RESOURCE_BUSY = 0xC2
    RESOURCE_UNAVAILABLE = 0xC3


#: not now: worth another try
AGAIN: Final = frozenset(
    {Code.STATE_CONFLICT, Code.READ_CONSTRAINT_CONFLICT, Code.WRITE_CONSTRAINT_CONFLICT, Code.RESOURCE_BUSY}
)
_TEXTS: Final[Mapping[int, str]] = {code: code.name.lower().replace("_", " ") for code in Code}
#: remedies for the user, by code
_REMEDIES: Final[dict[int, str]] = {
    Code.INVALID_INDEX: "its manual lists the records it has",
    Code.INVALID_SLOT: "slots count from 0 (the station itself); its manual lists them",
    Code.WRITE_LENGTH_ERROR: "give the record exactly the octets its manual names",
    Code.STATE_CONFLICT: "not in this state: it is busy, or the answer is not ready; ask again",
    Code.ACCESS_DENIED: "the record is read-only, write-only, or locked",
    Code.RESOURCE_BUSY: "it is busy: ask again",
    Code.READ_CONSTRAINT_CONFLICT: "it is busy with another read: ask again",
    Code.WRITE_CONSTRAINT_CONFLICT: "it is busy with another write: ask again",
}
#: the classes that have codes by the standard; the code from which on they are the device's own
_USER_SPECIFIC: Final[Mapping[int, int]] = {ErrorClass.APPLICATION: 10, ErrorClass.ACCESS: 10, ErrorClass.RESOURCE: 8}


def class_text(error_class: int) -> str:
    """The name of an error class 0..15."""
    if error_class in _USER_SPECIFIC:
        return ErrorClass(error_class).name.lower()
    return "device specific" if error_class > ErrorClass.RESOURCE else "reserved"


def code_text(code_1: int) -> str:
    """The meaning of Error_Code_1 0..255, without its number."""
    error_class, code = divmod(code_1, 16)
    if code_1 in _TEXTS:
        return _TEXTS[code_1]
    if error_class not in _USER_SPECIFIC:
        return f"{class_text(error_class)}: see the device's manual" if error_class > 12 else "reserved"
    own = code >= _USER_SPECIFIC[error_class]
    return f"{class_text(error_class)}: " + ("device specific, see its manual" if own else f"reserved code {code}")


def remedy(code_1: int) -> str:
    """The remedy for an Error_Code_1; empty if there is no general one."""
    return _REMEDIES.get(code_1, "")


def negative_text(decode: int, code_1: int, code_2: int) -> str:
    """One line for a whole negative response: its octets, its meaning."""
    octets = f"{decode:02X} {code_1:02X} {code_2:02X}"
    match decode:
        case Decode.DPV1:
            more = f", second code 0x{code_2:02X}" if code_2 else ""
            return f"{code_text(code_1)} ({octets}: class {class_text(code_1 >> 4)}, code {code_1 & 15}{more})"
        case Decode.FMS | Decode.HART:
            return f"an error in the codes of {Decode(decode).name} ({octets}); its manual knows them"
        case _:
            return f"an error whose codes have no meaning here ({octets}: Error_Decode 0x{decode:02X} is unknown)"
