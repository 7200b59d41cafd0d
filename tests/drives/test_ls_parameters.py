"""The simulated LS S100: parameter channel, faults, a lost master, against literal octets."""

from __future__ import annotations

import pytest
from drive_bench import DeviceBench

from dpstack.errors import ConfigError
from dpstack_drives.ls import DRIVE
from tests.drives.ls_kit import NONE, ZERO, LsBench, pkw, running, sim

# -- parameter channel ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("order", "reply"),
    [
        ("13 C5 00 00 00 00 00 00", "13 C5 00 00 00 00 03 28"),  # PNU 965
        ("63 C4 01 00 00 00 00 00", "43 C4 01 00 00 00 00 01"),  # PNU 964[1]
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
        assert sim(telegram, {"COM-11": 2}).device.kind == kind


def trip(bench: LsBench, *numbers: int) -> None:
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


# -- docs/reference/drives/ls-s100.md#swap-and-lost-command ------------------------------------------------------------


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
    bench.lose(ms)
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
    bench.away(500)
    assert bench.send("04 7F 40 00", 2000) == "03 37 40 00"


def test_l11_the_ls_profile_holds_its_last_outputs() -> None:
    bench = sim(profile="ls")
    bench.until("60 02 17 70", "68 42 17 70", 3000)
    bench.away(3000)
    assert bench.send("60 02 17 70", 6) == "68 42 17 70"


# -- misuse --------------------------------------------------------------------------------------------------------


def test_unknown_trips_and_options_are_refused() -> None:
    with pytest.raises(ValueError, match="35 lost command"):
        DRIVE.device("PPO3").trip("E.OL")
    refused: list[tuple[str, str, object, str]] = [
        ("PPO3", "profile", "canopen", "'profidrive' or 'ls'"),
        ("ST1", "profile", "ls", "ST1 is a telegram of PROFIdrive"),
        ("PPO3", "module_rset", 1, "did you mean"),
        ("PPO4", "para_control", "000A", "para_control: 000A .* is read only"),
        ("PPO4", "para_status", "speed", "no address"),
    ]
    for telegram, option, value, says in refused:
        with pytest.raises(ConfigError, match=says):
            DRIVE.device(telegram, {option: value})


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
