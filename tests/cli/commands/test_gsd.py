"""``dpstack gsd``: what people and scripts read, the way from a file to a table that a configuration accepts, a file of
a slave in a module of the user, and the same file at both ends of a segment of ptys."""

from __future__ import annotations

import io
import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from api_kit import RAW
from cli_kit import Cli
from far_ends import HANG_S
from gsd_kit import FILES, device, octets
from plant_files import plant_file
from programs import Starter

from dpstack.api.config.config import load_config, parse_config
from dpstack.api.gsd_info import check_gsd
from dpstack.cli.main import main
from dpstack.errors import ConfigError, GsdError
from dpstack.gsd.configuration import find_module, plug
from dpstack.gsd.model import Diagnostic

WHOLE = str(FILES / "whole.gsd")
Out = pytest.CaptureFixture[str]


def test_show_as_json(cli: Cli) -> None:
    shown = cli.json("gsd", "show", WHOLE)
    assert {
        key: shown[key]
        for key in (
            "ident",
            "vendor",
            "model",
            "gsd_revision",
            "modular",
            "max_module",
            "max_input_len",
            "max_output_len",
            "max_data_len",
            "max_diag_data_len",
            "user_prm",
            "user_prm_const",
            "unit_diag_bits",
        )
    } == {
        "ident": "0x1A2B",
        "vendor": "Nobody & Sons",
        "model": "Terminal 8",
        "gsd_revision": 5,
        "modular": True,
        "max_module": 4,
        "max_input_len": 16,
        "max_output_len": 8,
        "max_data_len": 20,
        "max_diag_data_len": 32,
        "user_prm": "8000000800",
        "user_prm_const": "8000000000",
        "unit_diag_bits": 1,
    }
    assert [
        {k: m[k] for k in ("name", "reference", "config", "inputs", "outputs", "user_prm")} for m in shown["modules"]
    ] == [
        {"name": "8 DI", "reference": 1, "config": "10", "inputs": 1, "outputs": 0, "user_prm": "0101f4"},
        {"name": "8 DO", "reference": 2, "config": "20", "inputs": 0, "outputs": 1, "user_prm": ""},
        {"name": "4 AI", "reference": 3, "config": "4343010203", "inputs": 8, "outputs": 0, "user_prm": ""},
    ]
    assert shown["diagnostics"] == []  # a default over zero bits of the constants is the usual way
    found = [d for d in cli.json("gsd", "show", str(FILES / "prm.gsd"))["diagnostics"] if "contradict" in d["message"]]
    assert [(d["line"], d["column"], d["severity"]) for d in found] == [(39, 1, "warning")]
    assert found[0]["message"].startswith("the device: defaults contradict the constant octets (Diagnosis@3.3:")


@pytest.mark.parametrize("limit", ["4", "-3"])
def test_a_file_with_more_constants_than_its_limit_is_shown_with_the_remark(
    limit: str, cli: Cli, tmp_path: Path
) -> None:
    path = tmp_path / "narrow.gsd"
    path.write_text(
        f"#Profibus_DP\nIdent_Number=1\nMax_User_Prm_Data_Len={limit}\nExt_User_Prm_Data_Const(0)=1,2,3,4,5\n"
    )
    shown = cli.json("gsd", "show", str(path))
    assert (shown["ident"], shown["user_prm"], shown["user_prm_const"]) == ("0x0001", "0102030405", "0102030405")
    remark = (
        f"5 octets of user parameters, Max_User_Prm_Data_Len is {limit}; the device may refuse them (Prm_Fault): then "
        f"give the octets that its manual wants as user_prm"
    )
    assert remark in [diagnostic["message"] for diagnostic in shown["diagnostics"]]
    assert remark in cli.out("gsd", "show", str(path))


def test_show_for_people(cli: Cli) -> None:
    out = cli.out("gsd", "show", WHOLE)
    for text in ("Terminal 8", "0x1A2B", "4 AI", "43 43 01 02 03", "Diagnosis", "off, on", "12 Mbit/s", "sync, freeze"):
        assert text in out


