"""File format of parameter lists: TOML, a head and one line an entry.

Its two kinds are in :mod:`dpstack.api.lists.parameter_list` and :mod:`dpstack.api.lists.record_list`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, NoReturn, Protocol, Self, TypeVar

from dpstack.api.config.toml import MAX_OCTETS, TomlError, quoted, read_toml
from dpstack.api.files import FileToBe, read_file
from dpstack.errors import ConfigError

_FORMAT: Final = "format = 1"
_ENTRIES: Final = "parameters"

#: a value: a number in its unit, a truth value, a text; octets that are nothing else as hex
Element = int | float | bool | str


@dataclass(frozen=True, slots=True, kw_only=True)
class ListFile:
    """The layout of one kind of file.

    ``program`` makes them, ``comment`` is their first line; ``kind`` stands in the head and tells what such a file is
    (None: it has none); ``head``: the other keys of the head, ``entry``: those of an entry, with the types they may
    have; ``value``: the key that holds what was read, without which an entry is ``unreadable``.
    """

    program: str
    comment: str
    kind: str | None = None
    head: Mapping[str, type]
    entry: Mapping[str, tuple[type, ...]]
    value: str

    def text(self, head: Iterable[str], entries: Iterable[str]) -> str:
        marks = [_FORMAT] if self.kind is None else [_FORMAT, f"kind = {quoted(self.kind)}"]
        return "\n".join([f"# {self.comment}", *marks, *head, f"{_ENTRIES} = [", *entries, "]", ""])

    def load(self, path: str | Path) -> str:
        """The text of a file. Raises ConfigError."""
        try:
            return read_file(path, MAX_OCTETS).decode("utf-8")
        except UnicodeDecodeError:
            raise ConfigError(f"{path}: not UTF-8 text; {self._make}") from None
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else None
            raise ConfigError(f"{path}: {why or error}; {self._make}") from None

    def parse(self, text: str, where: str) -> tuple[dict[str, Any], list[object]]:
        """Head and entries of a file. Raises ConfigError naming ``where``."""
        try:
            table, _ = read_toml(text)
        except TomlError as error:
            raise ConfigError(f"{where}: no TOML: {error}; {self._make}") from None
        stranger = f"is missing: this is no list of parameters of `{self.program}`"
        if (made := table.pop("format", None)) != 1 or type(made) is not int:
            self.refuse(where, f"{_FORMAT} {stranger}")
        if self.kind is not None and table.pop("kind", None) != self.kind:
            self.refuse(where, f"kind = {quoted(self.kind)} {stranger}")
        kinds = {**self.head, _ENTRIES: list}
        for key, kind in kinds.items():
            if type(table.get(key)) is not kind:
                self.refuse(where, f"{key} is missing or of the wrong type")
        if unknown := [key for key in table if key not in kinds]:
            self.refuse(where, f"there is no key {unknown[0]!r}")
        entries = table.pop(_ENTRIES)
        return table, entries

    def check(self, entry: object, where: str, needs: Sequence[str]) -> Mapping[str, Any]:
        """``entry``, checked: it has all keys of ``needs`` and no unknown ones. Raises ConfigError naming ``where``."""
        if not isinstance(entry, Mapping):
            self.refuse(where, "is no table")
        for key, value in entry.items():
            kinds = self.entry.get(key)
            if kinds is None:
                self.refuse(where, f"there is no key {key!r}; there are {', '.join(self.entry)}")
            if type(value) not in kinds:
                self.refuse(where, f"{key} = {value!r} is of the wrong type")
        if not all(key in entry for key in needs):
            self.refuse(where, f"needs {' and '.join(needs)}")
        if (self.value in entry) == ("unreadable" in entry):
            self.refuse(where, f"needs either {self.value} or unreadable")
        return entry

    def once(self, where: str, entries: Iterable[tuple[object, str]]) -> None:
        """Raises ConfigError where two entries (place, label) have the same place."""
        seen: set[object] = set()
        for place, label in entries:
            if place in seen:
                self.refuse(where, f"{label} is there twice")
            seen.add(place)

    def refuse(self, where: str, what: str) -> NoReturn:
        """Raises ConfigError."""
        raise ConfigError(f"{where}: {what}; correct the line, or make the file anew by `{self.program} ... dump`")

    @property
    def _make(self) -> str:
        return f"make the file by `{self.program} ... dump`"


class Entry(Protocol):
    """One parameter of a list."""

    @property
    def place(self) -> Hashable:
        """The key under which an entry is compared."""

    @property
    def label(self) -> str:
        """Name or number for messages."""

    @property
    def read_only(self) -> bool:
        """True for actual values and properties of the drive."""

    @property
    def unreadable(self) -> str | None:
        """Why it could not be read."""

    def as_dict(self) -> dict[str, Any]:
        """Plain data, without what is not there: its line of the file."""


class ReadOnly(Protocol):
    """A parameter of the drive or device that an entry is compared with."""

    @property
    def read_only(self) -> bool: ...


E = TypeVar("E", bound=Entry)
T = TypeVar("T", bound=ReadOnly)
D = TypeVar("D")


@dataclass(frozen=True, slots=True, kw_only=True)
class SavedList(Generic[E]):
    """The parameters of one drive or device, as a file of the kind ``FILE`` holds them."""

    FILE: ClassVar[ListFile]
    #: an entry in the text of an error, before its number
    LINE: ClassVar[str] = "parameter"

    name: str
    address: int
    time: str
    parameters: tuple[E, ...]
    complete: bool = True

    @classmethod
    def entry(cls, plain: object, where: str) -> E:
        """One parameter from its line. Raises ConfigError naming ``where``."""
        raise NotImplementedError

    @property
    def who(self) -> tuple[str, ...]:
        """The owner of the list: a file of the same owner may be replaced."""
        return (self.name,)

    @property
    def unreadable(self) -> tuple[E, ...]:
        """The entries that could not be read."""
        return tuple(one for one in self.parameters if one.unreadable is not None)

    def text(self) -> str:
        head = (f"{key} = {_toml(getattr(self, key), key)}" for key in self.FILE.head)
        lines = (
            ", ".join(f"{key} = {_toml(value)}" for key, value in one.as_dict().items()) for one in self.parameters
        )
        return self.FILE.text(head, (f"  {{ {line} }}," for line in lines))

    @classmethod
    def parse(cls, text: str, where: str = "parameters") -> Self:
        """From a file's text. Raises ConfigError naming ``where`` and the entry."""
        head, entries = cls.FILE.parse(text, where)
        found = tuple(cls.entry(entry, f"{where}: {cls.LINE} {n}") for n, entry in enumerate(entries, 1))
        cls.FILE.once(where, ((one.place, one.label) for one in found))
        return cls(**head, parameters=found)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """From a file. Raises ConfigError."""
        return cls.parse(cls.FILE.load(path), str(path))

    @classmethod
    def file(cls, path: str | Path, *who: str) -> FileToBe:
        """The file for a list of :attr:`who`: only an earlier list of the same owner is replaced."""

        def is_earlier(there: Path) -> bool:
            try:
                return cls.load(there).who == who
            except ConfigError:
                return False

        return FileToBe(path, is_earlier, f"earlier dump of {who[-1]}")

    def keep(self, file: FileToBe) -> Path:
        """Write it. Returns the path. Raises UsageError."""
        return file.keep(self.text().encode(), complete=self.complete)


