"""Identification and maintenance: I&M0 to I&M4 by the call function of index 255 (docs/reference/protocol.md#im).

A call is written to index 255 of a slot: Extended_Function_Num 08, a reserved octet, FI_Index, and for a record that is
to be changed its 64 octets. The following Read of index 255 gives the same four octets and the 64 of the record. Texts
are VisibleStrings filled up with blanks: what a device is stands in ASCII; what people write has umlauts in the field
(ISO 8859-1).
"""

from __future__ import annotations

from typing import Any, Final, Self

from msgspec.structs import force_setattr

from dpstack.dp.pdu.layouts import OCTET, REST, WORD, Layout, LayoutField, Pdu, adapted, array, fixed, octets
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
#: released, revision, prototype, under test in the field, test device
_KINDS: Final = "VRPUT"


class _ImRecord(Pdu, frozen=True):
    """One record of I&M, 64 octets."""

    @classmethod
    def parse(cls, octets: bytes) -> Self:
        """Read ``octets``; those after the 64 are ignored. Raises PduError if there are fewer."""
        record: Self = cls.LAYOUT.parse(octets[:IM_LEN])
        return record


class Im0(_ImRecord, frozen=True, kw_only=True):
    """I&M0: what the device is; read-only.

    ``software_revision``: ``V1.2.3`` (V released, R revision, P prototype, U under test, T test device; 0..255 each);
    read from a device the letter is what stands there, in hex if it is not printable.
    """

    #: MANUFACTURER_ID, 0..65535, as PROFIBUS & PROFINET International assigns it
    manufacturer_id: int = 0
    #: order number, up to 20 characters
    order_id: str = ""
    #: serial number, up to 16 characters
    serial_number: str = ""
    #: HARDWARE_REVISION, 0..65535
    hardware_revision: int = 0
    software_revision: str = "V1.0.0"
    #: REV_COUNTER, 0..65535: counts changes of hardware or parameters
    revision_counter: int = 0
    #: PROFILE_ID, 0..65535: the profile that the device follows
    profile_id: int = 0
    #: PROFILE_SPECIFIC_TYPE, 0..65535: its kind within the profile
    profile_type: int = 0
    #: version of I&M, major and minor
    version: tuple[int, int] = (1, 1)
    #: I&M_SUPPORTED: bit n for I&Mn, bit 0 profile specific
    supported: int = 0


class Im1(_ImRecord, frozen=True):
    """I&M1: what the device is for in the plant (up to 32 characters), and if it is (up to 22)."""

    #: the purpose of the device in the plant, up to 32 characters
    tag_function: str = ""
    #: the place of the device, up to 22 characters
    tag_location: str = ""


class Im2(_ImRecord, frozen=True):
    """I&M2: the date of installation, up to 16 characters (``2026-01-31 12:00``)."""

    #: date of installation, up to 16 characters
    date: str = ""


class Im3(_ImRecord, frozen=True):
    """I&M3: a description, up to 54 characters."""

    #: description, up to 54 characters
    descriptor: str = ""


class Im4(_ImRecord, frozen=True):
    """I&M4: a signature of the parameter set, 54 octets; shorter ones are filled up with zeros."""

    #: signature of the parameter set, 54 octets
    signature: bytes = bytes(54)

    def __post_init__(self) -> None:
        if len(self.signature) > 54:
            raise PduError(f"I&M4: {len(self.signature)} octets of signature, 54 are possible")
        force_setattr(self, "signature", self.signature.ljust(54, b"\0"))


Im = Im0 | Im1 | Im2 | Im3 | Im4
#: by number
RECORDS: Final[tuple[type[Im], ...]] = (Im0, Im1, Im2, Im3, Im4)


def number_of(record: Im) -> int:
    return RECORDS.index(type(record))


def build_call(number: int, record: Im | None = None) -> bytes:
    """The octets for a Write to index 255 that asks for I&M ``number``, or changes it to ``record``."""
    return _IM_CALL.build(function=_CALL, fi_index=_FIRST + number, data=b"" if record is None else record.build())


