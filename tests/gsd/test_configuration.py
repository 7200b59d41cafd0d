"""Modules in slots: literal identifier octets, every limit, and how modules are named."""

from __future__ import annotations

import pytest
from gsd_kit import device, made

from dpstack.errors import GsdError
from dpstack.gsd.configuration import configure, default_modules, find_module, modules_of_config


def test_identifier_octets_lengths_and_parameters() -> None:
    found = configure(device("whole"), ["8 DO", "8 DI", 3, ""])
    assert found.config.hex(" ") == "20 10 43 43 01 02 03 00"
    assert (found.inputs, found.outputs, found.notes) == (9, 1, ())
    # device: 80, bit 3 of octet 3; then the module in slot 2
    assert found.user_prm().octets().hex(" ") == "80 00 00 08 00 01 01 f4"


def test_a_dummy_in_front_and_special_formats() -> None:
    found = configure(device("identifiers"), ["dummy in front", "special", "manufacturer octets only"])
    assert found.config.hex() == "00" + "c1c1fd00" + "040000adc4"
    assert (found.inputs, found.outputs) == (124, 4)


@pytest.mark.parametrize(
    ("name", "modules", "message"),
    [
        ("whole", ["8DI"], "there is no module '8DI'; nearest are '8 DI', '8 DO'"),
        ("whole", [7], "no module has the reference number 7; nearest is 3"),
        ("whole", [1] * 5, "5 modules, the device takes at most 4 (Max_Module); take out some"),
        ("whole", [], "no module with identifier octets is plugged; name at least one"),
        ("equal_names", ["Reserve"], "2 modules are called 'Reserve'; give the reference number: 1, 2"),
        (
            "slots",
            [1, 4],
            "module '2 out' (reference 4) is not allowed in slot 2 (signals); allowed references: 2..3, 5",
        ),
        ("slots", [1, 5, 4], "6 octets of outputs, the device has at most 2; take out modules"),
        ("slots", [1, 2, 4, 2], "4 modules, the device takes at most 3 (Max_Module); take out some"),
        ("damaged_module", ["lost end"], "module 'lost end' (reference 1) of line 11 is damaged in the file"),
        ("identifiers", ["lies"], "identifier octet 0 (0x40) announces a length octet that is missing"),
    ],
)
def test_refused(name: str, modules: list[int | str], message: str) -> None:
    with pytest.raises(GsdError) as caught:
        configure(device(name), modules)
    assert str(caught.value).startswith(message)


def test_inputs_up_to_the_limit() -> None:
    assert configure(device("whole"), [3, 3]).inputs == 16
    with pytest.raises(GsdError, match="17 octets of inputs, the device has at most 16; take out modules"):
        configure(device("whole"), [3, 3, 1])


def test_both_lengths_together() -> None:
    d = made(
        "Modular_Station = 1\nMax_Module = 4\nMax_Input_Len = 4\nMax_Output_Len = 4\nMax_Data_Len = 5\n"
        'Module = "a" 0x33\nEndModule\n'
    ).device
    with pytest.raises(GsdError, match="8 octets of inputs and outputs, the device has at most 5"):
        configure(d, ["a"])


def test_ways_to_name_a_module() -> None:
    d = device("equal_names")
    assert find_module(d, 2).config == b"\x20"
    assert find_module(d, "2").config == b"\x20"
    assert find_module(d, "twin").config == b"\0"  # two of them, alike in everything that is sent
    assert find_module(device("whole"), "4  ai").reference == 3


def test_the_modules_without_a_choice() -> None:
    assert configure(device("prm_old")).config == b"\x13\x23"
    assert configure(device("slots")).config == b"\x00\x11\x21"
    assert [m.name for m in default_modules(device("whole")) or ()] == ["8 DO"]
    with pytest.raises(GsdError, match="the device has 4 modules to choose from; name those that are plugged"):
        configure(device("equal_names"))


def test_several_modules_in_a_compact_device_get_a_note() -> None:
    d = made('Module = "a" 0x10\nEndModule\nModule = "b" 0x20\nEndModule\n').device
    assert configure(d, ["b", "a"]).notes == (
        "the device is no modular station (Modular_Station = 0), but several modules are plugged",
    )


def test_slot_numbers_begin_with_modul_offset() -> None:
    d = made(
        "Modular_Station = 1\nMax_Module = 4\nModul_Offset = 0\n"
        'ExtUserPrmData = 1 "p"\nUnsigned8 3\nEndExtUserPrmData\n'
        'Module = "a" 0x10\nExt_Module_Prm_Data_Len = 1\nExt_User_Prm_Data_Ref(0) = 1\nEndModule\n'
    ).device
    assert [f.key for f in configure(d, ["a", "a"]).user_prm().fields] == ["0/p@0", "1/p@0"]


@pytest.mark.parametrize(
    ("name", "octets", "modules"),
    [
        ("whole", "20 10 43 43 01 02 03 00", ["8 DO", "8 DI", "4 AI", None]),
        ("whole", "", []),
        ("whole", "10 10", ["8 DI", "8 DI"]),
        ("whole", "10 11", None),  # 11 is of no module
        ("whole", "43 43 01 02", None),  # the last octet is missing
    ],
)
def test_modules_are_found_by_their_identifier_octets(name: str, octets: str, modules: list[str | None] | None) -> None:
    found = modules_of_config(device(name), bytes.fromhex(octets))
    assert (None if found is None else [None if one is None else one.name for one in found]) == modules


def test_octets_of_one_module_may_begin_with_those_of_another() -> None:
    """The longer one counts where the rest belongs to whole modules, else the shorter one."""
    file = made(
        'Module = "a" 0x10\n1\nEndModule\nModule = "ab" 0x10,0x20\n2\nEndModule\n'
        'Module = "bb" 0x20,0x20\n3\nEndModule\n'
    )
    for octets, names in (("10 20", ["ab"]), ("10 20 20", ["a", "bb"]), ("10 20 20 20", ["ab", "bb"])):
        found = modules_of_config(file.device, bytes.fromhex(octets))
        assert found is not None
        assert [one.name for one in found if one is not None] == names
    assert modules_of_config(file.device, b"\x10" * 244) is not None
