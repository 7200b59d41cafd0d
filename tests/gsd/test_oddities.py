"""Mistakes in GSD files: each finding has line, column, severity and text; no file raises an exception. The DP-V1
keywords: ranges, and contradictions between them."""

from __future__ import annotations

import gsd_kit
import pytest
from gsd_kit import HEAD, errors, made, texts

from dpstack.api.gsd_info import REQUIRES, flags_of
from dpstack.errors import ConfigError, GsdError
from dpstack.gsd.check import check
from dpstack.gsd.parser import load_gsd, parse_gsd
from dpstack.gsd.text import MAX_OCTETS


@pytest.mark.parametrize(
    ("octets", "message"),
    [
        (b"", "the file is empty; get a whole copy of it"),
        (b"\r\n \t\n\x00\x1a", "the file is empty; get a whole copy of it"),
        (b"<?xml version='1.0'?>", "no GSD file but an XML or HTML text, perhaps a GSDML file of PROFINET"),
        (b"\xef\xbb\xbf<ISO15745Profile>", "no GSD file but an XML or HTML text"),
        (b"PK\x03\x04rest", "no GSD file but a ZIP archive: unpack it"),
        (b"BM\0\0", "no GSD file but a bitmap"),
        (b"%PDF-1.4", "no GSD file but a PDF document"),
        (b"[bus]\nport = 1\n", "no GSD file: no line #Profibus_DP; give the .gsd"),
        (b"#Profibus_DP\nbut nothing else\n", "nothing to use: neither Ident_Number nor a module is in it"),
        (b'text = "#Profibus_DP"\n', "no GSD file: no line #Profibus_DP"),
        (bytes(range(256)) * 300, "no GSD file: no line #Profibus_DP"),
        (b"x" * (MAX_OCTETS + 1), "no GSD file: more than 8 MB"),
    ],
)
def test_files_that_are_no_gsd_files(octets: bytes, message: str) -> None:
    file = parse_gsd(octets, "x.gsd")
    assert file.fatal is not None
    assert file.fatal.message.startswith(message)
    assert errors(file)
    with pytest.raises(GsdError) as caught:
        load_gsd(octets, "x.gsd")
    assert str(caught.value) == f"x.gsd:1: {file.fatal.message}"
    assert isinstance(caught.value, ConfigError)


def test_fifty_megabytes_of_noise() -> None:
    assert parse_gsd(b"#Profibus_DP\n" + b"\xa5\x00;\\\n" * 10_000_000).fatal is not None


@pytest.mark.parametrize(
    ("text", "place", "says"),
    [
        ('Text(0) = "a"', "5:1", "Text does not belong here (outside of all blocks); kept as it stands"),
        ("EndModule", "5:1", "EndModule ends nothing here; it is skipped"),
        ("24V_Pins = some", "5:12", "24V_Pins = some is no number; left out"),
        ("Slave_Family = x@y", "5:16", "Slave_Family = x@y begins with no number; left out"),
        ('OrderNumber = "open', "5:15", "OrderNumber: the text has no closing quote"),
        ("Max_Module = many", "5:14", "Max_Module = many is no number; left out"),
        ("Max_Input_Len = 245", "5:17", "Max_Input_Len = 245 is outside 0..244"),
        ('Vendor_Name = "open', "5:15", "Vendor_Name: the text has no closing quote"),
        ("Ext_User_Prm_Data_Ref(a) = 1", "5:28", "Ext_User_Prm_Data_Ref(a) = 1 cannot be read; it is left out"),
        ("Ext_User_Prm_Data_Const(0) = 256", "5:30", "Ext_User_Prm_Data_Const(0) = 256 cannot be read; it is left out"),
        (
            "Ext_User_Prm_Data_Ref(0) = 5",
            "5:1",
            "ExtUserPrmData 5 is referred to but nowhere defined; the reference is skipped",
        ),
        (
            'PrmText = 1\nText(x) = "a"\nEndPrmText',
            "6:11",
            "Text: x in parentheses is no number; this value is left out",
        ),
        (
            'PrmText = one\nText(0) = "a"\nEndPrmText',
            "5:11",
            "PrmText = one is not a number; the block is kept as it stands",
        ),
        (
            "PrmText = 1\nMax_Module = 3\nEndPrmText",
            "6:1",
            "Max_Module does not belong here (in PrmText 1); kept as it stands",
        ),
        (
            'Unit_Diag_Area = 0-1\nValue(4) = "never"\nUnit_Diag_Area_End',
            "6:12",
            "Value(4) does not fit bits 0..1; it can never be shown",
        ),
        (
            "Unit_Diag_Area = wide\nUnit_Diag_Area_End",
            "5:18",
            "Unit_Diag_Area = wide is not bits like 0-7; the block is kept as it stands",
        ),
        (
            "User_Prm_Data_Len = 3\nUser_Prm_Data = 1,2",
            "6:1",
            "User_Prm_Data has 2 octets, User_Prm_Data_Len is 3; all 2 are used",
        ),
        (
            'SlotDefinition\nSlot(1) = "a" 9 1-3\nEndSlotDefinition',
            "6:11",
            "Slot(1): the default module 9 is not among those allowed (1..3)",
        ),
        ("Station_Type = 1", "5:1", "Station_Type is not 0: the file is of a master"),
        ('Module = "m" 0x10\n1\n2\nEndModule', "7:1", "module 'm' has two references, 1 and 2; the last one counts"),
        (
            'Module = "m 0x10\nEndModule',
            "5:10",
            'Module = "m 0x10 is not a name in quotes; the block is kept as it stands',
        ),
    ],
)
def test_finding(text: str, place: str, says: str) -> None:
    assert f"{place}: warning: {says}" in texts(made(f"{text}\n"))


