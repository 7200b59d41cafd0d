"""A cpio archive in the format "newc", as Linux unpacks it at boot. Several may stand one behind the other."""

from __future__ import annotations

import io
import os
import stat
from pathlib import Path
from typing import IO, Final

_MAGIC: Final = b"070701"


def _padding(size: int) -> bytes:
    return b"\0" * (-size % 4)


class Archive:
    """Collects entries and writes them; folders above an entry are made by themselves."""

    def __init__(self) -> None:
        self._out = io.BytesIO()
        self._number = 0
        self._names: set[str] = set()

    def _entry(self, name: str, mode: int, data: bytes = b"", device: tuple[int, int] = (0, 0)) -> None:
        self._number += 1
        raw = name.encode() + b"\0"
        words = (self._number, mode, 0, 0, 1, 0, len(data), 0, 0, *device, len(raw), 0)
        self._out.write(_MAGIC + b"".join(b"%08X" % word for word in words) + raw + _padding(110 + len(raw)))
        self._out.write(data + _padding(len(data)))

    def has(self, name: str) -> bool:
        return name.strip("/") in self._names

    def folder(self, name: str) -> None:
        parts = name.strip("/").split("/")
        for at in range(1, len(parts) + 1):
            path = "/".join(parts[:at])
            if path and path not in self._names:
                self._names.add(path)
                self._entry(path, stat.S_IFDIR | 0o755)

    def _place(self, name: str) -> str:
        name = name.strip("/")
        self.folder(os.path.dirname(name))
        self._names.add(name)
        return name

    def data(self, name: str, octets: bytes, *, executable: bool = False) -> None:
        self._entry(self._place(name), stat.S_IFREG | (0o755 if executable else 0o644), octets)

    def link(self, name: str, target: str) -> None:
        self._entry(self._place(name), stat.S_IFLNK | 0o777, target.encode())

    def character_device(self, name: str, major: int, minor: int) -> None:
        self._entry(self._place(name), stat.S_IFCHR | 0o600, device=(major, minor))

    def file(self, source: Path, name: str) -> None:
        """The contents of ``source``, with its right to be executed."""
        self.data(name, source.read_bytes(), executable=os.access(source, os.X_OK))

    def write(self, out: IO[bytes]) -> None:
        self._entry("TRAILER!!!", 0)
        out.write(self._out.getvalue())
