"""Named fields in the process data of a slave, declared as short texts.

``bool@0.3`` is bit 3 of octet 0, ``i16@2`` two octets from octet 2 on as a signed number, most significant octet first
as PROFIBUS has it; ``i16le@2`` the other way round, ``f32ws@4`` with its two words swapped (CDAB). ``u31@0`` are the
lower 31 bits of four octets, ``u4@2.4`` the upper four of one. ``bytes@4:3`` are three octets as they are. A number may
have a scale: its value is then the number in the octets (raw) * scale + offset, in a unit.

``slot 3 channel 0 i16`` and ``slot 3 bool@0.7`` count from the first octet of a slot.
"""

from __future__ import annotations

import dataclasses
import math
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from dpstack.dp.process_image import Value
from dpstack.dp.slot_map import Direction, SlotMap
from dpstack.errors import ConfigError
from dpstack.text import brief, octets_text, shortened

if TYPE_CHECKING:
    from fractions import Fraction

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
#: all types; the numbers of more than one octet also with ``le``, those of four with ``ws``
TYPES: Final = ("bool", *_NUMBERS, "bytes")
_LITTLE: Final = "le"
#: two words swapped, each with the most significant octet first: CDAB
_SWAPPED: Final = "ws"
#: numbers of other widths: u31, i12 ...
_WIDE: Final = re.compile(r"[ui]([1-9][0-9]?)")
_MOST_BITS: Final = 64
_SPEC: Final = re.compile(r"(?P<type>[^@]*)@(?P<octet>[0-9]+)(?:\.(?P<bit>[0-9]+))?(?::(?P<length>[0-9]+))?")
_BY_SLOT: Final = re.compile(
    r"\s*slot\s+(?P<slot>[0-9]{1,3})(?:\s+channel\s+(?P<channel>[0-9]{1,4}))?\s+(?P<rest>\S.*)", re.IGNORECASE
)
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
    """One named value. ``octet`` counts from 0; ``length`` in octets; ``bit`` 0..7 of a bool, else None.

    ``bits``: of a number of another width than its ``type``, which lie from the bit ``bit`` of its octets on; else
    None. ``slot``, ``channel``: as the declaration gives them, else None.

    The value of a number is the number in the octets (raw) * ``scale`` + ``offset``, in ``unit``. ``dead_band``: a
    recording on change leaves out changes up to so much, in the same unit.
    """

    name: str
    type: str
    octet: int
    length: int
    bit: int | None = None
    little: bool = False
    swapped: bool = False
    bits: int | None = None
    slot: int | None = None
    channel: int | None = None
    scale: float = 1
    offset: float = 0
    unit: str = ""
    dead_band: float = 0
    #: the octet of its status in the same image, and the name of the coding; None without one
    status: int | None = None
    coding: str = ""
    #: the meaning of its numbers; empty: they mean themselves
    words: Mapping[int, str] = field(default_factory=dict, hash=False, repr=False)
    #: the declaration, if it names the slot; the address of a value that an S7-200 has
    written: str = field(default="", repr=False, compare=False)
    #: decimal places of a scaled whole number, None if rounding to them changes nothing
    _places: int | None = field(default=None, init=False, repr=False, compare=False)
    #: the codec of a number; None for others
    _codec: struct.Struct | None = field(default=None, init=False, repr=False, compare=False)
    #: smallest and largest raw number
    _raw_limits: tuple[int, int] = field(default=(0, 0), init=False, repr=False, compare=False)
    #: the bits of the field in the whole image as one number, octet 0 lowest
    mask: int = field(default=0, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "mask", self._bits_in_image())
        bits = self.bits or 8 * self.length
        limits = (0, (1 << bits) - 1) if self.type.startswith("u") else (-1 << (bits - 1), (1 << (bits - 1)) - 1)
        object.__setattr__(self, "_raw_limits", limits)
        if self.type in _NUMBERS and self.bits is None and not self.swapped:
            object.__setattr__(self, "_codec", struct.Struct(("<" if self.little else ">") + _NUMBERS[self.type]))
        if self.is_scaled:
            _exact(self.scale)  # loads what it needs now, not beside a running bus
        if self.is_scaled and not self.type.startswith("f"):
            places = max(_places(self.scale), _places(self.offset))
            object.__setattr__(self, "_places", places if places <= _MOST_PLACES else None)

    @classmethod
    def parse(cls, name: str, text: str) -> Field:
        """Read ``text`` (see above) without a slot. Raises ConfigError: ``what; what to do``."""
        match = _SPEC.fullmatch(text.replace(" ", ""))
        text = shortened(text, _SHOWN)
        if match is None:
            raise ConfigError(f'{name} = "{text}" is no field; write TYPE@OCTET, for instance "bool@0.3" or "i16@2"')
        if any(len(match[key] or "") > _DIGITS for key in ("octet", "bit", "length")):
            raise ConfigError(f'{name} = "{text}": no slave has so many octets; their numbers are 0..243')
        kind, octet = match["type"].lower(), int(match["octet"])
        found = _type_of(name, kind)
        has_bit = match["bit"] is not None
        if has_bit != (found.type == "bool") and found.bits is None:
            todo = 'write for instance "bool@0.3"' if found.type == "bool" else "a bit is a bool: leave the point out"
            raise ConfigError(
                f'{name} = "{text}": {"no bit" if found.type == "bool" else f"{kind} has no bit"}; {todo}'
            )
        if (match["length"] is not None) != (found.type == "bytes"):
            todo = 'write for instance "bytes@4:3"' if found.type == "bytes" else "only bytes have one: leave it out"
            what = "no length" if found.type == "bytes" else "a length"
            raise ConfigError(f'{name} = "{text}": {what}; {todo}')
        if has_bit and int(match["bit"]) > 7:
            raise ConfigError(f'{name} = "{text}": bit {match["bit"]}; an octet has bits 0..7')
        length = int(match["length"]) if found.type == "bytes" else found.length
        if not length:
            raise ConfigError(f'{name} = "{text}": no octets; give a length of 1 or more')
        if found.bits is not None:
            bit = int(match["bit"] or 0)
            length = -(-(found.bits + bit) // 8)
            return dataclasses.replace(found, octet=octet, length=length, bit=bit or None)
        return dataclasses.replace(found, octet=octet, length=length, bit=int(match["bit"]) if has_bit else None)

    @property
    def is_number(self) -> bool:
        """Whether it may have a scale and a unit."""
        return self.type in _NUMBERS

    @property
    def is_scaled(self) -> bool:
        return self.scale != 1 or self.offset != 0

    @property
    def spec(self) -> str:
        """Type and place in the octets as in the configuration, without scale and unit; of a value that an S7-200 has
        its address."""
        if self.written and self.slot is None:
            return self.written
        tail = "" if self.bit is None else f".{self.bit}"
        tail += f":{self.length}" if self.type == "bytes" else ""
        return f"{self.type_text}@{self.octet}{tail}"

    def as_dict(self, slot: int | None = None) -> dict[str, object]:
        """The field as the live stream describes it. ``slot``: the number of the slot that has its first octet."""
        words = {"words": {str(number): text for number, text in self.words.items()}} if self.words else {}
        return {
            "name": self.name,
            "type": self.type,
            "at": self.spec,
            "slot": slot,
            "channel": self.channel,
            "scale": self.scale,
            "offset": self.offset,
            "unit": self.unit,
            "dead_band": self.dead_band,
            **words,
        }

    @property
    def type_text(self) -> str:
        """The type as in the configuration: with its width, and the order of its octets."""
        base = self.type if self.bits is None else f"{self.type[0]}{self.bits}"
        return base + (_LITTLE if self.little else "") + (_SWAPPED if self.swapped else "")

    @property
    def speaks_for_itself(self) -> bool:
        """Whether its octets may say more than the value: a float that is no number, a status octet, or words."""
        return self.status is not None or bool(self.words) or self.type.startswith("f")

    @property
    def is_bool(self) -> bool:
        return self.type == "bool"

    @property
    def width(self) -> int:
        """Bits of the value."""
        if self.is_bool:
            return 1
        return 8 * self.length if self.bits is None else self.bits

    def _bits_in_image(self) -> int:
        if self.is_bool:
            return 1 << (8 * self.octet + (self.bit or 0))
        own = self._own_bits.to_bytes(self.length, "little" if self.little else "big")
        return int.from_bytes(own, "little") << 8 * self.octet

    @property
    def _own_bits(self) -> int:
        """The bits of the value in the number that its octets are."""
        return ((1 << self.width) - 1) << (self.bit or 0)

    def get(self, octets: bytes) -> Value:
        """The value of the field in ``octets``, which must be long enough."""
        if self._codec is not None:
            value: int | float = self._codec.unpack_from(octets, self.octet)[0]
        elif self.is_bool:
            return bool(octets[self.octet] >> (self.bit or 0) & 1)
        elif self.type == "bytes":
            return octets[self.octet : self.octet + self.length]
        else:
            value = self._unusual(octets)
        return value if self.scale == 1 and self.offset == 0 else self._scaled(value)

    def _unusual(self, octets: bytes) -> int | float:
        """The raw number of a field with swapped words or of an unusual width."""
        own = octets[self.octet : self.octet + self.length]
        if self.swapped:
            found: int | float = struct.unpack(">" + _NUMBERS[self.type], own[2:] + own[:2])[0]
            return found
        number = int.from_bytes(own, "little" if self.little else "big") >> (self.bit or 0)
        number &= (1 << self.width) - 1
        return number - (1 << self.width) if self.type[0] == "i" and number >> (self.width - 1) else number

    def _scaled(self, raw: float) -> float:
        value = raw * self.scale + self.offset
        # 3 * 0.1 is 0.30000000000000004: as many decimal places as scale and offset have are exact
        return value if self._places is None else round(value, self._places)

    def number_of(self, value: object) -> object:
        """The number that a word of the field stands for; any other ``value`` as it is. Raises ValueError naming the
        words."""
        if not self.words or not isinstance(value, str):
            return value
        wanted = value.strip().lower()
        for number, word in self.words.items():
            if word.lower() == wanted:
                return number
        known = ", ".join(f"{word} ({number})" for number, word in self.words.items())
        raise ValueError(f"{self.name} is never {shortened(value, _SHOWN)!r}: it is {known}")

    def put(self, octets: bytes, value: object) -> bytes:
        """``octets`` with ``value`` in this field. Raises ValueError that names the possible values."""
        value = self.number_of(value)
        if self.type == "bool":
            if value not in (0, 1) or isinstance(value, float):
                raise ValueError(f"{self.name} is a bit: {value!r} is neither true nor false")
            own: bytes | int = bool(value) << (self.bit or 0)
        else:
            own = self._octets(value)
        if isinstance(own, int):  # only its own bits change
            order: Final = "little" if self.little else "big"
            before = int.from_bytes(octets[self.octet : self.octet + self.length], order)
            own = (before & ~self._own_bits | own).to_bytes(self.length, order)
        return octets[: self.octet] + own + octets[self.octet + self.length :]

    def _octets(self, value: object) -> bytes | int:
        """The octets of ``value``; of a field of an unusual width its bits."""
        if self.type == "bytes":
            if not isinstance(value, (bytes, bytearray)) or len(value) != self.length:
                given = octets_text(len(value)) if isinstance(value, (bytes, bytearray)) else repr(value)
                raise ValueError(f"{self.name} has {octets_text(self.length)}: {given} cannot be put there")
            return bytes(value)
        if self.type.startswith("f"):
            return self._float_octets(value)
        if self.is_scaled:
            raw = self._nearest_raw(value)
        elif isinstance(value, bool) or not isinstance(value, int):
            raise ValueError(f"{self.name} is {self.type_text}: {brief(value)} is not a whole number")
        else:
            raw = value
        low, high = self._raw_limits
        if not low <= raw <= high:
            raise ValueError(f"{self.name} = {value} is outside {self._range(low, high)}")
        if self.bits is not None:
            return (raw & ((1 << self.bits) - 1)) << (self.bit or 0)
        return self._codec.pack(raw) if self._codec is not None else self._packed(raw)

    def _packed(self, raw: float) -> bytes:
        if self._codec is not None:
            return self._codec.pack(raw)
        octets = struct.pack(">" + _NUMBERS[self.type], raw)
        return octets[2:] + octets[:2]

    def _range(self, low: int, high: int) -> str:
        if not self.is_scaled:
            return f"{low}..{high}{self.unit and ' '}{self.unit} ({self.type_text})"
        first, last = sorted((self._scaled(low), self._scaled(high)))
        scale = f"scale {self.scale}, offset {self.offset}"
        return f"{first}..{last}{self.unit and ' '}{self.unit} ({self.type_text}, {scale})"

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

    def _float_octets(self, value: object) -> bytes:
        raw = self._number(value)
        try:
            if self.is_scaled:
                raw = (raw - self.offset) / self.scale
            if math.isfinite(raw):
                return self._packed(raw)
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
        if self.words and not text[:1].isdigit():
            number = self.number_of(text)
            assert isinstance(number, int)
            return number
        try:
            if self.is_bool:
                return _SWITCH[text.lower()]
            if self.type == "bytes":
                return bytes.fromhex(text)
            return float(text) if self.type.startswith("f") or self.is_scaled else int(text, 0)
        except (KeyError, ValueError):
            how = {"bool": "on or off", "bytes": "hex digits"}.get(self.type, "a number, for instance 12")
            raise ValueError(f"{self.name} = {shortened(text, _SHOWN)!r} is no {self.type}: write {how}") from None


def field_of(name: str, text: str, length: int, what: str, slots: SlotMap | None = None) -> Field:
    """Read and check one declaration for an image of ``length`` octets, called ``what`` ("inputs", "outputs").

    ``slots``: for declarations by slot; None: they are refused. Raises ConfigError.
    """
    if not _NAME.fullmatch(name):
        raise ConfigError(
            f"{shortened(name, _SHOWN)!r} is no name for a field; use letters, digits, _ and -, a letter first"
        )
    by_slot = _BY_SLOT.fullmatch(text)
    if by_slot is not None and slots is not None:
        return _in_slot(name, text, by_slot, what, slots)
    found = Field.parse(name, text)
    check_inside(found, text, length, what)
    return found


def _type_of(name: str, kind: str) -> Field:
    """A field of the type ``kind`` without a place. Raises ConfigError."""
    base, little, swapped = kind, False, False
    if kind.endswith(_LITTLE):
        base, little = kind.removesuffix(_LITTLE), True
    elif kind.endswith(_SWAPPED):
        base, swapped = kind.removesuffix(_SWAPPED), True
    wide = _WIDE.fullmatch(base)
    if base in _NUMBERS:
        length = struct.calcsize(">" + _NUMBERS[base])
        if not swapped or length == 4:
            return Field(name, base, 0, length, None, little, swapped)
    elif wide is not None and int(wide[1]) <= _MOST_BITS and not swapped:
        bits = int(wide[1])
        size = next(size for size in (8, 16, 32, 64) if bits <= size)
        return Field(name, f"{base[0]}{size}", 0, -(-bits // 8), None, little, bits=bits)
    elif base in TYPES and base == kind:
        return Field(name, base, 0, 1)
    import difflib  # here, as it is for mistakes

    near = difflib.get_close_matches(base, TYPES, n=1, cutoff=0.5)
    known = f"known types: {', '.join(TYPES)}; le for the low octet first, ws for swapped words of 32 bits, u1 to u64"
    raise ConfigError(
        f"{name}: unknown type {shortened(kind, _SHOWN)!r}; {f'did you mean {near[0]!r}?' if near else known}"
    )


def _in_slot(name: str, text: str, match: re.Match[str], what: str, slots: SlotMap) -> Field:
    """The field of a declaration by slot. Raises ConfigError."""
    number, rest = int(match["slot"]), match["rest"]
    head = f'{name} = "{shortened(text, _SHOWN)}"'
    slot = slots.slot(number)
    if slot is None:
        raise ConfigError(f"{head}: there is no slot {number}; the configuration has {slots.range_text}")
    area = slot.area(Direction(what.removesuffix("s")))
    if not area.octets:
        raise ConfigError(f"{head}: {slot.title} has no {what}; its places: {slot.text}")
    if match["channel"] is None:
        found = Field.parse(name, rest)
        if found.octet + found.length > area.octets:
            raise ConfigError(
                f"{head} ends in octet {found.octet + found.length - 1}; {slot.title} has octets "
                f"0..{area.octets - 1} of {what}"
            )
        return dataclasses.replace(found, octet=found.octet + area.at, slot=number, written=text)
    if "@" in rest:
        raise ConfigError(f'{head}: a channel has no octet; write "slot {number} channel {match["channel"]} i16"')
    channel, found = int(match["channel"]), _type_of(name, rest.strip().lower())
    if found.type == "bytes":
        raise ConfigError(f'{head}: bytes are no channel; write "slot {number} bytes@0:{area.octets}"')
    # a number takes a whole channel of the module at least
    step = found.width if found.is_bool else max(found.width, area.width)
    first = channel * step
    if first + found.width > 8 * area.octets:
        there = 8 * area.octets // step
        raise ConfigError(
            f"{head}: {slot.title} has {there} channels of {found.type_text} of its {what}, the first is 0"
        )
    octet, bit = divmod(first, 8)
    if found.is_bool or found.bits is not None:
        length = -(-(found.width + bit) // 8)
        found = dataclasses.replace(found, length=length, bit=bit if found.is_bool else bit or None)
    return dataclasses.replace(found, octet=area.at + octet, slot=number, channel=channel, written=text)


def moved(found: Field, what: str, slots: SlotMap | None) -> Field:
    """``found`` in the octets that its slot has now. Raises ConfigError if it does not fit there."""
    if slots is None or found.slot is None:
        return found
    now = field_of(found.name, found.written, 0, what, slots)
    status = None if found.status is None else found.status + now.octet - found.octet
    return dataclasses.replace(found, octet=now.octet, length=now.length, bit=now.bit, status=status)


def check_inside(found: Field, text: str, length: int, what: str) -> None:
    if found.octet + found.length > length:
        has = f"its configuration has octets 0..{length - 1} of {what}" if length else f"it has no {what}"
        raise ConfigError(f'{found.name} = "{text}" ends in octet {found.octet + found.length - 1}; {has}')


def with_status(found: Field, status: Field, coding: str) -> Field:
    """``found`` with the octet ``status`` beside it. Raises ConfigError if that is no whole octet."""
    if status.type != "u8" or status.width != 8:
        raise ConfigError(f'{found.name}: status {status.spec} is no octet; write for instance status = "u8@4"')
    return dataclasses.replace(found, status=status.octet, coding=coding)


def with_words(found: Field, words: Mapping[int, str]) -> Field:
    """``found`` with the meaning of its numbers. Raises ConfigError if it is no whole number without a scale."""
    if not found.is_number or found.type.startswith("f") or found.is_scaled:
        raise ConfigError(
            f"{found.name}: words are for whole numbers without a scale; leave words out, or take an octet (u8, VB10) "
            "without scale"
        )
    return dataclasses.replace(found, words=words)


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
    from fractions import Fraction  # here, as few slaves have a field with a scale

    return Fraction(repr(number))


def _places(number: float) -> int:
    """The decimal places of ``number`` as a person reads it."""
    from decimal import Decimal

    exponent = Decimal(repr(number)).normalize().as_tuple().exponent
    return max(0, -exponent) if isinstance(exponent, int) else 0


def overlap(fields: Mapping[str, Field]) -> tuple[Field, Field] | None:
    """The first two fields that share bits, the later one first. A number may share some of its bits with fields of
    bits (``bool``, ``u4``)."""
    used = 0
    before: list[Field] = []
    for found in fields.values():
        if used & found.mask:
            for other in before:
                if other.mask & found.mask and not _is_word_with_bits(other, found):
                    return found, other
        before.append(found)
        used |= found.mask
    return None


def _is_word_with_bits(one: Field, other: Field) -> bool:
    word, part = (one, other) if one.width > other.width else (other, one)
    is_part = part.is_bool or part.bits is not None
    return word.is_number and is_part and word.width > part.width and part.mask & ~word.mask == 0
