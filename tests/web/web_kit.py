"""A page for tests of the web server: a WebSocket client of aiohttp, and a small plant in literal items."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import aiohttp
from far_ends import HANG_S
from verdicts_kit import verdicts

from dpstack.web.web_server import WebServer

#: the items of a plant with one slave, as the control socket of a run sends them
PLANT: dict[str, Any] = {
    "plant": {
        "version": 1,
        "started": 1_763_830_000.0,
        "port": "/dev/ttyUSB0",
        "config": "/home/me/plant.toml",
        "read_only": False,
        "slaves": {"3": {"name": "<script>alert(1)</script>", "address": 3, "inputs": [], "outputs": []}},
    }
}
WHOLE: dict[str, Any] = {
    "snapshot": {
        "t": 0.1,
        "whole": True,
        "bus": {"mode": "clear", "rotations": 10},
        "slaves": {"3": {"state": "offline", "exchanges": 0} | verdicts({"state": "offline"})},
    }
}


def delta(t: float, state: str) -> dict[str, Any]:
    values = {"state": state} | verdicts({"state": state})
    return {"snapshot": {"t": t, "whole": False, "bus": {}, "slaves": {"3": values}}}


def event(text: str) -> dict[str, Any]:
    return {"event": {"event": "notice", "time": "2026-11-22T12:00:00.000Z", "severity": "info", "text": text}}


class Page:
    """An open page. Its methods fail after :data:`~far_ends.HANG_S`."""

    def __init__(self, ws: aiohttp.ClientWebSocketResponse) -> None:
        self.ws = ws

    async def send(self, message: object) -> None:
        await self.ws.send_json(message)

    async def item(self) -> dict[str, Any]:
        """The next message."""
        item = await self.ws.receive_json(timeout=HANG_S)
        assert isinstance(item, dict)
        return item

    async def until(self, kind: str) -> Any:
        """The body of the next message of ``kind``; those before it are dropped."""
        async with asyncio.timeout(HANG_S):
            while True:
                item = await self.item()
                if kind in item:
                    return item[kind]

    async def ask(self, what: str, *args: object, id: int = 1) -> Any:
        await self.send({"ask": {"id": id, "what": what, "args": args}})
        return await self.until("answer")

    async def order(self, command: str, *args: str, confirmed: bool = True, id: int = 1) -> Any:
        await self.send({"order": {"id": id, "command": command, "args": args, "confirmed": confirmed}})
        return await self.until("answer")


@contextlib.asynccontextmanager
async def stranger(server: WebServer, **how: Any) -> AsyncIterator[Page]:
    """A WebSocket that has not said hello. ``how``: arguments of aiohttp's ``ws_connect`` and ``ssl``."""
    base = server.url.partition("#")[0]
    how = {"origin": base.rstrip("/"), **how}
    async with aiohttp.ClientSession() as session, session.ws_connect(base + "ws", max_msg_size=0, **how) as ws:
        yield Page(ws)


@contextlib.asynccontextmanager
async def page_of(server: WebServer, token: str | None = None, **how: Any) -> AsyncIterator[Page]:
    """An open page that said hello; its welcome is the first item."""
    async with stranger(server, **how) as page:
        await page.send({"hello": {"token": token}})
        yield page


async def connected(server: WebServer, octets: bytes = b"") -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """A connection without a request that has sent ``octets``."""
    host, port = server.url.split("/")[2].split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    writer.write(octets)
    return reader, writer
