"""Commissioning: GSD files of a folder, candidates of found slaves, modules, tables, checks, whole configurations."""

from __future__ import annotations

import contextlib
import json
import os
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from gsd_kit import HEAD, octets
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.api.commissioning.commissioning import Commissioning
from dpstack.api.config.config import load_config, parse_config
from dpstack.errors import ConfigError, UsageError
from dpstack.units import BAUD_RATES

#: modules with 8 outputs, 8 inputs, and a twin of the latter
FILE = (
    'Vendor_Name = "Nobody"\nModel_Name = "<b>Valve island</b>"\nModular_Station = 1\nMax_Module = 4\n'
    "Max_Input_Len = 4\nMax_Output_Len = 4\nMax_Data_Len = 8\n"
    'Module = "8 DO" 0x20\n1\nEndModule\nModule = "8 DI" 0x10\n2\nEndModule\nModule = "8 DI slow" 0x10\n3\nEndModule\n'
)
ISLAND = {"address": 8, "type": "slave", "ident": "0x0FFE", "state": "wait_prm", "config": "20 10"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """``plant.toml`` will be in it; ``gsd`` holds the files."""
    gsd = tmp_path / "gsd"
    (gsd / "deep").mkdir(parents=True)
    (gsd / "island.gsd").write_text(HEAD + FILE, encoding="cp1252")
    (gsd / "deep" / "Other Ränge.GSE").write_text(
        HEAD + 'Model_Name = "other"\nModule = "x" 0x31\nEndModule\n', encoding="utf-8"
    )
    (gsd / "whole.gsd").write_bytes(octets("whole"))
    (gsd / "broken.gsd").write_bytes(b"<?xml version='1.0'?>")
    (gsd / "no_number.gsd").write_text(HEAD.replace("Ident_Number = 0x0FFE\n", ""))
    return tmp_path


@pytest.fixture
def commissioning(folder: Path) -> Commissioning:
    return Commissioning(folder / "plant.toml", folder / "gsd")


def plain(value: Any) -> Any:
    """As it goes through JSON."""
    return json.loads(json.dumps(value))


# --- the folder -----------------------------------------------------------------------------------------------------


def test_files_are_listed_and_bad_ones_with_the_reason(commissioning: Commissioning, folder: Path) -> None:
    listed = plain(commissioning.files())
    by_name = {one["gsd"]: one for one in listed["files"]}
    assert by_name["gsd/whole.gsd"] == {
        "gsd": "gsd/whole.gsd",
        "ident": "0x1A2B",
        "vendor": "Nobody & Sons",
        "model": "Terminal 8",
    }
    assert by_name["gsd/deep/Other Ränge.GSE"]["model"] == "other"
    assert by_name["gsd/island.gsd"]["model"] == "<b>Valve island</b>"  # text, never markup: the page decides
    assert by_name["io-station"]["ident"] is not None
    reasons = {Path(one["gsd"]).name: one["reason"] for one in listed["bad"]}
    assert reasons.keys() == {"broken.gsd", "no_number.gsd"}
    assert "XML" in reasons["broken.gsd"]
    assert reasons["no_number.gsd"].startswith("1: nothing to use: neither Ident_Number nor a module is in it")
    # a file that comes, changes or goes is noticed
    (folder / "gsd" / "broken.gsd").write_text(HEAD + 'Model_Name = "mended"\n')
    (folder / "gsd" / "whole.gsd").unlink()
    listed = commissioning.files()
    assert "gsd/whole.gsd" not in {one["gsd"] for one in listed["files"]}
    assert {Path(one["gsd"]).name for one in listed["bad"]} == {"no_number.gsd"}
    (folder / "gsd" / "new.gsd").write_text(HEAD + FILE)
    assert commissioning.table({"address": 3, "gsd": "gsd/new.gsd", "modules": [1]})["errors"] == []
    (folder / "gsd" / "new.gsd").write_text(HEAD + FILE.replace('"8 DO"', '"8 DO, new"'))
    assert commissioning.modules("gsd/new.gsd")["modules"][0]["name"] == "8 DO, new"
    (folder / "gsd" / "new.gsd").unlink()
    assert commissioning.table({"address": 3, "gsd": "gsd/new.gsd", "modules": [1]})["errors"]


def test_nothing_outside_the_folder_is_read(folder: Path) -> None:
    secret = folder / "secret.gsd"
    secret.write_text(HEAD + FILE)
    (folder / "gsd" / "link.gsd").symlink_to(secret)
    os.mkfifo(folder / "gsd" / "pipe.gsd")
    commissioning = Commissioning(folder / "plant.toml", folder / "gsd")
    reasons = {Path(one["gsd"]).name: one["reason"] for one in commissioning.files()["bad"]}
    assert reasons["link.gsd"] == "a symbolic link that leads out of the folder"
    assert "a pipe" in reasons["pipe.gsd"]
    for name in ("secret.gsd", "gsd/../secret.gsd", str(secret), "/etc/passwd", "~root/x.gsd", "gsd/link.gsd", "\0"):
        with pytest.raises(UsageError, match="is none of the GSD files"):
            commissioning.modules(name)
        quoted = json.dumps(name)
        text = f'[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\naddress = 3\ngsd = {quoted}\n'
        (error,) = commissioning.check(text)["errors"]
        assert error["line"] == 6
        assert "is none of the GSD files in" in error["text"]
        assert commissioning.table({"address": 3, "gsd": name})["errors"]
    # there or not makes no difference
    texts = [
        commissioning.table({"address": 3, "gsd": name})["errors"][0]["text"] for name in ("/etc/hosts", "/nowhere")
    ]
    assert texts[0].replace("/etc/hosts", "") == texts[1].replace("/nowhere", "")


def test_without_a_folder_those_beside_the_configuration_and_named_in_it(folder: Path) -> None:
    plant = folder / "plant.toml"
    plant.write_text(
        '[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\naddress = 3\ngsd = "gsd/island.gsd"\nmodules = [1]\n'
    )
    (folder / "beside.gsd").write_text(HEAD + FILE)
    listed = [one["gsd"] for one in Commissioning(plant).files()["files"]]
    assert {name for name in listed if "." in name} == {"beside.gsd", "gsd/island.gsd"}
    with pytest.raises(ConfigError, match="no folder"):
        Commissioning(plant, folder / "nowhere")


# --- match and modules ----------------------------------------------------------------------------------------------


def test_candidates_of_a_slave_the_best_one_first(commissioning: Commissioning) -> None:
    found = plain(commissioning.match([ISLAND, {"address": 2, "type": "master_in_ring", "ident": None}]))
    (slave,) = found["stations"]
    assert (slave["address"], slave["ident"], slave["config"], slave["name"]) == (
        8,
        "0x0FFE",
        "20 10",
        "b-valve-island-b-8",
    )
    island, other, bare = slave["candidates"]
    assert (island["gsd"], island["fit"], island["ambiguous"]) == ("gsd/island.gsd", "exact", True)
    assert island["keys"] == {"gsd": "gsd/island.gsd", "modules": ["8 DO", "8 DI"]}
    assert (other["gsd"], other["fit"], other["unknown_octets"], other["keys"]) == (
        "gsd/deep/Other Ränge.GSE",
        "none",
        2,
        None,
    )
    assert (bare["kind"], bare["keys"]) == ("octets", {"ident": 0x0FFE, "config": "20 10"})


def test_known_drives_are_candidates(commissioning: Commissioning) -> None:
    stations = [{"address": 3, "ident": "0x0696", "config": "F3 71"}, {"address": 4, "ident": 0x0696, "config": None}]
    first, second = plain(commissioning.match(stations))["stations"]
    assert first["name"] == "demag-dedrive-3"
    assert (first["candidates"][0]["kind"], first["candidates"][0]["fit"]) == ("drive", "exact")
    assert first["candidates"][0]["keys"] == {"drive": "demag-dedrive", "telegram": "PPO1"}
    assert second["candidates"][0]["fit"] == "unknown"
    loaded = parse_config(
        commissioning.toml(plant_of({"address": 3, "name": "h", **first["candidates"][0]["keys"]}))["toml"]
    )
    assert loaded.slaves[0].params.config == bytes.fromhex("F3 71")


def test_modules_of_a_file_and_the_readings_of_octets(commissioning: Commissioning) -> None:
    found = plain(commissioning.modules("gsd/island.gsd", "20 10 31"))
    assert [(one["key"], one["config"], one["inputs"], one["outputs"]) for one in found["modules"]] == [
        ("8 DO", "20", 0, 1),
        ("8 DI", "10", 1, 0),
        ("8 DI slow", "10", 1, 0),
    ]
    assert found["max_module"] == 4
    (reading,) = found["readings"]
    assert reading["unknown_octets"] == 1
    assert [(place["slot"], place["modules"], place["unknown"]) for place in reading["places"]] == [
        (1, [0], False),
        (2, [1, 2], False),
        (3, [], True),
    ]
    without = commissioning.modules("gsd/whole.gsd")
    assert without["readings"] == []


@pytest.mark.parametrize(
    "stations",
    [
        None,
        {},
        [1],
        [{}],
        [{"address": True}],
        [{"address": 127}],
        [{"address": 3, "ident": "x"}],
        [{"address": 3, "ident": 65536}],
        [{"address": 3, "config": "2"}],
        [{"address": 3, "config": 5}],
        [ISLAND] * 128,
    ],
)
def test_nonsense_gets_one_clear_line(commissioning: Commissioning, stations: object) -> None:
    with pytest.raises(UsageError):
        commissioning.match(stations)


# --- table, check, toml ---------------------------------------------------------------------------------------------


def plant_of(*slaves: dict[str, object], **bus: object) -> dict[str, object]:
    return {"bus": {"port": "/dev/ttyUSB0", "baud": 500_000, **bus}, "slaves": list(slaves)}


def test_a_table_has_its_octets_as_comments(commissioning: Commissioning) -> None:
    keys = {"gsd": "gsd/island.gsd", "modules": ["8 DO", 3], "name": "valves", "address": 8, "watchdog_ms": 200}
    table = plain(commissioning.table({**keys, "inputs": {"limit": "bool@0.3"}}))
    assert table["text"].splitlines() == [
        "[[slave]]",
        'name = "valves"',
        "address = 8",
        'gsd = "gsd/island.gsd"',
        'modules = ["8 DO", 3]',
        "watchdog_ms = 200",
        'inputs = { "limit" = "bool@0.3" }',
        "# identifier octets 20 10: 1 octets of inputs, 1 of outputs",
        "# user parameters none",
        '# slot 1 "8 DO": outputs 0, 8 channels',
        '# slot 2 "8 DI slow": inputs 0, 8 channels',
    ]
    assert (table["inputs"], table["outputs"], table["errors"]) == (1, 1, [])
    wrong = plain(commissioning.table({**keys, "modules": ["8 DX"]}))
    assert (
        wrong["errors"][0]["text"] == "[[slave]] valves: there is no module '8 DX'"
        or "8 DX" in wrong["errors"][0]["text"]
    )
    assert "8 DO" in wrong["errors"][0]["suggestion"]
    assert wrong["inputs"] is None


def test_the_check_names_line_and_remedy_of_every_table(commissioning: Commissioning) -> None:
    text = (
        '[bus]\nport = "virtual"\nbaud = 500001\n\n[[slave]]\nadress = 3\n\n[[slave]]\naddress = 4\nident = 0x1234\n'
        'config = "2"\n'
    )
    checked = plain(commissioning.check(text))
    assert [(error["line"], error["suggestion"]) for error in checked["errors"]] == [
        (
            3,
            "nearest is 500000; known: " + ", ".join(map(str, BAUD_RATES)),
        ),
        (6, "did you mean 'address'?"),
        (11, 'write octets like "20 10"'),
    ]
    assert (checked["plan"], checked["text"]) == (None, "3 errors")
    (broken,) = commissioning.check("[bus\n")["errors"]
    assert broken["line"] == 1
    twice = '[bus]\nport = "virtual"\nbaud = 500000\n' + '[[slave]]\naddress = 4\nident = 1\nconfig = "20"\n' * 2
    assert [error["line"] for error in commissioning.check(twice)["errors"]] == [9, 8]


def test_the_check_has_the_plan(commissioning: Commissioning) -> None:
    text = (
        '[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\naddress = 4\nident = 1\nconfig = "20"\nwatchdog_ms = 10\n'
    )
    checked = plain(commissioning.check(text))
    assert checked["errors"] == []
    assert 0 < checked["plan"]["rotation_us"]["min"] < checked["plan"]["rotation_us"]["max"]
    assert checked["plan"]["slaves"][0]["chk_cfg"] == "20"
    auto = plain(commissioning.check(text.replace("500000", '"auto"')))
    assert (auto["errors"], auto["plan"]) == ([], None)
    assert "no plan without a baud rate" in auto["text"]
    short = commissioning.check(text.replace("[[slave]]", "cycle_ms = 0.01\n[[slave]]"))
    assert short["errors"][0]["line"] == 4


def test_the_whole_text_loads_from_its_file(commissioning: Commissioning, folder: Path) -> None:
    (slave,) = commissioning.match([ISLAND])["stations"]
    keys = {"name": slave["name"], "address": 8, **slave["candidates"][0]["keys"]}
    made = plain(commissioning.toml(plant_of({"address": 9, "ident": "0x1234", "config": "20 10"}, keys)))
    assert made["errors"] == []
    assert made["plan"]["baud"] == 500_000
    assert not (folder / "plant.toml").exists()  # the browser keeps it, not the server
    (folder / "plant.toml").write_text(made["toml"], encoding="utf-8")
    loaded = load_config(folder / "plant.toml")
    assert [(one.address, one.name, one.params.ident, one.params.config.hex()) for one in loaded.slaves] == [
        (8, "b-valve-island-b-8", 0x0FFE, "2010"),
        (9, "slave9", 0x1234, "2010"),
    ]


def test_the_text_proposes_names_as_the_scan_on_the_command_line_does(
    commissioning: Commissioning, folder: Path
) -> None:
    """Without the # of the proposals they are the names; a slave with names, and a drive, gets none."""
    keys = {"gsd": "gsd/island.gsd", "modules": ["8 DO", 3], "name": "valves", "address": 8}
    fan = {"address": 4, "drive": "fuji-frenic", "ident": "ask"}
    made = plain(commissioning.toml(plant_of(fan, keys, {"address": 9, "ident": 1, "config": "51"})))
    taken = re.sub(r"^# (?=\[slave\.|slot\d)", "", made["toml"], flags=re.MULTILINE)
    assert made["toml"].count("# [slave.") == 3
    (folder / "plant.toml").write_text(taken, encoding="utf-8")
    named = [(one.name, [*one.input_fields], [*one.output_fields]) for one in load_config(folder / "plant.toml").slaves]
    assert named == [
        ("slave4", [], []),
        ("valves", [f"slot2_{n}" for n in range(8)], [f"slot1_{n}" for n in range(8)]),
        ("slave9", ["slot1_ai0", "slot1_ai1"], []),
    ]


NAMES = st.text(st.characters(exclude_categories=()), min_size=1, max_size=30)
ODD = st.sampled_from(
    [
        "fan",
        "a b",
        'quo"te',
        "it's",
        "back\\slash",
        "🙂 pump",
        "# no comment",
        "<script>",
        "ümlaut",
        "x" * 200,
        "]]",
        "a\nb",
    ]
)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | NAMES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3),
    max_leaves=5,
)


