"""Layouts of PDUs, declared bit by bit with construct; constants of DP-V1 that layouts and checks share.

construct knows no types, takes some 10 us and more a PDU and 10 ms to load: it is imported here only, at the first use
of a layout, and never runs on the cyclic path nor while slaves are brought up. The PDUs of the bring-up are made of
:class:`Numbers`. Each other PDU declares its :class:`Layout` beside the class that it is read into. Layouts:
docs/reference/protocol.md#slave_diag, docs/reference/protocol.md#set_prm, docs/reference/protocol.md#global_control,
docs/reference/protocol.md#set_slave_add, docs/reference/protocol.md#alarms,
docs/reference/protocol.md#functions-of-dp-v1, docs/reference/protocol.md#im.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cached_property
from typing import Any, ClassVar, Final, Generic, Self, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from dpstack.errors import PduError
from dpstack.text import octets_text

#: of DP-V1: octets of data in one record; slots count from 0
MAX_RECORD: Final = 240
MAX_SLOT: Final = 254

R = TypeVar("R")


class LayoutField(Struct, frozen=True):
    """A field of a layout, ``"name" / OCTET``. ``"group_mask" / OCTET * "group_ident"``: messages name it
    ``group_ident``."""

    #: makes it in construct
    made: Callable[[], Any]
    #: bits of it, None for all up to the end
    bits: int | None
    name: str = ""
    label: str = ""
    #: reserved, or always the same
    is_value: bool = True

    def __rtruediv__(self, name: str) -> LayoutField:
        return replace(self, name=name, label=name)

    def __mul__(self, label: str) -> LayoutField:
        return replace(self, label=label)


class Layout(Generic[R]):
    """A PDU, declared field by field. ``make`` is called with the value of each field under the name of the field:
    usually a class with the same attributes.

    Fields that :func:`fixed` and :func:`ignored` make are not values: they are reserved, or always the same.
    ``function``: the number of a DP-V1 service, which is the first octet then.
    """

    def __init__(self, name: str, make: Callable[..., R], *fields: LayoutField, function: int | None = None) -> None:
        self.name = name
        self.make = make
        self._function = function
        if function is not None:
            fields = ("function" / fixed(8, function), *fields)
        self._all = fields
        self._names = {field.name: field.label for field in fields}
        #: the names of the values
        self.fields = tuple(field.name for field in fields if field.is_value)
        #: where each field ends, in bits from the first; REST has no end
        self._ends: dict[str, int] = {}
        end = 0
        for field in fields:
            if field.bits is not None:
                end += field.bits
                self._ends[field.name] = end
        self._is_exact = len(self._ends) == len(fields)
        #: octets without REST
        self.size = end // 8

    @cached_property
    def _struct(self) -> Any:
        cs = _construct()
        return cs.Bitwise(cs.Struct(*(field.name / field.made() for field in self._all)))

    def parse(self, octets: bytes) -> R:
        """Read ``octets``. Raises PduError naming the octet: one is missing, too many, or of another function."""
        count = len(octets)
        if count < self.size:
            missing = next(name for name, end in self._ends.items() if end > 8 * count)
            where = f"octet {count + 1} ({self._names[missing]})"
            raise PduError(f"{self.name} ends after {octets_text(count)}: {where} is missing")
        if self._function not in (None, octets[0]):
            raise PduError(f"octet 1 is 0x{octets[0]:02X}, {self.name} is 0x{self._function:02X}")
        if self._is_exact and count > self.size:
            raise PduError(f"{self.name} has {octets_text(count)}, octet {self.size} is the last one")
        found = self._struct.parse(octets)
        return self.make(**{name: found[name] for name in self.fields})

    def build(self, source: object = None, **values: object) -> bytes:
        """The octets: each field from ``values``, else the attribute of ``source`` that has its name. Raises PduError
        naming the field that does not fit."""
        given = {name: values[name] if name in values else getattr(source, name) for name in self.fields}
        try:
            return bytes(self._struct.build(given))
        except _construct().ConstructError as error:
            field = str(error.path).rpartition(" -> ")[2]  # "(building) -> ident"
            what = f"{self._names[field]} = {given.get(field)}"
            raise PduError(f"{self.name}: {what} does not fit its octets") from None


class Pdu(Struct, frozen=True):
    """Base class of the PDUs that :attr:`LAYOUT` describes completely."""

    #: the fields in the order of their octets, with their formats
    LAYOUT: ClassVar[Layout[Any]]

    def build(self) -> bytes:
        """The octets. Raises PduError if a value does not fit."""
        return self.LAYOUT.build(self)

    @classmethod
    def parse(cls, octets: bytes) -> Self:
        """Read ``octets``; reserved bits and octets may be anything. Raises PduError naming the octet."""
        pdu: Self = cls.LAYOUT.parse(octets)
        return pdu


def bits(count: int) -> LayoutField:
    """A number of ``count`` bits."""
    return LayoutField(lambda: _construct().BitsInteger(count), count)


def load() -> None:
    """Load construct now, if the first use of a layout would come at a time in which there are 10 ms for nothing."""
    _construct()


def _construct() -> Any:
    import construct  # here, as most buses use no layout

    return construct


#: the kinds of fields: ``"name" / OCTET``
OCTET: Final = bits(8)
WORD: Final = bits(16)
DOUBLE_WORD: Final = bits(32)
REST: Final = LayoutField(lambda: _construct().Bytewise(_construct().GreedyBytes), None)
_FLAG: Final = LayoutField(lambda: _construct().Flag, 1)


def flags(names: str) -> tuple[LayoutField, ...]:
    """Fields of one bit each, the most significant first."""
    return tuple(name / _FLAG for name in names.split())


def octets(count: int) -> LayoutField:
    """``count`` octets as bytes."""
    return LayoutField(lambda: _construct().Bytewise(_construct().Bytes(count)), 8 * count)


def array(count: int, field: LayoutField) -> LayoutField:
    """``count`` times ``field``, as a list."""
    assert field.bits is not None
    return LayoutField(lambda: _construct().Array(count, field.made()), count * field.bits)


def fixed(count: int, value: int = 0) -> LayoutField:
    """``count`` bits that are always ``value`` when sent, and may be anything when received."""
    return _default(bits(count), value)


def ignored() -> LayoutField:
    """The octets up to the end: none when sent, anything when received."""
    return _default(REST, b"")


def _default(field: LayoutField, value: object) -> LayoutField:
    return LayoutField(lambda: _construct().Default(field.made(), value), field.bits, is_value=False)


def adapted(field: LayoutField, read: Callable[[Any], object], write: Callable[[Any], object]) -> LayoutField:
    """``field`` with another value: ``read`` makes it of that on the wire, ``write`` the other way; both may raise
    PduError."""

    def made() -> Any:
        return _construct().ExprAdapter(field.made(), lambda value, _: read(value), lambda value, _: write(value))

    return LayoutField(made, field.bits)


class Numbers:
    """The first octets of a PDU of the bring-up: unsigned numbers of one or two octets, the greater octet first.

    ``sizes``: the octets of each number, under the name that messages give it. It does what a :class:`Layout` of them
    does, without construct, which takes longer to load than such a bus to come up.
    """

    def __init__(self, name: str, **sizes: int) -> None:
        self.name = name
        self._sizes = sizes
        self._struct = struct.Struct(">" + "".join({1: "B", 2: "H"}[size] for size in sizes.values()))
        self.size = self._struct.size
        #: the name of each octet
        self._octets = [number for number, size in sizes.items() for _ in range(size)]

    def parse(self, octets: bytes) -> tuple[int, ...]:
        """Read the first octets of ``octets``. Raises PduError naming the first one that is missing."""
        count = len(octets)
        if count < self.size:
            where = f"octet {count + 1} ({self._octets[count]})"
            raise PduError(f"{self.name} ends after {octets_text(count)}: {where} is missing")
        return self._struct.unpack_from(octets)

    def build(self, *numbers: int) -> bytes:
        """The octets. Raises PduError naming the number that does not fit."""
        try:
            return self._struct.pack(*numbers)
        except struct.error:
            for (name, size), number in zip(self._sizes.items(), numbers, strict=True):
                if not 0 <= number < 1 << 8 * size:
                    raise PduError(f"{self.name}: {name} = {number} does not fit its octets") from None
            raise
