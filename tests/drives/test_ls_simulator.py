"""The simulated LS S100 against literal octets (L1 to L7, L9, L11)."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from drive_bench import MS, DeviceBench, S

from dpstack.errors import ConfigError
from dpstack.profile import Leave
from dpstack_drives.ls import DRIVE
from dpstack_drives.ls.simulator import LsDevice

NONE: Mapping[str, float] = {}
NO_OPTIONS: dict[str, object] = {}
ZERO = "00 00 00 00 00 00 00 00 "


def sim(telegram: str = "PPO3", codes: Mapping[str, float] = NONE, **options: object) -> DeviceBench:
    """``codes``: parameters by code."""
    return DeviceBench(DRIVE.device(telegram, {**options, **codes}), DRIVE.telegram(telegram).config.hex())


def pkw(bench: DeviceBench, order: str) -> str:
    """A fresh order in PPO1."""
    bench.send(ZERO + "00 00 00 00", 10)
    return bench.send(order + " 00 00 00 00", 10)[:23]


def running(bench: DeviceBench, outputs: str = "04 7F 40 00", inputs: str = "03 37 40 00") -> DeviceBench:
    bench.send("04 7E 00 00")
    bench.until(outputs, inputs, 3000)
    return bench


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
    assert isinstance(bench.device, LsDevice)
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


# -- parameter channel ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("order", "reply"),
    [
        ("13 C5 00 00 00 00 00 00", "13 C5 00 00 00 00 03 28"),  # L6: PNU 965
        ("63 C4 01 00 00 00 00 00", "43 C4 01 00 00 00 00 01"),  # L6: PNU 964[1]
        ("63 C4 00 00 00 00 00 00", "43 C4 00 00 00 00 03 51"),
        ("63 C4 06 00 00 00 00 00", "43 C4 06 00 00 00 0A 6C"),
        ("63 C4 07 00 00 00 00 00", "73 C4 07 00 00 00 00 03"),
        ("13 C5 01 00 00 00 00 00", "73 C5 01 00 00 00 00 03"),
        ("63 C5 00 00 00 00 00 00", "43 C5 00 00 00 00 03 28"),  # 6 on a plain one is taken too
        ("13 9A 00 00 00 00 00 00", "13 9A 00 00 00 00 00 65"),  # 922: 101
        ("13 A2 00 00 00 00 00 00", "13 A2 00 00 00 00 00 01"),  # 930
        ("13 96 00 00 00 00 00 00", "13 96 00 00 00 00 00 07"),  # 918
        ("13 C3 00 00 00 00 00 00", "13 C3 00 00 00 00 00 06"),  # 963: 1.5 Mbit/s
        ("13 C7 00 00 00 00 00 00", "13 C7 00 00 00 00 00 00"),  # 967
        ("13 C8 00 00 00 00 00 00", "13 C8 00 00 00 00 00 40"),  # 968
        ("10 11 03 00 00 00 00 00", "10 11 03 00 00 00 00 0A"),  # dr-03: 1.0 s
        ("20 11 03 00 00 00 00 32", "10 11 03 00 00 00 00 32"),
        ("70 11 03 00 00 00 00 32", "40 11 03 00 00 00 00 32"),
        ("20 11 03 00 00 00 FF FF", "70 11 03 00 00 00 00 02"),
        ("20 00 0A 00 00 00 00 00", "70 00 0A 00 00 00 00 01"),
        ("10 11 63 00 00 00 00 00", "70 11 63 00 00 00 00 00"),
        ("13 98 00 00 00 00 00 00", "73 98 00 00 00 00 00 00"),
        ("30 11 03 00 00 00 00 32", "70 11 03 00 00 00 00 05"),
        ("83 B3 00 00 00 00 00 00", "73 B3 00 00 00 00 00 05"),
        ("43 C5 00 00 00 00 00 00", "73 C5 00 00 00 00 00 09"),
        ("53 C5 00 00 00 00 00 00", "73 C5 00 00 00 00 00 07"),
        ("93 B3 00 00 00 00 00 00", "73 B3 00 00 00 00 00 04"),
    ],
)
def test_l6_l9_orders_and_replies(order: str, reply: str) -> None:
    assert pkw(sim("PPO1", codes={"COM-07": 7, "COM-12": 6}), order) == reply


def test_l6_a_write_acts_once_when_the_request_changes() -> None:
    bench = sim("PPO1")
    assert isinstance(bench.device, LsDevice)
    bench.send("20 11 03 00 00 00 00 32 00 00 00 00", 500)
    assert bench.device.store.eeprom_writes == 1
    bench.send("20 11 03 00 00 00 00 33 00 00 00 00", 500)  # no zero between
    assert bench.device.store.eeprom_writes == 2
    assert bench.device.store.value("dr-03") == 5.1


def test_l6_not_while_it_turns() -> None:
    bench = sim("PPO1")
    bench.send(ZERO + "04 7E 40 00")
    bench.until(ZERO + "04 7F 40 00", ZERO + "03 37 40 00", 3000)
    assert bench.send("20 11 14 00 00 00 13 88 04 7F 40 00").startswith("70 11 14 00 00 00 00 11")


@pytest.mark.parametrize(
    ("telegram", "options", "value"), [("PPO1", {}, "00 01"), ("PPO1", {"profile": "ls"}, "80 02")]
)
def test_l2_l9_pnu_930(telegram: str, options: dict[str, object], value: str) -> None:
    assert pkw(sim(telegram, NONE, **options), "13 A2 00 00 00 00 00 00")[18:] == value


def test_l2_the_telegram_decides_where_it_can() -> None:
    for telegram, kind in (("VENDOR 2/3", 0), ("ST1", 1)):
        bench = sim(telegram, {"COM-11": 2})
        assert isinstance(bench.device, LsDevice)
        assert bench.device.kind == kind


def trip(bench: DeviceBench, *numbers: int) -> None:
    for number in numbers:
        bench.device.trip(str(number))
        bench.send(ZERO + "04 00 00 00", 10)


def test_l2_a_fault_outlives_a_change_of_the_telegram_and_a_run_command_does_not() -> None:
    bench = running(sim())
    bench.device.enter(bytes.fromhex("61 52"), bench.now)  # VENDOR 2/3
    assert bench.send("00 00 00 00")[6:11] == "61 22"  # it ramps down
    assert bench.send("00 00 00 00", 1500)[6:11] == "60 01"
    bench.device.trip("BX")
    bench.send("00 00 00 00")
    bench.device.enter(b"\x71", bench.now)
    assert bench.send("04 7E 00 00") == "02 7C 00 00"


def test_l9_fault_situations() -> None:
    """947: eight of eight; the ninth overwrites the eighth, an acknowledgement shifts."""
    bench = sim("PPO1")
    trip(bench, 1, 2, 3, 4, 5, 6, 7, 10, 11)
    assert pkw(bench, "13 B0 00 00 00 00 00 00")[18:] == "00 09"  # 944
    assert pkw(bench, "63 B3 00 00 00 00 00 00")[18:] == "00 01"
    assert pkw(bench, "63 B3 06 00 00 00 00 00")[18:] == "00 07"
    assert pkw(bench, "63 B3 07 00 00 00 00 00")[18:] == "00 0B"
    bench.send(ZERO + "04 80 00 00")
    trip(bench, 35)
    assert pkw(bench, "63 B3 00 00 00 00 00 00")[18:] == "00 23"
    assert pkw(bench, "63 B3 01 00 00 00 00 00")[18:] == "00 00"
    assert pkw(bench, "63 B3 08 00 00 00 00 00")[18:] == "00 01"
    assert pkw(bench, "63 B3 0F 00 00 00 00 00")[18:] == "00 0B"
    assert pkw(bench, "63 B3 40 00 00 00 00 00") == "73 B3 40 00 00 00 00 03"
    for _ in range(8):
        bench.send(ZERO + "04 80 00 00", 10)
        trip(bench, 34)
        bench.send(ZERO + "04 00 00 00", 10)
    assert pkw(bench, "63 B3 3F 00 00 00 00 00")[18:] == "00 00"
    assert pkw(bench, "63 B3 38 00 00 00 00 00")[18:] == "00 22"


def test_l9_972_zeroes_944_947_and_953_when_it_rises() -> None:
    bench = sim("PPO1")
    bench.device.warn(0x0012)
    trip(bench, 12)
    assert pkw(bench, "13 B9 00 00 00 00 00 00")[18:] == "00 12"  # 953
    assert pkw(bench, "10 03 34 00 00 00 00 00")[18:] == "00 12"  # the word at 0334
    assert pkw(bench, "23 CC 00 00 00 00 00 01") == "13 CC 00 00 00 00 00 01"
    for pnu in ("13 B0", "63 B3", "13 B9"):
        assert pkw(bench, pnu + " 00 00 00 00 00 00")[18:] == "00 00"
    trip(bench, 12)
    assert pkw(bench, "23 CC 00 00 00 00 00 01")[:5] == "13 CC"  # no change, no reset
    assert pkw(bench, "13 B0 00 00 00 00 00 00")[18:] == "00 01"
    assert pkw(bench, "23 CC 00 00 00 00 00 02") == "73 CC 00 00 00 00 00 02"


# -- lost command (L11) --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "ms", "word"),
    [
        (0, 5000, "02 37"),  # as delivered: it goes on
        (1, 900, "02 37"),
        (1, 1100, "02 7E"),
        (2, 1500, "02 37"),  # on its ramp
        (2, 2200, "02 7E"),
        (3, 5000, "02 37"),
        (4, 5000, "02 37"),
        (5, 5000, "02 37"),
    ],
)
def test_l11_lost_command(mode: int, ms: float, word: str) -> None:
    bench = running(sim(codes={"PRT-12": mode, "PRT-13": 1.0, "PRT-14": 30.0}))
    bench.device.leave(Leave.WATCHDOG, bench.now)
    bench.now += round(ms * MS)
    bench.device.advance(bench.now)
    assert isinstance(bench.device, LsDevice)
    tripped = word == "02 7E"
    assert bench.device.module.situations[0] == ([35] if tripped else [])
    speeds = {0: 1.0, 3: 1.0, 4: 1.0, 5: 0.5}
    if mode in speeds:
        assert bench.device.motor.frequency == speeds[mode]
    assert bench.device.motor.on is not tripped
    bench.device.enter(b"\x71", bench.now)
    assert (bench.send("04 7F 40 00", 6)[3:5] == "7E") is tripped


def test_l11_data_that_return_in_time() -> None:
    bench = running(sim(codes={"PRT-12": 1}))
    bench.device.leave(Leave.WATCHDOG, bench.now)
    bench.now += 500 * MS
    bench.device.enter(b"\x71", bench.now)
    assert bench.send("04 7F 40 00", 2000) == "03 37 40 00"


def test_l11_the_ls_profile_holds_its_last_outputs() -> None:
    bench = sim(profile="ls")
    bench.until("60 02 17 70", "68 42 17 70", 3000)
    bench.device.leave(Leave.WATCHDOG, bench.now)
    bench.now += 3 * S
    bench.device.enter(b"\x71", bench.now)
    assert bench.send("60 02 17 70", 6) == "68 42 17 70"


# -- misuse --------------------------------------------------------------------------------------------------------


def test_unknown_trips_and_options_are_refused() -> None:
    with pytest.raises(ValueError, match="35 lost command"):
        DRIVE.device("PPO3").trip("E.OL")
    with pytest.raises(ConfigError, match="'profidrive' or 'ls'"):
        DRIVE.device("PPO3", {"profile": "canopen"})
    with pytest.raises(ConfigError, match="ST1 is a telegram of PROFIdrive"):
        DRIVE.device("ST1", {"profile": "ls"})
    with pytest.raises(ConfigError, match="did you mean"):
        DRIVE.device("PPO3", {"module_rset": 1})
    with pytest.raises(ConfigError, match=r"para_control: 000A .* is read only"):
        DRIVE.device("PPO4", {"para_control": "000A"})
    with pytest.raises(ConfigError, match="no address"):
        DRIVE.device("PPO4", {"para_status": "speed"})


def test_switched_off_and_on_it_has_what_was_written_and_com_11_counts() -> None:
    bench = sim("PPO1", codes={"DRV-03": 2.0})
    pkw(bench, "20 17 0B 00 00 00 00 02")  # COM-11 := 2, no COM-94
    assert pkw(bench, "13 A2 00 00 00 00 00 00")[18:] == "00 01"
    after = DRIVE.device("PPO1")
    after.inherit(bench.device)
    again = DeviceBench(after, "F3 71")
    assert pkw(again, "13 A2 00 00 00 00 00 00")[18:] == "80 02"
    assert pkw(again, "10 11 03 00 00 00 00 00")[18:] == "00 14"


def test_l9_918_and_963_tell_address_and_rate() -> None:
    for baud, shown in (
        (9600, "00 00"),
        (1_500_000, "00 06"),
        (45_450, "00 0B"),
        (12_000_000, "00 09"),
        (None, "00 FF"),
    ):
        bench = sim("PPO1")
        bench.device.installed(9, baud)
        assert pkw(bench, "13 96 00 00 00 00 00 00")[18:] == "00 09"
        assert pkw(bench, "13 C3 00 00 00 00 00 00")[18:] == shown
