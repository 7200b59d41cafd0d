"""LS S100's plugin against literal octets: profiles, faults, warnings, what a start tells."""

from __future__ import annotations

import pytest
from drive_bench import PairBench

from dpstack.errors import ConfigError
from dpstack.profile import State
from dpstack_drives.ls import DRIVE
from tests.drives.ls_kit import S2, ZERO, plugin

# -- PROFIdrive ----------------------------------------------------------------------------------------------------


def test_l3_a_run() -> None:
    bench = plugin("00 40 00 00")
    assert bench.out_after("speed", value=1.0) == "04 7E 40 00"
    start = bench.order("start")
    assert bench.see("02 74 00 00") == "04 7E 40 00"  # S1, with 047E copied
    assert bench.see("02 35 00 00") == "04 7F 40 00"
    assert bench.value(start, "02 37 00 10", 3) == "running"
    reached = bench.order("reached")
    bench.see("02 37 20 00", 60)
    assert bench.result(reached) is None
    assert bench.value(reached, "03 37 40 00") == 1.0
    stop = bench.order("stop")
    assert bench.out() == "04 7E 40 00"
    bench.see("02 35 20 00", 60)  # like S2, but it turns
    assert bench.core.status().state is State.STOPPING
    assert bench.result(stop) is None
    assert bench.value(stop, "02 35 00 00", 60) == "ready_to_switch_on"


def test_l3_taken_back_during_the_ramp() -> None:
    bench = plugin("02 35 20 00")
    assert bench.out_after("start") == "04 7F 00 00"
    assert bench.see("02 37 20 00") == "04 7F 00 00"


@pytest.mark.parametrize(("op", "word"), [("quick_stop", "04 7A"), ("coast", "04 7C"), ("acknowledge", "04 80")])
def test_l3_words(op: str, word: str) -> None:
    bench = plugin("02 48 00 00" if op == "acknowledge" else "03 37 40 00")
    assert bench.out_after(op)[:5] == word


def test_l3_s4_is_taken_only_with_3_and_6_clear() -> None:
    for word, state in (("02 77", State.UNKNOWN), ("02 3F", State.FAULT), ("02 37", State.RUNNING)):
        bench = plugin("02 37 00 00")
        bench.order("start")
        bench.see("02 37 00 00", 30)
        bench.see(word + " 00 00")
        assert bench.core.status().state is state


@pytest.mark.parametrize(("speed", "word"), [(1.0, "40 00"), (-0.25, "F0 00"), (-1.0, "C0 00"), (0.5, "20 00")])
def test_l5_per_cent_of_dr_20(speed: float, word: str) -> None:
    """F000 is 15 Hz reverse at 60 Hz; C000 is -60 Hz (the manual once prints 60 Hz)."""
    bench = plugin()
    assert bench.out_after("speed", value=speed)[6:] == word
    bench.see(f"02 37 {word}")
    assert bench.core.status().frequency_hz == 60 * speed


def test_l5_the_range_is_c000_to_4000() -> None:
    bench = plugin()
    for speed in (1.01, -1.5):
        assert "dr-20" in bench.misuse("speed", value=speed)


def test_l5_rpm() -> None:
    bench = plugin(speed_unit="rpm", reference_rpm=1500.0, reference_hz=50.0)
    assert bench.out_after("speed", value=0.8)[6:] == "04 B0"  # 1200 rpm
    bench.see("02 37 FB 50")
    assert bench.core.status().frequency_hz == pytest.approx(-40)


def test_safe_outputs() -> None:
    assert DRIVE.core("pump", "PPO3").safe_outputs.hex() == "047e0000"
    assert DRIVE.core("pump", "PPO1").safe_outputs.hex() == "0000000000000000047e0000"
    assert DRIVE.core("pump", "PPO3", {"profile": "ls"}).safe_outputs.hex() == "60010000"
    assert DRIVE.core("pump", "VENDOR 2/3").safe_outputs.hex() == "00000001"
    assert DRIVE.core("pump", "PPO3", {"swap": True}).safe_outputs.hex() == "7e040000"


