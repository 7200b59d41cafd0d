"""The simulated IMO HD2 against literal octets (docs/reference/drives/imo-hd2.md)."""

from __future__ import annotations

from typing import Any

import pytest
from drive_bench import MS, DeviceBench, S
from support import instance

from dpstack.errors import ConfigError
from dpstack_drives.imo import DRIVE
from dpstack_drives.imo.simulator import ImoDevice

NO_PKW = "00 00 00 00 00 00 00 00 "
#: PZD2 set frequency; back come frequency, current, torque, rpm, fault code
MAPS = {"P15.02": 1, "P15.13": 1, "P15.14": 5, "P15.15": 6, "P15.16": 8, "P15.17": 11}


class Bench(DeviceBench[ImoDevice]):
    """Process data without the PKW zone, short: the rest is zeros."""

    def __init__(self, **presets: Any) -> None:
        device = instance(DRIVE.simulated(None, {}, presets), ImoDevice)
        super().__init__(device, "F3 7B")

    def pzd(self, process: str, ms: float = 70) -> str:
        """SW and the first PZDs after ``process`` was sent for a time."""
        return self.send((NO_PKW + process + " 00" * 24)[: 32 * 3], ms)[24:]

    def pkw(self, request: str, cw: str = "01 05", ms: float = 20) -> str:
        """The response to a request, with a control word."""
        self.send(NO_PKW + cw + " 00" * 22, ms)
        return self.send(request + " " + cw + " 00" * 22, ms)[:23]


def test_i1_words_each_way() -> None:
    bench = Bench()
    assert bench.pzd("00 00") == "41 03" + " 00" * 22
    assert DRIVE.device().check_cfg(bytes.fromhex("F3 71")) == "configuration f3 71 is not f3 7b"
    assert (DRIVE.ident, DRIVE.ident_made_up, DRIVE.user_prm) == (0xDD02, True, b"")


def test_i2_i4_a_run_step_by_step() -> None:
    bench = Bench(**MAPS, load=0)
    assert bench.pzd("00 01 09 C4")[:5] == "41 01"  # forward, 25.00 Hz
    seen = bench.pzd("00 01 09 C4", 1500)
    assert seen[:11] == "41 01 09 C4"
    assert seen[12:29] == "00 28 00 00 02 EE"  # 4.0 A without load, 0 %, 750 rpm
    assert bench.pzd("00 02 09 C4")[:5] == "41 01"  # still forward while it slows down
    assert bench.pzd("00 02 09 C4", 1500)[:11] == "41 02 09 C4"
    assert bench.pzd("00 00 09 C4", 500)[:5] == "41 02"  # 0 is no command
    assert bench.pzd("00 05 09 C4", 200)[:5] == "41 02"
    assert bench.pzd("00 05 09 C4", 1500)[:11] == "41 03 00 00"
    bench.pzd("00 01 09 C4", 1500)
    assert bench.pzd("00 06 09 C4", 10)[:11] == "41 03 00 00"
    assert bench.device.motor.speed > 0.4  # coasts


def test_i2_ramps_are_exact_in_bus_time() -> None:
    bench = Bench(**MAPS, **{"P00.11": 2.0, "load": 0})
    start = bench.now
    while bench.pzd("00 01 13 88", 2)[6:11] != "13 88":
        assert bench.now < start + 3 * S
    assert 2 * S <= bench.now - start <= 2 * S + 20 * MS


def test_i2_inching_and_pre_excitation() -> None:
    bench = Bench(**MAPS)
    assert bench.pzd("00 03", 500)[:11] == "41 01 01 F4"  # 5.00 Hz, made up
    assert bench.pzd("00 08", 500)[:11] == "41 03 00 00"
    assert bench.pzd("00 04", 500)[:11] == "41 02 01 F4"
    assert bench.pzd("00 08", 500)[:5] == "41 03"
    assert bench.pzd("00 09")[:5] == "41 06"
    assert bench.pzd("00 05")[:5] == "41 03"
    assert bench.pzd("20 05")[:5] == "41 06"  # by bit 13


