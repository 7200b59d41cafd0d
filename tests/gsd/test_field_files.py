"""Constructs of files in the field: comments without a semicolon, lengths that contradict, copies with other line ends,
compact stations with several modules, texts and slot numbers that do not count.
"""

from __future__ import annotations

import pytest
from gsd_kit import HEAD, made, octets, texts

from dpstack.errors import GsdError
from dpstack.gsd.check import check
from dpstack.gsd.configuration import configure, plug
from dpstack.gsd.model import PrmRef, Slot
from dpstack.gsd.parser import parse_gsd
from dpstack.gsd.prm import UserPrm

LIST = (
    'PrmText = 1\nText(0) = "one"\nText(1) = "two"\nText(3) = "three"\nEndPrmText\n'
    'ExtUserPrmData = 1 "Mode"\nUnsigned8 1 0-2\nPrm_Text_Ref = 1\nEndExtUserPrmData\n'
)


def findings(text: str) -> list[str]:
    """Line (the text begins on line 5) and message of each finding of ``gsd check``."""
    return [f"{found.line}: {found.message}" for found in check(made(text))]


def skipped(line: int, keyword: str, remark: str) -> str:
    return f"{line}: {keyword}: {remark!r} behind the value is skipped as a comment; a comment begins with a semicolon"


# --- comments without a semicolon -------------------------------------------------------------------------------------


def test_a_ref_with_a_comment_without_semicolon_is_read_with_a_warning() -> None:
    text = LIST + "Ext_User_Prm_Data_Const(0) = 0x00\nExt_User_Prm_Data_Ref(0) = 1 Mode of the unit\n"
    file = made(text)
    assert file.device.prm.refs == (PrmRef(0, 1),)
    assert UserPrm(file.device).octets() == b"\x01"
    assert findings(text) == [skipped(15, "Ext_User_Prm_Data_Ref", "Mode of the unit")]


def test_the_same_line_is_reported_each_time() -> None:
    module = 'Module = "{}" 0x10\nExt_Module_Prm_Data_Len = 1\nExt_User_Prm_Data_Ref(0) = 1 (Mode)\nEndModule\n'
    found = findings(LIST + module.format("a") + module.format("b"))
    assert found == [skipped(16, "Ext_User_Prm_Data_Ref", "(Mode)"), skipped(20, "Ext_User_Prm_Data_Ref", "(Mode)")]


def test_every_kind_of_number_may_have_such_a_comment() -> None:
    file = made(
        "Max_Module = 2 two\nUser_Prm_Data_Len = 2 octets\nUser_Prm_Data = 0x01,0x02 both\n"
        'Module = "m n" 0x10,0x11 in and in\n7 first one\nExt_Module_Prm_Data_Len = 2 octets\n'
        "Ext_User_Prm_Data_Const(0) = 0x08, 0x09 constants\nEndModule\n"
        'SlotDefinition\nSlot(1) = "front" 7 7 head\nEndSlotDefinition\n'
        'PrmText = 4 texts\nText(0) = 12 Volt\nEndPrmText\nExtUserPrmData = 2 "p"\nUnsigned8 3 0-9 range\n'
        "Prm_Text_Ref = 4 above\nEndExtUserPrmData\nUnit_Diag_Area = 0-7 area\nUnit_Diag_Area_End\n"
    )
    device = file.device
    assert (device.max_module, device.user_prm_data_len, device.user_prm_data) == (2, 2, b"\x01\x02")
    (module,) = device.modules
    assert (module.name, module.config, module.reference, module.prm.length) == ("m n", b"\x10\x11", 7, 2)
    assert module.prm.consts[0].octets == b"\x08\x09"
    assert device.slots == (Slot(1, "front", 7, ((7, 7),)),)
    assert (device.parameters[2].allowed, device.parameters[2].texts) == (((0, 9),), {0: "12 Volt"})
    assert len(file.diagnostics) == 12
    assert all("is skipped as a comment" in found.message for found in file.diagnostics)


@pytest.mark.parametrize("value", ["0x00,0x0G", "0x00, abc", "1 2x", "abc"])
def test_a_list_that_is_damaged_is_no_list_with_a_comment(value: str) -> None:
    file = made(f"Ext_User_Prm_Data_Const(0) = {value}\n")
    assert file.device.prm.consts == ()
    assert texts(file) == [
        f"5:30: warning: Ext_User_Prm_Data_Const(0) = {value} cannot be read; it is left out",
    ]


