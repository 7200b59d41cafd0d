"""The web server: the files of the page, and a WebSocket for each page that is open.

It neither opens a port nor drives a bus: a :class:`~dpstack.web.source.Source` gives it items, and carries out orders.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import weakref
from collections import Counter
from collections.abc import AsyncIterator, Callable, Collection, Coroutine, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from aiohttp import HttpVersion10, HttpVersion11, WSMsgType, web

from dpstack import __version__
from dpstack.api.commissioning.commissioning import Commissioning
from dpstack.errors import DpError, PortError
from dpstack.plant.items import CheckedItem, check_item
from dpstack.plant.state import end_of
from dpstack.tcp_address import Listen, Origins, is_local, join
from dpstack.text import iso_time, printable
from dpstack.web.asks import Asks
from dpstack.web.fan_out import FanOut, Reader
from dpstack.web.messages import MOST_OCTETS, Ask, Hello, MessageError, PageOrder, answer, encode, parse
from dpstack.web.orders import carry_out
from dpstack.web.page_files import FOLDER, HEADERS, read_page
from dpstack.web.rights import Rights, Visitor, network_of
from dpstack.web.source import KindChanged, Note, Source, SourceItem

#: writes a line of the log
Log = Callable[[str], None]

#: pages at the same time, WebSockets that have not said hello (in all, and of one network), connections of all kinds
_MOST_PAGES: Final = 64
_MOST_STRANGERS: Final = 32
_MOST_OF_A_NETWORK: Final = 16
_MOST_CONNECTIONS: Final = 256
_BACKLOG: Final = 64
#: of HTTP; aiohttp would take 0.9 and 2.0 too
_VERSIONS: Final = (HttpVersion10, HttpVersion11)
#: hosts of --listen that are no address to open
_EVERYWHERE: Final = ("0.0.0.0", "::")
#: seconds for the first message
_HELLO_S: Final = 10.0
#: asks and orders of one page under way, and messages a second of it, after a burst
_MOST_UNDER_WAY: Final = 4
_RATE: Final = 10.0
_BURST: Final = 30.0
#: invalid messages of a page before it is disconnected
_MOST_NONSENSE: Final = 20
_PING_S: Final = 20.0
#: times beyond it, in s since 1970, are no times (year 4000)
_LATEST: Final = 64e9
#: seconds at the end for pages that do not answer
_GOODBYE_S: Final = 1.0


class WebServer:
    """The server of ``source``. :func:`serve` starts and ends it.

    ``host``: its name in its address. ``patience_s``: a page that does not take what it is sent for so long is
    disconnected.
    """

    def __init__(
        self,
        source: Source,
        sockets: Sequence[socket.socket],
        rights: Rights,
        log: Log,
        *,
        names: Collection[str] = (),
        host: str | None = None,
        tls: ssl.SSLContext | None = None,
        folder: Path = FOLDER,
        commissioning: Commissioning | None = None,
    ) -> None:
        self.source = source
        self.rights = rights
        self.fan_out = FanOut()
        self.patience_s = 30.0
        self.log = log
        self.asks = Asks(source, commissioning)
        self._sockets = sockets
        self._tls = tls
        bound, port = sockets[0].getsockname()[:2]
        self._origins = Origins(names, port, secure=tls is not None)
        self._base = f"{'http' if tls is None else 'https'}://{join(host or bound, port)}/"
        self._files = read_page(folder)
        self._pages: set[_Page] = set()
        self._strangers: Counter[str] = Counter()  # by network
        self._handshakes = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self._runner: web.AppRunner | None = None
        #: what the clock of the stream is ahead of the time of the loop, in s; None: there is no stream
        self._clock: float | None = None
        self._listening: list[asyncio.Server] = []
        self._answered: weakref.WeakSet[asyncio.BaseTransport] = weakref.WeakSet()

    @property
    def url(self) -> str:
        """The address of the page, with the secret of this start behind ``#`` if orders need it."""
        return self._base + (f"#{self.rights.secret}" if self.rights.secret else "")

    @property
    def pages(self) -> int:
        """The number of open pages."""
        return len(self._pages)

    async def open(self) -> None:
        app = web.Application(client_max_size=1024)
        app.router.add_route("*", "/{path:.*}", self._respond)
        self._runner = web.AppRunner(
            app,
            access_log=None,
            handle_signals=False,
            shutdown_timeout=_GOODBYE_S,
            keepalive_timeout=_HELLO_S,
            max_line_size=4096,
            logger=_quiet_logger(),
        )
        await self._runner.setup()
        loop = asyncio.get_running_loop()
        try:
            # without ssl: asyncio reports a connection after its handshake, so their number would have no limit
            self._listening = [
                await loop.create_server(self._accept, sock=one, backlog=_BACKLOG) for one in self._sockets
            ]
        except OSError as exc:  # somebody else has begun to listen there
            raise PortError(f"{self._base}: {exc.strerror or exc}; give another address with --listen") from None
        self.spawn(self._follow_source())
        self.spawn(self.fan_out.run())

    async def close(self) -> None:
        """End in order: the pages are informed, then disconnected."""
        self.fan_out.put(check_item(end_of("the web server ends", failed=False)))
        self.fan_out.hand_out()
        for page in list(self._pages):
            page.finish()
        if self._pages:
            await asyncio.wait([page.over for page in self._pages], timeout=_GOODBYE_S)
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)
        for one in self._listening:
            one.close()
        if self._runner is not None:
            await self._runner.cleanup()

    def spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """Run ``work`` beside everything else, until the end of the server at most."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def tell(self, text: str, severity: str = "info", *, pages: bool = True, **more: object) -> None:
        """An event of the server itself, in the log, and on all ``pages``. The log has the clock of this computer, the
        pages that of the stream: it goes on evenly, also if somebody has set the clock since the run began."""
        now, text = _now(), printable(text)
        self.log(f"{now} {text}")
        if not pages:
            return
        time = now if self._clock is None else iso_time(self._clock + asyncio.get_running_loop().time())
        event = {"event": "web", "time": time, "severity": severity, "text": text, **more}
        self.fan_out.put(check_item({"event": event}))

    # --- the source -----------------------------------------------------------------------------------------------

    async def _follow_source(self) -> None:
        try:
            async with contextlib.aclosing(self.source.items()) as items:
                async for item in items:
                    self._take(item)
        except DpError as error:
            self.tell(str(error), "error")

    def _take(self, item: SourceItem) -> None:
        if isinstance(item, KindChanged):
            self._source_changed()
        elif isinstance(item, Note):
            self.tell(item.text, item.severity)
        else:
            self.fan_out.put(item)
            self._set_clock(item)

    def _set_clock(self, item: CheckedItem) -> None:
        state = self.fan_out.state
        started = -1.0 if state.plant is None or self.source.kind == "replay" else state.plant.started
        if not 0 <= started < _LATEST:
            self._clock = None
        elif item.snapshot is not None and state.t >= 0:
            self._clock = started + state.t - asyncio.get_running_loop().time()

    def _source_changed(self) -> None:
        self.fan_out.hand_out()
        if self.source.kind == "none":
            self.fan_out.forget()
            self._clock = None
        for page in self._pages:
            page.welcome()

    # --- requests -------------------------------------------------------------------------------------------------

    def _accept(self) -> asyncio.Protocol:
        """The protocol of a new connection. One beyond the limit is closed at once, one without a TLS handshake or
        without a request after 10 s."""
        assert self._runner is not None
        server = self._runner.server
        assert server is not None
        if len(server.connections) + self._handshakes >= _MOST_CONNECTIONS:
            return _Refused()
        return self._handler() if self._tls is None else _Handshake(self._shake_hands)

    def _handler(self) -> web.RequestHandler:
        assert self._runner is not None
        assert self._runner.server is not None
        handler = self._runner.server()
        asyncio.get_running_loop().call_later(_HELLO_S, self._drop_silent, handler)
        return handler

    def _shake_hands(self, transport: asyncio.Transport, waiting: _Handshake) -> None:
        self._handshakes += 1
        self.spawn(self._serve_over_tls(transport, waiting))

    async def _serve_over_tls(self, transport: asyncio.Transport, waiting: _Handshake) -> None:
        assert self._tls is not None
        try:
            over_tls = await asyncio.get_running_loop().start_tls(
                transport, waiting, self._tls, server_side=True, ssl_handshake_timeout=_HELLO_S
            )
        except OSError:  # of TLS too; start_tls has closed it
            return
        except asyncio.CancelledError:
            transport.abort()
            raise
        finally:
            self._handshakes -= 1
        if over_tls is None or over_tls.is_closing():
            return
        handler = self._handler()
        over_tls.set_protocol(handler)
        handler.connection_made(over_tls)
        if waiting.octets:
            handler.data_received(bytes(waiting.octets))

    def _drop_silent(self, handler: web.RequestHandler) -> None:
        transport = handler.transport
        if transport is not None and transport not in self._answered:
            transport.close()

    async def _respond(self, request: web.Request) -> web.StreamResponse:
        if request.transport is not None:
            self._answered.add(request.transport)
            if request.version not in _VERSIONS:
                # aiohttp would write the version of the request into the status line
                request.transport.write(b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\nContent-Length: 0\r\n\r\n")
                request.transport.close()
                return web.Response(status=400)  # written nowhere any more
        host = request.headers.get("Host")
        if not self._origins.is_own_host(host):
            return _refusal(421, "this server is not the one of that name: open the address that it has printed")
        if request.path == "/ws":
            if not self._origins.is_own_origin(request.headers.get("Origin"), host):
                return _refusal(403, "a WebSocket is opened by a page of this server only")
            return await self._talk(request)
        if request.method not in ("GET", "HEAD"):
            return _refusal(405, "only GET")
        file = self._files.get(request.path)
        if file is None:
            return _refusal(404, "there is no such page")
        return web.Response(body=file.octets, headers={**HEADERS, "Content-Type": file.content_type})

    async def _talk(self, request: web.Request) -> web.StreamResponse:
        network = network_of(request.remote or "")
        if self._strangers.total() >= _MOST_STRANGERS or self._strangers[network] >= _MOST_OF_A_NETWORK:
            return _refusal(503, "too many connections have not said hello")
        if len(self._pages) >= _MOST_PAGES:
            return _refusal(503, f"{_MOST_PAGES} pages are open: close one")
        ws = web.WebSocketResponse(timeout=_GOODBYE_S, heartbeat=_PING_S, compress=False, max_msg_size=MOST_OCTETS + 1)
        ws.headers.update(HEADERS)
        try:
            may_begin = ws.can_prepare(request).ok
        except ValueError:  # a Sec-WebSocket-Key that is no ASCII
            may_begin = False
        if not may_begin:
            return _refusal(426, "this address is for a WebSocket")
        await ws.prepare(request)
        with contextlib.suppress(ConnectionError):  # the page has gone
            self._strangers[network] += 1
            try:
                visitor = await self._let_in(ws, request.remote or "")
            finally:
                self._strangers -= Counter((network,))
            if visitor is not None:
                page = _Page(self, ws, request, visitor)
                self._pages.add(page)
                try:
                    await page.run()
                finally:
                    self._pages.discard(page)
        return ws

    async def _let_in(self, ws: web.WebSocketResponse, remote: str) -> Visitor | None:
        """The rights of a page by its first message. None if it has none and was disconnected."""
        why = f"the first message did not come within {_HELLO_S:g} s"
        try:
            async with asyncio.timeout(_HELLO_S):
                message = await ws.receive()
            if message.type is not WSMsgType.TEXT:
                raise MessageError("the first message is hello, a text")
            hello = parse(message.data)
            if not isinstance(hello, Hello):
                raise MessageError("the first message is hello")
        except (MessageError, TimeoutError) as error:
            await _refuse(ws, str(error) or why)
            return None
        if hello.token is not None and not await self.rights.pauses.wait(remote):
            await _refuse(ws, "too many wrong tokens from this address: wait half a minute")
            return None
        visitor = self.rights.visitor(hello.token)
        if hello.token is not None:
            self.rights.pauses.judge(remote, visitor is not None)
        if visitor is None:
            if hello.token is None:
                await _refuse(ws, "a token is needed")
                return None
            self.log(f"{_now()} a wrong token from {printable(remote)}")
            if self.rights.tokens is None:
                await _refuse(ws, "this address is of an earlier start: open the one that was printed last")
            else:
                await _refuse(ws, "the token is wrong")
        return visitor


class _Handshake(asyncio.Protocol):
    """A connection until its TLS handshake is over. Keeps octets that come with the end of the handshake."""

    def __init__(self, begin: Callable[[asyncio.Transport, _Handshake], None]) -> None:
        self._begin: Callable[[asyncio.Transport, _Handshake], None] | None = begin
        self.octets = bytearray()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        begin, self._begin = self._begin, None
        if begin is not None:
            transport.pause_reading()  # the first octets are for TLS
            begin(transport, self)

    def data_received(self, data: bytes) -> None:
        self.octets += data


class _Refused(asyncio.Protocol):
    """Closes its connection at once."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport.close()


