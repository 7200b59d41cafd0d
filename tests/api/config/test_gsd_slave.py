"""[[slave]] tables with a GSD file: the parameters by the file, notes and refusals."""

from __future__ import annotations

from pathlib import Path

import pytest
from api_kit import RAW, bus_of, slave_in
from gsd_kit import FILES
from support import present

import dpstack
from dpstack import UsageError
from dpstack.api.config.config import Config, parse_config, rate_findings
from dpstack.cli.main import main
from dpstack.dp.pdu.diag_blocks import UserDiag, channel_block, device_block
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import ConfigError

pytestmark = pytest.mark.virtual_time

HEAD = '[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\nname = "io"\naddress = 8\n'


def config(keys: str, name: str = "plant.toml") -> Config:
    return parse_config(HEAD + keys, str(FILES / name))


def test_the_parameters_by_the_file() -> None:
    found = config('gsd = "whole.gsd"\nmodules = ["8 DI", 2]\nparameters = { "Diagnosis" = "off", Delay = 100 }\n')
    slave = found.slaves[0]
    assert (slave.params.ident, slave.params.config.hex(" ")) == (0x1A2B, "10 20")
    assert slave.params.user_prm.hex(" ") == "80 00 00 00 00 01 00 64"
    assert (slave.params.input_len, slave.params.output_len) == (1, 1)
    assert (slave.params.min_slave_interval_ns, slave.params.fail_safe) == (600_000, True)
    assert (slave.params.max_tsdr[12_000_000], slave.params.max_tsdr.get(19_200)) == (800, None)
    assert [found.text for found in present(slave.params.texts).unit_diag_texts(b"\x01")] == ["fuse blown"]
    assert rate_findings(found, 500_000) == []
    known = "it knows 9.6 kbit/s, 45.45 kbit/s, 500 kbit/s, 12 Mbit/s"
    assert rate_findings(found, 19_200) == [f"slave 8 (io): by its GSD file it does not know 19.2 kbit/s; {known}"]


def test_both_readings_and_the_note() -> None:
    keys = 'gsd = "prm.gsd"\nmodules = ["AI"]\n'
    refs = config(keys).slaves[0]
    assert refs.params.user_prm.hex(" ") == "c0 00 00 d7 11 5f ff fe 00 00 00"
    assert refs.notes == (
        "slave 8 (io): in its GSD file the defaults of 3 parameters contradict the constant octets (the first: "
        "0/Diagnosis@3.3: its default is 0 (off), the constant octets say 1 (on)); the defaults are used, "
        'defaults = "const" takes the constants',
    )
    assert refs.params.prm_note == (
        "in its GSD file defaults and constants contradict each other (octets 11, 13, 14, 15 of Set_Prm): the defaults "
        'were sent, defaults = "const" sends the constants, as some devices need it'
    )
    const = config(keys + 'defaults = "const"\n').slaves[0]
    assert const.params.prm_note.endswith(
        'the constants were sent, defaults = "refs" sends the defaults, as some devices need it'
    )
    assert (const.params.user_prm.hex(" "), const.notes) == ("c0 00 00 ff 11 0f 00 05 00 00 00", ())
    assert config(keys + 'defaults = "refs"\n').slaves[0].notes == ()
    chosen = '"Diagnosis" = "off", "0/Range" = 5, "Offset" = 5'
    assert config(keys + f"parameters = {{ {chosen} }}\n").slaves[0].notes == ()
    (note,) = config(keys + 'parameters = { "Diagnosis" = "off" }\n').slaves[0].notes
    assert "the defaults of 2 parameters contradict the constant octets (the first: 0/Range@3.4" in note


def test_user_prm_in_place_of_the_files() -> None:
    slave = config('gsd = "prm.gsd"\nmodules = ["PLAIN"]\nuser_prm = "01 02 03 04 05"\n').slaves[0]
    assert slave.params.user_prm == bytes((1, 2, 3, 4, 5))
    assert slave.params.prm_note == ""


def test_the_preset_modules_of_the_file() -> None:
    assert config('gsd = "slots.gsd"\n').slaves[0].params.config == b"\x00\x11\x21"


def test_an_absolute_path(tmp_path: Path) -> None:
    text = HEAD + f'gsd = "{FILES / "slots.gsd"}"\n'
    assert parse_config(text, str(tmp_path / "plant.toml")).slaves[0].params.ident == 0x0FFE


