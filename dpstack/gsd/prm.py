"""User parameters: from names and values to the octets of Set_Prm behind the seven fixed ones, and back.

A GSD file says them twice: as constants (Ext_User_Prm_Data_Const) and as defaults of named parameters
(Ext_User_Prm_Data_Ref), and the two contradict each other in one file of six. :class:`Reading` says which counts; what
is set by name counts in both.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

from dpstack.errors import GsdError
from dpstack.gsd.joining import reach_of
from dpstack.gsd.model import Device, Module, Parameter, PrmBlock, PrmKind, PrmType, folded, in_ranges, ranges_text
from dpstack.gsd.module_block import MAX_USER_PRM


class Reading(Enum):
    """Which defaults count."""

    REFS = "refs"  #: the defaults of the named parameters lie over the constants, as engineering tools show it
    CONST = "const"  #: the constants as they stand


@dataclass(frozen=True, slots=True)
class Field:
    """One parameter at its place. ``slot`` 0 is the device itself, modules have theirs; ``at``: octet of the whole.

    ``offset`` is the one in the file, within the device's or the module's part. ``set``: the user has set it.
    """

    slot: int
    offset: int
    at: int
    parameter: Parameter
    value: int
    set: bool = False

    @property
    def key(self) -> str:
        """How to name it without doubt: ``2/Filter@4``, bits ``2/Filter@4.3``."""
        kind = self.parameter.type
        bit = f".{kind.first}" if kind.kind in (PrmKind.BIT, PrmKind.BIT_AREA) else ""
        return f"{self.slot}/{self.parameter.name}@{self.offset}{bit}"

    @property
    def text(self) -> str:
        """The value's text, or the value."""
        return self.parameter.texts.get(self.value, str(self.value))


@dataclass(frozen=True, slots=True)
class Contradiction:
    """A default that is not what the constants say at its place."""

    field: Field
    const: int

    @property
    def text(self) -> str:
        """One line."""
        f = self.field
        return (
            f"{f.key}: its default is {_shown(f.parameter, f.parameter.default)}, the constant octets say "
            f"{_shown(f.parameter, self.const)}"
        )


def take(octets: bytes, at: int, kind: PrmType) -> int:
    """The value of type ``kind`` at octet ``at``; octets that are missing count as 0."""
    whole = int.from_bytes(octets[at : at + kind.size].ljust(kind.size, b"\0"), "big")
    value = whole >> kind.first & (1 << kind.width) - 1
    return value - (1 << kind.width) if kind.signed and value >> (kind.width - 1) else value


def put(octets: bytearray, at: int, kind: PrmType, value: int) -> None:
    """Put ``value`` into its own bits at octet ``at``; big-endian, two's complement."""
    mask = (1 << kind.width) - 1 << kind.first
    whole = int.from_bytes(octets[at : at + kind.size], "big")
    whole = whole & ~mask | value << kind.first & mask
    octets[at : at + kind.size] = whole.to_bytes(kind.size, "big")


@dataclass(frozen=True, slots=True)
class _Part:
    """The part of one slot: where it begins, its constants, its fields with their defaults."""

    slot: int
    at: int
    const: bytes
    fields: tuple[Field, ...]


