"""Files: read up to a size limit, written by one program at a time or atomically, never over somebody else's file.

No link is followed to a file that is written: whoever may write into the folder could lay one to any file of the user.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import operator
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final

from dpstack.errors import UsageError

#: flags of :func:`open_alone` for a new file
NEW_FILE: Final = os.O_WRONLY | os.O_CREAT
#: O_NONBLOCK: the name may lead to a pipe by now
_ALWAYS: Final = functools.reduce(
    operator.or_, (getattr(os, name, 0) for name in ("O_CLOEXEC", "O_BINARY", "O_NOFOLLOW", "O_NONBLOCK", "O_NOCTTY"))
)
#: a link in place of the file
_LINK: Final = "is a link; name the file itself"
_KINDS: Final = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def read_file(path: str | Path, most: int) -> bytes:
    """The octets of an ordinary file, at most ``most`` + 1 of them, so that the caller can recognise a longer file.

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
    if stat.S_ISLNK(found.st_mode):
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, f"is {_kind(found)}, no ordinary file", str(path))


def _kind(found: os.stat_result) -> str:
    return next((name for check, name in _KINDS if check(found.st_mode)), "something else")


def open_alone(path: Path, flags: int, mode: int = 0o666) -> int:
    """``os.open`` for an ordinary file that nobody else writes, in this program or another, while it is open.

    Raises OSError: ELOOP for a link, EBUSY while somebody else writes it; ValueError for an impossible path.
    """
    with contextlib.suppress(FileNotFoundError):
        _check_ordinary(os.lstat(path), path)  # first: a serial port must not even be opened
    fd = os.open(path, flags | _ALWAYS, mode)
    try:
        found = os.fstat(fd)
        _check_ordinary(found, path)  # again: it may be another one by now
        _lock(fd, path, found)
    except BaseException:
        os.close(fd)
        raise
    return fd


def _lock(fd: int, path: Path, found: os.stat_result) -> None:
    from dpstack.ports import posix  # here, as most programs only read

    if not posix.is_available():
        return
    try:
        posix.fcntl.flock(fd, posix.fcntl.LOCK_EX | posix.fcntl.LOCK_NB)
        named = os.lstat(path)
    except (BlockingIOError, FileNotFoundError):  # its writer removes it at its end if it is empty
        named = None
    except OSError:  # a file system without locks
        return
    if named is None or (named.st_dev, named.st_ino) != (found.st_dev, found.st_ino):
        raise OSError(errno.EBUSY, "it is being written already", str(path))


def open_new(path: Path, otherwise: str = "") -> int:
    """Make a file, or take an empty one; its descriptor. ``otherwise``: further advice in place of a device.

    Raises UsageError, also if there is a file of that name already.
    """
    try:
        with contextlib.suppress(FileNotFoundError):
            _check_new(path, os.lstat(path), otherwise)  # first: a serial port must not even be opened
        try:
            fd = open_alone(path, NEW_FILE | os.O_EXCL)
        except FileExistsError:  # an empty one
            fd = open_alone(path, os.O_WRONLY)
    except (ValueError, OSError) as error:
        raise write_error(path, error) from None
    try:
        _check_new(path, os.fstat(fd), otherwise)  # again: it may be another one by now
    except UsageError:
        os.close(fd)
        raise
    return fd


def close_written(fd: int, path: Path) -> bool:
    """Close a file of :func:`open_alone`. True: it had no octet and is removed, while nobody else may write it."""
    is_empty = False
    with contextlib.suppress(OSError):
        if is_empty := not os.fstat(fd).st_size:
            path.unlink()
    with contextlib.suppress(OSError):
        os.close(fd)
    return is_empty


def _check_new(path: Path, found: os.stat_result, otherwise: str) -> None:
    """Raises UsageError if ``path`` is anything but an empty file."""
    _check_writable(path, found, otherwise)
    if found.st_size:
        raise _taken(path)


