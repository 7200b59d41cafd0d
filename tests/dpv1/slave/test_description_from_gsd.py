"""The slave of a GSD file: each keyword, its limits, its absence; modules, presets, user parameters."""

from __future__ import annotations

from typing import Any

import pytest
from gsd_kit import made
from msgspec import structs

from dpstack.dpv1.slave.description import SlaveDescription, SlaveModule, SlaveParameter
from dpstack.dpv1.slave.description_from_gsd import EMPTY_SLOT, slave_description
from dpstack.errors import ConfigError
from dpstack.gsd.configuration import plug
from dpstack.gsd.model import Device, DiagText, Module, PrmBlock, PrmConst

COMPACT = 'Module = "a" 0x10\nEndModule\nModule = "b" 0x21\nEndModule\nModule = "c" 0x10\nEndModule\n'
MODULAR = "Modular_Station = 1\nMax_Module = 3\n" + COMPACT
MODULES = tuple(SlaveModule(name, config) for name, config in (("a", b"\x10"), ("b", b"\x21"), ("c", b"\x10")))
#: the file that says nothing more
PLAIN: dict[str, Any] = {
    "ident": 0x0FFE,
    "name": "slave",
    "configs": (b"\x10", b"\x21"),
    "user_prm_len": (0, 237),
    "sync": False,
    "freeze": False,
    "prm_blocks": False,
    "rates": {500_000: 0},
}
V1 = "DPV1_Slave = 1\n"


def described(text: str) -> SlaveDescription:
    return slave_description(made(text).device)