@pytest.mark.parametrize(
    ("gsd", "keys", "says"),
    [
        ("none.gsd", "", "{files}/none.gsd: No such file or directory; give the path of a"),
        ("../test_constructs.py", "", "{files}/../test_constructs.py:1: no GSD file: no line"),
        ("whole.gsd", 'modules = ["8 DY"]', "there is no module '8 DY'; nearest are '8 DO'"),
        ("whole.gsd", 'modules = "8 DI"', "modules = '8 DI' is no list of names and numbers"),
        ("equal_names.gsd", "", "the device has 4 modules to choose from; name those "),
        (
            "prm.gsd",
            'modules = [1]\nparameters = { "Ofset" = 3 }',
            "there is no parameter 'Ofset'; nearest are 'Offset'",
        ),
        (
            "prm.gsd",
            "modules = [1]\nparameters = { Offset = 1000 }",
            "'Offset' = 1000 is not allowed; allowed are -100..100",
        ),
        (
            "prm.gsd",
            "modules = [1]\nparameters = { Offset = 1.5 }",
            "parameter 'Offset' = 1.5; give a number or a text of its list",
        ),
        ("prm.gsd", 'modules = [1]\ndefaults = "both"', 'unknown defaults \'both\'; it must be "refs" or "const"'),
        ("whole.gsd", 'config = "10"', "config beside gsd; leave config out, or gsd"),
        ("whole.gsd", "options = { a = 1 }", "options without drive; add drive, or leave "),
        ("slots.gsd", "sync = true", "sync = true, but its GSD file says Sync_Mode_supp = 0; leave sync out"),
        ("slots.gsd", "freeze = true", "freeze = true, but its GSD file says Freeze_Mode_supp = 0; leave freeze out"),
        (
            "slots.gsd",
            "wd_base_1ms = true",
            "wd_base_1ms = true, but its GSD file says WD_Base_1ms_supp = 0; leave wd_base_1ms out",
        ),
    ],
)
def test_refused(gsd: str, keys: str, says: str) -> None:
    line = 7 + len(keys.splitlines())  # the last one
    with pytest.raises(ConfigError) as caught:
        config(f'gsd = "{gsd}"\n{keys}\n')
    assert str(caught.value).startswith(f"{FILES}/plant.toml:{line}: [[slave]] io: {says.format(files=FILES)}")


def test_dpv1_status_follows_from_the_file() -> None:
    keys = 'gsd = "whole.gsd"\nmodules = ["8 DO"]\n'
    setup = config(keys + "watchdog_ms = 25\n").slaves[0].params
    watchdog = present(setup.watchdog(100))
    assert (watchdog.factors, watchdog.base_ms) == ((1, 25), 1)
    assert setup.user_octets(watchdog).hex(" ") == "c4 40 00 08 00"  # DPV1_Enable, Fail_Safe, WD_Base_1ms
    coarse = config(keys + "watchdog_ms = 20\nfail_safe = false\nwd_base_1ms = false\n").slaves[0].params
    assert coarse.user_octets(coarse.watchdog(100)).hex(" ") == "80 40 00 08 00"  # Process_Alarm_required


def test_fail_safe_required_cannot_be_left_out(tmp_path: Path) -> None:
    text = (FILES / "whole.gsd").read_text(encoding="utf-8").replace("Fail_Safe = 1", "Fail_Safe_required = 1")
    (tmp_path / "required.gsd").write_text(text, encoding="utf-8")
    keys = 'gsd = "required.gsd"\nmodules = ["8 DO"]\n'
    setup = parse_config(HEAD + keys, str(tmp_path / "plant.toml")).slaves[0].params
    assert (setup.fail_safe, setup.user_octets(None)[0]) == (True, 0xC0)
    with pytest.raises(
        ConfigError, match=r"9: \[\[slave\]\] io: fail_safe = false, but its GSD file says Fail_Safe_req"
    ):
        parse_config(HEAD + keys + "fail_safe = false\n", str(tmp_path / "plant.toml"))


def test_bus_parameters_fit_the_slowest_slave() -> None:
    slow = config('gsd = "whole.gsd"\nmodules = ["8 DO"]\n')
    assert slow.params(12_000_000).t_sl == 1000  # the table's: MaxTsdr 800
    assert slow.params(45_450).t_sl > 250


