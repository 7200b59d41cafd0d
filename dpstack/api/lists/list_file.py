"""A list of parameters as a file: TOML, a head and one line an entry, read with every doubt named, written whole.

What the lists hold is in :mod:`dpstack.api.lists.parameter_list` and :mod:`dpstack.api.lists.record_list`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn, Protocol

from dpstack.api.config.toml import MAX_OCTETS, TomlError, quoted, read_toml
from dpstack.api.files import FileToBe, read_file
from dpstack.errors import ConfigError

_FORMAT: Final = "format = 1"
_ENTRIES: Final = "parameters"


@dataclass(frozen=True, slots=True, kw_only=True)
class ListFile:
    """What files of one kind are made of.

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
        """The file, from lines."""
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
        """``entry`` with what it ``needs``, and nothing that there is not. Raises ConfigError naming ``where``."""
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
        """Raises ConfigError where two entries, each what it is found by and its label, are the same."""
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


class Kept(Protocol):
    """A list that is written into a file."""

    @property
    def complete(self) -> bool:
        """False where it was cut short."""

    def text(self) -> str:
        """As it stands in the file."""


def keep(file: FileToBe, found: Kept) -> Path:
    """Write ``found``. Where it is now. Raises UsageError."""
    return file.keep(found.text().encode(), complete=found.complete)
