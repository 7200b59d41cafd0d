"""Readings of identifier octets: rows of modules whose octets, counted by hand, are those that a slave has."""

from __future__ import annotations

import itertools

import pytest
from gsd_kit import device, made
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.gsd.model import Device
from dpstack.gsd.module_readings import ModuleReading, read_modules

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