def test_i2_fault_and_reset() -> None:
    bench = Bench(**MAPS)
    bench.pzd("00 01 09 C4", 1500)
    bench.device.trip("OL1")
    assert bench.pzd("00 01 09 C4")[:5] == "41 04"
    assert bench.pzd("00 01 09 C4")[30:35] == "00 0B"
    assert bench.pzd("00 07 09 C4")[:5] == "41 03"
    assert bench.pzd("00 01 09 C4")[:5] == "41 01"
    with pytest.raises(ValueError, match=r"known \(made up\): OC1 \(4\)"):
        bench.device.trip("E.OL")
    bench.device.trip("29")


def test_i2_bits_of_the_control_word() -> None:
    bench = Bench(**MAPS)
    assert bench.pzd("82 05")[:5] == "C3 03"  # motor 2, heartbeat
    bench.device.warn(1)
    assert bench.pzd("00 05")[:5] == "51 03"
    with pytest.raises(ValueError, match="overload pre-alarm"):
        bench.device.warn(2)
    bench.device.warn(0)
    bench.device.release(False)
    assert bench.pzd("00 05")[:5] == "40 05"
    bench.device.release(True)
    bench.pzd("00 01 09 C4", 1500)
    assert bench.device.energy > 0
    bench.pzd("10 05 09 C4", 1500)
    assert bench.device.energy == 0
    bench.pzd("00 01 09 C4", 1500)
    assert bench.pzd("40 01 09 C4", 500)[:11] == "41 03 00 00"  # DC brake


@pytest.mark.parametrize(("source", "sw"), [(0, "01 03"), (1, "21 03"), (2, "41 01")])
def test_i2_only_communication_obeys_the_bus(source: int, sw: str) -> None:
    assert Bench(**MAPS, **{"P00.01": source}).pzd("00 01 09 C4", 500)[:5] == sw


def test_i3_the_read_of_the_manual() -> None:
    assert Bench().pkw("00 01 00 0A 00 00 00 00") == "00 01 00 0A 00 00 13 88"
    assert Bench().pkw("00 00 00 0A 00 00 00 00") == "00 00 00 00 00 00 00 00"


@pytest.mark.parametrize(
    ("request_", "cw", "response"),
    [
        ("00 04 00 0A 00 00 04 E2", "01 05", "00 01 00 0A 00 00 04 E2"),
        ("00 04 00 0A 00 00 04 E2", "00 05", "00 04 00 0A 00 00 00 00"),  # CW bit 8 is 0: no rights
        ("00 02 00 0A 00 00 04 E2", "01 05", "00 03 00 0A 00 01 00 00"),
        ("00 03 00 0A 00 00 04 E2", "01 05", "00 03 00 0A 00 01 00 00"),
        ("00 05 00 0A 00 00 04 E2", "01 05", "00 03 00 0A 00 01 00 00"),
        ("00 07 00 0A 00 00 04 E2", "01 05", "00 03 00 0A 00 01 00 00"),
        ("00 01 12 34 00 00 00 00", "01 05", "00 03 12 34 00 02 00 00"),
        ("00 04 12 34 00 00 00 00", "01 05", "00 03 12 34 00 02 00 00"),
        ("00 04 0F 01 00 00 00 7E", "01 05", "00 03 0F 01 00 03 00 00"),  # P15.01: 0..125
        ("00 04 0F 01 00 00 00 7D", "01 05", "00 01 0F 01 00 00 00 7D"),
        ("00 04 0F 02 00 00 00 13", "01 05", "00 03 0F 02 00 03 00 00"),  # P15.02: 0..18
        ("00 04 0F 17 00 00 00 1B", "01 05", "00 03 0F 17 00 03 00 00"),  # P15.23: 0..26
        ("00 04 0F 00 00 00 00 01", "01 05", "00 03 0F 00 00 07 00 00"),
        ("00 04 0F 01 00 00 00 03", "01 01", "00 03 0F 01 00 08 00 00"),  # while running
        ("00 01 0F 01 00 00 00 00", "00 05", "00 01 0F 01 00 00 00 02"),
        ("00 01 0F 02 00 00 00 00", "00 05", "00 01 0F 02 00 00 00 00"),
        ("00 01 0F 16 00 00 00 00", "00 05", "00 01 0F 16 00 00 00 00"),  # P15.22, missing in print
    ],
)
def test_i3_i5_requests_and_responses(request_: str, cw: str, response: str) -> None:
    assert Bench().pkw(request_, cw) == response


