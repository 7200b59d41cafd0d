"""A broker of MQTT 5 that takes any number of clients, hands out what the test gives, and keeps what it receives.

It knows as much of the protocol as a test of a subscriber needs: it does not route.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType

CONNECT, CONNACK, PUBLISH, SUBSCRIBE, SUBACK, UNSUBSCRIBE, UNSUBACK, PINGREQ, PINGRESP = 1, 2, 3, 8, 9, 10, 11, 12, 13
DISCONNECT = 14


async def packets(reader: asyncio.StreamReader) -> AsyncIterator[tuple[int, bytes]]:
    """Kind and body of each packet, until the end of the connection."""
    with suppress(asyncio.IncompleteReadError, ConnectionError):
        while True:
            kind = (await reader.readexactly(1))[0] >> 4
            length = shift = 0
            while True:
                octet = (await reader.readexactly(1))[0]
                length |= (octet & 0x7F) << shift
                shift += 7
                if octet < 0x80:
                    break
            yield kind, await reader.readexactly(length)


def packet(kind: int, body: bytes, flags: int = 0) -> bytes:
    length, octets = len(body), bytearray()
    while True:
        length, octet = divmod(length, 128)
        octets.append(octet | (0x80 if length else 0))
        if not length:
            return bytes([kind << 4 | flags]) + bytes(octets) + body


def text(given: str) -> bytes:
    return struct.pack(">H", len(given.encode())) + given.encode()


def user_property(name: str, value: str) -> bytes:
    return b"\x26" + text(name) + text(value)


def publish(topic: str, payload: bytes, *, expiry: int | None = None, retain: bool = False, user: bytes = b"") -> bytes:
    name = topic.encode()
    properties = (b"" if expiry is None else b"\x02" + struct.pack(">I", expiry)) + user
    return packet(
        PUBLISH, struct.pack(">H", len(name)) + name + bytes([len(properties)]) + properties + payload, retain
    )


@dataclass
class FakeBroker:
    """``refuses``: reason code of CONNACK, 0: it takes every client. ``retained``: packets for each subscriber, behind
    its last subscription (:attr:`topics` of them). ``received``: (kind, body) of the packets of all clients."""

    refuses: int = 0
    topics: int = 4
    retained: list[bytes] = field(default_factory=list)
    received: list[tuple[int, bytes]] = field(default_factory=list)
    writers: list[asyncio.StreamWriter] = field(default_factory=list)
    port: int = 0

    async def __aenter__(self) -> FakeBroker:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.close()
        self.cut()
        await asyncio.sleep(0)

    @property
    def url(self) -> str:
        return f"mqtt://127.0.0.1:{self.port}"

    def kinds(self) -> set[int]:
        return {kind for kind, _ in self.received}

    def send(self, octets: bytes) -> None:
        """Hand ``octets`` to every client."""
        for writer in self.writers:
            writer.write(octets)

    def cut(self) -> None:
        """End all connections."""
        for writer in self.writers:
            writer.close()
        self.writers.clear()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        subscribed = 0
        async for kind, body in packets(reader):
            self.received.append((kind, body))
            if kind == CONNECT:
                writer.write(packet(CONNACK, bytes([0, self.refuses, 0])))
                self.writers.append(writer)
            elif kind == SUBSCRIBE:
                writer.write(packet(SUBACK, body[:2] + b"\x00\x00"))
                subscribed += 1
                if subscribed == self.topics:
                    writer.write(b"".join(self.retained))
            elif kind == PINGREQ:
                writer.write(packet(PINGRESP, b""))
        writer.close()
