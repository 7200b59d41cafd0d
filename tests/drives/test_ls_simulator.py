"""The simulated LS S100 against literal octets (docs/reference/drives/ls-s100.md)."""

from __future__ import annotations

import pytest
from drive_bench import MS, S

from dpstack_drives.ls import DRIVE
from tests.drives.ls_kit import NO_OPTIONS, ZERO, pkw, running, sim

# -- PROFIdrive ----------------------------------------------------------------------------------------------------


def test_l3_a_run() -> None:
    bench = sim()
    assert bench.send("00 00 00 00") == "00 40 00 00"
    assert bench.send("04 7E 40 00") == "02 35 00 00"  # S2; bit 2 copies STW1 bit 3
    seen = bench.until("04 7F 40 00", "03 37 40 00", 3000)
    assert {inputs[:5] for inputs in seen} == {"02 35", "02 37", "03 37"}
    seen = bench.until("04 7E 40 00", "02 35 00 00", 3000)
    assert {inputs[:5] for inputs in seen[1:]} == {"02 35"}  # the ramp looks like S2
    assert bench.send("04 7C 40 00")[:5] == "02 64"  # OFF2: S1
    assert bench.send("04 7F 40 00")[:5] == "02 76"  # S1 is not left with ON set


@pytest.mark.parametrize(
    ("control", "status"),
    [
        ("04 77 40 00", "02 33"),  # bit 3 copied to 2: 1 from bit 0
        ("04 7D 40 00", "02 66"),  # OFF2, bits 0 and 3 still copied to 1 and 2
        ("00 7F 40 00", "01 37"),  # bit 10 = 0: ignored, but copied to 9
        ("00 00 00 00", "01 01"),  # Clear: everything is copied, it runs on
    ],
)
def test_l3_copies(control: str, status: str) -> None:
    """ZSW1 1, 2, 4, 5, 9 are STW1 0, 3, 1, 2, 10, whatever the state is."""
    assert running(sim()).send(control)[:5] == status


@pytest.mark.parametrize(("mode", "ms"), [(0, 1000), (2, 0)])
def test_l3_bit_3_stops_by_ad_08(mode: int, ms: int) -> None:
    bench = running(sim(codes={"Ad-08": mode}))
    start = bench.now
    bench.until("04 77 40 00", "02 33 00 00", 1500)
    assert ms <= (bench.now - start) / MS < ms + 100


def test_l3_off3_is_quicker_and_ends_in_s1() -> None:
    bench = running(sim(quick_stop_s=0.3))
    start = bench.now
    bench.until("04 7B 40 00", "02 56 00 00", 1000)
    assert 290 < (bench.now - start) / MS < 400


def test_l3_ramp_bits() -> None:
    bench = sim()
    bench.send("04 7E 40 00")
    bench.send("04 7F 40 00", 300)
    frozen = bench.send("04 5F 40 00", 100)  # bit 5 = 0
    assert bench.send("04 5F 40 00", 300) == frozen
    assert bench.send("04 6F 40 00", 1000) == "03 37 00 00"  # bit 4 = 0
    bench.until("04 7F 40 00", "03 37 40 00", 3000)
    assert bench.send("04 3F 40 00", 1200) == "03 37 00 00"  # bit 6 = 0


def test_l3_fault_warning_acknowledge() -> None:
    bench = running(sim())
    bench.device.warn(1)
    assert bench.send("04 7F 40 00")[:5] == "03 B7"
    bench.device.warn(0)
    bench.device.trip("overload")
    assert bench.send("04 7F 40 00") == "02 7E 00 00"
    assert bench.send("04 80 00 00") == "02 40 00 00"
    assert bench.send("04 7E 00 00") == "02 35 00 00"


def test_l3_reverse_only_by_sign_and_l5_f000_is_15_hz() -> None:
    """F000 is -25 %: 15 Hz reverse of 60; C000 is -60 Hz although the manual once says 60 Hz."""
    bench = running(sim(), "04 7F F0 00", "03 37 F0 00")
    assert bench.device.motor.frequency == pytest.approx(-15 / 60)
    bench.until("04 7F C0 00", "03 37 C0 00", 3000)
    assert bench.device.motor.frequency == -1.0
    bench = running(sim(), "0C 7F 10 00", "03 37 10 00")  # bit 11 is reserved
    assert bench.device.motor.frequency == 0.25


def test_l5_rpm() -> None:
    """04B0 is 1200 rpm."""
    bench = running(sim(speed_unit="rpm"), "04 7F 04 B0", "03 37 04 B0")
    assert bench.device.motor.frequency == pytest.approx(1200 / 1800)
    bench.until("04 7F FB 50", "03 37 FB 50", 3000)


