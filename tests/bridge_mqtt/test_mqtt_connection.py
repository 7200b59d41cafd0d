"""The connection to a broker: floods and packets without end, a socket that is gone; messages that leave without a turn
of the loop, those that wait; an end although a library swallows a cancellation or a call blocks."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import struct
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import aiomqtt
import pytest
from far_ends import until

from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.connection import LastError, cancellations, close, end_if_cancelled, make_client, why_lost
from dpstack.bridge.mqtt.limited_client import MOST_A_SECOND, MOST_PACKET, LimitedClient
from dpstack.bridge.mqtt.session_file import SessionFile
from tests.bridge_mqtt.connector_kit import connector_at, serving

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


async def test_a_broker_that_ends_the_connection_before_it_answers_is_not_waited_for() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        client = LimitedClient("127.0.0.1", server.getsockname()[1], protocol=aiomqtt.ProtocolVersion.V5, timeout=1e6)
        connecting = asyncio.create_task(asyncio.to_thread(client.connect_blocking))
        broker, _ = await asyncio.to_thread(server.accept)
        await connecting
        broker.close()
        with pytest.raises((aiomqtt.MqttError, OSError)) as lost:
            await client.wait_connected()
        await close(client)
    assert why_lost(lost.value, LastError(), connected=False).startswith(("it has ended the connection", "Connection"))


class RefusingSocket(socket.socket):
    """A socket of TLS whose far end has sent ``alert``, if it has, and is gone."""

    alert = ""

    def send(self, *_: object) -> int:
        raise ssl.SSLEOFError(8, "EOF occurred in violation of protocol")

    def recv(self, *_: object) -> bytes:
        raise ssl.SSLError(1, self.alert) if self.alert else ssl.SSLWantReadError


@pytest.mark.parametrize(
    ("alert", "text"),
    [
        ("[SSL: SSLV3_ALERT_CERTIFICATE_EXPIRED] sslv3 alert certificate expired", "it has expired; give a new"),
        ("", "EOF occurred in violation of protocol"),
    ],
)
async def test_a_broker_that_is_gone_while_it_is_written_to_has_said_why(alert: str, text: str) -> None:
    last = LastError()
    client = make_client(Broker(url="mqtt://127.0.0.1:1"), None, last, "a")
    client._client._sock = sock = RefusingSocket()
    sock.alert = alert
    client._client.publish("t")
    with pytest.raises(aiomqtt.MqttError) as lost:
        await client.wait_connected()
    assert text in why_lost(lost.value, last, connected=False)


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


async def test_a_swallowed_cancellation_ends_the_task_after_all() -> None:
    async def work() -> None:
        before = cancellations()
        with contextlib.suppress(asyncio.CancelledError):  # as asyncio.wait_for of Python 3.11 now and then
            await asyncio.Event().wait()
        end_if_cancelled(before)
        raise AssertionError("it goes on")

    task = asyncio.create_task(work())
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_the_farewell_of_a_cancelled_task_goes_on() -> None:
    """It begins when the task is being cancelled already."""

    async def work() -> str:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.Event().wait()
        before = cancellations()
        await asyncio.sleep(0)
        end_if_cancelled(before)
        return "said"

    task = asyncio.create_task(work())
    await asyncio.sleep(0)
    task.cancel()
    assert await task == "said"


@pytest.mark.parametrize("blocked", [(aiomqtt.Client, "_client_connect"), (SessionFile, "next")])
def test_a_network_or_disk_that_blocks_does_not_delay_the_end_of_the_program(
    blocked: tuple[type, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, goes_on, went_on = threading.Event(), threading.Event(), threading.Event()

    def block(_: object) -> int:
        began.set()
        goes_on.wait(2)
        went_on.set()
        return 0

    monkeypatch.setattr(*blocked, block)

    async def program() -> None:
        async with serving(connector_at(tmp_path / "s", broker=Broker(url="mqtt://a"))):
            await until(began.is_set)

    asyncio.run(program())
    assert not went_on.is_set()
    goes_on.set()
    assert went_on.wait(5)