class UserPrm:
    """The user parameters of ``device`` with ``modules`` in slot order (None: an empty slot).

    Slots are numbered from ``first_slot``. Raises GsdError where they do not fit a Set_Prm or the device.
    """

    def __init__(
        self,
        device: Device,
        modules: Sequence[Module | None] = (),
        reading: Reading = Reading.REFS,
        first_slot: int = 1,
    ) -> None:
        self.device = device
        self.reading = reading
        self._parts = list(_parts(device, modules, first_slot))
        size = sum(len(part.const) for part in self._parts)
        limit = device.max_user_prm_data_len
        if size > MAX_USER_PRM:
            raise GsdError(f"{size} octets of user parameters; a Set_Prm carries {MAX_USER_PRM}: take out modules")
        if limit is not None and size > limit:
            raise GsdError(
                f"{size} octets of user parameters, Max_User_Prm_Data_Len of the device is {limit}; take out modules"
            )
        self._set: dict[str, int] = {}

    @property
    def legacy(self) -> bool:
        """The octets are User_Prm_Data as it stands: there are no named parameters."""
        return _legacy(self.device)

    @property
    def fields(self) -> tuple[Field, ...]:
        """Every named parameter with the value it has now, in the order of slots and of the file."""
        octets = self.octets()
        return tuple(
            replace(field, value=take(octets, field.at, field.parameter.type), set=field.key in self._set)
            for part in self._parts
            for field in part.fields
        )

    def octets(self) -> bytes:
        """The octets for Set_Prm."""
        found = bytearray()
        for part in self._parts:
            found += self._octets_of(part)
        return bytes(found)

    def octets_of(self, slot: int) -> bytes:
        """The part of one slot, 0 for the device itself."""
        return next((bytes(self._octets_of(part)) for part in self._parts if part.slot == slot), b"")

    def _octets_of(self, part: _Part) -> bytearray:
        octets = bytearray(part.const)
        for field in part.fields:
            value = self._set.get(field.key)
            if value is None and self.reading is Reading.REFS:
                value = field.parameter.default
            if value is not None:
                put(octets, field.offset, field.parameter.type, value)
        return octets

    def set(self, key: str, value: int | str | bool) -> None:
        """Set a parameter, by its name, ``slot/name``, ``name@offset`` or both, to a number, a text or a flag.

        Raises GsdError (``what; what to do``); nothing is changed then.
        """
        field = self.find(key)
        parameter = field.parameter
        if not parameter.changeable:
            raise GsdError(f"parameter {field.key} may not be changed (Changeable = 0); leave it out")
        self._set[field.key] = value_of(parameter, value)

    def find(self, key: str) -> Field:
        """The one field that ``key`` names. Raises GsdError with the nearest names, or with those it may mean."""
        fields = [field for part in self._parts for field in part.fields]
        found = [field for field in fields if _matches(field, key)]
        if len(found) == 1:
            return found[0]
        if not found:
            raise GsdError(f"there is no parameter {key!r}; {_nearest(key, fields)}")
        meant = ", ".join(repr(field.key) for field in found[:8])
        more = f" and {len(found) - 8} more" if len(found) > 8 else ""
        raise GsdError(f"{key!r} may be {len(found)} parameters; write one of {meant}{more}")

    def shortest_key(self, field: Field) -> str:
        """The parameter's name where that is enough to find it, else its key."""
        name = field.parameter.name
        alike = [other for part in self._parts for other in part.fields if _matches(other, name)]
        return name if len(alike) == 1 else field.key

    def read(self, octets: bytes) -> tuple[Field, ...]:
        """The named values that ``octets`` (of this device with these modules) hold. Raises GsdError on the length."""
        expected = sum(len(part.const) for part in self._parts)
        if len(octets) != expected:
            raise GsdError(f"{len(octets)} octets of user parameters; this configuration has {expected}")
        return tuple(
            replace(field, value=take(octets, field.at, field.parameter.type))
            for part in self._parts
            for field in part.fields
        )

    def contradictions(self) -> tuple[Contradiction, ...]:
        """Defaults that differ from the constants at their place."""
        found = []
        for part in self._parts:
            for field in part.fields:
                const = take(part.const, field.offset, field.parameter.type)
                if const != _fitted(field.parameter):
                    found.append(Contradiction(field, const))
        return tuple(found)


def value_of(parameter: Parameter, value: int | str | bool) -> int:
    """The number for ``value``; texts without regard to case. Raises GsdError naming what is allowed."""
    number = _number(parameter, value)
    low, high = parameter.type.limits
    if not low <= number <= high or not in_ranges(number, parameter.allowed):
        allowed = parameter.allowed or ((low, high),)
        raise GsdError(f"{parameter.name!r} = {number} is not allowed; allowed are {ranges_text(allowed)}")
    return number