# --- lengths ----------------------------------------------------------------------------------------------------------
REFUSE = "; the device may refuse them (Prm_Fault): then give the octets that its manual wants as user_prm"


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (
            "User_Prm_Data_Len = 5\nExt_User_Prm_Data_Const(0) = 1,2,3\n",
            ["6: 3 octets of user parameters, User_Prm_Data_Len is 5" + REFUSE],
        ),
        (
            "User_Prm_Data_Len = 5\n",
            ["0: 0 octets of user parameters, User_Prm_Data_Len is 5" + REFUSE],
        ),
        (
            "User_Prm_Data_Len = 3\nUser_Prm_Data = 1,2\n",
            ["6: User_Prm_Data has 2 octets, User_Prm_Data_Len is 3; all 2 are used"],
        ),
        (
            "Max_User_Prm_Data_Len = 2\nExt_User_Prm_Data_Const(0) = 1,2,3\n",
            ["6: 3 octets of user parameters, Max_User_Prm_Data_Len is 2" + REFUSE],
        ),
        (
            "Max_User_Prm_Data_Len = 2\nUser_Prm_Data_Len = 2\nUser_Prm_Data = 1,2\n",
            [
                "0: 0 octets of user parameters, User_Prm_Data has 2, but is not used beside Max_User_Prm_Data_Len"
                + REFUSE
            ],
        ),
        # the old keywords beside the new ones are usual
        ("User_Prm_Data_Len = 2\nUser_Prm_Data = 0,0\nExt_User_Prm_Data_Const(0) = 1,2\n", []),
        ("Max_User_Prm_Data_Len = 9\nUser_Prm_Data_Len = 9\nExt_User_Prm_Data_Const(0) = 1,2\n", []),
    ],
)
def test_check_says_both_numbers(text: str, wanted: list[str]) -> None:
    assert findings(text) == wanted


def test_modules_make_more_than_user_prm_data_len() -> None:
    device = made(
        "Modular_Station = 1\nMax_Module = 2\nUser_Prm_Data_Len = 2\nUser_Prm_Data = 1,2\n"
        'Module = "m" 0x10\nExt_Module_Prm_Data_Len = 1\nEndModule\n'
    ).device
    assert configure(device, ["m"]).user_prm().length_note == ""


def test_the_advice_where_modules_make_them_too_long() -> None:
    device = made(
        "Modular_Station = 1\nMax_Module = 4\nMax_User_Prm_Data_Len = 3\n"
        'Module = "m" 0x10\nExt_Module_Prm_Data_Len = 2\nEndModule\n'
    ).device
    with pytest.raises(GsdError) as caught:
        configure(device, ["m", "m"])
    assert str(caught.value) == (
        "4 octets of user parameters, Max_User_Prm_Data_Len of the device is 3; take out modules, or give user_prm"
    )
    assert configure(device, ["m", "m"], own_prm=True).config == b"\x10\x10"


# --- DP-V1 without octets ---------------------------------------------------------------------------------------------
V1 = "DPV1_Slave = 1\nC1_Read_Write_supp = 1\n"


@pytest.mark.parametrize("limit", ["", "Max_User_Prm_Data_Len = 3\n", "Max_User_Prm_Data_Len = 20\n"])
def test_a_device_with_dpv1_and_no_octets_gets_three_where_the_file_has_room(limit: str) -> None:
    assert UserPrm(made(V1 + limit).device).octets() == b"\0\0\0"
    assert findings(V1 + limit) == []
    assert UserPrm(made("DPV1_Slave = 1\n" + limit).device).octets() == b""  # it has no Read and Write


@pytest.mark.parametrize("limit", ["Max_User_Prm_Data_Len = 2", "User_Prm_Data_Len = 0"])
def test_where_the_file_has_no_room_check_says_so(limit: str) -> None:
    assert UserPrm(made(V1 + limit).device).octets() == b""
    said = limit.replace(" =", " is")
    assert findings(V1 + limit + "\n") == [
        "0: the GSD file says DPV1_Slave = 1 and C1_Read_Write_supp = 1, but has 0 octets of user parameters "
        f"({said}): Read, Write and alarms stay off without the three octets DPV1_Status; if the device has them, give "
        'user_prm = "00 00 00" and dpv1 = true'
    ]


