"""Constructs of device files, by the octets of both ends."""

from __future__ import annotations

from pathlib import Path

import pytest
from drive_bench import PairBench, PluginBench, pair

from dpstack.devices.finding import find
from dpstack.errors import ConfigError
from dpstack.profile import DriveProfile

ALONE = {"check_settings": False}
HEAD = 'format = 1\nname = "it"\n'


def read(folder: Path, text: str) -> DriveProfile:
    path = folder / "it.toml"
    path.write_text(HEAD + text)
    return find(str(path))


def tripped(profile: DriveProfile, telegram: str, fault: str) -> PairBench:
    """Both ends, until the master has the name of the fault."""
    both = pair(profile, telegram, options=ALONE)
    both.pass_time(100)
    both.device.trip(fault)
    both.pass_time(400)
    return both


def test_false_takes_out_a_table_of_the_base(tmp_path: Path) -> None:
    profile = read(tmp_path, 'base = "profidrive"\n[telegrams]\n5 = false\n6 = false\n')
    assert "4" in profile.telegrams
    assert not {"5", "6"} & set(profile.telegrams)


def test_paths_of_a_base_are_relative_to_it(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "texts.csv").write_text("7011;F07011 motor overtemperature\n")
    text = (
        HEAD.replace("it", "low") + 'base = "profidrive"\n[fault]\ntexts = "texts.csv"\n[bus]\nmade_gsd = "low.gsd"\n'
    )
    (tmp_path / "below" / "low.toml").write_text(text)
    profile = read(tmp_path, 'base = "./below/low.toml"\n')
    assert profile.core("m").fault_names == {7011: "F07011 motor overtemperature"}
    assert profile.gsd == str(tmp_path / "below" / "low.gsd")


@pytest.mark.parametrize(
    ("parameter", "orders"),
    [
        ("{ number = 945, counter = 944 }", {"13 B0 00 00", "63 B1 00 00", "63 B1 01 00"}),
        ("{ number = 945, index = 1, count = 1, counter = 952 }", {"13 B8 00 00", "63 B1 01 00"}),
        ("{ number = 801, array = false, counter = 944 }", {"13 B0 00 00", "13 21 00 00"}),
    ],
)
def test_a_fault_is_read_from_its_parameter(tmp_path: Path, parameter: str, orders: set[str]) -> None:
    text = f"""base = "profidrive"
    [fault]
    parameter = {parameter}
    texts = {{ 7011 = "F07011 motor overtemperature" }}
    unknown = "F{{:05d}}"
    """
    both = pair(read(tmp_path, text), "PPO1", options=ALONE)
    both.pass_time(100)
    both.device.trip("F07011")
    seen = set()
    for _ in range(200):
        seen.add(both.run()[:4].hex(" ").upper())
    assert seen - {"00 00 00 00"} == orders
    assert both.core.faults() == ("F07011 motor overtemperature",)
    both.ok("acknowledge")
    both.pass_time(100)
    assert both.core.faults() == ()


def test_a_warning_that_is_a_number_comes_from_its_parameter(tmp_path: Path) -> None:
    text = """base = "profidrive"
    [warning]
    kind = "number"
    parameter = { number = 2122 }
    texts = { 910 = "A00910 too hot" }
    unknown = "A{:05d}"
    [channel]
    dialect = "paged"
    """
    core = read(tmp_path, text).core("drive", "PPO1", ALONE, simulated=True)
    plugin = PluginBench(core, "00" * 8 + "02B1 0000")  # bit 7: a warning stands
    assert plugin.out(2)[:11] == "60 7A 00 80"  # number 122 on the page of 2000
    plugin.see("40 7A 00 80 00 00 03 8E 02 B1 00 00")
    plugin.see("00" * 8 + "02B1 0000", 3)
    assert plugin.out(1)[:11] == "60 7A 01 80"
    plugin.see("40 7A 01 80 00 00 00 00 02 B1 00 00")
    plugin.see("00" * 8 + "02B1 0000", 3)
    assert plugin.core.warnings() == ("A00910 too hot",)


def test_texts_of_errors_of_the_parameter_channel_are_those_of_the_file(tmp_path: Path) -> None:
    text = 'base = "profidrive"\n[channel]\ndialect = "arrays"\nerrors = { 120 = "it cannot be mapped" }\n'
    core = read(tmp_path, text).core("drive", "PPO1", ALONE, simulated=True)
    plugin = PluginBench(core, "00" * 8 + "0231 0000")
    token = plugin.order("write", number=915, index=3, value=3074)
    assert plugin.out(3)[:23] == "63 93 03 00 00 00 00 00"  # of an unknown type: it is read first
    plugin.see("43 93 03 00 00 00 00 00 02 31 00 00")
    plugin.see("00" * 8 + "0231 0000", 3)
    assert plugin.out(1)[:23] == "73 93 03 00 00 00 0C 02"
    plugin.see("73 93 03 00 00 00 00 78 02 31 00 00")
    assert plugin.text(token, "parameter") == "parameter 915: error 120, it cannot be mapped"


def test_the_simulated_drive_shows_off2_and_off3_of_its_control_word() -> None:
    """PROFIdrive: bits 4 and 5 of the status word are 1 while neither is ordered."""
    both = pair(find("profidrive"), "PPO3", options=ALONE)
    both.pass_time(50)
    assert both.inputs[:2].hex() == "0231"
    both.ok("start")
    assert both.inputs[:2].hex() == "0337"
    both.ok("coast")
    assert both.inputs[:2].hex() == "0260"


def test_a_file_takes_movilink_for_its_parameter_channel(tmp_path: Path) -> None:
    text = """base = "profidrive"
    [channel]
    dialect = "movilink"
    [parameters]
    P100 = { number = 8461, title = "Control signal source" }
    """
    both = pair(read(tmp_path, text), "PPO1", options=ALONE)
    both.pass_time(50)
    token = both.order("read", number="P100")
    seen = set()
    while both.result(token) is None:
        seen.add(both.run()[:4].hex(" ").upper())
    assert "71 00 21 0D" in seen
    assert both.value(token) == 0


def test_movilink_has_no_answers_of_pkw(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="movilink has neither answers nor zero_between; leave them out"):
        read(tmp_path, 'base = "profidrive"\n[channel]\ndialect = "movilink"\nzero_between = false\n')


def test_a_set_point_in_rpm_waits_until_the_drive_has_said_what_100_percent_is(tmp_path: Path) -> None:
    text = """base = "profidrive"
    [reference]
    rpm = "p2000"
    [channel]
    dialect = "paged"
    [parameters]
    p2000 = { number = 2000, type = "f32", unit = "rpm", factory = 1500 }
    """
    both = pair(read(tmp_path, text), "PPO1")
    refused = both.order("frequency", value=5)
    assert both.text(refused, "usage") == "nobody knows how many Hz 100 % is: give the drive its option reference_hz"
    waits = both.order("rpm", value=300)
    assert both.result(waits) is None
    both.pass_time(1000)
    assert both.value(waits) == 0.2
    both.core.lost(both.now)
    overtaken, later = both.order("rpm", value=600), both.order("speed", value=0)
    both.pass_time(1000)
    assert both.text(overtaken, "usage") == "another set point was given before the drive had said what 100 % is"
    assert (both.value(later), both.core.setpoint) == (0, 0)