def test_a_block_that_never_ends() -> None:
    text = 'PrmText = 1\nExtUserPrmData = 1 "a"\nBit(0) 0 0-1\nEndExtUserPrmData\n'
    says = "PrmText 1 never ends: EndPrmText is missing before ExtUserPrmData on line 6"
    assert f"5:1: error: {says}" in texts(made(text))


@pytest.mark.parametrize(
    ("line", "place", "says"),
    [
        ("Bit(99) 0 0-1", "6:9", "ExtUserPrmData 1: Bit(99) names no bits of 0..31; the parameter is left out"),
        ("Unsigned8 300 0-255", "6:11", "ExtUserPrmData 1: default 300 does not fit Unsigned8; its low bits are used"),
        ("Unsigned8 9 0-5", "6:11", "ExtUserPrmData 1: default 9 is not among the allowed values 0..5"),
        (
            "Unsigned8 1 low",
            "6:11",
            "ExtUserPrmData 1: allowed values 'low' cannot be read; every value of Unsigned8 is allowed",
        ),
        ("Unsigned8", "6:10", "ExtUserPrmData 1: no default value in Unsigned8 ; the parameter is left out"),
        ("Prm_Text_Ref = 4\nUnsigned8 0", "5:1", "ExtUserPrmData 1 refers to PrmText 4, which is nowhere defined"),
    ],
)
def test_finding_in_a_parameter(line: str, place: str, says: str) -> None:
    assert f"{place}: warning: {says}" in texts(made(f'ExtUserPrmData = 1 "a"\n{line}\nEndExtUserPrmData\n'))


def test_a_file_without_ident_number() -> None:
    file = parse_gsd(b'#Profibus_DP\n500_supp = 1\nModule = "m" 0x10\nEndModule\n')
    assert file.fatal is None
    assert [d.message for d in errors(file)] == [
        "no Ident_Number: the file is damaged, or it is of no DP slave; get a whole copy of it"
    ]


def test_at_most_500_findings_of_a_severity_are_listed() -> None:
    file = made("Text(0)\n" * 2_000)
    assert len(file.diagnostics) == 501
    assert file.diagnostics[0].text == "0:1: warning: 1500 more findings of this severity are not listed"


def test_too_many_lines() -> None:
    file = made("\n" * 250_000 + "Max_Module = 3\n")
    assert [d.text for d in errors(file)] == ["200002:1: error: more than 200000 lines: the rest is not read"]
    assert file.device.max_module is None


def test_a_remark_between_continued_lines() -> None:
    file = made(
        'Module = "m" 0x10, \\\n  ; the second half\n0x20\n7\nEndModule\n'
        "Ext_User_Prm_Data_Const(0) = 1,\\\n\nMax_Module = 3\n"
    )
    (module,) = file.device.modules
    assert (module.config, module.reference) == (b"\x10\x20", 7)
    assert (file.device.prm.consts[0].octets, file.device.max_module) == (b"\x01", 3)


def test_a_continuation_without_end() -> None:
    file = made('Info_Text = "' + "more and more \\\n" * 20_000 + '"\nMax_Module = 3\n')
    assert [d.message for d in errors(file)] == ["the continued line here has more than 65536 characters; it was ended"]
    assert file.device.ident == 0x0FFE