def _check_writable(path: Path, found: os.stat_result, otherwise: str = "") -> None:
    """Raises UsageError if ``path`` is anything but an ordinary file."""
    if stat.S_ISLNK(found.st_mode):
        raise UsageError(f"{path}: {_LINK}")
    if stat.S_ISDIR(found.st_mode):
        raise UsageError(f"{path}: is a directory; name a file")
    if not stat.S_ISREG(found.st_mode):
        raise UsageError(f"{path}: is a device or a pipe; name an ordinary file{otherwise}")


def _taken(path: Path) -> UsageError:
    return UsageError(f"{path}: there is a file of that name; give the name of a new file")


class AtomicFile:
    """Writes a temporary file and renames it at the end, so that the name never leads to half a file.

    Links, devices and pipes are refused. An existing file is replaced only if it is
    empty or ``is_earlier`` accepts it as an earlier file of the same kind; ``what`` names that kind in messages.

    Entering raises UsageError if the file cannot be written, before the caller does any work. Leaving without
    :meth:`keep` writes no file and keeps an existing one.
    """

    def __init__(
        self, path: str | Path, is_earlier: Callable[[Path], bool] | None = None, what: str = "such file"
    ) -> None:
        self.path = Path(path)
        self._is_earlier = is_earlier
        self._what = what
        #: path of an incomplete list
        self.part = self.path.parent / f"{self.path.name}.part"
        import secrets  # here, as most programs only read

        self._new = self.path.parent / f".{secrets.token_hex(8)}.tmp"
        self._file: BinaryIO | None = None

    def __enter__(self) -> AtomicFile:
        self._check(self.path)
        if self._is_earlier is not None:
            self._check(self.part)
        self._write(b"")
        return self

    def __exit__(self, *_: object) -> None:
        self._remove()

    def keep(self, octets: bytes, *, complete: bool = True) -> Path:
        """Write the file; if not ``complete``, to :attr:`part` instead. Returns the path. Raises UsageError."""
        path = self.path if complete else self.part
        self._check(path)  # again: the file may be another one by now
        self._write(octets)
        try:
            if self._is_earlier is not None or not self._link(path):
                with contextlib.suppress(OSError):
                    os.chmod(self._new, stat.S_IMODE(os.lstat(path).st_mode))
                os.replace(self._new, path)
        except OSError as error:
            raise write_error(path, error) from None
        return path

    def _link(self, path: Path) -> bool:
        """Give the file its name, unless there is a file of that name by now; False if the disk has no links."""
        try:
            os.link(self._new, path)
        except FileExistsError:
            self._check(path)
            raise
        except OSError:
            return False
        return True

    def _check(self, path: Path) -> None:
        """Raises UsageError if ``path`` may not be written."""
        try:
            found = os.lstat(path)
        except FileNotFoundError:
            return
        except (ValueError, OSError) as error:
            raise write_error(path, error) from None
        _check_writable(path, found)
        if self._is_earlier is None:
            raise _taken(path)
        if found.st_size and not self._is_earlier(path):
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
            raise write_error(self.path, error) from None

    def _remove(self) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
            with contextlib.suppress(OSError):
                self._new.unlink()
            self._file = None


def write_error(path: Path, error: OSError | ValueError) -> UsageError:
    """The error of a file that a user named and that cannot be written, with what to do."""
    if isinstance(error, ValueError):  # a path with a zero octet
        return UsageError(f"{path}: {error}; name a file")
    if error.errno == errno.EBUSY:
        return UsageError(f"{path}: it is being written already; name another file")
    if error.errno == errno.ELOOP and path.is_symlink():
        return UsageError(f"{path}: {_LINK}")
    if error.errno == errno.EEXIST:
        return UsageError(f"{path}: {error.strerror}; move it away, or name another file")
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    todo = "make room there, or name a file elsewhere" if full else "name a file in a directory of yours"
    return UsageError(f"{path}: cannot be written ({error.strerror or error}); {todo}")
