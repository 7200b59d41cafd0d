"""Ordinary files: read with a limit, written whole or not at all and never over a file of somebody else."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final

from dpstack.errors import UsageError

_KINDS: Final = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def read_file(path: str | Path, most: int) -> bytes:
    """The octets of an ordinary file, ``most`` + 1 of them at the most: so the caller sees that there are more.

    Raises OSError, also for a directory, and for a pipe, a socket or a device, which is not opened; ValueError for a
    path that cannot be.
    """
    _check_ordinary(os.stat(path), path)
    # what the name leads to may change meanwhile: opening it must not wait either
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
    with open(os.open(path, flags), "rb") as file:
        _check_ordinary(os.fstat(file.fileno()), path)
        return file.read(most + 1)


def _check_ordinary(found: os.stat_result, path: str | Path) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, f"is {_kind(found)}, no ordinary file", str(path))


def _kind(found: os.stat_result) -> str:
    return next((name for check, name in _KINDS if check(found.st_mode)), "something else")


class FileToBe:
    """A file that is made aside and takes its name at the end, so that no half of it is ever there under that name.

    A link stays, what it leads to is written; a device or a pipe is refused, whose name would be taken away from it.
    A file that is there is replaced where it is empty or ``is_earlier`` says that it is an earlier one of the same:
    ``what`` names that for people. Nothing else is.

    Entering raises UsageError where it cannot be written: before any work is done. Left without :meth:`keep` there
    is no file, and what stood under the name stays.
    """

    def __init__(
        self, path: str | Path, is_earlier: Callable[[Path], bool] | None = None, what: str = "such file"
    ) -> None:
        self.path = Path(path)
        self._is_earlier = is_earlier
        self._what = what
        self._real = Path(os.path.realpath(self.path)) if os.path.islink(self.path) else self.path
        #: where a list that was cut short is kept
        self.part = self._real.parent / f"{self._real.name}.part"
        self._new = self._real.parent / f".{secrets.token_hex(8)}.tmp"
        self._file: BinaryIO | None = None

    def __enter__(self) -> FileToBe:
        self._check(self._real, self.path)
        if self._is_earlier is not None:
            self._check(self.part, self.part)
        self._writing(b"")
        return self

    def __exit__(self, *_: object) -> None:
        self._remove()

    def keep(self, octets: bytes, *, complete: bool = True) -> Path:
        """Write it; one that is not complete under :attr:`part`, beside an older one that was. Where it is now.

        Raises UsageError.
        """
        target, path = (self._real, self.path) if complete else (self.part, self.part)
        self._check(target, path)  # time has passed
        self._writing(octets)
        try:
            with contextlib.suppress(OSError):
                os.chmod(self._new, stat.S_IMODE(os.stat(target).st_mode))
            os.replace(self._new, target)
        except OSError as error:
            raise _unwritten(path, error) from None
        return path

    def _check(self, target: Path, path: Path) -> None:
        """Raises UsageError where ``target``, called ``path``, may not be written."""
        try:
            found = os.stat(target)
        except FileNotFoundError:
            return
        except ValueError as error:  # a path with a zero octet
            raise UsageError(f"{path}: {error}; name a file") from None
        except OSError as error:  # links that lead to each other, for instance: their names would be taken away
            raise _unwritten(path, error) from None
        if stat.S_ISDIR(found.st_mode):
            raise UsageError(f"{path}: is a directory; name a file")
        if not stat.S_ISREG(found.st_mode):
            raise UsageError(f"{path}: is a device or a pipe; name an ordinary file")
        if self._is_earlier is None:
            raise UsageError(f"{path}: there is a file of that name; give the name of a new file")
        if found.st_size and not self._is_earlier(target):
            raise UsageError(
                f"{path}: there is a file of that name, and it is no {self._what}; move it away, or name another file"
            )

    def _writing(self, octets: bytes) -> None:
        try:
            if self._file is None:
                self._file = self._new.open("xb")
            self._file.write(octets)
            self._file.flush()
            os.fsync(self._file.fileno())
            if octets:
                self._file.close()
        except OSError as error:
            self._remove()
            raise _unwritten(self.path, error) from None

    def _remove(self) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
            with contextlib.suppress(OSError):
                self._new.unlink()
            self._file = None


def _unwritten(path: Path, error: OSError) -> UsageError:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    todo = "make room there, or name a file elsewhere" if full else "name a file in a directory of yours"
    return UsageError(f"{path}: cannot be written ({error.strerror or error}); {todo}")
