"""Layouts of PDUs, declared bit by bit with construct; constants of DP-V1 that layouts and checks share.

construct knows no types and takes some 10 us and more a PDU: it is imported here only, and never runs on the cyclic
path. Each PDU declares its :class:`Layout` beside the class that it is read into. Layouts:
docs/reference/protocol.md#slave_diag, docs/reference/protocol.md#set_prm, docs/reference/protocol.md#global_control,
docs/reference/protocol.md#set_slave_add, docs/reference/protocol.md#alarms,
docs/reference/protocol.md#functions-of-dp-v1, docs/reference/protocol.md#im.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Final, Generic, Self, TypeVar

import construct as cs
from msgspec import Struct

from dpstack.errors import PduError

#: of DP-V1: octets of data in one record; slots count from 0
MAX_RECORD: Final = 240
MAX_SLOT: Final = 254

R = TypeVar("R")


class Layout(Generic[R]):
    """A PDU, declared field by field. ``make`` is called with the value of each field under the name of the field:
    usually a class with the same attributes.

    Fields that :func:`fixed` and :func:`ignored` make are not values: they are reserved, or always the same.
    ``"group_mask" / OCTET * "group_ident"`` names the field as messages shall name it. ``function``: the number of a
    DP-V1 service, which is the first octet then.
    """

    def __init__(self, name: str, make: Callable[..., R], *fields: Any, function: int | None = None) -> None:
        self.name = name
        self.make = make
        self._function = function
        if function is not None:
            fields = ("function" / fixed(8, function), *fields)
        self._names = {field.name: field.docs or field.name for field in fields}
        #: the names of the values
        self.fields = tuple(field.name for field in fields if not field.flagbuildnone)
        self._struct: Any = cs.Bitwise(cs.Struct(*fields))
        #: where each field ends, in bits from the first; REST has no end
        self._ends: dict[str, int] = {}
        self._is_exact = True
        end = 0
        for field in fields:
            try:
                end += field.sizeof()
            except cs.SizeofError:
                self._is_exact = False
            else:
                self._ends[field.name] = end
        #: octets without REST
        self.size = end // 8

    def parse(self, octets: bytes) -> R:
        """Read ``octets``. Raises PduError naming the octet: one is missing, too many, or of another function."""
        count = len(octets)
        if count < self.size:
            missing = next(name for name, end in self._ends.items() if end > 8 * count)
            where = f"octet {count + 1} ({self._names[missing]})"
            raise PduError(f"{self.name} ends after {count} octets: {where} is missing")
        if self._function not in (None, octets[0]):
            raise PduError(f"octet 1 is 0x{octets[0]:02X}, {self.name} is 0x{self._function:02X}")
        if self._is_exact and count > self.size:
            raise PduError(f"{self.name} has {count} octets, octet {self.size} is the last one")
        found = self._struct.parse(octets)
        return self.make(**{name: found[name] for name in self.fields})

    def build(self, source: object = None, **values: object) -> bytes:
        """The octets: each field from ``values``, else the attribute of ``source`` that has its name. Raises PduError
        naming the field that does not fit."""
        given = {name: values[name] if name in values else getattr(source, name) for name in self.fields}
        try:
            return bytes(self._struct.build(given))
        except cs.ConstructError as error:
            field = str(error.path).rpartition(" -> ")[2]  # "(building) -> ident"
            what = f"{self._names[field]} = {given.get(field)}"
            raise PduError(f"{self.name}: {what} does not fit its octets") from None


class Pdu(Struct, frozen=True):
    """Base class of the PDUs that :attr:`LAYOUT` describes completely."""

    LAYOUT: ClassVar[Layout[Any]]

    def build(self) -> bytes:
        """The octets. Raises PduError where a value does not fit."""
        return self.LAYOUT.build(self)

    @classmethod
    def parse(cls, octets: bytes) -> Self:
        """Read ``octets``; reserved bits and octets may be anything. Raises PduError naming the octet."""
        pdu: Self = cls.LAYOUT.parse(octets)
        return pdu


#: the kinds of fields: ``"name" / OCTET``
OCTET: Final[Any] = cs.BitsInteger(8)
WORD: Final[Any] = cs.BitsInteger(16)
DOUBLE_WORD: Final[Any] = cs.BitsInteger(32)
REST: Final[Any] = cs.Bytewise(cs.GreedyBytes)


def bits(count: int) -> Any:
    """A number of ``count`` bits."""
    return cs.BitsInteger(count)


def flags(names: str) -> tuple[Any, ...]:
    """Fields of one bit each, the most significant first."""
    return tuple(name / cs.Flag for name in names.split())


def octets(count: int) -> Any:
    """``count`` octets as bytes."""
    return cs.Bytewise(cs.Bytes(count))


def array(count: int, field: Any) -> Any:
    """``count`` times ``field``, as a list."""
    return cs.Array(count, field)


def fixed(count: int, value: int = 0) -> Any:
    """``count`` bits that are always ``value`` when sent, and may be anything when received."""
    return cs.Default(cs.BitsInteger(count), value)


def ignored() -> Any:
    """The octets up to the end: none when sent, anything when received."""
    return cs.Default(REST, b"")


def adapted(field: Any, read: Callable[[Any], object], write: Callable[[Any], object]) -> Any:
    """``field`` with another value: ``read`` makes it of that on the wire, ``write`` the other way; both may raise
    PduError."""
    return cs.ExprAdapter(field, lambda value, _: read(value), lambda value, _: write(value))