def parse_call(octets: bytes) -> tuple[int, bytes]:
    """(FI_Index, octets after the four of the call) of what was written to index 255 or read from it.

    Raises PduError naming the octet.
    """
    call = _IM_CALL.parse(octets)
    function, fi_index = call["function"], call["fi_index"]
    if function != _CALL:
        raise PduError(f"I&M call: octet 1 is 0x{function:02X}, a call begins with 0x{_CALL:02X}")
    if fi_index not in IM_FI:
        raise PduError(f"I&M call: octets 3-4 are {fi_index}, I&M has {IM_FI.start}..{IM_FI.stop - 1}")
    return fi_index, call["data"]


#: the head of I&M in a record: Extended_Function_Num, a reserved octet, FI_Index; then the data of a record
_IM_CALL: Final[Layout[dict[str, Any]]] = Layout(
    "I&M call", dict, "function" / OCTET, "reserved" / fixed(8), "fi_index" / WORD, "data" / REST
)


def parse_answer(octets: bytes, number: int) -> Im:
    """I&M ``number`` as it is read from index 255. Raises PduError if it is another one, or too short."""
    fi_index, data = parse_call(octets)
    if fi_index != _FIRST + number:
        raise PduError(f"I&M call: octets 3-4 are {fi_index}, I&M{number} is {_FIRST + number}")
    return RECORDS[number].parse(data)


def _text(name: str, length: int, *, visible: bool = False) -> LayoutField:
    """The field ``name``: a text of up to ``length`` characters, filled up with blanks."""

    def write(text: str) -> bytes:
        if visible and not (text.isascii() and text.isprintable()):
            raise PduError(f"{name} = {text!r}: a VisibleString has ASCII characters from the blank to ~")
        try:
            encoded = text.encode("latin-1")
        except UnicodeEncodeError:
            raise PduError(f"{name} = {text!r} has characters outside ISO 8859-1") from None
        if len(encoded) > length:
            raise PduError(f"{name} = {text!r} has {len(encoded)} characters, {length} are possible")
        return encoded.ljust(length)

    return name / adapted(octets(length), lambda found: found.decode("latin-1").rstrip(" \0"), write)


def _read_revision(octets: bytes) -> str:
    letter, *numbers = octets
    kind = chr(letter) if chr(letter).isprintable() else f"0x{letter:02X} "
    return kind + ".".join(map(str, numbers))


def _revision(text: str) -> bytes:
    kind, numbers = text[:1], text[1:].split(".")
    if not kind or kind not in _KINDS or len(numbers) != 3 or not all(n.isdecimal() and int(n) <= 255 for n in numbers):
        raise PduError(
            f"software_revision = {text!r}: give a letter ({', '.join(_KINDS)}) and three numbers 0..255, like V1.2.3"
        )
    return bytes((ord(kind), *map(int, numbers)))


_HEADER: Final = "header" / fixed(80)
Im0.LAYOUT = Layout(
    "I&M0",
    Im0,
    _HEADER,
    "manufacturer_id" / WORD,
    _text("order_id", 20, visible=True),
    _text("serial_number", 16, visible=True),
    "hardware_revision" / WORD,
    "software_revision" / adapted(octets(4), _read_revision, _revision),
    "revision_counter" / WORD,
    "profile_id" / WORD,
    "profile_type" / WORD,
    "version" / adapted(array(2, OCTET), tuple, list),
    "supported" / WORD,
)
Im1.LAYOUT = Layout("I&M1", Im1, _HEADER, _text("tag_function", 32), _text("tag_location", 22))
Im2.LAYOUT = Layout("I&M2", Im2, _HEADER, _text("date", 16), "reserved" / fixed(38 * 8))
Im3.LAYOUT = Layout("I&M3", Im3, _HEADER, _text("descriptor", 54))
Im4.LAYOUT = Layout("I&M4", Im4, _HEADER, "signature" / octets(54))
