"""Where the control socket of a port is: one name for the server and the client."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from dpstack.ports.runtime_dir import own_directory, runtime_path

SUFFIX: Final = ".sock"
#: kinds of programs that are found as such, whoever else is at the same port
OWN_NAMES: Final = frozenset({"run"})


def directory() -> Path:
    """The directory of all control sockets of this user; it need not exist."""
    return runtime_path("dpstack")


def names_of(port: str) -> tuple[str, ...]:
    """The names a port is known by: as written (absolute), and the device behind links where that is another one."""
    if "://" in port or ("/" not in port and not os.path.exists(port)):
        return (port,)  # a URL, "virtual", COM3
    return tuple(dict.fromkeys((os.path.abspath(port), os.path.realpath(port))))


def own_name(kind: str, name: str) -> str:
    """What a program of :data:`OWN_NAMES` is found by besides the name of its port."""
    return f"{kind} {name}"


def socket_path(name: str) -> Path:
    """The socket of one name. Names are hashed: the path of a Unix socket has 107 octets at most."""
    return directory() / (hashlib.sha256(os.fsencode(name)).hexdigest()[:16] + SUFFIX)


def answers(path: Path) -> bool:
    """Whether a program lives behind the socket ``path``."""
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):
            return False
        except OSError as exc:  # alive but busy: its queue of clients is full, or it does not come to accept
            return isinstance(exc, (TimeoutError, BlockingIOError))
    return True


def clean(path: Path) -> None:
    """Remove a socket, or a link to one, that nobody answers at; not one that is just being made."""
    with contextlib.suppress(OSError), locked():
        if not answers(path):
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def locked() -> Iterator[Path]:
    """Make the directory and hold it: who removes stale sockets and makes new ones does it alone.

    Raises PortError where it is somebody else's, OSError where it cannot be made.
    """
    path = directory()
    own_directory(path)
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX)
        yield path
    finally:
        os.close(fd)
