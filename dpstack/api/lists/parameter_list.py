"""``ParameterList``: the parameters of a drive in a file: TOML, one line a parameter, fit for `diff`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from dpstack.api.lists.list_file import ListFile, SavedList

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


#: the key of a parameter: its name in lower case, and the data set or the element where there are several
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
        return self.name.lower(), self.data_set, self.index

    @property
    def label(self) -> str:
        return label(self.name, self.data_set, self.index)

    @property
    def title_label(self) -> str:
        return f"{self.label} ({self.title})"

    @property
    def text(self) -> str:
        return value_text(self.value, self.unit)

    def as_dict(self) -> dict[str, Any]:
        """Its line of the file."""
        plain: dict[str, Any] = {"name": self.name, "number": self.number}
        plain |= {"subindex": self.subindex} if self.subindex else {}
        plain |= {} if self.data_set is None else {"data_set": self.data_set}
        plain |= {} if self.index is None else {"index": self.index}
        read = {"value": self.value, "unit": self.unit}
        plain |= read if self.unreadable is None else {"unreadable": self.unreadable}
        return plain | ({"read_only": True} if self.read_only else {}) | {"title": self.title}


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterList(SavedList[SavedParam]):
    """The parameters of one drive. ``drive`` is its type; ``complete``: False where the dump was cut short."""

    FILE = _FILE

    drive: str

    @property
    def who(self) -> tuple[str, ...]:
        return self.drive, self.name

    @classmethod
    def entry(cls, plain: object, where: str) -> SavedParam:
        """A line with a name and a number, and a value or the reason why there is none."""
        if isinstance(plain, Mapping) and type(plain.get("name")) is str:
            where = f"{where} ({plain['name']})"
        told = _FILE.check(plain, where, ("name", "number"))
        if not math.isfinite(told.get("value", 0)):
            _FILE.refuse(where, f"value = {told['value']!r} is of the wrong type")
        return SavedParam(**told)

    def save(self, path: str | Path) -> None:
        """Into a file, whole or not at all; a file that is there must be an earlier list of the same drive.

        Raises UsageError where it cannot be written.
        """
        with self.file(path, *self.who) as file:
            self.keep(file)


def label(name: str, data_set: int | None, index: int | None) -> str:
    """A parameter for people: ``480, data set 3``."""
    place = "" if data_set is None else f", data set {data_set}"
    return f"{name}{place}" + ("" if index is None else f", index {index}")


def value_text(value: float | int | None, unit: str) -> str:
    """A value with its unit, as many digits as it has."""
    return f"{value!r} {unit}".rstrip()