# -- LS Drive profile ----------------------------------------------------------------------------------------------


def test_l4_a_run() -> None:
    bench = plugin("60 01 00 00", profile="ls")
    assert bench.out() == "60 01 00 00"
    bench.order("speed", value=1.0)
    start = bench.order("start")
    assert bench.out() == "60 02 17 70"  # forward, 60.00 Hz
    assert bench.value(start, "68 12 01 F4", 3) == "running"
    assert bench.core.status().frequency_hz == pytest.approx(5)
    assert bench.out_after("speed", value=-0.5) == "60 04 0B B8"
    bench.see("70 44 0B B8")
    assert bench.core.status().speed == pytest.approx(-0.5)
    assert bench.core.status().reached
    stop = bench.order("stop")
    assert bench.out() == "60 01 0B B8"
    bench.see("61 24 05 DC", 60)
    assert bench.core.status().state is State.STOPPING
    assert bench.value(stop, "60 01 00 00", 60) == "ready"
    assert bench.out_after("coast") == "60 10 0B B8"
    bench.see("60 09 00 00", 3)
    assert bench.out_after("acknowledge") == "60 08 0B B8"


def test_l4_what_the_profile_cannot_do_is_refused_by_name() -> None:
    bench = plugin("60 01 00 00", profile="ls")
    assert "no quick stop" in bench.misuse("quick_stop")
    with pytest.raises(ConfigError, match=r"drive pump .*ST1 is a telegram of PROFIdrive"):
        DRIVE.core("pump", "ST1", {"profile": "ls"})


def test_l4_the_keypad_in_control_is_told() -> None:
    bench = plugin("80 01 00 00", profile="ls")
    token = bench.order_and_run(200, "start")
    assert "bit 15: the keypad controls the drive: set dr-06" in bench.text(token)
    bench = plugin("00 01 00 00", profile="ls")
    token = bench.order_and_run(600, "start", timeout_s=1)
    assert "bit 13: the run authority is not granted: set dr-06" in bench.text(token)


# -- faults, warnings, what a start tells --------------------------------------------------------------------------


def test_l9_faults_and_warnings_by_name() -> None:
    bench = plugin(ZERO + S2, "PPO1")
    assert bench.see(ZERO + "02 7C 00 00", 3).startswith("63 B3 00 00")
    bench.see("43 B3 00 00 00 00 00 0B 02 7C 00 00", 2)
    assert bench.see(ZERO + "02 7C 00 00", 3).startswith("63 B3 01 00")
    bench.see("43 B3 01 00 00 00 00 22 02 7C 00 00", 2)
    bench.see(ZERO + "02 7C 00 00", 2)
    bench.see("43 B3 02 00 00 00 00 00 02 7C 00 00", 2)
    assert bench.core.status().faults == ("11 overcurrent", "34 LV")
    assert bench.see(ZERO + "02 B5 00 00", 3).startswith("13 B9 00 00")
    bench.see("13 B9 00 00 00 00 00 12 02 B5 00 00", 2)
    assert bench.core.status().warnings == ("warning word 0012",)
    assert "PPO3 has no parameter channel" in str(plugin("02 7C 00 00").core.status().fault)


def test_l4_bits_by_name() -> None:
    bench = plugin("66 80 00 00", "PPO3", profile="ls")
    assert bench.core.status().bits == ("dc_brake", "jog", "brake_open", "run_granted", "ramp_granted")


@pytest.mark.parametrize(
    ("option", "text"),
    [
        ("number", "11 overcurrent"),
        ("raw", "without a name (000F is 000B): VENDOR 2/3 has no parameter channel, the keypad shows it"),
    ],
)
def test_l7_l9_a_trip_in_the_vendor_telegram(option: str, text: str) -> None:
    """000A, 000E, 000F: the number of the simulated drive has a name, bits of the inverter's manual have not."""
    bench = plugin("00 00 00 09 00 0B", "VENDOR 2/3", trip_word=option)
    assert bench.core.status().faults == (text,)


