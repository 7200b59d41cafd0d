"""Simulated drives: what their masters, their supplies and orders from outside do to them, octet by octet."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from demag_kit import NONE, START, ZERO, DemagBench, enable, ppo1
from demag_kit import device as demag_device
from demag_kit import pkw as demag_pkw
from demag_kit import sim as demag
from drive_bench import ALONE, MS, DeviceBench, PairBench
from slave_alarm_kit import OctetMaster
from slave_kit import SLAVE, Bench
from support import instance, present

from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.events import AddressChanged
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.profile import DriveDevice
from dpstack.units import NEVER
from dpstack_drives.demag import DRIVE as DEMAG
from dpstack_drives.fuji import DRIVE as FUJI
from dpstack_drives.imo import DRIVE as IMO
from dpstack_drives.keb import DRIVE as KEB
from dpstack_drives.ls import DRIVE as LS
from tests.drives.fuji_kit import device as fuji_device
from tests.drives.fuji_kit import pkw as fuji_pkw
from tests.drives.fuji_kit import sim as fuji
from tests.drives.imo_kit import RUNS, Card
from tests.drives.keb_kit import sim as keb
from tests.drives.ls_kit import LsBench
from tests.drives.ls_kit import pkw as ls_pkw
from tests.drives.ls_kit import sim as ls

# -- KEB -----------------------------------------------------------------------------------------------------------

#: E.buS at once, 0.1 s after the last sign of life
TRIPS: Mapping[str, object] = {"Pn.05": 0, "Pn.06": 0.1}
RUN = "00 05 05 DC"


def test_keb_sees_a_master_that_was_away_when_the_next_one_begins() -> None:
    """Communication Supervision: Fb40 bit 2 keeps the watchdog alive in user data exchange only."""
    bench = keb(TRIPS)
    assert bench.send(RUN, 1200)[:5] == "00 15"  # ready, run, reached
    bench.away(5000)
    assert bench.send("00 01 00 00", 40)[:5] == "00 02"  # fault: E.buS
    short = keb(TRIPS)
    short.send(RUN, 1200)
    short.away(50)
    assert short.send(RUN, 40)[:5] == "00 15"


def test_keb_without_its_release_coasts_and_is_not_ready() -> None:
    bench = keb()
    assert bench.send(RUN, 1200) == "00 15 05 DC"
    bench.device.release(False)
    assert bench.device.injected == ("release off",)
    assert bench.send(RUN, 60) == "00 00 00 00"  # neither ready nor running, no frequency
    assert not bench.device.motor.on
    bench.device.release(True)
    assert bench.send(RUN, 60)[:5] == "00 05"


def test_keb_link_and_busy_inverter_over_the_channel() -> None:
    bench = keb({}, "PCH+4/4")
    ask = [f"{bits}1 01 23 03 00 00 00 00 00 00 00 00" for bits in ("7", "3")]
    bench.device.link(False)
    assert bench.device.injected == ("link off",)
    assert bench.send(ask[0], 6)[:23] == "C1 01 23 03 06 02 00 00"  # 6/2: no connection to the inverter
    bench.device.link(True)
    bench.device.refuse("busy", 2)
    assert bench.device.injected == ("parameter-error busy 2",)
    assert bench.send(ask[1], 6)[:23] == "81 01 23 03 08 00 00 22"  # 8/0/0022: busy
    assert bench.send(ask[0], 6)[:23] == "C1 01 23 03 08 00 00 22"
    assert bench.send(ask[1], 6)[:23] == "01 01 23 03 00 00 00 00"
    assert not bench.device.injected


# -- Demag: mode 2, currents ---------------------------------------------------------------------------------------

CONTACTS: Mapping[str, object] = {"412": 2}


@pytest.mark.parametrize(
    ("outputs", "inputs"),
    [
        ("00 03 20 00", "06 27 20 00"),  # S1 and S2: clockwise
        ("00 05 20 00", "06 27 E0 00"),  # S1 and S3: anticlockwise
        ("00 05 E0 00", "06 27 20 00"),  # both turn round: a reading
    ],
)
def test_demag_mode_2_turns_by_s2_and_s3(outputs: str, inputs: str) -> None:
    bench = demag("PPO3", CONTACTS)
    assert bench.send("00 00 00 00") == "02 23 00 00"
    assert bench.send(outputs, 2000) == inputs
    both = outputs[:3] + "07" + outputs[5:]
    assert bench.send(both, 2000)[:5] in ("02 23", "06 23", "02 27", "06 27")
    assert not bench.device.motor.frequency


def test_demag_mode_2_from_one_direction_to_the_other() -> None:
    bench = demag("PPO3", CONTACTS)
    assert bench.send("00 03 20 00", 2000) == "06 27 20 00"
    assert bench.send("00 05 20 00", 3000) == "06 27 E0 00"
    assert bench.send("00 03 20 00", 3000) == "06 27 20 00"


def test_demag_250_shows_the_contacts_of_the_control_word() -> None:
    """11.2.1.3: S1IND only where the hardware release is there as well."""
    bench = demag("PPO1", CONTACTS)
    read = "10 FA 00 00 00 00 00 00"
    assert demag_pkw(bench, read) == "10 FA 00 00 00 00 00 00"
    bench.send(ZERO + "00 2D 00 00")
    assert bench.send(read + " 00 2D 00 00")[:23] == "10 FA 00 00 00 00 00 2D"
    bench.send(ZERO + "00 2D 00 00")
    bench.device.release(False)
    assert bench.send(read + " 00 2D 00 00")[:23] == "10 FA 00 00 00 00 00 2C"
    bench.send(ZERO + "70 2D 00 00")
    assert bench.send(read + " 70 2D 00 00")[:23] == "10 FA 00 00 00 00 00 2C"  # bits 12 to 14 are no contacts


def active_current(bench: DemagBench, outputs: str, ms: float) -> int:
    """PZD4 of PPO4 as a signed word."""
    word = int(bench.send(outputs + " 00 00" * 4, ms)[18:23].replace(" ", ""), 16)
    return (word ^ 0x8000) - 0x8000


def test_demag_active_current_is_positive_as_a_motor_in_both_directions() -> None:
    """11.2.3: positive currents are motor, negative ones generator operation."""
    for setpoint, back in (("20 00", "E0 00"), ("E0 00", "20 00")):
        bench = demag("PPO4", load=0)
        enable(bench, "00 00" + " 00 00" * 4, words=START[:2])
        # 1 per unit per second with an inertia of 0.1 s: a tenth of the rated torque, about 0666
        assert 0x0580 < active_current(bench, f"00 0F {setpoint}", 300) < 0x0680
        assert abs(active_current(bench, f"00 0F {setpoint}", 2000)) < 4
        assert -0x0680 < active_current(bench, f"00 0F {back}", 300) < -0x0580  # brakes
        bench.device.set_load(0.2)
        assert abs(active_current(bench, f"00 0F {setpoint}", 3000) - 0x0CCC) < 4


# -- Demag: address, configuration, errors, supply -----------------------------------------------------------------


def on_the_bus(device: DriveDevice, prm: str, config: str) -> Bench:
    """In data exchange with a master that knows octets only."""
    bench = Bench(device, SlaveApp(device, address=SLAVE))
    device.installed(SLAVE, 500_000)
    bench.prm_and_cfg(bytes.fromhex(prm), bytes.fromhex(config))
    assert bench.app.state is SlaveAppState.DATA_EXCH
    return bench


def exchange(bench: Bench, outputs: str, ms: int) -> str:
    """For some time, with the application's own time; the last inputs."""
    end, data = bench.now + ms * MS, b""
    while bench.now < end:
        bench.now += 2 * MS
        if bench.app.wake_at() <= bench.now:
            bench.app.tick(bench.now)
        if bench.app.state is SlaveAppState.DATA_EXCH:
            data = bench.dx(bytes.fromhex(outputs)).data
    return data.hex(" ").upper()


