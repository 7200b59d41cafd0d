"""Messages that wait for a page: merged snapshots, bounded events, and pages that never read. Nonsense from a page:
it gets an error, its own connection lives for a while, and no other page notices."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections.abc import AsyncGenerator
from typing import Any

import aiohttp
import pytest
from far_ends import HANG_S
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.plant.items import check_item
from dpstack.plant.pending import Pending
from dpstack.web.fan_out import MOST_EVENTS, FanOut
from dpstack.web.messages import MOST_OCTETS, Ask, Hello, MessageError, PageOrder, answer, parse
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


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=6,
)
BODIES = st.fixed_dictionaries(
    {},
    optional={
        "id": st.integers() | JSON,
        "what": st.sampled_from(["why", "toml", "match"]) | JSON,
        "command": st.sampled_from(["operate", "set", "start"]) | JSON,
        "args": st.lists(st.text() | JSON, max_size=5) | JSON,
        "confirmed": st.booleans() | JSON,
        "token": st.none() | st.text() | JSON,
    },
)
MESSAGES = st.one_of(
    st.text(),
    JSON.map(json.dumps),
    st.builds(lambda kind, body: json.dumps({kind: body}), st.sampled_from(["hello", "ask", "order"]), BODIES | JSON),
)


def parsed(text: str) -> Hello | Ask | PageOrder | MessageError:
    try:
        return parse(text)
    except MessageError as error:
        return error


@given(MESSAGES)
@examples(12)
def test_a_message_is_one_with_right_types_or_an_error_in_one_line(text: str) -> None:
    message = parsed(text)
    given_ = json.loads(text) if not isinstance(message, MessageError) else {}
    match message:
        case MessageError():
            assert str(message).isprintable()
            assert len(str(message)) < 300
            json.loads(answer(message.id, error=str(message)).encode())
        case Hello(token):
            assert token is None or token.encode().decode() == token
            assert given_["hello"].get("token") == token
        case Ask(id, what, args):
            assert (given_["ask"]["id"], given_["ask"]["what"]) == (id, what)
            assert json.dumps(list(args)) == json.dumps(given_["ask"].get("args", []))
            assert type(id) is int
        case PageOrder(id, command, order_args, confirmed):
            assert (given_["order"]["id"], given_["order"]["command"]) == (id, command)
            assert all(type(one) is str for one in order_args)
            assert given_["order"].get("confirmed", False) is confirmed
            assert message.text.isprintable()


@given(st.lists(MESSAGES | st.binary(max_size=20), min_size=1, max_size=8))
@examples(3)
def test_a_server_answers_each_message_and_goes_on(messages: list[str | bytes]) -> None:
    async def talk() -> None:
        async with serve(GivenItems([PLANT])) as server, page_of(server) as page, page_of(server) as other:
            for message in messages:
                if isinstance(message, bytes):
                    await page.ws.send_bytes(message)
                else:
                    await page.ws.send_str(message.encode(errors="replace").decode())
                assert (await page.until("answer"))["ok"] is False  # there is no run, and no right to give orders
            assert "there is no ask" in (await other.ask("nothing"))["error"]

    asyncio.run(talk())


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("[" * 100_000, "message: Expected `object`, got `array`"),
        ('{"ask":' * 13 + "1" + "}" * 13, "ask: Object missing required field `id`"),
        ('{"ask":{"id":1,"what":"x","args":["' + "x" * MOST_OCTETS + '"]}}', "at most"),
        ('{"ask":{"id":' + "9" * 5_000 + ',"what":"x"}}', "ask: Integer value out of range"),
        ('{"ask":{"id":9007199254740992,"what":"x"}}', "Expected `int` <= 9007199254740991 - at `$.id`"),
        ('{"ask":{"id":-1,"what":"x"}}', "Expected `int` >= 0 - at `$.id`"),
        ('{"ask":{"id":true,"what":"x"}}', "Expected `int`, got `bool` - at `$.id`"),
        ('{"ask":{"id":1.0,"what":"x"}}', "Expected `int`, got `float` - at `$.id`"),
        ('{"ask":{"id":1,"what":"x","args":[NaN]}}', "message: it is no JSON; send for instance {"),
        ('{"ask":{"id":1,"what":"\\ud800"}}', "no JSON"),
        ('{"ask":{"id":1,"what":"x","args":[{"\\udfff":1}]}}', "no JSON"),
        ('{"hello":{"token":"\\ud800"}}', "no JSON"),
        ('{"hello":{"token":"' + "x" * 1_025 + '"}}', "hello: Expected `str` of length <= 1024 - at `$.token`"),
        ('{"hello":{},"ask":{}}', "one key"),
        ("{}", "one key"),
        ('{"hello":1}', "hello: Expected `object`, got `int`"),
        ('{"__proto__":{}}', "unknown field `__proto__`"),
        ('{"' + "x" * 10_000 + '":{}}', "unknown field `xxx"),
        ("\ud800", "UTF-8"),
    ],
)
def test_refused(text: str, why: str) -> None:
    with pytest.raises(MessageError) as error:
        parse(text)
    assert why in str(error.value)
    assert error.value.id is None
    assert len(str(error.value)) < 300


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ('"command":"set","args":["' + "x" * 5_000 + '"]', "Expected `str` of length <= 4096 - at `$.args[0]`"),
        ('"command":"set","args":[1],"confirmed":true', "order: Expected `str`, got `int` - at `$.args[0]`"),
        ('"command":"set","args":{"0":"x"}', "order: Expected `array`, got `object` - at `$.args`"),
        ('"command":"set","args":' + json.dumps(["x"] * 65), "of length <= 64 - at `$.args`"),
        ('"command":"set","confirmed":1', "Expected `bool`, got `int` - at `$.confirmed`; send for instance {"),
        ('"args":[]', "order: Object missing required field `command`"),
    ],
)
def test_the_error_of_a_wrong_order_goes_to_its_number(body: str, why: str) -> None:
    with pytest.raises(MessageError) as error:
        parse('{"order":{"id":7,' + body + "}}")
    assert why in str(error.value)
    assert error.value.id == 7


@pytest.mark.parametrize(("levels", "is_taken"), [(8, True), (9, False), (500, False), (100_000, False)])
def test_arguments_have_at_most_eight_levels(levels: int, is_taken: bool) -> None:
    text = '{"ask":{"id":1,"what":"x","args":' + "[" * levels + "]" * levels + "}}"
    if is_taken:
        assert parse(text).id == 1  # type: ignore[union-attr]
    else:
        with pytest.raises(MessageError, match="nested"):
            parse(text)


def test_a_number_beyond_all_limits_is_no_argument() -> None:
    with pytest.raises(MessageError, match="out of range") as error:
        parse('{"ask":{"id":1,"what":"check","args":[{"speed":1e999}]}}')
    assert error.value.id == 1


def test_brackets_in_texts_are_no_levels() -> None:
    text = json.dumps({"ask": {"id": 1, "what": "check", "args": ['[[["\\' * 50]}})
    assert parse(text) == Ask(1, "check", ('[[["\\' * 50,))


async def test_a_page_may_err_twenty_times_and_others_do_not_notice() -> None:
    source = GivenItems([PLANT, WHOLE])
    async with serve(source) as server, page_of(server) as other:
        await other.until("snapshot")
        async with page_of(server) as page:
            await page.until("snapshot")
            await page.ws.send_bytes(b"\0\xff")
            assert await page.until("answer") == {"id": None, "ok": False, "error": "a message is a text"}
            await page.send({"hello": {"token": None}})
            assert (await page.until("answer"))["error"] == "hello comes once"
            for _ in range(17):
                await page.ws.send_str("{")
                assert (await page.until("answer"))["id"] is None
            assert (await page.ask("nothing"))["ok"] is False
            await page.ws.send_str("{")
            assert (await page.until("refused")) == "too many invalid messages"
            assert (await page.ws.receive(timeout=HANG_S)).type is aiohttp.WSMsgType.CLOSE
        source.put(delta(1, "set_prm"))
        assert (await other.until("snapshot"))["t"] == 1


@pytest.mark.parametrize(
    "frame",
    [
        b"\x81\xff\x7f\xff\xff\xff\xff\xff\xff\xff\0\0\0\0",  # 2^63 octets
        b"\x81\x83\0\0\0\0\xff\xfe\xfd",  # no UTF-8
        b"\xf1\x82\0\0\0\0hi",  # reserved bits
        b"\x83\x80\0\0\0\0",  # an operation that there is not
        b"\x88\x81\0\0\0\0\x03",  # a close with half a code
        b"GET / HTTP/1.1\r\n\r\n",
    ],
)
async def test_wrong_frames_end_their_own_connection_only(frame: bytes) -> None:
    source = GivenItems([PLANT])
    async with serve(source) as server, page_of(server) as other:
        await other.until("plant")
        async with page_of(server) as page:
            await page.until("plant")
            connection: Any = page.ws._writer.transport
            connection.write(frame)
            while (await page.ws.receive(timeout=HANG_S)).type not in (
                aiohttp.WSMsgType.CLOSE,
                aiohttp.WSMsgType.CLOSED,
            ):
                pass
        source.put(WHOLE)
        assert (await other.until("snapshot"))["t"] == 0.1
        while server.pages > 1:
            source.put(WHOLE)
            await other.until("snapshot")
