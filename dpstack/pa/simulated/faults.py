"""Faults of a simulated process device, with their status octets, DIAGNOSIS and DIAGNOSIS_EXTENSION.

Classic: each event has a fixed status. Condensed: DIAG_EVENT_SWITCH says by its low four bits which status an event
gives, by its high four bits which bit of DIAGNOSIS. Sources: docs/reference/decisions/pa.md#simulated-devices.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple

#: quality and substatus without limits
GOOD: Final = 0x80
LOW, HIGH, CONSTANT = 1, 2, 3
#: out of service: classic, condensed (passivated)
PASSIVE: Final = (0x1F, 0x23)
#: substitute, last usable and initial value: classic, condensed
SUBSTITUTE, LAST_USABLE, INITIAL = (0x4B, 0x4B), (0x47, 0x4B), (0x4F, 0x4F)
#: what SIMULATE has for a value that somebody sets by hand
SIMULATED: Final = (0x60, 0x73)


class DiagnosisEvent(NamedTuple):
    """An event: its number in DIAG_EVENT_SWITCH (from 1), its key, the classic status and DIAGNOSIS, the switch."""

    number: int
    key: str
    words: str
    status: int
    diagnosis: bytes
    switch: int


SENSOR: Final = "sensor-failure"
REQUIRED: Final = "maintenance required"
DEMANDED: Final = "maintenance demanded"
ALARM: Final = "maintenance alarm"
CHECK: Final = "function-check"
OUTSIDE: Final = "out-of-specification"
EVENTS: Final = (
    DiagnosisEvent(1, SENSOR, "sensor failure", 0x10, bytes((0x20, 0, 0, 0)), 0x34),
    DiagnosisEvent(2, REQUIRED, "maintenance required", 0xA4, bytes((0, 0x20, 0, 0)), 0x11),
    DiagnosisEvent(3, DEMANDED, "maintenance demanded", 0x50, bytes((0, 0x20, 0, 0)), 0x22),
    DiagnosisEvent(4, ALARM, "electronics failed", 0x0C, bytes((0x01, 0, 0, 0)), 0x34),
    DiagnosisEvent(5, CHECK, "function check", 0x64, bytes(4), 0x57),
    DiagnosisEvent(6, OUTSIDE, "outside the limits of the sensor", 0x50, bytes(4), 0x45),
)
#: DIAG_EVENT_SWITCH as delivered: 48 events, and no further switch behind them
SWITCHES: Final = bytes(one.switch for one in EVENTS).ljust(50, b"\0")
#: status by the low four bits of a switch, octet and bit of DIAGNOSIS by the high ones
_STATUS: Final = (GOOD, 0xA4, 0xA8, 0x68, 0x24, 0x78, 0x28, 0x3C, 0xBC)
_BITS: Final = (
    bytes(4),
    bytes((0, 0x20, 0, 0)),
    bytes((0, 0, 2, 0)),
    bytes((0, 0, 1, 0)),
    bytes((0, 0, 8, 0)),
    bytes((0, 0, 4, 0)),
)
_EXTENSION_AVAILABLE: Final = bytes((0, 0, 0, 0x80))
#: the worst first; of two of one quality, the one that comes first counts
_ORDER: Final = (0x24, 0x0C, 0x10, 0x28, 0x3C, 0x68, 0x50, 0x64, 0x78, 0xA8, 0xA4, 0xBC, GOOD)


def _switch(number: int, switches: bytes) -> int:
    return switches[number - 1] if number <= len(switches) - 2 else 0


def status_of(events: Iterable[DiagnosisEvent], condensed: bool, switches: bytes) -> int:
    """The status octet of a measured value while ``events`` stand, without limits."""
    found = [
        _STATUS[min(_switch(one.number, switches) & 15, len(_STATUS) - 1)] if condensed else one.status
        for one in events
    ]
    return min(found, key=_rank, default=GOOD)


def _rank(status: int) -> tuple[int, int]:
    return status >> 6, _ORDER.index(status) if status in _ORDER else len(_ORDER)


def diagnosis_of(events: Iterable[DiagnosisEvent], condensed: bool, switches: bytes) -> tuple[bytes, bytes]:
    """DIAGNOSIS and DIAGNOSIS_EXTENSION while ``events`` stand."""
    found, extension = bytes(4), 0
    for one in events:
        high = _switch(one.number, switches) >> 4
        found = _or(found, _BITS[min(high, len(_BITS) - 1)] if condensed else one.diagnosis)
        extension |= 1 << one.number - 1
    if extension:
        found = _or(found, _EXTENSION_AVAILABLE)
    return found, extension.to_bytes(6, "little")


def _or(one: bytes, other: bytes) -> bytes:
    return bytes(left | right for left, right in zip(one, other, strict=True))
