"""The control socket of a program, fed with anything: cut lines, huge lines, other types, an early end.

Real connections in a loop whose time jumps; the commands are short, long with items, refusing and defective ones.
Judged: every line with something in it is answered by one JSON line (long commands: after their items), in order;
texts are printable; a request beyond the limit ends its own connection only; nothing reaches the loop's handler;
another client is answered meanwhile; and no connection or task is left.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections.abc import Awaitable, Callable
from typing import Any
from unittest import mock

from dpstack.api.control import control_server as module
from dpstack.api.control.commands import COMMON, Spec
from dpstack.api.control.control_server import ControlServer, _Client
from dpstack.errors import SlaveFault
from tests.fuzz.bent_json import bent, text_of
from tests.fuzz.frame import Cutter, Target, assert_plain
from tests.fuzz.quick_loop import QuickLoop, quick_loop

_SPECS = (
    *COMMON,
    Spec("number", "NUMBER", "a number", "3"),
    Spec("say", "TEXT...", "texts", "a b"),
    Spec("long", "[TEXT]", "items, then a result", ""),
    Spec("refuse", "[TEXT]", "refuses", ""),
    Spec("broken", "", "a defect", ""),
)
_RIGHT: tuple[Any, ...] = (
    {"command": "status", "args": []},
    {"command": "help"},
    {"command": "number", "args": ["3"]},
    {"command": "say", "args": ["a", "b"], "until_ns": 2**62},
    {"command": "long", "args": []},
    {"command": "refuse", "args": ["x"], "until_ns": 1},
    {"command": "broken", "args": []},
)


def _refuse(args: list[str]) -> object:
    raise SlaveFault(3, args[0] if args else "no")


def _long(args: list[str]) -> Callable[[Any], Awaitable[object]]:
    async def work(send: Any) -> object:
        await send({"at": 1})
        await asyncio.sleep(0.1)
        await send({"at": args})
        return args

    return work


_HANDLERS: dict[str, Callable[[list[str]], object]] = {
    "status": lambda _args: {"running": True},
    "number": lambda args: int(args[0]),
    "say": list,
    "long": _long,
    "refuse": _refuse,
    "broken": lambda args: {"y": args}["x"],
}


class Run:
    """One execution."""

    def __init__(self, octets: bytes, loop: QuickLoop) -> None:
        self.script = Cutter(octets)
        self.loop = loop
        self.server = ControlServer("run", "/dev/nowhere", _SPECS, _HANDLERS)

    def connected(self) -> socket.socket:
        """A new client's end of a connection."""
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        theirs.setblocking(False)
        client = _Client(theirs)
        task = self.loop.create_task(self.server._serve(client))
        self.server._clients[task] = client
        task.add_done_callback(lambda task: self.server._over(task, client))
        return ours

    def request(self) -> bytes:
        script = self.script
        how = script.octet()
        match how >> 5:
            case 0 | 1 | 2:
                return text_of(bent(_RIGHT[how % len(_RIGHT)], script)).encode("utf-8", "surrogatepass") + b"\n"
            case 3:
                return text_of(_RIGHT[how % len(_RIGHT)]).encode()[: script.octet()] + b"\n"
            case 4:
                return script.take(script.octet() & 63)
            case 5:
                return b"x" * (script.octet() << 9) + b"\n"
            case 6:
                return b"\n" * (how & 15)
            case _:
                return b'{"command":"say","args":[' + script.take(script.octet() & 31) + b"]}\n"

    async def main(self) -> None:
        script = self.script
        head = script.octet()
        ours, good = self.connected(), self.connected()
        sent, got = b"", b""
        while script.at < len(script.octets):
            piece = self.request()
            sent += piece
            with contextlib.suppress(OSError):
                ours.sendall(piece)
            await asyncio.sleep(0.2 if head & 1 else 0)
            got += read(ours)
        sent += b"\n"
        with contextlib.suppress(OSError):
            ours.sendall(b"\n")
        for _ in range(20):  # up to 200 orders of 0.1 s; a client that does not read for five seconds is disconnected
            await asyncio.sleep(1)
            got += read(ours)
        self.judge(sent, got)
        good.sendall(b'{"command":"number","args":["7"]}\n')
        await asyncio.sleep(0.1)
        assert read(good) == b'{"ok":true,"result":7}\n'
        if head & 2:
            ours.close()
        good.close()
        await asyncio.sleep(0.1)
        ours.close()
        await asyncio.sleep(0.1)
        assert not self.server._clients

    def judge(self, sent: bytes, got: bytes) -> None:
        lines = sent.split(b"\n")[:-1]
        asked = [line for line in lines if line.strip()]
        answers = [json.loads(line) for line in got.split(b"\n")[:-1]]
        ends = [answer for answer in answers if "ok" in answer]
        assert got.endswith(b"\n") or not got
        for answer in ends:
            if not answer["ok"]:
                assert_plain(answer["error"])
                if "defect" in answer["error"]:
                    assert "KeyError: 'x'" in answer["error"], answer
        if all(len(line) < module._LONGEST for line in lines):
            assert len(ends) == len(asked), (asked, ends)
        else:
            assert len(ends) <= len(asked)


def read(sock: socket.socket) -> bytes:
    """All octets that are there."""
    found = b""
    with contextlib.suppress(OSError):
        while chunk := sock.recv(1 << 20):
            found += chunk
    return found


def run(octets: bytes) -> None:
    loop = quick_loop()
    with mock.patch.object(module, "monotonic_ns", loop.now_ns):
        loop.play(Run(octets, loop).main())


TARGET = Target(
    run=run, covers=("dpstack.api.control.control_server",), executions=100_000, compares=False, max_len=200
)
