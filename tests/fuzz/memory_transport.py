"""A connection to a server in memory: no port, no socket."""

from __future__ import annotations

import asyncio
from typing import Any


class MemoryTransport(asyncio.Transport):
    """The server's end. ``said``: its octets; ``protocol``: given by the subclass or the test."""

    protocol: Any

    def __init__(self, client: str = "127.0.0.1", port: int = 4840) -> None:
        super().__init__({"peername": (client, 4711), "sockname": ("127.0.0.1", port)})
        self.said = bytearray()
        self.closed = False

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.said += data

    def can_write_eof(self) -> bool:
        return True

    def write_eof(self) -> None:
        return

    def is_closing(self) -> bool:
        return self.closed

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            asyncio.get_running_loop().call_soon(self.protocol.connection_lost, None)

    abort = close
