"""Modules that only POSIX systems have: ``fcntl``, ``termios``, ``grp``.

On other systems a stand-in replaces the module, so that everything else works; its use raises PortError.
"""

from __future__ import annotations

import contextlib
import importlib
import socket
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from dpstack.errors import PortError

_MISSING: Final[list[str]] = [] if hasattr(socket, "AF_UNIX") else ["Unix sockets"]


def check(what: str) -> None:
    """Raises PortError if this system cannot have ``what``."""
    if _MISSING:
        raise PortError(
            f"{what} needs {', '.join(_MISSING)}, which Python does not have on this system: take Linux or another "
            f"POSIX system for it"
        )


@contextlib.contextmanager
def importing_pyserial(what: str) -> Iterator[None]:
    """Around an import of pyserial, which needs such modules too. Raises PortError if the import fails."""
    try:
        yield
    except ImportError as error:
        raise PortError(
            f"{what} needs {error.name or 'pyserial'}, which Python does not have on this system: take a system that "
            f"has it, or a port socket://host:port"
        ) from None


def is_available() -> bool:
    return not _MISSING


class _StandIn:
    """Stands for a module that this system does not have."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        check(f"{self._name}.{attribute}")
        raise AttributeError(attribute)


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        _MISSING.append(name)
        return _StandIn(name)


if TYPE_CHECKING:
    import fcntl as fcntl
    import grp as grp
    import termios as termios
else:
    fcntl, grp, termios = map(_module, ("fcntl", "grp", "termios"))
