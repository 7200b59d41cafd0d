"""Response code, device status and additional status (command 48) of a HART device in words.

Sources: docs/reference/decisions/hart.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

#: bit 7 of the response code: the device has received a damaged request
COMMUNICATION_ERROR: Final = 0x80
BUSY: Final = 32
DELAYED_INITIATED: Final = 33
DELAYED_RUNNING: Final = 34
DELAYED_CONFLICT: Final = 36
NOT_IMPLEMENTED: Final = 64
#: response codes after which the same request is sent again
AGAIN: Final = frozenset({BUSY, DELAYED_INITIATED, DELAYED_RUNNING, DELAYED_CONFLICT})
#: response codes that are warnings: the command was carried out (8, 14, 24 to 27, 30, 96 to 111 and 112 to 127)
_WARNINGS: Final = frozenset({8, 14, *range(24, 28), 30, *range(96, 128)})
_CODES: Final[Mapping[int, str]] = {
    0: "success",
    2: "invalid selection",
    3: "passed parameter too large",
    4: "passed parameter too small",
    5: "too few data bytes received",
    6: "device specific command error",
    7: "in write protect mode",
    8: "warning: update failure, update in progress, or set to nearest possible value",
    9: "lower range value or applied process too high, or another meaning by command",
    10: "lower range value or applied process too low, or another meaning by command",
    11: "upper range value too high, or in multidrop mode, or another meaning by command",
    12: "upper range value too low, or invalid unit or mode, or another meaning by command",
    13: "both range values out of limits, or another meaning by command",
    14: "warning: span too small, or new lower range value pushed",
    16: "access restricted",
    17: "invalid device variable index",
    18: "invalid units code",
    19: "device variable index not allowed for this command",
    29: "invalid span",
    BUSY: "busy",
    DELAYED_INITIATED: "delayed response initiated",
    DELAYED_RUNNING: "delayed response running",
    35: "delayed response dead",
    DELAYED_CONFLICT: "delayed response conflict",
    NOT_IMPLEMENTED: "command not implemented",
}
_COMMUNICATION: Final[Mapping[int, str]] = {
    0x40: "parity error",
    0x20: "overrun error",
    0x10: "framing error",
    0x08: "checksum error",
    0x02: "receive buffer overflow",
}
MORE_STATUS: Final = 0x10
MALFUNCTION: Final = 0x80
_DEVICE: Final[Mapping[int, str]] = {
    MALFUNCTION: "device malfunction",
    0x40: "configuration changed",
    0x20: "cold start",
    MORE_STATUS: "more status available (command 48)",
    0x08: "loop current fixed",
    0x04: "loop current saturated",
    0x02: "non-primary variable out of limits",
    0x01: "primary variable out of limits",
}
_EXTENDED: Final[Mapping[int, str]] = {
    0x01: "maintenance required",
    0x02: "device variable alert",
    0x04: "critical power failure",
    0x08: "failure",
    0x10: "out of specification",
    0x20: "function check",
}
_STANDARDIZED: Final[Sequence[Mapping[int, str]]] = (
    {
        0x01: "simulation active",
        0x02: "non-volatile memory defect",
        0x04: "volatile memory defect",
        0x08: "watchdog reset executed",
        0x10: "power supply conditions out of range",
        0x20: "environmental conditions out of range",
        0x40: "electronic defect",
        0x80: "device configuration locked",
    },
    {
        0x01: "status simulation active",
        0x02: "discrete variable simulation active",
        0x04: "event notification overflow",
        0x08: "battery or power supply needs maintenance",
    },
    {0x01: "sub-device list changed", 0x02: "duplicate master detected"},
    {
        0x01: "capacity denied",
        0x02: "bandwidth allocation pending",
        0x04: "block transfer pending",
        0x08: "radio failure",
    },
)
#: octets of command 48 by their place: extended status, operating mode, standardized status 0 to 3
_EXTENDED_AT: Final = 6
_MODE_AT: Final = 7
_STANDARDIZED_AT: Final = (8, 9, 11, 12)
_SATURATED_AT: Final = 10
_FIXED_AT: Final = 13
_OF_DEVICE: Final = (*range(6), *range(14, 25))
#: HART revisions from which on these octets have a standardized meaning
_EXTENDED_SINCE: Final = 6
_STANDARDIZED_SINCE: Final = 7


def response_text(code: int) -> str:
    """A response code 0..255 in words: of the command, or the errors that the device saw in the request."""
    if code & COMMUNICATION_ERROR:
        seen = _bits(code & ~COMMUNICATION_ERROR, _COMMUNICATION)
        return f"communication error in the request ({', '.join(seen) or f'0x{code:02X}'})"
    return _CODES.get(code, f"response code {code}: its meaning depends on the command")


def is_warning(code: int) -> bool:
    """Whether the command was carried out with a warning."""
    return code in _WARNINGS


def device_status_texts(status: int) -> tuple[str, ...]:
    """The bits of the device status octet, the most severe first."""
    return _bits(status, _DEVICE)


def extended_status_texts(status: int) -> tuple[str, ...]:
    """The bits of the extended device status of HART 6 and later."""
    return _bits(status, _EXTENDED)


def additional_status_texts(data: bytes, revision: int) -> tuple[str, ...]:
    """The data of command 48 in words, as far as they are standardized in the HART ``revision`` of the device (its
    universal command revision); the maker's own octets in hex, if a bit is set in them."""
    found: list[str] = []
    plain = {*range(len(data))} - {*_OF_DEVICE}
    if revision >= _EXTENDED_SINCE and len(data) > _EXTENDED_AT:
        plain -= {_EXTENDED_AT}
        found += extended_status_texts(data[_EXTENDED_AT])
    if revision >= _STANDARDIZED_SINCE:
        for at, table in zip(_STANDARDIZED_AT, _STANDARDIZED, strict=True):
            found += _bits(data[at], table) if at < len(data) else ()
        plain -= {*_STANDARDIZED_AT, _SATURATED_AT, _FIXED_AT}
        found += _channels(data, _SATURATED_AT, "saturated") + _channels(data, _FIXED_AT, "fixed")
    if _MODE_AT in plain and data[_MODE_AT]:
        found.append(f"operating mode {data[_MODE_AT]}")
    own = [at for at in (*_OF_DEVICE, *sorted(plain - {_MODE_AT})) if at < len(data) and data[at]]
    found += [f"byte {at}: 0x{data[at]:02X} (the maker's own)" for at in sorted(own)]
    return tuple(found)


def _channels(data: bytes, at: int, what: str) -> list[str]:
    """Analogue channels 1 and up, beside the loop current itself."""
    octet = data[at] if at < len(data) else 0
    return [f"analog channel {channel + 1} {what}" for channel in range(8) if octet >> channel & 1]


def _bits(octet: int, names: Mapping[int, str]) -> tuple[str, ...]:
    known = [name for bit, name in names.items() if octet & bit]
    rest = octet & ~sum(names)
    return (*known, *((f"bits 0x{rest:02X} without a standardized meaning",) if rest else ()))
