"""The folders of the Wireshark that is there, and the two files of ours in them: dissector and extcap program.

Wireshark up to 4.0 looks for a user's own extcap programs in its configuration folder, newer ones in
~/.local/lib/wireshark/extcap [Wireshark 4.2 release notes]. ``tshark -G folders`` knows both, and the folder of Lua
plugins.
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from enum import Enum
from importlib import resources
from pathlib import Path
from typing import Final

from msgspec import Struct

from dpstack.errors import DpError, UsageError

#: names of the two files as they are installed
LUA_NAME: Final = "dpstack-profibus.lua"
EXTCAP_NAME: Final = "dpstack-profibus"
#: a file of ours has this text in its first octets, see profibus.lua
MARK: Final = b"dpstack wireshark: this file is installed and removed by `dpstack wireshark`"
_MARK_WITHIN: Final = 2000
_HANGS_S: Final = 30
#: from this version on ~/.local/lib/wireshark/extcap
_NEW_PLACE: Final = (4, 2)
#: Linux: octets of the first line of a program; some systems take 127
_LONGEST_FIRST_LINE: Final = 127
_MISSING: Final = (
    "tshark was not found, which says where Wireshark looks for its files; install it (Debian, Ubuntu: "
    "sudo apt-get install tshark), then again: dpstack wireshark"
)


class State(Enum):
    """The state of an installed file."""

    MISSING = "not installed"
    CURRENT = "installed"
    OLD = "installed by another version of dpstack, or for another Python"
    FOREIGN = "there is another file of that name"


class Place(Struct, frozen=True):
    """A file of ours in a folder of Wireshark. ``what``: dissector or extcap."""

    what: str
    path: Path
    content: bytes
    mode: int

    @property
    def state(self) -> State:
        """Raises DpError if it cannot be read."""
        try:
            if not self.path.is_symlink() and not self.path.exists():
                return State.MISSING
            if self.path.is_symlink() or not self.path.is_file():
                return State.FOREIGN
            found = self.path.read_bytes()
        except OSError as error:
            raise DpError(f"{self.path}: {error.strerror or error}") from None
        if MARK not in found[:_MARK_WITHIN]:
            return State.FOREIGN
        return State.CURRENT if found == self.content else State.OLD

    def write(self) -> None:
        """Put the file there at once, as a whole. Raises DpError."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            number, name = tempfile.mkstemp(prefix=".dpstack-", dir=self.path.parent)
        except OSError as error:
            raise DpError(f"{self.path}: {error.strerror or error}") from None
        try:
            with os.fdopen(number, "wb") as file:
                file.write(self.content)
            os.chmod(name, self.mode)
            os.replace(name, self.path)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise DpError(f"{self.path}: {error.strerror or error}") from None


class Wireshark(Struct, frozen=True):
    """The Wireshark that is there. ``lua``, ``extcap``: its folders of the user; ``others``: folders in which other
    versions look for extcap programs."""

    tshark: str
    version: str
    lua: Path
    extcap: Path
    others: tuple[Path, ...]

    @property
    def places(self) -> tuple[Place, Place]:
        """The dissector and the extcap program where this Wireshark looks for them."""
        lua = resources.files("dpstack.wireshark").joinpath("profibus.lua").read_bytes()
        return (
            Place("dissector", self.lua / LUA_NAME, lua, 0o644),
            Place("extcap", self.extcap / EXTCAP_NAME, extcap_program(), 0o755),
        )

    def install(self) -> tuple[Place, Place]:
        """Write both files; a file of an earlier installation is replaced. Raises UsageError if a file of somebody
        else has the name: nothing is written then."""
        places = self.places
        for place in places:
            if place.state is State.FOREIGN:
                raise UsageError(
                    f"{place.path}: there is another file of that name, which dpstack did not write; it stays as it "
                    "is, and nothing was installed: move it away, then install again"
                )
        for place in places:
            place.write()
        return places

    def remove(self) -> tuple[list[Path], list[Path]]:
        """Remove what an installation wrote, also if other versions look. Returns the files that were removed, and
        those of somebody else that were left. Raises DpError."""
        lua, extcap = self.places
        removed, left = [], []
        for folder_place in (lua, extcap, *(Place("extcap", at / EXTCAP_NAME, b"", 0) for at in self.others)):
            state = folder_place.state
            if state is State.FOREIGN:
                left.append(folder_place.path)
            elif state is not State.MISSING:
                try:
                    folder_place.path.unlink()
                except OSError as error:
                    raise DpError(f"{folder_place.path}: {error.strerror or error}") from None
                removed.append(folder_place.path)
        return removed, left


def find_wireshark() -> Wireshark:
    """Ask tshark for its version and folders. Raises DpError if none exists, or it does not answer."""
    tshark = shutil.which("tshark")
    if tshark is None:
        raise DpError(_MISSING)
    folders: dict[str, str] = {}
    for line in _output(tshark, "-G", "folders").splitlines():
        name, _, path = line.partition(":")
        folders.setdefault(name.strip().lower(), path.strip())
    version = re.search(r"\d+\.\d+(?:\.\d+)?", _output(tshark, "--version"))
    lua, configuration = folders.get("personal lua plugins"), folders.get("personal configuration")
    if not lua or not configuration or version is None:
        raise DpError(f"{tshark} does not name its folders (tshark -G folders); is it Wireshark's, and built with Lua?")
    old, new = Path(configuration) / "extcap", Path.home() / ".local" / "lib" / "wireshark" / "extcap"
    numbers = tuple(map(int, version[0].split(".")[:2]))
    named = folders.get("personal extcap path")
    extcap = Path(named) if named else new if numbers >= _NEW_PLACE else old
    others = tuple(place for place in dict.fromkeys((old, new)) if place != extcap)
    return Wireshark(tshark, version[0], Path(lua), extcap, others)


def _output(tshark: str, *arguments: str) -> str:
    try:
        done = subprocess.run(
            [tshark, *arguments], stdin=subprocess.DEVNULL, capture_output=True, timeout=_HANGS_S, check=True
        )
    except subprocess.CalledProcessError as error:
        why = os.fsdecode(error.stderr).strip().splitlines()[-1:] or [f"exit code {error.returncode}"]
        raise DpError(f"{tshark} {' '.join(arguments)}: {why[0]}") from None
    except (OSError, subprocess.TimeoutExpired) as error:
        raise DpError(f"{tshark} {' '.join(arguments)}: {error}") from None
    return os.fsdecode(done.stdout)


def extcap_program() -> bytes:
    """The extcap program as it is installed: begun with this interpreter, and with the folder of this dpstack.

    Raises UsageError if the interpreter has no name.
    """
    if not sys.executable:
        raise UsageError("this Python does not know its own path; start dpstack with a Python that does")
    package = resources.files("dpstack")
    source = package.joinpath("wireshark", "extcap.py").read_text(encoding="utf-8")
    stack = str(Path(str(package)).parent)
    filled = source.replace('\nSTACK = ""\n', f"\nSTACK = {stack!r}\n")
    return f"{_first_lines(sys.executable)}# {MARK.decode()}\n{filled}".encode()


def _first_lines(interpreter: str) -> str:
    """The lines by which the system starts a program with ``interpreter``; long paths and blanks need the shell."""
    line = f"#!{interpreter} -P\n"
    if len(line.encode()) <= _LONGEST_FIRST_LINE and not re.search(r"\s", interpreter):
        return line
    # a string to Python, a command to the shell
    return f"#!/bin/sh\n'''exec' {shlex.quote(interpreter)} -P \"$0\" \"$@\"\n' '''\n"
