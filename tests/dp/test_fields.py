"""Named process data: declarations, values against literal octets, only the own bits change."""

from __future__ import annotations

import math
import struct
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.dp.field_map import FieldMap, as_json
from dpstack.dp.process_data import Field, field_of, overlap, with_scale
from dpstack.dp.process_image import Value
from dpstack.errors import ConfigError

OCTETS = bytes.fromhex("80 01 FF FE 7F FF FF FF 3F C0 00 00 00 00 00 05")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("bool@0.7", True),
        ("bool@0.0", False),
        ("bool@1.0", True),
        ("u8@0", 0x80),
        ("i8@0", -128),
        ("u16@0", 0x8001),
        ("i16@2", -2),
        ("i16le@2", -257),
        ("u16le@0", 0x0180),
        ("u32@4", 0x7FFFFFFF),
        ("i32@2", -98305),
        ("u32le@0", 0xFEFF0180),
        ("f32@8", 1.5),
        ("u64@8", 0x3FC0_0000_0000_0005),
        ("i64le@8", 0x0500_0000_0000_C03F),
        ("f64@8", 0.12500000000000014),
        ("bytes@14:2", b"\x00\x05"),
        ("u32ws@4", 0xFFFF7FFF),
        ("i32ws@8", 0x3FC0),
        ("f32ws@6", struct.unpack(">f", bytes.fromhex("3FC0FFFF"))[0]),
        ("u31@4", 0x7FFFFFFF),
        ("u31@8", 0x3FC00000),
        ("u4@0.4", 8),
        ("u4@0", 0),
        ("i4@0.4", -8),
        ("i12@2", -2),
        ("u12@0.4", 0x800),
        ("u24@1", 0x01FFFE),
        ("u12le@0", 0x180),
        (" I16 @ 2 ", -2),
    ],
)
def test_reading_literal_octets(text: str, value: Value) -> None:
    found = Field.parse("x", text)
    assert found.get(OCTETS) == value
    assert type(found.get(OCTETS)) is type(value)
    assert Field.parse("x", found.spec) == found
    assert found.put(bytes(16), value) == bytes(o & m for o, m in zip(OCTETS, _mask(found), strict=True))


