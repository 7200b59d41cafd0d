"""Slots, fixed presets, ``[SlotNumber]`` and PROFIsafe: the module in each slot, and its parameters."""

from __future__ import annotations

import pytest
from gsd_kit import made
from hypothesis import given
from hypothesis import strategies as st

from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.errors import GsdError
from dpstack.gsd.check import check
from dpstack.gsd.configuration import configuration_like, configure, default_modules, plug
from dpstack.gsd.model import Device
from dpstack.gsd.prm import Reading, UserPrm

MODULAR = "Modular_Station = 1\nMax_Module = {most}\n"
TWO = 'Module = "head" 0x30\n1\nEndModule\nModule = "8 DI" 0x10\n2\nEndModule\n'


def slots(lines: str, most: int = 5, more: str = "") -> Device:
    return made(MODULAR.format(most=most) + more + f"SlotDefinition\n{lines}EndSlotDefinition\n" + TWO).device


# --- SlotDefinition --------------------------------------------------------------------------------------------------


def test_slots_that_are_not_listed_take_every_module_up_to_max_module() -> None:
    d = slots('Slot(1) = "head" 1 1\n')
    assert configure(d, ["head", "8 DI", "head", "", "8 DI"]).config.hex(" ") == "30 10 30 00 10"
    with pytest.raises(GsdError, match=r"module '8 DI' \(reference 2\) is not allowed in slot 1"):
        configure(d, ["8 DI"])
    with pytest.raises(GsdError, match="6 modules, the device takes at most 5"):
        configure(d, ["head"] * 6)


def test_counting_does_not_begin_at_the_lowest_listed_slot() -> None:
    d = slots('Slot(3) = "third" 2 2\n')
    assert configure(d, ["head", "head", "8 DI"]).device.first_slot == 1
    with pytest.raises(GsdError, match=r"is not allowed in slot 3 \(third\)"):
        configure(d, ["head", "head", "head"])


def test_counting_begins_at_modul_offset() -> None:
    d = slots('Slot(4) = "head" 1 1\n', more="Modul_Offset = 4\n")
    assert configure(d, ["head", "8 DI"]).device.first_slot == 4
    with pytest.raises(GsdError, match="is not allowed in slot 4"):
        configure(d, ["8 DI", "head"])


def test_defaults_of_slots_make_a_row_only_without_gaps() -> None:
    both = default_modules(slots('Slot(1) = "a" 1 1\nSlot(2) = "b" 2 2\n'))
    assert [m.name for m in both or ()] == ["head", "8 DI"]
    assert default_modules(slots('Slot(1) = "a" 1 1\nSlot(3) = "b" 2 2\n')) is None
    assert default_modules(slots('Slot(2) = "b" 2 2\n')) is None


def test_a_slot_without_a_list_takes_a_module_without_a_number() -> None:
    d = made(
        MODULAR.format(most=2) + 'SlotDefinition\nSlot(1) = "any"\nEndSlotDefinition\nModule = "x" 0x10\nEndModule\n'
    )
    assert configure(d.device, ["x"]).config == b"\x10"


def test_check_reports_slots_with_impossible_numbers() -> None:
    text = MODULAR.format(most=2) + 'SlotDefinition\nSlot(0) = "no" 1 1\nSlot(2) = "yes" 1 1\nEndSlotDefinition\n' + TWO
    assert [d.text for d in check(made(text))] == [
        "8:1: warning: Slot(0) is never used: the slots are 1..2 (Modul_Offset, else 1; Max_Module)"
    ]


# --- [SlotNumber] ----------------------------------------------------------------------------------------------------


