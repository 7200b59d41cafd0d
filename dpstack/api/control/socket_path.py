"""Control sockets as files: names, directory, owner of the peer process.

:func:`~dpstack.ports.runtime_dir.open_own` checks the directory. Each socket in it, and the process behind it, has to
belong to this user or to root, who can read and change everything anyway.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
import stat
import struct
import sys
from collections.abc import Iterator
from time import sleep
from typing import Any, Final

from dpstack.errors import PortError
from dpstack.ports import posix
from dpstack.ports.base import VIRTUAL
from dpstack.ports.posix import fcntl
from dpstack.ports.runtime_dir import open_own, runtime_path, user_name

SUFFIX: Final = ".sock"
#: kinds of programs with a second name beside that of the port
OWN_NAMES: Final = frozenset({"run"})
#: names of the runs on the port "virtual", which any number of programs may have: the process, its second bus ...
_VIRTUAL_NAME: Final = re.compile(rf"{VIRTUAL}:(\d{{1,10}}(?:\.\d{{1,6}})?)")
_VIRTUAL_SOCKET: Final = re.compile(rf"{VIRTUAL}-(\d{{1,10}}(?:\.\d{{1,6}})?){re.escape(SUFFIX)}")
#: octets of a socket's path without the final zero (sun_path of Linux; BSD and macOS have 104)
_LONGEST_PATH: Final = 107 if sys.platform == "linux" else 103
#: tries to get a place in the queue of a program, and the pause after each
_QUEUE_TRIES: Final = 50
_QUEUE_PAUSE_S: Final = 0.01
#: struct ucred of unix(7): process, user, group
_UCRED: Final = struct.Struct("iII")
_PEERCRED: Final[int | None] = getattr(socket, "SO_PEERCRED", None) if sys.platform == "linux" else None


def directory() -> str:
    """The directory of all control sockets of this user; it need not exist."""
    return runtime_path("dpstack")


@contextlib.contextmanager
def os_errors(what: str, advice: str = "") -> Iterator[None]:
    """Context manager: raise an OSError as PortError, with its reason after ``what``."""
    try:
        yield
    except PortError:
        raise
    except OSError as exc:
        raise PortError(f"{what} ({exc.strerror or exc}){advice}") from None


def names_of(port: str) -> tuple[str, ...]:
    """The names of a port: as written (absolute), and the device behind links if that is another one."""
    if "://" in port or ("/" not in port and not os.path.exists(port)):
        return (port,)  # a URL, "virtual:4711", COM3
    return tuple(dict.fromkeys((os.path.abspath(port), os.path.realpath(port))))


def own_name(kind: str, name: str) -> str:
    """The name of a program of :data:`OWN_NAMES` beside that of its port."""
    return f"{kind} {name}"


def virtual_name(number: int) -> str:
    """A name for a run on :data:`VIRTUAL`: ``number`` 1 for the first one of this process, which is ``virtual:PID``."""
    return f"{VIRTUAL}:{os.getpid()}" + (f".{number}" if number > 1 else "")


def socket_name(name: str) -> str:
    """The file name of the socket ``name``: readable for runs on "virtual"; others are hashed, as a port is a path."""
    found = _VIRTUAL_NAME.fullmatch(name)
    if found:
        return f"{VIRTUAL}-{found[1]}{SUFFIX}"
    import hashlib  # here, as runs on "virtual" need none

    return hashlib.sha256(os.fsencode(name)).hexdigest()[:16] + SUFFIX


def peer_uid(connection: socket.socket) -> int | None:
    """The user of the process at the other end of a Unix socket; None if the system does not say it."""
    if _PEERCRED is not None:
        return int(_UCRED.unpack(connection.getsockopt(socket.SOL_SOCKET, _PEERCRED, _UCRED.size))[1])
    import ctypes  # here, as Linux says it without

    getpeereid = getattr(_libc(), "getpeereid", None)
    if getpeereid is None:
        return None
    uid, gid = ctypes.c_uint32(), ctypes.c_uint32()
    if getpeereid(connection.fileno(), ctypes.byref(uid), ctypes.byref(gid)):
        raise PortError("who is at the other end of the control socket cannot be found out")
    return uid.value


def _libc() -> Any:
    import ctypes

    return ctypes.CDLL(None)


def is_trusted(uid: int | None) -> bool:
    """Whether to trust processes of user ``uid``: our own user, root, and None (the system does not say it)."""
    return uid is None or uid in (os.geteuid(), 0)


class Sockets:
    """The directory of the control sockets, by an open descriptor: later changes of its path have no effect.

    ``make``: create a missing directory; otherwise FileNotFoundError. Raises PortError if another user could put a
    socket into it, OSError. A context manager. All names here are file names.
    """

    def __init__(self, *, make: bool = False) -> None:
        posix.check("a control socket")
        self.path = directory()
        self._fd = open_own(self.path, make=make)
        self._is_locked = False

    def __enter__(self) -> Sockets:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()

    def close(self) -> None:
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def names(self) -> list[str]:
        """The names of all sockets, and of links to sockets."""
        return sorted(name for name in os.listdir(self._fd) if name.endswith(SUFFIX))

    def virtual_names(self) -> list[str]:
        """The names of all running runs on :data:`VIRTUAL`. Removes the sockets of killed ones."""
        found = [match[1] for match in map(_VIRTUAL_SOCKET.fullmatch, self.names()) if match]
        names = [f"{VIRTUAL}:{one}" for one in found]
        for name in names:
            self.clean(socket_name(name))
        left = self.names()
        return [name for name in names if socket_name(name) in left]

    def link_target(self, name: str) -> str | None:
        """The target of the link ``name``; None if it is no link, or missing."""
        try:
            return os.readlink(name, dir_fd=self._fd)
        except OSError:
            return None

    def link(self, name: str, target: str) -> None:
        """Make ``name`` lead to ``target``."""
        os.symlink(target, name, dir_fd=self._fd)

    def remove(self, name: str) -> None:
        """Remove a socket or a link, if it is there."""
        with contextlib.suppress(FileNotFoundError):
            os.unlink(name, dir_fd=self._fd)

    def bind(self, listening: socket.socket, name: str) -> None:
        """Create a socket of this user. Raises OSError, PortError if its path is too long for this system."""
        listening.bind(self._address(name))
        os.chmod(name, 0o600, dir_fd=self._fd)

    def connect(self, name: str, timeout: float | None) -> socket.socket:
        """A connection to the program behind a socket. Raises OSError if none exists, PortError if the socket
        or the process behind it belongs to another user.
        """
        info = os.stat(name, dir_fd=self._fd)
        where = os.path.join(self.path, name)
        if not stat.S_ISSOCK(info.st_mode) or not is_trusted(info.st_uid):
            raise PortError(
                f"{where} is no socket of yours, it belongs to {user_name(info.st_uid)}: remove it, and find out who "
                f"put it there"
            )
        connection = socket.socket(socket.AF_UNIX)
        try:
            connection.settimeout(timeout)
            self._join_queue(connection, name)
            peer = peer_uid(connection)
            if peer is not None and not is_trusted(peer):
                raise PortError(
                    f"{where}: the program that answers there is not yours, it belongs to {user_name(peer)}; nothing "
                    f"was sent to it: remove that file, and find out who put it there"
                )
        except BaseException:
            connection.close()
            raise
        return connection

    def _join_queue(self, connection: socket.socket, name: str) -> None:
        """Connect. While the queue of the program is full, try again for a short time: the system itself does not wait
        if a socket has a time-out. Raises OSError.
        """
        for _ in range(_QUEUE_TRIES):
            with contextlib.suppress(BlockingIOError):
                connection.connect(self._address(name))
                return
            sleep(_QUEUE_PAUSE_S)
        raise TimeoutError(errno.ETIMEDOUT, "too many clients wait for it; is it stopped or busy?")

    def answers(self, name: str) -> bool:
        """Whether a program listens at the socket ``name``. Raises PortError as :meth:`connect` does."""
        try:
            self.connect(name, 1.0).close()
        except (ConnectionRefusedError, FileNotFoundError):
            return False
        except PortError:
            raise
        except OSError as exc:  # alive but busy: its queue of clients is full
            return isinstance(exc, (TimeoutError, BlockingIOError))
        return True

    def clean(self, name: str) -> None:
        """Remove a socket, or a link to one, without a program behind it."""
        with contextlib.suppress(OSError), self.locked():
            if not self.answers(name):
                self.remove(name)

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Context manager: a lock for removing stale sockets and making new ones. Re-entrant."""
        if self._is_locked:
            yield
            return
        # a new descriptor: a lock of flock() belongs to it
        fd = os.open(".", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC, dir_fd=self._fd)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX)
            self._is_locked = True
            yield
        finally:
            self._is_locked = False
            os.close(fd)

    def _address(self, name: str) -> str:
        """A path for bind and connect, which have no ``dir_fd``: by the descriptor if that works, as this is short
        and leads to the checked directory. Raises PortError if the path is too long.
        """
        by_descriptor = f"/proc/self/fd/{self._fd}"
        with contextlib.suppress(OSError):
            if os.path.samestat(os.stat(by_descriptor), os.fstat(self._fd)):
                return f"{by_descriptor}/{name}"
        path = os.path.join(self.path, name)
        length = len(os.fsencode(path))
        if length > _LONGEST_PATH:
            raise PortError(
                f"{path} has {length} octets, and the path of a socket at most {_LONGEST_PATH} here: set "
                f"XDG_RUNTIME_DIR (or TMPDIR) to a directory with a shorter path"
            )
        return path
