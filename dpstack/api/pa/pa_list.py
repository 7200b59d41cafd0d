"""``PaList``: all parameters of a process device, in a file and compared with another device."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from dpstack.api.lists.list_file import (
    Difference,
    Element,
    ListComparison,
    ListEntry,
    SavedList,
    element_text,
    is_same,
    time_now,
)
from dpstack.api.pa.values import PaValue, shortest
from dpstack.pa.datatypes import ParameterValue, Scalar, datatype
from dpstack.pa.parameters import Group

#: the groups of parameters, in the order in which differences are shown
GROUPS: Final = tuple(group.value for group in Group)
#: differences of this group do not count: serial number, revisions
IDENTITY: Final = Group.IDENTITY.value


@dataclass(frozen=True, slots=True, kw_only=True)
class PaEntry(ListEntry):
    """A parameter with its ``values`` (the elements of a structure in their order). ``number``: its index; ``text``:
    value and unit in words."""

    KEYS: ClassVar = {
        "name": str,
        "slot": int,
        "number": int,
        "type": str,
        "group": str,
        "values": list,
        "text": str,
        "unreadable": str,
        "read_only": bool,
    }
    VALUES = "values", "text"
    OMITTED: ClassVar = {"text": "", "read_only": False}

    slot: int
    type: str = ""
    group: str = Group.UNKNOWN.value
    values: tuple[Element, ...] = ()
    text: str = ""

    @classmethod
    def of(cls, found: PaValue) -> PaEntry:
        return cls(
            number=found.index,
            name=found.name,
            slot=found.slot,
            type=found.type,
            group=found.group.value,
            values=_elements(found.value),
            text="" if found.unreadable is not None else found.text,
            read_only="w" not in found.access and found.access != "rm",
            unreadable=found.unreadable,
        )

    @property
    def place(self) -> str:
        return self.name

    @property
    def label(self) -> str:
        return self.name

    @property
    def shown(self) -> str:
        """Value and unit for people, or the reason why it cannot be read."""
        if self.unreadable is not None:
            return f"cannot be read: {self.unreadable}"
        return self.text or ", ".join(map(element_text, self.values)) or "empty"

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> PaEntry:
        known = {key: plain[key] for key in cls.KEYS if key in plain}
        return cls(**{**known, "values": tuple(plain.get("values", ()))})

    def for_json(self) -> dict[str, Any]:
        """As :meth:`as_dict`, without numbers that JSON does not have."""
        plain = self.as_dict()
        if "values" in plain:
            plain["values"] = [None if _is_no_number(one) else one for one in plain["values"]]
        return plain


def _is_no_number(value: object) -> bool:
    return isinstance(value, float) and not math.isfinite(value)


def _elements(value: ParameterValue | None) -> tuple[Element, ...]:
    if value is None:
        return ()
    return tuple(map(_element, value.values() if isinstance(value, Mapping) else (value,)))


def _element(value: Scalar) -> Element:
    if isinstance(value, bytes):
        return value.hex(" ")
    return shortest(value) if isinstance(value, float) else value


@dataclass(frozen=True, slots=True, kw_only=True)
class PaList(SavedList[PaEntry]):
    """The parameters of one device. ``maker``: DEVICE_MAN_ID; ``device``, ``serial``: DEVICE_ID, DEVICE_SER_NUM;
    ``profile``: revision of the profile."""

    PROGRAM = "dpstack pa"
    COMMENT = "Parameters of a process device; `dpstack pa CONFIG NAME compare FILE` shows where a device differs."
    KIND = "profibus pa"
    HEAD: ClassVar = {
        "name": str,
        "address": int,
        "maker": int,
        "device": str,
        "serial": str,
        "profile": str,
        "time": str,
    }
    ENTRY = PaEntry
    LINE = "entry"

    maker: int
    device: str
    serial: str
    profile: str

    @classmethod
    def entry(cls, plain: Any, where: str) -> PaEntry:
        """The parameter of a line: name, slot, index, and values or the reason why it has none."""
        if isinstance(plain, Mapping) and type(plain.get("name")) is str:
            where = f"{where} ({plain['name']})"
        found = cls.check(plain, where, ("name", "slot", "number"))
        if found.get("group", GROUPS[0]) not in GROUPS:
            cls.refuse(where, f"group = {found['group']!r} is none of {', '.join(GROUPS)}")
        for at, value in enumerate(found.get("values", ())):
            if type(value) not in (int, float, bool, str):
                cls.refuse(where, f"element {at} of its values, {value!r}, is neither a number nor a text")
        return PaEntry.from_dict(found)

    @classmethod
    def of_answer(cls, answer: Mapping[str, Any]) -> PaList:
        """The list in the answer to the order ``dump`` (:mod:`dpstack.api.pa.orders`)."""
        head = {key: answer[key] for key in ("address", "maker", "device", "serial", "profile")}
        entries = tuple(PaEntry.from_dict(_with_numbers(one)) for one in answer["parameters"])
        return cls(name=answer["slave"], time=time_now(), parameters=entries, **head)


def _with_numbers(plain: Mapping[str, Any]) -> Mapping[str, Any]:
    """The fields of an entry of JSON, in which null stands for NaN and infinity."""
    if "values" not in plain:
        return plain
    return {**plain, "values": [math.nan if one is None else one for one in plain["values"]]}


@dataclass(frozen=True, slots=True)
class PaDifference(Difference[PaEntry]):
    """A parameter that differs: ``saved`` in the list, ``found`` in the device."""

    @property
    def is_none(self) -> bool:
        """Whether both are readable, of one type, and equal."""
        saved, found = self.saved, self.found
        return found.unreadable is None and saved.type == found.type and not self.elements

    @property
    def group(self) -> str:
        return self.found.group

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the elements of a structure that differ, or their numbers from 0."""
        saved, found = self.saved.values, self.found.values
        count, both = max(len(saved), len(found)), min(len(saved), len(found))
        different = [at for at in range(count) if at >= both or not is_same(saved[at], found[at])]
        if self.found.type.startswith("simulate") and saved[-1:] == found[-1:] == (0,):
            return ()  # switched off in both: the rest follows the measured value
        names = _element_names(self.found.type)
        return tuple(names[at] if at < len(names) else str(at) for at in different)

    @property
    def text(self) -> str:
        return self.line("file", "device")

    def line(self, saved: str, found: str) -> str:
        """A line for people; ``saved``, ``found``: words for the two, for instance ``file`` and ``device``."""
        one, other = self.saved.shown, self.found.shown
        if one == other:  # the words leave out the element that differs
            one, other = (", ".join(map(element_text, entry.values)) for entry in (self.saved, self.found))
        return f"{self.saved.name}: {saved} {one}; {found} {other}"


