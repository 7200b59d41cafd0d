"""Control sockets and other users of the same computer: nobody can pose as a program of ours, or give it orders.

As root the other user is real: files are given to him, and his programs run with his uid. Without root's rights his uid
is put into what the system tells.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from control_kit import socket_of

from dpstack.api.control import socket_path
from dpstack.api.control.client import ControlClient, connect, find_run, running
from dpstack.api.control.commands import COMMON
from dpstack.api.control.control_server import ControlServer
from dpstack.errors import PortError
from dpstack.ports.runtime_dir import open_own, user_name

#: "nobody" on most systems; nothing but a number here
MALLORY = 65534
ROOT = os.geteuid() == 0


class Owners:
    """Gives files to the other user."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self._given: set[tuple[int, int]] = set()
        if not ROOT:
            for name in ("stat", "fstat"):
                patch.setattr(os, name, self._telling(getattr(os, name)))

    def give(self, path: Path) -> None:
        if ROOT:
            os.chown(path, MALLORY, MALLORY, follow_symlinks=False)
        else:
            info = os.lstat(path)
            self._given.add((info.st_dev, info.st_ino))

    def _telling(self, real: Any) -> Any:
        def told(*args: Any, **options: Any) -> os.stat_result:
            info: os.stat_result = real(*args, **options)
            if (info.st_dev, info.st_ino) not in self._given:
                return info
            return os.stat_result((*info[:4], MALLORY, MALLORY, *info[6:]))

        return told


@pytest.fixture
def owners(monkeypatch: pytest.MonkeyPatch) -> Owners:
    return Owners(monkeypatch)


def server() -> ControlServer:
    return ControlServer("run", "COM3", COMMON, {"status": lambda _: {"fine": True}})


async def refused() -> str:
    """The message of both ends, which is the same."""
    with pytest.raises(PortError) as at_server:
        await server().__aenter__()
    with pytest.raises(PortError) as at_client:
        connect("COM3")
    assert str(at_client.value) == str(at_server.value)
    with pytest.raises(PortError):  # of `drive` and `acyclic`: nothing goes anywhere, and no second master begins
        find_run("COM3", None)
    with pytest.raises(PortError):
        running()
    return str(at_client.value)


# --- directories ---------------------------------------------------------------------------------------------------


