"""Control sockets in tests: their paths, and a client that knows octets only."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

from dpstack.api.control.socket_path import directory, socket_name


def socket_of(name: str) -> Path:
    """The control socket of the program on the port ``name``."""
    return control_directory() / socket_name(name)


def control_directory() -> Path:
    """The directory of all control sockets."""
    return Path(directory())


class OctetClient:
    """A client of a control socket that sends and receives lines of octets."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def ask(self, line: bytes) -> bytes:
        """The first line of the answer to the request ``line``."""
        self.writer.write(line + b"\n")
        return await self.line()

    async def line(self) -> bytes:
        """The next line."""
        return await asyncio.wait_for(self.reader.readline(), 10)

    async def is_closed(self) -> bool:
        """Whether the program closes the connection without another answer."""
        return await asyncio.wait_for(self.reader.read(-1), 10) == b""

    async def is_served(self) -> bool:
        """Whether the program answers ``status``."""
        return b'"ok":true' in await self.ask(b'{"command":"status"}')


@contextlib.asynccontextmanager
async def octet_client(port: str = "COM3") -> AsyncIterator[OctetClient]:
    """A connection to the program on ``port``."""
    reader, writer = await asyncio.open_unix_connection(str(socket_of(port)))
    try:
        yield OctetClient(reader, writer)
    finally:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()
