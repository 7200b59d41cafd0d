"""All parameters of a device's own list (record 47, 980 to 989) in a file: TOML, a line a parameter, arrays whole."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn

from dpstack.api.toml_text import quoted
from dpstack.errors import ConfigError
from dpstack.profile.acyclic import ReadParameter

_FORMAT: Final = 1
_KIND: Final = "record 47"
_MAKE: Final = "make the file by `dpstack acyclic ... dump`"
_HEAD: Final[dict[str, tuple[type, ...]]] = {
    "format": (int,),
    "kind": (str,),
    "name": (str,),
    "address": (int,),
    "ident": (int,),
    "slot": (int,),
    "object": (int,),
    "time": (str,),
    "parameters": (list,),
}
_ENTRY: Final[dict[str, tuple[type, ...]]] = {
    "number": (int,),
    "name": (str,),
    "format": (str,),
    "values": (list,),
    "unreadable": (str,),
    "read_only": (bool,),
}

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
        return cls(**{**plain, "values": tuple(plain.get("values", ()))})

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
            "# Parameters of a device; `dpstack acyclic CONFIG ADDRESS compare FILE` tells where a device differs.",
            f"format = {_FORMAT}",
            f"kind = {quoted(_KIND)}",
            f"name = {quoted(self.name)}",
            f"address = {self.address}",
            f"ident = 0x{self.ident:04X}",
            f"slot = {self.slot}",
            f"object = {self.object}",
            f"time = {quoted(self.time)}",
            "parameters = [",
        ]
        return "\n".join([*head, *(one.line() for one in self.parameters), "]", ""])

    @classmethod
    def parse(cls, text: str, where: str = "parameters") -> RecordList:
        """From a file's text. Raises ConfigError naming ``where`` and the parameter."""
        try:
            table = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise ConfigError(f"{where}: no TOML: {error}; {_MAKE}") from None
        if table.get("format") != _FORMAT or table.get("kind") != _KIND:
            _refuse(where, f"kind = {quoted(_KIND)} is missing: this is no list of parameters of `dpstack acyclic`")
        for key, kinds in _HEAD.items():
            if type(table.get(key)) not in kinds:
                _refuse(where, f"{key} is missing or of the wrong type")
        if unknown := [key for key in table if key not in _HEAD]:
            _refuse(where, f"there is no key {unknown[0]!r}")
        entries = tuple(_entry(entry, f"{where}: entry {n}") for n, entry in enumerate(table["parameters"], 1))
        seen: set[int] = set()
        for one in entries:
            if one.number in seen:
                _refuse(where, f"parameter {one.number} is there twice")
            seen.add(one.number)
        head = {key: table[key] for key in ("name", "address", "ident", "slot", "object", "time")}
        return cls(**head, parameters=entries)

    @classmethod
    def load(cls, path: str | Path) -> RecordList:
        """From a file. Raises ConfigError."""
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror or error}; {_MAKE}") from None
        except UnicodeDecodeError:
            raise ConfigError(f"{path}: not UTF-8 text; {_MAKE}") from None
        return cls.parse(text, str(path))


def _entry(entry: object, where: str) -> ListedValues:
    if not isinstance(entry, Mapping):
        _refuse(where, "is no table")
    number = entry.get("number")
    if type(number) is not int:
        _refuse(where, "needs a number")
    where = f"{where} (parameter {number})"
    for key, value in entry.items():
        kinds = _ENTRY.get(key)
        if kinds is None:
            _refuse(where, f"there is no key {key!r}; there are {', '.join(_ENTRY)}")
        if type(value) not in kinds:
            _refuse(where, f"{key} = {value!r} is of the wrong type")
    if ("values" in entry) == ("unreadable" in entry):
        _refuse(where, "needs either values or unreadable")
    for at, value in enumerate(entry.get("values", ())):
        if type(value) not in (int, float, bool, str):
            _refuse(where, f"element {at} of its values, {value!r}, is neither a number nor a text")
    return ListedValues.from_dict(entry)


def _refuse(where: str, what: str) -> NoReturn:
    raise ConfigError(f"{where}: {what}; correct the line, or make the file anew by `dpstack acyclic ... dump`")


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
