"""Modules in slots: literal identifier octets, every limit, and how modules are named."""

from __future__ import annotations

import itertools

import msgspec.structs
import pytest
from gsd_kit import device, made
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.dp.slave_params import WatchdogTime, watchdog_factors
from dpstack.errors import ConfigError, GsdError
from dpstack.gsd.configuration import configure, default_modules, find_module, modules_of_config
from dpstack.gsd.identifiers import Identifier, io_lengths, parse_identifiers
from dpstack.gsd.model import Device
from dpstack.gsd.module_readings import ModuleReading, read_modules


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


# --- Identifier octets -----------------------------------------------------------------------------------------------
# against the examples of manuals (docs/reference/protocol.md#identifiers), and the watchdog factors


@pytest.mark.parametrize(
    ("octets", "inputs", "outputs"),
    [
        ("11", 2, 0),  # 2 octets in
        ("22", 0, 3),  # 3 octets out
        ("F3", 8, 8),  # 4 words in and out, consistent
        ("71", 4, 4),  # 2 words in and out
        ("21", 0, 2),  # pyprofibus#19
        ("F3 F1", 12, 12),  # PPO1
        ("F1", 4, 4),  # PPO3
        ("00", 0, 0),  # empty slot
        ("C3 C1 C1 FD 00 01", 4, 4),  # ABB FPBA-01 ST1: two words each way and three octets of the maker
        ("40 07", 8, 0),  # special, input only
        ("80 47", 0, 16),  # special, output only, words
        ("C0 83 C1", 4, 4),  # special: output 4 octets, input 2 words, both consistent
        ("CF 00 00", 1, 1),  # 15: no octets of the maker follow
        ("10 00 20", 1, 1),  # an empty slot between modules
    ],
)
def test_lengths(octets: str, inputs: int, outputs: int) -> None:
    assert io_lengths(bytes.fromhex(octets)) == (inputs, outputs)


@pytest.mark.parametrize(
    ("octets", "inputs", "outputs", "manufacturer"),
    [
        ("C3 C1 C1 FD 00 01", (4, True), (4, True), "FD 00 01"),  # the special format in full
        ("C0 81 02", (3, False), (2, True), ""),  # the length of outputs comes before that of inputs
        ("B0", (1, True), (1, True), ""),  # general format, consistent over the whole
        ("10", (1, False), (0, False), ""),
    ],
)
def test_lengths_consistency_and_manufacturer_octets(
    octets: str, inputs: tuple[int, bool], outputs: tuple[int, bool], manufacturer: str
) -> None:
    (identifier,) = parse_identifiers(bytes.fromhex(octets))
    whole = Identifier(bytes.fromhex(octets), inputs[0], outputs[0], inputs[1], outputs[1], bytes.fromhex(manufacturer))
    assert msgspec.structs.replace(identifier, input_words=False, output_words=False) == whole
    assert not identifier.empty


def test_several_identifiers_keep_their_octets() -> None:
    config = bytes.fromhex("F3 C3 C1 C1 FD 00 01 00 22")
    identifiers = parse_identifiers(config)
    assert [i.octets.hex() for i in identifiers] == ["f3", "c3c1c1fd0001", "00", "22"]
    assert identifiers[2].empty


@pytest.mark.parametrize(
    ("octets", "finding"),
    [
        ("C3", "identifier octet 0 .*missing"),
        ("C3 C1", "identifier octet 0 .*missing"),
        ("C3 C1 C1", "announces 3 manufacturer octets, 0 are left"),
        ("C3 C1 C1 FD 00", "announces 3 manufacturer octets, 2 are left"),
        ("11 40", "identifier octet 1 "),
        ("04 01 02", "announces 4 manufacturer octets, 2 are left"),
    ],
)
def test_truncated_ones_name_the_octet(octets: str, finding: str) -> None:
    with pytest.raises(ConfigError, match=finding):
        parse_identifiers(bytes.fromhex(octets))


@given(st.binary(max_size=244))
def test_any_octets_are_split_or_refused(config: bytes) -> None:
    try:
        identifiers = parse_identifiers(config)
    except ConfigError:
        return
    assert b"".join(i.octets for i in identifiers) == config
    assert io_lengths(config) == (sum(i.inputs for i in identifiers), sum(i.outputs for i in identifiers))
    assert all(0 <= i.inputs <= 128 and 0 <= i.outputs <= 128 for i in identifiers)


