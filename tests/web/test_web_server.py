"""The web server over literal items and over a recording: its files and headers, who may connect, and what a page
gets."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from pathlib import Path

import aiohttp
import pytest
from far_ends import HANG_S

from dpstack.cli.main import main
from dpstack.web import source
from dpstack.web.source import GivenItems, ReplaySource
from dpstack.web.web_server import serve
from tests.web.web_kit import PLANT, WHOLE, connected, delta, event, page_of, stranger


async def test_a_page_gets_plant_whole_snapshot_events_and_then_deltas() -> None:
    source = GivenItems([PLANT, WHOLE, event("hello"), delta(0.2, "set_prm")])
    async with serve(source) as server:
        async with page_of(server) as page:
            welcome = await page.until("welcome")
            assert welcome["control"] is False
            assert (welcome["name"], welcome["source"]) == (None, "run")
            while (await page.until("snapshot"))["slaves"]["3"]["state"] != "set_prm":
                pass
            source.put(delta(0.3, "data_exchange"))
            assert await page.until("snapshot") == delta(0.3, "data_exchange")["snapshot"]
        async with page_of(server) as late:
            items = [await late.item() for _ in range(4)]
            assert items[1] == PLANT
            assert items[2]["snapshot"] == {
                "t": 0.3,
                "whole": True,
                "bus": {"mode": "clear", "rotations": 10},
                "slaves": {"3": {"exchanges": 0} | delta(0.3, "data_exchange")["snapshot"]["slaves"]["3"]},
            }
            assert items[3] == event("hello")


async def test_files_have_strict_headers_and_nothing_else_is_served() -> None:
    async with serve(GivenItems()) as server, aiohttp.ClientSession() as session:
        async with session.get(server.url) as found:
            assert found.status == 200
            assert found.content_type == "text/html"
            assert "<html" in await found.text()
            policy = found.headers["Content-Security-Policy"].split("; ")
            assert {"default-src 'none'", "script-src 'self'", "frame-ancestors 'none'"} <= set(policy)
            assert "unsafe" not in found.headers["Content-Security-Policy"]
            assert found.headers["X-Content-Type-Options"] == "nosniff"
            assert found.headers["X-Frame-Options"] == "DENY"
            assert found.headers["Cache-Control"] == "no-store"
        for path in ("server.py", "..%2fserver.py", "%2e%2e/rights.py", "index.html/", "page/index.html", "ws/x"):
            async with session.get(server.url + path) as found:
                assert found.status == 404, path
                assert found.headers["X-Content-Type-Options"] == "nosniff"
        async with session.post(server.url, data=b"x") as found:
            assert found.status == 405


async def test_a_request_for_another_host_is_refused() -> None:
    async with serve(GivenItems()) as server, aiohttp.ClientSession() as session:
        port = server.url.rstrip("/").rpartition(":")[2]
        for host in ("evil.example", f"evil.example:{port}", "127.0.0.1:1", "127.0.0.1", "a b", "[::1"):
            async with session.get(server.url, headers={"Host": host}) as found:
                assert found.status == 421, host
            with pytest.raises(aiohttp.WSServerHandshakeError):
                async with stranger(server, headers={"Host": host}):
                    pass


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "https://127.0.0.1:{port}", "http://127.0.0.1:1", "null", ""]
)
async def test_a_websocket_of_another_page_is_refused(origin: str) -> None:
    async with serve(GivenItems()) as server:
        port = server.url.rstrip("/").rpartition(":")[2]
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            async with stranger(server, origin=origin.format(port=port)):
                pass
        assert refused.value.status == 403


async def test_the_end_of_the_server_is_told_to_its_pages() -> None:
    async with serve(GivenItems([PLANT])) as server, page_of(server) as page:
        await page.until("plant")
        ending = asyncio.ensure_future(server.close())
        assert (await page.until("end"))["text"] == "the web server ends"
        assert (await page.ws.receive(timeout=HANG_S)).type is aiohttp.WSMsgType.CLOSE
        await ending


async def test_events_of_the_server_have_the_clock_of_the_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody has set the clock of this computer years ahead since the run began; the log has the new time."""
    source, log = GivenItems([PLANT, WHOLE]), list[str]()
    async with serve(source, log=log.append) as server, page_of(server) as page:
        await page.until("snapshot")
        server.tell("an order")
        assert (await page.until("event"))["time"].startswith(
            "2025-11-22T16:46:4"
        )  # 1763830000.1 s since 1970, and a moment
        assert log[-1].endswith("Z an order")
        assert not log[-1].startswith("2025-11-22T16:46:4")
        source.put({"plant": {**PLANT["plant"], "started": 1e300}})
        source.put(WHOLE)
        await page.until("snapshot")
        server.tell("another one")
        assert (await page.until("event"))["time"] == log[-1].split()[0]


async def test_octets_of_strangers_reach_no_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    async with serve(GivenItems([PLANT])) as server, page_of(server) as page:
        for octets in (
            b"\x1b[2J\r\n\r\n",
            b"GET / HTTP/9.9\r\n\r\n",
            b"GET /\x1b[31m HTTP/1.1\r\nHost: x\r\n\r\n",
            b"\0" * 9000,
        ):
            reader, writer = await connected(server, octets)
            assert b"HTTP/1.1 2" not in await asyncio.wait_for(reader.read(64), 5)
            writer.close()
        await page.until("plant")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("version", ["0.9", "2.0", "9.9"])
