"""A list of parameters as a file: TOML, a head and one line an entry, read with every doubt named, written whole.

What the lists hold is in :mod:`dpstack.api.parameter_list` and :mod:`dpstack.api.record_list`.
"""

from __future__ import annotations

import contextlib
import errno
import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn, Protocol

from dpstack.api.toml_text import quoted
from dpstack.errors import ConfigError, UsageError

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
            return Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror or error}; {self._make}") from None
        except UnicodeDecodeError:
            raise ConfigError(f"{path}: not UTF-8 text; {self._make}") from None

    def parse(self, text: str, where: str) -> tuple[dict[str, Any], list[object]]:
        """Head and entries of a file. Raises ConfigError naming ``where``."""
        try:
            table = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
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


def _unwritten(path: Path, error: OSError) -> UsageError:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    todo = "make room there, or name a file elsewhere" if full else "name a file in a directory of yours"
    return UsageError(f"{path}: cannot be written ({error.strerror or error}); {todo}")