def test_l5_com_14_acts_with_com_94() -> None:
    bench = sim("PPO1")
    assert pkw(bench, "20 17 0E 00 00 00 00 01") == "10 17 0E 00 00 00 00 01"
    bench.send(ZERO + "04 7E 20 00")
    bench.until(ZERO + "04 7F 20 00", ZERO + "03 37 20 00", 3000)  # still per cent
    bench.until(ZERO + "04 7E 00 00", ZERO + "02 35 00 00", 3000)
    assert pkw(bench, "20 17 5E 00 00 00 00 01") == "10 17 5E 00 00 00 00 01"
    bench.send(ZERO + "04 7E 00 00")
    bench.until(ZERO + "04 7F 03 84", ZERO + "03 37 03 84", 3000)  # 900 rpm
    assert bench.device.motor.frequency == pytest.approx(0.5)


def test_l2_another_command_source_leaves_it_in_s1() -> None:
    assert sim(codes={"dr-06": 1}).send("04 7E 40 00") == "02 74 00 00"


def test_safe_outputs_of_one_frame_count_although_clear_follows_at_once() -> None:
    for options in (NO_OPTIONS, {"profile": "ls"}):
        bench = sim(**options)
        if options:
            bench.until("60 02 17 70", "68 42 17 70", 3000)
        else:
            running(bench)
        bench.device.exchange(DRIVE.core("it", "PPO3", options).safe_outputs, bench.now + 10_000)
        bench.device.clear(bench.now + 20_000)
        bench.now += 3 * S
        bench.device.advance(bench.now)
        assert bench.device.motor.frequency == 0.0


# -- LS Drive profile ----------------------------------------------------------------------------------------------


def test_l4_a_run() -> None:
    bench = sim(profile="ls")
    assert bench.send("00 00 00 00") == "00 01 00 00"
    assert bench.send("60 00 17 70") == "60 01 00 00"  # authority granted, no command
    seen = bench.until("60 02 17 70", "68 42 17 70", 3000)  # 60.00 Hz forward, reached
    assert {inputs[:5] for inputs in seen[1:-2]} == {"68 12"}  # accelerating
    assert bench.send("60 00 17 70") == "68 42 17 70"  # no command: as it was
    seen = bench.until("60 01 17 70", "60 01 00 00", 3000)
    assert {inputs[:5] for inputs in seen[1:-2]} == {"61 22"}  # decelerating, stopping
    bench.until("60 04 0B B8", "70 44 0B B8", 3000)  # 30.00 Hz reverse
    assert bench.device.motor.frequency == -0.5
    assert bench.send("60 10 0B B8") == "60 01 00 00"  # emergency: coasts


def test_l4_without_authority_nothing_moves() -> None:
    bench = sim(profile="ls")
    assert bench.send("00 02 17 70", 300) == "00 01 00 00"
    assert bench.send("20 02 17 70", 300) == "28 42 00 00"  # runs, but the set point is not the bus's
    assert bench.send("00 00 17 70", 300) == "00 01 00 00"  # authority withdrawn
    assert sim(profile="ls", codes={"dr-06": 0}).send("60 02 17 70") == "80 01 00 00"  # the keypad controls


def test_l4_fault_and_reset_by_the_edge_of_bit_3() -> None:
    bench = sim(profile="ls")
    bench.until("60 02 17 70", "68 42 17 70", 3000)
    bench.device.trip("11")
    assert bench.send("60 02 17 70") == "60 09 00 00"
    assert bench.send("60 08 17 70") == "60 01 00 00"
    bench.device.trip("11")
    assert bench.send("60 08 17 70") == "60 09 00 00"  # no edge


def test_l4_dc_brake_by_ad_08() -> None:
    """Ramp down to Ad-17, then bit 7 for Ad-15; neither forward nor reverse meanwhile."""
    bench = sim(profile="ls", codes={"Ad-08": 1, "Ad-15": 0.5, "Ad-17": 6})
    bench.until("60 02 17 70", "68 42 17 70", 3000)
    bench.until("60 01 17 70", "61 80 00 00", 1000)
    began = bench.now
    assert not bench.device.motor.frequency
    seen = bench.until("60 01 17 70", "60 01 00 00", 1000)
    assert seen == ["61 80 00 00", "60 01 00 00"]
    assert 490 <= (bench.now - began) / MS <= 510
    bench.until("60 02 17 70", "68 42 17 70", 3000)
    bench.send("60 01 17 70", 950)
    bench.until("60 02 17 70", "68 42 17 70", 3000)  # a run command ends it


def test_l3_bit_3_stops_by_the_dc_brake() -> None:
    bench = running(sim(codes={"Ad-08": 1, "Ad-15": 0.5}))
    start = bench.now
    bench.until("04 77 40 00", "02 33 00 00", 1500)
    assert bench.device.motor.braking
    assert 880 < (bench.now - start) / MS < 950  # 60 to 5 Hz in 0.92 s
    bench.send("04 77 40 00", 600)
    assert bench.send("04 77 40 00") == "02 33 00 00"


