"""``RecordList``: all parameters that a device lists (record 47, 980 to 989), in a file and compared with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from dpstack.api.lists.list_file import (
    Difference,
    Element,
    ListComparison,
    ListEntry,
    SavedList,
    element_text,
    is_same,
    pairs_of,
    time_now,
)
from dpstack.errors import ConfigError
from dpstack.profile.record47 import ReadParameter


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedValues(ListEntry):
    """A parameter of a device with all its ``values`` in ``format``, or without any."""

    KEYS: ClassVar = {"number": int, "name": str, "format": str, "values": list, "unreadable": str, "read_only": bool}
    VALUES = "values", "format"
    OMITTED: ClassVar = {"name": "", "read_only": False}

    format: str = ""
    values: tuple[Element, ...] = ()

    @classmethod
    def of(cls, found: ReadParameter) -> ListedValues:
        description, form = found.description, found.format
        return cls(
            number=found.pnu,
            name="" if description is None else description.name,
            format="" if form is None else form.name,
            values=tuple(one.hex(" ") if isinstance(one, bytes) else one for one in found.values),
            read_only=description is not None and description.read_only,
            unreadable=found.why_not,
        )

    @property
    def place(self) -> int:
        return self.number

    @property
    def label(self) -> str:
        """For people: ``parameter 964 (Device id)``."""
        return f"parameter {self.number}" + (f" ({self.name})" if self.name else "")

    @property
    def text(self) -> str:
        """The values for people, or the reason why they are missing."""
        if self.unreadable is not None:
            return f"cannot be read: {self.unreadable}"
        return ", ".join(map(element_text, self.values)) or "no value"

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> ListedValues:
        known = {key: plain[key] for key in cls.KEYS if key in plain}
        return cls(**{**known, "values": tuple(plain.get("values", ()))})


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordList(SavedList[ListedValues]):
    """The parameters of one device, in the order of its own list. ``ident``: its ident number."""

    PROGRAM = "dpstack acyclic"
    COMMENT = "Parameters of a device; `dpstack acyclic CONFIG ADDRESS compare FILE` shows where a device differs."
    KIND = "record 47"
    HEAD: ClassVar = {"name": str, "address": int, "ident": int, "slot": int, "object": int, "time": str}
    ENTRY = ListedValues
    LINE = "entry"

    ident: int
    slot: int
    object: int

    @classmethod
    def entry(cls, plain: Any, where: str) -> ListedValues:
        """The parameter of a line: a number, and values or the reason why it has none."""
        if isinstance(plain, Mapping) and type(plain.get("number")) is int:
            where = f"{where} (parameter {plain['number']})"
        found = cls.check(plain, where, ("number",))
        for at, value in enumerate(found.get("values", ())):
            if type(value) not in (int, float, bool, str):
                cls.refuse(where, f"element {at} of its values, {value!r}, is neither a number nor a text")
        return ListedValues.from_dict(found)


class RecordDifference(Difference[ListedValues]):
    """A parameter of a device that differs from the file."""

    __slots__ = ()

    @property
    def elements(self) -> tuple[int, ...]:
        """Indexes, from 0, of the elements that differ or are missing in one of the two."""
        saved, found = self.saved.values, self.found.values
        count, both = max(len(saved), len(found)), min(len(saved), len(found))
        return tuple(at for at in range(count) if at >= both or not is_same(saved[at], found[at]))

    @property
    def is_none(self) -> bool:
        """Whether all elements are readable and equal, and both formats are the same."""
        return not self.elements and self.found.unreadable is None and self.saved.format == self.found.format

    @property
    def text(self) -> str:
        """A line for people; of an array with the differing elements only."""
        saved, found = self.saved, self.found
        if found.unreadable is None and saved.format != found.format:
            return f"{saved.label}: file {saved.text} as {saved.format}, device {found.text} as {found.format}"
        if found.unreadable is not None or max(len(saved.values), len(found.values)) < 2:
            return f"{saved.label}: file {saved.text}, device {found.text}"
        parts = (f"[{at}] file {_element(saved, at)}, device {_element(found, at)}" for at in self.elements)
        return f"{saved.label}: {'; '.join(parts)}"


RecordComparison = ListComparison[RecordDifference, ListedValues]


def list_of(answer: Mapping[str, Any]) -> RecordList:
    """The list in the ``answer`` to the order ``parameters`` (:mod:`dpstack.api.control.record_orders`)."""
    place = {key: answer[key] for key in ("address", "ident", "slot", "object")}
    entries = tuple(ListedValues.from_dict(one) for one in answer["parameters"])
    return RecordList(name=answer["slave"], time=time_now(), parameters=entries, **place)


def compared(
    found: RecordList, saved: RecordList, *, read_only: bool = False, where: str | Path = "the list"
) -> RecordComparison:
    """The differences between the device and ``saved``, element by element.

    ``read_only``: compare read-only parameters (actual values, properties), too. Raises ConfigError for a list of
    another type of device.
    """
    if saved.ident != found.ident:
        raise ConfigError(
            f"{where} holds the parameters of {saved.name}, a device of the type 0x{saved.ident:04X}; slave "
            f"{found.address} ({found.name}) is 0x{found.ident:04X}: take a file of such a device"
        )
    pairs, skipped = pairs_of(
        saved.parameters,
        {one.place: one for one in found.parameters},
        lambda one: one,
        missing="the device does not have it",
        read_only=read_only,
    )
    return ListComparison.of([RecordDifference(one, now) for one, now in pairs], skipped)


def _element(one: ListedValues, at: int) -> str:
    return ListedValues(number=one.number, values=one.values[at : at + 1]).text