def test_every_file_of_ours_is_read() -> None:
    names = {path.stem for path in gsd_kit.FILES.glob("*.gsd")}
    assert len(names) >= 20
    for name in names:
        assert gsd_kit.read(name).device.ident in (0x0FFE, 0x0FFD, 0x1A2B)


CLASS1 = "DPV1_Slave = 1\nC1_Read_Write_supp = 1\nC1_Max_Data_Len = 240\nC1_Response_Timeout = 50\n"
CLASS2 = "C2_Read_Write_supp = 1\nC2_Max_Data_Len = 240\nC2_Response_Timeout = 50\nC2_Max_Count_Channels = 2\n"


def findings_of(text: str) -> list[str]:
    """Line and message of each finding; the text begins on line 5."""
    return [f"{found.line - HEAD.count(chr(10))}: {found.message}" for found in check(made(text))]


def test_files_without_contradictions() -> None:
    assert findings_of(CLASS1) == findings_of(CLASS1 + CLASS2 + "Max_Initiate_PDU_Length = 52\n") == []
    zeros = "C2_Read_Write_supp = 0\nC2_Max_Data_Len = 0\nC2_Response_Timeout = 0\nC2_Max_Count_Channels = 0\n"
    assert findings_of(CLASS1 + zeros + "C2_Read_Write_required = 0\nMax_Initiate_PDU_Length = 0\n") == []


@pytest.mark.parametrize(
    ("text", "findings"),
    [
        (
            "C2_Read_Write_supp = 1\n",
            [
                "1: C2_Read_Write_supp = 1 without C2_Max_Count_Channels: read as one connection",
                "1: C2_Read_Write_supp = 1 without C2_Max_Data_Len: read as 240 octets",
                "1: C2_Read_Write_supp = 1 without C2_Response_Timeout: the send time-out of a connection counts",
            ],
        ),
        (
            "C2_Max_Data_Len = 64\nC2_Max_Count_Channels = 1\n",
            [
                "1: C2_Max_Data_Len = 64 without C2_Read_Write_supp = 1: read as no class 2 connections",
                "2: C2_Max_Count_Channels = 1 without C2_Read_Write_supp = 1: read as no class 2 connections",
            ],
        ),
        (
            "C2_Read_Write_required = 1\nC1_Read_Write_required = 1\n",
            [
                "1: C2_Read_Write_required = 1 without C2_Read_Write_supp = 1: read as a device without them",
                "2: C1_Read_Write_required = 1 without C1_Read_Write_supp = 1: read as a device without them",
            ],
        ),
        (
            CLASS2 + "Max_Initiate_PDU_Length = 12\n",
            ["5: Max_Initiate_PDU_Length = 12: an Initiate has 20 octets at least; read as that"],
        ),
        (
            "C1_Read_Write_supp = 1\n",
            ["1: without DPV1_Slave = 1: neither Read and Write nor alarms of class 1 are used"],
        ),
        (
            CLASS1 + "Process_Alarm_required = 1\n",
            ["5: Process_Alarm_required = 1 without Process_Alarm_supp = 1: it is enabled all the same"],
        ),
        (
            "C2_Max_Count_Channels = 50\n" + CLASS2[: CLASS2.rindex("C2")],
            ["1: C2_Max_Count_Channels = 50 is outside 0..49"],
        ),
        ("C1_Max_Data_Len = 241\n", ["1: C1_Max_Data_Len = 241 is outside 0..240"]),
        ("Alarm_Sequence_Mode_Count = 33\n", ["1: Alarm_Sequence_Mode_Count = 33 is outside 0..32"]),
    ],
)
def test_findings(text: str, findings: list[str]) -> None:
    assert findings_of(text) == findings


def test_requirements_of_a_device() -> None:
    text = (
        "C1_Read_Write_required = 1\nC2_Read_Write_required = 1\nFail_Safe_required = 1\nPrm_Block_Structure_req = 1\n"
    )
    assert flags_of(made(CLASS1 + CLASS2 + text + "Isochron_Mode_required = 1\n").device, REQUIRES) == [*REQUIRES]
    assert [*REQUIRES] == ["fail-safe", "structured parameters", "acyclic class 1", "acyclic class 2", "isochronous"]
    assert flags_of(made(CLASS1 + CLASS2).device, REQUIRES) == []
