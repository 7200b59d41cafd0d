"""``Fence``: a second wall around the server for assistants, by the audit events of Python.

The tools name no file outside the folders, start no program and write nothing. The fence refuses it all the same,
whoever tries: a configuration in the folder that names a GSD file elsewhere, a package, a defect. It cannot be taken
down again in the process. It sees the paths that Python code opens, not those of compiled packages (Parquet files).
"""

from __future__ import annotations

import os
import re
import site
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import dpstack
from dpstack.cli.assistants.docs_search import docs_folder
from dpstack.cli.assistants.folders import Folders

#: a handle of a folder, by which control sockets are found; its names are no contents
_FOLDER: Final = getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_PATH", 0)
#: other systems have no port that is opened for reading only
_LISTENS_BY_WRITING: Final = sys.platform != "linux"
_WRITING: Final = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
#: never needed here
_REFUSED: Final = re.compile(
    r"subprocess\.Popen|pty\.spawn|shutil\..*|socket\.(bind|sendto|sendmsg)|sqlite3\.connect|webbrowser\.open|"
    r"os\.(system|exec|fork|forkpty|posix_spawn|spawn|startfile|kill|rename|rmdir|mkdir|truncate|chmod|chown|chflags|link|"
    r"symlink|setxattr|removexattr|utime|putenv|unsetenv)"
)
_READING: Final = frozenset(("os.listdir", "os.scandir"))
#: facts about adapters and time zones; nothing of a user
_SYSTEM: Final = ("/sys", "/usr/share/zoneinfo", "/proc/self/fd", "/proc/mounts", "/proc/devices", "/dev/serial")
_DEVICES: Final = (os.devnull, "/dev/urandom", "/etc/localtime", "/dev")
_CLOSED: Final = "is outside the folders that `dpstack mcp` may read"


class Fence:
    """``port``: the one port that may be opened, for reading only; of a URL, connections to its TCP port are possible.
    ``sockets``: the folder of control sockets."""

    def __init__(self, folders: Folders, port: str | None, sockets: str) -> None:
        self._folders = folders
        is_url = port is not None and "://" in port
        self._tcp_port = urlsplit(port).port if port is not None and is_url else None
        self._port = None if port is None or is_url else os.path.realpath(port)
        self._sockets = os.path.realpath(sockets)
        self._libraries = tuple(sorted({os.path.realpath(one) for one in _library_folders()}))

    def install(self) -> None:
        """From now on, for the whole process."""
        sys.dont_write_bytecode = True
        sys.addaudithook(self._look)

    def _look(self, event: str, args: tuple[Any, ...]) -> None:
        if event == "open":
            self._open(args[0], args[2] or 0)
        elif event in _READING:
            self._open("." if args[0] is None else args[0], 0)
        elif _REFUSED.fullmatch(event):
            raise PermissionError(13, f"{event}: `dpstack mcp` only reads")
        elif event == "socket.connect":
            self._connect(args[1])
        elif event == "socket.getaddrinfo" and self._tcp_port is None:
            raise PermissionError(13, "`dpstack mcp` connects to no other computer")
        elif event == "os.remove" and not str(args[0]).endswith(".sock"):  # that of a program that has ended
            raise PermissionError(13, f"{event}: `dpstack mcp` only reads", str(args[0]))

    def _open(self, path: object, flags: int) -> None:
        if not isinstance(path, (str, bytes, os.PathLike)):
            return  # a descriptor, which was opened before
        real = os.path.realpath(os.fsdecode(path))
        if real == os.devnull or (real == self._port and (not flags & _WRITING or _LISTENS_BY_WRITING)):
            return
        if not flags & _WRITING and (flags & _FOLDER or self._may_be_read(real)):
            return
        raise PermissionError(13, _CLOSED, os.fsdecode(path))

    def _may_be_read(self, real: str) -> bool:
        if self._folders.contains(real) or Path(real) in self._folders.roots or real in _DEVICES:
            return True
        return any(_is_in(real, folder) for folder in (*self._libraries, *_SYSTEM, self._sockets))

    def _connect(self, address: object) -> None:
        if isinstance(address, (str, bytes)):
            folder = os.path.dirname(os.path.realpath(os.fsdecode(address)))
            if folder == self._sockets or os.fsdecode(address).startswith("/proc/self/fd/"):
                return
        elif isinstance(address, tuple) and self._tcp_port is not None and self._tcp_port in address[1:2]:
            return
        raise PermissionError(13, "`dpstack mcp` connects to running programs of dpstack only")


def _is_in(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)


def _library_folders() -> Iterable[str]:
    """The folders of Python and of installed packages."""
    yield from (sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib"))
    yield from site.getsitepackages()
    yield site.getusersitepackages()
    yield str(Path(dpstack.__file__).parent)
    if (docs := docs_folder()) is not None:
        yield str(docs)
    for name, module in list(sys.modules.items()):
        if name.startswith("__editable__"):  # packages that are installed where they are written
            yield from getattr(module, "MAPPING", {}).values()
