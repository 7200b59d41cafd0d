"""The constructs of real GSD files: a small file for each, and the literal model expected; texts of the diagnosis,
from literal octets of blocks."""

from __future__ import annotations

import gsd_kit
import pytest
from gsd_kit import device, made, read, texts

from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.dpv1_keywords import DpV1
from dpstack.gsd.model import DiagText, PrmConst, PrmKind, PrmRef, Ranges, Raw, Slot, Speed
from dpstack.gsd.parser import load_gsd, parse_gsd


def test_a_whole_file() -> None:
    file = read("whole")
    assert texts(file) == []
    d = file.device
    assert (d.ident, d.vendor, d.model, d.revision) == (0x1A2B, "Nobody & Sons", "Terminal 8", "B02")
    assert (d.gsd_revision, d.hardware_release, d.software_release, d.station_type) == (5, "H1.0", "V2;3", 0)
    assert d.speeds == (Speed(9_600, 60), Speed(45_450, 250), Speed(500_000, 100), Speed(12_000_000, 800))
    assert (d.freeze, d.sync, d.auto_baud, d.set_slave_add, d.fail_safe) == (True, True, True, False, True)
    assert (d.min_slave_interval, d.modular, d.max_module, d.modul_offset) == (6, True, 4, 1)
    assert (d.max_input_len, d.max_output_len, d.max_data_len) == (16, 8, 20)
    assert (d.max_diag_data_len, d.max_user_prm_data_len) == (32, 30)
    assert d.dpv1 == DpV1(
        slave=True,
        c1_read_write=True,
        c1_max_data_len=240,
        c1_response_timeout=100,
        c2_read_write=True,
        c2_max_data_len=240,
        c2_response_timeout=200,
        c2_max_count_channels=2,
        max_initiate_pdu_length=52,
        alarms=("Process_Alarm", "Diagnostic_Alarm"),
        required=("Process_Alarm",),
        wd_base_1ms=True,
        check_cfg_mode=True,
        ident_maintenance=True,
        prm_block_structure=True,
    )
    assert d.order_number == "T8-001"
    assert (d.isochronous, d.isochronous_required, d.publisher) == (True, False, True)
    assert [(m.name, m.config, m.reference, m.preset, m.info) for m in d.modules] == [
        ("8 DI", b"\x10", 1, False, "eight inputs"),
        ("8 DO", b"\x20", 2, True, ""),
        ("4 AI", b"\x43\x43\x01\x02\x03", 3, False, ""),
    ]
    assert d.modules[0].prm.length == 3
    assert d.modules[0].prm.refs == (PrmRef(1, 2),)
    assert d.modules[0].line == 82
    assert d.prm.consts == (PrmConst(0, b"\x80\0\0\0\0"),)
    assert d.diagnosis.texts == (DiagText("bit", 0, 0, 1, "fuse blown", "replace F1"),)
    assert d.parameters[1].texts == {0: "off", 1: "on"}
    assert (d.parameters[2].default, d.parameters[2].allowed) == (500, ((0, 1000),))


@pytest.mark.parametrize(
    ("name", "encoding", "model"),
    [
        ("encodings_cp1252", "cp1252", "Größe \u2013 ±5 °C"),
        ("encodings_utf8", "utf-8", "Größe"),
        ("encodings_utf8_bom", "utf-8-sig", "Größe"),
        ("encodings_holes", "cp1252", "\x81\x8dé"),
    ],
)
def test_decoding(name: str, encoding: str, model: str) -> None:
    file = read(name)
    assert (file.encoding, file.device.model, file.diagnostics) == (encoding, model, ())


def test_utf16_is_read_too() -> None:
    octets = gsd_kit.octets("encodings_utf8").decode("utf-8").encode("utf-16")
    assert load_gsd(octets).device.model == "Größe"


