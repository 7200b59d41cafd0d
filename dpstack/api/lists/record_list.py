"""All parameters of a device's own list (record 47, 980 to 989) in a file: TOML, a line a parameter, arrays whole.

Written into a file and compared with one: what was read as a whole, of whatever program.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from dpstack.api.config.toml import quoted
from dpstack.api.files import FileToBe
from dpstack.api.lists.list_file import ListFile
from dpstack.errors import ConfigError
from dpstack.profile.record47 import ReadParameter

_FILE: Final = ListFile(
    program="dpstack acyclic",
    comment="Parameters of a device; `dpstack acyclic CONFIG ADDRESS compare FILE` tells where a device differs.",
    kind="record 47",
    head={"name": str, "address": int, "ident": int, "slot": int, "object": int, "time": str},
    entry={
        "number": (int,),
        "name": (str,),
        "format": (str,),
        "values": (list,),
        "unreadable": (str,),
        "read_only": (bool,),
    },
    value="values",
)

#: of one element: a number in its unit, a truth value, a text; octets that are nothing else as hex
Element = int | float | bool | str


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedValues:
    """One parameter with all its ``values`` in ``format``, or without any and the reason in ``unreadable``."""

    number: int
    name: str = ""
    format: str = ""
    values: tuple[Element, ...] = ()
    read_only: bool = False
    unreadable: str | None = None

    @classmethod
    def of(cls, found: ReadParameter) -> ListedValues:
        """As it was read."""
        told, form = found.description, found.format
        return cls(
            number=found.pnu,
            name="" if told is None else told.name,
            format="" if form is None else form.name,
            values=tuple(one.hex(" ") if isinstance(one, bytes) else one for one in found.values),
            read_only=told is not None and told.read_only,
            unreadable=found.why_not,
        )

    @property
    def label(self) -> str:
        """For people: ``parameter 964 (Device id)``."""
        return f"parameter {self.number}" + (f" ({self.name})" if self.name else "")

    @property
    def text(self) -> str:
        """The values for people, or why there are none."""
        if self.unreadable is not None:
            return f"cannot be read: {self.unreadable}"
        return ", ".join(map(_shown, self.values)) or "no value"

    def line(self) -> str:
        """Its line of the file."""
        parts = [f"number = {self.number}"]
        parts += [f"name = {quoted(self.name)}"] if self.name else []
        if self.unreadable is None:
            parts += [f"format = {quoted(self.format)}", f"values = [{', '.join(map(_toml, self.values))}]"]
        else:
            parts += [f"unreadable = {quoted(self.unreadable)}"]
        parts += ["read_only = true"] if self.read_only else []
        return "  { " + ", ".join(parts) + " },"

    def as_dict(self) -> dict[str, object]:
        """Plain data, without what is not there."""
        plain: dict[str, object] = {"number": self.number}
        plain |= {"name": self.name} if self.name else {}
        plain |= {"unreadable": self.unreadable} if self.unreadable is not None else {}
        plain |= {"format": self.format, "values": list(self.values)} if self.unreadable is None else {}
        return plain | ({"read_only": True} if self.read_only else {})

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> ListedValues:
        """From what :meth:`as_dict` made."""
        known = {name: plain[name] for name in _FILE.entry if name in plain}
        return cls(**{**known, "values": tuple(plain.get("values", ()))})

    def differences(self, other: ListedValues) -> tuple[int, ...]:
        """The elements that are not the same, from 0 on; those that one of the two does not have are among them."""
        count = max(len(self.values), len(other.values))
        return tuple(at for at in range(count) if not _same(self.values, other.values, at))


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordList:
    """The parameters of one device, in the order of its list. ``ident``: its ident number."""

    name: str
    address: int
    ident: int
    slot: int
    object: int
    time: str
    parameters: tuple[ListedValues, ...]

    @property
    def complete(self) -> bool:
        """Always: a list is read as a whole."""
        return True

    @property
    def unreadable(self) -> tuple[ListedValues, ...]:
        """Those that the device refused."""
        return tuple(one for one in self.parameters if one.unreadable is not None)

    def text(self) -> str:
        """As it stands in a file."""
        head = [
            f"name = {quoted(self.name)}",
            f"address = {self.address}",
            f"ident = 0x{self.ident:04X}",
            f"slot = {self.slot}",
            f"object = {self.object}",
            f"time = {quoted(self.time)}",
        ]
        return _FILE.text(head, (one.line() for one in self.parameters))

    @classmethod
    def parse(cls, text: str, where: str = "parameters") -> RecordList:
        """From a file's text. Raises ConfigError naming ``where`` and the parameter."""
        head, entries = _FILE.parse(text, where)
        params = tuple(_entry(entry, f"{where}: entry {n}") for n, entry in enumerate(entries, 1))
        _FILE.once(where, ((one.number, f"parameter {one.number}") for one in params))
        return cls(**head, parameters=params)

    @classmethod
    def load(cls, path: str | Path) -> RecordList:
        """From a file. Raises ConfigError."""
        return cls.parse(_FILE.load(path), str(path))


