"""Facts of the F5 that its Python looks at by name; all others are in keb-f5.toml, whose comments have the sources.

Passages: docs/reference/drives/keb-f5.md; the names in the comments are headings of the manual.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, NamedTuple

from dpstack.devices.finding import drive_file_at
from dpstack.profile import ParamSpec

FILE: Final = drive_file_at(Path(__file__).with_name("keb-f5.toml"))
PARAMETERS: Final = FILE.parameters

#: Application Parameters: 2000h + the address of the application manual
INVERTER: Final = range(0x2000, 0x5F00)
INTERFACE: Final = range(0x5F00, 0x6000)
SETS: Final = 8

CONTROL_WORD, STATUS_WORD, SET_SPEED, ACTUAL_SPEED = 0x2032, 0x2033, 0x2034, 0x2035
#: sy.43, sy.44; sy.50 and sy.51 are their low halves
CONTROL_LONG, STATUS_LONG = 0x202B, 0x202C
#: the parameters that the manual itself maps as words
WORDS: Final = frozenset({CONTROL_WORD, STATUS_WORD, SET_SPEED, ACTUAL_SPEED})
INVERTER_STATE: Final = 0x2200
#: Saving of the F5 PB-Operator Configuration: the map as the inverter has it, sy.16 to sy.31 and sy.58 to sy.73. Of
#: each block and direction the first definition (an address without 2000h, -1 off); its sets and the next ones follow
ACTIVE_INPUTS, ACTIVE_OUTPUTS = (0x2010, 0x203A), (0x2018, 0x2042)
#: values of a block, each a definition and its sets
BLOCK_VALUES: Final = 4
#: a definition of nothing, as 16 bits
OFF: Final = 0xFFFF
#: Changing the PD-Assignment: the records of the map, and their enables
MAP_INPUTS, MAP_OUTPUTS = 0x6000, 0x6001
ENABLE_INPUTS, ENABLE_OUTPUTS = 0x5FF8, 0x6002
ENABLED: Final = 0xFF
RECORDS: Final = frozenset({MAP_INPUTS, MAP_OUTPUTS, ENABLE_INPUTS, ENABLE_OUTPUTS})
#: the manual's two readings: when a new map acts
AT_POWER_ON, WITH_ENABLE = "power-on", "enable"

#: groups whose address the manual shows
GROUPS: Final = {"sy": 0x20, "ru": 0x22, "oP": 0x23, "LE": 0x2D, "cS": 0x2F}
_NAME: Final = re.compile(r"([A-Za-z]{2})[. ]?(\d{1,3})")


def index_of(name: str) -> int | None:
    """The index of a parameter such as ``oP.3`` (or ``op03``) of a group whose address the manual shows, else None."""
    match = _NAME.fullmatch(name.strip())
    if match is None or int(match[2]) > 0xFF:
        return None
    group = next((high for text, high in GROUPS.items() if text.lower() == match[1].lower()), None)
    return None if group is None else group << 8 | int(match[2])


def why_not_read(spec: ParamSpec) -> str | None:
    """Why a parameter of the table cannot be read by its name; None if it can."""
    if index_of(spec.name) is not None:
        return None
    return "the address of its group is not in the manual: read it by its index (0x2000 + the address)"


def looks_like_name(name: str) -> bool:
    """A group and a number, known or not."""
    return _NAME.fullmatch(name.strip()) is not None


def name_of(index: int) -> str:
    """``oP.3 (2303h)`` if the group is known."""
    group = next((text for text, high in GROUPS.items() if high == index >> 8), None)
    return f"{index:04X}h" if group is None else f"{group}.{index & 0xFF:02} ({index:04X}h)"


class Code(NamedTuple):
    """An error of the parameter channel: class, code, additional code."""

    kind: int
    code: int
    more: int

    @classmethod
    def of(cls, number: int) -> Code:
        """From :attr:`number`."""
        return cls(number >> 24, number >> 16 & 0xFF, number & 0xFFFF)

    def __str__(self) -> str:
        return f"{self.kind}/{self.code}/{self.more:04X}"

    @property
    def number(self) -> int:
        """The four octets EB5 to EB8 as one number."""
        return self.kind << 24 | self.code << 16 | self.more


READ_AND_WRITE: Final = Code(5, 4, 0)
NO_INVERTER: Final = Code(6, 2, 0)
WRITE_PROTECTED: Final = Code(6, 3, 0)
PASSWORD: Final = Code(6, 3, 0x30)
BAD_INDEX: Final = Code(6, 4, 0)
BAD_MAP: Final = Code(6, 5, 0)
BAD_SUBINDEX: Final = Code(6, 5, 0x11)
BUSY: Final = Code(8, 0, 0x22)
BAD_VALUE: Final = Code(8, 0, 0x30)
BAD_SET: Final = Code(8, 0, 0x33)
NOT_POSSIBLE: Final = Code(8, 0, 0x34)

#: Error messages of the parameterizing channel
ERRORS: Final = {
    READ_AND_WRITE: "read and write asked for at once",
    NO_INVERTER: "the operator has no connection to the inverter",
    WRITE_PROTECTED: "the parameter is write protected",
    PASSWORD: "not accessible with the present password (ud.01)",
    BAD_INDEX: "there is no such parameter (index)",
    BAD_MAP: "invalid process data description",
    BAD_SUBINDEX: "invalid subindex",
    BUSY: "the inverter is busy",
    BAD_VALUE: "the value is outside its range",
    BAD_SET: "there is no such parameter set",
    NOT_POSSIBLE: "the operation is not possible",
}

#: the section that says what makes the inverter obey sy.50 and sy.52
BASIC: Final = "Basic Adjustments"
#: made up: the bits of the simulated drive
CONTROL_BITS, STATUS_BITS = (str(FILE.device_options[f"{way}_bits"].default) for way in ("control", "status"))
#: made up: trips of the simulated drive, as ru.00 shows them; E.buS is the manual's
TRIPS: Final = {"E.OP": 1, "E.UP": 2, "E.OC": 4, "E.OH": 8, "E.OL": 16, "E.buS": 18, "E.EF": 31}
E_BUS: Final = 18
#: made up: ru.00 without a trip
RU_OFF, RU_STANDING, RU_RAMP, RU_CONSTANT = 0, 70, 64, 66


#: in place of bits: those that are made up for the simulated drive
SIMULATED_BITS: Final = "simulated"


def bits(text: str, made_up: str, what: str) -> dict[str, int]:
    """Names of bits given as ``run=2 reverse=3``; ``simulated`` stands for ``made_up``. Raises ValueError."""
    if text.strip() == SIMULATED_BITS:
        text = made_up
    found: dict[str, int] = {}
    for word in text.replace(",", " ").split():
        name, equals, number = word.partition("=")
        if not (name.isidentifier() and equals and number.isdecimal() and int(number) <= 15):
            raise ValueError(f"{what}: {word!r} is no bit; write names with their bit 0..15, e.g. {CONTROL_BITS!r}")
        if name in found or int(number) in found.values():
            raise ValueError(f"{what}: {word!r} names a bit or a name a second time")
        found[name] = int(number)
    return found


#: counts per unit that the manual shows (oP.3: 0640h is 20 Hz); everything else goes as the integer on the wire
SCALES: Final = {0x2303: (80, "Hz")}


def record_and_enable(text: str) -> tuple[int, int] | None:
    """Two indexes in hex, of block 2's record and enable; None if there is no text. Raises ValueError."""
    words = text.split()
    if not words:
        return None
    try:
        record, enable = (int(word, 16) for word in words)
    except ValueError:
        raise ValueError(f"block 2: {text!r} is not two indexes in hex (record, enable), e.g. '5FE0 5FE1'") from None
    return record, enable
