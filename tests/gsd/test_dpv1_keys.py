"""The DP-V1 keywords of a GSD file: ranges, and contradictions between them."""

from __future__ import annotations

import pytest
from gsd_kit import HEAD, made

from dpstack.api.gsd_info import REQUIRES, flags_of
from dpstack.gsd.check import check

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
