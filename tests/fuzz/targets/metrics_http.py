"""The HTTP server of the metrics, fed with any octets in any portions.

In memory, in a loop whose time jumps. The input chooses where octets are cut, and which come behind a right or a bent
request. Judged: nothing reaches the loop's handler; one answer at most, with a status of the list; a right request of
another client is answered meanwhile; no connection is left after ten seconds.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from http import HTTPStatus

from dpstack.bridge.metrics.http_server import LONGEST_S, Answer, Connection, HttpServer
from dpstack.tcp_address import Origins
from tests.fuzz.frame import Cutter, Target
from tests.fuzz.quick_loop import quick_loop

HOST = b"127.0.0.1:9464"
_RIGHT = b"GET /metrics HTTP/1.1\r\nHost: " + HOST + b"\r\n\r\n"
_STATUS = {200, 400, 404, 405, 421, 431}


class Wire(asyncio.Transport):
    """A transport in memory. ``said``: octets of the server."""

    def __init__(self, server: HttpServer) -> None:
        super().__init__({"peername": ("127.0.0.1", 4711)})
        self.said = bytearray()
        self.closed = False
        self.protocol = Connection(server)
        self.protocol.connection_made(self)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.said += data

    def can_write_eof(self) -> bool:
        return True

    def write_eof(self) -> None:
        return

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            asyncio.get_running_loop().call_soon(self.protocol.connection_lost, None)

    abort = close


async def _page() -> Answer:
    await asyncio.sleep(0)
    return Answer(HTTPStatus.OK, b"dpstack_bus_up 1\n")


async def _main(octets: bytes) -> None:
    script, counted = Cutter(octets), Counter[HTTPStatus]()
    server = HttpServer(
        {"/metrics": _page},
        (),
        origins=Origins((), 9464, secure=False),
        count=lambda status: counted.update((status,)),
        refused=lambda: None,
    )
    wire, good = Wire(server), Wire(server)
    how = script.octet()
    sent = bytearray(_RIGHT) if how & 1 else bytearray()
    for _ in range(how >> 1 & 7 if sent else 0):
        sent[script.octet() % len(sent)] = script.octet()
    sent += script.take(250)
    step = 1 + (how >> 4) * 8
    for at in range(0, len(sent), step):
        if not wire.closed:
            wire.protocol.data_received(bytes(sent[at : at + step]))
        await asyncio.sleep(0)
    if how & 2 and not wire.closed and not wire.protocol.eof_received():
        wire.close()
    good.protocol.data_received(_RIGHT)
    for _ in range(4):
        await asyncio.sleep(0)
    assert good.said.startswith(b"HTTP/1.1 200 OK\r\n"), bytes(good.said)
    if wire.said:
        assert wire.said.startswith(b"HTTP/1.1 "), bytes(wire.said)
        assert wire.said.count(b"HTTP/1.1 ") == 1
        assert int(wire.said[9:12]) in _STATUS, bytes(wire.said)
    await asyncio.sleep(LONGEST_S + 1)
    assert wire.closed
    assert good.closed
    assert not server.open
    assert counted[HTTPStatus.OK] >= 1


def run(octets: bytes) -> None:
    quick_loop().play(_main(octets))


TARGET = Target(run=run, covers=("dpstack.bridge.metrics.http_server",), executions=100_000, compares=False)