def _mask(found: Field) -> bytes:
    return found.mask.to_bytes(16, "little")


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("a", "i16", 'a = "i16" is no field; write TYPE@OCTET, for instance "bool@0.3" or "i16@2"'),
        ("a", "@2", "a: unknown type ''; known types: bool, u8, i8, u16"),
        ("a", "int16@2", "a: unknown type 'int16'; did you mean 'i16'?"),
        ("a", "word@2", "a: unknown type 'word'; known types: bool, u8"),
        ("a", "boolle@2.1", "a: unknown type 'boolle'; did you mean 'bool'?"),
        ("a", "bool@2", 'a = "bool@2": no bit; write for instance "bool@0.3"'),
        ("a", "bool@2.8", 'a = "bool@2.8": bit 8; an octet has bits 0..7'),
        ("a", "i16@2.1", 'a = "i16@2.1": i16 has no bit; a bit is a bool: leave the point out'),
        ("a", "i16@2:2", 'a = "i16@2:2": a length; only bytes have one: leave it out'),
        ("a", "bytes@2", 'a = "bytes@2": no length; write for instance "bytes@4:3"'),
        ("a", "bytes@2:0", 'a = "bytes@2:0": no octets; give a length of 1 or more'),
        ("a", "i16@-1", 'a = "i16@-1" is no field;'),
        ("a", "i16@7", 'a = "i16@7" ends in octet 8; its configuration has octets 0..7 of inputs'),
        ("a", "bool@8.0", 'a = "bool@8.0" ends in octet 8; its configuration has octets 0..7 of inputs'),
        ("a", "bytes@0:9", 'a = "bytes@0:9" ends in octet 8;'),
        ("a.b", "i16@0", "'a.b' is no name for a field; use letters, digits, _ and -, a letter first"),
        ("", "i16@0", "'' is no name for a field;"),
        ("1", "i16@0", "'1' is no name for a field;"),
        ("a ", "i16@0", "'a ' is no name for a field;"),
    ],
)
def test_declarations_that_cannot_be(name: str, text: str, line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        field_of(name, text, 8, "inputs")
    assert str(caught.value).startswith(line)


def test_a_slave_without_any() -> None:
    with pytest.raises(ConfigError, match='a = "u8@0" ends in octet 0; it has no outputs'):
        field_of("a", "u8@0", 0, "outputs")


@pytest.mark.parametrize(
    ("text", "value", "line"),
    [
        ("bool@0.0", 2, "x is a bit: 2 is neither true nor false"),
        ("bool@0.0", 1.0, "x is a bit: 1.0 is neither"),
        ("bool@0.0", "on", "x is a bit: 'on' is neither"),
        ("u8@0", 256, "x = 256 is outside 0..255 (u8)"),
        ("u8@0", -1, "x = -1 is outside 0..255 (u8)"),
        ("i16@0", 32768, "x = 32768 is outside -32768..32767 (i16)"),
        ("i16@0", 1.0, "x is i16: 1.0 is not a whole number"),
        ("i16@0", True, "x is i16: True is not a whole number"),
        ("u64@0", 1 << 64, "x = 18446744073709551616 is outside 0..18446744073709551615 (u64)"),
        ("f32@0", 1e39, "x = 1e+39 is no number that f32 can hold"),
        ("f32@0", math.nan, "x = nan is no number that f32 can hold"),
        ("f64@0", 10**400, "x = 1000"),
        ("f64@0", "1", "x is f64: '1' is not a number"),
        ("bytes@0:2", b"\1", "x has 2 octets: 1 octet cannot be put there"),
        ("bytes@0:2", "00ff", "x has 2 octets: '00ff' cannot be put there"),
    ],
)
def test_values_that_do_not_fit(text: str, value: object, line: str) -> None:
    with pytest.raises(ValueError) as caught:
        Field.parse("x", text).put(bytes(8), value)
    assert str(caught.value).startswith(line)


@pytest.mark.parametrize(
    ("text", "typed", "value"),
    [
        ("bool@0.0", "On", True),
        ("bool@0.0", "0", False),
        ("i16@0", " -12 ", -12),
        ("u16@0", "0x10", 16),
        ("f32@0", "1.5", 1.5),
        ("bytes@0:2", "00 ff", b"\x00\xff"),
    ],
)
def test_values_as_people_write_them(text: str, typed: str, value: Value) -> None:
    assert Field.parse("x", text).read(typed) == value


@pytest.mark.parametrize(("text", "how"), [("bool@0.0", "on or off"), ("i16@0", "a number"), ("bytes@0:1", "hex dig")])
def test_a_wrong_field_is_refused_with_advice(text: str, how: str) -> None:
    with pytest.raises(ValueError, match=f"x = 'maybe' is no .*: write {how}"):
        Field.parse("x", text).read("maybe")


_TYPES = st.sampled_from(
    ("u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "f32", "f64", "u16le", "i32le", "f64le", "bool", "bytes")
)


@st.composite
def _fields(draw: st.DrawFn) -> Field:
    kind, octet = draw(_TYPES), draw(st.integers(0, 12))
    tail = f".{draw(st.integers(0, 7))}" if kind == "bool" else f":{draw(st.integers(1, 8))}" if kind == "bytes" else ""
    return Field.parse("x", f"{kind}@{octet}{tail}")


@given(_fields(), st.binary(min_size=20, max_size=20), st.binary(min_size=20, max_size=20))
def test_writing_changes_its_own_bits_only(found: Field, octets: bytes, others: bytes) -> None:
    value = found.get(octets)
    if isinstance(value, float) and not math.isfinite(value):
        return
    made = found.put(others, value)
    assert len(made) == 20
    mask = found.mask.to_bytes(20, "little")
    assert made == bytes(o & m | p & ~m for o, m, p in zip(octets, mask, others, strict=True))
    assert found.get(made) == value


def test_overlaps() -> None:
    def fields(*texts: str) -> dict[str, Field]:
        return {f"f{n}": Field.parse(f"f{n}", text) for n, text in enumerate(texts)}

    assert overlap(fields("bool@0.0", "bool@0.1", "u8@1", "i16@2", "bytes@4:2")) is None
    for texts in (
        ("bool@0.3", "bool@0.3"),
        ("u8@0", "u8@0"),
        ("i32@0", "i16@3"),
        ("bytes@0:4", "u8@3"),
        ("u16@0", "u12@1"),
    ):
        shared = overlap(fields("u8@9", *texts))
        assert shared is not None
        assert (shared[0].name, shared[1].name) == ("f2", "f1")


def test_an_image_that_is_too_short_has_no_values() -> None:
    fields = FieldMap({"a": Field.parse("a", "i16@2")}, 4)
    assert fields.values(bytes(4)) == {"a": 0}
    assert fields.values(bytes(3)) == {}
    assert "a" in fields
    assert list(fields) == ["a"]
    assert len(fields) == 1


def test_json() -> None:
    values: dict[str, Value] = {"a": b"\x00\xff", "b": math.inf, "c": 1.5, "d": True}
    assert as_json(values) == {"a": "00ff", "b": None, "c": 1.5, "d": True}


def scaled(text: str, **keys: float | str) -> Field:
    return with_scale(Field.parse("x", text), keys)


@pytest.mark.parametrize(
    ("text", "scale", "offset", "octets", "value"),
    [
        ("i16@0", 0.1, 0, "0003", 0.3),  # 3 * 0.1 is 0.30000000000000004 for a float
        ("i16@0", 0.1, 0, "ffff", -0.1),
        ("u16@0", 0.01, -50, "1c84", 23.0),
        ("u8@0", 10, 0, "0c", 120),
        ("i8@0", -0.5, 1, "04", -1.0),
        ("u16le@0", 0.001, 0, "3930", 12.345),
        ("f32@0", 2, 1, "3fc00000", 4.0),
    ],
)
def test_scaled_values_of_literal_octets(text: str, scale: float, offset: float, octets: str, value: float) -> None:
    found = scaled(text, scale=scale, offset=offset, unit="bar")
    assert found.get(bytes.fromhex(octets)) == value
    assert found.put(bytes(len(octets) // 2), value).hex() == octets
    assert found.read(f" {value} bar") == found.read(str(value)) == value


def test_a_scale_of_a_whole_number_gives_whole_numbers() -> None:
    assert type(scaled("u8@0", scale=10.0).get(b"\1")) is int
    assert type(scaled("u8@0", unit="bar").get(b"\1")) is int
    assert type(scaled("u8@0", scale=0.5).get(b"\2")) is float


@pytest.mark.parametrize(
    ("text", "keys", "value", "line"),
    [
        ("i16@0", {"scale": 0.1, "unit": "bar"}, 3276.76, "x = 3276.76 is outside -3276.8..3276.7 bar (i16, scale 0.1"),
        ("u8@0", {"scale": -2, "offset": 1}, 3, "x = 3 is outside -509..1 (u8, scale -2, offset 1)"),
        ("u8@0", {"unit": "V"}, 256, "x = 256 is outside 0..255 V (u8)"),
        ("u8@0", {"scale": 0.5}, math.nan, "x = nan is outside 0.0..127.5 (u8, scale 0.5, offset 0)"),
        ("u8@0", {"scale": 0.5}, "1", "x is u8: '1' is not a number"),
        ("u8@0", {"scale": 0.5}, True, "x is u8: True is not a number"),
        ("u8@0", {"unit": "V"}, 1.0, "x is u8: 1.0 is not a whole number"),
        ("f32@0", {"scale": 1e-9}, 1e38, "x = 1e+38 is no number that f32 can hold with scale 1e-09 and offset 0"),
    ],
)
def test_scaled_values_that_do_not_fit(text: str, keys: dict[str, float], value: object, line: str) -> None:
    with pytest.raises(ValueError) as caught:
        scaled(text, **keys).put(bytes(8), value)
    assert str(caught.value).startswith(line)


@pytest.mark.parametrize(
    ("text", "keys", "line"),
    [
        ("bool@0.0", {"scale": 2}, "x: bool has no scale; only numbers have one: leave it out"),
        ("bytes@0:2", {"unit": "bar"}, "x: bytes has no unit; only numbers have one"),
        ("u8@0", {"scale": 0.0}, "x: scale = 0 makes all values equal; give the value of one step"),
    ],
)
def test_scales_that_cannot_be(text: str, keys: dict[str, float], line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        scaled(text, **keys)
    assert str(caught.value).startswith(line)


_WHOLE = st.sampled_from(("u8", "i8", "u16", "i16", "i16le", "u32", "i32", "u32le"))
_SCALES = st.builds(
    lambda m, e, sign: sign * m * 10.0**e, st.integers(1, 99), st.integers(-4, 3), st.sampled_from((1, -1))
)
_OFFSETS = st.builds(lambda m, e: m * 10.0**e, st.integers(-999, 999), st.integers(-3, 3))


@examples(50)
@given(_WHOLE, _SCALES, _OFFSETS, st.binary(min_size=4, max_size=4))
def test_every_raw_number_comes_back_through_its_value(kind: str, scale: float, offset: float, octets: bytes) -> None:
    scale, offset = float(f"{scale:.6g}"), float(f"{offset:.6g}")
    found = scaled(f"{kind}@0", scale=scale, offset=offset)
    raw = Field.parse("x", f"{kind}@0").get(octets)
    assert isinstance(raw, int)
    value = found.get(octets)
    assert isinstance(value, (int, float))
    assert float(value) == float(raw * Decimal(str(scale)) + Decimal(str(offset)))  # as a person reckons it
    assert found.put(octets, value) == octets


@examples(40)
@given(_WHOLE, _SCALES.filter(lambda scale: scale != 1), st.floats(0, 1))
def test_writing_takes_the_nearest_raw_number(kind: str, scale: float, place: float) -> None:
    found, plain = scaled(f"{kind}@0", scale=scale, unit="bar"), Field.parse("x", f"{kind}@0")
    bits = 8 * plain.length
    low = 0 if kind.startswith("u") else -1 << (bits - 1)
    value = scale * (low + place * ((1 << bits) - 1))
    raw = plain.get(found.put(bytes(4), value))
    assert isinstance(raw, int)
    assert abs(raw * Decimal(repr(scale)) - Decimal(repr(value))) <= abs(Decimal(repr(scale))) * Decimal("0.500001")


def test_another_length_of_the_image_keeps_the_scale() -> None:
    fields = FieldMap({"x": scaled("i16@2", scale=0.1, unit="bar")}, 4)
    assert fields.fitted(6, "inputs").values(bytes.fromhex("0000 007b 0000")) == {"x": 12.3}
    assert fields.units == {"x": "bar"}
    with pytest.raises(ConfigError, match='x = "i16@2" ends in octet 3; its configuration has octets 0'):
        fields.fitted(3, "inputs")


def test_a_number_larger_than_any_float_is_refused() -> None:
    scaled = Field("level", "u16", 0, 2, scale=0.1)
    for value in (10**400, -(10**400)):
        with pytest.raises(ValueError, match=r"level = -?10"):
            scaled.put(bytes(2), value)