def file_for(path: str | Path, name: str) -> FileToBe:
    """The file for a list of the slave ``name``: no other file than one of the same is replaced."""

    def is_earlier(there: Path) -> bool:
        try:
            return RecordList.load(there).name == name
        except ConfigError:
            return False

    return FileToBe(path, is_earlier, f"earlier dump of {name}")


def _entry(entry: object, where: str) -> ListedValues:
    if isinstance(entry, Mapping) and type(entry.get("number")) is int:
        where = f"{where} (parameter {entry['number']})"
    told = _FILE.check(entry, where, ("number",))
    for at, value in enumerate(told.get("values", ())):
        if type(value) not in (int, float, bool, str):
            _FILE.refuse(where, f"element {at} of its values, {value!r}, is neither a number nor a text")
    return ListedValues.from_dict(told)


def _toml(value: Element) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return quoted(value) if isinstance(value, str) else repr(value)


def _shown(value: Element) -> str:
    return repr(value) if isinstance(value, str) else _toml(value)


def _same(old: Sequence[Element], new: Sequence[Element], at: int) -> bool:
    """To the last digit of the wire: a file keeps every digit of a value, people may write fewer."""
    if at >= min(len(old), len(new)):
        return False
    one, other = old[at], new[at]
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    return math.isclose(one, other, rel_tol=1e-9) or (math.isnan(one) and math.isnan(other))


@dataclass(frozen=True, slots=True)
class RecordDifference:
    """A parameter whose values are not what the file says; ``elements`` that are not, from 0 on."""

    saved: ListedValues
    found: ListedValues
    elements: tuple[int, ...]

    @property
    def text(self) -> str:
        """One line for people: of an array those elements that differ."""
        saved, found = self.saved, self.found
        if found.unreadable is None and saved.format != found.format:
            return f"{saved.label}: file {saved.text} as {saved.format}, device {found.text} as {found.format}"
        if found.unreadable is not None or max(len(saved.values), len(found.values)) < 2:
            return f"{saved.label}: file {saved.text}, device {found.text}"
        parts = (f"[{at}] file {_element(saved, at)}, device {_element(found, at)}" for at in self.elements)
        return f"{saved.label}: {'; '.join(parts)}"


@dataclass(frozen=True, slots=True)
class RecordComparison:
    """What a compare found. ``same``: how many are equal; ``skipped``: what was not compared, and why."""

    differences: tuple[RecordDifference, ...]
    same: int
    skipped: tuple[tuple[ListedValues, str], ...]


def list_of(told: Mapping[str, Any]) -> RecordList:
    """The list in what the order ``parameters`` told (:mod:`dpstack.api.control.record_commands`)."""
    return RecordList(
        name=told["slave"],
        address=told["address"],
        ident=told["ident"],
        slot=told["slot"],
        object=told["object"],
        time=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        parameters=tuple(ListedValues.from_dict(one) for one in told["parameters"]),
    )


def compared(
    found: RecordList, saved: RecordList, *, read_only: bool = False, where: str | Path = "the list"
) -> RecordComparison:
    """Where the device is not as ``saved``, element by element.

    What is read only is what the device measures or is, and is compared with ``read_only`` alone. Raises ConfigError
    for a list of another type of device.
    """
    if saved.ident != found.ident:
        raise ConfigError(
            f"{where} holds the parameters of {saved.name}, a device of the type 0x{saved.ident:04X}; slave "
            f"{found.address} ({found.name}) is 0x{found.ident:04X}: take a file of such a device"
        )
    there = {one.number: one for one in found.parameters}
    differences: list[RecordDifference] = []
    skipped: list[tuple[ListedValues, str]] = []
    same = 0
    for one in saved.parameters:
        now = there.pop(one.number, None)
        why = _why_skipped(one, now, read_only)
        if now is None or why is not None:
            skipped.append((one, why or "the device does not have it"))
            continue
        elements = one.differences(now)
        if elements or now.unreadable is not None or one.format != now.format:
            differences.append(RecordDifference(one, now, elements))
        else:
            same += 1
    skipped += [(one, "it is not in the file") for one in there.values()]
    return RecordComparison(tuple(differences), same, tuple(skipped))


def _why_skipped(one: ListedValues, now: ListedValues | None, read_only: bool) -> str | None:
    if one.unreadable is not None:
        return f"it could not be read when the file was made: {one.unreadable}"
    if not read_only and (one.read_only or (now is not None and now.read_only)):
        return "it is read only"
    return None


def _element(one: ListedValues, at: int) -> str:
    return ListedValues(number=one.number, values=one.values[at : at + 1]).text