def _number(parameter: Parameter, value: int | str | bool) -> int:
    if isinstance(value, int):
        return int(value)
    for number, text in parameter.texts.items():
        if folded(text) == folded(value):
            return number
    try:
        return int(value, 0)
    except ValueError:
        pass
    if not parameter.texts:
        low, high = parameter.type.limits
        allowed = ranges_text(parameter.allowed or ((low, high),))
        raise GsdError(f"{parameter.name!r} = {value!r} is no number; allowed are {allowed}")
    near = difflib.get_close_matches(folded(value), [folded(t) for t in parameter.texts.values()], n=1, cutoff=0.5)
    texts = list(parameter.texts.values())
    first = next((t for t in texts if near and folded(t) == near[0]), None)
    hint = f"did you mean {first!r}? known: " if first else "known: "
    raise GsdError(f"{parameter.name!r} has no value {value!r}; {hint}{', '.join(map(repr, texts[:20]))}")


_CLOSE: Final = 0.5


def _nearest(key: str, fields: Iterable[Field]) -> str:
    names = list(dict.fromkeys(field.parameter.name for field in fields))
    if not names:
        return "this device with these modules has none: leave it out"
    bare = key.rpartition("/")[2].partition("@")[0]
    by_fold = {folded(name): name for name in names}
    near = difflib.get_close_matches(folded(bare), list(by_fold), n=3, cutoff=_CLOSE)
    if near:
        return "nearest are " + ", ".join(repr(by_fold[n]) for n in near)
    return "known are " + ", ".join(map(repr, names[:12])) + (" ..." if len(names) > 12 else "")


def _matches(field: Field, key: str) -> bool:
    """``key`` in any of the ways to name ``field``."""
    name, wanted = field.parameter.name, folded(key)
    places = ("", f"@{field.offset}", field.key[field.key.rindex("@") :])
    return any(wanted in (folded(name + place), folded(f"{field.slot}/{name}{place}")) for place in places)


def _parts(device: Device, modules: Sequence[Module | None], first_slot: int) -> Iterator[_Part]:
    own = device.user_prm_data if _legacy(device) else None
    part = _Part(0, 0, own, ()) if own is not None else _part(device.prm, device.parameters, 0, 0)
    yield part
    at = len(part.const)
    for slot, module in enumerate(modules, first_slot):
        if module is None or not module.prm.given:
            continue
        part = _part(module.prm, device.parameters, slot, at)
        yield part
        at += len(part.const)


def _legacy(device: Device) -> bool:
    """User_Prm_Data counts: neither Ext_User_Prm_Data nor Max_User_Prm_Data_Len is there."""
    return device.user_prm_data is not None and not device.prm.given and device.max_user_prm_data_len is None


def _part(prm: PrmBlock, parameters: Mapping[int, Parameter], slot: int, at: int) -> _Part:
    sizes = {ref.number: parameters[ref.number].type.size for ref in prm.refs if ref.number in parameters}
    size = reach_of(prm, sizes) if prm.length is None else prm.length
    octets = bytearray(size)
    for const in prm.consts:
        octets[const.offset : const.offset + len(const.octets)] = const.octets[: max(0, size - const.offset)]
    fields = [
        Field(slot, ref.offset, at + ref.offset, parameter, parameter.default)
        for ref in prm.refs
        if (parameter := parameters.get(ref.number)) is not None and ref.offset + parameter.type.size <= size
    ]
    return _Part(slot, at, bytes(octets[:size]), tuple(fields))


def _fitted(parameter: Parameter) -> int:
    """The default as its bits hold it."""
    octets = bytearray(parameter.type.size)
    put(octets, 0, parameter.type, parameter.default)
    return take(bytes(octets), 0, parameter.type)


def _shown(parameter: Parameter, value: int) -> str:
    text = parameter.texts.get(value)
    return str(value) if text is None else f"{value} ({text})"
