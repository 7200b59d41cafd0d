"""A gateway for programs of others that read PROFIBUS PA devices over UDP, on this computer only.

A request is four octets: a marker that the program chooses, address, slot, index. The answer is the marker and the
octets of the parameter; the marker alone says that the parameter could not be read. Source: the three programs that
docs/development/foreign.md#process-devices names.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any, Final, cast

#: reads a parameter: address, slot, index; raises if the device refuses
Read = Callable[[int, int, int], Awaitable[bytes]]

_REQUEST: Final = 4
LOCALHOST: Final = "127.0.0.1"


class Gateway(asyncio.DatagramProtocol):
    """Answers requests one after the other, as one class 2 connection does. ``asked``: address, slot, index of each."""

    def __init__(self, read: Read) -> None:
        self._read = read
        self._turn = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()
        self._transport: asyncio.DatagramTransport | None = None
        self.asked: list[tuple[int, int, int]] = []
        #: what a read raised, by the parameter that was asked for
        self.refused: dict[tuple[int, int, int], str] = {}

    @property
    def port(self) -> int:
        assert self._transport is not None
        return int(self._transport.get_extra_info("sockname")[1])

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        if len(data) != _REQUEST:
            return
        task = asyncio.ensure_future(self._answer(data[:1], (data[1], data[2], data[3]), addr))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _answer(self, marker: bytes, asked: tuple[int, int, int], addr: tuple[str | Any, int]) -> None:
        async with self._turn:
            self.asked.append(asked)
            try:
                octets = await self._read(*asked)
            except Exception as error:
                self.refused[asked] = f"{type(error).__name__}: {error}"
                octets = b""
        assert self._transport is not None
        self._transport.sendto(marker + octets, addr)

    async def close(self) -> None:
        """No answer is sent after this."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._transport is not None:
            self._transport.close()


@asynccontextmanager
async def gateway(read: Read, port: int = 0) -> AsyncIterator[Gateway]:
    """A gateway on 127.0.0.1; ``port`` 0: any free one."""
    loop = asyncio.get_running_loop()
    _, protocol = await loop.create_datagram_endpoint(lambda: Gateway(read), local_addr=(LOCALHOST, port))
    try:
        yield protocol
    finally:
        await protocol.close()
