"""The user's runtime directory for sockets and links of running programs, closed to other users.

Another user who can replace a directory on the way there could pose as a program of ours. So :func:`open_own` opens
each directory of the path from ``/`` on and checks its owner and mode. Paths are texts: ``dpstack ctl`` loads no
pathlib.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from typing import TYPE_CHECKING, Final

from dpstack.errors import PortError

if TYPE_CHECKING:
    from pathlib import Path

#: Windows has none of them, and no control socket
_SAFELY: Final[int] = sum(getattr(os, flag, 0) for flag in ("O_DIRECTORY", "O_NOFOLLOW", "O_CLOEXEC"))
#: O_PATH needs no right to read a directory, only to pass through it; systems without it open for reading
_PASS: Final = getattr(os, "O_PATH", os.O_RDONLY) | _SAFELY
_READ: Final = os.O_RDONLY | _SAFELY
#: what open() with O_NOFOLLOW and O_DIRECTORY says of a symbolic link, depending on the system
_LINK_ERRORS: Final = frozenset({errno.ELOOP, errno.ENOTDIR, errno.EMLINK})
#: as many symbolic links as Linux follows
_MOST_LINKS: Final = 40
_TODO: Final = "set XDG_RUNTIME_DIR to a directory that belongs to you, with mode 0700"


def runtime_path(name: str) -> str:
    """``name`` in the user's runtime directory, else in the temporary directory with the user's id. Creates nothing."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and os.path.isdir(runtime):
        return os.path.join(os.path.abspath(runtime), name)
    import tempfile  # here, as it is needed without a runtime directory only

    return os.path.join(tempfile.gettempdir(), f"{name}-{os.geteuid()}")


def own_directory(path: Path) -> bool:
    """Create ``path`` with mode 0700, or check that it is a directory of this user. True when it was created.

    The caller chose this path, so the directories above it are not checked; see :func:`open_own`.
    Raises PortError if it belongs to another user, OSError if it cannot be created.
    """
    try:
        path.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        info = os.lstat(path)
        if stat.S_ISLNK(info.st_mode) or not stat.S_ISDIR(info.st_mode) or info.st_uid != os.geteuid():
            raise PortError(f"{path} is no directory of yours") from None
        return False
    return True


def open_own(path: str, *, make: bool = False) -> int:
    """Open the directory ``path`` (absolute) below the runtime directory, if no other user can have created or can
    replace it.

    Every directory from ``/`` on, and every symbolic link on the way, belongs to root or to this user; nobody else may
    write to one of these directories unless it is sticky. ``path`` itself is no link and is writable by this user only.
    ``make``: create missing directories with mode 0700.

    Returns a file descriptor. Raises PortError that names the directory, its owner and what to do; OSError if a
    directory is missing or cannot be opened.
    """
    left = list(reversed(_parts(path)))
    links = 0
    place, fd = "/", os.open("/", _PASS)
    try:
        _check_owner(os.fstat(fd), place)
        while left:
            name = left.pop()
            last = not left
            try:
                below = _open(name, fd, _READ if last else _PASS, make=make)
            except OSError as exc:
                links += 1
                if exc.errno not in _LINK_ERRORS or links > _MOST_LINKS:
                    raise
                target = _link_target(name, fd, os.path.join(place, name), last=last)
                left += reversed(_parts(target))
                below = os.open("/" if os.path.isabs(target) else ".", _PASS, dir_fd=fd)
                place = "/" if os.path.isabs(target) else place
            else:
                place = os.path.normpath(os.path.join(place, name))
            os.close(fd)
            fd = below
            _check_owner(os.fstat(fd), place, last=last)
    except BaseException:
        os.close(fd)
        raise
    return fd


def _parts(path: str) -> list[str]:
    """The names in ``path``, without ``.``."""
    return [name for name in path.split("/") if name not in ("", ".")]


def user_name(uid: int) -> str:
    """``mallory (uid 1001)``, or just ``uid 1001``."""
    try:
        import pwd  # not on every system

        return f"{pwd.getpwuid(uid).pw_name} (uid {uid})"
    except (ImportError, KeyError):
        return f"uid {uid}"


def _open(name: str, fd: int, flags: int, *, make: bool) -> int:
    try:
        return os.open(name, flags, dir_fd=fd)
    except FileNotFoundError:
        if not make:
            raise
    with contextlib.suppress(FileExistsError):  # another program of ours was quicker, or it is a link to nowhere
        os.mkdir(name, 0o700, dir_fd=fd)
    return os.open(name, flags, dir_fd=fd)


def _link_target(name: str, fd: int, place: str, *, last: bool) -> str:
    """Where the symbolic link ``name`` leads. Raises PortError if it is no link, or one that is not to be followed."""
    info = os.stat(name, dir_fd=fd, follow_symlinks=False)
    if last or not stat.S_ISLNK(info.st_mode):
        kind = "a symbolic link" if stat.S_ISLNK(info.st_mode) else "a file"
        raise PortError(f"{place} is {kind}, and no directory of yours: remove it, or {_TODO}")
    if info.st_uid not in (0, os.geteuid()):
        raise PortError(f"{place} is a symbolic link of {user_name(info.st_uid)}, who may change it: {_TODO}")
    return os.readlink(name, dir_fd=fd)


def _check_owner(info: os.stat_result, place: str, *, last: bool = False) -> None:
    """Raises PortError if another user could put something of his own into the directory or in its place."""
    own = os.geteuid()
    if info.st_uid not in ((own,) if last else (0, own)):
        raise PortError(
            f"{place} is no directory of yours, it belongs to {user_name(info.st_uid)}, who could pose as your "
            f"programs there: {_TODO}"
        )
    mode = stat.S_IMODE(info.st_mode)
    if mode & (stat.S_IWGRP | stat.S_IWOTH) and (last or not mode & stat.S_ISVTX):
        raise PortError(
            f"{place} (owner {user_name(info.st_uid)}, mode {mode:04o}) can be written by others, who could pose as "
            f"your programs there: `chmod go-w {place}`, or {_TODO}"
        )