@pytest.mark.parametrize(
    ("octets", "name"),
    [
        (b"4\x8520 mA", "4\u202620 mA"),  # CP1252
        (b"4\xc2\x8520 mA", "4\x8520 mA"),  # NEL
        (b"4\xe2\x80\xa820 mA", "4\u202820 mA"),
        (b"4\x1c20 mA", "4\x1c20 mA"),
    ],
)
def test_only_cr_lf_vt_and_ff_end_a_line(octets: bytes, name: str) -> None:
    head = gsd_kit.HEAD.encode() + b"Modular_Station = 1\nMax_Module = 8 ; not " + octets + b" Max_Module = 2\n"
    device = parse_gsd(head + b'Module = "' + octets + b'" 0x53\n1\nEndModule\n').device
    assert (device.max_module, [module.name for module in device.modules]) == (8, [name])


@pytest.mark.parametrize("name", ["lines_cr", "lines_crlf", "lines_cr_cr_lf", "lines_no_end"])
def test_line_ends(name: str) -> None:
    file = read(name)
    assert (file.device.ident, file.device.speeds, file.diagnostics) == (0x0FFE, (Speed(500_000, 100),), ())


@pytest.mark.parametrize("name", ["lines_cr", "lines_crlf", "lines_cr_cr_lf"])
def test_line_numbers_are_those_of_an_editor(name: str) -> None:
    end = {"lines_cr": b"\r", "lines_crlf": b"\r\n", "lines_cr_cr_lf": b"\r\r\n"}[name]
    file = parse_gsd(gsd_kit.octets(name) + b"Wrong" + end)
    assert texts(file) == ["8:1: info: Wrong has no meaning here; kept as it stands"]


def test_text_before_the_mark_is_skipped_and_reported() -> None:
    file = read("mark_text_before")
    assert file.device.model == "late"
    assert "second line" not in file.device.settings
    assert texts(file) == ["1:1: info: the text before #Profibus_DP on line 3 is skipped"]


def test_without_mark_but_with_keywords() -> None:
    file = read("mark_missing")
    assert file.device.ident == 0x0FFE
    assert texts(file) == ["1:1: warning: no line #Profibus_DP, which begins a GSD file; read from its first line"]


def test_without_revision() -> None:
    file = read("revision_missing")
    assert (file.device.gsd_revision, file.device.ident, file.diagnostics) == (None, 0x0FFE, ())


def test_case_does_not_matter() -> None:
    d = device("case")
    assert (d.modular, d.auto_baud, d.max_data_len) == (True, True, 9)
    assert d.parameters[1].type.kind is PrmKind.UNSIGNED8
    assert [(m.name, m.preset, m.complete) for m in d.modules] == [("m", True, True)]


def test_comments_and_semicolons_in_texts() -> None:
    file = read("comments")
    d = file.device
    assert (d.model, d.revision, d.gsd_revision, d.max_data_len) == ("semi;colon", "A;1", 4, 7)
    assert [(m.name, m.config, m.complete) for m in d.modules] == [("a;b", b"\x10", True)]
    assert texts(file) == ["9:1: warning: GSD_Revision stands twice (first on line 2); the last one counts"]


def test_continuations() -> None:
    file = read("continuations")
    d = file.device
    assert d.model == "one long name"
    assert d.modular is True
    assert d.prm.consts == (PrmConst(0, b"\x01\x02\x03\x04\x05"), PrmConst(5, b"\x06"))
    assert d.settings["info_text"] == '"first half and second half; still the text"'
    assert d.max_module == 9
    assert d.modules[0].name == "path\\to"
    assert d.modules[0].line == 21
    assert file.diagnostics == ()


def test_blanks_inside_and_before_parentheses() -> None:
    file = read("blanks")
    d = file.device
    assert d.diagnosis.texts == (
        DiagText("bit", 0, 0, 1, "zero", ""),
        DiagText("bit", 2, 2, 1, "two", ""),
        DiagText("area", 8, 15, 0, "none", ""),
        DiagText("area", 8, 15, 0x60, "sixty", ""),
    )
    assert [(m.name, m.config) for m in d.modules] == [("x", b"\x20"), ("spaces", b"\x10\x20")]
    assert file.diagnostics == ()


