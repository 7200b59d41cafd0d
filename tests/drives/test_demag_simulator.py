"""Demag, the simulated drive alone: literal outputs in, literal inputs out (docs/reference/drives/demag.md)."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import pytest
from demag_kit import NONE, START, ZERO, DemagBench, device, enable, pkw, sim
from drive_bench import MS, DeviceBench, S

from dpstack.profile import Leave
from dpstack_drives.demag import DRIVE


def enabled(presets: Mapping[str, Any] = NONE, reference: str = "20 00", ms: float = 1000) -> DemagBench:
    """PPO3 after the words of a start and some time more."""
    bench = sim("PPO3", presets)
    enable(bench, reference)
    bench.send(f"00 0F {reference}", ms)
    return bench


def test_d7_power_up_and_every_state_word_by_word() -> None:
    bench = sim()
    assert bench.send("00 00 00 00") == "02 40 00 00"
    assert bench.send("00 06 00 00") == "02 21 00 00"  # 2
    assert bench.send("00 07 00 00") == "02 23 00 00"  # 3
    assert bench.send("00 06 00 00") == "02 21 00 00"  # 6
    assert bench.send("00 00 00 00") == "02 40 00 00"  # 7
    bench.send("00 06 00 00")
    assert bench.send("00 07 00 00") == "02 23 00 00"
    assert bench.send("00 00 00 00") == "02 40 00 00"  # 10
    bench.send("00 06 00 00")
    bench.send("00 07 00 00")
    assert bench.send("00 0F 20 00", 20) == "02 27 01 06"  # 4: on the ramp, 0.8 Hz after one scan
    assert bench.send("00 0F 20 00", 1000) == "06 27 20 00"
    assert bench.send("00 06 20 00") == "02 21 00 00"  # 8
    bench.send("00 07 00 00")
    assert bench.send("00 0F 00 00", 1500) == "06 27 00 00"
    assert bench.send("00 00 00 00") == "02 40 00 00"  # 9
    assert bench.send("00 0F 00 00") == "06 27 00 00"  # the short cut


def test_d8_transition_5_ramps_down_and_can_be_taken_back() -> None:
    bench = enabled()
    word = bench.send("00 07 20 00", 200)
    assert word[:5] == "02 27"
    assert 0 < int(word[6:].replace(" ", ""), 16) < 0x2000
    assert bench.send("00 0F 20 00", 1000) == "06 27 20 00"
    seen = bench.until("00 07 20 00", "02 23 00 00", 2000)
    speeds = [int(inputs[6:].replace(" ", ""), 16) for inputs in seen]
    assert speeds == sorted(speeds, reverse=True)


@pytest.mark.parametrize(("how", "word"), [(0, "02 23 00 00"), (1, "02 27 00 00")])
def test_d8_transition_5_by_392(how: int, word: str) -> None:
    bench = enabled({"392": how, "632": 0.5})
    assert bench.send("00 07 20 00", 40) == word
    if how == 1:  # no new control word until 632 is over
        assert bench.send("00 0F 20 00", 300) == "02 27 00 00"
        bench.until("00 07 20 00", "02 23 00 00", 400)


def test_d8_quick_stop_11_and_12() -> None:
    bench = enabled({"424": 50, "638": 0.2})
    assert bench.send("00 02 20 00", 100)[:5] == "02 07"
    start = bench.now
    bench.until("00 02 20 00", "02 40 00 00", 2000)
    # 25 Hz at 50 Hz/s, 638, a few scans
    assert 0.5 * S < bench.now - start + 100 * MS < 0.5 * S + 300 * MS


def test_d18_412_is_44_at_the_factory_and_nothing_is_obeyed() -> None:
    bench = DeviceBench(DRIVE.device("PPO3"), "71")
    assert bench.send("00 06 00 00") == "00 23 00 00"
    assert bench.send("00 0F 20 00", 500) == "00 23 00 00"


def test_412_set_over_the_bus() -> None:
    bench = DeviceBench(DRIVE.simulated(None, {}, {"412": 44}), "F3 71")
    assert pkw(bench, "61 9C 00 00 00 00 00 00") == "41 9C 00 00 00 00 00 2C"
    assert pkw(bench, "71 9C 00 00 00 00 00 01") == "41 9C 00 00 00 00 00 01"
    assert bench.send(ZERO + "00 00 00 00") == ZERO + "02 40 00 00"


def test_d7_release() -> None:
    bench = enabled()
    assert bench.send("00 0F 20 00") == "06 27 20 00"
    bench.device.release(False)
    assert bench.send("00 0F 20 00") == "00 23 00 00"  # coasts, bit 9 gone
    assert bench.send("00 00 20 00") == "00 23 00 00"  # not obeyed
    bench.device.release(True)
    assert bench.send("00 00 20 00") == "02 40 00 00"


def test_d9_fault_and_its_lock_exact() -> None:
    bench = sim()
    enable(bench)
    bench.device.trip("F2100")
    came = bench.now + 16 * MS
    assert bench.send("00 00 00 00", 32) == "02 08 00 00"
    assert bench.send("60 00 00 00") == "62 08 21 00"
    while bench.now < came + 15 * S - 100 * MS:
        bench.send("00 80 00 00", 34)
        assert bench.send("00 00 00 00", 34) == "02 08 00 00"
    bench.send("00 00 00 00", (came + 15 * S - bench.now) / MS + 40)
    assert bench.send("00 80 00 00") == "02 40 00 00"


@pytest.mark.parametrize(("scans", "word"), [(937, "02 08 00 00"), (938, "02 40 00 00")])
def test_d9_the_scan_before_15_s_and_the_one_after(scans: int, word: str) -> None:
    """A scan is 16 ms: 937 of them are 14.992 s, 938 are 15.008 s; one edge each, and never another."""
    bench = sim()
    bench.rotation = MS
    enable(bench)
    bench.device.trip("F2100")
    while not bench.send("00 00 00 00", 1).startswith("02 08"):
        pass
    bench.send("00 00 00 00", 16 * (scans - 1))
    assert bench.send("00 00 00 00", 8) == "02 08 00 00"
    assert bench.send("00 80 00 00", 16) == word
    assert bench.send("00 80 00 00", 100) == word


def test_d7_d8_reaction_to_a_fault_and_a_quick_stop_step_by_step() -> None:
    """11 and 12 by 02, 13 and 14 by a fault, 15 by the edge of bit 7; bits 0-6 by the masks of the states."""
    bench = enabled({"424": 50})
    seen = bench.until("00 02 20 00", "02 40 00 00", 2000)
    assert {word[3:5] for word in seen} == {"27", "07", "40"}
    assert int(seen[1][3:5], 16) & 0x6F == 0x07  # quick stop
    assert int(seen[-1][3:5], 16) & 0x4F == 0x40  # switch-on inhibit
    assert bench.send("00 0F 20 00", 1000) == "06 27 20 00"
    bench.device.trip("F2100")
    seen = bench.until("00 0F 20 00", "02 08 00 00", 3000)
    assert {int(word[3:5], 16) & 0x4F for word in seen[1:]} <= {0x0F, 0x08}
    assert bench.send("00 0F 20 00", 15_100) == "02 08 00 00"
    assert bench.send("00 80 20 00", 40) == "02 40 00 00"  # 15


def test_faults_are_named_by_digits() -> None:
    drive = device()
    assert drive.fault_code("F2062") == 0x2062
    assert drive.fault_code("2065") == 0x2065
    with pytest.raises(ValueError, match="F2061"):
        drive.trip("motor")


def test_d13_selected_actual_values() -> None:
    bench = enabled(ms=1500)
    assert bench.send("00 0F 20 00") == "06 27 20 00"
    assert bench.send("10 0F 20 00")[:5] == "16 27"
    current, active = (int.from_bytes(bytes.fromhex(bench.send(f"{which} 0F 20 00"))[2:]) for which in ("10", "20"))
    assert active == pytest.approx(0.2 * 0x4000, abs=20)
    assert current == pytest.approx((0.2**2 + 0.4**2) ** 0.5 * 0x4000, abs=20)
    assert bench.send("30 0F 20 00") == "06 27 20 00"  # no such choice: the frequency
    bench.device.warn(0x0080)
    assert bench.send("50 0F 20 00") == "D6 A7 00 80"
    bench.device.warn(0x0020)
    assert bench.send("00 0F 20 00") == "06 A7 20 00"  # no trip soon
    assert bench.send("60 0F 20 00") == "66 A7 00 00"


def test_d17_inputs_change_once_a_scan() -> None:
    for telegram, scan, head in (("PPO3", 16, ""), ("PPO1", 32, ZERO)):
        bench = sim(telegram)
        bench.rotation = MS
        changes = []
        last = ""
        for control in START:
            for _ in range(2 * scan):
                inputs = bench.send(f"{head}{control} 40 00", 1)
                if inputs != last:
                    changes.append(bench.now)
                    last = inputs
        gaps = {(b - a) // MS for a, b in pairwise(changes[1:])}
        assert gaps
        assert all(gap % scan == 0 for gap in gaps)


def test_d11_references() -> None:
    bench = enabled({"390": 60, "375": 50}, ms=1500)
    assert bench.send("00 0F 20 00") == "06 27 20 00"
    assert bench.device.motor.frequency * 50 == pytest.approx(30)
    assert enabled(reference="E0 00", ms=1500).send("00 0F E0 00") == "06 27 E0 00"


@pytest.mark.parametrize(("word", "hundredths"), [("80 00", "FF FF B1 E0"), ("7F FF", "00 00 4E 1F")])
def test_d11_field_weakening_of_the_example(word: str, hundredths: str) -> None:
    """375 = 50 Hz and 390 = 100 Hz: 282 shows -200.00 and 199.99 Hz."""
    bench = sim("PPO1", {"390": 100, "375": 50})
    bench.send(ZERO + f"00 00 {word}")
    assert bench.send(f"11 1A 00 00 00 00 00 00 00 00 {word}")[:23] == f"21 1A 00 00 {hundredths}"


def test_d11_ramp_set_point_434() -> None:
    assert enabled({"434": 1}, ms=500).send("00 0F 20 00") == "06 27 00 00"
    line = enabled({"434": 2, "f_min": 5.0}, "00 00", 500)
    assert line.send("00 0F 00 00") == "06 27 06 66"  # + after power-on: 5 Hz of 50
    assert line.send("00 0F E0 00", 1500) == "06 27 E0 00"
    assert line.send("00 0F 00 00", 1500) == "06 27 F9 9A"  # the sign of the last one


def test_d6_examples() -> None:
    bench = sim("PPO1")
    assert pkw(bench, "11 90 00 00 00 00 00 00") == "11 90 00 00 00 00 00 02"
    assert pkw(bench, "81 E0 03 00 FF FF 8A D0") == "51 E0 03 00 FF FF 8A D0"
    assert pkw(bench, "61 E0 03 00 00 00 00 00") == "51 E0 03 00 FF FF 8A D0"
    assert pkw(bench, "61 E0 01 00 00 00 00 00") == "51 E0 01 00 00 00 01 F4"


def test_d4_a_new_order_is_ignored_until_zero() -> None:
    bench = sim("PPO1")
    assert pkw(bench, "11 90 00 00 00 00 00 00") == "11 90 00 00 00 00 00 02"
    assert bench.send("11 9E 00 00 00 00 00 00 00 00 00 00")[:23] == "11 90 00 00 00 00 00 02"
    assert bench.send(ZERO + "00 00 00 00")[:23] == ZERO.strip()


# order, reply: positive ones by the table, negative ones with their number
REPLIES = [
    ("00 00 00 00 00 00 00 00", "00 00 00 00 00 00 00 00"),
    ("11 90 00 00 00 00 00 00", "11 90 00 00 00 00 00 02"),  # 1 -> 1
    ("11 A8 00 00 00 00 00 00", "21 A8 00 00 00 00 27 10"),  # 1 -> 2: 424 = 100.00
    ("21 9E 00 00 00 00 00 02", "11 9E 00 00 00 00 00 02"),  # 2 -> 1
    ("31 A8 00 00 00 00 13 88", "21 A8 00 00 00 00 13 88"),  # 3 -> 2
    ("61 9C 00 00 00 00 00 00", "41 9C 00 00 00 00 00 01"),  # 6 -> 4
    ("61 E0 02 00 00 00 00 00", "51 E0 02 00 00 00 01 F4"),  # 6 -> 5
    ("71 B2 01 00 00 00 00 02", "41 B2 01 00 00 00 00 02"),  # 7 -> 4
    ("81 86 00 00 00 00 17 70", "51 86 00 00 00 00 17 70"),  # 8 -> 5
    ("13 E7 00 00 00 00 00 00", "73 E7 00 00 00 00 00 00"),  # 0: no such parameter
    ("20 F9 00 00 00 00 00 01", "70 F9 00 00 00 00 00 01"),  # 1: not alterable
    ("21 9E 00 00 00 00 00 05", "71 9E 00 00 00 00 00 02"),  # 2: limit
    ("61 E0 0A 00 00 00 00 00", "71 E0 0A 00 00 00 00 03"),  # 3: data set 10
    ("61 90 00 00 00 00 00 00", "71 90 00 00 00 00 00 04"),  # 4: array order on a plain parameter
    ("21 A8 00 00 00 00 00 01", "71 A8 00 00 00 00 00 05"),  # 5: word order on a long
    ("31 90 00 00 00 00 00 01", "71 90 00 00 00 00 00 05"),  # 5: long order on a word
    ("11 19 00 00 00 00 00 00", "71 19 00 00 00 00 00 65"),  # 101: text
    ("41 90 00 00 00 00 00 00", "71 90 00 00 00 00 00 6C"),  # 108: unknown order
    ("F1 90 00 00 00 00 00 00", "71 90 00 00 00 00 00 6C"),
]


@pytest.mark.parametrize(("order", "reply"), REPLIES)
def test_d3_orders_and_replies(order: str, reply: str) -> None:
    assert pkw(sim("PPO1"), order) == reply


def test_d3_read_of_data_set_0_with_unequal_sets() -> None:
    bench = sim("PPO1")
    pkw(bench, "81 E0 03 00 FF FF 8A D0")
    assert pkw(bench, "61 E0 00 00 00 00 00 00") == "71 E0 00 00 00 00 00 6B"
    assert pkw(bench, "81 E0 00 00 00 00 01 F4") == "51 E0 00 00 00 00 01 F4"
    assert pkw(bench, "61 E0 00 00 00 00 00 00") == "51 E0 00 00 00 00 01 F4"


def test_d5_eeprom_writes_are_counted() -> None:
    bench = sim("PPO1")
    store = bench.device.store
    pkw(bench, "81 E0 08 00 00 00 03 E8")  # data set 3, RAM only
    assert store.eeprom_writes == 0
    assert pkw(bench, "61 E0 03 00 00 00 00 00") == "51 E0 03 00 00 00 03 E8"
    for order, writes in (
        ("81 E0 01 00 00 00 03 E8", 1),
        ("81 E0 00 00 00 00 03 E8", 5),
        ("21 9E 05 00 00 00 00 02", 5),
    ):
        pkw(bench, order)
        assert store.eeprom_writes == writes
    store.power_up()
    assert pkw(bench, "11 9E 00 00 00 00 00 00") == "11 9E 00 00 00 00 00 00"


def test_d18_data_sets() -> None:
    bench = sim("PPO1")
    assert pkw(bench, "10 F9 00 00 00 00 00 00") == "10 F9 00 00 00 00 00 01"
    pkw(bench, "71 9C 03 00 00 00 00 2C")  # 412 = 44 in data set 3 only
    assert bench.send(ZERO + "00 00 00 00")[24:29] == "02 40"
    pkw(bench, "21 9E 00 00 00 00 00 03")  # 414 = 3
    assert bench.send(ZERO + "00 00 00 00")[24:29] == "00 23"
    assert pkw(bench, "10 F9 00 00 00 00 00 00") == "10 F9 00 00 00 00 00 03"


def test_d20_actual_parameters() -> None:
    bench = sim("PPO1")
    bench.device.warn(0x0881)
    assert pkw(bench, "11 0E 00 00 00 00 00 00") == "11 0E 00 00 00 00 08 81"
    assert bench.send("11 1A 00 00 00 00 00 00 00 00 20 00") is not None
    bench.send(ZERO + "00 00 E0 00")
    assert bench.send("11 1A 00 00 00 00 00 00 00 00 E0 00")[:23] == "21 1A 00 00 FF FF F6 3C"  # -25.00 Hz


def test_d7_mode_2_remote_contacts() -> None:
    bench = sim("PPO3", {"412": 2})
    assert bench.send("00 00 20 00") == "02 23 00 00"
    assert bench.send("00 03 20 00", 1500) == "06 27 20 00"
    bench.until("00 01 20 00", "02 23 00 00", 2000)


def test_d2_d13_ppo2_reports_everything() -> None:
    bench = sim("PPO2")
    rest = " 00 00 00 00 00 00 00 00"
    assert bench.send(ZERO + "00 00 00 00" + rest) == ZERO + "02 40 00 00 00 00 00 00 00 00 00 00"
    bench.device.trip("F2061")
    assert bench.send(ZERO + "60 00 00 00" + rest)[24:] == "02 08 00 00 00 00 00 00 00 00 20 61"


def test_d12_additional_reference_in_ppo4() -> None:
    bench = sim("PPO4")
    outputs = "20 00 10 00 00 00 00 00 00 00"
    enable(bench, outputs)
    assert bench.send(f"00 0F {outputs}", 1500)[6:11] == "30 00"


@pytest.mark.parametrize(
    ("reason", "word"),
    [(Leave.WATCHDOG, "02 08 00 00"), (Leave.UNLOCK, "02 40 00 00"), (Leave.NEW_PARAMETERS, "02 40 00 00")],
)
def test_d15_master_lost_while_running(reason: Leave, word: str) -> None:
    bench = enabled()
    bench.away(100, reason)
    assert bench.send("00 00 00 00") == word
    if reason is Leave.WATCHDOG:
        assert bench.send("60 00 00 00") == "62 08 20 62"


def test_master_lost_while_off_is_no_fault() -> None:
    bench = sim()
    bench.send("00 06 00 00")
    bench.away()
    assert bench.send("00 00 00 00") == "02 40 00 00"


def test_clear_lets_it_coast() -> None:
    bench = enabled()
    assert bench.send("00 0F 20 00") == "06 27 20 00"
    bench.device.clear(bench.now)
    bench.now += 100 * MS
    assert bench.device.exchange(bytes(4), bench.now).hex() == "02400000"


def test_it_is_the_same_whether_asked_often_or_not() -> None:
    def play(rotation: int) -> list[str]:
        bench = sim()
        bench.rotation = rotation
        return [bench.send(word, 800) for word in ("00 06 00 00", "00 07 00 00", "00 0F 20 00", "00 0F C0 00")]

    assert play(MS) == play(4 * MS) == play(8 * MS)


def test_a_long_silence_is_caught_up() -> None:
    bench = sim()
    enable(bench)
    assert bench.device.exchange(bytes.fromhex("000F2000"), bench.now + 10 * 3600 * S).hex() == "06272000"