DEMAG_PRM = "80 01 01 0B 06 96 00" + " 00" * 16


def test_demag_391_is_answered_and_accepted_with_the_reset_that_it_brings() -> None:
    """Chapter 6: after the setting a reset is triggered, by which the address is accepted."""
    bench = on_the_bus(demag_device(), DEMAG_PRM, "F3 71")
    exchange(bench, ZERO + "00 00 00 00", 70)
    bench.app.take_events()
    assert exchange(bench, "21 87 00 00 00 00 00 09 00 00 00 00", 70)[:23] == "11 87 00 00 00 00 00 09"
    assert (bench.app.state, bench.app.address) == (SlaveAppState.DATA_EXCH, SLAVE)
    exchange(bench, ZERO + "00 00 00 00", 150)
    assert (bench.app.state, bench.app.address) == (SlaveAppState.WAIT_PRM, 9)
    told = [event for event in bench.app.take_events() if isinstance(event, AddressChanged)]
    assert [event.text for event in told] == ["slave 9 (demag-dedrive): address 8 became 9 by a setting of the device"]
    bench.app.restart(bench.now)
    assert bench.app.address == 9
    assert bench.app.wake_at() == NEVER


def test_demag_wrong_configuration_is_f2065() -> None:
    """13.2; the fault stands when the right configuration comes."""
    device = demag_device("PPO3")
    bench = Bench(device, SlaveApp(device, address=SLAVE))
    bench.prm_and_cfg(bytes.fromhex(DEMAG_PRM), bytes.fromhex("72"))
    assert bench.diag()[0] & 0x04  # Cfg_Fault
    bench.now += 100 * MS
    bench.prm_and_cfg(bytes.fromhex(DEMAG_PRM), bytes.fromhex("71"))
    assert exchange(bench, "60 00 00 00", 70) == "62 08 20 65"
    assert exchange(bench, "60 80 00 00", 70) == "62 08 20 65"  # no acknowledgement within 15 s
    exchange(bench, "60 00 00 00", 15_000)
    assert exchange(bench, "60 80 00 00", 70) == "62 40 00 00"


