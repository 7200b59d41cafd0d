"""The data formats of values in record 47: number, octets of one value, conversion.

Sources: the formats that every drive has (1 to 8, 0x40 to 0x44), Siemens SINAMICS manual p97; the range of the others,
VACON PROFINET manual p37, OPC 30141 table 59 (numbers of PROFIdrive 4.2); times, IEC 61158-5; N2 to X4 as PROFIdrive
V3 counts them (33 to 44, TR-Electronic encoTRive manual p195) and as V4 does (113 to 124, Eaton DS7 manual p202). V4
has UNICODEString at 39, which stays the T4 of V3 here. What depends on another parameter (R2, T2, T4, D2: the
sampling time; X2, X4) stays the integer on the wire.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from typing import Final

from msgspec import Struct

from dpstack.errors import PduError
from dpstack.profile.model.params import check_float, count_of

#: a value on the wire: an integer, a float (formats 8 and 15), or octets
Raw = int | float | bytes
#: a value for people
Value = int | float | str | bytes | bool


class Format(Struct, frozen=True):
    """A format. ``code`` of struct for numbers, "" for plain octets; ``octets`` of one value.

    ``string``: all values together are one text or octet string. ``scale``: value of 1 on the wire.
    """

    number: int
    name: str
    octets: int
    code: str = ""
    scale: float = 0
    string: bool = False

    def pack(self, values: tuple[Raw, ...]) -> bytes:
        """The octets of ``values``, without the octet that pads them. Raises ValueError with the range."""
        return b"".join(self._pack_one(value) for value in values)

    def _pack_one(self, value: Raw) -> bytes:
        if not self.code:
            wanted = "octets" if self.string else f"{self.octets} octets"
            if not isinstance(value, bytes) or (not self.string and len(value) != self.octets):
                raise ValueError(f"{self.name} takes {wanted}, not {value!r}")
            return value
        if isinstance(value, bytes):
            raise ValueError(f"{self.name} takes a number, not {value!r}")
        if self.code not in "fd":
            if value != int(value) or not self.low <= value <= self.high:
                raise ValueError(f"{self.name} takes whole numbers {self.low}..{self.high}, not {value:g}")
            value = int(value)
        elif not math.isfinite(value):
            raise ValueError(f"{self.name} takes finite numbers, not {value!r}")
        try:
            return struct.pack(f">{self.code}", value)
        except (struct.error, OverflowError):
            raise ValueError(f"{value:g} is more than {self.name} can hold") from None

    def repack(self, raws: tuple[Raw, ...]) -> bytes:
        """The octets that ``raws`` were unpacked from: also floats that are not finite, which :meth:`pack` refuses."""
        return b"".join(raw if isinstance(raw, bytes) else struct.pack(f">{self.code}", raw) for raw in raws)

    @property
    def low(self) -> int:
        return -(1 << 8 * self.octets - 1) if self.code.islower() else 0

    @property
    def high(self) -> int:
        return (1 << 8 * self.octets - self.code.islower()) - 1

    def unpack(self, octets: bytes) -> tuple[Raw, ...]:
        """The values in ``octets``, as many as there are; a string is one value."""
        if self.string:
            return (octets,)
        if self.code:
            return struct.unpack(f">{len(octets) // self.octets}{self.code}", octets)
        return tuple(octets[at : at + self.octets] for at in range(0, len(octets), self.octets))

    def value(self, raw: Raw) -> Value:
        """For people: a text, a truth value, a number in its unit (N2, N4: 1.0 is 100 %), else as on the wire."""
        if self.number == VISIBLE_STRING and isinstance(raw, bytes):
            return raw.decode("latin-1").rstrip("\0 ")
        if isinstance(raw, bytes):
            return raw
        if self.number == BOOLEAN:
            return bool(raw)
        return raw * self.scale if self.scale else raw

    def raw(self, value: Value) -> Raw:
        """The inverse of :meth:`value`. Raises ValueError."""
        if isinstance(value, str):
            if self.number != VISIBLE_STRING:
                raise ValueError(f"{self.name} takes no text")
            return value.encode("latin-1", "replace")
        if isinstance(value, bytes):
            return value
        if self.code == "f":
            check_float(self.name, value)
        if not self.scale:
            return value
        return count_of(self.name, value, 1 / self.scale)


BOOLEAN, INTEGER8, INTEGER16, INTEGER32, UNSIGNED8, UNSIGNED16, UNSIGNED32, FLOAT = range(1, 9)
VISIBLE_STRING, OCTET_STRING, BIT_STRING = 9, 10, 14
#: no value: the answer to a successful change beside failed ones
ZERO: Final = 0x40
BYTE, WORD, DOUBLE_WORD, ERROR = 0x41, 0x42, 0x43, 0x44


def _formats() -> Iterator[Format]:
    yield Format(BOOLEAN, "Boolean", 1, "B")
    yield Format(INTEGER8, "Integer8", 1, "b")
    yield Format(INTEGER16, "Integer16", 2, "h")
    yield Format(INTEGER32, "Integer32", 4, "i")
    yield Format(UNSIGNED8, "Unsigned8", 1, "B")
    yield Format(UNSIGNED16, "Unsigned16", 2, "H")
    yield Format(UNSIGNED32, "Unsigned32", 4, "I")
    yield Format(FLOAT, "FloatingPoint", 4, "f")
    yield Format(VISIBLE_STRING, "VisibleString", 1, string=True)
    yield Format(OCTET_STRING, "OctetString", 1, string=True)
    yield Format(12, "TimeOfDay with date", 6)
    yield Format(13, "TimeDifference", 4, "I")
    yield Format(BIT_STRING, "BitString", 1, string=True)
    yield Format(15, "FloatingPoint64", 8, "d")
    yield Format(50, "Date", 7)
    yield Format(52, "TimeOfDay", 4, "I")
    yield Format(53, "TimeDifference with date", 6)
    yield Format(54, "TimeDifference without date", 4, "I")
    yield Format(55, "Integer64", 8, "q")
    yield Format(56, "Unsigned64", 8, "Q")
    for first in (33, 113):
        for at, (name, code, scale) in enumerate(_PROFILE):
            yield Format(first + at, name, struct.calcsize(f">{code}"), code, scale)
    yield Format(ZERO, "Zero", 0, "B")
    yield Format(BYTE, "Byte", 1, "B")
    yield Format(WORD, "Word", 2, "H")
    yield Format(DOUBLE_WORD, "DoubleWord", 4, "I")
    yield Format(ERROR, "Error", 2, "H")


#: in the order of their numbers; N2, N4: 2^14 and 2^30 are 100 %; E2: seven places behind the binary point; C4: 0.0001
_PROFILE: Final = (
    ("N2", "h", 2.0**-14),
    ("N4", "i", 2.0**-30),
    ("V2", "H", 0.0),
    ("L2", "H", 0.0),
    ("R2", "H", 0.0),
    ("T2", "H", 0.0),
    ("T4", "I", 0.0),
    ("D2", "H", 0.0),
    ("E2", "h", 2.0**-7),
    ("C4", "i", 1e-4),
    ("X2", "h", 0.0),
    ("X4", "i", 0.0),
)
#: by number
FORMATS: Final[Mapping[int, Format]] = {one.number: one for one in _formats()}


class UnknownFormatError(PduError):
    """An unknown format: the octets behind it cannot be divided into values."""


def format_of(number: int) -> Format:
    """Raises UnknownFormatError."""
    found = FORMATS.get(number)
    if found is None:
        raise UnknownFormatError(f"record 47: format {number:#04x} is none of the profile's")
    return found
