"""``Sap``: a service access point of one's own: indications, their handler, reply data.

The bus never waits for the program: the station answers by itself, from the reply data that it was given before. What
the program has not taken waits, up to ``queue`` indications; then other stations get RR, and SDN telegrams are counted
as lost.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import threading
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, Protocol

from dpstack.argcheck import Sealed, octets, seconds
from dpstack.errors import DpError, UsageError
from dpstack.fdl.services.orders import FdlIndicated, TakenIndications, UpdateReply, data_limit, sap_name

#: gets each indication: a plain function, or an async one
OnReceive = Callable[[FdlIndicated], object]


class SapQueue:
    """The indications of the SAP ``number`` that the program has not taken."""

    def __init__(self, number: int | None) -> None:
        self.number = number
        self.waiting: deque[FdlIndicated] = deque()
        #: why no indication follows; None while the SAP is open
        self.over: DpError | None = None
        self._readers: deque[asyncio.Future[None]] = deque()

    def take(self, indication: FdlIndicated) -> None:
        """An indication of the station."""
        if self.over is None:
            self.waiting.append(indication)
            self._wake()

    def end(self, error: DpError) -> None:
        """No indication follows; later calls raise ``error``."""
        if self.over is None:
            self.over = error
            self._wake()

    def check_open(self) -> None:
        """Raises the reason of the end."""
        if self.over is not None:
            raise self.over

    async def first(self) -> FdlIndicated:
        """The oldest indication, which stays in the queue. Raises the reason of the end once the queue
        is empty."""
        while not self.waiting:
            self.check_open()
            reader = asyncio.get_running_loop().create_future()
            self._readers.append(reader)
            await reader
        return self.waiting[0]

    def _wake(self) -> None:
        while self._readers:
            reader = self._readers.popleft()
            if not reader.done():  # cancelled
                reader.set_result(None)


class SapLink(Protocol):
    """The FDL services as a SAP uses them, see :class:`~dpstack.api.fdl.link.FdlLink`."""

    @property
    def is_virtual(self) -> bool: ...
    def command(self, order: object) -> None: ...
    async def order(self, order: object) -> None: ...
    async def close_sap(self, queue: SapQueue) -> None: ...
    def report(self, text: str, error: Exception) -> None: ...


class Sap(Sealed):
    """An activated SAP of this station, made by ``await fdl.sap(number)``. ``async with`` it, or :meth:`close` it.

    With ``on_receive`` each indication is given to that function, one after the other. A plain function runs in a
    thread of its own, an async one in the event loop; one that raises is reported, and the next indication follows.
    Without it the program takes them by :meth:`receive` or :meth:`indications`.
    """

    def __init__(self, link: SapLink, inside: SapQueue, on_receive: OnReceive | None) -> None:
        self._link = link
        self._inside = inside
        self._handling: asyncio.Task[None] | None = None
        if on_receive is not None:
            self._handling = asyncio.get_running_loop().create_task(self._handle_all(on_receive))
        self._seal(Sap)

    def __repr__(self) -> str:
        return f"<Sap {'default' if self.number is None else self.number} {'open' if self.is_open else 'closed'}>"

    async def __aenter__(self) -> Sap:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    @property
    def number(self) -> int | None:
        """Number of the SAP, 0..62; None: the default SAP."""
        return self._inside.number

    @property
    def is_open(self) -> bool:
        """True until :meth:`close`, or the end of the bus."""
        return self._inside.over is None

    @property
    def waiting(self) -> int:
        """Indications that the program has not taken yet."""
        return len(self._inside.waiting)

    async def close(self) -> None:
        """Deactivate the SAP: other stations get RS. May be repeated."""
        if self.is_open:
            self._inside.end(UsageError(f"{sap_name(self.number)} is closed"))
            await self._link.close_sap(self._inside)

    async def update(self, data: bytes | None, *, high: bool = False, once: bool = False) -> None:
        """Set the reply data (0..244 octets, 246 at the default SAP) that an SRD to this SAP gets from now on (DL).

        ``data`` None: none (NR). ``high``: with high priority (DH). ``once``: for one reply only, then NR
        (FDL_REPLY_UPDATE Single; else Multiple). Returns when the station has them. Raises UsageError for other data.
        """
        if data is not None:
            data, limit = octets("data", data), data_limit(self.number, self.number)
            if len(data) > limit:
                raise UsageError(f"{sap_name(self.number)}: {len(data)} octets of reply data given; {limit} fit")
        self._inside.check_open()
        await self._link.order(UpdateReply(self.number, data, bool(high), bool(once)))

    async def receive(self, timeout: float | None = None) -> FdlIndicated:
        """The next indication. Raises TimeoutError, and UsageError or BusError when SAP or bus is closed."""
        seconds("timeout", timeout)
        if self._handling is not None:
            raise UsageError(
                f"{sap_name(self.number)} gives its indications to on_receive: leave that out to receive()"
            )
        async with asyncio.timeout(timeout):
            indication = await self._inside.first()
        self._taken()
        return indication

    async def indications(self) -> AsyncIterator[FdlIndicated]:
        """The indications one after the other; ends when SAP or bus is closed."""
        while self.is_open or self.waiting:
            try:
                indication = await self.receive()
            except DpError:
                if self.is_open:
                    raise
                return
            yield indication

    def _taken(self) -> None:
        """The program has taken the oldest indication."""
        self._inside.waiting.popleft()
        if self.is_open:
            self._link.command(TakenIndications(self.number, 1))

    async def _handle_all(self, on_receive: OnReceive) -> None:
        while True:
            try:
                indication = await self._inside.first()
            except DpError:
                return
            try:
                await self._call(on_receive, indication)
            except Exception as error:
                text = f"on_receive of {sap_name(self.number)} raised {type(error).__name__}: {error}"
                self._link.report(text, error)
            self._taken()

    async def _call(self, on_receive: OnReceive, indication: FdlIndicated) -> None:
        if inspect.iscoroutinefunction(on_receive) or self._link.is_virtual:  # bus time stands still meanwhile
            value = on_receive(indication)
        else:
            value = await _in_thread(on_receive, indication)
        if inspect.isawaitable(value):
            awaitable: Awaitable[Any] = value
            await awaitable


async def _in_thread(function: OnReceive, indication: FdlIndicated) -> object:
    """``function(indication)`` in a thread that does not hold up the end of the program."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[object] = loop.create_future()

    def finish(value: object, error: Exception | None) -> None:
        if done.done():
            return
        if error is None:
            done.set_result(value)
        else:
            done.set_exception(error)

    def run() -> None:
        value, failed = None, None
        try:
            value = function(indication)
        except Exception as error:
            failed = error
        with contextlib.suppress(RuntimeError):  # the loop is over, and the bus with it
            loop.call_soon_threadsafe(finish, value, failed)

    threading.Thread(target=run, name="dpstack on_receive", daemon=True).start()
    return await done