@pytest.mark.parametrize(
    ("text", "differs"),
    [
        ("", {}),
        ('Vendor_Name = "V"\nModel_Name = "M"\nRevision = "R"\n', {"vendor": "V", "name": "M", "revision": "R"}),
        ("Freeze_Mode_supp = 1\n", {"freeze": True}),
        ("Sync_Mode_supp = 1\n", {"sync": True}),
        ("Fail_Safe = 1\n", {"fail_safe": True}),
        ("Fail_Safe_required = 1\n", {"fail_safe_required": True}),
        ("Set_Slave_Add_supp = 1\n", {"set_slave_add": True}),
        ("WD_Base_1ms_supp = 1\n", {"wd_base_1ms": True}),
        ("MaxTsdr_500 = 100\n", {"rates": {500_000: 100}}),
        ("12M_supp = 1\nMaxTsdr_12M = 800\n", {"rates": {500_000: 0, 12_000_000: 800}}),
        ("Min_Slave_Intervall = 6\n", {"min_slave_interval_ns": 600_000}),
        ("Max_Diag_Data_Len = 6\n", {"max_diag_len": 6}),
        ("Max_Diag_Data_Len = 33\n", {"max_diag_len": 33}),
        ("Max_User_Prm_Data_Len = 9\n", {"user_prm_len": (0, 9)}),
        ("User_Prm_Data_Len = 4\nUser_Prm_Data = 1,2,3,4\n", {"user_prm_len": (0, 4)}),
        ("Max_User_Prm_Data_Len = 9\nUser_Prm_Data_Len = 4\nUser_Prm_Data = 1,2,3,4\n", {"user_prm_len": (0, 9)}),
        # lengths count for a modular station only
        ("Max_Input_Len = 1\nMax_Output_Len = 1\nMax_Data_Len = 1\n", {}),
        (V1, {"dpv1": True}),
        (V1 + "Max_User_Prm_Data_Len = 3\n", {"dpv1": True, "user_prm_len": (0, 3)}),
        (V1 + "Max_User_Prm_Data_Len = 2\n", {"user_prm_len": (0, 2)}),
        (V1 + "Prm_Block_Structure_supp = 1\n", {"dpv1": True, "prm_blocks": True}),
        (V1 + "Prm_Block_Structure_req = 1\n", {"dpv1": True, "prm_blocks_required": True}),
        ("C2_Read_Write_supp = 1\n", {"ms2": 1}),
        ("C2_Read_Write_supp = 1\nC2_Max_Count_Channels = 2\n", {"ms2": 2}),
        ("C2_Read_Write_supp = 1\nC2_Max_Count_Channels = 49\n", {"ms2": 49}),
        ("C2_Read_Write_supp = 1\nC2_Max_Count_Channels = 50\n", {"ms2": 49}),
        ("C2_Max_Count_Channels = 2\n", {}),
        ("C2_Max_Data_Len = 64\n", {"ms2_max_len": 64}),
        ("C2_Max_Data_Len = 241\n", {}),
        ("C2_Max_Data_Len = 0\n", {}),
        ("Max_Initiate_PDU_Length = 52\n", {"ms2_max_initiate": 52}),
        ("Max_Initiate_PDU_Length = 19\n", {"ms2_max_initiate": 20}),
        ("Max_Initiate_PDU_Length = 0\n", {}),
        (V1 + "Process_Alarm_supp = 1\nStatus_Alarm_supp = 1\n", {"dpv1": True, "alarms": ("process", "status")}),
        ("Process_Alarm_supp = 1\nAlarm_Sequence_Mode_Count = 4\nExtra_Alarm_SAP_supp = 1\n", {}),
        (V1 + "Alarm_Sequence_Mode_Count = 2\n", {"dpv1": True, "alarm_sequence": 2}),
        (V1 + "Alarm_Sequence_Mode_Count = 1\n", {"dpv1": True}),
        (V1 + "Alarm_Sequence_Mode_Count = 32\n", {"dpv1": True, "alarm_sequence": 32}),
        (V1 + "Alarm_Sequence_Mode_Count = 33\n", {"dpv1": True, "alarm_sequence": 32}),
        (V1 + "Extra_Alarm_SAP_supp = 1\n", {"dpv1": True, "extra_alarm_sap": True}),
        (
            V1 + "Process_Alarm_supp = 1\nMax_Diag_Data_Len = 10\n",
            {"dpv1": True, "alarms": ("process",), "max_diag_len": 10},
        ),
        # no room for an alarm, so there is none
        (
            V1 + "Process_Alarm_supp = 1\nExtra_Alarm_SAP_supp = 1\nMax_Diag_Data_Len = 9\n",
            {"dpv1": True, "max_diag_len": 9},
        ),
        (
            'Unit_Diag_Bit(3) = "hot"\n',
            {"diag_texts": (DiagText("bit", 3, 3, 1, "hot", ""),)},
        ),
        (
            'PrmText = 1\nText(0) = "no"\nText(1) = "yes"\nEndPrmText\n'
            'ExtUserPrmData = 7 "P"\nBit(3) 1 0-1\nPrm_Text_Ref = 1\nEndExtUserPrmData\n'
            "Ext_User_Prm_Data_Const(0) = 0x00,0x08\nExt_User_Prm_Data_Ref(1) = 7\nMax_User_Prm_Data_Len = 2\n",
            {
                "user_prm_len": (0, 2),
                "parameters": (SlaveParameter("P", 1, "Bit(3)", 1, ((0, 1),), {0: "no", 1: "yes"}),),
            },
        ),
    ],
)
def test_keywords_of_a_compact_slave(text: str, differs: dict[str, Any]) -> None:
    assert described(text + COMPACT) == SlaveDescription(**PLAIN | differs)


@pytest.mark.parametrize(
    ("text", "differs"),
    [
        (MODULAR, {}),
        (MODULAR.replace("Max_Module = 3\n", ""), {"max_modules": 244}),
        (
            MODULAR + "Max_Input_Len = 5\nMax_Output_Len = 6\nMax_Data_Len = 7\n",
            {"max_input_len": 5, "max_output_len": 6, "max_data_len": 7},
        ),
        (
            MODULAR + "Max_Input_Len = 300\nMax_Output_Len = 300\nMax_Data_Len = 600\n",
            {"max_input_len": 244, "max_output_len": 244, "max_data_len": 488},
        ),
        (
            MODULAR + 'FixPresetModules = 1\nModule = "p" 0x30\nPreset = 1\nEndModule\n',
            {"presets": (SlaveModule("p", b"\x30"),)},
        ),
        # without FixPresetModules it is a module as any other
        (
            MODULAR + 'Module = "p" 0x30\nPreset = 1\nEndModule\n',
            {"modules": (*MODULES, SlaveModule("p", b"\x30"), EMPTY_SLOT)},
        ),
        # identifier octets that contradict themselves, and a module that the file breaks off in
        (MODULAR + 'Module = "w" 0x80\nEndModule\nModule = "x" 0x11\n', {}),
    ],
)
def test_keywords_of_a_modular_slave(text: str, differs: dict[str, Any]) -> None:
    modular = {"configs": (), "modules": (*MODULES, EMPTY_SLOT), "max_modules": 3}
    assert described(text) == SlaveDescription(**PLAIN | modular | differs)


