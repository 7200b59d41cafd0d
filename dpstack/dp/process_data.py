"""Named fields in the process data of a slave, declared as short texts.

``bool@0.3`` is bit 3 of octet 0, ``i16@2`` two octets from octet 2 on as a signed number, most significant octet first
as PROFIBUS has it; ``i16le@2`` the other way round. ``bytes@4:3`` are three octets as they are. A number may have a
scale: its value is then the number in the octets (raw) * scale + offset, in a unit.
"""

from __future__ import annotations

import dataclasses
import math
import re
import struct
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from typing import Final

from dpstack.errors import ConfigError, UsageError
from dpstack.text import brief, octets_text, shortened

#: the value of a field
Value = bool | int | float | bytes

#: struct's letter of every number, by type
_NUMBERS: Final = {
    "u8": "B",
    "i8": "b",
    "u16": "H",
    "i16": "h",
    "u32": "I",
    "i32": "i",
    "u64": "Q",
    "i64": "q",
    "f32": "f",
    "f64": "d",
}
#: all types; the numbers of more than one octet also with ``le``
TYPES: Final = ("bool", *_NUMBERS, "bytes")
_LITTLE: Final = "le"
_SPEC: Final = re.compile(r"(?P<type>[^@]*)@(?P<octet>[0-9]+)(?:\.(?P<bit>[0-9]+))?(?::(?P<length>[0-9]+))?")
#: digits of an octet, a bit or a length: an image has 244 octets at most
_DIGITS: Final = 4
#: characters of a text that a message shows
_SHOWN: Final = 40
#: decimal places that a float with some places before the point can have
_MOST_PLACES: Final = 15
_NAME: Final = re.compile(r"[^\W\d][\w -]*(?<! )")
_SWITCH: Final = {"on": True, "true": True, "1": True, "off": False, "false": False, "0": False}


