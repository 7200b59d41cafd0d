"""A connection to the OPC UA server in memory: octets before any security, sent by hand. No port, no address space."""

from __future__ import annotations

import asyncio
import struct
from typing import Any, Final

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.crypto.security_policies import SecurityPolicyNone
from asyncua.ua.ua_binary import nodeid_to_binary, struct_to_binary

from dpstack.bridge.opcua.connection import MOST_REQUEST, ClientConnection
from dpstack.bridge.opcua.sessions import LimitedServer
from dpstack.bridge.processor_share import ProcessorShare
from tests.fuzz.memory_transport import MemoryTransport

#: Part 6, 7.1.2.3: version, both buffers, no limit of messages and chunks; the text of an address
HELLO: Final = b"HELF" + struct.pack("<I5Ii", 32, 0, 65_535, 65_535, 0, 0, -1)
POLICY_NONE: Final = b"http://opcfoundation.org/UA/SecurityPolicy#None"


def text(octets: bytes) -> bytes:
    return len(octets).to_bytes(4, "little") + octets


def opening(body: bytes | None = None) -> bytes:
    """OpenSecureChannel without security."""
    if body is None:
        asked = ua.OpenSecureChannelRequest()
        asked.Parameters.SecurityMode = ua.MessageSecurityMode.None_
        asked.Parameters.RequestedLifetime = 60_000
        body = struct_to_binary(asked)
    rest = struct.pack("<I", 0) + text(POLICY_NONE) + struct.pack("<ii", -1, -1) + struct.pack("<II", 1, 1) + body
    return b"OPNF" + struct.pack("<I", len(rest) + 8) + rest


def header(additional: bytes = b"\0\0\0", token: ua.NodeId | None = None) -> bytes:
    """A RequestHeader with this AdditionalHeader."""
    made: bytes = (
        nodeid_to_binary(token or ua.NodeId()) + struct.pack("<qII", 0, 7, 0) + text(b"") + struct.pack("<I", 0)
    )
    return made + additional


def request(type_: int, body: bytes, head: bytes | None = None) -> bytes:
    type_id: bytes = nodeid_to_binary(ua.NodeId(type_))
    return type_id + (header() if head is None else head) + body


def structure(type_: int, body: bytes) -> bytes:
    """An ExtensionObject."""
    type_id: bytes = nodeid_to_binary(ua.NodeId(type_))
    return type_id + b"\x01" + text(body)


class Wire(MemoryTransport):
    """``unread``: answers that the client has not taken."""

    def __init__(self, server: LimitedServer, address: str = "127.0.0.1") -> None:
        super().__init__(address)
        self.unread = 0
        self.number = 1
        limits = TransportLimits(max_message_size=MOST_REQUEST, max_chunk_count=17)
        self.clients = server_clients(server)
        none: Any = type("None_", (), {"matches": lambda *_: True, "create": lambda *_: SecurityPolicyNone()})
        self.protocol: ClientConnection = ClientConnection(server, [none()], self.clients, [], limits)
        self.protocol.connection_made(self)

    def get_write_buffer_size(self) -> int:
        return self.unread

    async def send(self, *octets: bytes) -> bytes:
        """Send, let the server work, return its new octets."""
        before = len(self.said)
        for one in octets:
            if not self.closed:
                self.protocol.data_received(one)
        ready = asyncio.get_running_loop()._ready  # type: ignore[attr-defined]  # empty: all others wait
        for _ in range(50):
            await asyncio.sleep(0)
            if not ready:
                break
        return bytes(self.said[before:])

    def message(self, body: bytes, kind: bytes = b"MSGF", *, token: int = 13) -> bytes:
        self.number += 1
        channel = self.protocol.processor._connection.security_token.ChannelId  # type: ignore[union-attr]
        rest = struct.pack("<IIII", channel, token, self.number, self.number) + body
        return kind + struct.pack("<I", len(rest) + 8) + rest

    async def opened(self) -> Wire:
        await self.send(HELLO, opening())
        assert self.said[:3] == b"ACK", bytes(self.said)
        assert b"OPNF" in self.said, bytes(self.said)
        return self


def server_clients(server: LimitedServer) -> list[Any]:
    """The list of connections of a server."""
    if not hasattr(server, "wires"):
        server.wires = []
    return server.wires  # type: ignore[no-any-return]


class NoServices:
    async def write(self, value: object, who: object) -> ua.StatusCode:
        return ua.StatusCode(ua.StatusCodes.BadNotWritable)

    async def call(self, method: object, who: object, session: object) -> ua.CallMethodResult:
        return ua.CallMethodResult(ua.StatusCode(ua.StatusCodes.BadMethodInvalid))


def bare_server() -> LimitedServer:
    """A server without nodes, for anonymous clients."""
    server = LimitedServer(None, anonymous=True, services=NoServices(), refuses=lambda _: None)
    server.pace = _Hasty()
    return server


class _Hasty(ProcessorShare):
    async def turn(self) -> None:
        await asyncio.sleep(0)
