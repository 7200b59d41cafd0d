"""Parameters of declared types: floats in both channels, signs and widths, and a drive that answers another type.

The octets of floats are those of IEEE 754: 10.0 is 41200000h, 2.5 is 40200000h, 0.1 is 3DCCCCCDh.
"""

from __future__ import annotations

import re
import struct

import pytest
from drive_bench import PluginBench
from hypothesis import given
from hypothesis import strategies as st
from profidrive_kit import DRIVE, NO_REPLY, PARAMETERS, READY, Core, over_pkw, over_records

from dpstack.profile import ParamSpec, ParamStore, ParamTable, ParamType, Pkw
from dpstack.profile.record47 import Address, StoreParameters, Values

# -- the type itself -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "low", "high", "wide"),
    [
        (ParamType.U8, 0, 255, False),
        (ParamType.I8, -128, 127, False),
        (ParamType.U16, 0, 65_535, False),
        (ParamType.I16, -32_768, 32_767, False),
        (ParamType.U32, 0, 4_294_967_295, True),
        (ParamType.I32, -2_147_483_648, 2_147_483_647, True),
        (ParamType.N2, -2, 32_767 / 16_384, False),
        (ParamType.C4, -214_748.3648, 214_748.3647, True),
    ],
)
def test_a_parameter_without_limits_has_those_of_its_type(kind: ParamType, low: float, high: float, wide: bool) -> None:
    spec = ParamSpec(1, "p", "P", type=kind)
    assert (spec.low, spec.high, kind.wide) == (low, high, wide)
    assert spec.to_value(spec.to_raw(low)) == low
    assert spec.to_value(spec.from_pwe(spec.pwe(spec.to_raw(high)))) == high


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"low": -1}, "low = -1 does not fit its type u16, which holds 0..65535"),
        ({"type": ParamType.I16, "high": 40_000}, "high = 40000 does not fit its type i16"),
        ({"high": 7000, "decimals": 1}, r"which holds 0\.\.6553\.5"),
        ({"type": ParamType.F32, "decimals": 1}, "a float has neither decimals nor per_unit"),
    ],
)
def test_limits_that_the_type_cannot_hold_are_refused(table: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        ParamSpec(1, "p", "P", **table)  # type: ignore[arg-type]


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_a_float_is_shown_with_the_digits_that_it_needs(value: float) -> None:
    spec = ParamSpec(1, "p", "P", type=ParamType.F32)
    octets = struct.pack(">f", value)
    shown = spec.to_value(int.from_bytes(octets, "big"))
    assert struct.pack(">f", shown) == octets


def test_a_float_of_a_tenth_is_a_tenth() -> None:
    spec = PARAMETERS.named("p1120")
    assert spec is not None
    assert (spec.to_raw(0.1), spec.to_value(0x3DCCCCCD), spec.nearest_raw(1e6)) == (0x3DCCCCCD, 0.1, 0x44228000)
    with pytest.raises(ValueError, match=r"650\.5 s is outside 0\.\.650 s"):
        spec.to_raw(650.5)


# -- PKW -----------------------------------------------------------------------------------------------------------


def read(bench: PluginBench, number: int, reply: str) -> object:
    token = bench.order_and_run(2, "read", number=number)
    return bench.value(token, f"{reply} {READY}")


def test_a_float_in_pwe_is_read_and_written() -> None:
    bench = over_pkw()
    assert read(bench, 1120, "24 60 00 00 41 20 00 00") == 10.0
    bench.see(NO_REPLY + READY, 2)
    token = bench.order_and_run(2, "write", number="p1120", value=2.5)
    assert bench.out().startswith("34 60 00 00 40 20 00 00")
    assert bench.value(token, f"24 60 00 00 40 20 00 00 {READY}") == 2.5
    assert bench.notices() == []


def test_a_word_for_a_float_is_an_error_that_says_what_to_declare() -> None:
    bench = over_pkw()
    token = bench.order_and_run(2, "read", number=1120)
    bench.see(f"14 60 00 00 00 00 00 0A {READY}")
    text = (
        "parameter 1120 (Ramp-up time): it is declared as f32, and the drive answers an integer: declare the type that"
    )
    assert bench.text(token, "parameter") == f"{text} the drive's manual gives"


@pytest.mark.parametrize(
    ("number", "reply", "value", "says"),
    [
        (
            1141,
            "24 75 00 00 41 20 00 00",
            1_092_616_192,
            r"as i16, and the drive answers 1092616192 \(as a float .* 10\)",
        ),
        (
            700,
            "22 BC 00 00 00 01 00 02",
            65_538,
            "declared as u16, and the drive answers 65538, which that cannot hold",
        ),
        (1121, "24 61 00 00 41 20 00 00", 1_092_616.192, r"1.09262e\+06 is outside 0..650 \(as a float it is 10\)"),
        (1121, "24 61 00 00 00 00 27 10", 10.0, None),
        (1141, "14 75 00 00 00 00 FF FF", -1, None),
        (700, "22 BC 00 00 00 00 00 02", 2, None),
    ],
)
def test_an_answer_that_the_declared_type_cannot_be_is_reported_once(
    number: int, reply: str, value: float, says: str | None
) -> None:
    bench = over_pkw()
    for _ in range(2):
        assert read(bench, number, reply) == value
        bench.see(NO_REPLY + READY, 2)
    notices = bench.notices()
    assert len(notices) == (says is not None)
    assert says is None or re.search(says, notices[0]), notices


def test_the_simulated_drive_carries_floats_in_its_parameter_channel() -> None:
    device = DRIVE.device("PPO1", {"p1082": 60.5})
    assert device.carry_out(Pkw(1, 1082)) == (2, 0x42720000)
    assert device.carry_out(Pkw(3, 1120, 0, 0x40200000)) == (2, 0x40200000)
    assert device.store.value("p1120") == 2.5
    assert device.carry_out(Pkw(3, 1120, 0, 0x447A0000)) == (7, 2)  # 1000.0 is beyond the limit
    assert device.carry_out(Pkw(3, 1120, 0, 0x7FC00000)) == (7, 2)  # not a number
    assert device.carry_out(Pkw(2, 1120, 0, 5)) == (7, 5)
    assert device.carry_out(Pkw(1, 1141)) == (1, 0)


# -- record 47 -----------------------------------------------------------------------------------------------------


def test_the_axis_of_record_47_is_the_cores() -> None:
    class Second(Core):
        record_object = 3

    bench = over_records(Second)
    token = bench.order("read", number="p1120")
    bench.answer("01 01 03 01 08 01 41 20 00 00")
    assert bench.requests == ["01 01 03 01 10 00 04 60 00 00"]
    assert bench.value(token) == 10.0


def test_a_write_of_an_int_to_a_float_returns_what_the_drive_got() -> None:
    bench = over_records()
    token = bench.order("write", number="p1120", value=5)
    bench.answer("01 01 01 01 08 01 41 20 00 00", "02 02 01 01")
    assert bench.requests[1].endswith("08 01 40 A0 00 00")
    assert (bench.done(token)["value"], bench.done(token)["raw"]) == (5.0, 0x40A00000)
    # of a parameter that was declared as an integer the drive gets the same
    token = bench.order("write", number="p1121", value=5)
    bench.answer("03 01 01 01 08 01 41 20 00 00", "04 02 01 01")
    assert bench.requests[3].endswith("08 01 40 A0 00 00")
    assert bench.value(token) == 5.0
    (said,) = bench.notices()
    assert "1121 (Ramp-down time in ms): it is declared as u32, and the drive answers a float" in said


@pytest.mark.parametrize(
    ("name", "response", "value"),
    [
        ("p1120", "01 01 01 01 08 01 3D CC CC CD", 0.1),
        ("p1120", "01 01 01 01 43 01 41 20 00 00", 10.0),  # the drive says only DoubleWord
        ("p1140", "01 01 01 01 71 01 E0 00", -0.5),
        ("p1141", "01 01 01 01 03 01 FF FF", -1),
        ("p1142", "01 01 01 01 05 01 7D 00", 125),
    ],
)
def test_types_over_record_47(name: str, response: str, value: float) -> None:
    bench = over_records()
    token = bench.order("read", number=name)
    bench.answer(response)
    assert bench.value(token) == value
    assert bench.notices() == []


def test_an_integer_for_a_float_over_record_47_is_an_error() -> None:
    bench = over_records()
    token = bench.order("read", number="p1120")
    bench.answer("01 01 01 01 06 01 00 0A")
    assert bench.text(token, "parameter").endswith("declare the type that the drive's manual gives (Unsigned16)")


def test_the_simulated_drive_carries_floats_over_record_47() -> None:
    store = ParamStore(PARAMETERS, {"p1120": 2.5, "p1141": -7, "p1142": 9})
    model = StoreParameters(store)
    found = [model.read(Address(number)) for number in (1120, 1140, 1141, 1142)]
    assert found == [Values(8, (2.5,)), Values(113, (0,)), Values(3, (-7,)), Values(5, (9,))]
    assert model.change(Address(1120), Values(8, (0.25,))) is None
    assert model.change(Address(1140), Values(113, (-0x4000,))) is None
    assert (store.value("p1120"), store.value("p1140")) == (0.25, -1.0)
    assert model.change(Address(1120), Values(8, (float("nan"),))) == (2, 0)
    assert model.change(Address(1120), Values(6, (1,))) == (5, None)


def test_a_preset_between_two_floats_is_the_nearest_one() -> None:
    store = ParamStore(ParamTable([ParamSpec(1, "p", "P", type=ParamType.F32)]), {"p": 1 / 3})
    assert store.value("p") == pytest.approx(1 / 3, rel=1e-7)
