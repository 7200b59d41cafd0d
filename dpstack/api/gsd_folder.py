"""The GSD files of a folder: found with limits, listed by ident number, read when they are needed.

A folder is somebody's collection: damaged files, files of other kinds and thousands of files must neither end a program
nor take its memory. A file that cannot be used is listed with the reason.
"""

from __future__ import annotations

import functools
import os
import re
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dpstack.api.files import read_file
from dpstack.api.gsd_info import ENDINGS, bundled, read_gsd
from dpstack.errors import ConfigError, GsdError, UsageError
from dpstack.gsd.model import Device
from dpstack.gsd.search import Found, Query
from dpstack.gsd.text import MAX_OCTETS, decode

#: files that are listed, and entries of folders that are looked at
_MOST_FILES: Final = 2000
_MOST_ENTRIES: Final = 50_000
#: devices that stay in memory, and files with a reason that are listed
_KEPT: Final = 16
_MOST_BAD: Final = 200
#: the lines that name a device; they stand outside of all blocks, near the beginning
_HEAD: Final = re.compile(
    r"^[ \t]*(Ident_Number|Vendor_Name|Model_Name|OrderNumber)[ \t]*=[ \t]*"
    r'(?:"([^"\n]*)"|(0x[0-9a-f]{1,4}|[0-9]{1,5})\b)',
    re.IGNORECASE | re.MULTILINE,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class GsdEntry:
    """One file, or one bundled device. ``key``: its name in a configuration: the path as seen from the folder of the
    configuration, or the name of the bundled device; ``path`` None for a bundled device.
    """

    key: str
    path: Path | None
    ident: int | None
    vendor: str
    model: str
    order_number: str = ""

    def as_dict(self) -> dict[str, object]:
        ident = None if self.ident is None else f"0x{self.ident:04X}"
        return {"gsd": self.key, "ident": ident, "vendor": self.vendor, "model": self.model}


class GsdFolder:
    """The GSD files in ``folder``, and those that come with dpstack.

    ``beside``: the folder of the configuration, from which paths are written. ``deep``: look into the folders in it,
    too. ``also``: further files. Symbolic links that lead out of the folder are not followed. Raises ConfigError if
    ``folder`` is no folder.
    """

    def __init__(
        self, folder: str | Path, *, beside: str | Path | None = None, deep: bool = True, also: Iterable[Path] = ()
    ) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise ConfigError(f"{folder}: this is no folder; give the folder of the plant's GSD files")
        self._beside = Path(self.folder if beside is None else beside).resolve()
        self._deep = deep
        self._also = tuple(also)
        self._entries: dict[str, GsdEntry] = {}
        self._bad: dict[str, str] = {}
        #: what was found in each file, by path, time of change and size
        self._heads: dict[tuple[str, int, int], GsdEntry | str] = {}
        self._devices: OrderedDict[tuple[str, int, int], Device] = OrderedDict()
        self.refresh()

    def refresh(self) -> None:
        """Look again: files may have come, gone or changed. Unchanged files are not read again."""
        self._entries, self._bad = {}, {}
        heads: dict[tuple[str, int, int], GsdEntry | str] = {}
        for path, limit in self._found():
            if limit:
                self._note(str(path), limit)
                break
            try:
                mark = _mark(path)
            except OSError as error:
                self._note(str(path), error.strerror or str(error))
                continue
            head = heads[mark] = self._heads.get(mark) or self._head_of(path)
            if isinstance(head, str):
                self._note(str(path), head)
            else:
                self._entries[head.key] = head
        self._heads = heads
        for name in bundled():
            if not (self._beside / name).exists():  # a configuration prefers the file
                self._entries[name] = _bundled_entry(name)

    @property
    def entries(self) -> tuple[GsdEntry, ...]:
        """The usable files by name, then the bundled devices."""
        return tuple(self._entries.values())

    @property
    def bad(self) -> tuple[tuple[str, str], ...]:
        """(path, reason) of the files that cannot be used, at most 200."""
        return tuple(self._bad.items())

    def with_ident(self, ident: int) -> Iterator[GsdEntry]:
        """The entries with that ident number."""
        return (entry for entry in self._entries.values() if entry.ident == ident)

    def search(self, words: Iterable[str]) -> list[tuple[GsdEntry, Found]]:
        """The devices in which every one of ``words`` is found, the best ones first: see
        :mod:`dpstack.gsd.search`. Files that turn out to be unusable are listed in :attr:`bad`.

        Raises UsageError if no word has a letter or digit.
        """
        query = Query(words)
        if not query:
            raise UsageError("no word to look for; give a vendor, model, order number, ident number or module")
        found = []
        for entry in self.entries:
            try:
                if not self._may_have(entry, query):
                    continue
                device = self.device(entry.key)
            except (OSError, ConfigError) as error:
                self._note(entry.key, getattr(error, "strerror", None) or str(error))
                continue
            match = query.search(device, Path(entry.key).name)
            if match is not None:
                found.append((entry, match))
        return sorted(found, key=lambda one: (-one[1].score, by_language(one[0])))

    def _may_have(self, entry: GsdEntry, query: Query) -> bool:
        if entry.path is None:
            return True
        text, _ = decode(read_file(entry.path, MAX_OCTETS))
        return query.may_be_in(text, entry.ident, entry.order_number, entry.path.name)

    def has(self, name: str) -> bool:
        """Whether ``name`` in a configuration means one of the files or of the bundled devices."""
        if name in self._entries:
            return True
        try:
            path = (self._beside / Path(name).expanduser()).resolve()
        except (OSError, RuntimeError, ValueError):
            return False
        return any(entry.path is not None and entry.path.resolve() == path for entry in self._entries.values())

    def device(self, key: str) -> Device:
        """The device of the entry ``key``. Raises UsageError for another key, ConfigError, GsdError for a file that
        cannot be used (it is then listed in :attr:`bad`, too)."""
        entry = self._entries.get(key)
        if entry is None:
            raise UsageError(f"{key!r} is none of the GSD files in {self.folder}; take one of the list")
        if entry.path is None:
            return read_gsd(entry.key).device
        try:
            mark = _mark(entry.path)
            device = self._devices.get(mark) or read_gsd(entry.path).device
        except (OSError, ConfigError) as error:
            reason = str(error).removeprefix(f"{entry.path}:").strip()
            self._note(str(entry.path), reason)
            raise error if isinstance(error, ConfigError) else GsdError(f"{entry.path}: {reason}") from None
        self._devices[mark] = device
        self._devices.move_to_end(mark)
        if len(self._devices) > _KEPT:
            self._devices.popitem(last=False)
        return device

    def _not_read(self, error: OSError) -> None:
        self._note(str(error.filename), error.strerror or str(error))

    def _note(self, path: str, reason: str) -> None:
        if len(self._bad) < _MOST_BAD:
            self._bad[path] = reason

    def _found(self) -> Iterator[tuple[Path, str]]:
        """The files by name; the last one with a text if a limit was reached."""
        seen = listed = 0
        inside = self.folder.resolve()
        for place, folders, files in os.walk(self.folder, onerror=self._not_read):
            folders[:] = sorted(folders) if self._deep else []
            for name in sorted(files):
                seen += 1
                path = Path(place, name)
                if seen > _MOST_ENTRIES:
                    yield self.folder, f"it has more than {_MOST_ENTRIES} files: name the folder of the GSD files only"
                    return
                if path.suffix.lower() not in ENDINGS:
                    continue
                listed += 1
                if listed > _MOST_FILES:
                    yield self.folder, f"it has more than {_MOST_FILES} GSD files: the rest is left out"
                    return
                if path.is_symlink() and not path.resolve().is_relative_to(inside):
                    self._note(str(path), "a symbolic link that leads out of the folder")
                    continue
                yield path, ""
        for path in self._also:
            yield path, ""

    def _head_of(self, path: Path) -> GsdEntry | str:
        """The entry of the file, or the reason why it cannot be used."""
        try:
            key = os.path.relpath(path.resolve(), self._beside)
            key.encode()
            octets = read_file(path, MAX_OCTETS)
        except UnicodeEncodeError:
            return "its name is no Unicode text, so that no configuration can hold it; rename it"
        except (OSError, ValueError) as error:
            return getattr(error, "strerror", None) or str(error)
        text, _ = decode(octets)
        head: dict[str, str] = {match[1].lower(): match[2] or match[3] for match in _HEAD.finditer(text)}
        if len(octets) <= MAX_OCTETS and re.fullmatch("0[xX][0-9a-fA-F]+|[0-9]+", head.get("ident_number") or ""):
            number = head["ident_number"]
            ident = int(number, 16 if number[:2].lower() == "0x" else 10)
            vendor, model = head.get("vendor_name") or "", head.get("model_name") or ""
            order_number = head.get("ordernumber") or ""
        else:
            try:
                device = read_gsd(path).device  # the parser reads what the search does not, and knows the reason
            except ConfigError as error:
                return str(error).removeprefix(f"{path}:").strip()
            if device.ident is None:
                return "it has no Ident_Number"
            ident, vendor, model, order_number = device.ident, device.vendor, device.model, device.order_number
        return GsdEntry(
            key=Path(key).as_posix(), path=path, ident=ident, vendor=vendor, model=model, order_number=order_number
        )


def by_language(entry: GsdEntry) -> tuple[str, int, str]:
    """For sorting: by name, of one name the file without a language (.gsd) and the English one (.gse) first."""
    path = Path(entry.key)
    ending = path.suffix.lower()
    return path.with_suffix("").as_posix().casefold(), (".gsd", ".gse", ending).index(ending), ending


def _mark(path: Path) -> tuple[str, int, int]:
    found = path.stat()
    return str(path), found.st_mtime_ns, found.st_size


@functools.cache
def _bundled_entry(name: str) -> GsdEntry:
    device = read_gsd(name).device
    return GsdEntry(key=name, path=None, ident=device.ident, vendor=device.vendor, model=device.model)