@given(st.lists(ODD | NAMES, min_size=1, max_size=4, unique=True), st.binary(max_size=6), ODD)
@examples(30)
def test_every_name_comes_back_or_is_refused(names: list[str], user_prm: bytes, port: str) -> None:
    """The text is read by tomllib, which is not ours, and by the reader of configurations."""
    commissioning = EMPTY
    slaves = [
        {
            "name": name,
            "address": n,
            "ident": 0x1234,
            "config": "20 10",
            "user_prm": user_prm.hex(" "),
            "groups": [1, 8],
        }
        for n, name in enumerate(names, 3)
    ]
    if any("\ud800" <= letter <= "\udfff" for name in names for letter in name):
        with pytest.raises(ConfigError, match="no Unicode text"):
            commissioning.toml(plant_of(*slaves, port=port))
        return
    made = commissioning.toml(plant_of(*slaves, port=port))
    data = tomllib.loads(made["toml"])
    assert [slave["name"] for slave in data["slave"]] == names
    assert data["bus"] == {"port": port, "baud": 500_000}
    if made["errors"]:
        assert all(error["line"] is not None and error["suggestion"] for error in made["errors"])
        return
    assert [slave.name for slave in parse_config(made["toml"]).slaves] == names


@given(
    st.dictionaries(
        st.sampled_from(["name", "address", "gsd", "modules", "inputs", "ident"]) | NAMES, VALUES, max_size=4
    )
)
@examples(30)
def test_nonsense_keys_are_refused_or_named_as_errors(keys: dict[str, object]) -> None:
    try:
        made = EMPTY.toml({"bus": keys, "slaves": [keys]})
    except (ConfigError, UsageError):
        return
    tomllib.loads(made["toml"])
    assert made["errors"]


@given(VALUES)
@examples(30)
def test_nonsense_of_any_shape_is_refused(value: object) -> None:
    for ask in (EMPTY.match, EMPTY.table, EMPTY.check, EMPTY.toml, EMPTY.modules):
        with contextlib.suppress(ConfigError, UsageError):
            json.dumps(ask(value))


EMPTY = Commissioning()