@dataclass(frozen=True, slots=True)
class ListComparison(Generic[D, E]):
    """Result of a comparison. ``same``: number of equal entries; ``skipped``: entries not compared, with the reason."""

    differences: tuple[D, ...]
    same: int
    skipped: tuple[tuple[E, str], ...]


def pairs_of(
    saved: Iterable[E], there: Mapping[Any, T], as_entry: Callable[[T], E], *, missing: str, read_only: bool
) -> tuple[list[tuple[E, T]], list[tuple[E, str]]]:
    """The entries to be compared, each with its counterpart in ``there``, and the others with the reason.

    ``missing``: the reason for an entry without counterpart. Read-only entries are compared only with ``read_only``.
    """
    pairs: list[tuple[E, T]] = []
    skipped: list[tuple[E, str]] = []
    places = set()
    for one in saved:
        places.add(one.place)
        now = there.get(one.place)
        if one.unreadable is not None:
            skipped.append((one, f"it could not be read when the file was made: {one.unreadable}"))
        elif now is None:
            skipped.append((one, missing))
        elif not read_only and (one.read_only or now.read_only):
            skipped.append((one, "it is read only"))
        else:
            pairs.append((one, now))
    skipped += [(as_entry(one), "it is not in the file") for place, one in there.items() if place not in places]
    return pairs, skipped


def is_same(one: Element, other: Element) -> bool:
    """Equal to the last digit of the wire: a file keeps every digit of a value, people may write fewer."""
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    return math.isclose(one, other, rel_tol=1e-9) or (math.isnan(one) and math.isnan(other))


def time_now() -> str:
    """As it stands in a list."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def shown(value: Element) -> str:
    """A value for people."""
    return repr(value) if isinstance(value, str) else _toml(value)


def _toml(value: object, key: str = "") -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_toml, value))}]"
    return quoted(value) if isinstance(value, str) else f"0x{value:04X}" if key == "ident" else repr(value)