@pytest.mark.parametrize(
    ("error", "order", "reply", "other"),
    [
        ("18", "11 90 00 00 00 00 00 00", "71 90 00 00 00 00 00 12", None),
        ("103", "11 90 00 00 00 00 00 00", "71 90 00 00 00 00 00 67", "21 90 00 00 00 00 00 04"),
        ("104", "21 90 00 00 00 00 00 04", "71 90 00 00 00 00 00 68", "11 90 00 00 00 00 00 00"),
        ("105", "21 90 00 00 00 00 00 04", "71 90 00 00 00 00 00 69", None),
        ("106", "21 90 00 00 00 00 00 04", "71 90 00 00 00 00 00 6A", "11 90 00 00 00 00 00 00"),
    ],
)
def test_demag_errors_of_its_state(error: str, order: str, reply: str, other: str | None) -> None:
    """11.1.3; an error of reading leaves writes alone, one of writing reads."""
    bench = demag("PPO1")
    bench.device.refuse(error, 2)
    if other is not None:
        assert demag_pkw(bench, other).startswith("11 90")
    for _ in range(2):
        assert demag_pkw(bench, order) == reply
    assert demag_pkw(bench, order).startswith("11 90")
    with pytest.raises(ValueError, match=r"'99' is not one error .* known: 18 .* 103 .* 104 .* 105 .* 106"):
        bench.device.refuse("99")
    with pytest.raises(ValueError, match="'EEPROM' is not one error"):
        bench.device.refuse("EEPROM")


def test_demag_module_with_24_volts_of_its_own_stays_on_the_bus() -> None:
    """4.1: the Profibus stays, communication with the inverter is not possible without its power."""
    bench = demag("PPO1", NONE, supply="24v")
    enable(bench, head=ZERO, words=START[:2])
    assert bench.send(ZERO + "00 0F 20 00", 1500) == ZERO + "06 27 20 00"
    bench.send("81 E0 06 00 00 00 03 E8 00 0F 20 00")  # 480 in RAM only
    bench.device.mains(False)
    assert bench.device.injected == ("mains off",)
    assert bench.send("11 90 00 00 00 00 00 00 00 0F 20 00") == ZERO + "00 00 00 00"
    assert not bench.device.motor.on
    bench.device.mains(True)
    assert bench.send(ZERO + "00 00 20 00") == ZERO + "02 40 00 00"  # as after power-on
    assert demag_pkw(bench, "61 E0 01 00 00 00 00 00") == "51 E0 01 00 00 00 01 F4"
    with pytest.raises(ValueError, match=r'the inverter feeds the module .* supply = "24v"'):
        demag("PPO1").device.mains(False)


