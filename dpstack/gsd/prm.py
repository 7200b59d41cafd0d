"""User parameters (User_Prm_Data): from names and values to octets of Set_Prm behind the seven fixed ones, and back.

A GSD file has them twice: as constants (Ext_User_Prm_Data_Const) and as defaults of named parameters
(Ext_User_Prm_Data_Ref). In one file of six the two contradict each other. :class:`Reading` selects which of them
counts. A value that the user sets by name counts in both cases. A module's parameter with the name ``[SlotNumber]``
(ISO 15745-3) always has the number of the module's slot.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Sequence
from enum import Enum
from typing import Final

from msgspec import Struct
from msgspec.structs import replace

from dpstack.errors import GsdError
from dpstack.gsd.identifiers import MAX_USER_PRM
from dpstack.gsd.joining import reach_of
from dpstack.gsd.model import Device, Module, Parameter, PrmBlock, PrmKind, PrmType, folded, ranges_text
from dpstack.params import DPV1_STATUS_LEN
from dpstack.text import octets_text, shortened


class Reading(Enum):
    """User parameters of a GSD file that gives both constant octets and defaults of named parameters."""

    REFS = "refs"  #: the defaults of the named parameters lie over the constants, as engineering tools show it
    CONST = "const"  #: the constants as they stand


class PrmField(Struct, frozen=True):
    """One parameter at its place. ``at``: octet of the whole, ``offset``: octet of the device's or the module's part.

    ``place``: the number of the module's slot; of the device itself 0, or "device" if a module is in slot 0.
    ``slot_number``: its value is always the number of its slot.
    """

    place: str
    offset: int
    at: int
    parameter: Parameter
    value: int
    slot_number: bool = False

    @property
    def key(self) -> str:
        """The unambiguous key: ``2/Filter@4``, of bits ``2/Filter@4.3``."""
        return f"{self.place}/{self.local_key}"

    @property
    def local_key(self) -> str:
        """The key within the part of the device or the module: ``Filter@4``, ``Filter@4.3``."""
        kind = self.parameter.type
        bit = f".{kind.first}" if kind.kind in (PrmKind.BIT, PrmKind.BIT_AREA) else ""
        return f"{self.parameter.name}@{self.offset}{bit}"

    @property
    def text(self) -> str:
        """The value's text, or the value."""
        return self.parameter.texts.get(self.value, str(self.value))


class Contradiction(Struct, frozen=True):
    """A default that is not what the constants say at its place."""

    field: PrmField
    const: int

    @property
    def matters(self) -> bool:
        """The constant bits are not all zero. Zero bits below a parameter are the usual way to write a GSD file."""
        return self.const != 0

    @property
    def text(self) -> str:
        return f"{self.field.key}: {self.readings}"

    @property
    def readings(self) -> str:
        """The value of each :class:`Reading`, without the parameter's name."""
        parameter = self.field.parameter
        return (
            f"its default is {_value_text(parameter, parameter.default)}, the constant octets say "
            f"{_value_text(parameter, self.const)}"
        )


def read_bits(octets: bytes, at: int, kind: PrmType) -> int:
    """The value of type ``kind`` at octet ``at``; octets that are missing count as 0."""
    return _with_sign(kind, _unsigned(octets, at, kind))


def _unsigned(octets: bytes, at: int, kind: PrmType) -> int:
    whole = int.from_bytes(octets[at : at + kind.size].ljust(kind.size, b"\0"), "big")
    return whole >> kind.first & (1 << kind.width) - 1


def _with_sign(kind: PrmType, value: int) -> int:
    return value - (1 << kind.width) if kind.signed and value >> (kind.width - 1) else value


def write_bits(octets: bytearray, at: int, kind: PrmType, value: int) -> None:
    """Write ``value`` to its bits at octet ``at``; big-endian, two's complement."""
    first, size = kind.first, kind.size
    mask = (1 << kind.last - first + 1) - 1 << first
    whole = int.from_bytes(octets[at : at + size], "big")
    whole = whole & ~mask | value << first & mask
    octets[at : at + size] = whole.to_bytes(size, "big")


#: the remedy if modules make the user parameters too long
_SHORTER: Final = "take out modules, or give user_prm"