def test_l9_what_was_asked_is_asked_again_after_the_drive_was_away() -> None:
    bench = plugin(ZERO + "02 7C 00 00", "PPO1")
    assert bench.out().startswith("63 B3 00 00")
    bench.core.lost(bench.now)
    assert bench.see(ZERO + "02 7C 00 00", 3).startswith("63 B3 00 00")
    bench.see("73 B3 00 00 00 00 00 00 02 7C 00 00", 2)
    assert bench.core.status().faults == ("without a name: PNU 947 holds none",)


def test_l2_a_start_with_another_profile_says_com_11() -> None:
    bench = plugin(ZERO + S2, "PPO1", check_settings=True)
    token = bench.order_and_run(1, "start")
    assert bench.out().startswith("13 A2 00 00")
    bench.see("13 A2 00 00 00 00 80 02 60 01 00 00", 2)
    assert bench.text(token) == (
        "the drive has profile 8002 (PNU 930), the option profile says 0001: set COM-11 to 1 and COM-94 to 1"
    )


def test_a_drive_that_stays_in_s1_is_told_with_what_to_look_at() -> None:
    bench = plugin("02 74 00 00")
    token = bench.order_and_run(600, "start", timeout_s=1)
    assert "stays in S1" in bench.text(token)
    assert "set dr-06 (command source) to 4" in bench.text(token)
    device = DRIVE.simulated("PPO1", {}, {"dr-06": 1})
    kind, why = PairBench(DRIVE.core("pump", "PPO1"), device).refused("start")
    assert kind == "fault"
    assert why.startswith("dr-06 is 1, not 4: set dr-06 (command source) to 4, field bus")


# -- with the simulated drive --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("telegram", "options"),
    [
        ("PPO1", {"profile": "ls"}),
        ("PPO6", {"profile": "ls", "swap": True}),
        ("PPO3", {"speed_unit": "rpm", "reference_rpm": 1450.0, "reference_hz": 50.0}),
        ("VENDOR 2/3", {}),
        ("VENDOR 4/5", {"para_control": "dr-03=1 0006 0005", "para_status": "000E In-90 000A"}),
    ],
)
def test_the_same_words_for_every_profile(telegram: str, options: dict[str, object]) -> None:
    bench = PairBench(DRIVE.core("pump", telegram, options), DRIVE.simulated(telegram, {}, options))
    for speed in (0.5, -0.25):
        bench.ok("speed", value=speed)
        assert bench.ok("start", timeout_s=3) == "running"
        assert bench.ok("reached", timeout_s=10) == pytest.approx(speed, abs=0.006)
        bench.ok("stop")
        assert bench.core.status().speed == pytest.approx(0, abs=0.02)
    bench.ok("start")
    bench.ok("coast")
    bench.device.trip("fan")
    bench.pass_time(300)
    assert bench.core.status().state is State.FAULT
    assert bench.refused("start")[0] == "fault"
    bench.ok("acknowledge")
    assert bench.ok("start") == "running"


def test_read_map_and_write_map() -> None:
    bench = PairBench(DRIVE.core("pump", "PPO2"), DRIVE.simulated("PPO2", {}, {}))
    assert bench.ok("read_map") == {"inputs": "000A 000E 000F", "outputs": "0005 0006"}
    assert bench.ok("write_map", inputs="dr-03 dr-04", outputs="dr-03") == {"inputs": "1103 1104", "outputs": "1103"}
    bench.ok("output", number="dr-03", value=3.0)
    bench.pass_time(50)
    assert bench.ok("inputs") == {"dr-03": 3.0, "dr-04": 1.0}
    assert bench.ok("read_map") == {"inputs": "1103 1104", "outputs": "1103"}
