"""File format of parameter lists: TOML, a head and one line an entry.

There are two kinds: :mod:`dpstack.api.lists.parameter_list` and :mod:`dpstack.api.lists.record_list`.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, NoReturn, Self, TypeVar

from dpstack.api.files import AtomicFile, read_file
from dpstack.errors import ConfigError
from dpstack.profile import ListedParam
from dpstack.toml.reading import MAX_OCTETS, TomlError, quoted, read_toml

_FORMAT: Final = "format = 1"
_ENTRIES: Final = "parameters"

#: a value: a number in its unit, a truth value, a text; octets without another meaning as hex
Element = int | float | bool | str


@dataclass(frozen=True, slots=True, kw_only=True)
class ListEntry(abc.ABC):
    """A parameter of a list. If it could not be read: without values, and ``unreadable`` is the reason.

    ``read_only``: an actual value or a property of the drive. ``KEYS``: the keys of its line in a file, with their
    types (a float may be written as a whole number); ``VALUES``: the keys of its values; ``OMITTED``: keys that the
    line leaves out at these values.
    """

    KEYS: ClassVar[Mapping[str, type]]
    VALUES: ClassVar[tuple[str, ...]]
    OMITTED: ClassVar[Mapping[str, object]]

    number: int
    name: str = ""
    read_only: bool = False
    unreadable: str | None = None

    @property
    @abc.abstractmethod
    def place(self) -> Hashable:
        """The key by which two lists are compared."""

    @property
    @abc.abstractmethod
    def label(self) -> str:
        """Name or number for messages."""

    @property
    def title_label(self) -> str:
        """The label for people, with a title if it has one."""
        return self.label

    def as_dict(self) -> dict[str, Any]:
        """Plain data without absent keys, as in its line of the file."""
        absent = ("unreadable",) if self.unreadable is None else self.VALUES
        plain = {key: getattr(self, key) for key in self.KEYS if key not in absent}
        return {key: value for key, value in plain.items() if key not in self.OMITTED or value != self.OMITTED[key]}


E = TypeVar("E", bound=ListEntry)
#: a parameter of the drive or device
T = TypeVar("T", bound=ListEntry | ListedParam)
D = TypeVar("D", bound="Difference[Any]")


@dataclass(frozen=True, slots=True, kw_only=True)
class SavedList(abc.ABC, Generic[E]):
    """The parameters of one drive or device, and the layout of their file.

    ``PROGRAM``: the command that makes such files; ``COMMENT``: their first line; ``KIND``: the value of ``kind`` in
    the head (None: the head has none); ``HEAD``: the other keys of the head, with their types; ``ENTRY``: the class of
    the entries; ``LINE``: the word for an entry in messages, before its number.
    """

    PROGRAM: ClassVar[str]
    COMMENT: ClassVar[str]
    KIND: ClassVar[str | None] = None
    HEAD: ClassVar[Mapping[str, type]]
    ENTRY: ClassVar[type[ListEntry]]
    LINE: ClassVar[str] = "parameter"

    name: str
    address: int
    time: str
    parameters: tuple[E, ...]
    complete: bool = True

    @classmethod
    @abc.abstractmethod
    def entry(cls, plain: object, where: str) -> E:
        """The parameter of a line. Raises ConfigError naming ``where``."""

    @property
    def who(self) -> tuple[str, ...]:
        """The owner of the list: a file of the same owner may be replaced."""
        return (self.name,)

    @property
    def unreadable(self) -> tuple[E, ...]:
        """The entries that could not be read."""
        return tuple(one for one in self.parameters if one.unreadable is not None)

    # --- the file -----------------------------------------------------------------------------------------------

    def text(self) -> str:
        marks = [_FORMAT] if self.KIND is None else [_FORMAT, f"kind = {quoted(self.KIND)}"]
        head = (f"{key} = {_toml_text(getattr(self, key), key)}" for key in self.HEAD)
        lines = (
            ", ".join(f"{key} = {_toml_text(value)}" for key, value in one.as_dict().items()) for one in self.parameters
        )
        entries = (f"  {{ {line} }}," for line in lines)
        return "\n".join([f"# {self.COMMENT}", *marks, *head, f"{_ENTRIES} = [", *entries, "]", ""])

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a list from a file. Raises ConfigError."""
        try:
            text = read_file(path, MAX_OCTETS).decode("utf-8")
        except UnicodeDecodeError:
            raise ConfigError(f"{path}: not UTF-8 text; {cls._how_to_make()}") from None
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else None
            raise ConfigError(f"{path}: {why or error}; {cls._how_to_make()}") from None
        return cls.parse(text, str(path))

    @classmethod
    def parse(cls, text: str, where: str = "parameters") -> Self:
        """Parse the text of a file. Raises ConfigError naming ``where`` and the entry."""
        try:
            head, _ = read_toml(text)
        except TomlError as error:
            raise ConfigError(f"{where}: no TOML: {error}; {cls._how_to_make()}") from None
        stranger = f"is missing: this is no list of parameters of `{cls.PROGRAM}`"
        if (made := head.pop("format", None)) != 1 or type(made) is not int:
            cls.refuse(where, f"{_FORMAT} {stranger}")
        if cls.KIND is not None and head.pop("kind", None) != cls.KIND:
            cls.refuse(where, f"kind = {quoted(cls.KIND)} {stranger}")
        types = {**cls.HEAD, _ENTRIES: list}
        for key, wanted in types.items():
            if type(head.get(key)) is not wanted:
                cls.refuse(where, f"{key} is missing or of the wrong type")
        if unknown := [key for key in head if key not in types]:
            cls.refuse(where, f"there is no key {unknown[0]!r}")
        lines = enumerate(head.pop(_ENTRIES), 1)
        entries = tuple(cls.entry(line, f"{where}: {cls.LINE} {number}") for number, line in lines)
        seen: set[Hashable] = set()
        for one in entries:
            if one.place in seen:
                cls.refuse(where, f"{one.label} is there twice")
            seen.add(one.place)
        return cls(**head, parameters=entries)

    @classmethod
    def check(cls, entry: object, where: str, needs: Sequence[str]) -> Mapping[str, Any]:
        """Check that ``entry`` has all keys of ``needs`` and no unknown ones. Raises ConfigError naming ``where``."""
        if not isinstance(entry, Mapping):
            cls.refuse(where, "is no table")
        for key, value in entry.items():
            wanted = cls.ENTRY.KEYS.get(key)
            if wanted is None:
                cls.refuse(where, f"there is no key {key!r}; there are {', '.join(cls.ENTRY.KEYS)}")
            if type(value) is not wanted and not (wanted is float and type(value) is int):
                cls.refuse(where, f"{key} = {value!r} is of the wrong type")
        if not all(key in entry for key in needs):
            cls.refuse(where, f"needs {' and '.join(needs)}")
        value = cls.ENTRY.VALUES[0]
        if (value in entry) == ("unreadable" in entry):
            cls.refuse(where, f"needs either {value} or unreadable")
        return entry

    @classmethod
    def refuse(cls, where: str, what: str) -> NoReturn:
        """Raises ConfigError."""
        raise ConfigError(f"{where}: {what}; correct the line, or make the file anew by `{cls.PROGRAM} ... dump`")

    @classmethod
    def _how_to_make(cls) -> str:
        return f"make the file by `{cls.PROGRAM} ... dump`"

    @classmethod
    def file(cls, path: str | Path, *who: str) -> AtomicFile:
        """The file for a list of :attr:`who`. It replaces only an earlier list of the same owner."""

        def is_earlier(there: Path) -> bool:
            try:
                return cls.load(there).who == who
            except ConfigError:
                return False

        return AtomicFile(path, is_earlier, f"earlier dump of {who[-1]}")

    def keep(self, file: AtomicFile) -> Path:
        """Write the list. Returns the path. Raises UsageError."""
        return file.keep(self.text().encode(), complete=self.complete)