def length_note(device: Device, octets: int, own: int) -> str:
    """How the length of the user parameters contradicts the lengths of the file; empty if it does not.

    ``octets``: all of them, ``own``: those of the device itself. User_Prm_Data_Len counts only without
    Max_User_Prm_Data_Len; the modules of a modular station may make more.
    """
    usual, most, data = device.user_prm_data_len, device.max_user_prm_data_len, device.user_prm_data
    if most is not None:
        said = f"Max_User_Prm_Data_Len is {most}" if own > most else ""
        if data and not device.prm.present and octets in (0, DPV1_STATUS_LEN):
            said = f"User_Prm_Data has {len(data)}, but is not used beside Max_User_Prm_Data_Len"
    else:
        differs = usual is not None and (own > usual or octets < usual)
        said = f"User_Prm_Data_Len is {usual}" if differs else ""
    return f"{octets_text(octets)} of user parameters, {said}; {MAY_REFUSE}" if said else ""


#: consequence and remedy of user parameters whose length contradicts the file
MAY_REFUSE: Final = "the device may refuse them (Prm_Fault): then give the octets that its manual wants as user_prm"


def dpv1_note(device: Device, octets: int) -> str:
    """Why a device with Read and Write (DP-V1) stays without them with ``octets`` user parameters; empty if not."""
    if not device.dpv1.reads or octets >= DPV1_STATUS_LEN:
        return ""
    keyword = "User_Prm_Data_Len" if device.max_user_prm_data_len is None else "Max_User_Prm_Data_Len"
    limit = f" ({keyword} is {_most(device)})" if _most(device) < DPV1_STATUS_LEN else ""
    return (
        f"the GSD file says DPV1_Slave = 1 and C1_Read_Write_supp = 1, but has {octets_text(octets)} of user "
        f"parameters{limit}: Read, Write and alarms stay off without the three octets DPV1_Status; {ADD_STATUS}"
    )


def _most(device: Device) -> int:
    """The most octets of user parameters that the file allows."""
    said = device.user_prm_data_len if device.max_user_prm_data_len is None else device.max_user_prm_data_len
    return MAX_USER_PRM if said is None else said


#: the remedy for a device with DP-V1 whose user parameters do not begin with DPV1_Status
ADD_STATUS: Final = f'if the device has them, give user_prm = "{bytes(DPV1_STATUS_LEN).hex(" ")}" and dpv1 = true'


