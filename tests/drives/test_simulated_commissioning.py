"""Simulated drives as delivered, and set up for the bus; terminals that take the command away; the keypad."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from drive_bench import DeviceBench, PairBench
from slave_kit import Bench

from dpstack.dp.slave.application import SlaveApp
from dpstack.fdl.interface import Reply
from dpstack.fdl.telegram import Resp
from dpstack.profile import DriveProfile, State
from dpstack_drives.demag import DRIVE as DEMAG
from dpstack_drives.fuji import DRIVE as FUJI
from dpstack_drives.imo import DRIVE as IMO
from dpstack_drives.keb import DRIVE as KEB
from dpstack_drives.ls import DRIVE as LS
from tests.drives import ls_kit
from tests.drives.fuji_kit import ZERO, pkw, plugin, running, sim

NONE: Mapping[str, Any] = {}
SETTINGS: list[tuple[DriveProfile, dict[str, float], str]] = [
    (DEMAG, {"412": 44}, "412 is 44"),
    (FUJI, {"y98": 0}, "y98 is 0"),
    (IMO, {"P00.01": 0, "P00.06": 0}, "SW bits 13-14 are 0"),
    (KEB, {"oP.00": 0, "oP.01": 2, "ud.01": 0}, "oP.00 is 0, not 5"),
    (LS, {"dr-06": 1, "dr-07": 0}, "dr-07 is 0, not 8"),
]


@pytest.mark.parametrize(("drive", "factory", "says"), SETTINGS)
def test_as_delivered_the_bus_does_not_run_it_and_ready_is_the_one_switch(
    drive: DriveProfile, factory: dict[str, float], says: str
) -> None:
    delivered = drive.device()
    assert {name: delivered.store.value(name) for name in factory} == factory
    telegram = drive.default_telegram
    options = {"set_map": True} if drive is IMO else {}
    bench = PairBench(drive.core("it", telegram, options, simulated=True), delivered)
    text = bench.refused_as("fault", "start")
    assert says in text
    bench = PairBench(drive.core("it", telegram, options, simulated=True), drive.device(telegram, {"ready": True}))
    assert bench.ok("start") == "running"


def test_the_drives_of_a_plant_are_ready_unless_it_says_otherwise_and_single_values_go_first() -> None:
    assert FUJI.simulated(None, {}, {}).store.value("y98") == 3
    assert FUJI.simulated(None, {}, {"ready": False}).store.value("y98") == 0
    assert FUJI.simulated(None, {}, {"y98": 1}).store.value("y98") == 1
    modes = [DEMAG.simulated(None, {}, given).store.value("412") for given in ({}, {"ready": True}, {"412": 2})]
    assert modes == [44, 1, 2]


def test_as_delivered_no_contact_of_the_demag_is_closed() -> None:
    bench = DeviceBench(DEMAG.device("PPO3", {"412": 1}), "71")
    assert bench.send("00 06 00 00") == "00 40 00 00"
    assert list(bench.device.injected) == []
    bench.device.release(True)
    bench.device.contact("S3", True)
    assert bench.send("00 06 00 00") == "02 21 00 00"


# -- Fuji: terminals and y99 -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "on"), [("LE", False), ("loc", True)])
def test_f10_terminals_go_before_the_bus(name: str, on: bool) -> None:
    """Bit 9 of STW goes, the drive stops by F08 and does not start again by itself."""
    bench = running()
    bench.device.contact(name, on)
    assert list(bench.device.injected) == [f"contact {name.upper()} {'on' if on else 'off'}"]
    assert bench.send("04 7F 40 00", 100)[:2] == "00"
    assert bench.send("04 7F 40 00", 1500) == "00 40 00 00"
    bench.device.contact(name, not on)
    assert bench.send("04 7F 40 00", 100) == "02 70 00 00"
    assert list(bench.device.injected) == []


@pytest.mark.parametrize(
    ("y99", "inputs"), [(0, "03 37 40 00"), (1, "03 37 00 00"), (2, "02 40 00 00"), (3, "00 40 00 00")]
)
def test_f10_y99_goes_before_the_bus(y99: int, inputs: str) -> None:
    """1: the loader has the frequency, 2 the run command, 3 both."""
    bench = sim(y99=y99)
    bench.send("04 7E 40 00", 20)
    assert bench.send("04 7F 40 00", 1500) == inputs


def test_f10_the_plugin_names_the_terminals_where_y98_is_right() -> None:
    bench = plugin("PPO1", ZERO + "00 40 00 00")
    token = bench.order("start")
    while not bench.out().startswith("11 0F 62 00"):
        assert bench.result(token) is None
    bench.see("11 0F 62 00 00 00 00 03 00 40 00 00", 3)
    text = bench.text(token, "fault")
    assert text.startswith("STW bit 9 is 0 although y98 is 3: terminal LE is off, LOC is on, or y99 is not 0")


# -- Fuji: which of two alarms -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("malfunction", "code", "name"),
    [
        ("43 10", 17, "OH1 overheating of the heat sink"),
        ("43 10", 20, "OH4 motor protection (PTC thermistor)"),
        ("75 20", 53, "ErP RS-485 communications error of the option"),
        ("52 20", 54, "ErH LSI error of the power board"),
        ("52 20", 99, "Er3 CPU error or ErH LSI error of the power board"),
    ],
)
def test_f9_m16_tells_which_of_two_alarms_it_is(malfunction: str, code: int, name: str) -> None:
    fault = " 02 78 00 00"
    bench = plugin("PPO1", ZERO + fault.strip())
    while not bench.out().startswith("63 B3 01 00"):
        pass
    bench.see(f"43 B3 01 00 00 00 {malfunction}{fault}", 2)
    while not bench.out().startswith("11 03 10 00"):
        pass
    bench.see(f"11 03 10 00 00 00 00 {code:02X}{fault}", 3)
    assert bench.core.status().faults == (name,)


def test_f9_m16_that_is_refused_leaves_both_names() -> None:
    fault = " 02 78 00 00"
    bench = plugin("PPO1", ZERO + fault.strip())
    while not bench.out().startswith("63 B3 01 00"):
        pass
    bench.see(f"43 B3 01 00 00 00 43 10{fault}", 2)
    while not bench.out().startswith("11 03 10 00"):
        pass
    bench.see(f"71 03 10 00 00 00 00 00{fault}", 3)
    (text,) = bench.core.status().faults
    assert "OH1" in text
    assert "OH4" in text


def test_f14_the_maximum_frequency_is_locked_while_it_runs() -> None:
    """F03: error 11; at rest it is written."""
    bench = sim("PPO1")
    order = "21 04 03 00 00 00 03 E8"  # F03 = 100.0 Hz
    bench.send(f"{ZERO}04 7E 40 00", 20)
    bench.send(f"{ZERO}04 7F 40 00", 200)
    assert bench.send(f"{order} 04 7F 40 00", 20)[:23] == "71 04 03 00 00 00 00 0B"
    bench.send(f"{ZERO}04 7E 40 00", 1500)
    assert pkw(bench, order) == "11 04 03 00 00 00 03 E8"


# -- LS ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("telegram", "own"), [("PPO1", "61 52"), ("VENDOR 4/1", "63 50"), ("ST1", "61 52")])
def test_l1_version_2_01_offers_only_what_it_accepts(telegram: str, own: str) -> None:
    """Get_Cfg shows its own configuration: COM-50 = 2 and COM-30 = 3 words as delivered, or the vendor telegram."""
    device = LS.device(telegram, {"version": "2.01"})
    bench = Bench(device, SlaveApp(device, address=8))
    assert bench.ask(59) == Reply(Resp.DL, bytes.fromhex(own))
    assert all(device.check_cfg(config) is None for config in device.configs)
    assert "version 2.01 has no PPO1" in str(device.check_cfg(bytes.fromhex("F3 71")))


def test_l2_com_11_shows_the_profile_in_force() -> None:
    """0x170B; a new one is in force from COM-94 = 1, and the vendor telegram has 0."""
    bench = ls_kit.sim("PPO1")
    read = "10 17 0B 00 00 00 00 00"
    shown = [ls_kit.pkw(bench, read)[-2:]]
    for order in ("20 17 0B 00 00 00 00 02", "20 17 5E 00 00 00 00 01"):
        ls_kit.pkw(bench, order)
        shown.append(ls_kit.pkw(bench, read)[-2:])
    assert shown == ["01", "01", "02"]


# -- the keypad --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("drive", "code"), [(FUJI, "OC1"), (IMO, "OC1"), (KEB, "E.OL"), (LS, "11")])
def test_the_keypad_acknowledges_a_fault(drive: DriveProfile, code: str) -> None:
    options = {"set_map": True} if drive is IMO else {}
    bench = PairBench(drive.core("it", None, options, simulated=True), drive.simulated(None, {}, {}))
    with pytest.raises(ValueError, match="no fault stands"):
        bench.device.acknowledge()
    bench.ok("start")
    bench.device.trip(code)
    bench.pass_time(300)
    assert bench.core.status().state is State.FAULT
    bench.device.acknowledge()
    bench.pass_time(300)
    assert not bench.device.faulted
    assert bench.core.status().state is not State.FAULT
    assert not bench.device.motor.on
    assert bench.ok("start") == "running"


def test_a_drive_without_contacts_says_so() -> None:
    with pytest.raises(ValueError, match="'S1' is no contact of keb-f5; it has none here"):
        KEB.device().contact("S1", True)
    with pytest.raises(ValueError, match="keb-f5 has no internal set point here"):
        KEB.device().set_point(1)
