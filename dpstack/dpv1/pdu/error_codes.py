"""What a negative response says: Error_Decode, class and code with their texts (docs/protocol.md#negative-response).

Error_Code_1 is class (bits 7..4) and code (bits 3..0); Error_Code_2 is the device's own.
"""

from __future__ import annotations

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
    """Error_Code_1 of DP-V1 where the standard gives it a meaning."""

    READ_ERROR = 0xA0
    WRITE_ERROR = 0xA1
    MODULE_FAILURE = 0xA2
    VERSION_CONFLICT = 0xA8
    NOT_SUPPORTED = 0xA9
    INVALID_INDEX = 0xB0
    WRITE_LENGTH = 0xB1
    INVALID_SLOT = 0xB2
    TYPE_CONFLICT = 0xB3
    INVALID_AREA = 0xB4
    STATE_CONFLICT = 0xB5
    ACCESS_DENIED = 0xB6
    INVALID_RANGE = 0xB7
    INVALID_PARAMETER = 0xB8
    INVALID_TYPE = 0xB9
    READ_CONSTRAINT = 0xC0
    WRITE_CONSTRAINT = 0xC1
    RESOURCE_BUSY = 0xC2
    UNAVAILABLE = 0xC3


#: not now: worth another try
AGAIN: Final = frozenset({Code.STATE_CONFLICT, Code.READ_CONSTRAINT, Code.WRITE_CONSTRAINT, Code.RESOURCE_BUSY})
_CLASSES: Final = {
    ErrorClass.APPLICATION: "application",
    ErrorClass.ACCESS: "access",
    ErrorClass.RESOURCE: "resource",
}
_TEXTS: Final = {
    Code.READ_ERROR: "read error",
    Code.WRITE_ERROR: "write error",
    Code.MODULE_FAILURE: "module failure",
    Code.VERSION_CONFLICT: "version conflict",
    Code.NOT_SUPPORTED: "feature not supported",
    Code.INVALID_INDEX: "invalid index",
    Code.WRITE_LENGTH: "write length error",
    Code.INVALID_SLOT: "invalid slot",
    Code.TYPE_CONFLICT: "type conflict",
    Code.INVALID_AREA: "invalid area",
    Code.STATE_CONFLICT: "state conflict",
    Code.ACCESS_DENIED: "access denied",
    Code.INVALID_RANGE: "invalid range",
    Code.INVALID_PARAMETER: "invalid parameter",
    Code.INVALID_TYPE: "invalid type",
    Code.READ_CONSTRAINT: "read constraint conflict",
    Code.WRITE_CONSTRAINT: "write constraint conflict",
    Code.RESOURCE_BUSY: "resource busy",
    Code.UNAVAILABLE: "resource unavailable",
}
#: what the user can do about it, by class or code
_REMEDIES: Final[dict[int, str]] = {
    Code.INVALID_INDEX: "its manual lists the records it has",
    Code.INVALID_SLOT: "slots count from 0 (the station itself); its manual lists them",
    Code.WRITE_LENGTH: "give the record exactly the octets its manual names",
    Code.STATE_CONFLICT: "not in this state: it is busy, or the answer is not ready; ask again",
    Code.ACCESS_DENIED: "the record is read-only, write-only, or locked",
    Code.RESOURCE_BUSY: "it is busy: ask again",
    Code.READ_CONSTRAINT: "it is busy with another read: ask again",
    Code.WRITE_CONSTRAINT: "it is busy with another write: ask again",
}
#: the codes from here on are the device's own, in the classes that have texts
_USER_SPECIFIC: Final = {ErrorClass.APPLICATION: 10, ErrorClass.ACCESS: 10, ErrorClass.RESOURCE: 8}


def class_text(error_class: int) -> str:
    """The name of an error class 0..15."""
    known = _CLASSES.get(ErrorClass(error_class)) if error_class in ErrorClass.__members__.values() else None
    return known or ("device specific" if error_class > ErrorClass.RESOURCE else "reserved")


def code_text(code_1: int) -> str:
    """What Error_Code_1 0..255 says, without its number."""
    if code_1 in Code.__members__.values():
        return _TEXTS[Code(code_1)]
    error_class, code = divmod(code_1, 16)
    if error_class not in ErrorClass.__members__.values():
        return f"{class_text(error_class)}: see the device's manual" if error_class > 12 else "reserved"
    own = code >= _USER_SPECIFIC[ErrorClass(error_class)]
    return f"{class_text(error_class)}: " + ("device specific, see its manual" if own else f"reserved code {code}")


def remedy(code_1: int) -> str:
    """What to do about it; empty where nothing general can be said."""
    return _REMEDIES.get(code_1, "")


def negative_text(decode: int, code_1: int, code_2: int) -> str:
    """One line for a whole negative response: its octets, its meaning."""
    octets = f"{decode:02X} {code_1:02X} {code_2:02X}"
    match decode:
        case Decode.DPV1:
            more = f", code 2: 0x{code_2:02X}" if code_2 else ""
            return f"{code_text(code_1)} ({octets}: class {class_text(code_1 >> 4)}, code {code_1 & 15}{more})"
        case Decode.FMS:
            return f"an error in the codes of FMS ({octets}); its manual knows them"
        case Decode.HART:
            return f"an error in the codes of HART ({octets}); its manual knows them"
        case _:
            return f"an error whose codes have no meaning here ({octets}: Error_Decode 0x{decode:02X} is unknown)"