@dataclass(frozen=True, slots=True)
class Difference(abc.ABC, Generic[E]):
    """A parameter in a file, ``saved``, and in the drive or device, ``found``."""

    saved: E
    found: E

    @property
    @abc.abstractmethod
    def is_none(self) -> bool:
        """Whether both are readable and equal."""

    @property
    @abc.abstractmethod
    def text(self) -> str:
        """A line for people with both values."""


@dataclass(frozen=True, slots=True)
class ListComparison(Generic[D, E]):
    """Result of a comparison. ``same``: number of equal entries; ``skipped``: entries not compared, with the reason."""

    differences: tuple[D, ...]
    same: int
    skipped: tuple[tuple[E, str], ...]

    @classmethod
    def of(cls, pairs: Sequence[D], skipped: Iterable[tuple[E, str]]) -> ListComparison[D, E]:
        differences = tuple(pair for pair in pairs if not pair.is_none)
        return cls(differences, len(pairs) - len(differences), tuple(skipped))


def pairs_of(
    saved: Iterable[E], there: Mapping[Any, T], as_entry: Callable[[T], E], *, missing: str, read_only: bool
) -> tuple[list[tuple[E, T]], list[tuple[E, str]]]:
    """The entries to compare, each with its counterpart in ``there``, and all others, each with the reason.

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
    """Whether two values are equal, apart from digits that the wire does not have: people may write fewer."""
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    return math.isclose(one, other, rel_tol=1e-9) or (math.isnan(one) and math.isnan(other))


def time_now() -> str:
    """The current time in the format of a list."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def element_text(value: Element) -> str:
    """The text of a value for people."""
    return repr(value) if isinstance(value, str) else _toml_text(value)


def _toml_text(value: object, key: str = "") -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_toml_text, value))}]"
    return quoted(value) if isinstance(value, str) else f"0x{value:04X}" if key == "ident" else repr(value)
