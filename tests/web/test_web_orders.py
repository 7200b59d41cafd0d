"""Orders and asks of a page: who may give them, how the run carries them out, what everybody is told; those of
commissioning, from a scan to the text of a configuration, and nonsense."""

from __future__ import annotations

import asyncio
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from gsd_kit import HEAD
from plant_files import plant_file

from dpstack.api.commissioning.commissioning import Commissioning
from dpstack.errors import BusError, UsageError
from dpstack.web.orders import ORDERS
from dpstack.web.rights import Rights
from dpstack.web.source import GivenItems
from dpstack.web.web_server import serve
from tests.web.web_kit import PLANT, WHOLE, page_of

TOKEN = "anna-0123456789abcdef"
RIGHTS = Rights(control=True, tokens={TOKEN: "anna"})


class Run(GivenItems):
    """A run that writes down its commands. ``refuse`` fails, ``hang`` never answers."""

    def __init__(self) -> None:
        super().__init__([PLANT, WHOLE])
        self.commands: list[tuple[str, ...]] = []
        self.ended = asyncio.Semaphore(0)

    async def call(self, command: str, *args: str) -> object:
        self.commands.append((command, *args))
        if "refuse" in args:
            raise UsageError("no slave <b>'refuse'</b> here")
        if "defect" in args:
            raise ZeroDivisionError("secret")
        if "hang" in args:
            try:
                await asyncio.Event().wait()
            finally:
                self.ended.release()
        return {"did": command}

    async def start(self) -> object:
        self.commands.append(("start",))
        raise BusError("the port is held by another program")


