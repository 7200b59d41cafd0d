"""The HTTP server of the metrics, fed with any octets in any portions.

In memory, in a loop whose time jumps. The server gives one answer a second. The input chooses where octets are cut,
which come behind a right or a bent request, how many clients have asked before, and which of them go away while they
wait for their turn. Judged: nothing reaches the loop's handler; one answer at most, with a status of the list; a right
request of another client is answered after those that are there still, a second for each; no connection and no task is
left after ten seconds.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from http import HTTPStatus
from unittest import mock

from dpstack.bridge.metrics import http_server
from dpstack.bridge.metrics.http_server import LONGEST_S, Answer, HttpConnection, HttpServer
from dpstack.tcp_address import Origins
from tests.fuzz.frame import Cutter, Target
from tests.fuzz.memory_transport import MemoryTransport
from tests.fuzz.quick_loop import quick_loop

HOST = b"127.0.0.1:9464"
_RIGHT = b"GET /metrics HTTP/1.1\r\nHost: " + HOST + b"\r\n\r\n"
_STATUS = {200, 400, 404, 405, 421, 431}


class Wire(MemoryTransport):
    """``answered_at``: when the last octets of the server came."""

    def __init__(self, server: HttpServer) -> None:
        super().__init__()
        self.answered_at = 0.0
        self.protocol = HttpConnection(server)
        self.protocol.connection_made(self)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        super().write(data)
        self.answered_at = asyncio.get_running_loop().time()


async def _page() -> Answer:
    await asyncio.sleep(0)
    return Answer(HTTPStatus.OK, b"dpstack_bus_up 1\n")


def _fault(error: Exception) -> Answer:
    raise AssertionError("the page of this target raises nothing") from error


async def _main(octets: bytes) -> None:
    script, counted, loop = Cutter(octets), Counter[HTTPStatus](), asyncio.get_running_loop()
    with mock.patch.object(http_server, "MOST_ANSWERS", 1):
        server = HttpServer(
            {"/metrics": _page},
            (),
            origins=Origins((), 9464, secure=False),
            count=lambda status: counted.update((status,)),
            refused=lambda: None,
            fault=_fault,
        )
    begun = loop.time()
    how, crowd = script.octet(), script.octet()
    others = [Wire(server) for _ in range(crowd & 3)]
    wire, good = Wire(server), Wire(server)
    for other in others:
        other.protocol.data_received(_RIGHT)
    if others:
        await asyncio.sleep(0.5)  # the first one has its answer
    for number, other in enumerate(others):
        if crowd & 4 << number:
            other.abort()
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
    if crowd & 32:
        await asyncio.sleep(0.25)
        wire.abort()
    await asyncio.sleep(LONGEST_S / 2)
    answered = [one for one in (*others, wire) if one.said]
    assert good.said.startswith(b"HTTP/1.1 200 OK\r\n"), bytes(good.said)
    assert good.answered_at <= begun + max(len(answered), 0.5) + 0.001
    for one in answered:
        assert one.said.startswith(b"HTTP/1.1 "), bytes(one.said)
        assert one.said.count(b"HTTP/1.1 ") == 1
        assert int(one.said[9:12]) in _STATUS, bytes(one.said)
    await asyncio.sleep(LONGEST_S)
    assert all(one.closed for one in (*others, wire, good))
    assert not server.open
    assert asyncio.all_tasks() == {asyncio.current_task()}
    assert counted[HTTPStatus.OK] >= 1
    assert counted.total() == len(answered) + 1


def run(octets: bytes) -> None:
    quick_loop().play(_main(octets))


TARGET = Target(run=run, covers=("dpstack.bridge.metrics.http_server",), executions=100_000, compares=False)