@pytest.fixture
def sticky(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A temporary directory that everybody may write to, as /tmp."""
    path = tmp_path / "tmp"
    path.mkdir()
    path.chmod(0o1777)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("TMPDIR", str(path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return path


async def test_a_directory_that_another_user_has_planted_in_the_temporary_directory(
    sticky: Path, owners: Owners
) -> None:
    planted = sticky / f"dpstack-{os.geteuid()}"
    planted.mkdir(mode=0o755)
    owners.give(planted)
    assert await refused() == (
        f"{planted} is no directory of yours, it belongs to {user_name(MALLORY)}, who could pose as your programs "
        "there: set XDG_RUNTIME_DIR to a directory that belongs to you, with mode 0700"
    )


async def test_a_sticky_directory_is_as_good_as_any_for_a_directory_of_ours(sticky: Path) -> None:
    async with server():
        told = await asyncio.to_thread(running)
    assert [one["port"] for one in told] == ["COM3"]
    assert (sticky / f"dpstack-{os.geteuid()}").stat().st_mode & 0o777 == 0o700


async def test_a_temporary_directory_in_a_directory_of_another_user(
    tmp_path: Path, sticky: Path, owners: Owners
) -> None:
    owners.give(tmp_path)
    assert (await refused()).startswith(f"{tmp_path} is no directory of yours, it belongs to {user_name(MALLORY)}, ")


async def test_a_runtime_directory_of_another_user(runtime: Path, owners: Owners) -> None:
    """As with `sudo -E`, or after `su`: XDG_RUNTIME_DIR is still that of somebody else."""
    owners.give(runtime)
    assert (await refused()).startswith(f"{runtime} is no directory of yours, it belongs to {user_name(MALLORY)}, ")


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o1777])
async def test_a_directory_of_ours_that_others_can_write_to(runtime: Path, mode: int) -> None:
    """Sticky is not enough for the one with the sockets: a name that is free there could be taken."""
    place = runtime / "dpstack"
    place.mkdir()
    place.chmod(mode)
    assert await refused() == (
        f"{place} (owner {user_name(os.geteuid())}, mode {mode:04o}) can be written by others, who could pose as your "
        f"programs there: `chmod go-w {place}`, or set XDG_RUNTIME_DIR to a directory that belongs to you, with mode "
        "0700"
    )


async def test_a_directory_on_the_way_that_others_can_write_to(runtime: Path) -> None:
    """Other users could move our directory away and put another one there."""
    (runtime / "dpstack").mkdir(mode=0o700)
    runtime.chmod(0o777)
    assert (await refused()).startswith(
        f"{runtime} (owner {user_name(os.geteuid())}, mode 0777) can be written by others"
    )


async def test_links_on_the_way(runtime: Path, owners: Owners, monkeypatch: pytest.MonkeyPatch) -> None:
    """Our own links are followed (/tmp of macOS is a link of root); a link of another user is refused."""
    links = runtime / "links"
    links.mkdir()
    (links / "way").symlink_to("../real/../real")
    (runtime / "real").mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(links / "way"))
    async with server():
        assert len(await asyncio.to_thread(running)) == 1
        assert (runtime / "real" / "dpstack").is_dir()
    owners.give(links / "way")
    assert (await refused()).startswith(
        f"{links / 'way'} is a symbolic link of {user_name(MALLORY)}, who may change it: "
    )


async def test_the_directory_itself_is_no_link(runtime: Path) -> None:
    (runtime / "elsewhere").mkdir(mode=0o700)
    (runtime / "dpstack").symlink_to("elsewhere")
    assert (await refused()).startswith(
        f"{runtime / 'dpstack'} is a symbolic link, and no directory of yours: remove it"
    )
    (runtime / "dpstack").unlink()
    (runtime / "dpstack").write_text("", encoding="ascii")
    assert (await refused()).startswith(f"{runtime / 'dpstack'} is a file, and no directory of yours: remove it")


def test_links_that_lead_in_a_circle_end(runtime: Path) -> None:
    (runtime / "a").symlink_to("b")
    (runtime / "b").symlink_to("a")
    with pytest.raises(OSError, match=r"Too many levels|Not a directory"):
        open_own(str(runtime / "a" / "dpstack"), make=True)


async def test_the_directory_is_the_one_that_was_checked(runtime: Path) -> None:
    """Later changes of the path do not lead to another program."""
    with socket_path.Sockets(make=True) as sockets:
        (runtime / "dpstack").rename(runtime / "away")
        (runtime / "dpstack").mkdir(mode=0o700)
        with socket.socket(socket.AF_UNIX) as planted, socket.socket(socket.AF_UNIX) as ours:
            planted.bind(str(runtime / "dpstack" / "a.sock"))
            planted.listen(1)
            with pytest.raises(FileNotFoundError):
                sockets.connect("a.sock", 1.0)
            sockets.bind(ours, "b.sock")
        assert sockets.names() == ["b.sock"]
    assert (runtime / "away" / "b.sock").is_socket()


# --- sockets and peers ---------------------------------------------------------------------------------------------


async def test_a_socket_of_another_user_in_our_directory(runtime: Path, owners: Owners) -> None:
    (runtime / "dpstack").mkdir(mode=0o700)
    path = socket_of("COM3")
    with socket.socket(socket.AF_UNIX) as planted:
        planted.bind(str(path))
        planted.listen(1)
        owners.give(path)
        with pytest.raises(PortError) as caught:
            connect("COM3")
        assert str(caught.value) == (
            f"{path} is no socket of yours, it belongs to {user_name(MALLORY)}: remove it, and find out who put "
            "it there"
        )


#: answers any order with "done", as the other user
POSING = f"""
import os, socket, sys
listening = socket.socket(fileno=int(sys.argv[1]))
if os.geteuid() == 0:
    os.setgroups([]); os.setgid({MALLORY}); os.setuid({MALLORY})
listening.listen(4)
print("listening", flush=True)
connection, _ = listening.accept()
with connection:
    print(repr(connection.recv(1000)), flush=True)
    try:
        connection.sendall(b'{{"ok":true,"result":null}}\\n')
    except OSError:
        pass
"""

#: gives an order, as the other user
ORDERING = f"""
import os, socket, sys
os.fchdir(int(sys.argv[1]))
if os.geteuid() == 0:
    os.setgroups([]); os.setgid({MALLORY}); os.setuid({MALLORY})
with socket.socket(socket.AF_UNIX) as connection:
    connection.connect(sys.argv[2])
    try:
        connection.sendall(b'{{"command":"status"}}\\n')
    except OSError:
        pass
    print(connection.recv(1000).decode(), flush=True)
"""


@contextlib.contextmanager
def program(text: str, *args: object, keep: int) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-c", text, *map(str, args)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, pass_fds=(keep,)) as started:
        try:
            yield started
        finally:
            started.kill()


def test_a_program_of_another_user_behind_our_socket_is_told_nothing(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not ROOT:
        monkeypatch.setattr(socket_path, "peer_uid", lambda _connection: MALLORY)
    (runtime / "dpstack").mkdir(mode=0o700)
    path = socket_of("COM3")
    with socket.socket(socket.AF_UNIX) as planted:
        planted.bind(str(path))
        with program(POSING, planted.fileno(), keep=planted.fileno()) as posing:
            assert posing.stdout is not None
            assert posing.stdout.readline() == "listening\n"
            with pytest.raises(PortError) as caught:
                connect("COM3")
            assert str(caught.value) == (
                f"{path}: the program that answers there is not yours, it belongs to {user_name(MALLORY)}; nothing was "
                "sent to it: remove that file, and find out who put it there"
            )
            assert posing.stdout.readline() == "b''\n"


async def test_an_order_of_another_user_is_refused(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even where somebody has opened the directory and the socket to him."""
    if not ROOT:
        monkeypatch.setattr("dpstack.api.control.control_server.peer_uid", lambda _connection: MALLORY)
    asked: list[object] = []
    served = ControlServer("run", "COM3", COMMON, {"status": lambda args: asked.append(args)})
    async with served:
        (runtime / "dpstack").chmod(0o711)
        socket_of("COM3").chmod(0o666)
        (runtime / "dpstack" / socket_path.socket_name("run COM3")).chmod(0o666)
        fd = os.open(runtime / "dpstack", os.O_RDONLY)

        def order() -> str:
            with program(ORDERING, fd, socket_path.socket_name("COM3"), keep=fd) as ordering:
                assert ordering.stdout is not None
                return ordering.stdout.readline()

        try:
            told = json.loads(await asyncio.to_thread(order))
        finally:
            os.close(fd)
    assert told["error"] == f"only {user_name(os.geteuid())} and root may give orders to this program"
    assert asked == []


def test_root_and_ourselves_are_trusted_and_nobody_else() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        assert socket_path.peer_uid(ours) == os.geteuid()
    asked = (0, os.geteuid(), os.geteuid() + 1, MALLORY)
    assert {uid for uid in asked if socket_path.is_trusted(uid)} == {0, os.geteuid()}


async def test_elsewhere_getpeereid_tells_who_it_is(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on macOS and BSD: int getpeereid(int fd, uid_t *euid, gid_t *egid), 0 or -1."""
    answer = [0, os.geteuid()]

    number = ctypes.POINTER(ctypes.c_uint32)

    def getpeereid(fd: int, uid: Any, _gid: Any) -> int:
        assert fd >= 0
        uid[0] = answer[1]
        return answer[0]

    libc = SimpleNamespace(getpeereid=ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, number, number)(getpeereid))

    monkeypatch.setattr(socket_path, "_PEERCRED", None)
    monkeypatch.setattr(socket_path, "_libc", lambda: libc)
    async with serving() as ask:
        assert await ask() == {"fine": True}
        answer[1] = MALLORY
        with pytest.raises(PortError, match="the program that answers there is not yours"):
            await ask()
        answer[:] = [-1, 0]
        with pytest.raises(PortError, match="cannot be found out"):
            await ask()


async def test_where_the_system_cannot_tell_the_directories_decide(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket_path, "_PEERCRED", None)
    monkeypatch.setattr(socket_path, "_libc", object)
    async with serving() as ask:
        assert await ask() == {"fine": True}
        (runtime / "dpstack").chmod(0o777)
        with pytest.raises(PortError, match="can be written by others"):
            await ask()


@contextlib.asynccontextmanager
async def serving() -> AsyncIterator[Any]:
    def call() -> object:
        with connect("COM3") as client:
            assert isinstance(client, ControlClient)
            return client.call("status")

    async with server():
        yield lambda: asyncio.to_thread(call)