@pytest.mark.parametrize(("supply", "mains", "inputs"), [("24v", True, "62 08 20 61"), ("24v", False, "00 00 00 00")])
def test_demag_module_that_was_off_under_a_live_inverter_is_f2061(supply: str, mains: bool, inputs: str) -> None:
    before = demag("PPO3", NONE, supply=supply)
    before.device.mains(mains)
    before.send("60 00 00 00")
    after = demag_device("PPO3", supply=supply)
    after.inherit(before.device)
    assert DeviceBench(after, "71").send("60 00 00 00") == inputs


def test_demag_power_off_of_both_is_no_fault() -> None:
    after = demag_device("PPO3")
    after.inherit(demag("PPO3").device)
    assert DeviceBench(after, "71").send("60 00 00 00") == "62 40 00 00"


# -- Fuji ----------------------------------------------------------------------------------------------------------


def test_fuji_f01_is_104_01() -> None:
    """8.3 (3): "104 01" for F01."""
    bench = fuji("PPO1")
    assert fuji_pkw(bench, "11 04 01 00 00 00 00 00") == "11 04 01 00 00 00 00 00"
    assert fuji_pkw(bench, "21 04 01 00 00 00 00 02") == "11 04 01 00 00 00 00 02"
    assert fuji_pkw(bench, "11 04 01 00 00 00 00 00") == "11 04 01 00 00 00 00 02"


def test_fuji_967_is_the_word_sent_obeyed_or_not() -> None:
    bench = fuji("PPO1")
    bench.send(ZERO + "04 7E 40 00", 10)
    read = "13 C7 00 00 00 00 00 00"
    assert bench.send(read + " 00 7F 40 00", 10)[:23] == "13 C7 00 00 00 00 00 7F"  # bit 10 is 0
    assert bench.device.motor.on is False
    assert bench.send(read + " 04 7E 40 00", 10)[:23] == "13 C7 00 00 00 00 04 7E"


@pytest.mark.parametrize(
    ("error", "order", "code", "spared"),
    [
        ("104", "21 04 1A 00 00 00 00 05", "68", "11 04 1A 00 00 00 00 00"),
        ("busy", "21 04 1A 00 00 00 00 05", "68", "11 04 1A 00 00 00 00 00"),
        ("101", "21 04 1A 00 00 00 00 05", "65", "11 04 1A 00 00 00 00 00"),
        ("17", "11 04 1A 00 00 00 00 00", "11", "21 04 1A 00 00 00 00 05"),
    ],
)
def test_fuji_errors_of_its_state_stand_as_long_as_the_order(error: str, order: str, code: str, spared: str) -> None:
    bench = fuji("PPO1")
    bench.device.refuse(error)
    assert fuji_pkw(bench, spared).startswith("11 04 1A")
    assert fuji_pkw(bench, order) == f"71 04 1A 00 00 00 00 {code}"
    assert bench.send(order + " 00 00 00 00", 50)[:23] == f"71 04 1A 00 00 00 00 {code}"
    assert fuji_pkw(bench, order).startswith("11 04 1A")


def test_fuji_busy_drive_and_the_plugin() -> None:
    bench = PairBench(FUJI.core("fan", "PPO1", ALONE), fuji_device("PPO1"))
    bench.device.refuse("104", 3)
    assert bench.ok("write", number="F26", value=15) == 15
    assert not bench.device.injected


def test_fuji_and_imo_lose_their_mains_under_the_option() -> None:
    bench = fuji("PPO3")
    bench.device.mains(False)
    assert bench.send("04 7E 40 00", 20) == "00 00 00 00"
    card = IMO.simulated("PKW+12", {}, {})
    card.mains(False)
    assert not card.released