async def test_other_versions_of_http_are_refused_in_one_of_ours(version: str) -> None:
    async with serve(GivenItems()) as server:
        place = server.url.split("/")[2]
        reader, writer = await connected(server, f"GET / HTTP/{version}\r\nHost: {place}\r\n\r\n".encode())
        answer = await asyncio.wait_for(reader.read(), 5)
        assert re.match(rb"HTTP/1\.[01] 400 Bad Request\r\n", answer)
        writer.close()


async def test_connections_without_a_request_are_closed_and_their_number_is_bounded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("dpstack.web.web_server._HELLO_S", 0.05)
    monkeypatch.setattr("dpstack.web.web_server._MOST_CONNECTIONS", 3)
    async with serve(GivenItems([PLANT])) as server, page_of(server) as page:
        opened = [await connected(server) for _ in range(4)]
        for reader, writer in opened:
            assert await asyncio.wait_for(reader.read(), 5) == b""
            writer.close()
        await page.until("plant")
        assert (await page.ask("nothing"))["ok"] is False


async def test_a_number_that_json_does_not_have_does_not_cost_the_message() -> None:
    source = GivenItems([PLANT, WHOLE])
    async with serve(source) as server, page_of(server) as page:
        await page.until("snapshot")
        fields = {"level": float("nan"), "limits": [float("inf"), 1.5]}
        source.put({"snapshot": {"t": 0.2, "whole": False, "bus": {}, "slaves": {"3": {"fields": fields}}}})
        message = await page.ws.receive_str(timeout=HANG_S)
        assert '"fields":{"level":null,"limits":[null,1.5]}' in message


async def test_a_key_of_a_websocket_that_is_no_ascii_is_refused() -> None:
    async with serve(GivenItems([PLANT])) as server:
        place = server.url.split("/")[2]
        request = (
            f"GET /ws HTTP/1.1\r\nHost: {place}\r\nOrigin: http://{place}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: \xe4\r\n\r\n".encode("latin-1")
        )
        reader, writer = await connected(server, request)
        assert b" 426 " in await asyncio.wait_for(reader.readline(), 5)
        writer.close()


#: a CSV file of somebody else: no description, one unit
LINES = """time,t,boiler.state,boiler.level [bar]
2026-01-31T12:00:00.000Z,0.0,data_exchange,12.3
2026-01-31T12:00:00.020Z,0.02,data_exchange,12.4
2026-01-31T12:00:00.040Z,0.04,offline,
"""


async def test_a_recording_is_shown_to_its_end_and_described(tmp_path: Path) -> None:
    path = tmp_path / "plant.csv"
    path.write_text(LINES, encoding="utf-8")
    async with serve(ReplaySource(path)) as server, page_of(server) as page:
        assert (await page.until("welcome"))["source"] == "replay"
        assert [slave["name"] for slave in (await page.until("plant"))["slaves"].values()] == ["boiler"]
        values = [slave["fields"]["level"] for slave in (await page.until("snapshot"))["slaves"].values()]
        assert values in ([12.3], [12.4], [None])
        assert "plant.csv" in (await page.until("end"))["text"]
        described = (await page.ask("recording"))["result"]
        assert (described["file"], described["seconds"]) == ("plant.csv", 0.04)
        assert described["started"] == 1_769_860_800.0
        assert [(one["name"], one["kind"], one["unit"]) for one in described["columns"]] == [
            ("boiler.state", None, ""),
            ("boiler.level", None, "bar"),
        ]
        assert "there is no run" in (await page.ask("why", "boiler"))["error"]
        assert (await page.order("operate"))["ok"] is False
        async with page_of(server) as late:  # the last values stay, marked as ended
            assert (await late.until("snapshot"))["whole"] is True
            await late.until("end")


async def test_an_invalid_item_of_a_recording_is_left_out_and_reported_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "plant.csv"
    path.write_text(LINES, encoding="utf-8")

    async def replayed(_: Path) -> AsyncIterator[dict[str, object]]:
        for item in [{"plant": {"slaves": {}, "baud": "fast"}}, {"plant": {"slaves": {}, "baud": "fast"}}, PLANT]:
            yield item

    monkeypatch.setattr(source, "replay_items", replayed)
    log: list[str] = []
    async with serve(ReplaySource(path), log=log.append) as server, page_of(server) as page:
        assert await page.until("plant") == PLANT["plant"]
    assert [line.partition(" ")[2] for line in log] == [
        "this is no item of the stream: Expected `int | null`, got `str` - at `$.plant.baud`; "
        "is the other program another version?"
    ]


@pytest.mark.parametrize(("text", "why"), [(None, "plant.csv"), ("no recording", "plant.csv")])
def test_a_file_that_is_no_recording_is_one_line(
    text: str | None, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "plant.csv"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    assert main(["web", "--replay", str(path), "--listen", "0"]) == 2
    err = capsys.readouterr().err
    assert why in err
    assert err.count("\n") == 1