def test_fixed_presets_alone_are_the_whole_slave() -> None:
    text = 'Modular_Station = 1\nMax_Module = 3\nFixPresetModules = 1\nModule = "p" 0x30\nPreset = 1\nEndModule\n'
    assert described(text) == SlaveDescription(**PLAIN | {"configs": (b"\x30",), "max_modules": 3})


def test_a_slave_accepts_the_chosen_modules_only() -> None:
    prm = "Ext_Module_Prm_Data_Len = 4\nExt_User_Prm_Data_Const(0) = 1,2,3,4\n"
    text = MODULAR + f'Max_User_Prm_Data_Len = 9\nModule = "d" 0x31\n{prm}EndModule\n'
    for more, lengths, v1 in (
        ("", (4, 4), False),
        (V1, (4, 4), True),
        (V1 + "Prm_Block_Structure_supp = 1\n", (4, 9), True),
        (V1 + "Prm_Block_Structure_req = 1\n", (4, 9), True),
        ("Prm_Block_Structure_supp = 1\n", (4, 4), False),
    ):
        device = made(more + text).device
        found = slave_description(device, plug(device, [device.modules[3], device.modules[1]]))
        assert (found.configs, found.modules, found.presets) == ((b"\x31\x21",), (), ())
        assert (found.user_prm_len, found.dpv1, found.max_modules) == (lengths, v1, 3)
    device = made(text).device
    plain = slave_description(device, plug(device, [device.modules[0]]))
    assert (plain.configs, plain.user_prm_len) == ((b"\x10",), (0, 9))


def test_name_and_ident() -> None:
    device = made(COMPACT).device
    assert slave_description(device, name="mine").name == "mine"
    assert slave_description(device, ident=7).ident == 7
    assert slave_description(device, ident=0).ident == 0
    bare = structs.replace(device, ident=None)
    assert slave_description(bare, ident=7).ident == 7
    for model, who in (("", "the GSD file"), ("M 1", "M 1")):
        with pytest.raises(ConfigError) as refused:
            slave_description(structs.replace(bare, model=model))
        assert str(refused.value) == f"{who} has no Ident_Number; give ident"
        with pytest.raises(ConfigError) as refused:
            slave_description(Device(ident=1, model=model, modules=(Module("e", b""), Module("w", b"\x80"))))
        assert str(refused.value) == f"{who} has no module with identifier octets"


@pytest.mark.parametrize(
    ("block", "octets"),
    [
        (PrmBlock(), b""),
        (PrmBlock(3), bytes(3)),
        (PrmBlock(None, (PrmConst(1, b"\1\2"),)), b"\0\1\2"),
        (PrmBlock(None, (PrmConst(2, b"\3"), PrmConst(0, b"\1\2"))), b"\1\2\3"),
        (PrmBlock(4, (PrmConst(1, b"\1\2"),)), b"\0\1\2\0"),
        (PrmBlock(2, (PrmConst(1, b"\1\2"),)), b"\0\1"),
        (PrmBlock(237), bytes(237)),
        (PrmBlock(238), b""),  # no Set_Prm has room for them
        (PrmBlock(None, (PrmConst(236, b"\1"),)), bytes(236) + b"\1"),
        (PrmBlock(None, (PrmConst(237, b"\1"),)), b""),
        (PrmBlock(2, (PrmConst(237, b"\1"),)), b""),
    ],
)
def test_user_parameters_of_a_module(block: PrmBlock, octets: bytes) -> None:
    device = Device(ident=1, modular=True, modules=(Module("m", b"\x10", prm=block),))
    assert slave_description(device).modules == (SlaveModule("m", b"\x10", octets), SlaveModule("empty slot", b"\0"))


def test_parameters_of_a_module_by_name() -> None:
    text = (
        'ExtUserPrmData = 7 "P"\nUnsigned16 5 1-9\nEndExtUserPrmData\nModular_Station = 1\nModule = "m" 0x10\n'
        "Ext_Module_Prm_Data_Len = 3\nExt_User_Prm_Data_Ref(1) = 7\nExt_User_Prm_Data_Ref(0) = 8\nEndModule\n"
    )
    (module, _) = described(text).modules
    assert module.parameters == (SlaveParameter("P", 1, "Unsigned16", 5, ((1, 9),)),)