@dataclass(frozen=True, slots=True)
class Field:
    """One named value. ``octet`` counts from 0; ``bit`` 0..7 of a bool, else None; ``length`` in octets.

    The value of a number is the number in the octets (raw) * ``scale`` + ``offset``, in ``unit``. ``dead_band``: a
    recording on change leaves out changes up to so much, in the same unit.
    """

    name: str
    type: str
    octet: int
    length: int
    bit: int | None = None
    little: bool = False
    scale: float = 1
    offset: float = 0
    unit: str = ""
    dead_band: float = 0
    #: decimal places of a scaled whole number, None if rounding to them changes nothing
    _places: int | None = field(default=None, init=False, repr=False, compare=False)
    #: the codec of a number; None for others
    _codec: struct.Struct | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.type in _NUMBERS:
            object.__setattr__(self, "_codec", struct.Struct(("<" if self.little else ">") + _NUMBERS[self.type]))
        if self.is_scaled and not self.type.startswith("f"):
            places = max(_places(self.scale), _places(self.offset))
            object.__setattr__(self, "_places", places if places <= _MOST_PLACES else None)

    @classmethod
    def parse(cls, name: str, text: str) -> Field:
        """Read ``text`` (see above). Raises ConfigError: ``what; what to do``."""
        match = _SPEC.fullmatch(text.replace(" ", ""))
        text = shortened(text, _SHOWN)
        if match is None:
            raise ConfigError(f'{name} = "{text}" is no field; write TYPE@OCTET, for instance "bool@0.3" or "i16@2"')
        if any(len(match[key] or "") > _DIGITS for key in ("octet", "bit", "length")):
            raise ConfigError(f'{name} = "{text}": no slave has so many octets; their numbers are 0..243')
        kind, octet = match["type"].lower(), int(match["octet"])
        base = kind.removesuffix(_LITTLE)
        if base not in TYPES or (base != kind and base not in _NUMBERS):
            import difflib  # here, as it is for mistakes

            near = difflib.get_close_matches(base, TYPES, n=1, cutoff=0.5)
            todo = (
                f"did you mean {near[0]!r}?" if near else f"known types: {', '.join(TYPES)}; le for the low octet first"
            )
            raise ConfigError(f"{name}: unknown type {shortened(kind, _SHOWN)!r}; {todo}")
        if (match["bit"] is not None) != (base == "bool"):
            todo = 'write for instance "bool@0.3"' if base == "bool" else "a bit is a bool: leave the point out"
            raise ConfigError(f'{name} = "{text}": {"no bit" if base == "bool" else f"{kind} has no bit"}; {todo}')
        if (match["length"] is not None) != (base == "bytes"):
            todo = 'write for instance "bytes@4:3"' if base == "bytes" else "only bytes have one: leave it out"
            raise ConfigError(f'{name} = "{text}": {"no length" if base == "bytes" else "a length"}; {todo}')
        if base == "bool":
            bit = int(match["bit"])
            if bit > 7:
                raise ConfigError(f'{name} = "{text}": bit {bit}; an octet has bits 0..7')
            return cls(name, base, octet, 1, bit)
        length = int(match["length"]) if base == "bytes" else struct.calcsize(">" + _NUMBERS[base])
        if not length:
            raise ConfigError(f'{name} = "{text}": no octets; give a length of 1 or more')
        return cls(name, base, octet, length, None, base != kind)

    @property
    def is_number(self) -> bool:
        """Whether it may have a scale and a unit."""
        return self.type in _NUMBERS

    @property
    def is_scaled(self) -> bool:
        return self.scale != 1 or self.offset != 0

    @property
    def spec(self) -> str:
        """Type and place as in the configuration, without scale and unit."""
        tail = "" if self.bit is None else f".{self.bit}"
        tail += f":{self.length}" if self.type == "bytes" else ""
        return f"{self.type}{_LITTLE if self.little else ''}@{self.octet}{tail}"

    @property
    def mask(self) -> int:
        """The bits of the field in the whole image as one number, octet 0 lowest."""
        if self.bit is not None:
            return 1 << (8 * self.octet + self.bit)
        return ((1 << 8 * self.length) - 1) << 8 * self.octet

    def get(self, octets: bytes) -> Value:
        """The value of the field in ``octets``, which must be long enough."""
        if self._codec is not None:
            value: int | float = self._codec.unpack_from(octets, self.octet)[0]
            return value if self.scale == 1 and self.offset == 0 else self._scaled(value)
        if self.bit is not None:
            return bool(octets[self.octet] >> self.bit & 1)
        return octets[self.octet : self.octet + self.length]

    def _scaled(self, raw: float) -> float:
        value = raw * self.scale + self.offset
        # 3 * 0.1 is 0.30000000000000004: as many decimal places as scale and offset have are exact
        return value if self._places is None else round(value, self._places)

    def put(self, octets: bytes, value: object) -> bytes:
        """``octets`` with ``value`` in this field. Raises ValueError that names the possible values."""
        if self.bit is not None:
            if value not in (0, 1) or isinstance(value, float):
                raise ValueError(f"{self.name} is a bit: {value!r} is neither true nor false")
            bits = octets[self.octet] & ~(1 << self.bit) | bool(value) << self.bit
            return octets[: self.octet] + bytes((bits,)) + octets[self.octet + 1 :]
        return octets[: self.octet] + self._octets(value) + octets[self.octet + self.length :]

    def _octets(self, value: object) -> bytes:
        if self._codec is None:
            if not isinstance(value, (bytes, bytearray)) or len(value) != self.length:
                given = octets_text(len(value)) if isinstance(value, (bytes, bytearray)) else repr(value)
                raise ValueError(f"{self.name} has {octets_text(self.length)}: {given} cannot be put there")
            return bytes(value)
        if self.type.startswith("f"):
            return self._float_octets(value, self._codec)
        if self.is_scaled:
            raw = self._nearest_raw(value)
        elif isinstance(value, bool) or not isinstance(value, int):
            raise ValueError(f"{self.name} is {self.type}: {brief(value)} is not a whole number")
        else:
            raw = value
        low, high = self._raw_limits
        if not low <= raw <= high:
            raise ValueError(f"{self.name} = {value} is outside {self._range(low, high)}")
        return self._codec.pack(raw)

    @property
    def _raw_limits(self) -> tuple[int, int]:
        bits = 8 * self.length
        return (0, (1 << bits) - 1) if self.type.startswith("u") else (-1 << (bits - 1), (1 << (bits - 1)) - 1)

    def _range(self, low: int, high: int) -> str:
        if not self.is_scaled:
            return f"{low}..{high}{self.unit and ' '}{self.unit} ({self.type})"
        first, last = sorted((self._scaled(low), self._scaled(high)))
        return f"{first}..{last}{self.unit and ' '}{self.unit} ({self.type}, scale {self.scale}, offset {self.offset})"

    def _nearest_raw(self, value: object) -> int:
        """The number for the octets that comes nearest to the scaled ``value``."""
        number = self._number(value)
        if isinstance(number, float) and not math.isfinite(number):
            raise ValueError(f"{self.name} = {value!r} is outside {self._range(*self._raw_limits)}")
        # exact: what a person writes as 0.1 is a tenth
        return round((_exact(number) - _exact(self.offset)) / _exact(self.scale))

    def _number(self, value: object) -> int | float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError(f"{self.name} is {self.type}: {brief(value)} is not a number")
        return value

    def _float_octets(self, value: object, codec: struct.Struct) -> bytes:
        raw = self._number(value)
        try:
            if self.is_scaled:
                raw = (raw - self.offset) / self.scale
            if math.isfinite(raw):
                return codec.pack(raw)
        except OverflowError:
            pass
        scaled = f" with scale {self.scale} and offset {self.offset}" if self.is_scaled else ""
        raise ValueError(f"{self.name} = {brief(value)} is no number that {self.type} can hold{scaled}")

    def read(self, text: str) -> Value:
        """The value in ``text`` as a person writes it, with its unit behind it or without.

        Raises ValueError that says how to write it.
        """
        text = text.strip()
        if self.unit:
            text = text.removesuffix(f" {self.unit}").rstrip()
        try:
            if self.bit is not None:
                return _SWITCH[text.lower()]
            if self.type == "bytes":
                return bytes.fromhex(text)
            return float(text) if self.type.startswith("f") or self.is_scaled else int(text, 0)
        except (KeyError, ValueError):
            how = {"bool": "on or off", "bytes": "hex digits"}.get(self.type, "a number, for instance 12")
            raise ValueError(f"{self.name} = {shortened(text, _SHOWN)!r} is no {self.type}: write {how}") from None


