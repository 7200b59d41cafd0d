"""A small HTTP server for texts that other programs fetch: GET and HEAD, one request a connection, limits for all.

It has no thread, reads no body, and keeps no connection: the answer to the first request ends it. So a client costs a
place for ten seconds at most, and what it sends besides is thrown away. The answers of a second are bounded, for
the sake of a bus on the same computer: a client that asks without a pause waits.

aiohttp 3.14, the server of the page, was tried in its place. It took a head of 880 927 octets, as its limits are those
of one line and of the number of lines. It answered 2000 wrong requests a second before any handler of ours was asked,
so they were neither counted nor slowed down, with octets of the client in the answer. It closed the connection with
octets unread behind the request, so that the client lost the answer; it gave none to a client that had ended its
sending; one that read nothing kept its place. The process took 12 MB more. A protocol in front of aiohttp would have
to do all that stands here, but for parsing the head and writing that of the answer.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import socket
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping, Sequence
from http import HTTPStatus
from typing import Final, NamedTuple

from dpstack.errors import PortError
from dpstack.tcp_address import Origins

#: connections at the same time: in all, and from one address
MOST_CONNECTIONS: Final = 64
MOST_OF_ONE: Final = 16
#: octets of a request with its head
MOST_OCTETS: Final = 8192
#: answers a second, and as many at once
MOST_ANSWERS: Final = 20
#: s of a connection in all
LONGEST_S: Final = 10.0
#: s behind the answer, until the client has closed
_GOODBYE_S: Final = 1.0
_BACKLOG: Final = 32
_REQUEST: Final = re.compile(rb"([!#$%&'*+.^_`|~0-9A-Za-z-]{1,40}) (/[!-~]{0,2000}) HTTP/1\.([01])")
_HEADER: Final = re.compile(rb"([!#$%&'*+.^_`|~0-9A-Za-z-]{1,100}):[ \t]*([^\x00-\x08\x0a-\x1f\x7f]*)")
_END: Final = b"\r\n\r\n"
_HEADERS: Final = (
    "Content-Type: text/plain; version=0.0.4; charset=utf-8\r\n"
    "Cache-Control: no-store\r\n"
    "X-Content-Type-Options: nosniff\r\n"
    "Connection: close\r\n"
)


class Answer(NamedTuple):
    status: HTTPStatus
    body: bytes


#: the answer to a GET of one path
Page = Callable[[], Awaitable[Answer]]


class Pace:
    """At most ``per_s`` a second in the mean, and ``at_once`` of them together."""

    def __init__(self, per_s: float, at_once: int) -> None:
        self._each_s = 1.0 / per_s
        self._at_once_s = (at_once - 1) * self._each_s
        self._next = 0.0

    def wait_s(self, now: float) -> float:
        """s until the next one is due, 0 or less: it is."""
        return max(self._next, now - self._at_once_s) - now

    def take(self, now: float) -> None:
        """Count one more, which is due."""
        self._next = now + self.wait_s(now) + self._each_s


class HttpServer:
    """Serves ``pages`` by path on ``sockets``, which listen; it closes them at its end.

    ``origins``: a ``Host`` that is not one of them is refused, against pages of others in a browser of this computer;
    None: every host. ``count``: takes the status of each answer; ``refused``: is called for each connection that was
    closed at once. ``fault``: the answer if a page raises.
    """

    def __init__(
        self,
        pages: Mapping[str, Page],
        sockets: Sequence[socket.socket],
        *,
        origins: Origins | None,
        count: Callable[[HTTPStatus], object],
        refused: Callable[[], object],
        fault: Callable[[Exception], Answer],
    ) -> None:
        self.pages = pages
        self.origins = origins
        self.count = count
        self.refused = refused
        self.fault = fault
        self.open: set[HttpConnection] = set()
        self._of: Counter[str] = Counter()
        self._sockets = sockets
        self._listening: list[asyncio.Server] = []
        self._pace = Pace(MOST_ANSWERS, MOST_ANSWERS)
        self._turn = asyncio.Lock()

    async def begin(self) -> None:
        """Accept connections. Raises PortError."""
        loop = asyncio.get_running_loop()
        try:
            for one in self._sockets:
                server = await loop.create_server(lambda: HttpConnection(self), sock=one, backlog=_BACKLOG)
                self._listening.append(server)
        except OSError as error:
            self.end()
            raise PortError(f"[metrics] listen: {error.strerror or error}; give another address") from None

    def end(self) -> None:
        """Close everything at once. May be repeated."""
        for server in self._listening:
            server.close()
        self._listening.clear()
        for one in self._sockets:
            one.close()
        for connection in tuple(self.open):
            connection.abort()

    def enter(self, connection: HttpConnection) -> bool:
        """Whether there is a place for ``connection``."""
        if len(self.open) >= MOST_CONNECTIONS or self._of[connection.client] >= MOST_OF_ONE:
            self.refused()
            return False
        self.open.add(connection)
        self._of[connection.client] += 1
        return True

    async def turn(self) -> None:
        """Wait until one more answer may be given. A client that goes away while it waits takes no turn."""
        loop = asyncio.get_running_loop()
        async with self._turn:
            wait_s = self._pace.wait_s(loop.time())
            if wait_s > 0:
                await asyncio.sleep(wait_s)
            self._pace.take(loop.time())

    def leave(self, connection: HttpConnection) -> None:
        if connection in self.open:
            self.open.discard(connection)
            self._of -= Counter((connection.client,))


class HttpConnection(asyncio.Protocol):
    """A client's connection: reads the head of one request, answers it, and waits until the client has closed."""

    def __init__(self, server: HttpServer) -> None:
        self.client = ""
        self._server = server
        self._transport: asyncio.Transport | None = None
        self._head = bytearray()
        self._answering: asyncio.Task[None] | None = None
        self._answered = False
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        peer = transport.get_extra_info("peername")
        self.client = str(peer[0]) if isinstance(peer, tuple) and peer else ""
        if not self._server.enter(self):
            transport.abort()
            return
        self._transport = transport
        self._timer = asyncio.get_running_loop().call_later(LONGEST_S, self.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        self._server.leave(self)
        if self._timer is not None:
            self._timer.cancel()
        if self._answering is not None:
            self._answering.cancel()

    def data_received(self, data: bytes) -> None:
        if self._transport is None or self._answered or self._answering is not None:
            return  # behind the first request; nothing of it is kept
        self._head += data[: MOST_OCTETS + 1 - len(self._head)]
        end = self._head.find(_END)
        if end >= 0 or len(self._head) > MOST_OCTETS:
            head = bytes(self._head[:end]) if end >= 0 else None
            self._head.clear()
            self._answering = asyncio.get_running_loop().create_task(self._answer(head))

    def eof_received(self) -> bool:
        """The client sends no more. It still gets the answer to a whole request."""
        if self._answering is not None:
            return True
        if self._transport is not None and not self._answered:
            self._transport.abort()
        return False

    def abort(self) -> None:
        if self._transport is not None:
            self._transport.abort()

    async def _answer(self, head: bytes | None) -> None:
        """Answer the request with ``head``; None: it is too long."""
        await self._server.turn()
        asked = HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE if head is None else self._judge(head)
        if isinstance(asked, HTTPStatus):
            more = "Allow: GET, HEAD\r\n" if asked is HTTPStatus.METHOD_NOT_ALLOWED else ""
            self._say(asked, f"{asked.phrase}\n".encode(), more)
        else:
            page, with_body = asked
            try:
                status, body = await page()
            except Exception as error:
                status, body = self._server.fault(error)
            self._say(status, body, with_body=with_body)

    def _judge(self, head: bytes) -> tuple[Page, bool] | HTTPStatus:
        """The page that is asked for and whether with its body, or the status of a refusal."""
        line, *headers = head.split(b"\r\n")
        request = _REQUEST.fullmatch(line)
        found = [_HEADER.fullmatch(one) for one in headers]
        if request is None or not all(found):
            return HTTPStatus.BAD_REQUEST
        hosts = [one[2].strip().decode("latin-1") for one in found if one is not None and one[1].lower() == b"host"]
        if len(hosts) > 1 or (request[3] == b"1" and not hosts):
            return HTTPStatus.BAD_REQUEST
        if self._server.origins is not None and hosts and not self._server.origins.is_own_host(hosts[0]):
            return HTTPStatus.MISDIRECTED_REQUEST
        if request[1] not in (b"GET", b"HEAD"):
            return HTTPStatus.METHOD_NOT_ALLOWED
        page = self._server.pages.get(request[2].partition(b"?")[0].decode("ascii"))
        return HTTPStatus.NOT_FOUND if page is None else (page, request[1] == b"GET")

    def _say(self, status: HTTPStatus, body: bytes, more: str = "", *, with_body: bool = True) -> None:
        self._answered, self._answering = True, None
        self._server.count(status)
        if self._transport is None:
            return
        head = f"HTTP/1.1 {status.value} {status.phrase}\r\n{_HEADERS}{more}Content-Length: {len(body)}\r\n\r\n"
        self._transport.write(head.encode("ascii") + (body if with_body else b""))
        # a socket that is closed with octets unread would take the answer away from the client
        if self._transport.can_write_eof():
            with contextlib.suppress(OSError):  # the client has reset the connection
                self._transport.write_eof()
        asyncio.get_running_loop().call_later(_GOODBYE_S, self._close)

    def _close(self) -> None:
        if self._transport is not None:
            self._transport.close()