@pytest.mark.parametrize("name", sorted(path.stem for path in FILES.glob("*.gsd")))
def test_every_file_is_shown(name: str, cli: Cli) -> None:
    path = str(FILES / f"{name}.gsd")
    cli("gsd", "show", path)
    assert cli.json("gsd", "show", path)["ident"]


def test_check_tells_and_judges(cli: Cli, tmp_path: Path) -> None:
    assert cli.out("gsd", "check", str(FILES / "slots.gsd"), str(FILES / "mark_missing.gsd")).splitlines() == [
        f"{FILES}/slots.gsd: nothing is wrong",
        f"{FILES}/mark_missing.gsd:1:1: warning: no line #Profibus_DP, which begins a GSD file; read from its first "
        "line",
    ]
    wrong = tmp_path / "wrong.gsd"
    wrong.write_bytes(b"")
    first, second = cli.jsons("gsd", "check", str(wrong), str(FILES / "damaged_module.gsd"), code=1)
    assert first == {
        "file": str(wrong),
        "diagnostics": [
            {"line": 1, "column": 1, "severity": "error", "message": "the file is empty; get a whole copy of it"}
        ],
    }
    assert [d["severity"] for d in second["diagnostics"]].count("error") == 3


def test_check_tells_that_a_modular_station_has_no_module(cli: Cli, tmp_path: Path) -> None:
    cut = tmp_path / "cut.gsd"
    cut.write_text((FILES / "whole.gsd").read_text(encoding="utf-8").partition('Module = "')[0], encoding="utf-8")
    assert "a modular station (Modular_Station = 1) without any Module: the file may be cut short" in (
        cli.out("gsd", "check", str(cut))
    )


@pytest.mark.parametrize("command", ["show", "configure"])
def test_a_file_that_cannot_be_read_is_one_line(command: str, cli: Cli, tmp_path: Path) -> None:
    assert cli.err("gsd", command, str(tmp_path / "none.gsd")) == (
        f"dpstack: {tmp_path}/none.gsd: No such file or directory; give the path of a GSD file\n"
    )
    assert "no GSD file: no line #Profibus_DP" in cli.err("gsd", command, __file__)


@pytest.mark.parametrize("command", ["show", "check"])
def test_a_name_that_is_nearly_one(command: str, cli: Cli) -> None:
    assert cli.err("gsd", command, "io-sttion") == (
        "dpstack: io-sttion: No such file or directory; did you mean io-station, or give the path of a GSD file?\n"
    )


def test_alarms_are_shown_by_their_names_in_a_configuration(cli: Cli) -> None:
    assert "pull_plug, process, diagnostic, update; one of each at a time or 8 in all" in cli.out(
        "gsd", "show", "io-station"
    )
    shown = cli.json("gsd", "show", "io-station")
    assert shown["alarms"] == ["pull_plug", "process", "diagnostic", "update"]
    assert (shown["alarms_required"], shown["alarm_sequence"]) == ([], 8)


Configure = Callable[..., tuple[str, str]]


