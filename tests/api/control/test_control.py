"""The control socket: literal lines in, literal lines out; rubbish, silence and stale sockets harm nobody."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import socket
import stat
import threading
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from dpstack.api.control import socket_path
from dpstack.api.control.client import ControlClient, connect, running
from dpstack.api.control.commands import COMMON, KINDS, SLAVES, Spec, find
from dpstack.api.control.server import ControlServer, Handler, LongCommand, Send
from dpstack.errors import BusError, PortBusyError, PortError, SlaveTimeout, UsageError

ECHO = Spec("echo", "WORD...", "says it again", "hello")
COUNT = Spec("count", "N", "counts", "3")
LATER = Spec("later", "", "takes its time", "")
FLOOD = Spec("flood", "", "goes on for ever", "")
BAD = Spec("bad", "KIND", "fails", "usage")
SPECS = (*COMMON, ECHO, COUNT, LATER, FLOOD, BAD)


@pytest.fixture(autouse=True)
def own_runtime_directory(runtime_directory: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Nobody else's sockets: a directory for each test."""
    path = Path(runtime_directory) / "t"
    path.mkdir(exist_ok=True)
    for left in path.glob("dpstack/*"):
        left.unlink()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(path))
    return path / "dpstack"


def _bad(args: list[str]) -> object:
    raise {
        "usage": UsageError("not like this"),
        "late": SlaveTimeout(3, "slave 3 is late"),
        "defect": ZeroDivisionError("division\nby zero"),
    }[args[0]]


def _count(args: list[str]) -> LongCommand:
    async def count(send: Send) -> None:
        for n in range(int(args[0])):
            await send({"progress": ("steps", n, int(args[0]))})

    return count


async def _later(_args: list[str]) -> str:
    await asyncio.sleep(0)
    return "now"


HANDLERS: dict[str, Handler] = {
    "status": lambda _: {"fine": True},
    "echo": lambda args: args,
    "count": _count,
    "later": _later,
    "bad": _bad,
}


def server(port: str = "COM3") -> ControlServer:
    return ControlServer("sim", port, SPECS, HANDLERS)


