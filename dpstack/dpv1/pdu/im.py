"""Identification and maintenance: I&M0 to I&M4 by the call function of index 255 (docs/protocol.md#im).

A call is written to index 255 of a slot: Extended_Function_Num 08, a reserved octet, FI_Index, and for a record that is
to be changed its 64 octets. The following Read of index 255 gives the same four octets and the 64 of the record. Texts
are VisibleStrings filled up with blanks: what a device is stands in ASCII; what people write has umlauts in the field
(ISO 8859-1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.dpv1.pdu.layouts import (
    IM0,
    IM1,
    IM2,
    IM3,
    IM4,
    IM_CALL,
    Im0Octets,
    Im1Octets,
    Im2Octets,
    ImCallOctets,
    ImTextOctets,
)
from dpstack.errors import PduError

#: the record of every slot that calls go through
IM_INDEX: Final = 255
IM_LEN: Final = 64
#: octets that a call gives: its head and the record
IM_ANSWER: Final = 4 + IM_LEN
_CALL: Final = 0x08
_FIRST: Final = 65000
#: FI_Index of I&M records: 65000..65199 are reserved for them
IM_FI: Final = range(_FIRST, _FIRST + 200)
_HEADER: Final = bytes(10)
#: released, revision, prototype, under test in the field, test device
_KINDS: Final = "VRPUT"


@dataclass(frozen=True, slots=True, kw_only=True)
class Im0:
    """I&M0: what the device is; read-only.

    ``software_revision``: ``V1.2.3`` (V released, R revision, P prototype, U under test, T test device; 0..255 each);
    read from a device the letter is what stands there, in hex where it is none.
    ``supported``: bit n for I&Mn, bit 0 profile specific. ``version``: of I&M itself.
    """

    manufacturer_id: int = 0
    order_id: str = ""
    serial_number: str = ""
    hardware_revision: int = 0
    software_revision: str = "V1.0.0"
    revision_counter: int = 0
    profile_id: int = 0
    profile_type: int = 0
    version: tuple[int, int] = (1, 1)
    supported: int = 0

    def build(self) -> bytes:
        """The 64 octets. Raises PduError where a value does not fit."""
        kind, functional, bug_fix, internal = _revision(self.software_revision)
        return IM0.build(
            Im0Octets(
                _HEADER,
                self.manufacturer_id,
                _visible("order_id", self.order_id, 20),
                _visible("serial_number", self.serial_number, 16),
                self.hardware_revision,
                kind,
                functional,
                bug_fix,
                internal,
                self.revision_counter,
                self.profile_id,
                self.profile_type,
                *self.version,
                self.supported,
            )
        )

    @classmethod
    def parse(cls, octets: bytes) -> Im0:
        """Read ``octets``; those after the 64 are ignored. Raises PduError where there are fewer."""
        raw = IM0.parse(octets[:IM_LEN])
        letter = raw.software_kind.decode("latin-1")
        kind = letter if letter.isprintable() else f"0x{ord(letter):02X} "
        return cls(
            manufacturer_id=raw.manufacturer_id,
            order_id=_read(raw.order_id),
            serial_number=_read(raw.serial_number),
            hardware_revision=raw.hardware_revision,
            software_revision=f"{kind}{raw.software_functional}.{raw.software_bug_fix}.{raw.software_internal}",
            revision_counter=raw.revision_counter,
            profile_id=raw.profile_id,
            profile_type=raw.profile_type,
            version=(raw.version_major, raw.version_minor),
            supported=raw.supported,
        )


@dataclass(frozen=True, slots=True)
class Im1:
    """I&M1: what the device is for in the plant (up to 32 characters), and where it is (up to 22)."""

    tag_function: str = ""
    tag_location: str = ""

    def build(self) -> bytes:
        """The 64 octets. Raises PduError where a text does not fit."""
        tags = _text("tag_function", self.tag_function, 32), _text("tag_location", self.tag_location, 22)
        return IM1.build(Im1Octets(_HEADER, *tags))

    @classmethod
    def parse(cls, octets: bytes) -> Im1:
        """Read ``octets``, as :meth:`Im0.parse`."""
        raw = IM1.parse(octets[:IM_LEN])
        return cls(_read(raw.tag_function), _read(raw.tag_location))


@dataclass(frozen=True, slots=True)
class Im2:
    """I&M2: the date of installation, up to 16 characters (``2026-01-31 12:00``)."""

    date: str = ""

    def build(self) -> bytes:
        """The 64 octets. Raises PduError where the text does not fit."""
        return IM2.build(Im2Octets(_HEADER, _text("date", self.date, 16), bytes(38)))

    @classmethod
    def parse(cls, octets: bytes) -> Im2:
        """Read ``octets``, as :meth:`Im0.parse`."""
        return cls(_read(IM2.parse(octets[:IM_LEN]).date))


@dataclass(frozen=True, slots=True)
class Im3:
    """I&M3: a description, up to 54 characters."""

    descriptor: str = ""

    def build(self) -> bytes:
        """The 64 octets. Raises PduError where the text does not fit."""
        return IM3.build(ImTextOctets(_HEADER, _text("descriptor", self.descriptor, 54)))

    @classmethod
    def parse(cls, octets: bytes) -> Im3:
        """Read ``octets``, as :meth:`Im0.parse`."""
        return cls(_read(IM3.parse(octets[:IM_LEN]).body))


@dataclass(frozen=True, slots=True)
class Im4:
    """I&M4: a signature of the parameter set, 54 octets; shorter ones are filled up with zeros."""

    signature: bytes = bytes(54)

    def __post_init__(self) -> None:
        if len(self.signature) > 54:
            raise PduError(f"I&M4: {len(self.signature)} octets of signature, 54 are possible")
        object.__setattr__(self, "signature", self.signature.ljust(54, b"\0"))

    def build(self) -> bytes:
        """The 64 octets."""
        return IM4.build(ImTextOctets(_HEADER, self.signature))

    @classmethod
    def parse(cls, octets: bytes) -> Im4:
        """Read ``octets``, as :meth:`Im0.parse`."""
        return cls(IM4.parse(octets[:IM_LEN]).body)


Im = Im0 | Im1 | Im2 | Im3 | Im4
#: by number
RECORDS: Final[tuple[type[Im0] | type[Im1] | type[Im2] | type[Im3] | type[Im4], ...]] = (Im0, Im1, Im2, Im3, Im4)


def number_of(record: Im) -> int:
    return RECORDS.index(type(record))


def build_call(number: int, record: Im | None = None) -> bytes:
    """What is written to index 255 to ask for I&M ``number``, or to change it to ``record``."""
    return IM_CALL.build(ImCallOctets(_CALL, 0, _FIRST + number, b"" if record is None else record.build()))


def parse_call(octets: bytes) -> tuple[int, bytes]:
    """(FI_Index, octets after the four of the call) of what was written to index 255 or read from it.

    Raises PduError naming the octet.
    """
    raw = IM_CALL.parse(octets)
    if raw.function != _CALL:
        raise PduError(f"I&M call: octet 1 is 0x{raw.function:02X}, a call begins with 0x{_CALL:02X}")
    if raw.fi_index not in IM_FI:
        raise PduError(f"I&M call: octets 3-4 are {raw.fi_index}, I&M has {IM_FI.start}..{IM_FI.stop - 1}")
    return raw.fi_index, raw.data


def parse_answer(octets: bytes, number: int) -> Im:
    """I&M ``number`` as it is read from index 255. Raises PduError where it is another one, or too short."""
    fi_index, data = parse_call(octets)
    if fi_index != _FIRST + number:
        raise PduError(f"I&M call: octets 3-4 are {fi_index}, I&M{number} is {_FIRST + number}")
    return RECORDS[number].parse(data)


def _text(name: str, text: str, length: int) -> bytes:
    try:
        octets = text.encode("latin-1")
    except UnicodeEncodeError:
        raise PduError(f"{name} = {text!r} has characters outside ISO 8859-1") from None
    if len(octets) > length:
        raise PduError(f"{name} = {text!r} has {len(octets)} characters, {length} are possible")
    return octets.ljust(length)


def _visible(name: str, text: str, length: int) -> bytes:
    if not (text.isascii() and text.isprintable()):
        raise PduError(f"{name} = {text!r}: a VisibleString has ASCII characters from the blank to ~")
    return _text(name, text, length)


def _read(octets: bytes) -> str:
    return octets.decode("latin-1").rstrip(" \0")


def _revision(text: str) -> tuple[bytes, int, int, int]:
    kind, numbers = text[:1], text[1:].split(".")
    if not kind or kind not in _KINDS or len(numbers) != 3 or not all(n.isdecimal() and int(n) <= 255 for n in numbers):
        raise PduError(
            f"software_revision = {text!r}: give a letter ({', '.join(_KINDS)}) and three numbers 0..255, like V1.2.3"
        )
    first, second, third = (int(n) for n in numbers)
    return kind.encode("ascii"), first, second, third
