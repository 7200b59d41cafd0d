"""The page's WebSocket and HTTP server of ``dpstack web``, fed with any messages and requests.

In memory, in a loop whose time jumps: aiohttp's server protocol gets octets, its transport is a list. The input
chooses requests (bent heads, other methods and paths, octets of its own), and behind a WebSocket's handshake
messages: bent ones, any JSON, huge and nested ones, binary frames, pings, frames cut anywhere. Judged: nothing
reaches the loop's handler; no answer but those of a file, a refusal or a WebSocket; each message that is answered
gets one line of JSON with a printable text; another page gets its answer meanwhile; and no page is left.
"""

from __future__ import annotations

import asyncio
import base64
import functools
import json
import struct
from typing import Any
from unittest import mock

from dpstack.web import web_server as module
from dpstack.web.page_files import read_page
from dpstack.web.rights import Rights
from dpstack.web.source import GivenItems
from dpstack.web.web_server import WebServer
from tests.fuzz.bent_json import bent, text_of
from tests.fuzz.frame import Cutter, Target, assert_plain
from tests.fuzz.memory_transport import MemoryTransport
from tests.fuzz.quick_loop import QuickLoop, quick_loop

HOST = "127.0.0.1:8765"
SECRET = "s" * 32
#: pauses of a second: a page that answers no ping is disconnected after 20 s and more
_MOST_PAUSES = 15
#: seconds until a page that hung up is forgotten
_MOST_S = 40
_PLANT = {"plant": {"version": 1, "started": 1_763_830_000.0, "port": "/dev/ttyUSB0", "slaves": {"3": {"name": "x"}}}}
_RIGHT: tuple[Any, ...] = (
    {"hello": {"token": None}},
    {"hello": {"token": SECRET}},
    {"ask": {"id": 1, "what": "why", "args": ["3"]}},
    {"ask": {"id": 2, "what": "toml", "args": []}},
    {"ask": {"id": 3, "what": "match", "args": [{"3": "0x1234"}]}},
    {"order": {"id": 4, "command": "operate", "args": [], "confirmed": True}},
    {"order": {"id": 5, "command": "set", "args": ["3.level=1"], "confirmed": False}},
)


class Wire(MemoryTransport):
    def __init__(self) -> None:
        super().__init__(port=8765)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        return

    def get_write_buffer_size(self) -> int:
        return 0

    def pause_reading(self) -> None:
        return

    def resume_reading(self) -> None:
        return

    def is_reading(self) -> bool:
        return True


class FakeSocket:
    """A listening socket that is only an address."""

    def getsockname(self) -> tuple[str, int]:
        return ("127.0.0.1", 8765)


def head_of(path: str = "/ws", **more: str) -> bytes:
    """A right request for a WebSocket."""
    key = base64.b64encode(bytes(16)).decode()
    fields = {
        "Host": HOST, "Origin": f"http://{HOST}", "Upgrade": "websocket", "Connection": "Upgrade",
        "Sec-WebSocket-Key": key, "Sec-WebSocket-Version": "13",
    } | more  # fmt: skip
    return f"GET {path} HTTP/1.1\r\n".encode() + b"".join(f"{k}: {v}\r\n".encode() for k, v in fields.items()) + b"\r\n"


def frame_of(octets: bytes, kind: int = 1, *, last: bool = True) -> bytes:
    """A masked frame of a client."""
    first = (0x80 if last else 0) | kind
    size = len(octets)
    head = (
        bytes((first, 0x80 | size))
        if size < 126
        else struct.pack(">BBH", first, 0xFE, size)
        if size < 1 << 16
        else struct.pack(">BBQ", first, 0xFF, size)
    )
    return head + bytes(4) + octets


def frames_in(octets: bytes) -> list[tuple[int, bytes]]:
    """The frames of a server: kind and octets."""
    found, at = [], 0
    while at + 2 <= len(octets):
        kind, size = octets[at] & 15, octets[at + 1] & 0x7F
        at += 2
        if size == 126:
            (size,), at = struct.unpack_from(">H", octets, at), at + 2
        elif size == 127:
            (size,), at = struct.unpack_from(">Q", octets, at), at + 8
        found.append((kind, bytes(octets[at : at + size])))
        at += size
    return found