class Raw:
    """A client that knows octets only."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def ask(self, line: bytes) -> bytes:
        self.writer.write(line + b"\n")
        return await asyncio.wait_for(self.reader.readline(), 10)

    async def ended(self) -> bool:
        return await asyncio.wait_for(self.reader.read(-1), 10) == b""


@contextlib.asynccontextmanager
async def raw(port: str = "COM3") -> AsyncIterator[Raw]:
    reader, writer = await asyncio.open_unix_connection(str(socket_path.socket_path(port)))
    try:
        yield Raw(reader, writer)
    finally:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


async def test_lines_in_lines_out() -> None:
    async with server(), raw() as client:
        assert await client.ask(b'{"command":"status"}') == b'{"ok":true,"result":{"fine":true}}\n'
        assert await client.ask(b'{"command":"echo","args":["a","\xc3\xa4"]}') == (
            b'{"ok":true,"result":["a","\xc3\xa4"]}\n'
        )
        assert await client.ask(b'{"command":"later","args":[]}') == b'{"ok":true,"result":"now"}\n'
        assert await client.ask(b'{"command":"count","args":["2"]}') == b'{"item":{"progress":["steps",0,2]}}\n'
        assert await client.reader.readline() == b'{"item":{"progress":["steps",1,2]}}\n'
        assert await client.reader.readline() == b'{"ok":true,"result":null}\n'


async def test_a_request_is_dropped_where_it_is_read_after_its_time_limit() -> None:
    """A program that was stopped must not do what was asked of it long before."""
    async with server(), raw() as client:
        late = time.monotonic_ns() - 8_000_000_000
        answer = json.loads(await client.ask(b'{"command":"echo","args":["a"],"until_ns":%d}' % late))
        assert (answer["ok"], answer["kind"]) == (False, "OrderDropped")
        assert re.search(r"took the order \d+ ms too late .* and dropped it", answer["error"])
        soon = time.monotonic_ns() + 60_000_000_000
        assert (
            await client.ask(b'{"command":"echo","args":["a"],"until_ns":%d}' % soon) == b'{"ok":true,"result":["a"]}\n'
        )


def test_the_client_gives_its_requests_the_time_for_which_it_waits() -> None:
    ours, theirs = socket.socketpair()
    with theirs, ControlClient("here", ours) as client:
        ours.settimeout(3)
        theirs.send(b'{"ok":true,"result":null}\n')
        before = time.monotonic_ns()
        client.call("status")
        until = json.loads(theirs.recv(1000))["until_ns"]
        assert before + 3_000_000_000 <= until <= time.monotonic_ns() + 3_000_000_000


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        (b'{"command":"bad","args":["usage"]}', {"ok": False, "error": "not like this", "usage": True}),
        (
            b'{"command":"bad","args":["late"]}',
            {"ok": False, "error": "slave 3 is late", "kind": "SlaveTimeout", "address": 3},
        ),
        (b'{"command":"ecco","args":["a"]}', "unknown command 'ecco'; did you mean echo?"),
        (b'{"command":"qqq"}', "unknown command 'qqq'; it knows: help, status, echo, count, later, flood, bad"),
        (b'{"command":"noise"}', "noise is a command of `dpstack segment`, this is a sim; it knows: help, "),
        (b'{"command":"echo"}', "echo takes WORD..., for instance: echo hello"),
        (b'{"command":"count","args":["1","2"]}', "count takes N, for instance: count 3"),
        (b'{"command":"status","args":["1"]}', "status takes no arguments, for instance: status"),
        (b"rubbish", "a request is one line: "),
        (b"\xff\xfe\x00", "a request is one line: "),
        (b"[1]", "a request is one line: "),
        (b"{}", "a request is one line: "),
        (b'{"command":3}', "a request is one line: "),
        (b'{"command":"echo","args":"a"}', "a request is one line: "),
        (b'{"command":"echo","args":[1]}', "a request is one line: "),
        (b"[" * 60_000, "a request is one line: "),
    ],
)
async def test_what_is_refused(request_: bytes, answer: dict[str, object] | str) -> None:
    async with server(), raw() as client:
        told = json.loads(await client.ask(request_))
        if isinstance(answer, str):
            assert told["ok"] is False
            assert told["usage"] is True
            assert told["error"].startswith(answer)
        else:
            assert told == answer
        assert b'"ok":true' in await client.ask(b'{"command":"status"}')


async def test_a_defect_is_told_and_survived() -> None:
    async with server(), raw() as client:
        told = json.loads(await client.ask(b'{"command":"bad","args":["defect"]}'))
        assert told["error"] == "failed by a defect, please report it: ZeroDivisionError: division by zero"
        assert b'"ok":true' in await client.ask(b'\n{"command":"status"}')


async def test_a_line_without_end_is_cut() -> None:
    async with server():
        async with raw() as client:
            client.writer.write(b"x" * 70_000)
            assert b"at most 65536 octets" in await asyncio.wait_for(client.reader.readline(), 10)
            with contextlib.suppress(ConnectionResetError):
                assert await client.ended()
        async with raw() as client:
            assert b'"ok":true' in await client.ask(b'{"command":"status"}')


@pytest.mark.parametrize("size", [10_000, 100])
async def test_who_does_not_read_is_dropped_and_the_others_are_served(size: int) -> None:
    ended = asyncio.Event()

    async def flood(send: Send) -> None:
        try:
            while True:
                await send("x" * size)
        finally:
            ended.set()

    served = ControlServer("sim", "COM3", SPECS, {**HANDLERS, "flood": lambda _: flood})
    served.patience_s = 0.02
    async with served, raw() as client:
        with socket.socket(socket.AF_UNIX) as deaf:
            deaf.connect(str(socket_path.socket_path("COM3")))
            deaf.send(b'{"command":"flood"}\n')
            assert b'"ok":true' in await client.ask(b'{"command":"status"}')
            await asyncio.wait_for(ended.wait(), 10)
            assert b'"ok":true' in await client.ask(b'{"command":"status"}')


async def test_the_seventeenth_client_pushes_out_the_one_that_was_idle_longest() -> None:
    """Sixteen that hold a connection and ask nothing block nobody."""
    async with server(), contextlib.AsyncExitStack() as stack:
        clients = [await stack.enter_async_context(raw()) for _ in range(16)]
        for client in clients[1:]:
            assert b'"ok":true' in await client.ask(b'{"command":"status"}')
        clients[0].writer.write(b'{"command":"sta')  # half a request is none
        for _ in range(3):
            extra = await stack.enter_async_context(raw())
            assert b'"ok":true' in await extra.ask(b'{"command":"status"}')
        for client in clients[:3]:
            told = json.loads(await asyncio.wait_for(client.reader.readline(), 10))
            assert told["error"].startswith("closed: there are too many clients, and this one was idle longest")
            assert await client.ended()
        for client in clients[3:]:
            assert b'"ok":true' in await client.ask(b'{"command":"status"}')


async def test_a_client_with_an_order_under_way_is_not_pushed_out() -> None:
    over = asyncio.Event()

    async def long(_args: list[str]) -> str:
        await over.wait()
        return "over"

    served = ControlServer("sim", "COM3", SPECS, {**HANDLERS, "later": long})
    async with served, contextlib.AsyncExitStack() as stack:
        clients = [await stack.enter_async_context(raw()) for _ in range(16)]
        for client in clients:
            client.writer.write(b'{"command":"later"}\n{"command":"status"}\n')
        await asyncio.sleep(0.05)
        extra = await stack.enter_async_context(raw())
        assert b"16 clients have an order under way: end some of them" in await extra.reader.readline()
        over.set()
        for client in clients:
            assert b'"over"' in await asyncio.wait_for(client.reader.readline(), 10)
        extra = await stack.enter_async_context(raw())
        assert b'"ok":true' in await extra.ask(b'{"command":"status"}')


async def test_a_client_that_asks_nothing_for_long_is_told_and_dropped() -> None:
    served = server()
    served.idle_s = 0.02
    async with served, raw() as silent, raw() as half:
        half.writer.write(b'{"command":"sta')
        for client in (silent, half):
            told = json.loads(await asyncio.wait_for(client.reader.readline(), 10))
            assert told["error"] == "closed: no request came for 0.02 s; connect again"
            assert await client.ended()


async def test_a_client_that_was_dropped_says_why() -> None:
    served = server()
    served.idle_s = 0.02
    async with served:

        def ask() -> None:
            with connect("COM3") as client:
                assert client.call("status") == {"fine": True}
                end = time.monotonic() + 10
                while len(served._clients) and time.monotonic() < end:
                    time.sleep(0.02)
                with pytest.raises(BusError, match="closed: no request came for"):
                    client.call("status")

        await in_thread(ask)


async def test_the_socket_is_the_users_alone_and_goes_with_the_program(own_runtime_directory: Path) -> None:
    async with server():
        path = socket_path.socket_path("COM3")
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert stat.S_IMODE(own_runtime_directory.stat().st_mode) == 0o700
    assert list(own_runtime_directory.iterdir()) == []


async def test_a_second_program_is_refused_a_stale_socket_is_not() -> None:
    async with server():
        with pytest.raises(PortBusyError, match="another program answers `dpstack ctl COM3`"):
            await server().__aenter__()
    stale = socket.socket(socket.AF_UNIX)
    stale.bind(str(socket_path.socket_path("COM3")))
    stale.close()
    async with server(), raw() as client:
        assert b'"ok":true' in await client.ask(b'{"command":"status"}')


@pytest.mark.parametrize("kind", ["run", "sim"])
async def test_what_a_killed_program_left_behind_is_no_other_program(kind: str, tmp_path: Path) -> None:
    """After a kill -9 there are a socket that nobody answers at and links to it, by the names of the same port."""
    (tmp_path / "device").touch()
    link = tmp_path / "0"
    link.symlink_to(tmp_path / "device")
    for _ in range(2):
        killed = ControlServer(kind, str(link), SPECS, HANDLERS)
        await killed.__aenter__()
        assert killed.remark is None
        killed._stop_listening()  # nothing is removed
    async with ControlServer(kind, str(link), SPECS, HANDLERS) as again:
        assert again.remark is None
        for port in (link, tmp_path / "device"):
            async with raw(str(port)) as client:
                assert b'"ok":true' in await client.ask(b'{"command":"status"}')


async def test_a_directory_of_somebody_else_is_refused(own_runtime_directory: Path, tmp_path: Path) -> None:
    own_runtime_directory.rmdir() if own_runtime_directory.exists() else None
    own_runtime_directory.symlink_to(tmp_path)
    try:
        with pytest.raises(PortError, match="no directory of yours"):
            await server().__aenter__()
    finally:
        own_runtime_directory.unlink()


async def test_a_path_that_is_longer_than_a_sockets_may_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """sun_path has room for 107 octets: where /proc/self/fd is, the directory is named by its descriptor."""
    long = tmp_path / ("x" * 100) / ("y" * 100)
    long.mkdir(parents=True)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(long))

    def ask() -> object:
        with connect("COM3") as client:
            return client.call("echo", "a")

    async with server():
        assert await in_thread(ask) == ["a"]
        assert [one["port"] for one in await in_thread(running)] == ["COM3"]
    assert list((long / "dpstack").iterdir()) == []


async def test_a_system_without_descriptors_in_proc_says_that_the_path_is_too_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stat_of = os.stat

    def no_proc(path: Any, **options: Any) -> os.stat_result:
        if str(path).startswith("/proc"):
            raise FileNotFoundError(2, "No such file or directory")
        return stat_of(path, **options)

    monkeypatch.setattr("dpstack.api.control.socket_path.os.stat", no_proc)
    async with server(), raw() as client:  # a short one does
        assert b'"ok":true' in await client.ask(b'{"command":"status"}')
    long = tmp_path / ("x" * 100)
    long.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(long))
    with pytest.raises(PortError) as caught:
        await server().__aenter__()
    path = long / "dpstack" / socket_path.socket_name("COM3")
    assert str(caught.value) == (
        f"{path} has {len(str(path))} octets, and the path of a socket at most 107 here: set XDG_RUNTIME_DIR "
        "(or TMPDIR) to a directory with a shorter path"
    )


async def in_thread(work: Any) -> Any:
    return await asyncio.to_thread(work)


async def test_a_client_finds_the_program_by_link_and_by_device(tmp_path: Path) -> None:
    (tmp_path / "device").touch()
    link = tmp_path / "0"
    link.symlink_to(tmp_path / "device")

    def ask(port: str) -> object:
        with connect(port) as client:
            progress: list[tuple[str, int, int]] = []
            client.call("count", "3", progress=lambda *step: progress.append(step))
            assert progress == [("steps", 0, 3), ("steps", 1, 3), ("steps", 2, 3)]
            with pytest.raises(UsageError, match="not like this"):
                client.call("bad", "usage")
            with pytest.raises(SlaveTimeout, match="slave 3 is late"):
                client.call("bad", "late")
            return client.call("echo", "a b")

    async with server(str(link)):
        for port in (str(link), str(tmp_path / "device")):
            assert await in_thread(lambda port=port: ask(port)) == ["a b"]
        link.unlink()  # the adapter was plugged in again under another device
        (tmp_path / "other").touch()
        link.symlink_to(tmp_path / "other")
        assert await in_thread(lambda: ask(str(link))) == ["a b"]
    assert running() == []


async def test_nobody_there_names_those_who_are(own_runtime_directory: Path) -> None:
    with pytest.raises(PortError, match=r"nobody answers for /dev/ttyUSB9; no run, sim or segment of yours is running"):
        connect("/dev/ttyUSB9")
    async with server("socket://plant:7000"):
        stale = own_runtime_directory / "0123456789abcdef.sock"
        with socket.socket(socket.AF_UNIX) as left:
            left.bind(str(stale))
        (own_runtime_directory / "fedcba9876543210.sock").symlink_to("nowhere")

        def ask() -> str:
            with pytest.raises(PortError) as caught:
                connect("COM3")
            return str(caught.value)

        assert await in_thread(ask) == "nobody answers for COM3; there is: sim on socket://plant:7000"
        assert [path.name for path in own_runtime_directory.iterdir()] == [
            socket_path.socket_path("socket://plant:7000").name
        ]


@pytest.mark.parametrize(
    ("answer", "says"),
    [(b"", "ended without an answer"), (b"hello\n", "is no JSON object"), (b'"x"\n', "is no JSON object")],
)
def test_a_program_that_answers_nonsense(own_runtime_directory: Path, answer: bytes, says: str) -> None:
    own_runtime_directory.mkdir(exist_ok=True)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(socket_path.socket_path("COM3")))
        listening.listen(1)

        def serve() -> None:
            connection, _ = listening.accept()
            connection.recv(1000)
            connection.sendall(answer)
            connection.close()

        thread = threading.Thread(target=serve)
        thread.start()
        with connect("COM3") as client, pytest.raises(PortError, match=says):
            client.call("status")
        thread.join()


def test_a_program_that_hangs(own_runtime_directory: Path) -> None:
    own_runtime_directory.mkdir(exist_ok=True)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(socket_path.socket_path("COM3")))
        listening.listen(1)
        with connect("COM3", timeout=0.05) as client, pytest.raises(PortError, match="does not answer"):
            client.call("status")


async def test_a_client_waits_for_a_place_in_a_full_queue() -> None:
    """The server of a busy program comes to accept later; a client with a time-out is not told off by the system."""
    async with server():
        path = str(socket_path.socket_path("COM3"))
        with contextlib.ExitStack() as stack:
            with contextlib.suppress(BlockingIOError):
                while True:  # the loop does not run meanwhile: nobody is accepted
                    waiting = stack.enter_context(socket.socket(socket.AF_UNIX))
                    waiting.setblocking(False)
                    waiting.connect(path)
            await asyncio.to_thread(lambda: connect("COM3").close())


def test_a_stopped_program_with_a_full_queue(own_runtime_directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket_path, "_QUEUE_TRIES", 2)
    own_runtime_directory.mkdir(exist_ok=True)
    with contextlib.ExitStack() as stack:
        listening = stack.enter_context(socket.socket(socket.AF_UNIX))
        listening.bind(str(socket_path.socket_path("COM3")))
        listening.listen(1)
        with contextlib.suppress(BlockingIOError):
            while True:
                waiting = stack.enter_context(socket.socket(socket.AF_UNIX))
                waiting.setblocking(False)
                waiting.connect(str(socket_path.socket_path("COM3")))
        with pytest.raises(PortError, match=r"cannot be reached .*too many clients wait for it; is it stopped"):
            connect("COM3")


def test_every_kind_of_program_has_help_and_its_own_names() -> None:
    for kind, specs in KINDS.items():
        names = [spec.name for spec in specs]
        assert names[:2] == ["help", "status"]
        assert len(set(names)) == len(names)
        for spec in specs:
            assert find(kind, specs, spec.name) is spec
            spec.check(spec.example.split())
    with pytest.raises(UsageError, match="trip is a command of `dpstack sim`, this is a run"):
        find("run", KINDS["run"], "trip")
    with pytest.raises(UsageError, match="did you mean power-off"):
        find("sim", SLAVES, "power_off")


def test_names_of_ports(tmp_path: Path) -> None:
    os.symlink("/dev/null", tmp_path / "0")
    assert socket_path.names_of("socket://plant:7000") == ("socket://plant:7000",)
    assert socket_path.names_of("COM3") == ("COM3",)
    assert socket_path.names_of("/dev/null") == ("/dev/null",)
    assert socket_path.names_of(str(tmp_path / "0")) == (str(tmp_path / "0"), "/dev/null")
