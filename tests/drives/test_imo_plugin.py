"""IMO's plugin against literal octets: codes of CW and SW (docs/reference/drives/imo-hd2.md), what start and faults
tell."""

from __future__ import annotations

import pytest
from drive_bench import PluginBench

from dpstack.profile import State
from dpstack_drives.imo import DRIVE
from tests.drives.imo_kit import NOTHING, READY, RUNS, Card


def test_i1_one_frame_of_sixteen_words() -> None:
    spec = DRIVE.telegram()
    assert (spec.name, spec.config.hex(), spec.output_octets, spec.input_octets) == ("PKW+12", "f37b", 32, 32)
    assert spec.made_up
    assert DRIVE.core("pump").safe_outputs.hex(" ") == "00 " * 8 + "00 05" + " 00" * 22


def test_i2_i4_forward_reverse_stop_coast_reset() -> None:
    bench = Card(RUNS, rated_current=20, fault_names="11=OL1")
    assert bench.show(READY) == "00 05" + " 00" * 22
    bench.order("frequency", value=25.0)
    start = bench.order("start")
    assert bench.show(READY, rotations=40) == "00 01 09 C4" + " 00" * 20
    assert bench.result(start) is None
    # forward, 20.00 Hz, 10.0 A, 30.0 %, no fault
    bench.show("41 01 ", "07 D0 00 64 01 2C 00 00" + " 00" * 14)
    assert bench.value(start) == "running"
    status = bench.core.status()
    assert (status.frequency_hz, status.current, status.torque) == (20.0, 0.5, 0.3)
    bench.order("speed", value=-0.5)
    assert bench.show("41 01 ", rotations=2) == "00 02 09 C4" + " 00" * 20
    bench.show("41 02 ", "09 C4" + " 00" * 20)
    assert bench.core.status().speed == -0.5
    bench.order("stop")
    assert bench.show("41 02 ", "07 D0" + " 00" * 20, 2)[:5] == "00 05"
    assert bench.core.status().state is State.STOPPING
    bench.show(READY)
    assert bench.core.status().state is State.READY
    bench.order("coast")
    assert bench.show(READY, rotations=2)[:5] == "00 06"
    bench.show("41 04 ", "00 00 00 00 00 00 00 0B" + " 00" * 14)
    assert bench.core.status().faults == ("OL1 (code 11)",)
    assert "OL1 (code 11); acknowledge it first" in bench.refused("start")[1]
    bench.order("acknowledge")
    assert bench.show("41 04 ", rotations=2)[:5] == "00 07"
    assert bench.show(READY, rotations=200)[:5] == "00 05"


@pytest.mark.parametrize(
    ("sw", "state", "remote"),
    [
        ("41 01 ", State.STOPPING, True),  # runs, but not by our command
        ("41 03 ", State.READY, True),
        ("40 03 ", State.NOT_READY, True),
        ("41 04 ", State.FAULT, True),
        ("40 05 ", State.NOT_READY, True),
        ("41 06 ", State.READY, True),
        ("01 03 ", State.READY, False),
        ("21 03 ", State.READY, False),
        ("41 00 ", State.UNKNOWN, True),
        ("41 07 ", State.UNKNOWN, True),
    ],
)
def test_i2_states(sw: str, state: State, remote: bool) -> None:
    bench = Card({}, sw)
    status = bench.core.status()
    assert (status.state, status.remote) == (state, remote)


def test_i2_bits() -> None:
    bench = Card(RUNS, "DB 03 ", motor="2", heartbeat=True)
    status = bench.core.status()
    assert status.bits == ("bus_voltage", "motor_2", "synchronous", "overload", "remote", "heartbeat")
    assert status.warnings == ("overload pre-alarm",)
    assert bench.show("DB 03 ", rotations=1)[:5] == "82 05"
    bench.show("4B 03 ")
    assert bench.core.status().warnings == ("heartbeat not echoed (SW bit 15)",)
    for name, cw in (("torque_control", "8A"), ("clear_energy", "92"), ("pre_excitation", "A2"), ("dc_brake", "C2")):
        bench.ok("control", number=name, value=1)
        assert bench.show("CB 03 ", rotations=1)[:5] == f"{cw} 05"
        bench.do("control", number=name, value=0)
    assert "torque_control, clear_energy" in bench.misuse("control", number="motor", value=1)