async def test_a_slave_by_its_gsd_file_on_a_bus() -> None:
    table = {"name": "io", "address": 8, "gsd": str(FILES / "whole.gsd"), "modules": ["8 DO", "8 DI"]}
    async with bus_of(table) as bus:
        await bus.operate()
        slave = bus.slave("io")
        await slave.ready()
        slave.outputs = b"\x5a"
        await bus.rotated(10)
        assert (slave.state.value, slave.inputs) == ("data_exchange", b"\x5a")


SAFE = (
    "#Profibus_DP\nGSD_Revision = 5\nIdent_Number = 0x0FFE\n500_supp = 1\nModular_Station = 1\nMax_Module = 3\n"
    'FixPresetModules = 1\nModule = "F-DI" 0x11\n5\nPreset = 1\nF_ParamDescCRC = 0x1234\nEndModule\n'
    'Module = "8 DI" 0x10\n6\nEndModule\n'
)


def test_plan_and_run_print_the_note_about_profisafe(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "safe.gsd").write_text(SAFE, encoding="utf-8")
    plant = tmp_path / "plant.toml"
    plant.write_text(HEAD + 'gsd = "safe.gsd"\nmodules = ["8 DI"]\n', encoding="utf-8")
    note = "slave 8 (io): module 'F-DI' (reference 5) in slot 1 has F_ parameters (PROFIsafe), but dpstack is no F-host"
    assert main(["plan", str(plant)]) == 0
    assert note in capsys.readouterr().out
    assert main(["run", str(plant), "--rotations", "10", "--json"]) == 0
    out = capsys.readouterr().out
    assert note in out
    assert '"state":"data_exchange"' in out


# --- user parameters whose length contradicts the file ----------------------------------------------------------------
#: a compact station whose constants are longer than its own maximum
NARROW = (
    "#Profibus_DP\nGSD_Revision = 3\nIdent_Number = 0x0FFE\n500_supp = 1\nMax_User_Prm_Data_Len = 3\n"
    'Ext_User_Prm_Data_Const(0) = 1,2,3,4,5\nModule = "in" 0x10\nEndModule\n'
)
REFUSE = "; the device may refuse them (Prm_Fault): then give the octets that its manual wants as user_prm"


def compact(folder: Path, gsd: str, keys: str = "") -> Config:
    (folder / "own.gsd").write_text(gsd, encoding="utf-8")
    return parse_config(HEAD + 'gsd = "own.gsd"\n' + keys, str(folder / "plant.toml"))


@pytest.mark.parametrize(
    ("keys", "octets", "notes"),
    [
        ("", "0102030405", ("slave 8 (io): 5 octets of user parameters, Max_User_Prm_Data_Len is 3" + REFUSE,)),
        (
            'user_prm = "09 08 07 06"\n',
            "09080706",
            (
                "slave 8 (io): user_prm has 4 octets, with these modules its GSD file makes 5, Max_User_Prm_Data_Len "
                "is 3" + REFUSE,
            ),
        ),
        (
            'user_prm = "09 08 07"\n',
            "090807",
            ("slave 8 (io): user_prm has 3 octets, with these modules its GSD file makes 5" + REFUSE,),
        ),
    ],
)
def test_user_prm_overrides_what_the_file_makes(tmp_path: Path, keys: str, octets: str, notes: tuple[str, ...]) -> None:
    found = compact(tmp_path, NARROW, keys).slaves[0]
    assert (found.params.user_prm.hex(), found.notes) == (octets, notes)


def test_user_prm_overrides_what_no_set_prm_can_carry(tmp_path: Path) -> None:
    long = NARROW.replace("Max_User_Prm_Data_Len = 3\n", "")
    long = long.replace("EndModule", "Ext_Module_Prm_Data_Len = 237\nEndModule")
    with pytest.raises(ConfigError, match="242 octets of user parameters; a Set_Prm carries 237: take out modules, "):
        compact(tmp_path, long)
    assert compact(tmp_path, long, 'user_prm = "01"\n').slaves[0].params.user_prm == b"\x01"


def test_plan_prints_both_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gsd = NARROW.replace("Max_User_Prm_Data_Len = 3", "User_Prm_Data_Len = 4\nUser_Prm_Data = 1,2,3,4")
    compact(tmp_path, gsd)
    (tmp_path / "plant.toml").write_text(HEAD + 'gsd = "own.gsd"\n', encoding="utf-8")
    main(["plan", str(tmp_path / "plant.toml")])
    assert "5 octets of user parameters, User_Prm_Data_Len is 4" in " ".join(capsys.readouterr().out.split())


