"""``dpstack sheet``: commissioning sheets as text, JSON and HTML; those of slaves of a GSD file, and of octets."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from cli_kit import Cli
from gsd_kit import HEAD
from page_kit import Page
from plant_files import plant_file

HOIST = {"name": "hoist", "address": 3, "drive": "demag-dedrive", "watchdog_ms": 300}
RACK = {
    "name": "rack",
    "address": 8,
    "gsd": "rack.gsd",
    "modules": ["8 DO", "", "2 AI"],
    "parameters": {"Diagnosis": "off"},
    "inputs": {"level": {"at": "i16@2", "unit": "mm"}},
    "outputs": {"valve": "bool@0.3"},
    "safe": "A5",
    "watchdog_ms": 0,
}
RAW = {"name": "raw", "address": 9, "ident": 0x1234, "config": "20 10"}
#: a rack with texts for its diagnosis, one of which would be markup
GSD = (
    HEAD + 'Vendor_Name = "<script>alert(1)</script>"\nModel_Name = "R&D rack"\nRevision = "V2"\nSlave_Family = 3\n'
    "Modular_Station = 1\nMax_Module = 4\nMax_Input_Len = 8\nMax_Output_Len = 8\nMax_Data_Len = 16\n"
    "Set_Slave_Add_supp = 1\nUser_Prm_Data_Len = 1\n"
    'PrmText = 1\nText(0) = "off"\nText(1) = "on"\nEndPrmText\n'
    'ExtUserPrmData = 1 "Diagnosis"\nBit(0) 1 0-1\nPrm_Text_Ref = 1\nEndExtUserPrmData\n'
    "Ext_User_Prm_Data_Const(0) = 0x00\nExt_User_Prm_Data_Ref(0) = 1\n"
    'Unit_Diag_Bit(3) = "Sensor supply low"\nUnit_Diag_Bit_Help(3) = "Measure <24 V> at X1"\n'
    'Channel_Diag(6) = "Wire torn"\n'
    'Module = "8 DO" 0x20\n1\nEndModule\nModule = "2 AI" 0x51\n2\nEndModule\n'
)


@pytest.fixture
def plant(tmp_path: Path) -> str:
    (tmp_path / "rack.gsd").write_text(GSD, encoding="cp1252")
    return str(plant_file(tmp_path, HOIST, RACK, RAW))


def test_all_sheets_as_text(plant: str, cli: Cli) -> None:
    out = cli.out("sheet", plant)
    lines = [re.sub(" {2,}", "  ", line) for line in out.splitlines()]
    titles = [line for line in lines if ", address " in line]
    assert titles == [
        "hoist, address 3: Demag Dedrive Compact, CM-PDP-24",
        "rack, address 8: <script>alert(1)</script> R&D rack",
        "raw, address 9: device by identifier octets",
    ]
    assert "watchdog  300 ms" in lines
    assert any(line.startswith("391 (Profibus Node-ID) = 3  the master asks for the drive") for line in lines)
    assert any(line.startswith("- after 300 ms: trips F2062 and coasts") for line in lines)
    assert any(line.startswith("F2062  Profibus OFF, the DP master failed") for line in lines)


def test_a_slave_of_a_gsd_file(plant: str, cli: Cli) -> None:
    (sheet,) = cli.json("sheet", plant, "rack")["sheets"]
    assert (sheet["kind"], sheet["name"], sheet["address"], sheet["ident"]) == ("gsd", "rack", 8, "0x0FFE")
    assert sheet["device"]["manual"] == "GSD file rack.gsd, revision V2"
    assert (sheet["watchdog_ms"], sheet["safe"]) == (0, "A5")
    assert sheet["on_loss"] == "goes on with its last outputs: its watchdog is off"
    empty = {"config": "", "inputs": "", "outputs": ""}
    assert sheet["modules"] == [
        {"slot": 1, "name": "8 DO", "config": "20", "inputs": "", "outputs": "0"},
        {"slot": 2, "name": "(empty)", **empty},
        {"slot": 3, "name": "2 AI", "config": "51", "inputs": "0..3", "outputs": ""},
    ]
    assert sheet["values"] == [
        {"name": "level", "way": "inputs", "at": "i16@2", "unit": "mm", "slot": 3},
        {"name": "valve", "way": "outputs", "at": "bool@0.3", "unit": "", "slot": 1},
    ]
    assert sheet["parameters"] == [["Diagnosis", "off"]]
    faults = [(one["code"], one["text"], one["remedy"]) for one in sheet["device"]["faults"]]
    assert faults == [
        ("bit 3", "Sensor supply low", "Measure <24 V> at X1"),
        ("channel error 6", "Wire torn", ""),
    ]
    steps = [step["what"] for step in sheet["device"]["steps"]]
    assert steps == [
        "station address = 8",
        "baud rate = 500 kbit/s",
        "modules plugged in the order of the table of modules",
    ]
    assert "dpstack address" in sheet["device"]["steps"][0]["why"]  # Set_Slave_Add_supp
    out = cli.out("sheet", plant, "8")
    assert "without a master it never stops by itself" in out


def test_a_slave_of_octets_says_that_nothing_is_known(plant: str, cli: Cli) -> None:
    (sheet,) = cli.json("sheet", plant, "raw")["sheets"]
    assert sheet["kind"] == "octets"
    assert (sheet["safe"], sheet["device"]["faults"]) == ("00", [])
    assert [(one["slot"], one["name"], one["config"], one["inputs"], one["outputs"]) for one in sheet["modules"]] == [
        (1, "", "20", "", "0"),
        (2, "", "10", "0", ""),
    ]
    out = cli.out("sheet", plant, "raw")
    assert "without a GSD file nothing is known about its diagnosis bits" in out
    assert "after 10 ms" not in out
    assert re.search(r"after \d+ ms: as its manual says", out)


def test_the_html_file_is_whole_foreign_texts_are_no_markup(plant: str, tmp_path: Path, cli: Cli) -> None:
    file = tmp_path / "sheets.html"
    out = cli.out("sheet", plant, "--html", str(file))
    assert out == f"{file}: the sheets of hoist, rack, raw; open it in a browser and print it\n"
    html = file.read_text(encoding="utf-8")
    page = Page.of(html)
    assert page.faults == []
    assert page.all("script") == []
    assert "<script>alert(1)</script> R&D rack" in page.text
    assert "Measure <24 V> at X1" in page.text
    assert len(page.all("article")) == 3
    ids = [element.attributes["id"] for element in page.elements if "id" in element.attributes]
    assert len(ids) == len(set(ids))
    targets = {one.attributes["href"] for one in page.all("a")}
    assert targets == {"#s3", "#s8", "#s9"}
    assert {target[1:] for target in targets} <= set(ids)
    labels = {one.attributes["for"] for one in page.all("label")}
    assert labels <= set(ids)
    # no network, no script; each sheet begins on a page of its own, and a row is never torn apart
    (policy,) = [one.attributes["content"] for one in page.all("meta") if "http-equiv" in one.attributes]
    assert policy.startswith("default-src 'none'")
    assert not re.search(r"(src|href)=\"(?!#)", html)
    assert re.search(r"\.sheet \{[^}]*break-before: page", page.style)
    assert re.search(r"tr,[^{]*\{ break-inside: avoid", page.style)
    boxes = [one for one in page.elements if one.attributes.get("class") == "tick"]
    steps = sum(len(one["device"]["steps"]) for one in cli.json("sheet", plant)["sheets"])
    assert len(boxes) == steps  # a box to tick for each thing to set


def test_one_sheet_alone(plant: str, tmp_path: Path, cli: Cli) -> None:
    file = tmp_path / "hoist.html"
    result = cli.json("sheet", plant, "hoist", "--html", str(file))
    assert [one["name"] for one in result["sheets"]] == ["hoist"]
    page = Page.of(file.read_text(encoding="utf-8"))
    assert page.all("title")[0].text == "Commissioning sheet, hoist, address 3: Demag Dedrive Compact, CM-PDP-24"
    assert len(page.all("article")) == 1


def test_wrong_use_has_one_line_that_says_what_to_do(plant: str, tmp_path: Path, cli: Cli) -> None:
    assert cli.err("sheet", plant, "hoits") == "dpstack: no slave is called 'hoits'; did you mean hoist?\n"
    assert cli.err("sheet", plant, "77") == "dpstack: no slave is called '77'; known: hoist, rack, raw\n"
    there = tmp_path / "there.html"
    there.write_text("mine")
    assert "there is a file of that name" in cli.err("sheet", plant, "--html", str(there))
    assert there.read_text() == "mine"
    assert "is a directory" in cli.err("sheet", plant, "--html", str(tmp_path))
    assert "no such file" in cli.err("sheet", str(tmp_path / "plants.toml"))
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "has no slaves" in cli.err("sheet", str(plant_file(empty)))


def test_a_bus_whose_rate_is_not_known_yet(tmp_path: Path, cli: Cli) -> None:
    keys = {"name": "hoist", "address": 3, "drive": "demag-dedrive"}
    plant = str(plant_file(tmp_path, keys, RAW, port="/dev/ttyUSB0", baud="auto"))
    sheets = cli.json("sheet", plant)["sheets"]
    assert [(one["baud"], one["watchdog_ms"]) for one in sheets] == [(None, None), (None, None)]
    assert sheets[0]["on_loss"].startswith("trips F2062 and coasts")
    out = cli.out("sheet", plant, "hoist")
    assert "found by listening (auto)" in out
    assert "chosen when the rate of the bus is known" in out


def test_plan_points_to_the_sheet(plant: str, cli: Cli) -> None:
    line = f"note: what to set at each drive and device, faults and LEDs: dpstack sheet {plant}"
    assert line in cli.out("plan", plant).splitlines()


def test_sheet_and_plan_name_the_choice_for_outputs_after_the_slave_was_away(tmp_path: Path, cli: Cli) -> None:
    safe = RAW | {"name": "turns", "address": 10, "after_return": "safe"}
    plant = str(plant_file(tmp_path, HOIST, RAW, safe, RAW | {"name": "eye", "address": 11, "config": "10"}))
    blocks = cli.out("sheet", plant).split("After it was away")
    said = [" ".join(block.split("\n\n")[0].split()) for block in blocks[1:]]
    stays = 'its outputs stay at their safe values until they are set anew (after_return = "safe")'
    assert [text.removeprefix("- ") for text in said] == [
        "the drive does not start by itself: start() starts it again",
        'its outputs are at once those from before (after_return = "resume"), and a drive that starts by level turns; '
        'after_return = "safe" keeps them safe until they are set anew',
        stays,
    ]
    assert cli.json("sheet", plant, "eye")["sheets"][0]["on_return"] == ""
    notes = [line for line in cli.out("plan", plant).splitlines() if "away" in line]
    assert notes == [f"note: slave 10 (turns): after it was away {stays}"]
    found = {one["name"]: one["after_return"] for one in cli.json("plan", plant)["slaves"]}
    assert found == {"hoist": "safe", "raw": "resume", "turns": "safe", "eye": "resume"}


def test_the_same_facts_in_text_and_json(plant: str, cli: Cli) -> None:
    """One maker: each step, fault and LED of the JSON is in the text."""
    out = cli.out("sheet", plant)
    for sheet in cli.json("sheet", plant)["sheets"]:
        device = json.loads(json.dumps(sheet["device"]))
        for key, field in (("steps", "why"), ("faults", "text"), ("warnings", "text"), ("ranges", "wire")):
            assert all(one[field] in out for one in device[key])
