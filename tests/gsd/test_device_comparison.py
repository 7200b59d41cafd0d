"""Two GSD files compared: the wire first. Each case changes one thing in a file by hand."""

from __future__ import annotations

import re

import pytest
from gsd_kit import FILES

from dpstack.gsd.device_comparison import Part, compare_devices
from dpstack.gsd.model import Device
from dpstack.gsd.parser import load_gsd

WHOLE = (FILES / "whole.gsd").read_text()


def device(text: str) -> Device:
    return load_gsd(text.encode(), "a").device


def changed(*edits: tuple[str, str]) -> list[str]:
    """Part and text of each change after the ``edits``."""
    text = WHOLE
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return [f"{one.part.name}: {one.text}" for one in compare_devices(device(WHOLE), device(text))]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("0x1A2B", "0x1A2C", "WIRE: ident number: 0x1A2B -> 0x1A2C"),
        ('"8 DI" 0x10', '"8 DI" 0x11', "WIRE: module '8 DI', identifier octets: 10 -> 11"),
        ("0x01,0x01,0xF4", "0x02,0x01,0xF4", "WIRE: module '8 DI', default user parameters: 01 01 f4 -> 02 01 f4"),
        (
            "0x80,0x00,0x00,0x00,0x00",
            "0x80,0x00,0x00,0x00,0x01",
            "WIRE: default user parameters of the device: 80 00 00 08 00 -> 80 00 00 08 01",
        ),
        ("Max_Input_Len = 16", "Max_Input_Len = 15", "WIRE: max_input_len: 16 -> 15"),
        ("MaxTsdr_500 = 100", "MaxTsdr_500 = 150", "WIRE: 500 kbit/s: MaxTsdr 100 -> MaxTsdr 150"),
        ("12M_supp = 1", "12M_supp = 0", "WIRE: 12 Mbit/s: gone, MaxTsdr 800"),
        ("Min_Slave_Intervall = 6", "Min_Slave_Intervall = 7", "WIRE: min_slave_interval: 6 -> 7"),
        ("C1_Response_Timeout = 100", "C1_Response_Timeout = 50", "WIRE: c1_response_timeout: 100 -> 50"),
        ("Process_Alarm_required = 1", "", "WIRE: alarms_required: Process_Alarm -> none"),
        ("DPV1_Slave = 1", "DPV1_Slave = 0", "WIRE: dpv1_slave: yes -> no"),
        ('"8 DO" 0x20\n2', '"8 DO" 0x20\n5', "MODULES: module '8 DO', reference number: 2 -> 5"),
        ('"eight inputs"', '"8 inputs"', "MODULES: module '8 DI', info: eight inputs -> 8 inputs"),
        ('"8 DO"', '"8 outputs"', "MODULES: module '8 DO', name: 8 DO -> 8 outputs"),
        ('"fuse blown"', '"fuse"', "DIAGNOSIS: bit 0: 'fuse blown' (replace F1) -> 'fuse' (replace F1)"),
        ("500 0-1000", "500 0-2000", "PARAMETERS: parameter 'Delay', allowed: 0..1000 -> 0..2000"),
        ('Text(0) = "off"', 'Text(0) = "no"', "PARAMETERS: parameter 'Diagnosis', text of 0: 'off' -> 'no'"),
        ('"B02"', '"B03"', "REST: revision: B02 -> B03"),
        ("DXB_Max_Link_Count = 4", "DXB_Max_Link_Count = 5", "WIRE: dxb_max_link_count: 4 -> 5"),
        ("Implementation_Type =", "Strange_Type =", 'REST: implementation_type: gone, "own"'),
    ],
)
def test_one_change(old: str, new: str, said: str) -> None:
    assert changed((old, new))[0] == said


def test_a_module_that_is_gone_is_a_matter_of_the_wire_a_new_one_of_choice() -> None:
    module = 'Module = "4 AI" 0x43,0x43,0x01,0x02,0x03\n3\nEndModule\n'
    text = "module '4 AI' (reference 3)"
    assert changed((module, "")) == [f"WIRE: {text}: gone, 43 43 01 02 03"]
    few = WHOLE.replace(module, "")
    assert [one.text for one in compare_devices(device(few), device(WHOLE))] == [f"{text}: new, 43 43 01 02 03"]
    assert compare_devices(device(few), device(WHOLE))[0].part is Part.MODULES


def test_a_parameter_at_another_place_makes_other_octets() -> None:
    place = "WIRE: place of parameter 'Diagnosis': octet 3, Bit(3) -> octet 4, Bit(3)"
    prm = "WIRE: default user parameters of the device: 80 00 00 08 00 -> 80 00 00 00 08"
    assert sorted(changed(("Ext_User_Prm_Data_Ref(3) = 1", "Ext_User_Prm_Data_Ref(4) = 1"))) == [prm, place]


def test_the_wire_goes_first() -> None:
    parts = [line.split(":")[0] for line in changed(('"B02"', '"B03"'), ('"fuse blown"', '"x"'), ("0x1A2B", "1"))]
    assert parts == ["WIRE", "DIAGNOSIS", "REST"]


def test_comments_line_ends_and_the_spelling_of_numbers_make_no_difference() -> None:
    other = re.sub(" ; .*|        ;.*", "", WHOLE).replace("0x1A2B", "6699").replace("Ident_Number", "IDENT_NUMBER")
    assert compare_devices(device(WHOLE), device(other.replace("\n", "\r\n"))) == []


def test_another_order_is_said() -> None:
    first = 'Module = "8 DO" 0x20\n2\nPreset = 1\nEndModule\n'
    rest = 'Module = "4 AI" 0x43,0x43,0x01,0x02,0x03\n3\nEndModule\n'
    assert changed((first + rest, rest + first)) == [
        "REST: order of modules, texts or parameters: as in the first -> another one"
    ]
