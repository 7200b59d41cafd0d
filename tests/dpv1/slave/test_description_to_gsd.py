"""GSD files of slaves of one's own: every key in literal text, and reading them gives the same slave."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from api_kit import in_virtual_time
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack import World, open_bus
from dpstack.api.gsd_info import write_gsd
from dpstack.dpv1.slave.description import SlaveDescription, SlaveModule, SlaveParameter
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.dpv1.slave.description_to_gsd import as_gsd_file, gsd_octets
from dpstack.errors import ConfigError
from dpstack.gsd.check import check
from dpstack.gsd.dpv1_keywords import ALARM_KEYWORDS
from dpstack.gsd.model import DiagText
from dpstack.gsd.parser import load_gsd
from dpstack.gsd.prm import UserPrm
from dpstack.slave import DpSlave, UserDiag, channel_block, serve_slave
from dpstack.trace import Severity
from dpstack.units import BAUD_RATES

EMPTY = SlaveModule("empty slot", b"\0")
TANK = SlaveDescription(
    ident=0x4711,
    name="Tank 3000",
    vendor="Mustermann & Söhne",
    revision="V1.2",
    configs=(b"\x11\x20",),
    user_prm_len=(3, 20),
    dpv1=True,
    alarms=("process", "diagnostic"),
    alarm_sequence=8,
    ms2=2,
    ms2_max_len=64,
    ms2_max_initiate=52,
    rates={500_000: 100, 12_000_000: 800},
    min_slave_interval_ns=600_000,
    max_diag_len=32,
    parameters=(
        SlaveParameter("Diagnosis", 3, "Bit(3)", 1, ((0, 1),), {0: "off", 1: "on"}),
        SlaveParameter("Delay", 4, "Unsigned16", 500, ((0, 1000), (2000, 2000))),
        SlaveParameter("Offset", 6, "Signed8", -5),
    ),
    diag_texts=(
        DiagText("channel", None, None, 17, "valve stuck", "clean it"),
        DiagText("bit", 0, 0, 1, "fuse blown", "replace F1"),
        DiagText("area", 8, 11, 5, "too hot", ""),
        DiagText("not_bit", 1, 1, 0, "no air", ""),
    ),
)
FILE = """; Made by dpstack gsd write from the description of a slave.
#Profibus_DP
GSD_Revision = 5
Vendor_Name = "Mustermann & Söhne"
Model_Name = "Tank 3000"
Revision = "V1.2"
Ident_Number = 0x4711
Protocol_Ident = 0
Station_Type = 0
FMS_supp = 0
Hardware_Release = "V1.0"
Software_Release = "V1.0"
9.6_supp = 0
19.2_supp = 0
31.25_supp = 0
45.45_supp = 0
93.75_supp = 0
187.5_supp = 0
500_supp = 1
1.5M_supp = 0
3M_supp = 0
6M_supp = 0
12M_supp = 1
MaxTsdr_500 = 100
MaxTsdr_12M = 800
Redundancy = 0
Repeater_Ctrl_Sig = 0
24V_Pins = 0
Implementation_Type = "dpstack"
Freeze_Mode_supp = 1
Sync_Mode_supp = 1
Auto_Baud_supp = 0
Set_Slave_Add_supp = 0
Fail_Safe = 0
Min_Slave_Intervall = 6
Max_Diag_Data_Len = 32
Max_User_Prm_Data_Len = 20
Slave_Family = 0
Modular_Station = 0
FixPresetModules = 1
DPV1_Slave = 1
C1_Read_Write_supp = 1
C1_Max_Data_Len = 240
C1_Response_Timeout = 100
Process_Alarm_supp = 1
Diagnostic_Alarm_supp = 1
Alarm_Type_Mode_supp = 1
Alarm_Sequence_Mode_Count = 8
Prm_Block_Structure_supp = 1
C2_Read_Write_supp = 1
C2_Max_Data_Len = 64
C2_Response_Timeout = 100
C2_Max_Count_Channels = 2
Max_Initiate_PDU_Length = 52
PrmText = 1
Text(0) = "off"
Text(1) = "on"
EndPrmText
ExtUserPrmData = 1 "Diagnosis"
Bit(3) 1 0-1
Prm_Text_Ref = 1
EndExtUserPrmData
ExtUserPrmData = 2 "Delay"
Unsigned16 500 0-1000,2000
EndExtUserPrmData
ExtUserPrmData = 3 "Offset"
Signed8 -5 -128-127
EndExtUserPrmData
Ext_User_Prm_Data_Const(0) = 0x80, 0x00, 0x00, 0x08, 0x01, 0xF4, 0xFB
Ext_User_Prm_Data_Ref(3) = 1
Ext_User_Prm_Data_Ref(4) = 2
Ext_User_Prm_Data_Ref(6) = 3
Unit_Diag_Bit(0) = "fuse blown"
Unit_Diag_Bit_Help(0) = "replace F1"
Unit_Diag_Not_Bit(1) = "no air"
Unit_Diag_Area = 8-11
Value(5) = "too hot"
Unit_Diag_Area_End
Channel_Diag(17) = "valve stuck"
Channel_Diag_Help(17) = "clean it"
Module = "2 octets in, 1 octet out" 0x11, 0x20
1
Preset = 1
EndModule
"""


def test_every_key_of_a_file() -> None:
    octets, (_, remarks) = gsd_octets(TANK), as_gsd_file(TANK)
    assert octets.decode("latin-1") == FILE.replace("\n", "\r\n")
    assert remarks == ("user_prm_len 3..20: a GSD file says the most, 20; a master that has it sends 7 octets",)
    assert check(load_gsd(octets, "tank.gsd")) == ()


def test_a_modular_slave() -> None:
    rack = SlaveDescription(
        ident=1,
        name="rack",
        presets=(SlaveModule("head", b"\x42\x01\x02\x03"),),
        modules=(
            SlaveModule("8 DI", b"\x10", b"\x01\x00", (SlaveParameter("Filter", 1, "BitArea(0-3)", 5),)),
            SlaveModule("8 DO", b"\x20"),
        ),
        max_modules=5,
        max_input_len=8,
        max_output_len=9,
        max_data_len=17,
        fail_safe_required=True,
        wd_base_1ms=True,
    )
    _, remarks = as_gsd_file(rack)
    lines = gsd_octets(rack).decode("latin-1").splitlines()
    assert lines[lines.index("Modular_Station = 1") :] == [
        "Modular_Station = 1",
        "Max_Module = 5",
        "Max_Input_Len = 8",
        "Max_Output_Len = 9",
        "Max_Data_Len = 17",
        "Modul_Offset = 1",
        "FixPresetModules = 1",
        "DPV1_Slave = 0",
        "WD_Base_1ms_supp = 1",
        "Fail_Safe_required = 1",
        'ExtUserPrmData = 1 "Filter"',
        "BitArea(0-3) 5 0-15",
        "EndExtUserPrmData",
        'Module = "head" 0x42, 0x01, 0x02, 0x03',
        "1",
        "Preset = 1",
        "EndModule",
        'Module = "8 DI" 0x10',
        "2",
        "Ext_Module_Prm_Data_Len = 2",
        "Ext_User_Prm_Data_Const(0) = 0x01, 0x05",
        "Ext_User_Prm_Data_Ref(1) = 1",
        "EndModule",
        'Module = "8 DO" 0x20',
        "3",
        "EndModule",
    ]
    assert lines.count("MaxTsdr_9.6 = 60") == lines.count("MaxTsdr_12M = 800") == 1  # all rates
    assert remarks == (
        "a master may leave slots empty, which the slave refuses; add SlaveModule('empty slot', b'\\0')",
    )


# --- round trip -------------------------------------------------------------------------------------------------------
names = st.text(st.sampled_from("abz AZ09_-+;,=()/\\'äöüß#&<>"), min_size=1, max_size=20).map(str.strip).filter(bool)
configs = st.sampled_from([b"\x10", b"\x21", b"\x11\x20", b"\xc0\x83\x81\x01\x02", b"\x40\x05", b"\x54", b"\x00"])


@st.composite
def parameters(draw: st.DrawFn, at: int = 3) -> tuple[SlaveParameter, ...]:
    """Parameters from octet ``at`` on, up to octet 30, one behind the other."""
    found = []
    for _ in range(draw(st.integers(0, 4))):
        kind, low, high, size = draw(
            st.sampled_from(
                [
                    ("Unsigned8", 0, 255, 1),
                    ("Signed8", -128, 127, 1),
                    ("Unsigned16", 0, 65535, 2),
                    ("Signed32", -(2**31), 2**31 - 1, 4),
                    ("Bit(0)", 0, 1, 1),
                    ("Bit(9)", 0, 1, 2),
                    ("BitArea(2-4)", 0, 7, 1),
                ]
            )
        )
        first = draw(st.integers(low, high))
        last = draw(st.integers(first, high))
        allowed = draw(st.sampled_from([(), ((first, last),), ((low, low), (last, last))]))
        default = draw(st.sampled_from([last if allowed else low, low if low in (first,) or not allowed else last]))
        texts = draw(st.dictionaries(st.integers(low, high), names, max_size=3))
        found.append(SlaveParameter(draw(names), at, kind, default, allowed, texts))
        at += size
    return tuple(found)


bit_texts = st.builds(
    lambda kind, bit, text, help: DiagText(kind, bit, bit, int(kind == "bit"), text, help),
    st.sampled_from(["bit", "not_bit"]),
    st.integers(0, 40),
    names,
    st.just("") | names,
)
area_texts = st.builds(
    lambda first, value, text: DiagText("area", first, first + 3, value, text, ""),
    st.sampled_from([0, 8, 64]),
    st.integers(0, 15),
    names,
)
channel_texts = st.builds(
    lambda error, text: DiagText("channel", None, None, error, text, ""), st.integers(16, 31), names
)


@st.composite
def descriptions(draw: st.DrawFn) -> SlaveDescription:
    dpv1 = draw(st.booleans())
    alarms = tuple(kind for kind in ALARM_KEYWORDS if dpv1 and draw(st.booleans()))
    modular = draw(st.booleans())
    modules = tuple(
        draw(st.lists(st.builds(SlaveModule, names, configs.filter(lambda c: c != b"\0")), min_size=1, max_size=3))
    )
    presets = tuple(draw(st.lists(st.builds(SlaveModule, names, configs), max_size=2)))
    return SlaveDescription(
        ident=draw(st.integers(0, 0xFFFF)),
        name=draw(names),
        vendor=draw(st.just("") | names),
        revision=draw(st.just("") | names),
        configs=() if modular else tuple(draw(st.lists(configs, min_size=1, max_size=3))),
        modules=(*modules, EMPTY)[: draw(st.integers(len(modules), len(modules) + 1))] if modular else (),
        presets=presets if modular else (),
        max_modules=draw(st.integers(1, 300)),
        max_input_len=draw(st.integers(16, 244)) if modular else 244,
        user_prm_len=(draw(st.integers(0, 30)), draw(st.integers(34, 237))),
        sync=draw(st.booleans()),
        freeze=draw(st.booleans()),
        fail_safe=draw(st.booleans()),
        fail_safe_required=draw(st.booleans()),
        set_slave_add=draw(st.booleans()),
        wd_base_1ms=draw(st.booleans()),
        dpv1=dpv1,
        prm_blocks=draw(st.booleans()),
        prm_blocks_required=draw(st.booleans()),
        ms2=draw(st.integers(0, 49)),
        ms2_max_len=draw(st.integers(1, 240)),
        ms2_max_initiate=draw(st.integers(20, 244)),
        alarms=draw(st.permutations(alarms).map(tuple)),
        alarm_sequence=draw(st.sampled_from([0, 2, 9, 32])) if dpv1 else 0,
        extra_alarm_sap=dpv1 and draw(st.booleans()),
        max_diag_len=draw(st.integers(10 if alarms else 6, 244)),
        rates=draw(st.dictionaries(st.sampled_from(BAUD_RATES), st.integers(0, 800), max_size=4)),
        min_slave_interval_ns=draw(st.integers(0, 6_000_000_000)),
        parameters=draw(parameters()),
        diag_texts=tuple(draw(st.lists(bit_texts | area_texts | channel_texts, max_size=5))),
    )


@examples(8)
@given(descriptions())
def test_reading_a_file_gives_the_slave_again(slave: SlaveDescription) -> None:
    said, _ = as_gsd_file(slave)
    octets = gsd_octets(slave)
    file = load_gsd(octets, "own.gsd")
    assert [found.text for found in check(file) if found.severity is not Severity.INFO] == []
    assert slave_description(file.device) == said
    again, remarks = as_gsd_file(said)
    assert (again, remarks) == (said, ())  # nothing is lost a second time
    assert said.default_config == slave.default_config
    kept = (
        "ident",
        "sync",
        "freeze",
        "fail_safe",
        "fail_safe_required",
        "set_slave_add",
        "dpv1",
        "ms2",
        "max_diag_len",
    )
    assert [getattr(said, name) for name in kept] == [getattr(slave, name) for name in kept]
    assert said.alarm_support.kinds == slave.alarm_support.kinds
    least = len(UserPrm(file.device).octets())
    assert slave.check_prm(bytes(least)) is None or slave.prm_blocks_required  # what a master sends without a change


# --- errors and the command -------------------------------------------------------------------------------------------
ONE = SlaveDescription.simple(1, inputs=1, outputs=1)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"name": 'a "tank"'}, "the name 'a \"tank\"' holds a quote"),
        ({"name": "x" * 33}, "has 33 characters; a GSD file allows 32"),
        ({"vendor": "株式会社"}, "letters of Western Europe only"),
        ({"vendor": "Ã¤"}, "would be read as other letters"),
        ({"rates": {1_000_000: 100}}, "1000000 bit/s is no rate of PROFIBUS"),
        ({"parameters": (SlaveParameter("a", 0, "Word"),)}, "parameter a: type 'Word'; write Unsigned8"),
        ({"parameters": (SlaveParameter("a", 237),)}, "reach to octet 237, user_prm_len allows 237 octets"),
        ({"parameters": (SlaveParameter("a", -1),)}, "octet -1; octets count from 0"),
        ({"dpv1": True, "parameters": (SlaveParameter("a", 2),)}, "octet 2; the first 3 are DPV1_Status"),
        ({"parameters": (SlaveParameter("a", 0, default=300),)}, "default 300 is not allowed (0..255)"),
        ({"parameters": (SlaveParameter("a", 0, allowed=((0, 256),)),)}, "allowed 0..256 do not fit Unsigned8"),
        (
            {"configs": (), "modules": (SlaveModule("m", b"\x10", b"", (SlaveParameter("a", 300),)),)},
            "module m: more than 237 octets of user parameters",
        ),
        ({"diag_texts": (DiagText("bits", 0, 0, 1, "x", ""),)}, "kind 'bits'; one of bit, not_bit, area, channel"),
        ({"diag_texts": (DiagText("channel", None, None, 6, "x", ""),)}, "error 6 of a channel; 16..31 are possible"),
    ],
)
def test_slaves_without_a_gsd_file(changes: dict[str, object], says: str) -> None:
    with pytest.raises(ConfigError) as told:
        as_gsd_file(dataclasses.replace(ONE, **changes))  # type: ignore[arg-type]
    assert says in str(told.value)


def test_areas_that_end_at_the_same_bit_are_two() -> None:
    texts = (DiagText("area", 0, 3, 5, "from bit 0", ""), DiagText("area", 1, 3, 5, "from bit 1", ""))
    assert as_gsd_file(dataclasses.replace(TANK, diag_texts=texts))[0].diag_texts == texts


@in_virtual_time
async def test_a_master_with_the_written_file(tmp_path: Path) -> None:
    """A master that knows only the file brings the slave up and reads its diagnosis in words."""
    assert len(write_gsd(TANK, tmp_path / "tank.gsd")) == 1
    slave = DpSlave(TANK, lambda outputs, elapsed: outputs + b"\x07")
    world = World()
    table = {"name": "tank", "address": 9, "gsd": str(tmp_path / "tank.gsd"), "parameters": {"Delay": 2000}}
    seen: list[bytes] = []
    slave = DpSlave(TANK, lambda outputs, elapsed: outputs + b"\x07", on_prm=lambda prm: seen.append(prm[3:]))
    async with (
        serve_slave(slave, world=world, address=9),
        open_bus(world=world, baud=500_000, slaves=[table]) as bus,
    ):
        await bus.operate()
        await bus.ready(3)
        slave.diag = UserDiag.of(channel_block(0, 2, 17, input=True))
        await bus.rotated(bus.stats.rotations + 8)
        assert bus.slave("tank").inputs == b"\0\x07"
        assert [text for text in bus.slave("tank").diagnosis_texts if "valve stuck (clean it)" in text] != []
    assert seen == [bytes.fromhex("08 07 D0 FB")]  # Diagnosis on, 2000, -5
