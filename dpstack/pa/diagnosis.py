"""Diagnosis of a PROFIBUS PA device in words: DIAGNOSIS, its extension, CHECKBACK of a valve.

DIAGNOSIS has a home of its own, :mod:`dpstack.dp.pdu.pa_diagnosis`, because a device sends it in its Slave_Diag too.
Sources: docs/reference/decisions/pa.md#checkback.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from dpstack.dp.pdu.pa_diagnosis import (
    BITS,
    DIAGNOSIS_LEN,
    EXTENSION_LEN,
    Category,
    DiagnosisBit,
    category_of,
    diagnosis_bits,
    diagnosis_words,
    extension_words,
)

__all__ = [
    "BITS",
    "CHECKBACK",
    "CHECKBACK_LEN",
    "DIAGNOSIS_LEN",
    "EXTENSION_LEN",
    "Category",
    "CheckbackBit",
    "DiagnosisBit",
    "category_of",
    "checkback_bits",
    "checkback_words",
    "diagnosis_bits",
    "diagnosis_words",
    "extension_words",
]

#: octets of CHECKBACK
CHECKBACK_LEN: Final = 3


class CheckbackBit(NamedTuple):
    """``octet`` from 0, as the manuals count. ``event``: the device takes the bit back after 10 s."""

    octet: int
    mask: int
    name: str
    text: str
    event: bool = False


#: every bit that the profile defines; octet 2 beyond its first bits is the maker's
CHECKBACK: Final = (
    CheckbackBit(0, 0x01, "CB_FAIL_SAFE", "in the fail-safe position"),
    CheckbackBit(0, 0x02, "CB_REQ_LOC_OP", "asks for local operation", event=True),
    CheckbackBit(0, 0x04, "CB_LOCAL_OP", "operated locally"),
    CheckbackBit(0, 0x08, "CB_OVERRIDE", "emergency operation"),
    CheckbackBit(0, 0x10, "CB_DISC_DIR", "moves in the wrong direction"),
    CheckbackBit(0, 0x20, "CB_TORQUE_D_OP", "end stop or torque limit reached, open"),
    CheckbackBit(0, 0x40, "CB_TORQUE_D_CL", "end stop or torque limit reached, closed"),
    CheckbackBit(0, 0x80, "CB_TRAV_TIME", "does not reach the position in time", event=True),
    CheckbackBit(1, 0x01, "CB_ACT_OPEN", "opens"),
    CheckbackBit(1, 0x02, "CB_ACT_CLOSE", "closes"),
    CheckbackBit(1, 0x04, "CB_UPDATE_EVT", "parameters were changed", event=True),
    CheckbackBit(1, 0x08, "CB_SIMULATE", "simulation is on"),
    CheckbackBit(1, 0x20, "CB_CONTR_ERR", "control loop error"),
    CheckbackBit(1, 0x40, "CB_CONTR_INACT", "positioner inactive"),
    CheckbackBit(1, 0x80, "CB_SELFTEST", "self-test or initialisation runs"),
    CheckbackBit(2, 0x01, "CB_TOT_VALVE_TRAV", "limit of the total valve travel exceeded"),
    CheckbackBit(2, 0x02, "CB_ADD_INPUT", "additional input is active"),
)
_BY_PLACE: Final = {(bit.octet, bit.mask): bit for bit in CHECKBACK}


def checkback_bits(octets: bytes) -> tuple[CheckbackBit, ...]:
    """The bits of CHECKBACK that are set; the maker's and the reserved ones with their place instead of a name.

    ``octets``: three; missing ones count as 0, further ones are left out.
    """
    places = ((n, 1 << bit) for n, octet in enumerate(octets[:CHECKBACK_LEN]) for bit in range(8) if octet >> bit & 1)
    return tuple(_BY_PLACE.get(place) or _unknown(*place) for place in places)


def _unknown(octet: int, mask: int) -> CheckbackBit:
    kind = "maker's" if octet == CHECKBACK_LEN - 1 else "reserved"
    return CheckbackBit(octet, mask, "", f"octet {octet} bit {mask.bit_length() - 1} ({kind})")


def checkback_words(octets: bytes) -> tuple[str, ...]:
    """CHECKBACK in words, one for each bit that is set."""
    return tuple(bit.text for bit in checkback_bits(octets))
