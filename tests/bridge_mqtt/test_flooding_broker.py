"""A broker of octets that floods its client, or sends a packet without end; a socket that is gone."""

from __future__ import annotations

import asyncio
import logging
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import aiomqtt
import pytest

from dpstack.bridge.mqtt.limited_client import MOST_A_SECOND, MOST_PACKET, LimitedClient

CONNACK = bytes((0x20, 3, 0, 0, 0))


@asynccontextmanager
async def broker(*flood: bytes) -> AsyncIterator[int]:
    """Its port. It sends ``flood`` when its client has published, and takes no more notice of it."""

    tasks: list[asyncio.Task[None] | None] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        tasks.append(asyncio.current_task())
        try:
            await reader.read(1000)
            writer.write(CONNACK)
            await reader.read(1000)
            for octets in flood:
                writer.write(octets)
                await writer.drain()
            await reader.read(-1)
        finally:
            writer.transport.abort()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for task in filter(None, tasks):
            task.cancel()
        await asyncio.gather(*filter(None, tasks), return_exceptions=True)


def publish(size: int) -> bytes:
    body = struct.pack(">H", 1) + b"t" + b"\x00" + bytes(size)
    return bytes((0x30, 0x80 | (len(body) & 0x7F), 0x80 | (len(body) >> 7 & 0x7F), len(body) >> 14)) + body


@pytest.mark.parametrize("size", [20, 60_000])
async def test_a_flood_is_read_at_a_limited_rate_and_wholly(size: int) -> None:
    sent = 600 if size == 20 else 20
    loop = asyncio.get_running_loop()
    async with broker(*[publish(size)] * sent) as port:
        began = loop.time()
        async with LimitedClient("127.0.0.1", port, protocol=aiomqtt.ProtocolVersion.V5) as client:
            await client.publish("t")
            for _ in range(sent):
                message = await anext(aiter(client.messages))
                assert len(message.payload) == size
            took = loop.time() - began
            client._disconnected.set_result(None)  # the broker takes no DISCONNECT
    # a packet counts 1000 octets besides its own; the first part of a second has its share at once
    assert sent * (size + 1000) <= MOST_A_SECOND * (took + 0.1) + size + 1000


async def test_a_packet_that_is_too_long_ends_the_connection_before_it_is_taken(
    caplog: pytest.LogCaptureFixture,
) -> None:
    logger = logging.getLogger("test of a packet")
    async with broker(bytes((0x30, 0xFF, 0xFF, 0xFF, 0x7F))) as port:
        client = LimitedClient("127.0.0.1", port, protocol=aiomqtt.ProtocolVersion.V5, logger=logger)

        async def take() -> None:
            async with asyncio.timeout(10), client:
                await client.publish("t")
                await anext(aiter(client.messages))

        with pytest.raises(aiomqtt.MqttError):
            await take()
    assert f"a packet of {(1 << 28) - 1} octets, {MOST_PACKET} are allowed" in caplog.text


async def test_messages_with_qos_2_end_the_connection_and_fill_no_memory() -> None:
    body = struct.pack(">H", 1) + b"t" + struct.pack(">H", 7) + b"\x00"
    async with broker(bytes((0x34, len(body))) + body) as port:
        client = LimitedClient("127.0.0.1", port, protocol=aiomqtt.ProtocolVersion.V5)

        async def take() -> None:
            async with asyncio.timeout(2), client:
                await client.publish("t")
                await anext(aiter(client.messages))

        with pytest.raises((aiomqtt.MqttError, OSError), match=r"QoS 2|Disconnected"):
            await take()


async def test_confirmations_that_the_broker_does_not_read_end_the_connection_and_fill_no_memory() -> None:
    body = struct.pack(">H", 1) + b"t" + struct.pack(">H", 7) + b"\x00"
    async with broker((bytes((0x32, len(body))) + body) * 3000) as port:
        client = LimitedClient("127.0.0.1", port, protocol=aiomqtt.ProtocolVersion.V5)
        send = client._client._sock_send

        def send_all_but_confirmations(octets: bytes) -> int:
            if octets[0] == 0x40:
                raise BlockingIOError  # as where the sockets between client and broker are full
            return send(octets)

        client._client._sock_send = send_all_but_confirmations  # type: ignore[method-assign,assignment]

        async def take() -> None:
            async with asyncio.timeout(10), client:
                await client.publish("t")
                async for _ in client.messages:
                    pass

        with pytest.raises((aiomqtt.MqttError, OSError), match=r"does not read|Disconnected"):
            await take()
        assert len(client._client._out_packet) < 1100


async def test_a_socket_that_is_gone_before_its_turn_is_watched_by_nobody() -> None:
    """Its number may be that of another file by then, for instance of the port of the bus."""
    loop = asyncio.get_running_loop()
    faults: list[dict[str, object]] = []
    loop.set_exception_handler(lambda _, context: faults.append(context))
    async with broker() as port:
        client = LimitedClient("127.0.0.1", port, protocol=aiomqtt.ProtocolVersion.V5)
        await asyncio.to_thread(client.connect_blocking)
        await client.wait_connected()
        paho, sock = client._client, client._client.socket()
        assert sock is not None
        number = sock.fileno()
        client._on_socket_open(paho, None, sock)
        client._on_socket_register_write(paho, None, sock)
        paho._sock_close()
        with socket.socket() as other:
            assert other.fileno() == number
            await asyncio.sleep(0.01)
            assert not loop.remove_writer(number)
            assert not loop.remove_reader(number)
    assert faults == []