def test_i3_a_password() -> None:
    bench = Bench(protected=True)
    assert bench.pkw("00 04 00 0A 00 00 04 E2") == "00 03 00 0A 00 09 00 00"


def test_i3_a_request_that_stands_is_written_once_to_the_eeprom() -> None:
    bench = Bench()
    bench.pkw("00 04 00 0A 00 00 04 E2", ms=500)
    assert bench.device.store.eeprom_writes == 1
    bench.pkw("00 04 00 0A 00 00 04 E2")
    assert bench.device.store.eeprom_writes == 2
    after = instance(DRIVE.simulated(None, {}, {}), ImoDevice)
    after.inherit(bench.device)
    assert after.store.value("P00.10") == 12.5
    assert after.store.eeprom_writes == 2


def test_i4_the_rpm_of_the_manual() -> None:
    """P15.14 = 8: 00 0A in PZD3 is 10 rpm; 0.33 Hz of a motor with 30 rpm per Hz, without load."""
    bench = Bench(**{"P15.02": 1, "P15.14": 8, "load": 0})
    assert bench.pzd("00 01 00 21", 2000)[:17] == "41 01 00 00 00 0A"


def test_i4_a_map_written_acts_at_once_and_outlives_power_off() -> None:
    bench = Bench()
    assert bench.pzd("00 01 09 C4", 500)[:11] == "41 01 00 00"
    bench.pkw("00 04 0F 02 00 00 00 01", "01 01")
    bench.pkw("00 04 0F 0D 00 00 00 02", "01 01")
    assert bench.pzd("00 01 09 C4")[:11] == "41 01 09 C4"  # transmitted PZD2: the set frequency
    after = DRIVE.simulated(None, {}, {})
    after.inherit(bench.device)
    again = DeviceBench(after, "F3 7B")
    assert again.send(NO_PKW + "00 05 13 88" + " 00" * 20)[24:35] == "41 03 13 88"


@pytest.mark.parametrize(
    ("received", "sent", "transmitted", "told"),
    [
        (2, "01 F4", 18, "13 88"),  # PID reference: 1000 is 100 % on the way in, x100 on the way out
        (3, "03 E8", 19, "27 10"),
        (9, "02 01", 16, "02 01"),
        (10, "00 0F", 17, "00 0F"),
        (14, "FF FE", 21, "FF FE"),
        (15, "12 34", 22, "12 34"),
        (1, "27 10", 2, "27 10"),
    ],
)
def test_i4_received_and_transmitted(received: int, sent: str, transmitted: int, told: str) -> None:
    bench = Bench(**{"P15.12": received, "P15.23": transmitted})
    assert bench.pzd("00 05" + " 00" * 20 + " " + sent)[-5:] == told


@pytest.mark.parametrize(
    ("transmitted", "told"),
    [
        (3, "15 18"),  # 540.0 V
        (4, "00 C8"),  # 200 V at half of 400
        (10, "09 C4"),
        (20, "00 41"),
        (25, "41 01"),
        (12, "00 00"),
        (26, "00 00"),
    ],
)
def test_i4_transmitted_while_it_runs(transmitted: int, told: str) -> None:
    bench = Bench(**{"P15.02": 1, "P15.13": transmitted})
    assert bench.pzd("00 01 09 C4", 1500)[6:11] == told