async def test_orders_become_commands_of_the_run_and_all_pages_are_told() -> None:
    run, log = Run(), list[str]()
    served = serve(run, rights=RIGHTS, log=log.append)
    async with served as server, page_of(server, TOKEN) as page, page_of(server, TOKEN) as other:
        orders: list[tuple[str, ...]] = [
            ("operate",),
            ("clear",),
            ("stop",),
            ("set", "valves.limit=on", "8.level=3"),
            ("outputs", "9=00FF"),
            ("drive", "hoist", "speed", "0.5"),
            ("write", "8", "1", "47", "00FF"),
            ("force", "tank.level=3"),
            ("release", "tank"),
        ]
        for number, (command, *args) in enumerate(orders):
            answer = await page.order(command, *args, id=number)
            assert answer == {"id": number, "ok": True, "result": {"did": run.commands[-1][0]}}
        assert run.commands == [
            *orders[:3],
            ("set", "now", "valves.limit=on", "8.level=3"),
            ("outputs", "now", "9=00FF"),
            ("drive", "now", "hoist", "speed", "0.5"),
            ("acyclic", "8", "write", "1", "47", "00FF"),
            ("set", "now", "tank.level=3"),
            ("mirror", "tank"),
        ]
        refused = await page.order("set", "refuse", id=9)
        assert refused == {"id": 9, "ok": False, "error": "no slave <b>'refuse'</b> here"}
        assert "held by another" in (await page.order("start"))["error"]
        told = [await other.until("event") for _ in range(11)]
    assert told[3]["text"] == "order of anna: set valves.limit=on 8.level=3: done"
    assert told[3] | {"time": "", "text": ""} == {
        "event": "web",
        "time": "",
        "severity": "info",
        "text": "",
        "by": "anna",
        "command": "set",
        "args": ["valves.limit=on", "8.level=3"],
        "ok": True,
    }
    assert [one["ok"] for one in told] == [True] * 9 + [False] * 2
    assert [one["severity"] for one in told[9:]] == ["warning"] * 2
    assert len(log) == 22  # given, and its result
    assert [line.partition(" ")[2] for line in log[:3]] == [
        "order of anna: operate",
        "order of anna: operate: done",
        "order of anna: clear",
    ]
    assert all(re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z order of anna: ", line) for line in log)


async def test_no_order_without_confirmation_or_without_rights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dpstack.web.web_server._BURST", 100.0)
    run, log = Run(), list[str]()
    async with serve(run, rights=RIGHTS, log=log.append) as server, page_of(server, TOKEN) as page:
        for command in ORDERS:
            assert "not confirmed" in (await page.order(command, confirmed=False))["error"]
            await page.send({"order": {"id": 3, "command": command}})
            assert "not confirmed" in (await page.until("answer"))["error"]
            await page.send({"order": {"id": 3, "command": command, "confirmed": 1}})
            assert "Expected `bool`, got `int` - at `$.confirmed`" in (await page.until("answer"))["error"]
    async with serve(run, log=log.append) as server, page_of(server, TOKEN) as page:
        for command in ORDERS:
            assert "--control" in (await page.order(command))["error"]
    looking = Rights(tokens={TOKEN: "anna"})
    async with serve(run, rights=looking, log=log.append) as server, page_of(server, TOKEN) as page:
        for command in ORDERS:
            assert "--control" in (await page.order(command))["error"]
    assert run.commands == []
    assert log == []


async def test_other_commands_of_the_control_socket_are_no_orders_and_no_asks() -> None:
    run = Run()
    async with serve(run, rights=RIGHTS) as server, page_of(server, TOKEN) as page:
        for command in ("power-off", "trip", "help", "tap", "live", "acyclic", "", "OPERATE", "__init__"):
            assert "there is no order" in (await page.order(command, "3"))["error"]
            assert "there is no ask" in (await page.ask(command, "3"))["error"]
        assert "pa takes SLAVE NAME VALUE" in (await page.order("pa", "8", "tb1.lower_range"))["error"]
        assert "write takes" in (await page.order("write", "8", "1"))["error"]
        for what in ("im", "records"):  # an ask never becomes a write
            assert f"{what} takes SLAVE" in (await page.ask(what, "x", "write", "1", "47", "00"))["error"]
        assert (await page.ask("records", "x", "write", "47"))["ok"] is True
    assert run.commands == [("acyclic", "x", "read", "write", "47")]


async def test_asks_of_the_run() -> None:
    run = Run()
    async with serve(run) as server, page_of(server) as page:
        asks: list[tuple[Any, ...]] = [("why", "valves"), ("diag", 8), ("records", "8", 1, 47), ("im", 8), ("scan",)]
        asks += [("pa", 8), ("pa", 8, "ai1.out")]
        for what, *args in asks:
            assert (await page.ask(what, *args))["ok"] is True
        assert "takes SLAVE" in (await page.ask("why"))["error"]
        assert "takes ADDRESS" in (await page.ask("diag", [1]))["error"]
        assert "no recording" in (await page.ask("recording"))["error"]
    assert run.commands == [
        ("why", "valves"),
        ("diag", "8"),
        ("acyclic", "8", "read", "1", "47"),
        ("acyclic", "8", "im"),
        ("scan",),
        ("acyclic", "8", "pa"),
        ("acyclic", "8", "pa", "read", "ai1.out"),
    ]


async def test_a_defect_ends_no_page_and_tells_no_secret() -> None:
    log: list[str] = []
    async with serve(Run(), log=log.append) as server, page_of(server) as page:
        answer = await page.ask("why", "defect")
        assert answer["error"] == "failed by a defect, please report it: ZeroDivisionError"
        assert (await page.ask("why", "valves"))["ok"] is True
    assert "ZeroDivisionError: secret" in log[0]


async def test_requests_under_way_are_bounded_and_end_with_their_page() -> None:
    run = Run()
    async with serve(run) as server, page_of(server) as other:
        async with page_of(server) as page:
            for number in range(4):
                await page.send({"ask": {"id": number, "what": "why", "args": ["hang"]}})
            await page.send({"ask": {"id": 4, "what": "why", "args": ["valves"]}})
            answer = await page.until("answer")
            assert (answer["id"], answer["ok"]) == (4, False)
            assert "wait for an answer" in answer["error"]
        for _ in range(4):
            await asyncio.wait_for(run.ended.acquire(), 5)
        assert (await other.ask("why", "valves"))["ok"] is True


async def test_a_page_that_asks_too_often_is_told_and_goes_on() -> None:
    async with serve(Run()) as server, page_of(server) as page:
        for number in range(40):
            await page.send({"ask": {"id": number, "what": "scan", "args": ["no"]}})
        answers = [await page.until("answer") for _ in range(40)]
        assert sorted(answer["id"] for answer in answers) == list(range(40))
        assert sum("messages a second" in answer["error"] for answer in answers) >= 5


ISLAND = (
    'Vendor_Name = "Nobody"\nModel_Name = "<script>alert(1)</script>"\nModular_Station = 1\nMax_Module = 4\n'
    "Max_Input_Len = 4\nMax_Output_Len = 4\nMax_Data_Len = 8\n"
    'Module = "8 DO" 0x20\n1\nEndModule\nModule = "8 DI" 0x10\n2\nEndModule\n'
)
SCAN = {
    "baud": 500_000,
    "address": 2,
    "stations": [
        {"address": 3, "type": "slave", "ident": "0x0696", "state": "wait_prm", "master": None, "config": "F3 71"},
        {"address": 8, "type": "slave", "ident": "0x0FFE", "state": "wait_prm", "master": None, "config": "20 10"},
    ],
}


class Scanned(GivenItems):
    """A run whose bus has two slaves."""

    async def call(self, command: str, *args: str) -> object:
        assert (command, args) == ("scan", ())
        return SCAN


@pytest.fixture
def commissioning(tmp_path: Path) -> Commissioning:
    (tmp_path / "gsd").mkdir()
    (tmp_path / "gsd" / "island.gsd").write_text(HEAD + ISLAND)
    return Commissioning(tmp_path / "plant.toml", tmp_path / "gsd")


async def test_from_a_scan_to_a_configuration(commissioning: Commissioning) -> None:
    async with serve(Scanned(), commissioning=commissioning) as server, page_of(server) as page:

        async def ask(what: str, *args: object) -> Any:
            answer = await page.ask(what, *args)
            assert answer["ok"], answer
            return answer["result"]

        stations = (await ask("scan"))["stations"]
        matched = (await ask("match", stations))["stations"]
        slaves = [
            {"name": one["name"], "address": one["address"], **one["candidates"][0]["keys"], "watchdog_ms": 100}
            for one in matched
        ]
        slaves[1]["name"] = '🙂 "valves" of hall 2'
        modules = await ask("modules", "gsd/island.gsd", "20 10")
        assert modules["model"] == "<script>alert(1)</script>"
        assert [place["modules"] for place in modules["readings"][0]["places"]] == [[0], [1]]
        assert (await ask("table", slaves[1]))["inputs"] == 1
        made = await ask("toml", {"bus": {"port": "/dev/ttyUSB0", "baud": 500_000}, "slaves": slaves})
        assert made["errors"] == []
        data = tomllib.loads(made["toml"])
        assert data["slave"][0] == {
            "name": "demag-dedrive-3",
            "address": 3,
            "drive": "demag-dedrive",
            "telegram": "PPO1",
            "watchdog_ms": 100,
        }
        assert data["slave"][1]["name"] == '🙂 "valves" of hall 2'
        assert data["slave"][1]["modules"] == ["8 DO", "8 DI"]
        wrong = await ask("check", made["toml"].replace("watchdog_ms = 100", "watchdog = 100", 1) + "# long\n" * 2000)
        line = made["toml"].split("\n").index("watchdog_ms = 100") + 1
        assert [error["line"] for error in wrong["errors"]] == [line]
        assert "watchdog_ms" in wrong["errors"][0]["suggestion"]


async def test_the_commissioning_sheet_of_a_slave(tmp_path: Path) -> None:
    plant_file(tmp_path, {"name": "hoist", "address": 3, "drive": "demag-dedrive"})
    commissioning = Commissioning(tmp_path / "plant.toml")
    async with serve(Scanned(), commissioning=commissioning) as server, page_of(server) as page:
        answer = await page.ask("sheet", "3")
        assert answer["ok"], answer
        sheet = answer["result"]
        assert (sheet["name"], sheet["address"]) == ("hoist", 3)
        assert sheet["title"] == "hoist, address 3: Demag Dedrive Compact, CM-PDP-24"
        faults = next(one for one in sheet["blocks"] if one["title"] == "Faults")
        assert faults["columns"] == ["code", "meaning", "remedy", "source"]
        assert faults["rows"][1] == ["F2062", "Profibus OFF, the DP master failed", "", "13.2"]
        assert sheet["html"].startswith("<!DOCTYPE html>")
        assert "F2062" in sheet["html"]
        assert str(tmp_path) not in json.dumps(sheet)  # paths of this computer are not for all who look at a page
        for wrong in (4, "hoister", "h" * 200):
            assert "no slave is called" in (await page.ask("sheet", wrong))["error"]
        nothing: tuple[object, ...] = ([], {"a": 1}, None, "")
        for nonsense in nothing:
            assert "slave must be a text" in (await page.ask("sheet", nonsense))["error"]
        (tmp_path / "plant.toml").unlink()
        assert "no such file" in (await page.ask("sheet", "hoist"))["error"]


@pytest.mark.parametrize(
    ("what", "args"),
    [
        ("match", [5]),
        ("match", []),
        ("toml", [{"slaves": [[]]}]),
        ("toml", [{"slaves": [{"inputs": {"a": [[None]]}}]}]),
        ("modules", ["../../etc/passwd"]),
        ("modules", ["gsd/island.gsd", "2"]),
        ("table", ["[[slave]]"]),
        ("check", [None]),
        ("scan", ["now"]),
    ],
)
async def test_nonsense_is_answered_in_one_line(commissioning: Commissioning, what: str, args: list[object]) -> None:
    async with serve(Scanned(), commissioning=commissioning) as server, page_of(server) as page:
        answer = await page.ask(what, *args, id=9)
        assert (answer["id"], answer["ok"]) == (9, False)
        assert answer["error"]
        assert "defect" not in answer["error"]
        assert "\n" not in answer["error"]


async def test_without_a_configuration_there_is_no_folder() -> None:
    async with serve(GivenItems()) as server, page_of(server) as page:
        assert "no configuration" in (await page.ask("files"))["error"]


class OverClass2(GivenItems):
    """A run with slave 3, without DP-V1 in its parameters, and slave 4, which has no class 2 connections either."""

    async def call(self, command: str, *args: str) -> object:
        if command == "class2" and args[0] == "3":
            return {"order": args[1], "data": "00ff"}
        raise UsageError(f"{command}: no")


async def test_records_of_a_slave_without_dp_v1_are_read_over_class_2() -> None:
    async with serve(OverClass2()) as server, page_of(server) as page:
        assert (await page.ask("records", "3", "1", "47"))["result"] == {"order": "read", "data": "00ff"}
        assert (await page.ask("im", "3"))["result"]["order"] == "im"
        assert (await page.ask("im", "4"))["error"] == "acyclic: no"