def _quiet_logger() -> logging.Logger:
    """The logger for aiohttp, which would write octets of strangers to the terminal."""
    logger = logging.getLogger("dpstack.web.aiohttp")
    logger.propagate = False
    logger.addHandler(logging.NullHandler())
    return logger


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _refusal(status: int, text: str) -> web.Response:
    return web.Response(
        status=status, text=f"dpstack: {text}\n", headers={**HEADERS, "Content-Type": "text/plain; charset=utf-8"}
    )


async def _refuse(ws: web.WebSocketResponse, text: str) -> None:
    with contextlib.suppress(ConnectionError):
        await ws.send_str(encode({"refused": text}))
        await ws.close()


class _Page:
    """One open page."""

    def __init__(self, server: WebServer, ws: web.WebSocketResponse, request: web.Request, visitor: Visitor) -> None:
        self._server = server
        self._ws = ws
        self._request = request
        self._visitor = visitor
        self._reader: Reader = server.fan_out.join()
        self._under_way: set[asyncio.Task[None]] = set()
        self._credit = _BURST
        self._credit_at = asyncio.get_running_loop().time()
        self._nonsense = 0
        self._is_ending = False
        #: done when the page has gone
        self.over: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def welcome(self) -> None:
        """Inform the page that the kind of the source has changed, behind the items before that."""
        self._say(self._welcome())

    def _welcome(self) -> str:
        """The rights of the page and the kind of the source."""
        visitor = self._visitor
        welcome = {"control": visitor.control, "name": visitor.name, "source": self._server.source.kind}
        return encode({"welcome": {**welcome, "version": __version__}})

    def finish(self) -> None:
        """Disconnect the page as soon as it has got what waits for it."""
        self._is_ending = True
        self._reader.wake()

    async def run(self) -> None:
        writing = asyncio.ensure_future(self._write(self._welcome()))
        try:
            await self._read()
        finally:
            self._server.fan_out.leave(self._reader)
            tasks = [writing, *self._under_way]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self.over.set_result(None)

    async def _write(self, first: str) -> None:
        try:
            await self._send(first)
            while not (self._is_ending and self._reader.is_empty):
                for text in await self._reader.take():
                    await self._send(text)
            await self._ws.close()
        except TimeoutError:
            self._hang_up()
        except ConnectionError:
            pass  # it has gone

    async def _send(self, text: str) -> None:
        async with asyncio.timeout(self._server.patience_s):
            await self._ws.send_str(text)

    def _hang_up(self) -> None:
        """Disconnect a page that does not read, at once."""
        if self._request.transport is not None:
            self._request.transport.abort()

    def _say(self, text: str) -> None:
        if not self._reader.say(text):
            self._hang_up()

    async def _read(self) -> None:
        async for message in self._ws:
            if self._is_ending:
                continue
            id = None
            try:
                if message.type is not WSMsgType.TEXT:
                    raise MessageError("a message is a text")
                parsed = parse(message.data)
                if isinstance(parsed, Hello):
                    raise MessageError("hello comes once")
                id = parsed.id
                self._check_rate()
                self._begin(parsed)
            except MessageError as error:
                self._say(answer(error.id if id is None else id, error=str(error)))
                self._nonsense += id is None
                if self._nonsense >= _MOST_NONSENSE:
                    self._say(encode({"refused": "too many invalid messages"}))
                    self.finish()

    def _check_rate(self) -> None:
        now = asyncio.get_running_loop().time()
        self._credit = min(_BURST, self._credit + (now - self._credit_at) * _RATE)
        self._credit_at = now
        if self._credit < 1:
            raise MessageError(f"more than {_RATE:g} messages a second: this one was left out")
        self._credit -= 1
        if len(self._under_way) >= _MOST_UNDER_WAY:
            raise MessageError(f"{_MOST_UNDER_WAY} of your requests are under way: wait for an answer")

    def _begin(self, message: Ask | PageOrder) -> None:
        task = asyncio.ensure_future(self._answer(message))
        self._under_way.add(task)
        task.add_done_callback(self._under_way.discard)

    async def _answer(self, message: Ask | PageOrder) -> None:
        try:
            if isinstance(message, PageOrder):
                result = await carry_out(self._server.source, self._visitor, message, self._server.tell)
            else:
                result = await self._server.asks.answer(message)
            text = answer(message.id, result)
        except (DpError, ValueError) as error:
            text = answer(message.id, error=printable(str(error)))
        except Exception as error:  # a defect must not end the page
            self._server.log(f"{_now()} a defect, please report it: {type(error).__name__}: {printable(str(error))}")
            text = answer(message.id, error=f"failed by a defect, please report it: {type(error).__name__}")
        self._say(text)