class Run:
    """One execution."""

    def __init__(self, octets: bytes, loop: QuickLoop) -> None:
        self.script = Cutter(octets)
        self.loop = loop
        self.log: list[str] = []

    def connect(self, server: WebServer) -> Wire:
        wire = Wire()
        wire.protocol = server._accept()
        wire.protocol.connection_made(wire)
        return wire

    async def feed(self, wire: Wire, octets: bytes) -> None:
        if not wire.closed:
            wire.protocol.data_received(octets)
        for _ in range(8):
            await asyncio.sleep(0)

    async def page(self, server: WebServer, token: str | None) -> Wire:
        wire = self.connect(server)
        await self.feed(wire, head_of())
        await self.feed(wire, frame_of(json.dumps({"hello": {"token": token}}).encode()))
        return wire

    def request(self) -> bytes:
        script = self.script
        how = script.octet()
        match how & 7:
            case 0 | 1 | 2:
                return head_of()
            case 3:
                name = ("Host", "Origin", "Upgrade", "Sec-WebSocket-Key", "Connection")[script.octet() % 5]
                return head_of(**{name: script.take(how >> 3).decode("latin-1")})
            case 4:
                return head_of(script.take(how >> 3).decode("latin-1"))
            case 5:
                whole = bytearray(head_of())
                for _ in range(how >> 5):
                    whole[script.octet() % len(whole)] = script.octet()
                return bytes(whole)
            case 6:
                method = (b"POST", b"HEAD", b"OPTIONS", b"PUT")[how >> 3 & 3]
                path = (b"/", b"/ws", b"/app.js", b"/../x")[how >> 5 & 3]
                return (
                    method
                    + b" "
                    + path
                    + b" HTTP/1.1\r\nHost: "
                    + HOST.encode()
                    + b"\r\n"
                    + script.take(4)
                    + b"\r\n\r\n"
                )
            case _:
                return script.take(script.octet() & 63)

    def message(self) -> bytes:
        script = self.script
        how = script.octet()
        match how >> 5:
            case 0 | 1 | 2 | 3:
                text = text_of(bent(_RIGHT[how % len(_RIGHT)], script)).encode()
                return frame_of(text[:60_000])
            case 4:
                return frame_of(script.take(script.octet() & 63), how & 15, last=bool(how & 16))
            case 5:
                return frame_of(b"[" * (script.octet() << 4))
            case 6:
                return script.take(script.octet() & 31)
            case _:
                whole = frame_of(text_of(_RIGHT[how % len(_RIGHT)]).encode())
                return whole[: script.octet()]

    async def main(self) -> None:
        script = self.script
        head, pauses = script.octet(), 0
        rights = Rights(True, None, SECRET) if head & 1 else Rights()
        source = GivenItems([_PLANT])
        server = WebServer(source, [FakeSocket()], rights, self.log.append)  # type: ignore[list-item]

        server._sockets = ()  # nothing listens
        await server.open()
        try:
            good = await self.page(server, None)
            assert server.pages == 1, bytes(good.said)
            wire = self.connect(server)
            await self.feed(wire, self.request())
            await self.feed(wire, frame_of(text_of(bent(_RIGHT[head >> 1 & 1], script)).encode()))
            while script.at < len(script.octets):
                await self.feed(wire, self.message())
                if head & 4 and pauses < _MOST_PAUSES:
                    pauses += 1
                    await asyncio.sleep(1)
            self.judge(bytes(wire.said))
            good.said.clear()
            await self.feed(good, frame_of(b'{"ask":{"id":9,"what":"nothing"}}'))
            await asyncio.sleep(0.3)
            answers = [json.loads(text) for kind, text in frames_in(bytes(good.said)) if kind == 1]
            assert [one["answer"]["id"] for one in answers if "answer" in one] == [9], answers
            for one in (wire, good):
                one.close()
            for _ in range(_MOST_S):
                if server.pages == 0 and not server._strangers.total():
                    break
                await asyncio.sleep(1)
            assert server.pages == 0
            assert not server._strangers.total()
        finally:
            await server.close()
        for line in self.log:
            assert_plain(line)

    def judge(self, said: bytes) -> None:
        """The octets that the server sent to the stranger."""
        if not said:
            return
        assert said.startswith(b"HTTP/1."), said[:80]
        status = int(said[9:12])
        assert status in (101, 200, 400, 403, 404, 405, 414, 417, 421, 426, 431, 503), said[:200]
        assert status < 500 or status == 503
        if status != 101:
            return
        body = said.partition(b"\r\n\r\n")[2]
        for kind, octets in frames_in(body):
            if kind != 1:
                continue
            item = json.loads(octets)
            assert len(item) == 1
            answer = item.get("answer")
            if answer is not None and not answer["ok"]:
                assert_plain(answer["error"])
            if "refused" in item:
                assert_plain(item["refused"])


#: the page's files are read once, and not for every input
_read_page = functools.cache(read_page)


def run(octets: bytes) -> None:
    loop = quick_loop()
    with mock.patch.object(module, "read_page", _read_page):
        loop.play(Run(octets, loop).main())


TARGET = Target(run=run, covers=("dpstack.web",), executions=100_000, compares=False, max_len=300)