@pytest.fixture
def configure(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> Configure:
    """``gsd configure FILE``: standard output and standard error after these answers."""

    def answered(path: str, answers: str, *more: str, code: int = 0) -> tuple[str, str]:
        monkeypatch.setattr("sys.stdin", io.StringIO(answers))
        return cli("gsd", "configure", path, *more, code=code)

    return answered


BUS = '[bus]\nport = "virtual"\nbaud = 500000\n'


def test_configure(configure: Configure) -> None:
    out, err = configure(WHOLE, "valves\n126\n8\nn\n8 DI\n9 DO\n2\n-\n\ny\noff\n2000\n33\n")
    assert out.splitlines() == [
        "[[slave]]",
        'name = "valves"',
        "address = 8",
        f'gsd = "{WHOLE}"',
        'modules = ["8 DI", "8 DO", ""]',
        'parameters = { "Diagnosis" = "off", "Delay" = 33 }',
        "# identifier octets 10 20 00: 1 octets of inputs, 1 of outputs",
        "# user parameters 80 00 00 00 00 01 00 21",
        '# slot 1 "8 DI": inputs 0, 8 channels',
        '# slot 2 "8 DO": outputs 0, 8 channels',
        "# names for the channels, proposed: take away the # of the tables and names that you want",
        "# [slave.inputs]",
        f"# slot1 = {_bits(0)}",
        "# [slave.outputs]",
        f"# slot2 = {_bits(0)}",
    ]
    for told in ("'126' is no station address", "there is no module '9 DO'", "'Delay' = 2000 is not allowed"):
        assert told in err
    slave = parse_config(BUS + out, "plant.toml").slaves[0]
    assert (slave.params.config.hex(), slave.params.user_prm.hex()) == ("102000", "8000000000010021")


def _bits(octet: int) -> str:
    return "[" + ", ".join(f'"bool@{octet}.{bit}"' for bit in range(8)) + "]"


def test_proposed_names_are_taken_or_only_their_marks_taken_away(configure: Configure) -> None:
    answers = "rack\n8\n8 DI\n2 AI\n-\n16 DO\ndone\nn\n"
    out, err = configure("io-station", f"{answers}y\n")
    assert '  slot 2 "2 AI": inputs 1 to 4, 2 channels\n' in err
    assert (
        "names for the channels (slot1_0, slot1_1, slot1_2, slot1_3, slot1_4, slot1_5 and 20 more), y or n [n]: " in err
    )
    taken = parse_config(BUS + out, "plant.toml").slaves[0]
    inputs, outputs = taken.input_fields.fields, taken.output_fields.fields
    assert [(name, inputs[name].spec) for name in list(inputs)[7:]] == [
        ("slot1_7", "bool@0.7"),
        ("slot2_ai0", "i16@1"),
        ("slot2_ai1", "i16@3"),
    ]
    assert list(outputs) == [f"slot4_{number}" for number in range(16)]
    assert outputs["slot4_15"].spec == "bool@1.7"
    out, _ = configure("io-station", answers)
    left = parse_config(BUS + out, "plant.toml").slaves[0]
    assert (len(left.input_fields), len(left.output_fields)) == (0, 0)
    head, names = out.split("# names for the channels, ")
    again = parse_config(BUS + head + "# " + names.replace("\n# ", "\n"), "plant.toml").slaves[0]
    assert (again.input_fields, again.output_fields) == (taken.input_fields, taken.output_fields)


@pytest.mark.parametrize(
    ("name", "answers", "config", "modules"),
    [
        ("whole", "\n3\n\n\n", "20", '["8 DO"]'),
        ("equal_names", "r\n4\nReserve\n2\n1\ntwin\n", "201000", '[2, 1, "Twin"]'),
        ("prm_old", "old\n6\ny\n", "1323", '["fixed"]'),
    ],
)
def test_its_tables_are_accepted(name: str, answers: str, config: str, modules: str, configure: Configure) -> None:
    out, _ = configure(str(FILES / f"{name}.gsd"), answers)
    assert parse_config(BUS + out, "plant.toml").slaves[0].params.config.hex() == config
    assert f"modules = {modules}\n" in out


def test_texts_outside_of_the_range_are_not_offered(configure: Configure, cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "texts.gsd"
    path.write_text(
        "#Profibus_DP\nIdent_Number = 0x0FFE\n500_supp = 1\n"
        'Module = "in" 0x10\nEndModule\n'
        'PrmText = 1\nText(0) = "one"\nText(1) = "two"\nText(3) = "three"\nEndPrmText\n'
        'ExtUserPrmData = 1 "Mode"\nUnsigned8 1 0-2\nPrm_Text_Ref = 1\nEndExtUserPrmData\n'
        "Ext_User_Prm_Data_Ref(0) = 1\n"
    )
    out, err = configure(str(path), "\n8\ny\ny\nthree\none\n")
    assert 'parameters = { "Mode" = "one" }\n' in out
    assert "0/Mode@0 (one, two) [two]: " in err
    assert "'Mode' has no value 'three'; known: 'one', 'two'" in err
    assert "three" not in cli.out("gsd", "show", str(path))


def test_slots_refuse_at_once(configure: Configure) -> None:
    out, err = configure(str(FILES / "slots.gsd"), "s\n5\nn\n1\n4\n5\n2\n\n")
    assert "is not allowed in slot 2 (signals); allowed references: 2..3, 5" in err
    assert "4 octets of outputs, the device has at most 2" in err
    assert parse_config(BUS + out, "plant.toml").slaves[0].params.config.hex() == "0011"


def test_answers_that_end_too_early(configure: Configure) -> None:
    out, err = configure(WHOLE, "valves\n", code=2)
    assert out == ""
    assert err.endswith("the answers ended before the table was complete; nothing was written\n")


def test_the_files_of_bundled_drives_by_name(cli: Cli, tmp_path: Path) -> None:
    assert cli.json("gsd", "show", "demag-dedrive")["ident"] == "0x0696"
    cli("gsd", "check", "demag-dedrive", "keb-f5", "io-station")
    target = tmp_path / "hoist.gsd"
    cli("gsd", "copy", "demag-dedrive", str(target))
    assert target.read_bytes().startswith(b"#Profibus_DP")
    assert main(["gsd", "copy", "demag-dedrive", str(target)]) == 2
    assert cli.err("gsd", "copy", "fuji-frenic", str(target)) == (
        f"dpstack: {target}: there is a file of that name; give the name of a new file\n"
        "dpstack: no GSD file was written for 'fuji-frenic'; there is one for demag-dedrive, keb-f5, ls-s100, "
        "io-station\n"
    )


# --- show ------------------------------------------------------------------------------------------------------------


@pytest.fixture(name="small")
def small_file(tmp_path: Path) -> str:
    (tmp_path / "small.gsd").write_bytes(octets("rack"))
    return str(tmp_path / "small.gsd")


def test_show_has_slots_presets_diagnoses_and_whose_parameters_they_are(small: str, cli: Cli) -> None:
    shown = cli.json("gsd", "show", small)
    assert shown["slots"] == [{"number": 2, "name": "head", "default": 11, "allowed": [[11, 11]]}]
    assert (shown["first_slot"], shown["fix_preset_modules"]) == (2, True)
    assert shown["presets"] == [{"name": "HEAD 7", "reference": 11}]
    assert shown["device_parameters"] == [{"number": 5, "name": "Filter", "offset": 1}]
    assert shown["diagnosis"] == [
        {"kind": "bit", "first": 3, "last": 3, "value": 1, "text": "fuse blown", "help": "replace it"},
        {"kind": "area", "first": 8, "last": 11, "value": 2, "text": "too hot", "help": ""},
    ]
    assert shown["diagnosis_types"] == [
        {
            "type": 129,
            "diagnosis": [{"kind": "not_bit", "first": 24, "last": 24, "value": 0, "text": "no supply", "help": ""}],
        }
    ]
    di, head, _ = shown["modules"]
    assert di["parameters"] == [
        {"number": 6, "name": "[SlotNumber]", "offset": 0},
        {"number": 5, "name": "Filter", "offset": 1},
    ]
    assert di["diagnosis"] == [
        {"kind": "channel", "first": None, "last": None, "value": 17, "text": "wire torn", "help": ""}
    ]
    assert (di["user_prm"], di["preset"], head["preset"], di["info"]) == ("0103", False, True, "sixteen inputs")


def test_show_tells_them_to_people(small: str, cli: Cli) -> None:
    lines = [" ".join(line.split()) for line in cli.out("gsd", "show", small).splitlines()]
    for line in (
        "fixed presets HEAD 7",
        "parameters 5",
        "Slots that SlotDefinition lists (the first slot is 2)",
        "2 head 11 11",
        "10 6ES7 321-1BH00-0AA0 16DI 11 2 0 01 03 5..6",
        "5 Filter Unsigned8 reserved off, on, reserved, reserved device, 6ES7 321-1BH00-0AA0 16DI",
        "bit 3 fuse blown replace it",
        "bits 8..11 = 2 too hot",
        "UnitDiagType 129 bit 24 is 0 no supply",
        "6ES7 321-1BH00-0AA0 16DI channel error 17 wire torn",
    ):
        assert line in lines


# --- check -----------------------------------------------------------------------------------------------------------


def test_check_of_a_directory_ends_with_a_summary(small: str, tmp_path: Path, cli: Cli) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "CUT.GSE").write_bytes(b'#Profibus_DP\nIdent_Number = 1\n500_supp = 1\nModule = "x" 0x10\n')
    (inner / "warned.gsg").write_bytes(b"#Profibus_DP\nIdent_Number = 1\n")
    (inner / "notes.txt").write_bytes(b"nothing")
    out = cli.out("gsd", "check", str(tmp_path), code=1).splitlines()
    assert out[0].startswith(f"{inner}/CUT.GSE:4:1: error: Module 'x' never ends")
    assert out[1].startswith(f"{inner}/warned.gsg:1:1: warning: no baud rate is declared")
    assert out[2:] == ["3 files: 1 without a finding, 1 with warnings, 1 damaged"]
    *files, summary = cli.jsons("gsd", "check", str(tmp_path), code=1)
    assert [file["file"] for file in files] == [f"{inner}/CUT.GSE", f"{inner}/warned.gsg", small]
    assert summary == {
        "event": "summary",
        "files": 3,
        "sound": 1,
        "info": 0,
        "warning": 1,
        "damaged": 1,
        "unreadable": 0,
    }
    (inner / "CUT.GSE").unlink()
    cli("gsd", "check", str(inner))


def test_check_of_a_directory_goes_on_after_a_file_that_cannot_be_read(
    small: str, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = check_gsd

    def refused(path: str) -> tuple[Diagnostic, ...]:
        if path.endswith("a.gsd"):
            raise ConfigError(f"{path}: Permission denied; give the path of a GSD file")
        return whole(path)

    (tmp_path / "a.gsd").touch()
    monkeypatch.setattr("dpstack.cli.commands.gsd.check_gsd", refused)
    assert cli.out("gsd", "check", str(tmp_path), code=1).splitlines() == [
        f"{tmp_path}/a.gsd: Permission denied; give the path of a GSD file",
        "2 files: 1 without a finding, 1 unreadable",
    ]


def test_check_of_a_directory_goes_on_after_a_folder_that_vanishes(
    small: str, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gone").mkdir()
    scandir = os.scandir

    def vanishing(path: str | Path) -> object:
        if os.path.basename(path) == "gone":
            os.rmdir(path)
        return scandir(path)

    monkeypatch.setattr(os, "scandir", vanishing)
    assert cli.out("gsd", "check", str(tmp_path)) == "1 file: 1 without a finding\n"
    assert not (tmp_path / "gone").exists()


def test_check_of_a_directory_without_gsd_files(tmp_path: Path, cli: Cli) -> None:
    assert "no GSD file (.gsd, .gse, .gsg ...) is in this directory" in cli.err("gsd", "check", str(tmp_path))


# --- names -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wanted", "hint"),
    [
        ("321-1BH00", "nearest are '6ES7 321-1BH00-0AA0 16DI'"),
        ("1bh00", "nearest are '6ES7 321-1BH00-0AA0 16DI', '6ES7 322-1BH00-0AA0 16DO'"),
        ("321 16DI", "nearest are '6ES7 321-1BH00-0AA0 16DI'"),
        ("6ES7322-1BH00", "nearest are '6ES7 322-1BH00-0AA0 16DO'"),
    ],
)
def test_hints_find_parts_of_names(wanted: str, hint: str) -> None:
    rack = device("rack")
    with pytest.raises(GsdError) as caught:
        find_module(rack, wanted)
    assert str(caught.value).startswith(f"there is no module {wanted!r}; {hint}")
    with pytest.raises(GsdError, match=r"no parameter 'ilte'; nearest are 'Filter'"):
        plug(rack, []).user_prm().set("ilte", 1)


# --- configure -------------------------------------------------------------------------------------------------------


def test_configure_puts_modules_behind_the_fixed_presets(small: str, configure: Configure) -> None:
    out, err = configure(small, "\n8\n/321\n6ES7 321-1BH00-0AA0 16DI\n12\ndone\n")
    assert 'name = "rack-9-8"\n' in out
    assert 'modules = ["HEAD 7", "6ES7 321-1BH00-0AA0 16DI", "6ES7 322-1BH00-0AA0 16DO"]\n' in out
    assert "# identifier octets 00 11 21: 2 octets of inputs, 2 of outputs\n" in out
    assert "# user parameters 00 03 03 03\n" in out
    assert "fixed presets, always plugged: slot 2 HEAD 7\n" in err
    assert err.count("    10  6ES7 321-1BH00-0AA0 16DI  (11)\n") == 2  # all, then found
    assert err.count("    12  6ES7 322-1BH00-0AA0 16DO  (21)\n") == 1
    assert "[SlotNumber]" not in err
    assert parse_config(BUS + out, "plant.toml").slaves[0].params.config.hex() == "001121"


def test_configure_takes_the_beginning_of_a_name_and_goes_back(configure: Configure) -> None:
    out, err = configure(WHOLE, "valves\n8\nn\nback\n8di\n8 D\n8d\n-\nback\nback\n8do\n8DI\n\n")
    assert 'modules = ["8 DO", "8 DI"]\n' in out
    assert "this is the first slot that can be chosen" in err
    assert err.count("2 modules begin with '8") == 2
    assert "begin with '8 D': 8 DI, 8 DO; type more of the name" in err
    assert err.count("slot 1: ") == 3
    assert err.count("  8 DI\n") == 2  # the name in full


def test_configure_goes_back_to_the_fixed_presets_only(small: str, configure: Configure) -> None:
    out, err = configure(small, "\n8\nback\n10\nback\n12\ndone\n")
    assert 'modules = ["HEAD 7", "6ES7 322-1BH00-0AA0 16DO"]\n' in out
    assert err.count("this is the first slot that can be chosen") == 1


def test_a_preset_that_is_not_fixed_is_taken_and_more_behind_it(configure: Configure) -> None:
    assert 'modules = ["8 DO", "8 DI"]\n' in configure(WHOLE, "valves\n8\ny\n8 DI\n\n")[0]


@pytest.mark.parametrize("answers", ["\n8\n", "\n8", "\n8\ny", "\n8\ny\n\n"])
def test_the_end_of_input_keeps_the_defaults(answers: str, configure: Configure) -> None:
    assert configure(WHOLE, answers)[0].startswith(
        f'[[slave]]\nname = "terminal-8-8"\naddress = 8\ngsd = "{WHOLE}"\nmodules = ["8 DO"]\n# identifier'
    )


def test_the_end_of_input_among_the_parameters_keeps_the_others(configure: Configure) -> None:
    assert 'parameters = { "Diagnosis" = "off" }\n' in configure(WHOLE, "v\n8\nn\n8 DI\ndone\ny\noff\n")[0]
    assert 'parameters = { "Diagnosis" = "off" }\n' in configure(WHOLE, "v\n8\nn\n8 DI\ndone\ny\noff\ndone\n")[0]


def test_the_end_of_input_where_no_module_is_chosen(configure: Configure) -> None:
    out, err = configure(WHOLE, "v\n8\nn\n", code=2)
    assert out == ""
    assert "no module is chosen yet" in err


def test_a_text_that_stands_for_two_values_is_written_as_its_number(small: str, configure: Configure) -> None:
    out, err = configure(small, "v\n8\n10\ndone\ny\n\n2\n")
    assert 'parameters = { "3/Filter@1" = 2 }\n' in out  # the device keeps its 3, the other "reserved"
    assert "(off, on, reserved, reserved) [reserved]" in err
    assert parse_config(BUS + out, "plant.toml").slaves[0].params.user_prm.hex() == "0003" + "0302"


def test_configure_for_a_configuration(
    small: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, configure: Configure
) -> None:
    folder = tmp_path / "plant"
    folder.mkdir()
    plant = folder / "plant.toml"
    monkeypatch.chdir(tmp_path)
    first = configure("small.gsd", "valves\n8\n", "--config", str(plant))[0]
    assert 'gsd = "../small.gsd"\n' in first
    plant.write_text(BUS + first, encoding="utf-8")
    second, err = configure("small.gsd", "valves\nrack\n8\n2\n9\n", "--config", str(plant))
    assert "the configuration has a slave 'valves' already; type another name" in err
    assert "address 8 is taken in the configuration (valves)" in err
    assert "address 2 is taken in the configuration (the master)" in err
    plant.write_text(BUS + first + second, encoding="utf-8")
    assert [slave.name for slave in load_config(str(plant)).slaves] == ["valves", "rack"]


PROGRAM = """
from dpstack.slave import DpSlave, SlaveDescription

TYPE = SlaveDescription.simple(0x4711, inputs=2, outputs=1, name="tank", dpv1=True)
SLAVE = DpSlave(TYPE, lambda outputs, elapsed: bytes(2))

class Tank(DpSlave):
    def __init__(self):
        super().__init__(TYPE, lambda outputs, elapsed: bytes(2))

def broken():
    raise ValueError("no")
"""


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli) -> None:
    (tmp_path / "own_tank.py").write_text(PROGRAM, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in ("own_tank:TYPE", "own_tank.py:SLAVE", "own_tank:Tank"):
        cli.out("gsd", "write", name, "tank.gsd", *(["--force"] if name != "own_tank:TYPE" else []))
        shown = cli.json("gsd", "show", "tank.gsd")
        assert (shown["ident"], shown["model"]) == ("0x4711", "tank")
        assert cli.out("gsd", "check", "tank.gsd")
    before = (tmp_path / "tank.gsd").read_bytes()
    assert "there is a file of that name" in cli.err("gsd", "write", "own_tank:TYPE", "tank.gsd")
    assert (tmp_path / "tank.gsd").read_bytes() == before
    for name, says in (
        ("own_tank", "names no slave; write MODULE:NAME"),
        ("own_tank:NONE", "own_tank has no description 'NONE'"),
        ("own_tonk:TYPE", "'own_tonk:TYPE' cannot be loaded (ModuleNotFoundError"),
        ("own_tank:broken", "cannot be made without arguments (ValueError: no)"),
        ("math:pi", "math:pi is a float; name a SlaveDescription or a DpSlave"),
    ):
        assert says in cli.err("gsd", "write", name, "other.gsd")
    assert not (tmp_path / "other.gsd").exists()


IO = {
    "name": "io", "address": 8, "gsd": FILES / "whole.gsd", "modules": ["8 DO", "8 DI"],
    "parameters": {"Diagnosis": "off"}, "sync": True,
}  # fmt: skip


@pytest.fixture
def bus(tmp_path: Path, start: Starter) -> Path:
    """A segment of two with simulated slaves on port 0; ``plant.toml`` beside it is for port 1."""
    folder = tmp_path / "bus"
    start.segment(folder)
    both = plant_file(tmp_path, IO, {**RAW, "address": 20})
    start("sim", str(both), "--port", str(folder / "0")).wait_for("raw")
    plant_file(tmp_path, IO, port=folder / "1")
    return folder


def test_run_and_address_against_simulated_slaves(bus: Path, capsys: pytest.CaptureFixture[str], cli: Cli) -> None:
    plant, port = str(bus.parent / "plant.toml"), str(bus / "1")

    def address(old: int, new: int) -> tuple[int, str, str]:
        """Exit code, standard output and standard error. A busy computer may keep the slave from answering in time."""
        end = time.monotonic() + HANG_S
        while True:
            code = main(["address", str(old), str(new), "--port", port, "--baud", "500000"])
            out, err = capsys.readouterr()
            if "does not answer Slave_Diag" not in err or time.monotonic() > end:
                return code, out, err

    assert address(20, 9) == (0, "slave 20 has address 9 now: ident 0x1234, verified there\n", "")
    code, _, err = address(8, 10)
    assert code == 1  # Set_Slave_Add_supp = 0
    assert "Set_Slave_Add" in err

    summary = cli.json("run", plant, "--rotations", "50", "--outputs", "8=5A")
    assert summary["slaves"]["8"]["state"] == "data_exchange"
    assert summary["slaves"]["8"]["inputs"] == "5a"
