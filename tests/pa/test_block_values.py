"""Data types and block objects of PROFIBUS PA at the makers' octets."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.errors import PduError, UsageError
from dpstack.pa.blocks import BlockObject, block_class
from dpstack.pa.datatypes import STRUCTURES, datatype, encode_value, parse_value

#: the AO block of SIPART PS2 PA (manual C79000-G7476-C150-01, page A-9)
SIPART_AO = bytes.fromhex("FA 02 02 01 00000000 0000 4002 0300 00 003D 003C 01")


def test_the_block_object_of_a_positioner() -> None:
    block = BlockObject.parse(SIPART_AO)
    assert (block.object, block.parent_class, block.block_class, block.parameters) == (2, 2, 1, 61)
    assert block.revision == "3.00"
    assert block.is_block
    assert block.block_class_of.short == "AO"
    assert block.block_class_of.words == "function block, analogue output"
    assert block.block_class_of.parameters["readback"].relative == 12


@pytest.mark.parametrize(
    ("octets", "words", "parameter", "relative"),
    [
        ((1, 1, 0), "physical block, transmitter", "device_man_id", 10),
        ((2, 1, 1), "function block, analogue input", "out_scale", 12),
        ((2, 5, 8), "function block, totaliser", "set_tot", 13),
        ((3, 1, 1), "transducer block, pressure, differential", "primary_value", 18),
        ((3, 2, 16), "transducer block, temperature, thermocouple + voltage", "rj_temp", 33),
        ((3, 3, 3), "transducer block, flow, Coriolis", "mass_flow", 21),
        ((3, 4, 2), "transducer block, level, echo", "level", 10),
        ((3, 5, 2), "transducer block, actuator, electro-pneumatic", "rated_travel", 32),
        ((3, 244, 250), "transducer block, maker's class 244", "tag_desc", 2),
        ((2, 1, 200), "function block, input, maker's class 200", "batch", 8),
        ((3, 4, 9), "transducer block, level, class 9", "level", 10),
    ],
)
def test_classes_in_words(octets: tuple[int, int, int], words: str, parameter: str, relative: int) -> None:
    found = block_class(*octets)
    assert found.words == words
    assert found.parameters[parameter].relative == relative


def test_no_block_object() -> None:
    with pytest.raises(PduError, match="octet 1 is 0"):
        block_class(0, 0, 0)
    with pytest.raises(PduError, match="19 octets"):
        BlockObject.parse(bytes(19))


def test_each_parameter_stands_once_with_a_known_type() -> None:
    for kind, parents in {1: (1,), 2: (1, 2, 5), 3: range(1, 10)}.items():
        for parent in parents:
            for number in (1, 2, 8):
                table = block_class(kind, parent, number).parameters.values()
                assert len({parameter.relative for parameter in table}) == len(table)
                assert all(datatype(parameter.kind).length for parameter in table)
                assert {parameter.access for parameter in table} <= {"r", "rw", "rm", "w"}
                assert {parameter.storage for parameter in table} <= set("SNDC")


def test_octets_of_structures() -> None:
    # Levelflex M FMP40 (easymanua.ls, page 58): OUT_SCALE has 11 octets, PV_SCALE 8, MODE_BLK 3, ALARM_SUM 8, BATCH 10
    lengths = {kind: datatype(kind).length for kind in ("block", "scaling", "range", "mode", "alarm_sum", "batch")}
    assert lengths == {"block": 20, "scaling": 11, "range": 8, "mode": 3, "alarm_sum": 8, "batch": 10}
    assert parse_value("scaling", bytes.fromhex("42C80000 00000000 053E 00")) == {
        "eu_100": 100.0,
        "eu_0": 0.0,
        "unit": 1342,
        "decimals": 0,
    }
    assert parse_value("value", bytes.fromhex("42F6E979 80")) == {"value": pytest.approx(123.456), "status": 0x80}
    assert parse_value("text16", b"SITRANS TH400   ") == "SITRANS TH400"


@pytest.mark.parametrize(
    ("kind", "value", "message"),
    [
        ("u8", 256, "0 to 255"),
        ("i8", -129, "-128 to 127"),
        ("u16", 1.5, "whole number"),
        ("u8", True, "whole number"),
        ("f32", math.nan, "finite"),
        ("f32", 1e39, "floating point"),
        ("f32", "1", "finite"),
        ("text16", "x" * 17, "at most 16"),
        ("text16", "\N{SNOWMAN}", "Latin-1"),
        ("text16", "a\nb", "at most 16"),
        ("octets4", b"123", "4 octets"),
        ("range", {"eu_100": 1.0}, "elements eu_100, eu_0"),
        ("range", {"eu_100": 1.0, "eu_0": 0.0, "x": 1}, "elements eu_100, eu_0"),
        ("range", 1.0, "structure"),
    ],
)
def test_values_that_do_not_fit(kind: str, value: object, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        encode_value(kind, value)  # type: ignore[arg-type]


@given(st.sampled_from(sorted(set(STRUCTURES) | {"u8", "u16", "u32", "i8", "f32", "octets6"})), st.data())
def test_octets_come_back(kind: str, data: st.DataObject) -> None:
    length = datatype(kind).length
    octets = data.draw(st.binary(min_size=length, max_size=length))
    value = parse_value(kind, octets)
    numbers = value.values() if isinstance(value, dict) else [value]
    if all(not isinstance(number, float) or math.isfinite(number) for number in numbers):
        assert encode_value(kind, value) == octets
