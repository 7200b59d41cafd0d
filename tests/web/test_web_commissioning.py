"""The asks of commissioning over the real server: from a scan to the text of a configuration, and nonsense."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from gsd_kit import HEAD

from dpstack.api.commissioning.commissioning import Commissioning
from dpstack.errors import UsageError
from dpstack.web.source import GivenItems
from dpstack.web.web_server import serve
from tests.web.web_kit import page_of

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