def test_imo_errors_of_its_state() -> None:
    bench = DeviceBench(IMO.simulated("PKW+12", {}, {}), "F3 7B")
    bench.device.refuse("5")
    rest = " 01 00" + " 00 00" * 11
    assert bench.send("00 01 00 0A 00 00 00 00" + rest, 20)[:23] == "00 01 00 0A 00 00 13 88"
    assert bench.send("00 04 00 0A 00 00 13 88" + rest, 20)[:23] == "00 03 00 0A 00 05 00 00"
    assert bench.send("00 04 00 0A 00 00 13 87" + rest, 20)[:23] == "00 01 00 0A 00 00 13 87"
    assert Card(RUNS).core.drive == "imo-hd2"


# -- LS ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("order", "reply"),
    [
        ("10 03 16 00 00 00 00 00", "10 03 16 00 00 00 00 00"),  # 6.2.1 prints 0316, 000B and 1101
        ("10 00 0B 00 00 00 00 00", "10 00 0B 00 00 00 00 00"),
        ("10 11 01 00 00 00 00 00", "10 11 01 00 00 00 00 00"),
        ("20 11 01 00 00 00 13 88", "10 11 01 00 00 00 13 88"),
        ("20 03 16 00 00 00 00 01", "70 03 16 00 00 00 00 01"),
        ("20 00 0B 00 00 00 00 01", "70 00 0B 00 00 00 00 01"),
        ("10 17 09 00 00 00 00 00", "10 17 09 00 00 00 00 05"),  # COM-09: ONLINE and CPU, as in 4.2.3
    ],
)
def test_ls_parameters_that_the_manual_prints(order: str, reply: str) -> None:
    assert ls_pkw(ls("PPO1"), order) == reply


def test_ls_voltage_and_power_follow_the_motor() -> None:
    bench = ls("PPO1")
    bench.send(ZERO + "04 7E 40 00")
    bench.until(ZERO + "04 7F 40 00", ZERO + "03 37 40 00", 3000)
    words = " 04 7F 40 00"
    assert bench.send("10 00 0B 00 00 00 00 00" + words, 20)[:23] == "10 00 0B 00 00 00 01 7C"  # 380
    assert bench.send("10 03 16 00 00 00 00 00" + words, 20)[:20] == "10 03 16 00 00 00 00"
    power = int(bench.send("10 03 16 00 00 00 00 00" + words, 20)[18:23].replace(" ", ""), 16)
    assert 14 <= power <= 15  # a fifth of the rated 75


def leds(bench: LsBench, words: str = "04 7E 00 00") -> str:
    return bench.send("10 17 09 00 00 00 00 00 " + words, 20)[21:23]


def test_ls_com_09_shows_the_leds() -> None:
    """Table 7 and 4.2.3: bit 0 CPU, bit 1 ERROR, bit 2 ONLINE."""
    bench = ls("PPO1", {"PRT-12": 3, "PRT-13": 1})
    assert leds(bench) == "05"
    bench.device.trip("LV")
    assert leds(bench) == "07"
    assert bench.send("10 17 09 00 00 00 00 00 04 FE 00 00", 20)[21:23] == "05"
    bench.away()
    module = present(bench.device.channel)
    # the command is lost until outputs come again: nobody has sent any yet
    assert module.step(bytes.fromhex("10 17 09 00 00 00 00 00")).hex(" ")[21:23] == "07"
    assert leds(bench) == "05"
    assert bench.device.check_cfg(bytes.fromhex("99")) is not None
    assert leds(bench) == "07"  # CONFIG ERROR
    assert bench.device.check_cfg(bench.config) is None
    assert leds(bench) == "05"


LS_PRM = "80 01 01 0B 0A 6C 00 80 20 00"  # DPV1_Enable, diagnosis alarms


