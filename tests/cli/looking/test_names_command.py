"""``dpstack names``: the I/O list as a table, as CSV, and taken back into the configuration."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest
from cli_kit import Cli

from dpstack.api.config.config import Config, load_config
from dpstack.api.lists.io_list_reader import TakenList, take_list

PLANT = """\
[bus]
port = "virtual"
baud = 500000

[[slave]]
name = "rack"          # in the cabinet
address = 8
gsd = "io-station"
modules = ["8 DI", "2 AI"]
inputs = { level = { at = "i16@1", scale = 0.1, unit = "°C" } }
"""
HEADER = "slave,direction,name,type,octet,bit,unit\n"


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    path = tmp_path / "plant.toml"
    path.write_bytes(PLANT.encode())
    return path


def test_the_table_and_json(plant: Path, cli: Cli) -> None:
    lines = cli.out("names", str(plant)).splitlines()
    assert " ".join(lines[1].split()) == "slave slot module channel direction name type octet bit unit scale offset"
    assert lines[10].split() == ["rack", "2", "2", "AI", "0", "input", "level", "i16", "1", "°C", "0.1"]
    found = cli.json("names", str(plant))["names"]
    assert (len(found), found[9]["name"], found[9]["octet"], found[9]["address"]) == (10, None, 3, 8)
    assert found[8] == {
        "slave": "rack",
        "address": 8,
        "slot": 2,
        "module": "2 AI",
        "channel": 0,
        "direction": "input",
        "name": "level",
        "type": "i16",
        "octet": 1,
        "bit": None,
        "unit": "°C",
        "scale": 0.1,
        "offset": None,
        "dead_band": None,
        "status": None,
        "quality": None,
    }


def test_there_and_back(plant: Path, tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / "list.csv"
    assert cli.out("names", str(plant), "--csv", str(path)) == f"{path}: 1 name, 9 channels without a name\n"
    written = path.read_bytes()
    assert written.startswith(b"\xef\xbb\xbfslave,address,slot,")  # with a mark of its encoding, for spreadsheets
    assert written.count(b"\r\n") == 11
    assert cli.out("names", str(plant), "--csv").encode() == written[3:].replace(b"\r\n", b"\n")
    assert cli.out("names", str(plant), "--from", str(path)) == f"{plant}: nothing to change\n"
    assert plant.read_bytes() == PLANT.encode()
    # a list that exists has the work of people in it
    assert "there is a file of that name" in cli.err("names", str(plant), "--csv", str(path))
    # a name is filled in by a spreadsheet that writes semicolons and decimal commas
    rows = list(csv.DictReader(io.StringIO(cli.out("names", str(plant), "--csv", "--semicolons")), delimiter=";"))
    assert rows[8]["scale"] == "0,1"
    rows[3]["name"] = "door"
    filled = io.StringIO(newline="")
    writer = csv.DictWriter(filled, rows[0], delimiter=";")
    writer.writeheader()
    writer.writerows(rows)
    path.write_text(filled.getvalue(), encoding="utf-8-sig", newline="")
    plant.chmod(0o640)
    out = cli.out("names", str(plant), "--from", str(path))
    assert out == f"rack: input door added (bool@0.3)\n{plant}: 1 name changed\n"
    assert plant.read_text("utf-8") == PLANT.replace('"°C" } }', '"°C" }, door = "bool@0.3" }')
    assert plant.stat().st_mode & 0o777 == 0o640
    assert {file.name for file in tmp_path.iterdir()} == {"plant.toml", "list.csv"}
    assert list(load_config(plant).slaves[0].input_fields) == ["level", "door"]


def test_changes_in_json(plant: Path, tmp_path: Path, cli: Cli) -> None:
    plant.write_bytes(b"\xef\xbb\xbf" + PLANT.replace("\n", "\r\n").encode())
    (tmp_path / "l.csv").write_text(HEADER + "rack,input,temperature,i16,1,,K\n", encoding="utf-8")
    assert cli.json("names", str(plant), "--from", str(tmp_path / "l.csv")) == {
        "config": str(plant),
        "changes": [
            {
                "slave": "rack",
                "direction": "input",
                "name": "temperature",
                "change": "renamed",
                "was": "level",
                "at": "i16@1",
            }
        ],
        "kept": [],
    }
    text = PLANT.replace("level", "temperature").replace("°C", "K").replace("\n", "\r\n")
    assert plant.read_bytes() == b"\xef\xbb\xbf" + text.encode()


def test_nothing_is_written_if_a_line_is_refused(plant: Path, tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / "l.csv"
    path.write_text(f"{HEADER}rack,input,a,u8,0,,\nrack,input,b,u8,5,,\nrock,input,c,u8,0,,\n", encoding="utf-8")
    out, err = cli("names", str(plant), "--from", str(path), code=2)
    assert out == ""
    assert err.splitlines() == [
        f'dpstack: {path}:3: slave rack: b = "u8@5" ends in octet 5; its configuration has octets 0..4 of inputs',
        f"dpstack: {path}:4: no slave is called 'rock'; did you mean rack?",
        f"dpstack: {path}: 2 lines are refused; correct the list: {plant} stays as it is",
    ]
    assert plant.read_bytes() == PLANT.encode()


def test_a_configuration_that_changes_meanwhile_stays(
    plant: Path, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "l.csv").write_text(HEADER + "rack,input,a,u8,0,,\n", encoding="utf-8")

    def changed(octets: bytes, name: str, config: Config, text: str) -> TakenList:
        plant.write_text(PLANT + "# somebody else\n", encoding="utf-8")
        return take_list(octets, name, config, text)

    monkeypatch.setattr("dpstack.cli.looking.names.take_list", changed)
    err = cli.err("names", str(plant), "--from", str(tmp_path / "l.csv"))
    assert err == f"dpstack: {plant}: has changed meanwhile, nothing was written; take the list again\n"
    assert plant.read_text("utf-8") == PLANT + "# somebody else\n"


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("--from", "no.csv"), "no.csv: No such file or directory; name a file that can be read"),
        (("--from", "."), ".: Is a directory; name a file that can be read"),
        (("--from", "a", "--csv"), "names writes a list with --csv or takes one with --from: leave one of them out"),
        (("--semicolons",), "names: --semicolons belongs to --csv: add --csv, or leave --semicolons out"),
        (("--csv", "."), ".: is a directory; name a file"),
    ],
)
def test_wrong_use(args: tuple[str, ...], says: str, plant: Path, cli: Cli) -> None:
    assert cli.err("names", str(plant), *args) == f"dpstack: {says}\n"


def test_a_link_is_not_written_through(plant: Path, tmp_path: Path, cli: Cli) -> None:
    (tmp_path / "l.csv").write_text(HEADER + "rack,input,a,u8,0,,\n", encoding="utf-8")
    (tmp_path / "link.toml").symlink_to(plant)
    err = cli.err("names", str(tmp_path / "link.toml"), "--from", str(tmp_path / "l.csv"))
    assert "link.toml: is a link; name the file itself" in err
    assert plant.read_bytes() == PLANT.encode()


def test_the_process_variables_of_epics(plant: Path, cli: Cli) -> None:
    err = cli.err("names", str(plant), "--epics")
    assert err == f"dpstack: {plant}: there is no table [epics]; add it, with the key prefix\n"
    table = '\n[epics]\nprefix = "LAB:"\nallow_commands = ["rack.*"]\n'
    plant.write_bytes(PLANT.encode() + table.encode())
    lines = cli.out("names", str(plant), "--epics").splitlines()
    assert {"LAB:bus:mode", "LAB:rack:state", "LAB:rack:in:level"} <= set(lines)
    assert not any("late_us" in line for line in lines)  # of a fixed cycle
    found = {one["name"]: one for one in cli.json("names", str(plant), "--epics")["epics"]}
    assert list(found) == lines
    assert found["LAB:rack:in:level"] == {"name": "LAB:rack:in:level", "slave": 8, "unit": "°C", "order": None}
    with_long = table.replace("LAB:", "L" * 40)
    plant.write_bytes(PLANT.encode() + with_long.encode())
    assert "characters, and an EPICS name at most 60" in cli.err("names", str(plant), "--epics")