class UserPrm:
    """The user parameters of ``device`` with ``modules`` in slot order (None: an empty slot).

    Without ``in_slots`` the modules are in no slot, and ``[SlotNumber]`` keeps its default. A device with Read and
    Write (DP-V1) whose file has no octets, and no limit below three, gets three zeros: DPV1_Status.
    Raises GsdError if they do not fit a Set_Prm, if the modules make them longer than the device takes, or if
    a module may not have the number of its slot.
    """

    def __init__(
        self,
        device: Device,
        modules: Sequence[Module | None] = (),
        reading: Reading = Reading.REFS,
        *,
        in_slots: bool = True,
    ) -> None:
        #: device of the parameters
        self.device = device
        #: whether defaults of named parameters lie over the constant octets
        self.reading = reading
        own = b"" if device.user_prm_data_ignored else device.user_prm_data or b""
        #: the constants of the device and of all modules, and the fields with their defaults
        self._const = bytearray(own)
        self._fields: list[PrmField] = []
        self._set: dict[str, int] = {}
        self._add(device.prm, 0, "device" if device.first_slot == 0 and any(modules[:1]) else "0", None)
        #: octets of the device itself
        self._own = len(self._const)
        for slot, module in enumerate(modules, device.first_slot):
            if module is not None and module.prm.present:
                self._add(module.prm, slot, str(slot), module if in_slots else None)
        size, limit = len(self._const), device.max_user_prm_data_len
        if size > MAX_USER_PRM:
            raise GsdError(f"{size} octets of user parameters; a Set_Prm carries {MAX_USER_PRM}: {_SHORTER}")
        if limit is not None and size > limit >= self._own:
            raise GsdError(
                f"{size} octets of user parameters, Max_User_Prm_Data_Len of the device is {limit}; {_SHORTER}"
            )
        if size == 0 and device.dpv1.reads and _most(device) >= DPV1_STATUS_LEN:
            self._const += bytes(DPV1_STATUS_LEN)
            self._own = DPV1_STATUS_LEN

    def __repr__(self) -> str:
        return f"<UserPrm {self.octets().hex(' ')}>"

    def _add(self, prm: PrmBlock, slot: int, place: str, plugged: Module | None) -> None:
        """Append the part of the device or of a module. ``[SlotNumber]`` of a ``plugged`` module is ``slot``."""
        at, parameters = len(self._const), self.device.parameters
        size = reach_of(prm, parameters) if prm.length is None else prm.length
        octets = bytearray(size)
        for const in prm.consts:
            octets[const.offset : const.offset + len(const.octets)] = const.octets[: max(0, size - const.offset)]
        self._const += octets
        for ref in prm.refs:
            parameter = parameters.get(ref.number)
            if parameter is None or ref.offset + parameter.type.size > size:
                continue
            slot_number = plugged is not None and is_slot_number(parameter)
            if plugged is not None and slot_number and not parameter.allows(slot):
                raise GsdError(
                    f"module {plugged.title} cannot be in slot {slot}: its parameter {parameter.name} allows "
                    f"{_allowed(parameter)}; plug it there, or leave it out"
                )
            value = slot if slot_number else parameter.default
            self._fields.append(PrmField(place, ref.offset, at + ref.offset, parameter, value, slot_number))

    @property
    def length_note(self) -> str:
        """How the number of octets contradicts the file; empty if it does not."""
        return length_note(self.device, len(self._const), self._own)

    @property
    def fields(self) -> tuple[PrmField, ...]:
        """Every named parameter with the value it has now, in the order of slots and of the file."""
        return self.read(self.octets())

    def octets(self) -> bytes:
        octets = bytearray(self._const)
        for field in self._fields:
            value = self._set.get(field.key) if self._set else None
            if value is None and (field.slot_number or self.reading is Reading.REFS):
                value = field.value
            if value is not None:
                write_bits(octets, field.at, field.parameter.type, value)
        return bytes(octets)

    def set(self, key: str, value: int | str | bool) -> None:
        """Set a parameter, by its name, ``slot/name``, ``name@offset`` or both, to a number, a text or a flag.

        Raises GsdError (``what; what to do``); nothing is changed then.
        """
        for numbered in self._fields:
            if is_slot_number(numbered.parameter) and _matches(numbered, key):
                raise GsdError(f"parameter {numbered.key} is the number of the slot and cannot be set; leave it out")
        field = self.find(key)
        parameter = field.parameter
        if not parameter.changeable:
            raise GsdError(f"parameter {field.key} may not be changed (Changeable = 0); leave it out")
        self._set[field.key] = value_of(parameter, value)

    def find(self, key: str) -> PrmField:
        """The one field that ``key`` names. Raises GsdError with the nearest names, or with those it may mean."""
        found = [field for field in self._fields if _matches(field, key)]
        if len(found) == 1:
            return found[0]
        if not found:
            raise GsdError(f"there is no parameter {key!r}; {_nearest_names(key, self._fields)}")
        meant = ", ".join(repr(field.key) for field in found[:8])
        more = f" and {len(found) - 8} more" if len(found) > 8 else ""
        raise GsdError(f"{key!r} may be {len(found)} parameters; write one of {meant}{more}")

    def shortest_key(self, field: PrmField) -> str:
        """The parameter's name if that is enough to find it, else its key."""
        name = field.parameter.name
        return name if sum(_matches(other, name) for other in self._fields) == 1 else field.key

    def read(self, octets: bytes) -> tuple[PrmField, ...]:
        """The named values that ``octets`` (of this device with these modules) hold. Raises GsdError on the length."""
        if len(octets) != len(self._const):
            raise GsdError(f"{len(octets)} octets of user parameters; this configuration has {len(self._const)}")
        return tuple(replace(field, value=read_bits(octets, field.at, field.parameter.type)) for field in self._fields)

    def contradictions(self) -> tuple[Contradiction, ...]:
        """Defaults that differ from the constants at their place, of parameters that the user has not set.

        ``[SlotNumber]`` is none of them: neither its default nor the constant is ever sent.
        """
        consts = bytes(self._const)
        found: list[Contradiction] = []
        for field in self._fields:
            kind, default = field.parameter.type, field.parameter.default
            const = _unsigned(consts, field.at, kind)
            differs = (const ^ default) & (1 << kind.width) - 1  # from the default as its bits hold it
            if differs and not is_slot_number(field.parameter) and field.key not in self._set:
                found.append(Contradiction(field, _with_sign(kind, const)))
        return tuple(found)