def test_i4_load_shows_in_current_torque_and_power() -> None:
    bench = Bench(**{"P15.02": 1, "P15.13": 5, "P15.14": 6, "P15.15": 7})
    light = bench.pzd("00 01 13 88", 2500)
    bench.device.set_load(0.8)
    heavy = bench.pzd("00 01 13 88", 800)
    assert light[12:17] == "00 C8"  # 20.0 %
    assert heavy[12:17] == "03 20"  # 80.0 %
    assert int(heavy[6:11].replace(" ", ""), 16) > int(light[6:11].replace(" ", ""), 16)


def test_i4_limits_and_torque() -> None:
    """PZD2 set frequency, PZD3 and PZD4 the limits of either direction, PZD5 the motoring torque limit."""
    bench = Bench(**{"P15.02": 1, "P15.03": 5, "P15.04": 6, "P15.05": 7, "P15.13": 1, "P15.14": 6})
    assert bench.pzd("00 01 13 88 09 C4 03 E8 0B B8", 2000)[:11] == "41 01 09 C4"
    assert bench.pzd("00 02 13 88 09 C4 03 E8 0B B8", 2000)[:11] == "41 02 03 E8"
    bench.device.set_load(1.0)
    assert bench.pzd("00 02 13 88 09 C4 13 88 01 F4", 3000)[6:11] < "03 E8"  # 50 % torque cannot hold the load


def test_i4_torque_setting_counts_under_torque_control() -> None:
    bench = Bench(**{"P15.02": 1, "P15.03": 4, "P15.13": 6, "load": 0.6})
    assert bench.pzd("00 01 13 88 00 64", 2500)[6:11] == "02 58"  # 60.0 %
    assert bench.pzd("08 01 13 88 00 64", 1500)[6:11] <= "00 64"  # at most 10.0 %


def test_i4_position_feedback_is_taken_when_its_flag_falls() -> None:
    maps = {"P15.02": 16, "P15.03": 17, "P15.04": 18, "P15.13": 23, "P15.14": 24}
    bench = Bench(**maps)
    assert bench.pzd("00 05 FF FF 00 07 00 00")[6:17] == "00 00 00 00"
    assert bench.pzd("00 05 FF FF 00 07 00 01")[6:17] == "00 00 00 00"
    assert bench.pzd("00 05 FF FF 00 07 00 00")[6:17] == "FF FF 00 07"


@pytest.mark.parametrize(("how", "sw"), [("go_on", "41 01"), ("stop", "41 03"), ("coast", "41 03"), ("fault", "41 04")])
def test_a_lost_master_by_the_option(how: str, sw: str) -> None:
    """A reading: the card's manual does not say."""
    bench = Bench(**MAPS, on_loss=how)
    bench.pzd("00 01 09 C4", 1500)
    bench.away(3000)
    assert bench.pzd("00 00", 20)[:5] == sw


def test_zeros_and_clear_leave_it_running_the_safe_outputs_do_not() -> None:
    bench = Bench(**MAPS)
    bench.pzd("00 01 09 C4", 1500)
    bench.device.clear(bench.now)
    bench.now += S
    assert bench.device.exchange(bytes(32), bench.now)[8:10].hex() == "4101"
    bench.pzd("00 01 09 C4", 1500)
    bench.device.exchange(DRIVE.core("pump").safe_outputs, bench.now + 10_000)
    bench.device.clear(bench.now + 20_000)
    bench.now += 3 * S
    bench.device.advance(bench.now)
    assert bench.device.exchange(bytes(32), bench.now)[8:10].hex() == "4103"


def test_i5_options_and_presets_that_cannot_be() -> None:
    with pytest.raises(ConfigError, match="9 Mbit/s in the card's table"):
        DRIVE.device(None, {"baud_index": 9})
    with pytest.raises(ConfigError, match=r"P15\.01 \(Node address\): 126 is outside 0\.\.125"):
        DRIVE.device(None, {"P15.01": 126})
    with pytest.raises(ConfigError, match="'go_on' or 'stop'"):
        DRIVE.device(None, {"on_loss": "trip"})
