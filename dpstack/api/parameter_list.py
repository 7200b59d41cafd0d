"""Parameters of a drive in a file: TOML, one line a parameter, so that people read it and `diff` shows what changed."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NoReturn, Protocol

from dpstack.api.toml_text import quoted
from dpstack.errors import ConfigError, UsageError

_FORMAT: Final = 1
_HEAD: Final[dict[str, type]] = {
    "format": int,
    "drive": str,
    "name": str,
    "address": int,
    "time": str,
    "complete": bool,
    "parameters": list,
}
_ENTRY: Final[dict[str, tuple[type, ...]]] = {
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
}


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
            "# Parameters of a drive; `dpstack drive CONFIG NAME compare FILE` tells where a drive differs.",
            f"format = {_FORMAT}",
            f"drive = {quoted(self.drive)}",
            f"name = {quoted(self.name)}",
            f"address = {self.address}",
            f"time = {quoted(self.time)}",
            f"complete = {str(self.complete).lower()}",
            "parameters = [",
        ]
        return "\n".join([*head, *(one.line() for one in self.parameters), "]", ""])

    @classmethod
    def parse(cls, text: str, where: str = "parameters") -> ParameterList:
        """From a file's text. Raises ConfigError naming ``where`` and the entry."""
        try:
            table = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise ConfigError(f"{where}: no TOML: {error}; make the file by `dpstack drive ... dump`") from None
        if table.get("format") != _FORMAT:
            _refuse(where, f"format = {_FORMAT} is missing: this is no list of parameters that dpstack can read")
        for key, kind in _HEAD.items():
            if type(table.get(key)) is not kind:
                _refuse(where, f"{key} is missing or of the wrong type")
        if unknown := [key for key in table if key not in _HEAD]:
            _refuse(where, f"there is no key {unknown[0]!r}")
        entries = tuple(_entry(entry, f"{where}: parameter {n}") for n, entry in enumerate(table["parameters"], 1))
        seen: set[Place] = set()
        for one in entries:
            if one.place in seen:
                _refuse(where, f"{one.label} is there twice")
            seen.add(one.place)
        head = {key: table[key] for key in ("drive", "name", "address", "time", "complete")}
        return cls(**head, parameters=entries)

    @classmethod
    def load(cls, path: str | Path) -> ParameterList:
        """From a file. Raises ConfigError."""
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror or error}; make the file by `dpstack drive ... dump`") from None
        except UnicodeDecodeError:
            raise ConfigError(f"{path}: not UTF-8 text; make the file by `dpstack drive ... dump`") from None
        return cls.parse(text, str(path))

    def save(self, path: str | Path) -> None:
        """Into a file, whole or not at all. Raises UsageError where it cannot be written."""
        with FileToBe(path) as file:
            file.keep(self)


class Kept(Protocol):
    """A list that is written into a file."""

    @property
    def complete(self) -> bool:
        """False where it was cut short."""

    def text(self) -> str:
        """As it stands in the file."""


class FileToBe:
    """A file that is made aside and takes its name at the end, so that no half of it is ever there under that name.

    A link stays, what it leads to is written; a device or a pipe is refused, whose name would be taken away from it.

    Entering raises UsageError where it cannot be written: before any work is done. Left without :meth:`keep` there
    is no file, and what stood under the name stays.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._real = Path(os.path.realpath(self.path)) if self.path.is_symlink() else self.path
        #: where a list that was cut short is kept
        self.part = self._real.with_name(self._real.name + ".part")
        self._new = self._real.with_name(f".{self._real.name}.{os.getpid()}")

    def __enter__(self) -> FileToBe:
        if self.path.is_dir():
            raise UsageError(f"{self.path}: is a directory; name a file")
        if self.path.exists() and not self.path.is_file():
            raise UsageError(f"{self.path}: is a device or a pipe; name an ordinary file")
        self._writing("")
        return self

    def __exit__(self, *_exc: object) -> None:
        self._new.unlink(missing_ok=True)

    def keep(self, found: Kept) -> Path:
        """Write it; one that is not complete under :attr:`part`, beside an older one that was. Where it is now."""
        path = self.path if found.complete else self.part
        self._writing(found.text())
        try:
            os.replace(self._new, self._real if found.complete else self.part)
        except OSError as error:
            raise _unwritten(path, error) from None
        return path

    def _writing(self, text: str) -> None:
        try:
            with self._new.open("w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            with contextlib.suppress(OSError):
                self._new.unlink(missing_ok=True)
            raise _unwritten(self.path, error) from None


def label(name: str, data_set: int | None, index: int | None) -> str:
    """A parameter for people: ``480, data set 3``."""
    place = "" if data_set is None else f", data set {data_set}"
    return f"{name}{place}" + ("" if index is None else f", index {index}")


def value_text(value: float | int | None, unit: str) -> str:
    """A value with its unit, as many digits as it has."""
    return f"{value!r} {unit}".rstrip()


def _entry(entry: object, where: str) -> SavedParam:
    if not isinstance(entry, Mapping):
        _refuse(where, "is no table")
    for key, value in entry.items():
        kinds = _ENTRY.get(key)
        if kinds is None:
            _refuse(where, f"there is no key {key!r}; there are {', '.join(_ENTRY)}")
        if type(value) not in kinds or (isinstance(value, float) and not math.isfinite(value)):
            _refuse(where, f"{key} = {value!r} is of the wrong type")
    if "name" not in entry or "number" not in entry:
        _refuse(where, "needs name and number")
    if ("value" in entry) == ("unreadable" in entry):
        _refuse(where, f"{entry['name']} needs either value or unreadable")
    return SavedParam(**entry)


def _refuse(where: str, what: str) -> NoReturn:
    raise ConfigError(f"{where}: {what}; correct the line, or make the file anew by `dpstack drive ... dump`")


def _unwritten(path: Path, error: OSError) -> UsageError:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    todo = "make room there, or name a file elsewhere" if full else "name a file in a directory of yours"
    return UsageError(f"{path}: cannot be written ({error.strerror or error}); {todo}")