# --- compact stations -------------------------------------------------------------------------------------------------
THREE = 'Module = "in" 0x10\nEndModule\nModule = "none" 0x00\nEndModule\nModule = "out" 0x21\nEndModule\n'


def test_a_compact_station_has_all_its_modules_in_the_files_order() -> None:
    found = configure(made(THREE).device)
    assert (found.config, found.inputs, found.outputs, found.notes) == (b"\x10\x00\x21", 1, 2, ())


@pytest.mark.parametrize("limit", ["Max_Module = 1\n", "Max_Output_Len = 1\n", "Max_Data_Len = 2\n"])
def test_modules_that_do_not_fit_together_are_a_choice(limit: str) -> None:
    with pytest.raises(GsdError, match="the device has 3 modules to choose from; name those that are plugged"):
        configure(made(limit + THREE).device)


def test_a_preset_of_a_compact_station_is_the_choice() -> None:
    device = made(THREE.replace("0x21\n", "0x21\nPreset = 1\n")).device
    assert configure(device).config == b"\x21"


# --- texts, slot numbers, infos ---------------------------------------------------------------------------------------


def test_texts_of_values_outside_of_the_range_are_not_offered() -> None:
    device = made(LIST + "Ext_User_Prm_Data_Ref(0) = 1\n").device
    assert device.parameters[1].texts == {0: "one", 1: "two", 3: "three"}
    assert device.parameters[1].choices == {0: "one", 1: "two"}
    prm = UserPrm(device)
    with pytest.raises(GsdError, match=r"'Mode' has no value 'three'; known: 'one', 'two'$"):
        prm.set("Mode", "three")
    prm.set("Mode", "two")
    assert prm.octets() == b"\x01"


def test_the_number_of_the_slot_is_no_contradiction() -> None:
    text = (
        "Modular_Station = 1\nMax_Module = 2\n"
        'ExtUserPrmData = 1 "[SlotNumber]"\nUnsigned8 1 1-9\nEndExtUserPrmData\n'
        'ExtUserPrmData = 2 "Filter"\nUnsigned8 2 0-9\nEndExtUserPrmData\n'
        'Module = "m" 0x10\nExt_Module_Prm_Data_Len = 2\nExt_User_Prm_Data_Const(0) = 4,{filter}\n'
        "Ext_User_Prm_Data_Ref(0) = 1\nExt_User_Prm_Data_Ref(1) = 2\nEndModule\n"
    )
    assert findings(text.format(filter=2)) == []
    (found,) = findings(text.format(filter=7))
    assert "(Filter@1: its default is 2, the constant octets say 7)" in found  # and not "1 more in this file"


# --- line ends --------------------------------------------------------------------------------------------------------
STRAY = (HEAD + "; MLFB\r\n" + 'Module = "a\\\n b" 0x10\nEndModule\nWrong\n').replace("\n", "\r\n").encode()


def test_a_file_with_a_stray_cr_and_its_copies_are_one_model() -> None:
    """``; MLFB`` CR CR LF: a program that rewrites line ends makes two of it."""
    assert STRAY.count(b"\r\r\n") == 1
    lf = STRAY.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    copies = [STRAY, lf, lf.replace(b"\n", b"\r"), lf.replace(b"\n", b"\r\n")]
    files = [parse_gsd(copy, "copy") for copy in copies]
    assert files == [files[0]] * 4
    assert [texts(file) for file in files] == [["10:1: info: Wrong has no meaning here; kept as it stands"]] * 4
    assert [module.line for module in files[0].device.modules] == [7]
    assert files[0].device.modules[0].name == "a b"


def test_models_that_differ_in_lines_only_are_equal() -> None:
    whole = octets("whole")
    with_comment = whole.replace(b"#Profibus_DP", b"#Profibus_DP\n; one line more", 1)
    one, other = parse_gsd(whole, "x").device, parse_gsd(with_comment, "x").device
    assert one.modules[0].line + 1 == other.modules[0].line
    assert one == other


def test_a_row_of_the_users_own_gets_the_note() -> None:
    device = made(THREE).device
    assert configure(device, ["in", "none", "out"]).notes == ()
    assert plug(device, device.modules[::2]).notes == (
        "the device is no modular station (Modular_Station = 0), but several modules are plugged",
    )