async def test_the_simulated_slave_accepts_a_user_prm_of_its_own() -> None:
    table = {"address": 8, "gsd": str(FILES / "prm.gsd"), "modules": ["PLAIN"], "user_prm": "01 02"}
    async with bus_of(table) as bus:
        await bus.operate()
        await bus.slave(8).ready()
        assert bus.slave(8).state.value == "data_exchange"


# --- DP-V1 of a file without octets -----------------------------------------------------------------------------------
SILENT = (
    "#Profibus_DP\nGSD_Revision = 3\nIdent_Number = 0x0FFE\n500_supp = 1\nDPV1_Slave = 1\nC1_Read_Write_supp = 1\n"
    'C1_Max_Data_Len = 64\nC1_Response_Timeout = 10\nModule = "in" 0x10\nEndModule\n'
)


def test_dpv1_is_on_where_the_file_has_room_for_its_octets(tmp_path: Path) -> None:
    found = compact(tmp_path, SILENT).slaves[0]
    assert (found.params.user_octets(None).hex(" "), found.notes) == ("80 00 00", ())
    assert present(found.description).user_prm_len == (3, 3)


def test_where_it_has_none_the_advice_names_all_keys_and_is_accepted(tmp_path: Path) -> None:
    narrow = SILENT + "Max_User_Prm_Data_Len = 0\n"
    found = compact(tmp_path, narrow).slaves[0]
    (note,) = found.notes
    assert (found.params.dpv1, found.params.user_prm) == (None, b"")
    assert note.endswith('if the device has them, give user_prm = "00 00 00" and dpv1 = true')
    assert compact(tmp_path, narrow, "dpv1 = false\n").slaves[0].notes == ()
    followed = compact(tmp_path, narrow, 'user_prm = "00 00 00"\ndpv1 = true\n').slaves[0]
    assert followed.params.user_octets(None).hex(" ") == "80 00 00"
    (note,) = followed.notes
    assert "user_prm has 3 octets, Max_User_Prm_Data_Len is 0" in note


def test_a_compact_station_without_modules_has_all_of_them(tmp_path: Path) -> None:
    several = SILENT + 'Module = "more" 0x20\nEndModule\n'
    assert compact(tmp_path, several).slaves[0].params.config == b"\x10\x20"


# --- Notes about requirements of a GSD file that a configuration switches off; services that the file excludes ------