def numbered(head: str = "", kind: str = "Unsigned8 1 1-12", name: str = "[SlotNumber]") -> Device:
    return made(
        f'{MODULAR.format(most=12)}{head}ExtUserPrmData = 7 "{name}"\n{kind}\nEndExtUserPrmData\n'
        'ExtUserPrmData = 8 "Filter"\nUnsigned8 3 0-9\nEndExtUserPrmData\n'
        'Module = "AI" 0x53\nExt_Module_Prm_Data_Len = 3\nExt_User_Prm_Data_Const(0) = 0xA0,0x01,0x00\n'
        "Ext_User_Prm_Data_Ref(1) = 7\nExt_User_Prm_Data_Ref(2) = 8\nEndModule\n"
        'Module = "bus head" 0x00\nPreset = 1\nExt_Module_Prm_Data_Len = 2\nExt_User_Prm_Data_Ref(1) = 7\nEndModule\n'
    ).device


@pytest.mark.parametrize(("reading", "filter_"), [(Reading.REFS, "03"), (Reading.CONST, "00")])
def test_each_module_gets_the_number_of_its_slot_in_both_readings(reading: Reading, filter_: str) -> None:
    found = configure(numbered(), ["AI", "", "AI"]).user_prm(reading)
    assert found.octets().hex() == f"a001{filter_}" + f"a003{filter_}"


@pytest.mark.parametrize("revision", [1, 3, 5])
def test_the_revision_of_the_file_does_not_matter(revision: int) -> None:
    d = numbered(f"GSD_Revision = {revision}\n")
    assert configure(d, ["AI", "AI"]).user_prm().octets().hex() == "a00103a00203"


def test_slot_numbers_count_from_modul_offset_and_fixed_presets_are_counted() -> None:
    d = numbered("Modul_Offset = 4\nFixPresetModules = 1\n")
    assert configure(d, ["AI", "", "AI"]).user_prm().octets().hex() == "0004" + "a00503" + "a00703"
    assert configure(d, ["AI", "", "AI"]).texts().first_slot == 4  # as diagnoses name it


def test_the_number_lies_in_its_bits_only() -> None:
    d = numbered(kind="BitArea(0-3) 1 0-15")
    assert configure(d, ["AI"] * 3).user_prm().octets().hex() == "a00103a00203a00303"


def test_the_slot_number_cannot_be_set_and_contradicts_nothing() -> None:
    prm = configure(numbered(name="[slotnumber]"), ["AI", "AI"]).user_prm()
    with pytest.raises(GsdError, match=r"2/\[slotnumber\]@1 is the number of the slot and cannot be set; leave it out"):
        prm.set("2/[SlotNumber]", 2)
    with pytest.raises(GsdError, match=r"1/\[slotnumber\]@1 is the number of the slot and cannot be set; leave it out"):
        prm.set("[SlotNumber]", 2)
    assert [c.field.key for c in prm.contradictions()] == ["1/Filter@2", "2/Filter@2"]
    assert [f.value for f in prm.fields if f.slot_number] == [1, 2]


def test_a_slot_number_outside_of_its_range_is_refused() -> None:
    d = numbered(kind="Unsigned8 4 4-6", head="Modul_Offset = 4\n")
    assert configure(d, ["AI"] * 3).user_prm().octets().hex() == "a00403a00503a00603"
    with pytest.raises(GsdError, match=r"module 'AI' cannot be in slot 7: its parameter \[SlotNumber\] allows 4..6"):
        configure(d, ["AI"] * 4)
    with pytest.raises(GsdError, match="module 'AI' cannot be in slot 1"):
        UserPrm(numbered(kind="Unsigned8 4 4-6"), d.modules[:1])
    with pytest.raises(GsdError, match=r"in slot 4: its parameter \[SlotNumber\] allows 0..3"):
        configure(numbered(kind="BitArea(0-1) 1", head="Modul_Offset = 4\n"), ["AI"])


def test_a_module_in_no_slot_keeps_the_default() -> None:
    d = numbered(kind="Unsigned8 4 4-6")
    assert UserPrm(d, d.modules[:1], in_slots=False).octets().hex() == "a00403"


