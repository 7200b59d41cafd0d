"""Addresses as STEP 7-Micro/WIN writes them: ``VW100``, ``M0.3``, ``AIW4``, ``T37``; with a type: ``VD8:real``.

Area codes and sizes: docs/reference/decisions/ppi.md.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping
from typing import Final, NamedTuple

from msgspec import Struct

from dpstack.errors import PduError, UsageError
from dpstack.text import brief

#: value of an address: a bit, a number, or octets of ``VB0[16]``
PpiValue = bool | int | float | bytes

BIT, BYTE, WORD = 1, 2, 4


class Area(NamedTuple):
    """A memory area of the CPU. ``block``: number of the data block; ``writable``: by a master."""

    name: str
    code: int
    block: int = 0
    writable: bool = True


AREAS: Final[Mapping[str, Area]] = {
    area.name: area
    for area in (
        Area("V", 0x84, block=1),
        Area("M", 0x83),
        Area("I", 0x81),
        Area("Q", 0x82),
        Area("SM", 0x05),
        Area("S", 0x04),
        Area("AI", 0x06, writable=False),
        Area("AQ", 0x07),
        Area("T", 0x1F),
        Area("C", 0x1E),
    )
}
#: types of a value: :mod:`struct` code; the first of a size is the usual one
_TYPES: Final[Mapping[str, Mapping[str, str]]] = {
    "B": {"byte": "B", "sint": "b"},
    "W": {"word": "H", "int": "h"},
    "D": {"dword": "I", "dint": "i", "real": "f"},
}
#: analogue values are signed
_ANALOGUE_TYPES: Final = {"int": "h", "word": "H"}
#: octets of one element of timers and counters: a status octet, then the value
ELEMENT_LENGTH: Final = {"T": 5, "C": 3}
_GRAMMAR: Final = re.compile(
    r"(?P<area>SM|AI|AQ|[VMIQS])(?:(?P<size>[BWD])(?P<at>\d{1,5})(?:\[(?P<count>\d{1,3})\])?(?::(?P<type>[a-z]+))?"
    r"|(?P<byte>\d{1,5})\.(?P<bit>[0-7]))|(?P<element>[TC])(?P<number>\d{1,3})"
)
#: most octets of one read or write; the CPU's PDU has 240
MOST_OCTETS: Final = 200
#: highest address of an octet: 21 bits of bit address
_MOST_AT: Final = 0x1FFFF
_EXAMPLES: Final = "V10.3, VB100, VW100, VW100:int, VD8:real, VB0[16], M0.1, I0.0, Q1.7, SMB28, AIW4, AQW2, T37, C5"


class PpiAddress(Struct, frozen=True):
    """An address in the memory of a CPU."""

    #: as written, in capitals
    text: str
    #: memory area of the CPU
    area: Area
    #: transport size of an item: bit, byte or word; the area's code for timers and counters
    size: int
    #: octets, bits or elements
    count: int
    #: start in bits; number of the element for timers and counters
    start: int
    #: of :mod:`struct`; empty: bit, octets
    code: str

    @property
    def length(self) -> int:
        """Octets of the value in an answer."""
        return self.count * ELEMENT_LENGTH.get(self.area.name, 2 if self.size == WORD else 1)

    @property
    def item(self) -> bytes:
        """The 12 octets of the address in a request."""
        head = struct.pack(">BBBBHHB", 0x12, 0x0A, 0x10, self.size, self.count, self.area.block, self.area.code)
        return head + self.start.to_bytes(3, "big")

    def value(self, octets: bytes) -> PpiValue:
        """The value of the octets of an answer. Raises :class:`~dpstack.errors.PduError` for another number."""
        if len(octets) != self.length:
            raise PduError(f"{self.text}: {len(octets)} octets, not {self.length}")
        if self.size == BIT:
            return bool(octets[0] & 1)
        if self.area.name in ELEMENT_LENGTH:
            return int.from_bytes(octets[1:], "big")
        if not self.code:
            return octets
        (value,) = struct.unpack(f">{self.code}", octets)
        assert isinstance(value, int | float)
        return value

    def octets(self, value: PpiValue) -> bytes:
        """The octets of ``value`` in a write. Raises :class:`~dpstack.errors.UsageError` if it does not fit."""
        if self.size == BIT:
            if not isinstance(value, bool) and value not in (0, 1):
                raise self._wrong("True or False")
            return bytes([bool(value)])
        if self.area.name in ELEMENT_LENGTH:
            raise UsageError(f"{self.text}: timers and counters are written by the program of the CPU only")
        if not self.code:
            if not isinstance(value, bytes) or len(value) != self.count:
                raise self._wrong(f"{self.count} octets")
            return value
        return self._number(value)

    def packed(self, value: bool | int | float) -> bytes:
        """The octets of a bit or number that was read, also of one that cannot be written (NaN)."""
        return bytes([bool(value)]) if self.size == BIT else struct.pack(f">{self.code}", value)

    def _number(self, value: PpiValue) -> bytes:
        whole = self.code != "f"
        if isinstance(value, bool | bytes) or (whole and not isinstance(value, int)) or not math.isfinite(value):
            raise self._wrong("a whole number" if whole else "a number")
        try:
            return struct.pack(f">{self.code}", value)
        except (struct.error, OverflowError):
            raise self._wrong(_range(self.code)) from None

    def _wrong(self, wanted: str) -> UsageError:
        return UsageError(f"{self.text}: {wanted} is wanted")


def _range(code: str) -> str:
    if code == "f":
        return "a number within the range of 32 bit floating point"
    bits = struct.calcsize(f">{code}") * 8
    low = -(1 << (bits - 1)) if code.islower() else 0
    return f"a whole number {low} to {low + (1 << bits) - 1}"


def parse_address(text: str) -> PpiAddress:
    """The address that ``text`` names, for instance ``VW100``, ``M0.3``, ``VD8:real``, ``VB0[16]`` or ``T37``.

    Raises :class:`~dpstack.errors.UsageError` with examples for anything else.
    """
    wanted, _, kind = text.strip().partition(":")
    found = _GRAMMAR.fullmatch(wanted.upper() + (f":{kind.lower()}" if kind else ""))
    if found is None:
        raise UsageError(f"{brief(text)} is no address of an S7-200; for instance {_EXAMPLES}")
    if found["element"]:
        area = AREAS[found["element"]]
        return PpiAddress(found[0], area, area.code, 1, int(found["number"]), "")
    if found["bit"]:
        return _bit(found[0], AREAS[found["area"]], int(found["byte"]), int(found["bit"]))
    return _numbers(found)


def _bit(text: str, area: Area, at: int, bit: int) -> PpiAddress:
    if area.name in ("AI", "AQ"):
        raise UsageError(f"{text}: analogue values have no bits; write {area.name}W{at & ~1}")
    return PpiAddress(text, area, BIT, 1, _start(text, at) + bit, "")


def _numbers(found: re.Match[str]) -> PpiAddress:
    text, area, size, at = found[0], AREAS[found["area"]], found["size"], int(found["at"])
    analogue = area.name in ("AI", "AQ")
    if analogue and (size != "W" or at % 2):
        raise UsageError(f"{text}: analogue values are words at even addresses, for instance {area.name}W{at & ~1}")
    types = _ANALOGUE_TYPES if analogue else _TYPES[size]
    kind = found["type"] or next(iter(types))
    if kind not in types:
        raise UsageError(f"{text}: no type {kind!r} here; {' or '.join(types)}")
    if found["count"] is not None:
        return _several(text, area, size, at, int(found["count"]), found["type"])
    if analogue:
        return PpiAddress(text, area, WORD, 1, _start(text, at), types[kind])
    return PpiAddress(text, area, BYTE, {"B": 1, "W": 2, "D": 4}[size], _start(text, at), types[kind])


def _several(text: str, area: Area, size: str, at: int, count: int, kind: str | None) -> PpiAddress:
    if size != "B" or kind is not None:
        raise UsageError(f"{text}: octets only, for instance {area.name}B{at}[{count}]")
    if not 1 <= count <= MOST_OCTETS:
        raise UsageError(f"{text}: 1 to {MOST_OCTETS} octets")
    return PpiAddress(text, area, BYTE, count, _start(text, at), "")


def _start(text: str, at: int) -> int:
    if at > _MOST_AT:
        raise UsageError(f"{text}: the highest address is {_MOST_AT}")
    return at * 8