GSD = """#Profibus_DP
GSD_Revision = 5
Model_Name = "rig"
Ident_Number = 0x1234
500_supp = 1
MaxTsdr_500 = 100
Max_Diag_Data_Len = 64
User_Prm_Data_Len = 3
User_Prm_Data = 0x00,0x00,0x00
DPV1_Slave = 1
C1_Read_Write_supp = 1
C1_Max_Data_Len = 64
C1_Response_Timeout = 100
Process_Alarm_supp = 1
Unit_Diag_Bit(0) = "fuse blown"
Channel_Diag(17) = "sensor missing"
Module = "io" 0x20, 0x10
EndModule
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "rig.gsd").write_text(GSD, encoding="ascii")
    return tmp_path


def notes(folder: Path, keywords: str, keys: str) -> list[str]:
    """The notes about slave 8, whose GSD file has the ``keywords`` too."""
    (folder / "rig.gsd").write_text(GSD.replace("Module =", f"{keywords}\nModule =", 1), encoding="ascii")
    table = f'[[slave]]\nname = "rig"\naddress = 8\ngsd = "rig.gsd"\n{keys}\n'
    config = parse_config(f'[bus]\nport = "virtual"\nbaud = 500000\n{table}', str(folder / "plant.toml"))
    bus = dpstack.open_bus(config)
    return [note.removeprefix("slave 8 (rig): ") for note in bus.plan.notes if note.startswith("slave 8 (rig): ")]


EXTRA = (
    "extra_alarm_sap = true, but its GSD file does not say Extra_Alarm_SAP_supp = 1: alarms are acknowledged at SAP 50"
)


@pytest.mark.parametrize(
    ("keywords", "keys", "text"),
    [
        (
            "C1_Read_Write_required = 1",
            "dpv1 = false",
            "C1_Read_Write_required = 1: it counts on Read and Write; leave dpv1",
        ),
        (
            "Process_Alarm_required = 1",
            "dpv1 = false",
            "says Process_Alarm_required = 1: it raises no alarms now; leave dpv1",
        ),
        ("", "dpv1 = { extra_alarm_sap = true }", EXTRA),
        (
            "Isochron_Mode_required = 1",
            "",
            "demands isochronous mode (its GSD file says Isochron_Mode_required = 1)",
        ),
    ],
)
def test_requirements_that_the_configuration_switches_off_get_a_note(
    folder: Path, keywords: str, keys: str, text: str
) -> None:
    (note,) = notes(folder, keywords, keys)
    assert text in note


@pytest.mark.parametrize(
    ("keywords", "keys"),
    [
        ("C1_Read_Write_required = 1\nProcess_Alarm_required = 1", ""),
        ("C1_Read_Write_required = 1", "dpv1 = true"),
        ("", "dpv1 = false"),
        ("C2_Read_Write_supp = 1\nC2_Read_Write_required = 1", "dpv1 = false"),  # class 2 is no matter of this master
        ("Extra_Alarm_SAP_supp = 1", "dpv1 = { extra_alarm_sap = true }"),
        ("Extra_Alarm_SAP_supp = 1", "dpv1 = { extra_alarm_sap = false }"),  # SAP 51 works, too
    ],
)
def test_configurations_without_a_note(folder: Path, keywords: str, keys: str) -> None:
    assert notes(folder, keywords, keys) == []


def test_a_required_alarm_without_its_supp_keyword_can_be_enabled(folder: Path) -> None:
    required = "Update_Alarm_required = 1"
    assert notes(folder, required, 'dpv1 = { alarms = ["update"] }') == []
    with pytest.raises(ConfigError, match="Update_Alarm_required = 1"):
        notes(folder, required, 'dpv1 = { alarms = ["process"] }')


# --- Set_Slave_Add ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "ident"),
    [(9, 10, None), (126, 9, None), (126, 10, 0x1234)],
)
async def test_set_slave_add_is_refused_where_the_file_excludes_it(
    folder: Path, old: int, new: int, ident: int | None
) -> None:
    table = {"name": "rig", "address": 9, "gsd": str(folder / "rig.gsd")}
    async with bus_of(table, world=dpstack.World()) as bus:
        with pytest.raises(UsageError) as caught:
            await bus.class2.set_address(old, new, ident=ident)
        assert str(caught.value) == (
            "slave 9 (rig): its GSD file does not say Set_Slave_Add_supp = 1: its address is set at the device "
            "(switches, its keypad); force=True asks it all the same"
        )
        with pytest.raises(dpstack.SlaveTimeout):  # nobody is there
            await bus.class2.set_address(old, new, ident=ident, force=True)


@pytest.mark.parametrize("says", ["Set_Slave_Add_supp = 1", None])
async def test_set_slave_add_where_the_file_allows_it_or_there_is_none(folder: Path, says: str | None) -> None:
    (folder / "rig.gsd").write_text(f"{GSD}{says}\n", encoding="ascii")
    table = {"name": "rig", "address": 9, "gsd": str(folder / "rig.gsd")} if says else RAW
    async with bus_of(table, world=dpstack.World()) as bus:
        with pytest.raises(dpstack.SlaveTimeout):
            await bus.class2.set_address(126, 9)


# --- the texts of a diagnosis over class 2 ------------------------------------------------------------------------


class Faulty(MirrorDevice):
    """A device with diagnosis blocks."""

    def user_diag(self) -> UserDiag:
        return UserDiag.of(device_block(b"\x01"), channel_block(0, 3, 17, size=1, input=True))


@pytest.mark.parametrize(("ident", "words"), [(0x1234, True), (0x4321, False)])
async def test_a_diagnosis_over_class_2_has_the_texts_of_the_gsd_file(folder: Path, ident: int, words: bool) -> None:
    """Only for the configured device, not for another one at its address."""
    world = dpstack.World()
    slave_in(world, Faulty(ident, b"\x20\x10"), 9)
    table = {"name": "rig", "address": 9, "gsd": str(folder / "rig.gsd"), "dpv1": False}
    async with bus_of(table, world=world) as bus:
        found = await bus.class2.diagnosis(9)
        assert found.ident == ident
        said = "fuse blown" if words else "device: 01"
        channel = "sensor missing" if words else "bit): error 17"
        assert said in found.diagnosis_texts
        assert any(channel in line for line in found.diagnosis_texts)
        assert found.diagnosis_texts[: len(found.texts)] == found.texts
