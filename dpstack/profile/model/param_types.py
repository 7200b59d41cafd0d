"""Data types of parameters: width, sign, floats, fixed-point types of PROFIdrive; numbers in record 47."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import StrEnum
from typing import Final, NamedTuple


class ParamType(StrEnum):
    """The data type of a parameter, as its manual has it.

    N2 and N4: 2^14 and 2^30 are 1.0 (100 %); E2: seven places behind the binary point; C4: 0.0001 a count.
    """

    U8 = "u8"
    I8 = "i8"
    U16 = "u16"
    I16 = "i16"
    U32 = "u32"
    I32 = "i32"
    F32 = "f32"
    N2 = "n2"
    N4 = "n4"
    E2 = "e2"
    C4 = "c4"
    #: a string: the parameter channel cannot carry it
    TEXT = "text"

    @property
    def bits(self) -> int:
        """Width in bits; 0 for a text."""
        return 8 * struct.calcsize(_KINDS[self].code)

    @property
    def wide(self) -> bool:
        """32 bits: a double word in the parameter channel."""
        return self.bits > 16

    @property
    def signed(self) -> bool:
        return _KINDS[self].code in ("b", "h", "i")

    @property
    def data_format(self) -> int:
        """Number of the data format in record 47."""
        return _KINDS[self].data_format

    @property
    def counts(self) -> float:
        """Counts on the wire that make 1; 1 for a plain integer."""
        return _KINDS[self].counts

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest integer on the wire; of a float the largest finite values."""
        if self is ParamType.F32:
            return -_LARGEST_FLOAT, _LARGEST_FLOAT
        return (-(1 << self.bits - 1), (1 << self.bits - 1) - 1) if self.signed else (0, (1 << self.bits) - 1)


class _Kind(NamedTuple):
    """``code`` of struct, ``data_format`` of record 47 (PROFIdrive V4), ``counts`` that make 1."""

    code: str
    data_format: int
    counts: float = 1


_KINDS: Final[Mapping[ParamType, _Kind]] = {
    ParamType.U8: _Kind("B", 5),
    ParamType.I8: _Kind("b", 2),
    ParamType.U16: _Kind("H", 6),
    ParamType.I16: _Kind("h", 3),
    ParamType.U32: _Kind("I", 7),
    ParamType.I32: _Kind("i", 4),
    ParamType.F32: _Kind("f", 8),
    ParamType.N2: _Kind("h", 113, 1 << 14),
    ParamType.N4: _Kind("i", 114, 1 << 30),
    ParamType.E2: _Kind("h", 121, 1 << 7),
    ParamType.C4: _Kind("i", 122, 1e4),
    ParamType.TEXT: _Kind("", 9),
}
_LARGEST_FLOAT: Final = float.fromhex("0x1.fffffep+127")
_FLOAT: Final = struct.Struct(">f")


def float_bits(value: float) -> int:
    """The 32 bits of ``value`` as a float; raises OverflowError beyond its range."""
    return int.from_bytes(_FLOAT.pack(value), "big")


def float_of(bits: int) -> float:
    """The float in 32 bits with as few digits as distinguish it from its neighbours: 0.1, not 0.10000000149."""
    octets = bits.to_bytes(4, "big")
    (exact,) = _FLOAT.unpack(octets)
    short = (float(f"{exact:.{digits}g}") for digits in range(6, 9))
    return next((one for one in short if abs(one) <= _LARGEST_FLOAT and _FLOAT.pack(one) == octets), exact)
