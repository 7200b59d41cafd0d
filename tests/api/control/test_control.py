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
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from control_kit import control_directory, octet_client, socket_of

from dpstack.api.control.client import ControlClient, connect, running
from dpstack.api.control.commands import COMMON, KINDS, SLAVES, Spec, find
from dpstack.api.control.control_server import ControlServer, Handler, LongCommand, Send, _ClientGoneError
from dpstack.api.control.socket_path import names_of, socket_name
from dpstack.errors import BusError, PortBusyError, PortError, SlaveTimeout, UsageError

ECHO = Spec("echo", "WORD...", "says it again", "hello")
COUNT = Spec("count", "N", "counts", "3")
LATER = Spec("later", "", "takes its time", "")
FLOOD = Spec("flood", "", "goes on for ever", "")
BAD = Spec("bad", "KIND", "fails", "usage")
SPECS = (*COMMON, ECHO, COUNT, LATER, FLOOD, BAD)


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


@contextlib.contextmanager
def listening() -> Iterator[socket.socket]:
    """A program that is no server of dpstack's, at the socket of COM3."""
    control_directory().mkdir(exist_ok=True)
    with socket.socket(socket.AF_UNIX) as found:
        found.bind(str(socket_of("COM3")))
        found.listen(1)
        yield found


@contextlib.contextmanager
def full_queue() -> Iterator[None]:
    """As many clients as fit wait for the program on COM3, which does not come to accept."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(BlockingIOError):
            while True:
                waiting = stack.enter_context(socket.socket(socket.AF_UNIX))
                waiting.setblocking(False)
                waiting.connect(str(socket_of("COM3")))
        yield


async def test_lines_in_lines_out() -> None:
    async with server(), octet_client() as client:
        assert await client.ask(b'{"command":"status"}') == b'{"ok":true,"result":{"fine":true}}\n'
        assert await client.ask(b'{"command":"echo","args":["a","\xc3\xa4"]}') == (
            b'{"ok":true,"result":["a","\xc3\xa4"]}\n'
        )
        assert await client.ask(b'{"command":"later","args":[]}') == b'{"ok":true,"result":"now"}\n'
        assert await client.ask(b'{"command":"count","args":["2"]}') == b'{"item":{"progress":["steps",0,2]}}\n'
        assert await client.line() == b'{"item":{"progress":["steps",1,2]}}\n'
        assert await client.line() == b'{"ok":true,"result":null}\n'


async def test_a_request_is_dropped_where_it_is_read_after_its_time_limit() -> None:
    """A program that was stopped must not do what was asked of it long before."""
    async with server(), octet_client() as client:
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
async def test_wrong_requests_are_refused(request_: bytes, answer: dict[str, object] | str) -> None:
    async with server(), octet_client() as client:
        told = json.loads(await client.ask(request_))
        if isinstance(answer, str):
            assert told["ok"] is False
            assert told["usage"] is True
            assert told["error"].startswith(answer)
        else:
            assert told == answer
        assert await client.is_served()


async def test_a_defect_is_told_and_survived() -> None:
    async with server(), octet_client() as client:
        told = json.loads(await client.ask(b'{"command":"bad","args":["defect"]}'))
        assert told["error"] == "failed by a defect, please report it: ZeroDivisionError: division by zero"
        assert b'"ok":true' in await client.ask(b'\n{"command":"status"}')


async def test_a_line_without_end_is_cut() -> None:
    async with server():
        async with octet_client() as client:
            client.writer.write(b"x" * 70_000)
            assert b"at most 65536 octets" in await client.line()
            with contextlib.suppress(ConnectionResetError):
                assert await client.is_closed()
        async with octet_client() as client:
            assert await client.is_served()


@pytest.mark.parametrize("size", [10_000, 100])
async def test_a_client_that_does_not_read_is_dropped_and_the_others_are_served(size: int) -> None:
    ended = asyncio.Event()

    async def flood(send: Send) -> None:
        try:
            while True:
                await send("x" * size)
        finally:
            ended.set()

    served = ControlServer("sim", "COM3", SPECS, {**HANDLERS, "flood": lambda _: flood})
    served.patience_s = 0.02
    async with served, octet_client() as client:
        with socket.socket(socket.AF_UNIX) as deaf:
            deaf.connect(str(socket_of("COM3")))
            deaf.send(b'{"command":"flood"}\n')
            assert await client.is_served()
            await asyncio.wait_for(ended.wait(), 10)
            assert await client.is_served()


async def test_an_answer_is_as_long_as_the_plant_is_large() -> None:
    """More than the buffers of the system and of the loop take at once."""
    slaves = {str(address): {"name": f"slave {address}", "inputs": "5a" * 20_000} for address in range(1, 101)}
    async with ControlServer("sim", "COM3", SPECS, HANDLERS | {"status": lambda _: {"slaves": slaves}}):

        def ask() -> tuple[object, object]:
            with connect("COM3") as client:
                return client.call("status"), client.call("echo", "hello")

        assert await asyncio.to_thread(ask) == ({"slaves": slaves}, ["hello"])


class SlowWriter:
    """A connection whose client has left so many octets of an answer whenever the patience of the program ends."""

    def __init__(self, *left: int) -> None:
        self.transport = self
        self._left = deque(left)

    def write(self, line: bytes) -> None:
        self.line = line

    def get_write_buffer_size(self) -> int:
        return self._left.popleft()

    async def drain(self) -> None:
        if self._left[0]:
            raise TimeoutError


async def test_a_client_has_as_much_time_for_its_answer_as_it_reads_of_it() -> None:
    slow: Any = SlowWriter(1000, 600, 200, 0)
    await server()._send(slow, {"ok": True})
    assert slow.line == b'{"ok":true}\n'
    deaf: Any = SlowWriter(1000, 600, 600, 0)
    with pytest.raises(_ClientGoneError):
        await server()._send(deaf, {"ok": True})


async def test_the_seventeenth_client_pushes_out_the_one_that_was_idle_longest() -> None:
    """Sixteen that hold a connection and ask nothing block nobody."""
    async with server(), contextlib.AsyncExitStack() as stack:
        clients = [await stack.enter_async_context(octet_client()) for _ in range(16)]
        for client in clients[1:]:
            assert await client.is_served()
        clients[0].writer.write(b'{"command":"sta')  # half a request is none
        for _ in range(3):
            extra = await stack.enter_async_context(octet_client())
            assert await extra.is_served()
        for client in clients[:3]:
            told = json.loads(await client.line())
            assert told["error"].startswith("closed: there are too many clients, and this one was idle longest")
            assert await client.is_closed()
        for client in clients[3:]:
            assert await client.is_served()


async def test_a_client_with_an_order_under_way_is_not_pushed_out() -> None:
    over = asyncio.Event()

    async def long(_args: list[str]) -> str:
        await over.wait()
        return "over"

    served = ControlServer("sim", "COM3", SPECS, {**HANDLERS, "later": long})
    async with served, contextlib.AsyncExitStack() as stack:
        clients = [await stack.enter_async_context(octet_client()) for _ in range(16)]
        for client in clients:
            client.writer.write(b'{"command":"later"}\n{"command":"status"}\n')
        await asyncio.sleep(0.05)
        extra = await stack.enter_async_context(octet_client())
        assert b"16 clients have an order under way: end some of them" in await extra.line()
        over.set()
        for client in clients:
            assert b'"over"' in await client.line()
        extra = await stack.enter_async_context(octet_client())
        assert await extra.is_served()


async def test_a_client_that_asks_nothing_for_long_is_told_and_dropped() -> None:
    served = server()
    served.idle_s = 0.02
    async with served, octet_client() as silent, octet_client() as half:
        half.writer.write(b'{"command":"sta')
        for client in (silent, half):
            told = json.loads(await client.line())
            assert told["error"] == "closed: no request came for 0.02 s; connect again"
            assert await client.is_closed()


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

        await asyncio.to_thread(ask)


async def test_the_socket_is_the_users_alone_and_goes_with_the_program() -> None:
    async with server():
        path = socket_of("COM3")
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert stat.S_IMODE(control_directory().stat().st_mode) == 0o700
    assert list(control_directory().iterdir()) == []


async def test_a_second_program_is_refused_a_stale_socket_is_not() -> None:
    async with server():
        with pytest.raises(PortBusyError, match="another program answers `dpstack ctl COM3`"):
            await server().__aenter__()
    with listening():
        pass
    async with server(), octet_client() as client:
        assert await client.is_served()


@pytest.mark.parametrize("kind", ["run", "sim"])
async def test_the_socket_of_a_killed_program_is_no_other_program(kind: str, tmp_path: Path) -> None:
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
            async with octet_client(str(port)) as client:
                assert await client.is_served()


async def test_a_path_that_is_longer_than_a_sockets_may_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """sun_path has room for 107 octets: where /proc/self/fd is, the directory is named by its descriptor."""
    long = tmp_path / ("x" * 100) / ("y" * 100)
    long.mkdir(parents=True)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(long))

    def ask() -> object:
        with connect("COM3") as client:
            return client.call("echo", "a")

    async with server():
        assert await asyncio.to_thread(ask) == ["a"]
        assert [one["port"] for one in await asyncio.to_thread(running)] == ["COM3"]
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
    async with server(), octet_client() as client:  # a short one does
        assert await client.is_served()
    long = tmp_path / ("x" * 100)
    long.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(long))
    with pytest.raises(PortError) as caught:
        await server().__aenter__()
    path = long / "dpstack" / socket_name("COM3")
    assert str(caught.value) == (
        f"{path} has {len(str(path))} octets, and the path of a socket at most 107 here: set XDG_RUNTIME_DIR "
        "(or TMPDIR) to a directory with a shorter path"
    )


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
            assert await asyncio.to_thread(ask, port) == ["a b"]
        link.unlink()  # the adapter was plugged in again under another device
        (tmp_path / "other").touch()
        link.symlink_to(tmp_path / "other")
        assert await asyncio.to_thread(ask, str(link)) == ["a b"]
    assert running() == []


async def test_nobody_there_names_those_who_are() -> None:
    with pytest.raises(PortError, match=r"nobody answers for /dev/ttyUSB9; no run, sim or segment of yours is running"):
        connect("/dev/ttyUSB9")
    async with server("socket://plant:7000"):
        with socket.socket(socket.AF_UNIX) as left:
            left.bind(str(control_directory() / "0123456789abcdef.sock"))
        (control_directory() / "fedcba9876543210.sock").symlink_to("nowhere")

        def ask() -> str:
            with pytest.raises(PortError) as caught:
                connect("COM3")
            return str(caught.value)

        assert await asyncio.to_thread(ask) == "nobody answers for COM3; there is: sim on socket://plant:7000"
        assert list(control_directory().iterdir()) == [socket_of("socket://plant:7000")]


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (b"", "closed the connection before its answer was complete"),
        (b"hello\n", "is no JSON object"),
        (b'"x"\n', "is no JSON object"),
    ],
)
def test_a_program_that_answers_nonsense(answer: bytes, says: str) -> None:
    with listening() as program:

        def serve() -> None:
            connection, _ = program.accept()
            with connection:
                connection.recv(1000)
                connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        with connect("COM3") as client, pytest.raises(PortError, match=says):
            client.call("status")
        thread.join()


def test_a_program_that_hangs() -> None:
    with listening(), connect("COM3", timeout=0.05) as client, pytest.raises(PortError, match="does not answer"):
        client.call("status")


async def test_a_client_waits_for_a_place_in_a_full_queue() -> None:
    """The loop does not run meanwhile, so nobody is accepted. A client with a time-out tries again."""
    async with server():
        with full_queue():
            await asyncio.to_thread(lambda: connect("COM3").close())


def test_a_stopped_program_with_a_full_queue(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dpstack.api.control.socket_path._QUEUE_TRIES", 2)
    with (
        listening(),
        full_queue(),
        pytest.raises(PortError, match=r"cannot be reached .*too many clients wait for it; is it stopped"),
    ):
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
    assert names_of("socket://plant:7000") == ("socket://plant:7000",)
    assert names_of("COM3") == ("COM3",)
    assert names_of("/dev/null") == ("/dev/null",)
    assert names_of(str(tmp_path / "0")) == (str(tmp_path / "0"), "/dev/null")
