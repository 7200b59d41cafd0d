"""Parameters of a drive in a file: TOML, one line a parameter, so that people read it and `diff` shows what changed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dpstack.api.config.toml import quoted
from dpstack.api.files import FileToBe
from dpstack.api.lists.list_file import ListFile, keep
from dpstack.errors import ConfigError

_FILE: Final = ListFile(
    program="dpstack drive",
    comment="Parameters of a drive; `dpstack drive CONFIG NAME compare FILE` tells where a drive differs.",
    head={"drive": str, "name": str, "address": int, "time": str, "complete": bool},
    entry={
        "name": (str,),
        "number": (int,),
        "subindex": (int,),
        "data_set": (int,),
        "index": (int,),
        "value": (int, float),
        "unit": (str,),
        "unreadable": (str,),
        "read_only": (bool,),
        "title": (str,),
    },
    value="value",
)


#: what a parameter is found by: its name in lower case, and the data set or the element where there are several
Place = tuple[str, int | None, int | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class SavedParam:
    """One parameter as it was read: ``value`` in ``unit``, or None with the reason in ``unreadable``."""

    name: str
    number: int
    title: str = ""
    subindex: int = 0
    data_set: int | None = None
    index: int | None = None
    value: float | int | None = None
    unit: str = ""
    read_only: bool = False
    unreadable: str | None = None

    @property
    def place(self) -> Place:
        """What it is found by."""
        return self.name.lower(), self.data_set, self.index

    @property
    def label(self) -> str:
        """For people."""
        return label(self.name, self.data_set, self.index)

    @property
    def text(self) -> str:
        """Value and unit for people."""
        return value_text(self.value, self.unit)

    def line(self) -> str:
        """Its line of the file."""
        parts = [f"name = {quoted(self.name)}", f"number = {self.number}"]
        parts += [f"subindex = {self.subindex}"] if self.subindex else []
        parts += [] if self.data_set is None else [f"data_set = {self.data_set}"]
        parts += [] if self.index is None else [f"index = {self.index}"]
        if self.unreadable is None:
            parts += [f"value = {self.value!r}", f"unit = {quoted(self.unit)}"]
        else:
            parts += [f"unreadable = {quoted(self.unreadable)}"]
        parts += ["read_only = true"] if self.read_only else []
        return "  { " + ", ".join([*parts, f"title = {quoted(self.title)}"]) + " },"


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterList:
    """The parameters of one drive. ``drive`` is its type; ``complete``: False where the dump was cut short."""

    drive: str
    name: str
    address: int
    time: str
    parameters: tuple[SavedParam, ...]
    complete: bool = True

    @property
    def unreadable(self) -> tuple[SavedParam, ...]:
        """Those that could not be read."""
        return tuple(one for one in self.parameters if one.unreadable is not None)

    def text(self) -> str:
        """As it stands in a file."""
        head = [
            f"drive = {quoted(self.drive)}",
            f"name = {quoted(self.name)}",
            f"address = {self.address}",
            f"time = {quoted(self.time)}",
            f"complete = {str(self.complete).lower()}",
        ]
        return _FILE.text(head, (one.line() for one in self.parameters))

    @classmethod
    def parse(cls, text: str, where: str = "parameters") -> ParameterList:
        """From a file's text. Raises ConfigError naming ``where`` and the entry."""
        head, entries = _FILE.parse(text, where)
        params = tuple(_entry(entry, f"{where}: parameter {n}") for n, entry in enumerate(entries, 1))
        _FILE.once(where, ((one.place, one.label) for one in params))
        return cls(**head, parameters=params)

    @classmethod
    def load(cls, path: str | Path) -> ParameterList:
        """From a file. Raises ConfigError."""
        return cls.parse(_FILE.load(path), str(path))

    def save(self, path: str | Path) -> None:
        """Into a file, whole or not at all; a file that is there must be an earlier list of the same drive.

        Raises UsageError where it cannot be written.
        """
        with file_for(path, self.drive, self.name) as file:
            keep(file, self)


def file_for(path: str | Path, drive: str, name: str) -> FileToBe:
    """The file for a list of ``name``, a drive of type ``drive``: no other file than one of the same is replaced."""

    def is_earlier(there: Path) -> bool:
        try:
            found = ParameterList.load(there)
        except ConfigError:
            return False
        return (found.drive, found.name) == (drive, name)

    return FileToBe(path, is_earlier, f"earlier dump of {name}")


def label(name: str, data_set: int | None, index: int | None) -> str:
    """A parameter for people: ``480, data set 3``."""
    place = "" if data_set is None else f", data set {data_set}"
    return f"{name}{place}" + ("" if index is None else f", index {index}")


def value_text(value: float | int | None, unit: str) -> str:
    """A value with its unit, as many digits as it has."""
    return f"{value!r} {unit}".rstrip()


def _entry(entry: object, where: str) -> SavedParam:
    if isinstance(entry, Mapping) and type(entry.get("name")) is str:
        where = f"{where} ({entry['name']})"
    told = _FILE.check(entry, where, ("name", "number"))
    if not math.isfinite(told.get("value", 0)):
        _FILE.refuse(where, f"value = {told['value']!r} is of the wrong type")
    return SavedParam(**told)
