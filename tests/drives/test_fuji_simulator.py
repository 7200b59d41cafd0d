"""The simulated Fuji against literal octets, the worked run of the manual in order (docs/reference/drives/fuji.md)."""

from __future__ import annotations

import pytest
from drive_bench import MS, S

from dpstack.errors import ConfigError
from dpstack.profile import Leave
from dpstack_drives.fuji import DRIVE
from tests.drives.fuji_kit import WIDE, ZERO, FujiBench, again, pkw, running, sim


def test_f3_worked_run_of_the_drive() -> None:
    bench = sim()
    assert bench.send("00 00 00 00") == "02 40 00 00"  # 1
    assert bench.send("04 7E 40 00") == "02 31 00 00"  # 2
    seen = bench.until("04 7F 40 00", "03 37 40 00", 3000)  # 3
    speeding = [inputs for inputs in seen if not inputs.startswith("03 37")]
    assert speeding[0] == "02 31 00 00"
    assert {inputs[:5] for inputs in speeding[1:]} == {"02 37"}
    seen = bench.until("04 7E 40 00", "02 31 00 00", 3000)  # 4
    assert seen[0] == "03 37 40 00"
    assert {inputs[:5] for inputs in seen[1:-1]} == {"02 33"}
    bench.until("0C 7F 20 00", "03 37 E0 00", 3000)  # 5, reverse by bit 11
    bench.until("04 7E 20 00", "02 31 00 00", 3000)
    bench.until("04 7F E0 00", "03 37 E0 00", 3000)  # 6, reverse by the sign
    bench.device.trip("OC1")
    assert bench.send("04 7F E0 00") == "02 78 00 00"
    assert bench.send("04 80 10 00") == "02 40 00 00"  # 7
    assert bench.send("04 00 10 00") == "02 40 00 00"
    assert bench.send("04 7E 10 00") == "02 31 00 00"


def test_straight_047f_from_s1_stays_in_s1() -> None:
    assert sim().send("04 7F 40 00", 200) == "02 70 00 00"


def test_fdt_by_e31() -> None:
    bench = sim(E31=60.0)
    bench.send("04 7E 40 00")
    bench.until("04 7F 40 00", "07 37 40 00", 3000)


@pytest.mark.parametrize(
    ("control", "word"),
    [("04 7C 40 00", "02 60"), ("04 3F 40 00", "02 33"), ("04 77 40 00", "02 33"), ("00 7E 40 00", "03 37")],
)
def test_f12_bits(control: str, word: str) -> None:
    """OFF2 coasts to S1; b6 = 0 disables b0; b3 = 0 blocks; b10 = 0: the whole frame is ignored."""
    bench = running()
    assert bench.send(control)[:5] == word


def test_f12_off3_stops_with_h56_to_s1() -> None:
    bench = running(H56=0.5, F08=5)
    start = bench.now
    bench.until("04 7A 40 00", "02 50 00 00", 1000)
    assert 490 * MS < bench.now - start < 600 * MS


def test_f12_ramp_bits() -> None:
    bench = sim()
    bench.send("04 7E 40 00")
    bench.send("04 7F 40 00", 300)
    frozen = bench.send("04 5F 40 00", 100)  # b5 = 0
    assert bench.send("04 5F 40 00", 300) == frozen
    assert bench.send("04 6F 40 00", 300) == "02 37 00 00"  # b4 = 0
    bench.until("04 7F 40 00", "03 37 40 00", 3000)


def test_047f_during_the_ramp_takes_it_back() -> None:
    bench = running()
    assert bench.send("04 7E 40 00", 300)[:5] == "02 33"
    bench.until("04 7F 40 00", "03 37 40 00", 3000)


def test_f4_bit_11_and_the_sign_multiply() -> None:
    bench = sim()
    bench.send("04 7E 00 00")
    bench.until("0C 7F E0 00", "03 37 20 00", 3000)


@pytest.mark.parametrize(("y98", "word"), [(0, "00 40 00 00"), (1, "02 40 00 00"), (3, "02 31 00 00")])
def test_f10_command_source(y98: int, word: str) -> None:
    assert sim(y98=y98).send("04 7E 40 00") == word


def test_f10_run_from_the_bus_frequency_from_the_inverter() -> None:
    bench = sim(y98=2)
    bench.send("04 7E 40 00")
    assert bench.send("04 7F 40 00", 500) == "03 37 00 00"


def back(bench: FujiBench, ms: float, reason: Leave = Leave.WATCHDOG) -> str:
    """The master is away for some time; the word of the first inputs that come of a scan."""
    bench.away(ms, reason)
    return bench.send("00 00 00 00", 6)[:5]