def ls_master(prm: str = LS_PRM, **options: object) -> OctetMaster:
    device = LS.simulated("PPO3" if not options else "VENDOR 2/2", {}, options)
    bench = OctetMaster(device, SlaveApp(device, address=SLAVE))
    config = "71" if not options else "61 51"
    bench.start_with(bytes.fromhex(prm), bytes.fromhex(config), bytes.fromhex("04 7E 00 00"))
    return bench


def scans(bench: OctetMaster, outputs: str) -> bool:
    """Exchange for some scans; whether a diagnosis is to be fetched."""
    bench.outputs = bytes.fromhex(outputs)
    told = False
    for _ in range(2):
        bench.now += 20 * MS
        told |= bench.must_fetch
    return told


def test_ls_trip_is_a_diagnosis_alarm_of_ms1() -> None:
    """Table 2: MS1 of DP-V1 has Read, Write, Alarm."""
    bench = ls_master()
    assert isinstance(bench.device, DriveDevice)
    assert not scans(bench, "04 7E 00 00")
    bench.device.trip("overcurrent")
    assert scans(bench, "04 7E 00 00")
    assert bench.ext() == "06 01 01 01 00 0B"  # 6 octets, diagnosis, slot 1, appears, trip 11
    assert bench.ack("01 01 01") == "5C 01 01 01"
    assert scans(bench, "04 FE 00 00")  # acknowledged by STW1 bit 7
    assert bench.ext() == "04 01 01 0A"  # disappears, sequence number 1
    assert bench.ack("01 01 0A") == "5C 01 01 0A"


def test_ls_trip_without_alarms_is_no_diagnosis() -> None:
    for bench in (ls_master("80 01 01 0B 0A 6C 00 80 00 00"), ls_master(version="2.01")):
        instance(bench.device, DriveDevice).trip("overcurrent")
        assert not scans(bench, "04 7E 00 00")
        assert len(bench.diag()) == 6


def test_ls_error_from_outside_over_record_47() -> None:
    bench = ls("PPO3")
    server = present(bench.device.record47)
    bench.send("04 7E 00 00")
    bench.device.refuse("17", 2)  # 11 hex, of a write only

    def asked(request: str) -> str:
        now = bench.device.seen_until or 0
        assert server.write_record(1, 47, bytes.fromhex(request), now) is None
        while isinstance(data := server.read_record(1, 47, 240, now), RecordRequest) or not isinstance(data, bytes):
            bench.pass_time(1)
            now = bench.device.seen_until or 0
        return data.hex(" ").upper()

    assert asked("01 01 01 01 10 00 11 03 00 00") == "01 01 01 01 06 01 00 0A"
    assert asked("02 02 01 01 10 00 11 03 00 00 06 01 00 32") == "02 82 01 01 44 01 00 11"
    assert asked("03 02 01 01 10 00 11 03 00 00 06 01 00 32") == "03 82 01 01 44 01 00 11"
    assert asked("04 02 01 01 10 00 11 03 00 00 06 01 00 32") == "04 02 01 01"


def test_ls_com_94_takes_a_new_address_over() -> None:
    """4.2.2: COM-07 acts with COM-94 = 1."""
    bench = on_the_bus(LS.simulated("PPO1", {}, {}), LS_PRM, "F3 71")
    words = " 04 7E 00 00"
    exchange(bench, ZERO + words, 20)
    assert exchange(bench, "20 17 07 00 00 00 00 0C" + words, 300)[:23] == "10 17 07 00 00 00 00 0C"
    assert bench.app.address == SLAVE
    assert exchange(bench, "20 17 5E 00 00 00 00 01" + words, 50)[:23] == "10 17 5E 00 00 00 00 01"
    exchange(bench, ZERO + words, 150)
    assert (bench.app.state, bench.app.address) == (SlaveAppState.WAIT_PRM, 12)


def test_links_and_mains_that_are_none_are_refused() -> None:
    for drive in (DEMAG, FUJI, IMO, LS):
        with pytest.raises(ValueError, match="no link"):
            drive.device(drive.default_telegram, {}).link(False)
    for drive in (KEB, LS):
        with pytest.raises(ValueError, match="power-off"):
            drive.device(drive.default_telegram, {}).mains(False)
    assert ppo1().core.drive == "demag-dedrive"