def test_numbers() -> None:
    d = device("numbers")
    found = {n: (p.type.text, p.default, p.allowed) for n, p in d.parameters.items()}
    assert found == {
        1: ("Signed16", -32768, ((-32768, 32767),)),
        2: ("Signed32", 0, ((-16777216, 16777215),)),
        3: ("Unsigned16", 0x4802, ((0, 0xFFFF),)),
        4: ("Unsigned8", 24, ((24, 24),)),
        5: ("Bit(0)", 0, ((0, 0), (1, 1))),
        6: ("BitArea(2-4)", 5, ((0, 3), (5, 5))),
        65377: ("Unsigned32", 7, ((7, 7),)),
    }
    assert d.hardware_release == "1.1"
    assert (d.modules[0].config, d.modules[0].reference) == (b"\x60\x50\xc1", 9999)


@pytest.mark.parametrize(
    ("written", "default", "allowed", "told"),
    [
        ("Bit(0)  0-1", 0, ((0, 1),), "no default value in front of the range 0..1; 0 is used"),
        ("Unsigned8 5-9,12", 5, ((5, 9), (12, 12)), "no default value in front of the range 5..9, 12; 5 is used"),
        ("Signed8 -5 - 5", 0, ((-5, 5),), "no default value in front of the range -5..5; 0 is used"),
        ("Signed8 -5-5", 0, ((-5, 5),), "no default value in front of the range -5..5; 0 is used"),
        ("Bit(0) 0-2", 0, ((0, 2),), "allowed values 0..2 do not fit Bit(0); the default is 0"),
        ("Bit(0) 0 0-1", 0, ((0, 1),), ""),
        ("Signed8 0 -5-5", 0, ((-5, 5),), ""),
        ("Signed8 0 -5", 0, ((-5, -5),), "default 0 is not among the allowed values -5"),
        ("Bit(0) 1", 1, (), ""),
    ],
)
def test_a_range_without_a_default(written: str, default: int, allowed: Ranges, told: str) -> None:
    file = made(f'ExtUserPrmData = 1 "p"\n{written}\nEndExtUserPrmData\n')
    parameter = file.device.parameters[1]
    assert (parameter.default, parameter.allowed) == (default, allowed)
    assert [d.message for d in file.diagnostics] == ([f"ExtUserPrmData 1: {told}"] if told else [])


def test_blanks_at_the_ends_of_texts_are_left_out() -> None:
    file = made(
        'PrmText = 1\nText(0) = " off  "\nEndPrmText\nUnit_Diag_Bit(1) = "fuse blown "\n'
        'ExtUserPrmData = 1 "p"\nUnsigned8 0\nPrm_Text_Ref = 1\nEndExtUserPrmData\n'
        'SlotDefinition\nSlot(1) = "head " 1 1\nEndSlotDefinition\n'
    )
    assert file.device.parameters[1].texts == {0: "off"}
    assert file.device.diagnosis.texts == (DiagText("bit", 1, 1, 1, "fuse blown", ""),)
    assert file.device.slots[0].name == "head"


def test_order_is_free() -> None:
    file = read("order")
    d = file.device
    assert (d.gsd_revision, d.modules[0].name) == (1, "early")
    assert d.parameters[1].texts == {0: "slow", 1: "fast"}
    assert d.diagnosis.texts == (DiagText("bit", 3, 3, 1, "second", ""),)
    assert texts(file) == [
        "13:1: warning: PrmText 4 stands twice (first on line 10); the last one counts",
        "18:20: warning: Unit_Diag_Bit(3) stands twice with different texts; the last one counts",
    ]


def test_unknown_keywords_and_blocks_are_kept_raw() -> None:
    file = read("unknown")
    d = file.device
    assert DiagText("not_bit", 5, 5, 0, "no load voltage", "") in d.diagnosis.texts
    assert d.settings["our_own_keyword"] == '"kept"'
    assert d.settings["f_paramdesccrc"] == "0x1234"
    assert [raw for raw in d.raw if not raw.block] == [Raw(12, "F_Ext_User_Prm_Data_Const", "0", "0x01,0x02")]
    blocks = {raw.block: [r.keyword for r in d.raw if r.block == raw.block] for raw in d.raw if raw.block}
    assert blocks == {
        "Physical_Interface": ["Physical_Interface", "Transmission_Delay_500"],
        "Version_Firmware_Download": ["Version_Firmware_Download", "Download_Version"],
        "Speciality": ["Speciality", "Ext_User_Prm_Data_Const"],
    }
    assert d.prm.consts == ()  # the one in an unknown block is not the device's
    assert [raw.keyword for raw in d.modules[0].raw] == ["Data_Area_Beg", "Length", "F_Ext_Module_Prm_Data_Len"]
    assert [text for text in d.diagnosis.texts if text.kind == "bit"] == [DiagText("bit", 3, 3, 1, "of DP-V1", "")]
    (typed,) = d.diag_types
    assert typed.type == 129
    assert DiagText("bit", 24, 24, 1, "parity", "") in typed.texts
    assert [(text.value, text.text, text.help) for text in typed.texts if text.kind == "area"] == [
        (64, "address differs", "set the switches")
    ]
    assert [line for line in texts(file) if "info" not in line] == []
    assert len(file.diagnostics) == 5  # each unknown keyword once