@pytest.mark.parametrize(
    ("o27", "o28", "ms", "word"),
    [
        (0, 0, 20, "02 78"),
        (4, 9, 20, "02 78"),
        (1, 1.0, 500, "03 37"),
        (1, 1.0, 1100, "02 78"),
        (3, 0, 5000, "03 37"),
        (13, 0, 5000, "03 37"),
        (10, 0, 300, "02 37"),
        (10, 0, 2000, "02 78"),
        (11, 1.0, 500, "03 37"),
        (11, 1.0, 3000, "02 78"),
        (12, 1.0, 3000, "02 78"),
    ],
)
def test_f8_lost_communication(o27: int, o28: float, ms: float, word: str) -> None:
    assert back(running(o27=o27, o28=o28), ms) == word


@pytest.mark.parametrize(("o27", "word"), [(1, "02 78"), (2, "03 37"), (11, "02 78"), (12, "03 37")])
def test_f8_data_that_return_in_time(o27: int, word: str) -> None:
    bench = running(o27=o27, o28=1.0)
    assert back(bench, 500) == "03 37"
    assert bench.send("00 00 00 00", 5000)[:5] == word


def test_f8_no_watchdog_no_reaction_and_nothing_before_data() -> None:
    assert back(running(), 500, Leave.UNLOCK) == "03 37"
    bench = sim()
    bench.pass_time(1000)
    bench.away(1000)
    assert bench.send("00 00 00 00", 100) == "02 40 00 00"


def test_clear_is_ignored_by_bit_10() -> None:
    bench = running()
    bench.device.clear(bench.now)
    bench.now += 500 * MS
    assert bench.device.exchange(bytes(4), bench.now).hex() == "03374000"


def test_safe_outputs_of_one_frame_count_although_clear_follows_at_once() -> None:
    bench = running()
    bench.device.exchange(DRIVE.core("fan", "PPO3").safe_outputs, bench.now + 10_000)
    bench.device.clear(bench.now + 20_000)
    bench.now += 3 * S
    bench.device.advance(bench.now)
    assert bench.device.exchange(bytes(4), bench.now).hex() == "02310000"


def test_unknown_alarms_and_options_are_refused() -> None:
    with pytest.raises(ValueError, match="Er5"):
        DRIVE.device("PPO3").trip("F2100")
    DRIVE.device("PPO3").trip("35")
    with pytest.raises(ConfigError, match="'sign' or 'bit'"):
        DRIVE.core("fan", "PPO3", {"reverse": "left"})
    with pytest.raises(ConfigError, match=r"0\.\.3"):
        DRIVE.device("PPO3", {"y98": 4})


def test_f2_bit_6_of_the_drive_is_not_bit_0_of_ctw_state() -> None:
    bench = sim("PPO3", E31=30)
    assert bench.send("00 00 00 00") == "02 40 00 00"
    assert bench.send("04 7E 40 00") == "02 31 00 00"
    bench.until("04 7F 40 00", "07 37 40 00", 3000)  # 10: the output is at E31 and above
    assert bench.send("04 77 40 00")[:5] == "02 33"  # b3 = 0: S3


@pytest.mark.parametrize("supply", ["24v", "inverter"])
def test_f15_on_the_bus_without_the_inverter(supply: str) -> None:
    bench = sim("PPO1", supply=supply)
    bench.send(ZERO + "04 7E 40 00")
    bench.send(ZERO + "04 7F 40 00", 500)
    bench.device.release(False)
    assert bench.send(ZERO + "04 7F 40 00") == ZERO + "00 00 00 00"
    assert pkw(bench, "11 0F 62 00 00 00 00 00") == "71 0F 62 00 00 00 00 11"
    bench.device.release(True)
    assert bench.send(ZERO + "00 00 00 00") == ZERO + "02 40 00 00"  # as after power-up


@pytest.mark.parametrize(
    ("seconds", "supply", "stw"), [(0.9, "24v", "02 40"), (1.5, "24v", "02 48"), (1.5, "inverter", "02 40")]
)
def test_f15_an_option_that_was_off_under_a_live_inverter_is_er4(seconds: float, supply: str, stw: str) -> None:
    bench = sim("PPO2", supply=supply)
    bench.send(ZERO + "00 00 00 00" + WIDE)
    bench = again(bench, seconds, supply=supply)
    assert bench.send(ZERO + "00 00 00 00" + WIDE)[24:29] == stw
    if stw == "02 48":  # CTW is 0: its copies are
        assert pkw(bench, "63 B3 01 00 00 00 00 00") == "43 B3 01 00 00 00 75 10"
