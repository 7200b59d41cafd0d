"""``dpstack web`` and ``demo --web`` as processes: what they start ends with them, in order."""

from __future__ import annotations

import asyncio
import os
import queue
import re
import signal
import sys
import threading
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from far_ends import HANG_S, eventually
from programs import Program, Starter, plant_of

import dpstack
from dpstack.api.control.client import running
from dpstack.cli.main import main
from dpstack.cli.terminal import signals
from tests.web.web_kit import Page


def url_of(program: Program) -> str:
    program.wait_for('"listening"')
    return str(next(line["url"] for line in program.lines if line["event"] == "listening"))


async def looked_at(url: str) -> list[dict[str, Any]]:
    """The welcome with a run, the plant and the first snapshot, as a page gets them."""
    base, _, secret = url.partition("#")
    async with aiohttp.ClientSession() as session:
        async with session.get(base) as found:
            assert found.status == 200
        async with session.ws_connect(base + "ws", origin=base.rstrip("/")) as ws:
            page = Page(ws)
            await page.send({"hello": {"token": secret or None}})
            while (welcome := await page.until("welcome"))["source"] == "none":
                pass
            return [welcome, await page.until("plant"), await page.until("snapshot")]


@pytest.mark.soak
async def test_web_starts_a_run_that_only_reads_and_both_end_in_order(start: Starter, tmp_path: Path) -> None:
    program = start("web", str(plant_of(tmp_path)), "--listen", "0", "--json")
    welcome, plant, snapshot = await looked_at(await asyncio.to_thread(url_of, program))
    assert (welcome["source"], welcome["control"]) == ("read-only", False)
    assert (plant["read_only"], plant["config"]) == (True, str(tmp_path / "plant.toml"))
    assert snapshot["whole"] is True
    assert len(await asyncio.to_thread(running)) == 1
    assert await asyncio.to_thread(program.end, signal.SIGTERM) == 0
    assert running() == []
    assert "--read-only" in program.err
    assert "Traceback" not in program.err


@pytest.mark.soak
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell the death of a parent")
async def test_a_killed_web_server_leaves_no_run_behind(start: Starter, tmp_path: Path) -> None:
    program = start("web", str(plant_of(tmp_path)), "--listen", "0", "--json")
    await looked_at(await asyncio.to_thread(url_of, program))
    await asyncio.to_thread(program.end, signal.SIGKILL)
    await asyncio.to_thread(eventually, lambda: not running(), "the end of the run")


@pytest.mark.soak
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_the_demo_has_a_page_and_both_end_in_order(start: Starter, number: int) -> None:
    program = start("demo", "--web", "--listen", "0", "--json")
    welcome, plant, _ = await looked_at(await asyncio.to_thread(url_of, program))
    assert (welcome["source"], welcome["control"]) == ("demo", False)
    assert len(plant["slaves"]) >= 5
    assert all(slave["drive"] for slave in plant["slaves"].values())
    assert await asyncio.to_thread(program.end, number) == 0
    assert running() == []
    assert "Traceback" not in program.err


def test_the_command_serves_until_a_signal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In this process, and the run is one that is not there: nothing is started."""
    urls: queue.SimpleQueue[str] = queue.SimpleQueue()
    seen: list[Any] = []

    async def look(url: str) -> None:
        base, _, secret = url.partition("#")
        async with aiohttp.ClientSession() as session, session.ws_connect(base + "ws", origin=base.rstrip("/")) as ws:
            await ws.send_json({"hello": {"token": secret}})
            seen.append(await Page(ws).item())
            terminate()
            seen.append(await Page(ws).item())

    def look_in_thread() -> None:
        try:
            asyncio.run(look(urls.get(timeout=HANG_S)))
        finally:
            terminate()

    def terminate() -> None:
        if not ended.is_set():
            os.kill(os.getpid(), signal.SIGTERM)

    ended = threading.Event()
    monkeypatch.setattr("dpstack.cli.terminal.output.json_line", lambda found: urls.put(found["url"]))
    looking = threading.Thread(target=look_in_thread)
    monkeypatch.setattr(signals, "_SAME_S", 600.0)  # the second signal is the first one
    before = signal.signal(signal.SIGTERM, lambda *_: None)  # where nothing is served
    try:
        looking.start()
        code = main(["web", str(plant_of(tmp_path)), "--listen", "0", "--control", "--json"])
        ended.set()
        looking.join()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert code == 0
    assert (seen[0]["welcome"]["control"], seen[0]["welcome"]["source"]) == (True, "none")
    assert seen[1] == {"end": {"text": "the web server ends"}}
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("args", [["web", "PLANT"], ["demo", "--web"]], ids=" ".join)
def test_without_aiohttp_there_is_one_line(
    args: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main([arg.replace("PLANT", str(plant_of(tmp_path))) for arg in args]) == 2
    assert "needs aiohttp: pip install 'dpstack[web]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("args", "why"),
    [
        (["web"], "give the configuration file"),
        (["web", "PLANT", "--join", "virtual"], "give the configuration file"),
        (["web", "PLANT", "--replay", "x.csv", "--control"], "leave out"),
        (["web", "PLANT", "--read-only", "--control"], "leave one out"),
        (["web", "PLANT", "--read-only", "--listen", "0.0.0.0:0"], "--token FILE"),
        (["web", "PLANT", "--gsd", "/no/folder"], "/no/folder"),
        (["demo", "--web", "--fast"], "--fast"),
        (["demo", "--listen", "8000"], "add --web"),
    ],
)
def test_wrong_use_is_one_line(args: list[str], why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([arg.replace("PLANT", str(plant_of(tmp_path))) for arg in args]) == 2
    err = capsys.readouterr().err
    assert why in err
    assert err.count("\n") == 1


def test_nothing_else_listens_on_a_network() -> None:
    """Sockets that wait for connections: those of the page and of the connectors, and the Unix socket for commands."""
    waiting = re.compile(
        r"create_server\(|start_server\(|create_datagram_endpoint\(|SockSite|TCPSite|socketserver|AF_INET|listening\.listen\("
    )
    root = Path(dpstack.__file__).parent
    found = {
        path.relative_to(root).as_posix()
        for path in root.rglob("*.py")
        if waiting.search(path.read_text(encoding="utf-8"))
    }
    assert found == {
        "api/control/control_server.py",
        "bridge/epics/connector.py",
        "bridge/epics/server.py",
        "bridge/metrics/http_server.py",
        "bridge/opcua/connection.py",
        "tcp_address.py",
        "web/web_server.py",
    }
