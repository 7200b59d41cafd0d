"""The status octet beside a value: quality and words of PROFIBUS PA, in the classic and the condensed coding.

Bits 7 and 6: bad, uncertain, good, good (cascade); bits 5 to 2: the substatus; bits 1 and 0: the limits. Sources of the
rows: docs/reference/quality.md#status-octets.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple, Protocol

from dpstack.plant.quality import NO_MEANING, Reason

CLASSIC, CONDENSED = "pa-classic", "pa-condensed"
#: the codings that a configuration may name
TABLES: Final = (CLASSIC, CONDENSED)

_LIMITS: Final = ("", ", low limit", ", high limit", ", constant")
#: quality without a known substatus
_GENERAL: Final = (Reason.STATUS_BAD, Reason.STATUS_UNCERTAIN, Reason.STATUS_GOOD, Reason.STATUS_GOOD)
#: good (cascade), the same in both codings: of outputs and of RCAS_OUT
_CASCADE: Final = {
    0xC0: (Reason.GOOD, ""),
    0xC4: (Reason.STATUS_GOOD, "initialisation acknowledged"),
    0xC8: (Reason.STATUS_GOOD, "initialisation requested"),
    0xCC: (Reason.STATUS_GOOD, "not invited"),
    0xD4: (Reason.STATUS_GOOD, "do not select"),
    0xD8: (Reason.STATUS_GOOD, "local override"),
    0xE0: (Reason.STATUS_GOOD, "initiate fail-safe"),
}
#: substatus, the octet without its limits: reason, words
_ROWS: Final[Mapping[str, Mapping[int, tuple[Reason, str]]]] = {
    CLASSIC: {
        0x00: (Reason.STATUS_BAD, "not specific"),
        0x04: (Reason.STATUS_CONFIGURATION, "configuration error"),
        0x08: (Reason.STATUS_NOT_CONNECTED, "not connected"),
        0x0C: (Reason.STATUS_DEVICE_FAILURE, "device failure"),
        0x10: (Reason.STATUS_SENSOR_FAILURE, "sensor failure"),
        0x14: (Reason.STATUS_NO_COMMUNICATION, "no communication, last usable value"),
        0x18: (Reason.STATUS_NO_COMMUNICATION, "no communication, no usable value"),
        0x1C: (Reason.STATUS_OUT_OF_SERVICE, "out of service"),
        0x40: (Reason.STATUS_UNCERTAIN, "not specific"),
        0x44: (Reason.STATUS_LAST_USABLE, "last usable value"),
        0x48: (Reason.STATUS_SUBSTITUTE, "substitute set"),
        0x4C: (Reason.STATUS_INITIAL, "initial value"),
        0x50: (Reason.STATUS_NOT_ACCURATE, "sensor conversion not accurate"),
        0x54: (Reason.STATUS_RANGE, "range of the unit violated"),
        0x58: (Reason.STATUS_SUBNORMAL, "subnormal"),
        0x5C: (Reason.STATUS_UNCERTAIN, "configuration error"),
        0x60: (Reason.STATUS_SUBSTITUTE, "simulated value"),
        0x64: (Reason.STATUS_NOT_ACCURATE, "sensor calibration"),
        0x80: (Reason.GOOD, ""),
        0x84: (Reason.STATUS_GOOD, "update event"),
        0x88: (Reason.STATUS_GOOD, "active advisory alarm"),
        0x8C: (Reason.STATUS_GOOD, "active critical alarm"),
        0x90: (Reason.STATUS_GOOD, "unacknowledged update event"),
        0x94: (Reason.STATUS_GOOD, "unacknowledged advisory alarm"),
        0x98: (Reason.STATUS_GOOD, "unacknowledged critical alarm"),
        0xA0: (Reason.STATUS_GOOD, "initiate fail-safe"),
        0xA4: (Reason.STATUS_GOOD, "maintenance required"),
        **_CASCADE,
    },
    CONDENSED: {
        0x00: (Reason.STATUS_BAD, "not specific"),
        0x20: (Reason.STATUS_OUT_OF_SERVICE, "passivated"),
        0x24: (Reason.STATUS_DEVICE_FAILURE, "maintenance alarm"),
        0x28: (Reason.STATUS_BAD, "process related, no maintenance"),
        0x3C: (Reason.STATUS_OUT_OF_SERVICE, "function check"),
        0x48: (Reason.STATUS_SUBSTITUTE, "substitute set"),
        0x4C: (Reason.STATUS_INITIAL, "initial value"),
        0x68: (Reason.STATUS_SUBNORMAL, "maintenance demanded"),
        0x70: (Reason.STATUS_SUBSTITUTE, "simulated value, start"),
        0x74: (Reason.STATUS_SUBSTITUTE, "simulated value, end"),
        0x78: (Reason.STATUS_NOT_ACCURATE, "process related, no maintenance"),
        0x80: (Reason.GOOD, ""),
        0x84: (Reason.STATUS_GOOD, "update event"),
        0x88: (Reason.STATUS_GOOD, "advisory alarm"),
        0x8C: (Reason.STATUS_GOOD, "critical alarm"),
        0xA0: (Reason.STATUS_GOOD, "initiate fail-safe"),
        0xA4: (Reason.STATUS_GOOD, "maintenance required"),
        0xA8: (Reason.STATUS_GOOD, "maintenance demanded"),
        0xBC: (Reason.STATUS_GOOD, "function check"),
        **_CASCADE,
    },
}


class StatusMeaning(NamedTuple):
    """A status octet. ``text``: its words with the limits and the octet; empty if there is nothing to say."""

    reason: Reason
    text: str


def read_status(table: str, octet: int) -> StatusMeaning:
    """The meaning of ``octet`` in the coding ``table``, one of :data:`TABLES`. A substatus that the table does not have
    counts by its first two bits."""
    reason, words = _ROWS[table].get(octet & 0xFC, (_GENERAL[octet >> 6], "unknown substatus"))
    limits = _LIMITS[octet & 3]
    if reason is Reason.GOOD:
        return StatusMeaning(Reason.STATUS_GOOD, f"good{limits} (status {octet:02X})") if limits else _GOOD
    return StatusMeaning(reason, f"{words}{limits} (status {octet:02X})")


_GOOD: Final = StatusMeaning(Reason.GOOD, "")
_NOT_A_NUMBER: Final = StatusMeaning(Reason.NOT_A_NUMBER, "")


class OwnStatus(Protocol):
    """A named value whose octets may say more than the value, see :class:`dpstack.dp.process_data.Field`."""

    @property
    def status(self) -> int | None: ...
    @property
    def coding(self) -> str: ...
    @property
    def words(self) -> Mapping[int, str]: ...
    def get(self, octets: bytes) -> object: ...


def read_octets(field: OwnStatus, octets: bytes) -> StatusMeaning:
    """The quality that the octets of an image give to a value: a float that is no number, its status octet; and the
    word for its number, if it has words. ``octets`` are long enough for all of them."""
    value = field.get(octets)
    if isinstance(value, float) and not math.isfinite(value):
        return _NOT_A_NUMBER
    found = _GOOD if field.status is None else read_status(field.coding, octets[field.status])
    if not field.words or not isinstance(value, int):
        return found
    word = field.words.get(value, NO_MEANING)
    reason = Reason.STATUS_GOOD if found.reason is Reason.GOOD else found.reason
    return StatusMeaning(reason, f"{word}; {found.text}" if found.text else word)
