"""The clients and brokers around the connectors that are measured, each a program:
``python -m bench.plant.connector_ends KIND PORT``.

- ``scraper``: GET /metrics over and over, a pause of ``--pause`` s between
- ``opcua``: OPC UA client that subscribes to every variable and takes what comes
- ``opcua-deaf``: the same, but it stops reading its connection
- ``hostile``: a broker that takes everybody, and sends commands of up to a megabyte as fast as they are read, with the
  packets of tests/kits/fake_broker.py

Each goes on until standard input ends, tries again where nobody answers, and prints a line with its counts then.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import os
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from bench.masters import Ended

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "kits"))

from fake_broker import (
    CONNACK,
    CONNECT,
    PINGREQ,
    PINGRESP,
    PUBLISH,
    SUBACK,
    SUBSCRIBE,
    UNSUBACK,
    UNSUBSCRIBE,
    packet,
    packets,
)

#: s until the next try
_AGAIN_S: Final = 0.2
#: s for the farewell of a client
_END_S: Final = 2.0
#: variables that one call subscribes to
_AT_ONCE: Final = 500
#: octets of the commands of a hostile broker, in turn
_SIZES: Final = (20, 2000, 60_000, 1_000_000)


async def scrape(port: int, counts: Counter[str], pause_s: float) -> None:
    """A connection for each scrape, as a scraper without keep-alive does it."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(b"GET /metrics HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nConnection: close\r\n\r\n" % port)
        text = await reader.read(-1)
    finally:
        writer.close()
    counts["scrapes"] += b" 200 " in text[:20]
    counts["octets"] += len(text)
    await asyncio.sleep(pause_s)


async def subscribe(port: int, counts: Counter[str], *, deaf: bool) -> None:
    """Subscribe to all variables of the plant with the shortest intervals that the server gives."""
    from asyncua import Client, Node, ua

    from dpstack.bridge.opcua.certificate import own_certificate

    class Handler:
        def datachange_notification(self, node: Node, value: object, data: object) -> None:
            counts["notifications"] += 1

        def event_notification(self, event: object) -> None:
            counts["events"] += 1

        def status_change_notification(self, status: object) -> None:
            raise ConnectionError(str(status))

    client = Client(f"opc.tcp://127.0.0.1:{port}", timeout=20)
    with tempfile.TemporaryDirectory(prefix="dpstack-bench-") as folder:
        cert, key = Path(folder) / "client.der", Path(folder) / "client.pem"
        client.application_uri = "urn:dpstack:bench"
        own_certificate(cert, key, uri=client.application_uri, hosts=("localhost",), now=datetime.now(UTC))
        await client.set_security_string(f"Basic256Sha256,SignAndEncrypt,{cert},{key}")
    async with client:
        found: list[Node] = []
        waiting = [client.nodes.objects]
        while waiting:
            node = waiting.pop()
            for reference in await node.get_references(ua.ObjectIds.HierarchicalReferences, ua.BrowseDirection.Forward):
                child = client.get_node(reference.NodeId)
                if reference.NodeId.NamespaceIndex and reference.NodeClass == ua.NodeClass.Variable:
                    found.append(child)
                elif reference.NodeId.NamespaceIndex and reference.NodeClass == ua.NodeClass.Object:
                    waiting.append(child)
        subscription = await client.create_subscription(10, Handler())
        for first in range(0, len(found), _AT_ONCE):
            await subscription.subscribe_data_change(found[first : first + _AT_ONCE], queuesize=100)
        await subscription.subscribe_events()
        counts["variables"] = len(found)
        if deaf:
            transport = client.uaclient.protocol.transport
            assert transport is not None
            transport.pause_reading()
        while True:
            await asyncio.sleep(1.0)
            if client.uaclient.protocol.transport.is_closing():
                raise ConnectionError("the server has ended the connection")


async def flood(port: int, counts: Counter[str]) -> None:
    """The broker: CONNACK, SUBACK, PINGRESP, and commands without end to each topic that was subscribed."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        topics: list[bytes] = []
        counts["connections"] += 1
        sending = asyncio.create_task(send(writer, topics))
        try:
            async for kind, body in packets(reader):
                if kind == CONNECT:
                    writer.write(packet(CONNACK, bytes(3)))
                elif kind == SUBSCRIBE:
                    writer.write(packet(SUBACK, body[:2] + b"\x00\x01"))
                    length = int.from_bytes(body[3:5], "big")
                    topics.append(body[5 : 5 + length].replace(b"+", b"s0"))
                elif kind == UNSUBSCRIBE:
                    writer.write(packet(UNSUBACK, body[:2] + b"\x00\x00"))
                elif kind == PINGREQ:
                    writer.write(packet(PINGRESP, b""))
        finally:
            sending.cancel()
            writer.close()

    async def send(writer: asyncio.StreamWriter, topics: list[bytes]) -> None:
        for number in itertools.count():
            if not topics:
                await asyncio.sleep(0.01)
                continue
            topic, size = topics[number % len(topics)], _SIZES[number % len(_SIZES)]
            body = struct.pack(">H", len(topic)) + topic + b"\x00" + os.urandom(20) + bytes(size)
            writer.write(packet(PUBLISH, body))
            counts["messages"] += 1
            counts["octets"] += len(body)
            await writer.drain()

    async with await asyncio.start_server(serve, "127.0.0.1", port) as server:
        await server.serve_forever()


async def _again(once: Callable[[], Awaitable[None]], counts: Counter[str]) -> None:
    while True:
        try:
            await once()
        except Exception as error:  # whatever the other end does, it is tried again
            counts[type(error).__name__] += 1
            await asyncio.sleep(_AGAIN_S)


async def _main(args: argparse.Namespace, ended: Ended) -> dict[str, int]:
    counts: Counter[str] = Counter()
    ways: dict[str, Callable[[], Awaitable[None]]] = {
        "scraper": lambda: scrape(args.port, counts, args.pause),
        "opcua": lambda: subscribe(args.port, counts, deaf=False),
        "opcua-deaf": lambda: subscribe(args.port, counts, deaf=True),
        "hostile": lambda: flood(args.port, counts),
    }
    running = asyncio.create_task(_again(ways[args.kind], counts))
    await asyncio.to_thread(ended.wait)
    running.cancel()
    await asyncio.wait((running,), timeout=_END_S)
    return dict(counts)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("kind", choices=("scraper", "opcua", "opcua-deaf", "hostile"))
    parser.add_argument("port", type=int)
    parser.add_argument("--pause", type=float, default=1.0)
    args = parser.parse_args()
    os.nice(10)  # the wire beside it comes first
    ended = Ended()
    ended.watch()
    with asyncio.Runner() as runner:
        print(json.dumps({"counts": runner.run(_main(args, ended))}), flush=True)
        os._exit(0)  # a client that does not read cannot take its leave


if __name__ == "__main__":
    main()