@contextlib.asynccontextmanager
async def serve(
    source: Source,
    listen: Listen | None = None,
    *,
    rights: Rights | None = None,
    log: Log = lambda _: None,
    tls: ssl.SSLContext | None = None,
    names: Collection[str] = (),
    folder: Path = FOLDER,
    sockets: Sequence[socket.socket] | None = None,
    commissioning: Commissioning | None = None,
) -> AsyncIterator[WebServer]:
    """Serve the page of ``source`` within the context, on a free port of this computer unless ``listen`` says another.

    ``sockets``: listening ones instead of ``listen``; ``names``: names of this server in a URL; ``log`` gets a line for
    each order and each event of the server; ``commissioning``: its asks. Raises PortError.
    """
    listen = listen or Listen("127.0.0.1", 0)
    opened = listen.sockets() if sockets is None else sockets
    own = () if is_local(opened) else (socket.gethostname(), listen.host)
    host = socket.gethostname() if listen.host in _EVERYWHERE else listen.host
    server = WebServer(
        source,
        opened,
        rights or Rights(),
        log,
        names=(*names, *own),
        host=host,
        tls=tls,
        folder=folder,
        commissioning=commissioning,
    )
    try:
        await server.open()
        yield server
    finally:
        await server.close()
        await source.close()
        for one in opened:
            one.close()