@dataclass(frozen=True, slots=True)
class FieldMap(Collection[str]):
    """The fields of one image of ``length`` octets; empty if nothing is named."""

    fields: Mapping[str, Field] = field(default_factory=dict)
    length: int = 0

    def __contains__(self, name: object) -> bool:
        return name in self.fields

    def __iter__(self) -> Iterator[str]:
        return iter(self.fields)

    def __len__(self) -> int:
        return len(self.fields)

    def fitted(self, length: int, what: str) -> FieldMap:
        """The same fields for an image of another length, called ``what``. Raises ConfigError if one lies outside."""
        if length == self.length:
            return self
        for found in self.fields.values():
            _check_inside(found, found.spec, length, what)
        return FieldMap(self.fields, length)

    @property
    def units(self) -> dict[str, str]:
        """The units of the fields that have one, by name."""
        return {name: found.unit for name, found in self.fields.items() if found.unit}

    def values(self, octets: bytes) -> dict[str, Value]:
        """The values of all fields; empty if ``octets`` are too short for them."""
        if len(octets) < self.length:
            return {}
        return {name: found.get(octets) for name, found in self.fields.items()}


class NamedValues(dict[str, Value]):
    """Values of fields by name. An unknown name raises UsageError with the nearest one, instead of KeyError."""

    def __missing__(self, name: object) -> Value:
        import difflib  # here, as it is for mistakes

        near = difflib.get_close_matches(str(name), self, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}?" if near else f"there are: {', '.join(self) or 'none'}"
        raise UsageError(f"no input is called {name!r}; {hint}")


def field_of(name: str, text: str, length: int, what: str) -> Field:
    """Read and check one declaration for an image of ``length`` octets, called ``what``. Raises ConfigError."""
    if not _NAME.fullmatch(name):
        raise ConfigError(
            f"{shortened(name, _SHOWN)!r} is no name for a field; use letters, digits, _ and -, a letter first"
        )
    found = Field.parse(name, text)
    _check_inside(found, text, length, what)
    return found


def _check_inside(found: Field, text: str, length: int, what: str) -> None:
    if found.octet + found.length > length:
        has = f"its configuration has octets 0..{length - 1} of {what}" if length else f"it has no {what}"
        raise ConfigError(f'{found.name} = "{text}" ends in octet {found.octet + found.length - 1}; {has}')


def with_scale(found: Field, given: Mapping[str, float | str]) -> Field:
    """``found`` with ``scale``, ``offset``, ``unit`` and ``dead_band`` as ``given``. Raises ConfigError."""
    if given and not found.is_number:
        key = next(iter(given))
        raise ConfigError(f"{found.name}: {found.type} has no {key}; only numbers have one: leave it out")
    if not given.get("scale", 1):
        raise ConfigError(
            f"{found.name}: scale = 0 makes all values equal; give the value of one step, for instance 0.1"
        )
    changes: dict[str, object] = {
        key: int(value) if isinstance(value, float) and value.is_integer() else value for key, value in given.items()
    }
    return dataclasses.replace(found, **changes)  # type: ignore[arg-type]


def _exact(number: float) -> Fraction:
    """The decimal number that a person reads for ``number``."""
    return Fraction(repr(number))


def _places(number: float) -> int:
    """The decimal places of ``number`` as a person reads it."""
    exponent = Decimal(repr(number)).normalize().as_tuple().exponent
    return max(0, -exponent) if isinstance(exponent, int) else 0


def overlap(fields: Mapping[str, Field]) -> tuple[Field, Field] | None:
    """The first two fields that share a bit, the later one first."""
    used = 0
    for found in fields.values():
        mask = found.mask
        if used & mask:
            return found, next(other for other in fields.values() if other.mask & mask)
        used |= mask
    return None


def as_json(values: Mapping[str, Value]) -> dict[str, object]:
    """Plain JSON data: octets as hex, infinite and undefined numbers as null."""
    made: dict[str, object] = {}
    for name, value in values.items():
        if isinstance(value, bytes):
            made[name] = value.hex()
        elif isinstance(value, float) and not math.isfinite(value):
            made[name] = None
        else:
            made[name] = value
    return made