def test_names_of_parameters_of_slot_0_and_of_the_device() -> None:
    d = made(
        MODULAR.format(most=2) + 'Modul_Offset = 0\nExtUserPrmData = 1 "p"\nUnsigned8 3\nEndExtUserPrmData\n'
        "Ext_User_Prm_Data_Ref(0) = 1\n"
        'Module = "a" 0x10\nExt_Module_Prm_Data_Len = 1\nExt_User_Prm_Data_Ref(0) = 1\nEndModule\n'
    ).device
    prm = configure(d, ["a"]).user_prm()
    assert [f.key for f in prm.fields] == ["device/p@0", "0/p@0"]
    prm.set("0/p", 9)
    assert prm.octets().hex() == "0309"
    prm.set("device/p", 8)
    assert prm.octets().hex() == "0809"


# --- fixed presets ---------------------------------------------------------------------------------------------------


def presets(fixed: int = 1, more: str = "", most: int = 4) -> Device:
    return made(
        f"{MODULAR.format(most=most)}FixPresetModules = {fixed}\n"
        'Module = "8 DO" 0x20\n1\nEndModule\nModule = "base" 0x11\n2\nPreset = 1\nEndModule\n'
        'Module = "option" 0x21\n3\nPreset = 1\nEndModule\nModule = "8 DI" 0x10\n4\nEndModule\n' + more
    ).device


@pytest.mark.parametrize(
    ("wanted", "config"),
    [
        (["8 DO", "8 DI"], "11 21 20 10"),
        (["base", "option", "8 DO", "8 DI"], "11 21 20 10"),
        ([2, "3", 1, 4], "11 21 20 10"),
        (["BASE", 3, "8 do", "8 DI"], "11 21 20 10"),
        (["", "8 DI"], "11 21 00 10"),
        ([], "11 21"),
        (None, "11 21"),
    ],
)
def test_fixed_presets_stand_first_named_or_not(wanted: list[int | str] | None, config: str) -> None:
    found = configure(presets(), wanted)
    assert found.config.hex(" ") == config
    assert [m.name for m in found.modules[:2] if m] == ["base", "option"]


@pytest.mark.parametrize(("wanted", "config"), [(None, "11 21"), (["8 DI", "base"], "10 11")])
def test_presets_without_the_keyword_are_defaults_only(wanted: list[int | str] | None, config: str) -> None:
    assert configure(presets(0), wanted).config.hex(" ") == config


def test_modules_of_a_diagnosis_count_from_the_fixed_presets() -> None:
    found = configure(presets(), ["8 DO"]).texts()
    assert [found.module_name(number) for number in range(4)] == ["base", "option", "8 DO", ""]


WRONG: list[list[int | str]] = [["base", "8 DO"], ["8 DI", "option"], ["base", "option", "base"], ["option", "base"]]


@pytest.mark.parametrize("wanted", WRONG)
def test_fixed_presets_elsewhere_or_twice_are_refused(wanted: list[int | str]) -> None:
    with pytest.raises(GsdError, match=r"is a fixed preset \(FixPresetModules = 1\) and stands once, in slot [12]; "):
        configure(presets(), wanted)


def test_fixed_presets_count_in_max_module() -> None:
    with pytest.raises(GsdError, match="5 modules with the 2 fixed presets, the device takes at most 4"):
        configure(presets(), ["8 DI"] * 3)


def test_more_fixed_presets_than_any_device_has_modules_are_refused() -> None:
    many = made("FixPresetModules = 1\n" + 'Module = "x" 0x10\nPreset = 1\nEndModule\n' * 256).device
    with pytest.raises(GsdError, match="256 fixed presets, Max_Module is 255 at most"):
        configure(many)


