"""Messages that wait for a page: merged snapshots, bounded events, and pages that never read."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections.abc import AsyncGenerator
from typing import Any

from dpstack.plant.items import check_item
from dpstack.plant.pending import Pending
from dpstack.web.fan_out import MOST_EVENTS, FanOut
from dpstack.web.source import GivenItems, SourceItem
from dpstack.web.web_server import serve
from tests.web.web_kit import PLANT, WHOLE, delta, event, page_of


async def taken(reader: Any) -> list[dict[str, Any]]:
    return [json.loads(text) for text in await reader.take()]


async def test_a_page_that_does_not_read_gets_one_snapshot_and_the_last_events() -> None:
    fan_out = FanOut()
    fan_out.put(check_item(PLANT))
    fan_out.put(check_item(WHOLE))
    reader = fan_out.join()
    assert [list(item) for item in await taken(reader)] == [["plant"], ["snapshot"]]
    for number in range(1_000):
        fan_out.put(check_item(delta(number, f"state {number}")))
        fan_out.put(check_item(event(f"event {number}")))
        fan_out.hand_out()
    items = await taken(reader)
    assert [item["snapshot"] for item in items if "snapshot" in item] == [delta(999, "state 999")["snapshot"]]
    events = [item["event"]["text"] for item in items if "event" in item]
    assert events == [f"event {number}" for number in range(1_000 - MOST_EVENTS, 1_000)]
    assert [item["lost"] for item in items if "lost" in item] == [1_000 - MOST_EVENTS]
    assert reader.is_empty


async def test_pages_that_read_share_their_texts() -> None:
    fan_out = FanOut()
    fan_out.put(check_item(PLANT))
    readers = [fan_out.join() for _ in range(3)]
    for reader in readers:
        await reader.take()
    fan_out.put(check_item(delta(1, "set_prm")))
    fan_out.hand_out()
    texts = [(await reader.take())[0] for reader in readers]
    assert texts[0] is texts[1] is texts[2]
    slow = fan_out.join()
    fan_out.put(check_item(delta(2, "chk_cfg")))
    fan_out.hand_out()
    assert json.loads((await readers[0].take())[0]) == delta(2, "chk_cfg")
    assert (await taken(slow))[-1]["snapshot"]["slaves"]["3"]["state"] == "chk_cfg"


async def test_a_stream_of_an_older_version_is_judged_here() -> None:
    """Its program makes no verdicts: the page gets them as from a program of today, and only when they change."""
    fan_out = FanOut()
    fan_out.put(check_item(PLANT))
    reader = fan_out.join()
    await reader.take()
    found = []
    for values in (
        {"state": "data_exchange", "inputs_valid": True, "drive": {"faults": ["F0070 comm link error"]}, "retries": 0},
        {"inputs_valid": False, "retries": 1},
        {"retries": 2},
    ):
        snapshot = {"t": 1, "whole": not values["retries"], "bus": {}, "slaves": {"3": values}}
        fan_out.put(check_item({"snapshot": snapshot}))
        fan_out.hand_out()
        found += [item["snapshot"]["slaves"]["3"] for item in await taken(reader)]
    first, second, third = found
    remark = {"text": "drive fault: F0070 comm link error", "severity": "error"}
    assert (first["alive"], first["level"], first["remark"]) == (True, "error", remark)
    assert first["state_text"] == "data exchange"
    assert second == {"inputs_valid": False, "retries": 1, "alive": False, "state_text": "not valid"}
    assert third == {"retries": 2}


async def test_a_bus_that_runs_again_has_not_ended() -> None:
    pending = Pending()
    for item in ({"end": {"text": "over"}}, PLANT, WHOLE):
        pending.put(item)
    assert [pending.take(), pending.take(), pending.take()] == [PLANT, WHOLE, None]


async def test_answers_come_behind_the_items_before_them_and_are_bounded() -> None:
    fan_out = FanOut()
    fan_out.put(check_item(PLANT))
    reader = fan_out.join()
    assert reader.say("welcome")
    assert (await reader.take())[1:] == ["welcome"]
    assert [reader.say("x") for _ in range(100)].count(True) == 64


async def test_items_behind_an_answer_are_not_merged_with_those_before_it() -> None:
    """Else a page whose loop stood still would be told of a new run behind the plant of that run."""
    fan_out = FanOut()
    reader = fan_out.join()
    await reader.take()
    for state, welcome in (("offline", "first"), ("data_exchange", "second"), ("offline", None)):
        for t in (0.1, 0.2, 0.3):
            fan_out.put(check_item(delta(t, state)))
            fan_out.hand_out()
        assert welcome is None or reader.say(welcome)
    first, one, second, two, third = await reader.take()
    assert (one, two) == ("first", "second")
    assert ["offline" in text for text in (first, second, third)] == [True, False, True]
    assert all('"t":0.3' in text for text in (first, second, third))


async def test_twenty_pages_read_one_stream() -> None:
    class Counted(GivenItems):
        reads = 0

        def items(self) -> AsyncGenerator[SourceItem]:
            self.reads += 1
            return super().items()

    source = Counted([PLANT, WHOLE])
    async with serve(source) as server, contextlib.AsyncExitStack() as stack:
        pages = [await stack.enter_async_context(page_of(server)) for _ in range(20)]
        for page in pages:
            await page.until("snapshot")
        source.put(delta(0.3, "data_exchange"))
        assert [(await page.until("snapshot"))["t"] for page in pages] == [0.3] * 20
        assert server.pages == 20
    assert source.reads == 1


async def test_a_page_that_never_reads_is_disconnected_and_disturbs_no_other() -> None:
    source = GivenItems([PLANT, WHOLE])
    async with serve(source) as server, page_of(server) as page:
        server.patience_s = 0.05
        await page.until("snapshot")
        reader, writer = await open_raw(server.url)
        assert (await reader.readline()).startswith(b"HTTP/1.1 101")
        writer.write(MASKED_HELLO)  # and nothing is read any more
        most = 0
        for number in range(500):
            source.put(
                {"snapshot": {**WHOLE["snapshot"], "t": float(number), "slaves": {"3": {"state": "x" * 500_000}}}}
            )
            while (await page.until("snapshot"))["t"] != number:
                pass
            most = max(most, server.pages)
            if most > server.pages:
                break
        assert (most, server.pages) == (2, 1)
        writer.transport.abort()
        source.put(delta(9_999.0, "data_exchange"))
        assert (await page.until("snapshot"))["t"] == 9_999.0


#: a frame of RFC 6455: FIN and text, masked with zeros
MASKED_HELLO = b"\x81\x96\0\0\0\0" + b'{"hello":{"token":""}}'


async def open_raw(url: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """A connection that has sent the request for a WebSocket; at most 4 KB of what comes wait in it."""
    host, port = url.removeprefix("http://").rstrip("/").split(":")
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.setblocking(False)
    await asyncio.get_running_loop().sock_connect(connection, (host, int(port)))
    reader, writer = await asyncio.open_connection(sock=connection, limit=4096)
    lines = ("GET /ws HTTP/1.1", f"Host: {host}:{port}", f"Origin: http://{host}:{port}", "Connection: Upgrade")
    key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
    writer.write("\r\n".join((*lines, "Upgrade: websocket", "Sec-WebSocket-Version: 13", key, "", "")).encode())
    return reader, writer
