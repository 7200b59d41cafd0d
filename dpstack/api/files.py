"""Files: read up to a size limit, written atomically, never over somebody else's file."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final

from dpstack.errors import UsageError

#: flags of os.open for a file that is written
NEW_FILE: Final = os.O_WRONLY | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_KINDS: Final = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def read_file(path: str | Path, most: int) -> bytes:
    """The octets of an ordinary file, at most ``most`` + 1 of them, so that the caller can tell a longer file.

    Raises OSError, also for a directory, a pipe, a socket or a device, which it does not open; ValueError for an
    impossible path.
    """
    _check_ordinary(os.stat(path), path)
    # the name may lead to a pipe by now: O_NONBLOCK keeps open() from waiting for its other end
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


def open_new(path: Path, otherwise: str = "") -> int:
    """Make a file, or take an empty one; its descriptor. ``otherwise``: further advice in place of a device.

    Raises UsageError, also where there is a file of that name already.
    """
    try:
        with contextlib.suppress(FileNotFoundError):
            _check_new(path, os.stat(path), otherwise)  # first: a serial port must not even be opened
        fd = os.open(path, NEW_FILE | getattr(os, "O_NONBLOCK", 0), 0o666)
    except ValueError as error:  # a path with a zero octet
        raise UsageError(f"{path}: {error}; name a file") from None
    except OSError as error:
        why = error.strerror or error
        raise UsageError(f"{path}: cannot be written ({why}); name a file in a directory of yours") from None
    try:
        _check_new(path, os.fstat(fd), otherwise)  # again: it may be another one by now
    except UsageError:
        os.close(fd)
        raise
    return fd


def _check_new(path: Path, found: os.stat_result, otherwise: str) -> None:
    """Raises UsageError where ``path`` is anything but an empty file."""
    if stat.S_ISDIR(found.st_mode):
        raise UsageError(f"{path}: is a directory; name a file")
    if not stat.S_ISREG(found.st_mode):
        raise UsageError(f"{path}: is a device or a pipe; name an ordinary file{otherwise}")
    if found.st_size:
        raise UsageError(f"{path}: there is a file of that name; give the name of a new file")


class AtomicFile:
    """Writes a temporary file and renames it at the end, so that the name never leads to half a file.

    Of a symbolic link the target is written. Devices and pipes are refused. An existing file is replaced only if it is
    empty or ``is_earlier`` accepts it as an earlier file of the same kind; ``what`` names that kind in messages.

    Entering raises UsageError where the file cannot be written, before the caller does any work. Leaving without
    :meth:`keep` writes no file and keeps an existing one.
    """

    def __init__(
        self, path: str | Path, is_earlier: Callable[[Path], bool] | None = None, what: str = "such file"
    ) -> None:
        self.path = Path(path)
        self._is_earlier = is_earlier
        self._what = what
        self._real = Path(os.path.realpath(self.path)) if os.path.islink(self.path) else self.path
        #: path of an incomplete list
        self.part = self._real.parent / f"{self._real.name}.part"
        import secrets  # here, as most programs only read

        self._new = self._real.parent / f".{secrets.token_hex(8)}.tmp"
        self._file: BinaryIO | None = None

    def __enter__(self) -> AtomicFile:
        self._check(self._real, self.path)
        if self._is_earlier is not None:
            self._check(self.part, self.part)
        self._write(b"")
        return self

    def __exit__(self, *_: object) -> None:
        self._remove()

    def keep(self, octets: bytes, *, complete: bool = True) -> Path:
        """Write the file; if not ``complete``, to :attr:`part` instead. Returns the path. Raises UsageError."""
        target, path = (self._real, self.path) if complete else (self.part, self.part)
        self._check(target, path)  # again: the file may be another one by now
        self._write(octets)
        try:
            with contextlib.suppress(OSError):
                os.chmod(self._new, stat.S_IMODE(os.stat(target).st_mode))
            os.replace(self._new, target)
        except OSError as error:
            raise _write_error(path, error) from None
        return path

    def _check(self, target: Path, path: Path) -> None:
        """Raises UsageError where ``target``, called ``path``, may not be written."""
        try:
            found = os.stat(target)
        except FileNotFoundError:
            return
        except ValueError as error:  # a path with a zero octet
            raise UsageError(f"{path}: {error}; name a file") from None
        except OSError as error:  # links in a circle, for instance: a rename would replace one of them
            raise _write_error(path, error) from None
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

    def _write(self, octets: bytes) -> None:
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
            raise _write_error(self.path, error) from None

    def _remove(self) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
            with contextlib.suppress(OSError):
                self._new.unlink()
            self._file = None


def _write_error(path: Path, error: OSError) -> UsageError:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    todo = "make room there, or name a file elsewhere" if full else "name a file in a directory of yours"
    return UsageError(f"{path}: cannot be written ({error.strerror or error}); {todo}")