def _element_names(kind: str) -> tuple[str, ...]:
    try:
        return tuple(name for name, _ in datatype(kind).elements)
    except (ValueError, KeyError, ArithmeticError, OSError):
        return ()


#: the groups that are compared without being asked for
_USUAL: Final = (Group.CONFIGURATION.value, Group.IDENTITY.value)


def compared(found: PaList, saved: PaList, *, everything: bool = False) -> ListComparison[PaDifference, PaEntry]:
    """The differences between the device and ``saved``: configuration and identity, with ``everything`` measured values
    and octets of the maker, too."""
    there = {one.place: one for one in found.parameters}
    mine = {one.place for one in saved.parameters}
    pairs: list[PaDifference] = []
    skipped: list[tuple[PaEntry, str]] = []
    for one in saved.parameters:
        now = there.get(one.place)
        group = one.group if now is None else now.group
        if group not in _USUAL and not everything:
            skipped.append((one, _WHY.get(group, "")))
        elif one.unreadable is not None:
            skipped.append((one, f"it could not be read when the list was made: {one.unreadable}"))
        elif now is None:
            skipped.append((one, "the device does not have it"))
        else:
            pairs.append(PaDifference(one, now))
    extra = [one for one in found.parameters if one.place not in mine]
    skipped += [(one, "it is not in the list") for one in extra if everything or one.group in _USUAL]
    return ListComparison.of(pairs, skipped)


_WHY: Final = {
    Group.MEASURED.value: "measured values, --all compares them",
    Group.UNKNOWN.value: "octets of the maker without a known meaning, --all compares them",
}
