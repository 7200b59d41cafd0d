"""``Folders``: the folders whose files an assistant may have read: that of CONFIG, and those of ``--dir``."""

from __future__ import annotations

import os
import stat
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from dpstack.errors import UsageError
from dpstack.text import brief

#: characters of a path
_LONGEST: Final = 1000
#: entries of folders that a list looks at, and folders below a folder
_MOST_ENTRIES: Final = 20_000
_DEEPEST: Final = 8


class Listed(NamedTuple):
    """A file of a list: its path from the named folder on, as tools take it, its size and time of change (s)."""

    name: str
    path: Path
    size: int
    changed: float


class Folders:
    """The named folders, ``given`` as the user wrote them. Raises UsageError for a path that is no folder.

    A name that leads out of them is refused before anything is looked at; one that leads out over a link, before it is
    opened. Hidden files and folders are left out. The message is the same for files outside that exist and that do not.
    """

    def __init__(self, given: Sequence[Path]) -> None:
        self.roots: list[Path] = []
        for folder in given:
            try:
                real = Path(os.path.realpath(folder, strict=True))
                is_folder = real.is_dir()
            except (OSError, ValueError) as error:
                why = getattr(error, "strerror", None) or error
                raise UsageError(f"{folder}: {why}; name a folder that exists") from None
            if not is_folder:
                raise UsageError(f"{folder}: is no folder; name the folder in which the files are")
            if real not in self.roots:
                self.roots.append(real)

    def __str__(self) -> str:
        return ", ".join(map(str, self.roots)) or "none (give CONFIG or --dir DIR)"

    def file(self, name: str, endings: Collection[str]) -> Path:
        """The real path of the file ``name``: from one of the folders on, or absolute within one.

        ``endings``: the suffixes of the tool, in small letters. Raises UsageError.
        """
        path = self._find(name)
        try:
            found = os.stat(path, follow_symlinks=False)
        except OSError:
            raise self._unknown(name) from None
        if not stat.S_ISREG(found.st_mode):
            raise UsageError(f"{brief(name)} is no ordinary file; name one of the list that `files` gives")
        if path.suffix.lower() not in endings:
            raise UsageError(f"{brief(name)}: this tool reads files that end in {', '.join(sorted(endings))}")
        return path

    def place(self, name: str, endings: Collection[str]) -> Path | None:
        """The path of ``name`` where no file of that name exists, in a folder that does; None if it is not within the
        folders. (The parts of a rotated recording stand beside the name that was given.)"""
        if not name or len(name) > _LONGEST or not name.isprintable():
            return None
        for root in self.roots:
            path = Path(os.path.normpath(root / name))
            if not _is_below(path, root) or path.suffix.lower() not in endings:
                continue
            try:
                real = Path(os.path.realpath(path.parent, strict=True)) / path.name
            except (OSError, ValueError):
                continue
            if self.contains(real) and not os.path.lexists(real):
                return real
        return None

    def contains(self, path: str | Path) -> bool:
        """Whether the real ``path`` lies within one of the folders and is not hidden there."""
        return any(_is_below(Path(path), root) for root in self.roots)

    def files(self, endings: Collection[str]) -> Iterator[Listed]:
        """The files with these ``endings``, by name; links are not followed. At most 20000 entries are looked at."""
        left = _MOST_ENTRIES
        for root in self.roots:
            for here, folders, names in os.walk(root):
                left -= len(folders) + len(names)
                deep = len(Path(here).relative_to(root).parts)
                folders[:] = sorted(one for one in folders if not one.startswith(".")) if deep < _DEEPEST else []
                for name in sorted(names):
                    path = Path(here, name)
                    if name.startswith(".") or path.suffix.lower() not in endings:
                        continue
                    try:
                        found = os.stat(path, follow_symlinks=False)
                    except OSError:
                        continue
                    if stat.S_ISREG(found.st_mode):
                        yield Listed(str(path.relative_to(root)), path, found.st_size, found.st_mtime)
                if left <= 0:
                    return

    def _find(self, name: str) -> Path:
        if not name or len(name) > _LONGEST or not name.isprintable():
            raise UsageError("a file has a name of 1 to 1000 printable characters; name one of the list of `files`")
        inside = [path for root in self.roots if _is_below(path := Path(os.path.normpath(root / name)), root)]
        for path in inside:
            try:
                real = Path(os.path.realpath(path, strict=True))
            except (OSError, ValueError):
                continue
            if not self.contains(real):
                raise UsageError(f"{brief(name)} is a link that leads out of the folders of this server: {self}")
            return real
        raise self._unknown(name)

    def _unknown(self, name: str) -> UsageError:
        return UsageError(
            f"{brief(name)} is not in the folders of this server: {self}; `files` lists what is there, `dpstack mcp` "
            f"takes further folders as --dir DIR"
        )


def _is_below(path: Path, root: Path) -> bool:
    """Whether ``path`` lies below ``root``, no part of it hidden."""
    try:
        parts = path.relative_to(root).parts
    except ValueError:
        return False
    return bool(parts) and not any(part.startswith(".") for part in parts)
