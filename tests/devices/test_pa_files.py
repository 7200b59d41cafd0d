"""Device files of PROFIBUS PA devices: modules and identifier octets as makers print them, values, mistakes by line."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.api.bus.compose import plan_bus
from dpstack.api.config.config import make_config, slave_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.devices import finding
from dpstack.devices.examples import run_examples
from dpstack.devices.pa.configurations import of_config, telegram_of
from dpstack.devices.pa.model import PaFile
from dpstack.devices.reader import DeviceFileError
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.process_image import Value
from dpstack.errors import ConfigError
from dpstack.gsd.identifiers import io_lengths

#: identifier octets as printed, with the octets of inputs and outputs that the same page gives, and the module
PRINTED = (
    # Endress+Hauser Prosonic Flow 93, page 108: byte lengths of input and output
    ("94", 5, 0, "AI"),
    ("42 84 08 05", 5, 0, "AI long"),
    ("C1 81 84 85", 5, 2, "SETTOT_MODETOT_TOTAL"),
    ("41 84 85", 5, 0, "TOTAL"),  # page 109
    ("20", 0, 1, "CONTROL_BLOCK"),
    ("00", 0, 0, "free"),
    # Samson KH 8384-4 EN, pages 10 to 13; Type 3785, EB 8382-1, page 36: A4, B4
    ("A4", 0, 5, "SP"),
    ("82 84 08 05", 0, 5, "SP long"),
    ("B4", 5, 5, "RCAS_IN+RCAS_OUT short"),
    ("C4 84 84 08 05 08 05", 5, 5, "RCAS_IN+RCAS_OUT"),
    ("C7 84 89 08 05 08 05 05 05 0A", 10, 5, "SP+READBACK+POS_D+CHECKBACK"),
    ("C5 84 87 08 05 08 05 0A", 8, 5, "RCAS_IN+RCAS_OUT+CHECKBACK"),
    ("CB 89 8E 08 05 08 05 08 05 08 05 05 05 0A", 15, 10, "SP+RCAS_IN+READBACK+RCAS_OUT+POS_D+CHECKBACK"),
    ("91", 2, 0, "DI"),
)
PLAIN = "format = 1\nname = 'plain'\nbase = 'pa'\n[bus]\nident = 0x1234\n"


def pa(**more: object) -> SlaveConfig:
    return slave_config({"name": "tank", "address": 5, "device": "pa", "ident": 0x9700, **more})


def base() -> PaFile:
    path = finding.path_of("pa")
    assert path is not None
    file = finding.file_at(path)
    assert isinstance(file, PaFile)
    return file


def values(slave: SlaveConfig, octets: str) -> dict[str, Value]:
    return slave.input_fields.values(bytes.fromhex(octets))


def mistakes(folder: Path, text: str) -> list[str]:
    path = folder / "plain.toml"
    path.write_text(PLAIN + text)
    with pytest.raises(DeviceFileError) as caught:
        finding.read(path)
    return [str(error).removeprefix(f"{path}") for error in caught.value.errors]


@pytest.mark.parametrize(("octets", "inputs", "outputs", "module"), PRINTED)
def test_identifiers_as_makers_print_them(octets: str, inputs: int, outputs: int, module: str) -> None:
    config = bytes.fromhex(octets)
    assert io_lengths(config) == (inputs, outputs)
    assert base().modules[module].config == config
    found = of_config(base(), config)
    assert found is not None
    assert (found.name, found.inputs, found.outputs) == (module, inputs, outputs)


def test_a_gsd_style_table_of_a_flow_meter() -> None:
    """Prosonic Flow 93, page 109, example 2, in the slots of Promag 55 (page 107): octet numbers as printed there."""
    slave = slave_config(
        {
            "name": "flow",
            "address": 7,
            "device": "promag-55-pa",
            "modules": ["AI long", "free", "TOTAL", "SETTOT_MODETOT_TOTAL", "", "DISPLAY_VALUE", "CONTROL_BLOCK"],
        }
    )
    assert slave.params.config.hex(" ") == "42 84 08 05 00 41 84 85 c1 81 84 85 00 a4 20"
    places = {name: field.spec for _, fields in slave.fields for name, field in fields.fields.items()}
    assert places == {
        "flow": "f32@0", "total2": "f32@5", "total3": "f32@10",
        "total3_set": "u8@0", "total3_mode": "u8@1", "display": "f32@2", "control": "u8@7",
    }  # fmt: skip
    assert {name: field.status for name, field in slave.input_fields.fields.items()} == {
        "flow": 4, "total2": 9, "total3": 14,
    }  # fmt: skip
    assert slave.input_fields.units == {"flow": "m3/h", "total2": "m3", "total3": "m3"}


def test_all_parts_of_an_actuator() -> None:
    """SIPART PS2 A5E00127926-AC, page 217: READBACK 0, RCAS_OUT 5, POS_D 10, CHECKBACK 12; SP 0, RCAS_IN 5."""
    slave = pa(modules=["SP+RCAS_IN+READBACK+RCAS_OUT+POS_D+CHECKBACK"])
    specs = {name: field.spec for name, field in slave.input_fields.fields.items() if "checkback" not in name}
    assert specs == {"ao1_readback": "f32@0", "ao1_rcas_out": "f32@5", "ao1_pos_d": "u8@10"}
    assert slave.input_fields.fields["ao1_checkback_fail_safe"].spec == "bool@12.0"
    assert {name: field.spec for name, field in slave.output_fields.fields.items()} == {
        "ao1": "f32@0", "ao1_rcas_in": "f32@5",
    }  # fmt: skip


def test_bits_of_checkback() -> None:
    """SIPART PS2, pages 212 and 213: local operation is bit 2 of octet 0, parameters changed bit 2 of octet 1, path
    integral bit 0 of octet 2."""
    found = values(pa(modules=["SP+CHECKBACK"]), "04 04 01")
    assert [name for name, value in found.items() if value] == [
        "ao1_checkback_local", "ao1_checkback_update_event", "ao1_checkback_total_travel",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("ident", "modules", "octets"),
    [
        (0x9700, "AI", "94"),  # VEGAPULS 63, page 59; ModMAG M2000: one AI
        (0x9701, "AI, AI", "94 94"),  # VEGABAR 65, page 61: PA-OUT and temperature
        (0x9702, "AI, AI, AI", "94 94 94"),  # VEGAPULS 66, page 72, with its three AI function blocks
        (0x9741, "AI, AI, SETTOT_MODETOT_TOTAL", "94 94 c1 81 84 85"),  # Prosonic Flow 90, page 58
    ],
)
def test_ident_numbers_of_the_profile_bring_their_modules(ident: int, modules: str, octets: str) -> None:
    slave = pa(ident=ident)
    assert (slave.telegram, slave.params.config.hex(" "), slave.params.ident) == (modules, octets, ident)


def test_a_gsd_file_chooses_the_modules(tmp_path: Path) -> None:
    """The names of modules as profile GSD files have them; the values follow from their identifier octets."""
    (tmp_path / "pa.gsd").write_text(
        "#Profibus_DP\nGSD_Revision = 3\nVendor_Name = \"x\"\nModel_Name = \"Transmitter 1 AI\"\nRevision = \"1\"\n"
        "Ident_Number = 0x9700\nProtocol_Ident = 0\nStation_Type = 0\nFMS_supp = 0\nHardware_Release = \"1\"\n"
        "Software_Release = \"1\"\n31.25_supp = 1\n45.45_supp = 1\n93.75_supp = 1\nMaxTsdr_31.25 = 100\n"
        "MaxTsdr_45.45 = 250\nMaxTsdr_93.75 = 1000\nModular_Station = 1\nMax_Module = 2\nMax_Input_Len = 10\n"
        "Max_Output_Len = 0\nMax_Data_Len = 10\nModul_Offset = 1\nFail_Safe = 0\nMin_Slave_Intervall = 250\n"
        "Max_Diag_Data_Len = 20\nSlave_Family = 12\n"
        "Module = \"Analog Input (AI)short\" 0x94\nEndModule\n"
        "Module = \"Analog Input (AI)long\" 0x42,0x84,0x08,0x05\nEndModule\n"
        "Module = \"EMPTY_MODULE\" 0x00\nEndModule\n"
    )  # fmt: skip
    table = {"name": "tank", "address": 5, "device": "pa", "gsd": str(tmp_path / "pa.gsd")}
    slave = slave_config({**table, "modules": ["EMPTY_MODULE", "Analog Input (AI)long"]})
    assert (slave.telegram, slave.params.config.hex(" ")) == ("free, AI long", "00 42 84 08 05")
    assert list(slave.input_fields) == ["ai1"]
    assert slave.params.max_tsdr[93_750] == 1000


def test_couplers_at_fixed_rates_are_planned_with_the_max_tsdr_of_the_devices() -> None:
    """45.45 kbit/s: 640 and 400 bit times by the standard; 93.75 kbit/s: T_SL 1015 for MaxTsdr 1000 of PA devices."""
    slaves = [{"name": "tank", "address": 5, "device": "pa", "ident": 0x9700}]
    plans = {baud: plan_bus(make_config("virtual", baud, slaves=slaves)) for baud in (45_450, 93_750)}
    assert {baud: (plan.params.max_tsdr, plan.params.t_sl) for baud, plan in plans.items()} == {
        45_450: (400, 640), 93_750: (1000, 1015),
    }  # fmt: skip
    assert not [text for plan in plans.values() for text in plan.findings]


@pytest.mark.parametrize("name", ["pa", "vegabar-65", "promag-55-pa", "samson-3730-4"])
def test_the_examples_of_the_library(name: str) -> None:
    path = finding.path_of(name)
    assert path is not None
    file = finding.file_at(path)
    assert [str(error) for result in run_examples(file) for error in result.errors] == []


def test_the_option_chooses_the_coding() -> None:
    classic, condensed = (
        pa(**more).input_fields.fields["ai1"].coding for more in ({}, {"options": {"coding": "condensed"}})
    )
    assert (classic, condensed) == ("pa-classic", "pa-condensed")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"modules": ["A1"]}, r"pa: slot 1 has no module 'A1'; did you mean 'AI'\?"),
        ({"modules": []}, "pa: 0 modules; name one"),
        ({"modules": ["AI"], "telegram": "AI"}, "telegram beside modules"),
        ({"modules": ["AI"] * 49}, "its modules have 245 octets of inputs and 0 of outputs; a frame has 244"),
        ({"config": "94"}, "config beside device"),
        ({"modules": ["SP"], "safe": "00 00 00 00 80"}, "safe beside device: its safe outputs are zeros, which is bad"),
        ({"modules": ["SP"], "outputs": {"x": "u8@0"}}, "outputs beside device"),
        ({"options": {"coding": "new"}}, "coding must be 'classic' or 'condensed', not 'new'"),
        ({"simulated": {"ai2": 1}}, "there is no option or value 'ai2'"),
        ({"simulated": {"ai1": "x"}}, "ai1 = 'x' is no number"),
        ({"device": "samson-3730-4", "modules": ["AI"]}, "samson-3730-4: slot 1 has no module 'AI'"),
        ({"device": "vegabar-65", "modules": ["AI"] * 4}, "vegabar-65: 4 modules; it has 3 slots"),
    ],
)
def test_plant_files_that_cannot_be(more: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        pa(**more)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[slots.2]\nblock = 'AI'", "no slot 1"),
        ("[slots.x]\nblock = 'AI'", "slot 'x'"),
        ("[slots.1]\nblock = 'PID'", "unknown block 'PID'"),
        ("[slots.1]\nblock = 'AI'\nmodules = ['AI lang']", "'AI lang' is no module; did you mean 'AI long'?"),
        ("[slots.1]\nblock = 'AI'\nmodule = 'DI'", "module = 'DI' is none of its modules"),
        ("[slots.1]\nblock = 'AI'\nname = '1'", "name = '1'"),
        ("[slots.1]\nblock = 'AI'\nat = [1, 999]", "at = [1, 999]"),
        ("[slots.1]\nblock = 'AI'\nunit = '[m]'", "unit = '[m]'"),
        ("[slots.1]\nblock = 'DI'\nwords = { on = 'x' }", "'on' = 'x'"),
        ("[slots.1]\nblock = 'DI'\nwords = { 1 = \"x\\u001b[2J\" }", "holds a control character"),
        ("[slots.1]\nblock = 'AI'\nname = 'x'\n[slots.2]\nblock = 'AI'\nname = 'x'", "slots 1 and 2 are both called x"),
        ("[modules]\n'two, three' = { config = '94', in = ['OUT'] }", "a comma, or a space"),
        ("[modules]\nshort = { config = '93', in = ['OUT'] }", "the identifiers have 4 octets of inputs"),
        ("[modules]\nshort = { config = '94', in = ['OUTT'] }", "'OUTT' is no part of a module; did you mean 'OUT'?"),
        ("[modules]\nshort = { in = ['OUT'] }", "the module short has no identifiers"),
        ("[checkback]\nx = 24", "x = 24"),
        ("[extension]\n'6.0' = 'x'", "'6.0' = 'x' is no bit of DIAGNOSIS_EXTENSION"),
        ("[parameters]\nx = { block = 'tb1' }", "x has no place"),
        ("[parameters]\nx = { block = 'tb1', relative = 60, type = 'float' }", "type = 'float'"),
        ("[parameters]\nx = { slot = 1, index = 60, block = 'zz1' }", "x has no place"),
        ("[telegrams]\nx = { config = '94' }", "telegrams is for drives and encoders"),
        ("[profiles]\n97 = ['AI']", "97"),
        ("coding = 'condensed'\n[profiles]\n9700 = ['A']", "'A' is no module"),
    ],
)
def test_device_files_that_cannot_be(text: str, said: str, tmp_path: Path) -> None:
    found = mistakes(tmp_path, text)
    assert len(found) >= 1
    assert any(said in one for one in found), found
    assert not any("\x1b" in one for one in found)


@given(st.lists(st.sampled_from(sorted(base().modules)), min_size=1, max_size=12))
def test_modules_are_found_again_by_their_identifiers(names: list[str]) -> None:
    """Identifiers that two kinds of blocks share come back as octets, if not as names."""
    file = base()
    wanted = telegram_of([file.modules[name] for name in names])
    found = of_config(file, wanted.config)
    assert found is not None
    assert (found.config, found.inputs, found.outputs) == (wanted.config, wanted.inputs, wanted.outputs)


@given(st.binary(min_size=1, max_size=60))
def test_any_octets_are_a_configuration_or_none(octets: bytes) -> None:
    found = of_config(base(), octets)
    assert found is None or found.config == octets


def test_identifiers_that_begin_others_cost_no_time(tmp_path: Path) -> None:
    path = tmp_path / "plain.toml"
    path.write_text(
        PLAIN + "[modules]\none = { config = '94', in = ['OUT'] }\ntwo = { config = '94 94', in = ['OUT', 'OUT'] }\n"
    )
    file = finding.read(path)
    assert isinstance(file, PaFile)
    assert of_config(file, b"\x94" * 200 + b"\xff") is None


def test_maker_words_of_the_positioner() -> None:
    path = finding.path_of("samson-3730-4")
    assert path is not None
    file = finding.file_at(path)
    assert isinstance(file, PaFile)
    assert file.extension[3] == "control loop error (57)"  # KH 8384-4, page 41: octet 0, bit 3
    assert file.extension[15] == "test or calibration in progress"
    one = file.parameters["actuator_action"]
    assert (one.slot, one.index, one.words[2]) == (1, 143, "closing")  # page 69


def test_the_maker_s_bits_of_a_diagnosis_in_words() -> None:
    """KH 8384-4, pages 31 and 32: octets of an extended diagnosis; octet 1, bit 4: initialisation, solenoid valve."""
    slave = slave_config({"name": "pos", "address": 6, "device": "samson-3730-4"})
    octets = bytes.fromhex("08 0C 00 02 07 1D 0E FE 00 01 00 20 00 80 00 10 00 00 00 00")
    diagnosis = Diagnosis.parse(octets)
    assert diagnosis is not None
    assert slave.params.block_texts(diagnosis) == (
        "PROFIBUS PA diagnosis, slot 0, a message appears, maintenance required, more in DIAGNOSIS_EXTENSION, "
        "initialisation, solenoid valve (54)",
    )


def test_slots_have_the_names_of_their_modules() -> None:
    slots = pa(modules=["AI", "free", "TOTAL"]).params.slots.slots
    assert [(one.number, one.name, one.config.hex()) for one in slots] == [
        (1, "AI", "94"), (2, "free", "00"), (3, "TOTAL", "418485"),
    ]  # fmt: skip


def test_a_link_has_the_slots_of_its_devices(tmp_path: Path) -> None:
    """A5E00193841-01, page 10-6: a compact slave behind an IM 157 has two slots, header and module."""
    path = tmp_path / "link.toml"
    path.write_text(
        "format = 1\nname = 'link'\nbase = 'pa'\n[bus]\nident = 0x8052\n"
        "[slots.1]\n[slots.2]\nblock = 'AI'\nname = 't3_level'\nunit = 'm'\n"
        "[slots.3]\n[slots.4]\nblock = 'AO'\nname = 't4_valve'\nmodule = 'SP+READBACK+POS_D+CHECKBACK'\n"
    )
    slave = slave_config({"name": "link", "address": 20, "device": str(path)})
    assert slave.params.config.hex(" ") == "00 94 00 c7 84 89 08 05 08 05 05 05 0a"
    assert slave.input_fields.fields["t4_valve_readback"].spec == "f32@5"
    profile = slave.device_profile
    assert profile is not None
    assert profile.units is not None
    assert [(one.names[0], one.slot, one.record) for one in profile.units(slave.telegram or "", {})] == [
        ("t3_level", 2, 28), ("t4_valve_readback", 4, 27),
    ]  # fmt: skip
