"""The blocks of simulated PA devices: rules of access, values, faults. Pure, in times of the test."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.errors import RecordRefused, UsageError
from dpstack.pa.datatypes import datatype, encode_value
from dpstack.pa.simulated import KINDS, kinds
from dpstack.pa.simulated.block import AUTO, LOCAL, MAN, OUT_OF_SERVICE, RCAS, Block
from dpstack.pa.simulated.conversion import convert
from dpstack.pa.simulated.device import ProcessDevice
from dpstack.pa.simulated.kinds import Row, process_device

S = 1_000_000_000


def out(device: ProcessDevice, block: str = "AI1", name: str = "out") -> tuple[Any, Any]:
    found = cast("Mapping[str, Any]", device.block(block).get(name))
    return found["value"], found["status"]


def write(device: ProcessDevice, block: str, name: str, value: object) -> None:
    """As a master writes it."""
    one = device.block(block)
    parameter = one.parameters[name]
    device.write(one.slot, one.index + parameter.relative, encode_value(parameter.kind, cast("Any", value)))


def refused(device: ProcessDevice, block: str, name: str, value: object) -> int:
    with pytest.raises(RecordRefused) as caught:
        write(device, block, name, value)
    return caught.value.code_1


def code_of_write(device: ProcessDevice, slot: int, index: int, octets: bytes) -> int | None:
    """The code of the refusal; None: it was written."""
    try:
        device.write(slot, index, octets)
    except RecordRefused as refusal:
        return refusal.code_1
    return None


def scaled(high: float, low: float, unit: int = 1137) -> dict[str, object]:
    return {"eu_100": high, "eu_0": low, "unit": unit, "decimals": 2}


def test_the_kinds_are_those_of_the_options() -> None:
    assert tuple(kinds.KINDS) == KINDS


# --- access ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "255 blocks"])
def test_every_parameter_of_the_profile_is_read_in_its_length(kind: str) -> None:
    device = process_device(kind)
    for block in device.blocks:
        for one in block.parameters.values():
            if one.access == "w":
                with pytest.raises(RecordRefused, match="0xB6"):
                    device.read(block.slot, block.index + one.relative)
            else:
                assert len(device.read(block.slot, block.index + one.relative)) == datatype(one.kind).length, one


@given(st.data(), st.sampled_from([kind for kind in KINDS if kind != "255 blocks"]), st.binary(max_size=40))
def test_a_write_is_taken_whole_or_refused_whole(data: st.DataObject, kind: str, octets: bytes) -> None:
    """Whatever a master writes wherever: a code of DP-V1 and nothing changed, or the octets stand and ST_REV counts."""
    device = process_device(kind)
    block = data.draw(st.sampled_from(device.blocks))
    relative = data.draw(st.integers(0, block.count + 2))
    one = next((found for found in block.parameters.values() if found.relative == relative), None)
    if one is not None and data.draw(st.booleans()):
        octets = data.draw(st.binary(min_size=datatype(one.kind).length, max_size=datatype(one.kind).length))
    before = device.read(block.slot, block.index + 1)
    state = [found.octets_of(name) for found in device.blocks for name in found.parameters]
    if (code := code_of_write(device, block.slot, block.index + relative, octets)) is not None:
        assert code in set(Code)
        assert [found.octets_of(name) for found in device.blocks for name in found.parameters] == state
        return
    assert one is not None
    assert one.access != "r"
    assert len(octets) == datatype(one.kind).length
    if one.storage == "S" and one.name != "factory_reset":
        assert device.read(block.slot, block.index + 1) == b"\0\1" != before
        assert block.octets_of(one.name) == octets
    elif one.name != "factory_reset" and not one.name.startswith("tab_"):
        assert device.read(block.slot, block.index + 1) == before
    device.advance(device.now + S)


@pytest.mark.parametrize(
    ("slot", "index", "code"),
    [(0, 9, Code.INVALID_INDEX), (1, 9, Code.INVALID_INDEX), (9, 16, Code.INVALID_SLOT), (1, 40, Code.INVALID_INDEX)],
)
def test_places_without_a_record(slot: int, index: int, code: Code) -> None:
    device = process_device("pressure")
    for ask in (lambda: device.read(slot, index), lambda: device.write(slot, index, b"\0")):
        with pytest.raises(RecordRefused) as caught:
            ask()
        assert caught.value.code_1 == code


def test_what_is_refused_and_how() -> None:
    device = process_device("pressure")
    assert refused(device, "PB", "device_id", "x") == Code.ACCESS_DENIED
    assert refused(device, "AI1", "out", {"value": 1.0, "status": 0x80}) == Code.STATE_CONFLICT
    assert refused(device, "AI1", "target_mode", RCAS) == Code.INVALID_RANGE
    assert refused(device, "AI1", "target_mode", AUTO | MAN) == Code.INVALID_RANGE
    assert refused(device, "AI1", "fsafe_type", 3) == Code.INVALID_RANGE
    assert refused(device, "AI1", "out_scale", scaled(1, 1)) == Code.INVALID_RANGE
    assert refused(device, "AI1", "channel", 0x0912) == Code.INVALID_RANGE
    assert refused(device, "TB1", "primary_value_unit", 1001) == Code.INVALID_RANGE  # bar to degC
    assert refused(device, "TB1", "cal_point_hi", 0.05) == Code.INVALID_RANGE  # below CAL_MIN_SPAN
    assert refused(device, "TB1", "cal_point_lo", -5.0) == Code.INVALID_RANGE  # below the sensor's limit
    block = device.block("AI1")
    with pytest.raises(RecordRefused, match="0xB1"):
        device.write(1, block.index + 18, b"\0\0\0")
    with pytest.raises(RecordRefused, match="0xB3"):
        device.write(1, block.index + 18, struct.pack(">f", math.nan))
    with pytest.raises(RecordRefused, match="0xB6"):
        device.write(1, 0, bytes(12))  # the directory


def test_write_protections() -> None:
    device = process_device("pressure")
    write(device, "PB", "write_locking", 0)
    assert refused(device, "AI1", "pv_ftime", 1.0) == Code.ACCESS_DENIED
    assert refused(device, "PB", "descriptor", "x") == Code.ACCESS_DENIED
    write(device, "TB1", "tab_entry", 1)  # has no write protection
    assert refused(device, "PB", "write_locking", 7) == Code.INVALID_RANGE
    write(device, "PB", "write_locking", 2457)
    write(device, "AI1", "pv_ftime", 1.0)
    device.physical.put("hw_write_protection", 2)
    assert refused(device, "PB", "write_locking", 2457) == Code.ACCESS_DENIED
    assert refused(device, "AI1", "target_mode", MAN) == Code.ACCESS_DENIED
    device.physical.put("hw_write_protection", 1)
    write(device, "AI1", "target_mode", MAN)


def test_st_rev_counts_static_parameters_and_goes_on_with_one() -> None:
    device = process_device("pressure")
    block = device.block("AI1")
    write(device, "AI1", "pv_ftime", 2.0)  # kept, not static
    assert block.get("st_rev") == 0
    block.put("st_rev", 0xFFFF)
    write(device, "AI1", "strategy", 5)
    assert block.get("st_rev") == 1
    assert device.block("TB1").get("st_rev") == 0
    assert cast("Mapping[str, bytes]", block.get("alarm_sum"))["current"] == b"\x80\0"
    assert out(device)[1] == 0x84  # update event
    device.advance(10 * S)
    assert out(device)[1] == 0x80


def test_manual_mode_takes_a_value_with_its_status() -> None:
    device = process_device("pressure")
    write(device, "AI1", "target_mode", MAN)
    write(device, "AI1", "out", {"value": 3.5, "status": 0x60})
    device.process["pressure"] = 9.0
    device.advance(5 * S)
    assert out(device) == (3.5, 0x60)
    assert cast("Mapping[str, int]", device.block("AI1").get("mode_blk"))["actual"] == MAN


# --- values ---------------------------------------------------------------------------------------------------------


def test_scales_and_linearisation() -> None:
    device = process_device("pressure")
    write(device, "AI1", "out_scale", scaled(100, 0, 1342))
    device.process["pressure"] = 2.5
    device.settle()
    assert out(device)[0] == pytest.approx(25)
    write(device, "TB1", "lin_type", 10)
    assert out(device)[0] == pytest.approx(50)  # square root of a quarter
    write(device, "TB1", "low_flow_cut_off", 30.0)
    assert out(device)[0] == 0


def test_a_unit_changes_and_out_stays() -> None:
    """PV_SCALE follows the unit of its channel, so OUT is undisturbed (PA.h, PV_SCALE)."""
    device = process_device("pressure")
    write(device, "TB1", "primary_value_unit", 1138)
    assert out(device, "TB1", "primary_value")[0] == pytest.approx(1000)
    assert device.block("AI1").part("pv_scale", "eu_100") == pytest.approx(10_000)
    assert out(device) == (pytest.approx(1.0), 0x80)


@given(st.sampled_from([1130, 1132, 1133, 1137, 1138, 1141]), st.floats(-1, 10))
def test_pressures_in_any_unit_are_the_same_pressure(unit: int, bar: float) -> None:
    device = process_device("pressure")
    write(device, "TB1", "sensor_unit", unit)
    device.process["pressure"] = bar
    device.settle()
    assert convert(device.block("TB1").number_of("sensor_value"), unit, 1137) == pytest.approx(bar, abs=1e-5)
    assert out(device)[0] == pytest.approx(bar, abs=1e-4)


def test_a_filter_has_its_time_constant() -> None:
    device = process_device("pressure")
    write(device, "AI1", "pv_ftime", 4.0)
    device.settle()
    device.process["pressure"] = 2.0
    device.advance(4 * S)
    assert out(device)[0] == pytest.approx(1 + 0.6321, abs=1e-4)


def test_limits_with_hysteresis() -> None:
    device = process_device("pressure")
    for name, value in (("hi_lim", 5.0), ("hi_hi_lim", 8.0), ("lo_lim", 0.5), ("lo_lo_lim", 0.1), ("alarm_hys", 0.5)):
        write(device, "AI1", name, value)
    device.advance(20 * S)
    found = []
    for pressure in (4.9, 5.0, 8.0, 7.6, 7.4, 4.6, 4.4, 0.5, 0.1, 0.7, 1.1):
        device.process["pressure"] = pressure
        device.settle()
        found.append((out(device)[1], device.block("AI1").octets_of("alarm_sum")[0]))
    assert found == [
        (0x80, 0), (0x8A, 4), (0x8E, 6), (0x8E, 6), (0x8A, 4), (0x8A, 4), (0x80, 0), (0x89, 0x10), (0x8D, 0x18),
        (0x89, 0x10), (0x80, 0),
    ]  # fmt: skip
    assert cast("Mapping[str, Any]", device.block("AI1").get("hi_hi_alm"))["value"] == pytest.approx(7.4)


@pytest.mark.parametrize(
    ("kind", "condensed", "value", "status"),
    [
        (0, False, 7.0, 0x4B),
        (0, True, 7.0, 0x4B),
        (1, False, 1.0, 0x47),
        (1, True, 1.0, 0x4B),
        (2, False, 1.0, 0x10),
        (2, True, 1.0, 0x24),
    ],
)
def test_fail_safe_of_a_broken_sensor(kind: int, condensed: bool, value: float, status: int) -> None:
    device = process_device("pressure", condensed=condensed)
    device.block("AI1").put("fsafe_type", kind)
    device.block("AI1").put("fsafe_value", 7.0)
    device.active.add("sensor-failure")
    device.settle()
    assert out(device) == (value, status)
    assert out(device, "TB1", "primary_value")[1] == (0x24 if condensed else 0x10)


def test_out_of_service() -> None:
    device = process_device("pressure")
    write(device, "AI1", "target_mode", OUT_OF_SERVICE)
    assert out(device) == (1.0, 0x1F)
    write(device, "PB", "cond_status_diag", 1)
    assert out(device)[1] == 0x23


def test_beyond_the_limits_of_the_sensor() -> None:
    device = process_device("pressure")
    device.process["pressure"] = 11.0
    device.settle()
    assert (out(device)[1], device.physical.get("diagnosis")) == (0x52, b"\0\0\0\x80")
    write(device, "PB", "cond_status_diag", 1)
    assert (out(device)[1], device.physical.get("diagnosis")) == (0x7A, b"\0\0\x08\x80")


def test_simulate_replaces_the_channel() -> None:
    device = process_device("pressure", condensed=True)
    write(device, "AI1", "simulate", {"status": 0x73, "value": 6.0, "enabled": 1})
    assert (out(device), device.physical.get("diagnosis")) == ((6.0, 0x73), b"\0\0\x04\0")
    write(device, "AI1", "simulate", {"status": 0x24, "value": 6.0, "enabled": 1})
    assert out(device) == (6.0, 0x4B)  # bad, so FSAFE_TYPE acts


def test_the_event_switch_says_what_an_event_does() -> None:
    """Low four bits the status, high four the bit of DIAGNOSIS (PA.h, DIAG_EVENT_SWITCH)."""
    device = process_device("pressure", condensed=True)
    device.active.add("maintenance required")
    device.settle()
    assert (out(device)[1], device.physical.get("diagnosis")) == (0xA4, b"\0\x20\0\x80")
    switch = bytearray(cast("bytes", device.physical.get("diag_event_switch")))
    switch[1] = 0x32
    write(device, "PB", "diag_event_switch", bytes(switch))
    assert (out(device)[1], device.physical.get("diagnosis")) == (0xA8, b"\0\0\x01\x80")
    switch[1] = 0x39
    assert refused(device, "PB", "diag_event_switch", bytes(switch)) == Code.INVALID_RANGE


def test_feature_follows_the_switch_of_the_coding() -> None:
    device = process_device("pressure")
    assert device.physical.octets_of("feature") == bytes.fromhex("0B000000 0A000000")
    write(device, "PB", "cond_status_diag", 1)
    assert device.physical.octets_of("feature") == bytes.fromhex("0B000000 09000000")
    device.order_coding(False)  # Set_Prm
    assert (device.condensed, device.physical.octets_of("feature")[4]) == (False, 0x0A)


def test_a_totaliser_counts_in_the_time_of_the_machine() -> None:
    device = process_device("flow")
    device.advance(1800 * S)
    assert out(device, "TOT1", "total") == (pytest.approx(5.0), 0x80)
    device.process["flow"] = -20.0
    device.advance(3600 * S)
    assert out(device, "TOT1", "total")[0] == pytest.approx(-5.0)
    write(device, "TOT1", "mode_tot", 1)
    device.advance(7200 * S)
    assert out(device, "TOT1", "total")[0] == pytest.approx(-5.0)
    write(device, "TOT1", "unit_tot", 1038)
    assert out(device, "TOT1", "total")[0] == pytest.approx(-5000.0)
    write(device, "TOT1", "preset_tot", 250.0)
    write(device, "TOT1", "set_tot", 2)
    assert out(device, "TOT1", "total")[0] == pytest.approx(250.0)
    write(device, "TOT1", "set_tot", 0)
    device.process["flow"] = 1.0
    device.advance(7200 * S + 3600 * S)
    assert out(device, "TOT1", "total")[0] == pytest.approx(1250.0)
    write(device, "TOT1", "set_tot", 1)
    assert out(device, "TOT1", "total")[0] == 0
    assert refused(device, "TOT1", "channel", 0x0119) == Code.INVALID_RANGE  # a density is no flow


@given(st.lists(st.integers(1, 5_000), min_size=1, max_size=20))
def test_a_total_does_not_depend_on_the_steps(steps: list[int]) -> None:
    device = process_device("flow")
    for step in steps:
        device.advance(device.now + step * 1_000_000)
    assert out(device, "TOT1", "total")[0] == pytest.approx(10 * sum(steps) / 3_600_000, rel=1e-5)


@pytest.mark.parametrize(("kind", "total", "status"), [(0, 20.0, 0x40), (1, 10.0, 0x10), (2, 20.0, 0x47)])
def test_a_totaliser_without_a_flow(kind: int, total: float, status: int) -> None:
    device = process_device("flow")
    device.block("TOT1").put("fail_tot", kind)
    device.advance(3600 * S)
    device.active.add("sensor-failure")
    device.advance(7200 * S)
    assert out(device, "TOT1", "total") == (pytest.approx(total), status)


def test_a_level_is_calibrated_and_linearised() -> None:
    device = process_device("level")
    assert out(device) == (50.0, 0x80)
    write(device, "TB1", "lin_type", 20)
    assert out(device, "TB1", "primary_value")[0] == pytest.approx(50)  # half of the volume of 100
    device.process["level"] = 2.5
    device.settle()
    assert out(device, "TB1", "primary_value")[0] == pytest.approx(19.55, abs=0.01)  # a quarter of the height
    write(device, "TB1", "cal_point_hi", 5.0)
    assert device.block("TB1").number_of("level") == pytest.approx(50)


def test_a_table_is_loaded_point_by_point() -> None:
    device = process_device("level")
    write(device, "TB1", "tab_op_code", 1)
    for x, y in ((0, 0), (50, 80), (100, 100)):
        write(device, "TB1", "tab_x_y_value", {"x": float(x), "y": float(y)})
    assert device.block("TB1").get("tab_status") == 8
    write(device, "TB1", "tab_op_code", 3)
    assert (device.block("TB1").get("tab_status"), device.block("TB1").get("tab_actual_number")) == (1, 3)
    write(device, "TB1", "lin_type", 1)
    assert out(device)[0] == pytest.approx(80)
    write(device, "TB1", "tab_op_code", 1)
    write(device, "TB1", "tab_x_y_value", {"x": 5.0, "y": 1.0})
    write(device, "TB1", "tab_x_y_value", {"x": 4.0, "y": 2.0})
    write(device, "TB1", "tab_op_code", 3)
    assert [device.block("TB1").get("tab_status"), out(device)[0]] == [2, pytest.approx(80)]  # the old one counts


def test_temperature_differences_and_a_broken_wire() -> None:
    device = process_device("temperature")
    write(device, "TB1", "sensor_meas_type", 129)
    assert out(device)[0] == pytest.approx(1)
    write(device, "TB1", "primary_value_unit", 1000)
    assert device.block("TB1").number_of("rj_temp") == pytest.approx(295.15)
    device.active.add("sensor-failure")
    device.settle()
    assert device.block("TB1").get("input_fault_gen") == 1


# --- actuators ------------------------------------------------------------------------------------------------------


def set_point(device: ProcessDevice, value: float, status: int = 0x80, name: str = "sp") -> None:
    device.block("AO1").put_value(name, value, status)
    device.settle()


def back(device: ProcessDevice) -> tuple[float, float, str]:
    block = device.block("AO1")
    return round(block.part("readback", "value"), 3), block.part("pos_d", "value"), block.octets_of("check_back").hex()


def test_a_valve_moves_with_its_stroke_time_and_falls_to_fail_safe() -> None:
    device = process_device("positioner")
    assert back(device) == (0.0, 1, "010000")
    set_point(device, 60.0)
    found = []
    for seconds in (1, 2, 3, 4):
        device.advance(seconds * S)
        found.append(back(device))
    assert found == [(20.0, 3, "000100"), (40.0, 3, "000100"), (60.0, 3, "000000"), (60.0, 3, "000000")]
    set_point(device, 60.0, 0x00)
    device.advance(int(4.9 * S))
    assert back(device) == (60.0, 3, "000000")  # FSAFE_TIME runs
    device.advance(6 * S)
    assert back(device) == (40.0, 3, "010200")  # ACTUATOR_ACTION: it closes without supply
    device.advance(20 * S)
    assert back(device) == (0.0, 1, "010000")


@pytest.mark.parametrize(
    ("status", "moves"), [(0x80, True), (0xC0, True), (0x7F, False), (0x00, False), (0xA0, False), (0xE0, False)]
)
def test_the_status_of_a_set_point_decides(status: int, moves: bool) -> None:
    device = process_device("positioner")
    set_point(device, 100.0, status)
    device.advance(5 * S)
    assert (back(device)[0] == 100.0) is moves


def test_initiate_fail_safe_acts_at_once() -> None:
    device = process_device("positioner")
    set_point(device, 50.0)
    device.advance(5 * S)
    set_point(device, 50.0, 0xA0)
    device.advance(5 * S + S // 2)
    assert back(device)[0] == 40.0


@pytest.mark.parametrize(("kind", "after"), [(0, 30.0), (1, 50.0), (2, 0.0)])
def test_kinds_of_fail_safe(kind: int, after: float) -> None:
    device = process_device("positioner")
    device.block("AO1").put("fsafe_type", kind)
    device.block("AO1").put("fsafe_value", 30.0)
    set_point(device, 50.0)
    device.advance(10 * S)
    set_point(device, 0.0, 0)
    device.advance(30 * S)
    assert back(device)[0] == pytest.approx(after, abs=0.2)


def test_modes_of_an_output() -> None:
    device = process_device("positioner")
    write(device, "AO1", "target_mode", MAN)
    write(device, "AO1", "out", {"value": 25.0, "status": 0x80})
    device.advance(5 * S)
    assert back(device) == (25.0, 3, "004400")  # control inactive, parameters were changed
    write(device, "AO1", "target_mode", RCAS)
    assert cast("Mapping[str, int]", device.block("AO1").get("mode_blk"))["actual"] == AUTO  # RCAS_IN is bad
    set_point(device, 75.0, 0xC0, "rcas_in")
    device.advance(15 * S)
    assert back(device)[0] == 75.0
    device.is_local = True
    set_point(device, 10.0, 0xC0, "rcas_in")
    device.advance(20 * S)
    assert (back(device)[0], back(device)[2][:2]) == (75.0, "04")
    assert cast("Mapping[str, int]", device.block("AO1").get("mode_blk"))["actual"] == LOCAL


def test_tight_closing_direction_and_a_jam() -> None:
    device = process_device("positioner")
    set_point(device, 0.4)
    device.advance(5 * S)
    assert back(device)[:2] == (0.0, 1)
    write(device, "AO1", "increase_close", 1)
    set_point(device, 20.0)
    device.advance(20 * S)
    assert (device.process["position"], back(device)[0]) == (80.0, 20.0)
    device.transducers[0].blocked = True  # type: ignore[attr-defined]
    set_point(device, 90.0)
    device.advance(40 * S)
    assert (device.process["position"], back(device)[2]) == (80.0, "802000")


def test_a_self_calibration_is_a_function_check() -> None:
    device = process_device("positioner", condensed=True)
    write(device, "TB1", "self_calib_cmd", 1)
    assert (device.physical.get("diagnosis"), back(device)[2]) == (b"\0\0\x04\x80", "018000")
    device.advance(11 * S)
    assert (device.physical.get("diagnosis"), back(device)[2]) == (b"\0\0\0\0", "010000")


def test_an_on_off_valve() -> None:
    device = process_device("valve")
    device.block("DO1").put("sp_d", {"value": 1, "status": 0x80})
    device.settle()
    assert out(device, "DI1", "out_d") == (1, 0x80)
    assert out(device, "DO1", "readback_d") == (1, 0x80)
    device.block("DO1").put("sp_d", {"value": 1, "status": 0})
    device.settle()
    device.advance(2 * S)
    assert (out(device, "DI1", "out_d"), device.block("DO1").octets_of("check_back")[0]) == ((0, 0x80), 1)


def test_resets() -> None:
    device = process_device("pressure")
    write(device, "AI1", "fsafe_value", 5.0)
    write(device, "AI1", "tag_desc", "FT 101")
    write(device, "PB", "factory_reset", 1)
    assert (device.block("AI1").get("fsafe_value"), device.block("AI1").get("tag_desc")) == (0.0, "pressure")
    assert device.physical.get("diagnosis") == b"\0\x10\0\0"
    device.advance(10 * S)
    assert device.physical.get("diagnosis") == bytes(4)
    write(device, "PB", "factory_reset", 2506)
    assert device.physical.get("diagnosis") == b"\0\x08\0\0"
    write(device, "PB", "factory_reset", 2712)
    assert device.address_reset


def test_rows_that_the_kind_does_not_know() -> None:
    device = process_device(
        "pressure", [Row("AI", n) for n in ("pressure", "temperature")] + [Row("AI", "spare", 4, 1077)]
    )
    device.process["spare"] = 12.5
    device.settle()
    assert out(device, "AI3") == (12.5, 0x80)
    assert (device.block("AI3").slot, device.block("AI3").part("out_scale", "unit")) == (4, 1077)
    with pytest.raises(UsageError, match="no simulated process device 'presure'"):
        process_device("presure")


def test_blocks_say_who_they_are() -> None:
    assert repr(process_device("positioner")) == "<ProcessDevice PB, AO1, TB1>"
    block: Block = process_device("positioner").block("ao1")
    assert repr(block) == "<AnalogueOutput AO1 slot 1 index 16>"
    with pytest.raises(UsageError, match="no block 'AI9'; it has PB, AO1, TB1"):
        process_device("positioner").block("AI9")


EXTREME = st.sampled_from([0.0, 1e-45, -1e-45, 1.0, -3.4e38, 3.4e38, 1e38, -1e-38, 7.5])


@given(st.data(), st.sampled_from([kind for kind in KINDS if kind != "255 blocks"]))
def test_no_order_of_writes_breaks_a_device(data: st.DataObject, kind: str) -> None:
    """Numbers at the ends of their range in any parameters and units: taken or refused, and the device goes on."""
    device = process_device(kind)
    places = [(block, one) for block in device.blocks for one in block.parameters.values() if one.access != "r"]
    for _ in range(data.draw(st.integers(1, 8))):
        block, one = data.draw(st.sampled_from(places))
        octets = b""
        for element in datatype(one.kind).format.lstrip(">"):
            octets += struct.pack(">f", data.draw(EXTREME)) if element == "f" else b""
        length = datatype(one.kind).length
        rest = data.draw(st.sampled_from([b"\x01", b"\x10", b"\x04\x71", b"\x04\x69", b"\x00"]))
        code_of_write(device, block.slot, block.index + one.relative, (octets + rest * length)[:length])
        device.process.update(dict.fromkeys(device.process, data.draw(st.sampled_from([0.0, 5.0, -1e9, 1e9]))))
        device.advance(device.now + 10_000_000)
    for block in device.blocks:
        for one in block.parameters.values():
            block.get(one.name)