def test_a_module_that_shares_its_name_with_a_fixed_preset() -> None:
    twin = 'Module = "base" 0x11\n9\nEndModule\n'
    d = presets(more=twin)
    assert [m.reference for m in configure(d, ["base", "option", "base"]).modules if m] == [2, 3, 9]
    assert [m.reference for m in configure(d, ["8 DI", "base"]).modules if m] == [2, 3, 4, 9]
    assert [m.reference for m in plug(d, [d.modules[4]]).modules if m] == [2, 3, 9]


def test_the_module_of_a_telegram_stands_behind_the_fixed_presets() -> None:
    assert configuration_like(presets(), b"\x11\x21\x10", (0, 0)).config.hex(" ") == "11 21 10"


def test_a_simulated_slave_requires_its_fixed_presets_first() -> None:
    slave = slave_description(presets())
    assert slave.default_config.hex(" ") == "11 21"
    for good in ("11 21", "11 21 20 10", "11 21 00 10"):
        assert slave.check_cfg(bytes.fromhex(good)) is None
    assert slave.check_cfg(bytes.fromhex("20 10")) == (
        "the configuration does not begin with 11 21, the fixed presets of this slave"
    )
    assert slave.check_cfg(bytes.fromhex("11 21 11")) == (
        "octet 3 (11) of the configuration begins no module of this slave"
    )
    assert slave.check_cfg(bytes.fromhex("11 21 10 10 10")) == "5 modules, 4 are possible"
    only = made(MODULAR.format(most=1) + 'FixPresetModules = 1\nModule = "x" 0x10\nPreset = 1\nEndModule\n').device
    assert slave_description(only).configs == (b"\x10",)


# --- PROFIsafe -------------------------------------------------------------------------------------------------------

SAFE = (
    MODULAR.format(most=4) + 'FixPresetModules = 1\nModule = "F-DI" 0xC4,0x00\n5\nPreset = 1\n'
    "F_ParamDescCRC = 0x1234\nF_Ext_Module_Prm_Data_Len = 14\nF_Ext_User_Prm_Data_Const(0) = 0,0\nEndModule\n" + TWO
)


def test_modules_with_f_parameters_get_a_note() -> None:
    file = made(SAFE.replace("0xC4,0x00", "0x11"))
    found = configure(file.device, ["8 DI"])
    assert found.config.hex(" ") == "11 10"
    assert found.notes == (
        "module 'F-DI' (reference 5) in slot 1 has F_ parameters (PROFIsafe), but dpstack is no F-host: their F octets "
        "are missing in Set_Prm, which the device may refuse, and nothing safety-related works; use an F-host for them",
    )
    assert [d.text for d in check(file) if d.severity.value == "warning"] == [
        "8:1: warning: module 'F-DI' (reference 5) has F_ parameters (PROFIsafe), but dpstack is no F-host: their F "
        "octets are missing in Set_Prm, which the device may refuse, and nothing safety-related works; use an F-host "
        "for them"
    ]


def test_f_parameters_of_a_compact_device_get_a_note() -> None:
    file = made('F_Ext_User_Prm_Data_Const(0) = 0,0\nModule = "x" 0x10\nEndModule\n')
    assert configure(file.device).notes[0].startswith("the device itself has F_ parameters (PROFIsafe)")
    assert "the device itself has F_ parameters" in check(file)[0].message


def test_devices_without_f_parameters_get_no_note() -> None:
    assert not [d for d in check(made(TWO)) if "PROFIsafe" in d.message]


@given(names=st.lists(st.sampled_from(["AI", ""]), min_size=1, max_size=11), offset=st.integers(0, 9))
def test_presets_named_or_not_and_numbers_of_slots(names: list[str], offset: int) -> None:
    d = numbered(f"Modul_Offset = {offset}\nFixPresetModules = 1\n", "Unsigned8 1 0-255")
    left_out, named = configure(d, names), configure(d, ["bus head", *names])
    assert left_out == named
    octets = bytes((0, offset))
    for slot, name in enumerate(names, offset + 1):
        octets += bytes((0xA0, slot, 3)) if name else b""
    assert left_out.user_prm().octets() == octets