def test_slots() -> None:
    assert device("slots").slots == (
        Slot(1, "power", 1, ((1, 1),), 14),
        Slot(2, "signals", 2, ((2, 3), (5, 5)), 15),
        Slot(3, "last", 4, ((2, 2), (4, 4)), 16),
    )


def test_special_identifiers() -> None:
    file = read("identifiers")
    assert [m.config.hex() for m in file.device.modules] == ["00", "c1c1fd00", "040000adc4", "40", ""]
    assert texts(file) == [
        "16:1: warning: module 'lies': identifier octet 0 (0x40) announces a length octet that is missing",
        "18:1: warning: module 'no octets': no identifier octets; it changes nothing in a configuration",
    ]


def test_a_damaged_module_leaves_the_others_usable() -> None:
    file = read("damaged_module")
    d = file.device
    assert [(m.name, m.complete, m.prm.consts) for m in d.modules] == [
        ("lost end", False, (PrmConst(0, b"\xaa"),)),
        ("sound", True, ()),
        ("no octets", False, ()),
        ("cut off", False, (PrmConst(0, b"\x0b"),)),
    ]
    assert d.prm.consts == (PrmConst(0, b"\x07"),)
    assert [line for line in texts(file) if "error" in line] == [
        "11:1: error: Module 'lost end' never ends: EndModule is missing before Module on line 15",
        "18:10: error: module 'no octets': twenty is no list of identifier octets; the module cannot be used",
        "21:1: error: Module 'cut off' never ends: EndModule is missing before the end of the file",
    ]


D = device("diagnosis")
TEXTS = DiagTexts(D, [None, D.modules[0]])


@pytest.mark.parametrize(
    ("octets", "texts"),
    [
        ("", ()),
        ("00", ()),
        ("01", ("fuse blown",)),
        ("00 06", ("too hot",)),
        ("00 00", ("no load voltage",)),
        ("00 04 05", ()),
        ("01 02 00 00", ("fuse blown", "too hot", "no load voltage", "runs")),
        ("00 04 19 08", ("stopped", "across the octets")),
        ("81 04 05 01", ("parity",)),
        ("80 04 05 01", ()),
    ],
)
def test_device_related(octets: str, texts: tuple[str, ...]) -> None:
    assert tuple(found.text for found in TEXTS.unit_diag_texts(bytes.fromhex(octets))) == texts


def test_helps_go_with_the_texts() -> None:
    found = TEXTS.unit_diag_texts(bytes.fromhex("01 04 09 00"))
    assert [(text.text, text.help) for text in found] == [("fuse blown", "replace F1"), ("stopped", "start it")]


def test_channel_related() -> None:
    assert TEXTS.channel_text(16) == DiagText("channel", None, None, 16, "sensor missing", "plug it in")
    assert TEXTS.channel_text(17) is None


@pytest.mark.parametrize(("module", "text"), [(1, "coil open"), (0, "sensor missing"), (99, "sensor missing")])
def test_a_modules_own_channel_texts_come_first(module: int, text: str) -> None:
    found = TEXTS.channel_text(16, module)
    assert found is not None
    assert found.text == text


def test_a_modules_own_unit_texts_come_first() -> None:
    assert [found.text for found in TEXTS.unit_diag_texts(b"\x01", module=1)] == ["module fuse"]