def test_l4_jog_by_the_terminals() -> None:
    """Bit 9, at dr-11, while there is no command."""
    bench = sim(profile="ls", codes={"dr-11": 6})
    device = bench.device
    device.jog(-1)
    bench.until("60 00 17 70", "62 04 02 58", 1000)
    device.jog(1)
    bench.until("60 00 17 70", "62 02 02 58", 1000)
    bench.until("60 02 17 70", "68 42 17 70", 3000)  # a command goes before it
    device.jog(0)
    bench.until("60 01 17 70", "60 01 00 00", 3000)


def test_l4_brake_open_where_a_relay_is_brake_control() -> None:
    bench = sim(profile="ls", codes={"OU-31": 35, "Ad-44": 30})
    seen = bench.until("60 02 17 70", "6C 42 17 70", 3000)  # bit 10
    assert {inputs[:5] for inputs in seen[1:-1]} == {"68 12", "6C 12", "6C 42"}
    assert all((int(inputs[6:].replace(" ", ""), 16) >= 3000) is (inputs[:2] == "6C") for inputs in seen)
    assert bench.send("60 10 17 70") == "60 01 00 00"


# -- vendor telegram, maps -----------------------------------------------------------------------------------------


def test_l1_l7_vendor_words_as_delivered() -> None:
    """0005, 0006 / 000A, 000E, 000F; the counts of the configuration are taken over."""
    bench = sim("VENDOR 2/3")
    bench.until("17 70 00 02", "17 70 68 42 00 00", 3000)
    bench.device.trip("overvoltage")
    assert bench.send("17 70 00 02") == "00 00 60 09 00 0C"
    assert bench.send("17 70 00 08") == "00 00 60 01 00 00"


def test_l1_a_differing_count_is_taken_over() -> None:
    bench = sim("VENDOR 1/4", para_status="000A 000E", para_control="dr-03 dr-04")
    assert bench.send("00 32") == "00 00 60 01 00 00 00 00"
    assert bench.device.store.value("COM-30") == 4
    assert bench.device.store.value("COM-50") == 1
    assert bench.device.store.value("dr-03") == 5.0
    assert bench.device.store.eeprom_writes == 0


def test_l7_para_1_is_pzd3_in_ppos_and_values_out_of_range_are_ignored() -> None:
    bench = sim("PPO4", para_status="dr-03 000E", para_control="dr-03 dr-20")
    assert bench.send("04 7E 00 00 00 14 00 00 00 00 00 00") == "02 35 00 00 00 14 60 01 00 00 00 00"
    assert bench.send("04 7E 00 00 FF FF 00 00 00 00 00 00")[12:17] == "00 14"


def test_l7_000e_and_000a_tell_the_same_under_profidrive() -> None:
    bench = sim("PPO4")
    tail = " 00 00 00 00 00 00 00 00"
    bench.send("04 7E 40 00" + tail)
    bench.until("04 7F E0 00" + tail, "03 37 E0 00 0B B8 70 44 00 00 00 00", 3000)  # 30.00 Hz, reverse, reached


def test_l7_com_94_applies_a_map() -> None:
    bench = sim("PPO2")
    idle = ZERO + "00 " * 12
    for order in ("20 17 1F 00 00 00 11 03", "20 17 1E 00 00 00 00 01"):  # COM-31 := 1103, COM-30 := 1
        bench.send(idle, 10)
        assert bench.send(order + " 00" * 12, 10)[:11] == "1" + order[1:11]
    assert bench.send(idle)[36:] == "00 00 60 01 00 00 00 00"  # 000A, 000E, 000F
    bench.send("20 17 5E 00 00 00 00 01" + " 00" * 12, 10)
    assert bench.send(idle)[36:] == "00 0A 00 00 00 00 00 00"  # dr-03 = 1.0 s


def test_l11_swap_changes_words_but_not_the_parameter_channel() -> None:
    bench = sim("PPO1", swap=True)
    assert bench.send("13 C5 00 00 00 00 00 00 7E 04 00 40") == "13 C5 00 00 00 00 03 28 35 02 00 00"


def test_l1_version_2_01_has_only_the_vendor_telegram() -> None:
    device = DRIVE.device("VENDOR 2/3", {"version": "2.01"})
    assert device.check_cfg(bytes.fromhex("61 52")) is None
    assert device.check_cfg(bytes.fromhex("F3 71")) == "version 2.01 has no PPO1: take VENDOR n/m"
    assert "configuration" in str(device.check_cfg(b"\x12"))
    assert device.check_prm(bytes(2)) == "2 octets of user parameters, 3 are needed"
    assert device.check_prm(bytes.fromhex("80 00 00 00")) is None