def test_i2_inching_and_pre_excitation_last_until_another_command() -> None:
    bench = Card(RUNS)
    for direction, cw in (("forward", "00 03"), ("reverse", "00 04"), ("stop", "00 08")):
        bench.ok("inch", direction=direction)
        assert bench.show(READY, rotations=1)[:5] == cw
    bench.do("inch", direction="forward")
    bench.show("41 01 ")
    assert bench.core.status().state is State.RUNNING
    bench.order("stop")
    assert bench.show("41 01 ", rotations=1)[:5] == "00 05"
    bench.show(READY)
    bench.ok("pre_excite")
    assert bench.show(READY, rotations=1)[:5] == "00 09"
    bench.show("41 04 ")  # a fault ends it: not again after its reset
    assert bench.show(READY)[:5] == "00 05"
    bench.order("start")
    bench.show(READY)
    bench.show("41 01 ")
    assert "stop() it first" in bench.misuse("inch", direction="forward")
    assert "forward, reverse, stop" in bench.misuse("inch", direction="up")


def test_i2_no_quick_stop_is_said_by_name() -> None:
    bench = Card(RUNS)
    assert "no quick stop ramp: its emergency stop (6) coasts" in bench.misuse("quick_stop")


@pytest.mark.parametrize(
    ("sw", "says"),
    [
        ("01 03 ", "SW bits 13-14 are 0: its keypad commands the drive"),
        ("21 03 ", "SW bits 13-14 are 1: its terminals commands the drive"),
        ("61 03 ", "SW bits 13-14 are 3"),
        ("40 03 ", "SW bit 8 is 0: the bus voltage is not established"),
        ("40 05 ", "POFF"),
    ],
)
def test_i2_start_says_what_keeps_it(sw: str, says: str) -> None:
    bench = Card(RUNS, sw)
    kind, why = bench.refused("start")
    assert kind == "fault"
    assert says in why
    assert bench.show(sw, rotations=1)[:5] == "00 05"


def test_i4_start_without_a_set_frequency_names_the_parameter() -> None:
    text = str(Card({3: 4}).do("start")["text"])
    assert "of P15.02 to P15.12 none is 1; set P15.02 to 1" in text


def test_i4_set_map_lets_start_write_it() -> None:
    bench = Card({}, set_map=True)
    bench.order("speed", value=0.5)
    bench.order("start")
    assert bench.show(READY)[:11] == "00 01 09 C4"
    assert bench.p15 == RUNS
    assert "00 04 0F 02 00 00 00 01" in bench.seen
    assert any("takes a limited number" in text for text in bench.notices())


def test_a_fault_without_a_fault_code_in_the_map_says_where_to_look() -> None:
    bench = Card({2: 1, 13: 1}, "41 04 ")
    assert "no transmitted PZD (P15.13 to P15.23) is 11, fault_code" in str(bench.core.status().fault)


def test_a_drive_that_never_tells_its_map_is_a_time_out_with_a_reason() -> None:
    bench = PluginBench(DRIVE.core("pump"), "00 " * 8 + READY + NOTHING)
    token = bench.order_and_run(400, "start", timeout_s=0.5)
    assert "process data map (P15.02 to P15.23) has not been read yet" in bench.text(token, "timeout")


def test_old_outputs_do_not_come_back_with_the_drive() -> None:
    bench = Card({2: 4})
    bench.do("output", number="torque", value=50)
    bench.do("control", number="dc_brake", value=1)
    assert bench.show(READY, rotations=1)[:11] == "40 05 01 F4"
    bench.core.lost(bench.now)
    assert bench.show(READY)[:11] == "00 05 00 00"
