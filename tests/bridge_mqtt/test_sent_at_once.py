"""Messages leave when they are published, without a turn of the loop; those that a slow broker does not take wait."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import aiomqtt

from dpstack.bridge.mqtt.limited_client import LimitedClient

CONNACK = bytes((0x20, 3, 0, 0, 0))
#: more than the sockets between a client and a broker hold
LARGE = 4_000_000


def packet(payload: bytes) -> bytes:
    """PUBLISH of MQTT 5 to the topic t with QoS 0."""
    rest = bytes((0, 1)) + b"t" + bytes(1) + payload
    length, head = len(rest), bytearray((0x30,))
    while True:
        length, digit = divmod(length, 128)
        head.append(digit | (0x80 if length else 0))
        if not length:
            return bytes(head) + rest


@asynccontextmanager
async def connected() -> AsyncIterator[tuple[LimitedClient, socket.socket]]:
    """A client, and the broker's end of its connection, which has sent CONNACK."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        client = LimitedClient("127.0.0.1", server.getsockname()[1], protocol=aiomqtt.ProtocolVersion.V5, timeout=10)
        connecting = asyncio.create_task(asyncio.to_thread(client.connect_blocking))
        broker, _ = await asyncio.to_thread(server.accept)
        with broker:
            await connecting
            await asyncio.to_thread(broker.recv, 1000)
            broker.sendall(CONNACK)
            await client.wait_connected()
            broker.setblocking(False)
            try:
                yield client, broker
            finally:
                client._client._sock_close()


def is_watched_for_writing(client: LimitedClient) -> bool:
    sock = client._client.socket()
    assert sock is not None
    return asyncio.get_running_loop().remove_writer(sock.fileno())


async def test_a_message_has_left_when_publish_returns_and_nobody_else_had_a_turn() -> None:
    async with connected() as (client, broker):
        turns: list[None] = []
        asyncio.get_running_loop().call_soon(turns.append, None)
        await client.publish("t", b"one")
        await client.publish("t", b"two")
        assert not turns
        await asyncio.sleep(0)
        # with Nagle's algorithm the second one would wait until the broker's computer has confirmed the first one
        assert broker.recv(1000) == packet(b"one") + packet(b"two")
        assert not is_watched_for_writing(client), "a loop that watches a socket without a reason never sleeps"


async def test_a_message_that_the_broker_does_not_take_waits_and_arrives_whole() -> None:
    async with connected() as (client, broker):
        payloads = [bytes((number,)) * LARGE for number in (1, 2)]
        publishing = asyncio.create_task(client.publish("t", payloads[0]))
        await asyncio.sleep(0.01)
        assert not publishing.done()
        behind = asyncio.create_task(client.publish("t", payloads[1]))
        expected = b"".join(map(packet, payloads))
        taken = bytearray()
        async with asyncio.timeout(10):
            while len(taken) < len(expected):
                taken += await asyncio.get_running_loop().sock_recv(broker, 1 << 20)
            await asyncio.gather(publishing, behind)
        assert taken == expected
        await asyncio.sleep(0)
        assert not is_watched_for_writing(client)


async def test_publish_with_qos_1_still_waits_for_its_answer() -> None:
    async with connected() as (client, broker):
        publishing = asyncio.create_task(client.publish("t", b"x", qos=1))
        await asyncio.sleep(0.01)
        octets = broker.recv(1000)
        assert octets[0] == 0x32
        assert not publishing.done()
        identifier = octets[5:7]  # behind the head of two octets and the topic of three
        broker.sendall(bytes((0x40, 2)) + identifier)
        async with asyncio.timeout(5):
            await publishing


async def test_a_connection_that_is_broken_at_a_publish_ends_the_client() -> None:
    async with connected() as (client, broker):
        broker.close()
        async with asyncio.timeout(5):
            while not client._disconnected.done():
                publishing = asyncio.create_task(client.publish("t", b"x"))
                await asyncio.sleep(0)
                publishing.cancel()
                await asyncio.gather(publishing, return_exceptions=True)
        assert isinstance(client._disconnected.exception(), aiomqtt.MqttError)