def is_slot_number(parameter: Parameter) -> bool:
    """ISO 15745-3: a parameter of this name has the number of the module's slot, whatever GSD_Revision says."""
    return folded(parameter.name) == _SLOT_NUMBER


_SLOT_NUMBER: Final = folded("[SlotNumber]")


def value_of(parameter: Parameter, value: int | str | bool) -> int:
    """The number for ``value``; texts without regard to case. Raises GsdError with the allowed values."""
    number = _number(parameter, value)
    if not parameter.allows(number):
        raise GsdError(f"{parameter.name!r} = {number} is not allowed; allowed are {_allowed(parameter)}")
    return number


def _allowed(parameter: Parameter) -> str:
    return ranges_text(parameter.allowed or (parameter.type.limits,))


#: characters; 32 bits in binary have 35
_LONGEST_NUMBER: Final = 40


def _number(parameter: Parameter, value: int | str | bool) -> int:
    if isinstance(value, int):
        return int(value)
    choices = parameter.choices
    for number, text in choices.items():
        if folded(text) == folded(value):
            return number
    if len(value) <= _LONGEST_NUMBER:
        with contextlib.suppress(ValueError):
            return int(value, 0)
    if not choices:
        raise GsdError(f"{parameter.name!r} = {shortened(value)!r} is no number; allowed are {_allowed(parameter)}")
    texts = list(choices.values())
    near = near_names(value, texts, _CLOSE)
    hint = f"did you mean {near[0]!r}? known: " if near else "known: "
    raise GsdError(f"{parameter.name!r} has no value {shortened(value)!r}; {hint}{', '.join(map(repr, texts[:20]))}")


_CLOSE: Final = 0.5
#: the most names in a message
_HINTS: Final = 3


def near_names(wanted: str, names: Iterable[str], cutoff: float) -> list[str]:
    """At most three of ``names`` that ``wanted`` may mean: those that contain it, else those that contain its words,
    else those that contain it without regard to blanks and the similar ones (``cutoff`` as in difflib).
    """
    by_fold = {folded(name): name for name in names}
    found = containing(wanted, list(by_fold))
    if not found:
        bare = "".join(folded(wanted).split())
        found = [fold for fold in by_fold if bare and bare in fold.replace(" ", "")]
        import difflib  # here, as most names are right

        found += difflib.get_close_matches(folded(wanted), list(by_fold), n=_HINTS, cutoff=cutoff)
    return [by_fold[fold] for fold in list(dict.fromkeys(found))[:_HINTS]]


def containing(part: str, names: Sequence[str]) -> list[str]:
    """Those of ``names`` that contain ``part``, without regard to case and runs of blanks; else all of its words."""
    whole = folded(part)
    found = [name for name in names if whole and whole in folded(name)]
    return found or [name for name in names if whole and all(word in folded(name) for word in whole.split())]


def module_octets(device: Device, module: Module) -> bytes:
    """The user parameters of ``module`` with its defaults, in no slot. Raises GsdError if they fit no Set_Prm."""
    # without the device's own parameters, which would be computed again for every module
    return UserPrm(Device(parameters=device.parameters), (module,), in_slots=False).octets()


def _nearest_names(key: str, fields: Iterable[PrmField]) -> str:
    names = list(dict.fromkeys(field.parameter.name for field in fields))
    if not names:
        return "this device with these modules has none: leave it out"
    near = near_names(key.rpartition("/")[2].partition("@")[0], names, _CLOSE)
    if near:
        return "nearest are " + ", ".join(map(repr, near))
    return "known are " + ", ".join(map(repr, names[:12])) + (" ..." if len(names) > 12 else "")


def _matches(field: PrmField, key: str) -> bool:
    """Whether ``key`` is one of the ways to name ``field``."""
    name, wanted = field.parameter.name, folded(key)
    places = ("", f"@{field.offset}", field.key[field.key.rindex("@") :])
    return any(wanted in (folded(name + place), folded(f"{field.place}/{name}{place}")) for place in places)


def _value_text(parameter: Parameter, value: int) -> str:
    text = parameter.texts.get(value)
    return str(value) if text is None else f"{value} ({text})"
