"""The data types of block parameters: structures DS-32 to DS-68, their octets and their elements.

Numbers are sent with the high octet first. Sources of the structures: docs/reference/decisions/pa.md.
"""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Mapping
from typing import Final, NamedTuple

from dpstack.errors import PduError, UsageError

#: value of a scalar: whole number, floating point number, text, or octets without a known structure
Scalar = int | float | str | bytes
#: value of a parameter: a scalar, or the elements of a structure by name
ParameterValue = Scalar | Mapping[str, Scalar]


_WHOLE: Final = {"u8": "B", "u16": "H", "u32": "I", "i8": "b", "i16": "h", "unit": "H"}

#: structures: elements with their scalar types. Names of the elements are ours; their order and types are the profile's
STRUCTURES: Final[Mapping[str, str]] = {
    # DS-32. Octets 4 to 9: DD reference and DD revision in profile 3.0, device revision, its compatibility and DD
    # revision since 3.02
    "block": "reserved:u8 object:u8 parent_class:u8 class:u8 device_revision:u16 compatible_revision:u16"
    " dd_revision:u16 profile:u16 profile_revision:u16 execution_time:u8 parameters:u16 view_1:u16 views:u8",
    "value": "value:f32 status:u8",  # 101 (DS-33)
    "value_d": "value:u8 status:u8",  # 102 (DS-34)
    "range": "eu_100:f32 eu_0:f32",
    "scaling": "eu_100:f32 eu_0:f32 unit:unit decimals:i8",  # DS-36
    "mode": "actual:u8 permitted:u8 normal:u8",  # DS-37
    "alarm": "unacknowledged:u8 state:u8 time:octets8 subcode:u16 value:f32",  # DS-39
    "alarm_sum": "current:octets2 unacknowledged:octets2 unreported:octets2 disabled:octets2",  # DS-42
    "simulate": "status:u8 value:f32 enabled:u8",  # DS-50
    "simulate_d": "status:u8 value:u8 enabled:u8",  # DS-51
    "batch": "batch:u32 unit:u16 operation:u16 phase:u16",  # DS-67
    "feature": "supported:octets4 enabled:octets4",  # DS-68
    "point": "x:f32 y:f32",
}


class Datatype(NamedTuple):
    """The type of a parameter. ``elements``: of a structure, else empty; ``format``: of :mod:`struct`."""

    name: str
    elements: tuple[tuple[str, str], ...]
    format: str

    @property
    def length(self) -> int:
        """Octets of a value."""
        return struct.calcsize(self.format)


def _scalar_format(name: str) -> str:
    if name in _WHOLE:
        return _WHOLE[name]
    if name == "f32":
        return "f"
    return f"{name.removeprefix('text').removeprefix('octets')}s"


@functools.cache
def datatype(name: str) -> Datatype:
    """The data type of a name, for instance ``f32``, ``unit``, ``text32``, ``octets6`` or ``scaling``."""
    layout = STRUCTURES.get(name)
    if layout is None:
        return Datatype(name, (), ">" + _scalar_format(name))
    elements = [tuple(element.split(":")) for element in layout.split()]
    pairs = tuple((element, kind) for element, kind in elements)
    return Datatype(name, pairs, ">" + "".join(_scalar_format(kind) for _, kind in pairs))


def _plain(kind: str, raw: int | float | bytes) -> Scalar:
    if isinstance(raw, bytes) and kind.startswith("text"):
        return raw.rstrip(b"\0 ").decode("latin-1")
    return raw


def parse_value(kind: str, octets: bytes) -> ParameterValue:
    """The value of ``octets`` as data type ``kind``.

    Raises :class:`~dpstack.errors.PduError` if their number is another than the type's. Texts may be shorter or longer:
    devices send them with and without padding.
    """
    wanted = datatype(kind)
    if kind.startswith("text"):
        return _plain(kind, octets)
    if len(octets) != wanted.length:
        raise PduError(f"{len(octets)} octets where data type {kind} has {wanted.length}")
    parts = struct.unpack(wanted.format, octets)
    if not wanted.elements:
        return _plain(kind, parts[0])
    return {name: _plain(of, part) for (name, of), part in zip(wanted.elements, parts, strict=True)}


def encode_value(kind: str, value: ParameterValue) -> bytes:
    """The octets of ``value`` as data type ``kind``; a structure needs each of its elements.

    Raises :class:`~dpstack.errors.UsageError` if the value does not fit the type.
    """
    wanted = datatype(kind)
    if not wanted.elements:
        return _encode_scalar(kind, value)
    if not isinstance(value, Mapping):
        raise UsageError(f"data type {kind} is a structure: {', '.join(name for name, _ in wanted.elements)}")
    missing = [name for name, _ in wanted.elements if name not in value]
    unknown = [name for name in value if name not in dict(wanted.elements)]
    if missing or unknown:
        raise UsageError(f"data type {kind} has the elements {', '.join(name for name, _ in wanted.elements)}")
    return b"".join(_encode_scalar(of, value[name]) for name, of in wanted.elements)


def _encode_scalar(kind: str, value: ParameterValue) -> bytes:
    wanted = datatype(kind)
    if kind.startswith("text"):
        return _encode_text(kind, wanted.length, value)
    if kind.startswith("octets"):
        if not isinstance(value, bytes) or len(value) != wanted.length:
            raise UsageError(f"{wanted.length} octets are wanted")
        return value
    return _encode_number(kind, wanted.format, value)


def _encode_text(kind: str, length: int, value: ParameterValue) -> bytes:
    try:
        octets = value.encode("latin-1") if isinstance(value, str) else None
    except UnicodeEncodeError:
        octets = None
    if octets is None or len(octets) > length or any(octet < 0x20 for octet in octets):
        raise UsageError(f"a text of at most {length} characters of Latin-1 is wanted")
    return octets.ljust(length)


def _encode_number(kind: str, code: str, value: ParameterValue) -> bytes:
    if kind == "f32":
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise UsageError("a finite number is wanted")
    elif isinstance(value, bool) or not isinstance(value, int):
        raise UsageError(f"a whole number is wanted ({whole_range(kind)})")
    try:
        return struct.pack(code, value)
    except (struct.error, OverflowError):
        limits = "the range of a 32 bit floating point number" if kind == "f32" else whole_range(kind)
        raise UsageError(f"{value} is outside {limits}") from None


def whole_range(kind: str) -> str:
    """The range of a whole number type in words, for instance ``0 to 255``."""
    bits = datatype(kind).length * 8
    low = -(1 << (bits - 1)) if kind.startswith("i") else 0
    return f"{low} to {low + (1 << bits) - 1}"
