"""All parameters of a device's own list (record 47, 980 to 989) in a file: TOML, a line a parameter, arrays whole."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from dpstack.api.config.toml_text import quoted
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
