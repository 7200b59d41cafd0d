"""DIAGNOSIS of PROFIBUS PA: four octets of the physical block, which a device sends in its Slave_Diag too.

The bits in words with their category of NAMUR NE 107, in the classic and the condensed diagnosis; the maker's six
octets behind them. Sources and choices: docs/reference/decisions/pa.md#diagnosis.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from dpstack.text import TextEnum, printable

#: octets of DIAGNOSIS, and of DIAGNOSIS_EXTENSION
DIAGNOSIS_LEN: Final = 4
EXTENSION_LEN: Final = 6
#: specifier of a status with DIAGNOSIS: at least one bit was set, or reset; others may still be set
CHANGES: Final = ("", "a message appears", "a message disappears", "a message disappears")


class Category(TextEnum):
    """NAMUR NE 107, the most serious one first."""

    FAILURE = "F", "failure"
    FUNCTION_CHECK = "C", "function check"
    OUT_OF_SPECIFICATION = "S", "out of specification"
    MAINTENANCE = "M", "maintenance"


_F, _C, _S, _M = Category


class DiagnosisBit(NamedTuple):
    """``octet`` from 1; ``name`` is the profile's. ``category`` None: an event, nothing is wrong."""

    octet: int
    mask: int
    name: str
    category: Category | None
    text: str
    #: the condensed diagnosis has it too; all others are reserved there
    condensed: bool = False

    @property
    def words(self) -> str:
        """The text, with its category in brackets if the text does not say it."""
        if self.category is None or self.category.text in self.text:
            return self.text
        return f"{self.text} ({self.category.text})"


#: further messages stand in DIAGNOSIS_EXTENSION
EXTENSION_AVAILABLE: Final = DiagnosisBit(
    4, 0x80, "EXTENSION_AVAILABLE", None, "more in DIAGNOSIS_EXTENSION", condensed=True
)

#: every bit that the profile defines, in the order of the octets
BITS: Final = (
    DiagnosisBit(1, 0x01, "DIA_HW_ELECTR", _F, "hardware failure of the electronics"),
    DiagnosisBit(1, 0x02, "DIA_HW_MECH", _F, "hardware failure of the mechanics"),
    DiagnosisBit(1, 0x04, "DIA_TEMP_MOTOR", _S, "motor too hot"),
    DiagnosisBit(1, 0x08, "DIA_TEMP_ELECTR", _S, "electronics too hot"),
    DiagnosisBit(1, 0x10, "DIA_MEM_CHKSUM", _F, "memory error"),
    DiagnosisBit(1, 0x20, "DIA_MEASUREMENT", _F, "measurement failed"),
    DiagnosisBit(1, 0x40, "DIA_NOT_INIT", _F, "not initialised, no self-calibration"),
    DiagnosisBit(1, 0x80, "DIA_INIT_ERR", _F, "self-calibration failed"),
    DiagnosisBit(2, 0x01, "DIA_ZERO_ERR", _M, "zero point error, end position"),
    DiagnosisBit(2, 0x02, "DIA_SUPPLY", _F, "electrical or pneumatic supply failed"),
    DiagnosisBit(2, 0x04, "DIA_CONF_INVAL", _F, "configuration not valid"),
    DiagnosisBit(2, 0x08, "DIA_WARMSTART", None, "warm start", condensed=True),
    DiagnosisBit(2, 0x10, "DIA_COLDSTART", None, "cold start, parameters were reset", condensed=True),
    DiagnosisBit(2, 0x20, "DIA_MAINTENANCE", _M, "maintenance required", condensed=True),
    DiagnosisBit(2, 0x40, "DIA_CHARACT", _M, "characteristic not valid"),
    DiagnosisBit(
        2, 0x80, "IDENT_NUMBER_VIOLATION", None, "ident number differs from IDENT_NUMBER_SELECTOR", condensed=True
    ),
    DiagnosisBit(3, 0x01, "DIA_MAINTENANCE_ALARM", _F, "maintenance alarm", condensed=True),
    DiagnosisBit(3, 0x02, "DIA_MAINTENANCE_DEMANDED", _M, "maintenance demanded", condensed=True),
    DiagnosisBit(3, 0x04, "DIA_FUNCTION_CHECK", _C, "in function check, simulation or local operation", condensed=True),
    DiagnosisBit(3, 0x08, "DIA_INV_PRO_COND", _S, "process conditions do not allow a valid value", condensed=True),
    DiagnosisBit(3, 0x10, "UPDATE_EVENT", None, "parameters were changed", condensed=True),
    EXTENSION_AVAILABLE,
)
_BY_PLACE: Final = {(bit.octet, bit.mask): bit for bit in BITS}


def _set_masks(octets: bytes) -> Iterator[tuple[int, int]]:
    """Octet (from 1) and mask of each bit that is 1."""
    for number, octet in enumerate(octets, 1):
        yield from ((number, 1 << place) for place in range(8) if octet >> place & 1)


def diagnosis_bits(octets: bytes) -> tuple[DiagnosisBit, ...]:
    """The bits of DIAGNOSIS that are set, in the order of the octets; reserved ones with their place.

    ``octets``: four; missing ones count as 0, further ones are left out.
    """
    return tuple(
        _BY_PLACE.get(place)
        or DiagnosisBit(*place, "", None, f"octet {place[0]} bit {place[1].bit_length() - 1} (reserved)")
        for place in _set_masks(octets[:DIAGNOSIS_LEN])
    )


def category_of(octets: bytes) -> Category | None:
    """The most serious category in DIAGNOSIS; None if nothing is wrong."""
    found = {bit.category for bit in diagnosis_bits(octets)}
    return next((category for category in Category if category in found), None)


def diagnosis_words(octets: bytes) -> tuple[str, ...]:
    """DIAGNOSIS in words, one text a bit that is set: the most serious ones first, EXTENSION_AVAILABLE last."""
    order: dict[Category | None, int] = {category: place for place, category in enumerate((*Category, None))}
    found = sorted(diagnosis_bits(octets), key=lambda bit: (bit is EXTENSION_AVAILABLE, order[bit.category]))
    return tuple(bit.words for bit in found)


def extension_words(octets: bytes, names: Mapping[int, str] | None = None) -> tuple[str, ...]:
    """DIAGNOSIS_EXTENSION in words: the maker's bits, numbered from 1 (bit 0 of octet 1) as DIAG_EVENT_SWITCH does.

    ``names``: what the device file calls them; a bit without a name is shown by its number.
    """
    known = names or {}
    numbers = ((octet - 1) * 8 + mask.bit_length() for octet, mask in _set_masks(octets))
    return tuple(printable(known[number]) if number in known else f"maker's bit {number}" for number in numbers)


def status_words(data: bytes, names: Mapping[int, str] | None = None) -> str | None:
    """The data of a status of type :data:`~dpstack.dp.pdu.alarm_blocks.PHYSICAL_BLOCK` in words: DIAGNOSIS, and the
    maker's octets behind it, which are DIAGNOSIS_EXTENSION or another number of them.

    None for fewer than four octets, that is if another maker means something else by this type.
    """
    if len(data) < DIAGNOSIS_LEN:
        return None
    extension = extension_words(data[DIAGNOSIS_LEN:], names)
    return ", ".join((*diagnosis_words(data[:DIAGNOSIS_LEN]), *extension)) or "nothing to report"