@pytest.mark.parametrize(
    ("ms", "effective_ms"),
    [(1, 10), (10, 10), (11, 20), (200, 200), (2550, 2550), (2560, 2560), (2570, 2580), (650_250, 650_250)],
)
def test_watchdog_factors(ms: int, effective_ms: int) -> None:
    """2570 ms: 257 is a prime above 255, so the next product of two factors is taken, 258 = 2 x 129."""
    factors = watchdog_factors(ms)
    assert all(1 <= factor <= 255 for factor in factors)
    assert WatchdogTime(factors).ns == effective_ms * 1_000_000


_PRODUCTS = sorted({a * b for a in range(1, 256) for b in range(1, 256)})


@given(st.integers(1, 650_250))
def test_the_watchdog_is_the_shortest_possible_one(ms: int) -> None:
    first, second = watchdog_factors(ms)
    ticks = -(-ms // 10)
    assert first * second == next(product for product in _PRODUCTS if product >= ticks)


# --- Readings of identifier octets: rows of modules whose octets, counted by hand, are those that a slave has -------


PAIRS = (
    'Module = "a" 0x10\n1\nEndModule\nModule = "a too" 0x10\n2\nEndModule\n'
    'Module = "aa" 0x10,0x10\n3\nEndModule\nModule = "b" 0x20\n4\nEndModule\n'
)


def brief(reading: ModuleReading) -> list[tuple[int, str, list[str]]]:
    return [(place.slot, place.octets.hex(), [module.name for module in place.modules]) for place in reading.places]


def one(device: Device, octets: str) -> ModuleReading:
    found, more = read_modules(device, bytes.fromhex(octets))
    assert (len(found), more) == (1, False)
    return found[0]


def test_slots_decide_among_modules_and_count_from_the_first_one() -> None:
    # slot 1 takes PWR only, slot 2 "3 in", "2 in" or "4 out", slot 3 "3 in" ... and no "4 out"
    assert brief(one(device("slots"), "00 11 21")) == [(1, "00", ["PWR"]), (2, "11", ["2 in"]), (3, "21", ["2 out"])]
    assert brief(one(device("rack"), "00 11 21")) == [
        (2, "00", ["HEAD 7"]),
        (3, "11", ["6ES7 321-1BH00-0AA0 16DI"]),
        (4, "21", ["6ES7 322-1BH00-0AA0 16DO"]),
    ]


def test_octets_of_no_module_stay_unknown_one_identifier_at_a_time() -> None:
    # C3 01 02 .. is one special identifier with lengths and three octets of its maker
    reading = one(device("whole"), "20 C3 81 83 01 02 03 10 00")
    assert brief(reading) == [
        (1, "20", ["8 DO"]),
        (2, "c38183010203", []),
        (3, "10", ["8 DI"]),
        (4, "00", []),
    ]
    assert [place.unknown for place in reading.places] == [False, True, False, False]  # 00 is an empty slot
    assert reading.unknown == 6


def test_all_readings_of_ambiguous_octets() -> None:
    found, more = read_modules(made(PAIRS).device, bytes.fromhex("10 10 20"))
    assert not more
    assert [brief(reading) for reading in found] == [
        [(1, "1010", ["aa"]), (2, "20", ["b"])],
        [(1, "10", ["a", "a too"]), (2, "10", ["a", "a too"]), (3, "20", ["b"])],
    ]
    found, more = read_modules(made(PAIRS).device, b"\x10" * 244, most=5)
    assert (len(found), more) == (5, True)
    assert read_modules(made(PAIRS).device, b"") == ((ModuleReading(()),), False)


@pytest.mark.parametrize("octets", ["43", "C3", "20 C3 81"])
def test_octets_that_break_off_are_unknown(octets: str) -> None:
    assert one(device("whole"), octets).unknown == len(bytes.fromhex(octets).removeprefix(b"\x20"))


@given(st.lists(st.sampled_from((b"\x10", b"\x20", b"\x10\x10", b"\x30")), max_size=4))
@examples(20)
def test_the_best_reading_has_as_few_unknown_octets_as_any_row(parts: list[bytes]) -> None:
    """Held against every row of modules, one by one; 30 is of no module."""
    octets = b"".join(parts)
    found, more = read_modules(made(PAIRS).device, octets, most=4096)
    assert not more
    kinds = (b"\x10", b"\x10\x10", b"\x20", b"\x30")
    rows = (row for n in range(len(octets) + 1) for row in itertools.product(kinds, repeat=n))
    possible = {row for row in rows if b"".join(row) == octets}
    assert {tuple(place.octets for place in reading.places) for reading in found} == possible
    assert {reading.unknown for reading in found} == {octets.count(b"\x30")}
