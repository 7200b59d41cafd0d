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
from dpstack.fdl.services.orders import CloseSap, FdlIndicated, TakenIndications, UpdateReply, data_limit, sap_name

#: gets each indication: a plain function, or an async one
OnReceive = Callable[[FdlIndicated], object]


class SapHost(Protocol):
    """The FDL services as a SAP uses them, see :class:`~dpstack.api.fdl.requests.Fdl`."""

    @property
    def is_virtual(self) -> bool: ...
    def command(self, order: object) -> None: ...
    async def order(self, order: object) -> None: ...
    async def close_sap(self, sap: Sap, order: CloseSap) -> None: ...
    def report(self, text: str, error: Exception) -> None: ...


class Sap(Sealed):
    """An activated SAP of this station, made by ``await fdl.sap(number)``. ``async with`` it, or :meth:`close` it.

    With ``on_receive`` each indication is given to that function, one after the other. A plain function runs in a
    thread of its own, an async one in the event loop; one that raises is reported, and the next indication follows.
    Without it the program takes them by :meth:`receive` or :meth:`indications`.
    """

    #: number of the SAP, 0..62; None: the default SAP
    number: int | None

    def __init__(self, fdl: SapHost, number: int | None, on_receive: OnReceive | None) -> None:
        self.number = number
        self._fdl = fdl
        self._on_receive = on_receive
        self._waiting: deque[FdlIndicated] = deque()
        self._readers: deque[asyncio.Future[None]] = deque()
        self._over: DpError | None = None
        self._handling: asyncio.Task[None] | None = None
        if on_receive is not None:
            self._handling = asyncio.get_running_loop().create_task(self._handle_all(on_receive))
        self._seal(Sap)

    def __repr__(self) -> str:
        state = "open" if self._over is None else "closed"
        return f"<Sap {'default' if self.number is None else self.number} {state}>"

    async def __aenter__(self) -> Sap:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    @property
    def is_open(self) -> bool:
        """True until :meth:`close`, or the end of the bus."""
        return self._over is None

    @property
    def waiting(self) -> int:
        """Indications that the program has not taken yet."""
        return len(self._waiting)

    async def close(self) -> None:
        """Deactivate the SAP: other stations get RS. May be repeated."""
        if self._over is not None:
            return
        self.end(UsageError(f"{sap_name(self.number)} is closed"))
        with contextlib.suppress(DpError):  # the bus may have ended meanwhile
            await self._fdl.close_sap(self, CloseSap(self.number))

    async def update(self, data: bytes | None, *, high: bool = False, once: bool = False) -> None:
        """Set the reply data (0..244 octets, 246 at the default SAP) that an SRD to this SAP gets from now on (DL).

        ``data`` None: none (NR). ``high``: with high priority (DH). ``once``: for one reply only, then NR
        (FDL_REPLY_UPDATE Single; else Multiple). Returns when the station has them. Raises UsageError for other data.
        """
        if data is not None:
            data = octets("data", data)
            if len(data) > data_limit(self.number, self.number):
                limit = data_limit(self.number, self.number)
                raise UsageError(f"{sap_name(self.number)}: {len(data)} octets of reply data given; {limit} fit")
        self._check_open()
        await self._fdl.order(UpdateReply(self.number, data, bool(high), bool(once)))

    async def receive(self, timeout: float | None = None) -> FdlIndicated:
        """The next indication. Raises TimeoutError, and UsageError or BusError when SAP or bus is closed."""
        seconds("timeout", timeout)
        if self._on_receive is not None:
            raise UsageError(
                f"{sap_name(self.number)} gives its indications to on_receive: leave that out to receive()"
            )
        async with asyncio.timeout(timeout):
            return await self._next()

    async def indications(self) -> AsyncIterator[FdlIndicated]:
        """The indications one after the other; ends when SAP or bus is closed."""
        while True:
            try:
                indication = await self.receive()
            except DpError:
                if self._over is None:
                    raise
                return
            yield indication

    # --- for the rooms of dpstack -------------------------------------------------------------------------------
    def take(self, indication: FdlIndicated) -> None:
        """An indication of the station."""
        if self._over is not None:
            return
        self._waiting.append(indication)
        self._wake()

    def end(self, error: DpError) -> None:
        """No indication follows; later calls raise ``error``."""
        if self._over is None:
            self._over = error
            self._wake()

    def _wake(self) -> None:
        while self._readers:
            reader = self._readers.popleft()
            if not reader.done():
                reader.set_result(None)

    def _check_open(self) -> None:
        if self._over is not None:
            raise self._over

    async def _next(self) -> FdlIndicated:
        while not self._waiting:
            self._check_open()
            reader = asyncio.get_running_loop().create_future()
            self._readers.append(reader)
            await reader
        indication = self._waiting.popleft()
        if self._over is None:
            with contextlib.suppress(DpError):  # the bus may have ended meanwhile
                self._fdl.command(TakenIndications(self.number, 1))
        return indication

    async def _handle_all(self, on_receive: OnReceive) -> None:
        while True:
            while not self._waiting:
                if self._over is not None:
                    return
                reader = asyncio.get_running_loop().create_future()
                self._readers.append(reader)
                await reader
            indication = self._waiting[0]
            try:
                await self._call(on_receive, indication)
            except Exception as error:
                self._fdl.report(f"on_receive of {sap_name(self.number)} raised {type(error).__name__}: {error}", error)
            self._waiting.popleft()
            if self._over is None:
                with contextlib.suppress(DpError):
                    self._fdl.command(TakenIndications(self.number, 1))

    async def _call(self, on_receive: OnReceive, indication: FdlIndicated) -> None:
        if inspect.iscoroutinefunction(on_receive):
            await on_receive(indication)
        elif self._fdl.is_virtual:  # bus time stands still meanwhile
            await _result_of(on_receive(indication))
        else:
            await _result_of(await _in_thread(on_receive, indication))


async def _result_of(value: object) -> None:
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
