"""The commissioning sheet of a device file, obstacles by state, and files with Python behind them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from drive_bench import PluginBench

from dpstack.devices.finding import find
from dpstack.errors import ConfigError
from dpstack.profile import DescribedLed, DescribedRange, DriveProfile
from dpstack_drives.fuji import table as fuji

TEXT = """base = "profidrive"
source = "Acme, manual A1"
address = "p918"
only = ["PPO1", "PPO3"]
telegram_parameter = "p922"
acknowledge = "bit 7 of CW"
scan_ms = 20
missing = { warnings = "it has none" }
led = [{ name = "RUN", shows = "green", meaning = "it runs", source = "3.1" }]
range = [{ name = "torque", range = "0..100 %", wire = "4000h = 100 %", source = "3.2" }]
step = [
    { what = "S1 {tens}, S2 {ones}", why = "at {address}", source = "2.1", first = true, when = { address = [1, 99] } },
    { what = "by parameter: {address}", first = true, when = { address = [100, 126] } },
    { what = "p922 = {number}, then off", why = "telegram {telegram}", delivered = "1", source = "2.2", first = true },
    { what = "shaft {shaft}", when = { shaft = "left" } },
]
[telegrams]
PPO1 = { number = 1 }
PPO3 = { number = 3 }
[words]
control = { title = "CW (control word)" }
[control]
title = "CW"
[reference]
hz = 50
meaning = "p2000"
source = "4.1"
[options]
shaft = { default = "left", choices = ["left", "right"], text = "which" }
[obstacles]
remote = "bit 9 is 0"
switch_on_inhibited = { state = true, text = "it stays in S1" }
[fault]
sheet = "{code} (number {number}, PNU 947: {malfunction:04X}h)"
source = "table 9"
parameter = false
[fault.texts]
7 = { code = "E07", text = "earth fault", remedy = "see the cable", malfunction = 0x2330 }
[channel]
answers = { 1 = [1], 2 = [1] }
errors = { 0 = "no such parameter", 17 = "not now" }
source = "table 8"
[simulate]
ready = { p922 = 3 }
errors = [17]
[parameters]
p918 = { number = 918, title = "Address", factory = 126 }
p922 = { number = 922, title = "Telegram", factory = 1 }
[settings]
p922 = { equals = "{telegram}", remedy = "set {wanted}, not {}", why = "the words are its own", source = "2.2" }
"""


def read(folder: Path, text: str) -> DriveProfile:
    path = folder / "it.toml"
    path.write_text('format = 1\nname = "it"\n' + text)
    return find(str(path))


def test_the_sheet_has_the_facts_of_the_file(tmp_path: Path) -> None:
    profile = read(tmp_path, TEXT)
    assert sorted(profile.telegrams) == ["PPO1", "PPO3"]
    sheet = profile.describe(27, "PPO1")
    assert [(one.what, one.why, one.delivered, one.source) for one in sheet.steps] == [
        ("S1 2, S2 7", "at 27", "", "2.1"),
        ("p922 = 1, then off", "telegram PPO1", "1", "2.2"),
        ("p922 = 1", "the words are its own", "1", "2.2"),
        ("shaft left", "", "", "the device file"),
    ]
    assert sheet.manual == "Acme, manual A1"
    assert (sheet.ranges[0].range, sheet.ranges[0].source) == ("-100..99.9969 Hz", "4.1")
    assert "p2000" in sheet.ranges[0].wire
    assert sheet.ranges[1] == DescribedRange(name="torque", range="0..100 %", wire="4000h = 100 %", source="3.2")
    assert sheet.leds == (DescribedLed(name="RUN", shows="green", meaning="it runs", source="3.1"),)
    (fault,) = sheet.faults
    assert (fault.code, fault.text) == ("E07 (number 7, PNU 947: 2330h)", "earth fault")
    assert (fault.remedy, fault.source) == ("see the cable", "table 9")
    assert [(one.code, one.text, one.source) for one in sheet.errors] == [
        ("0", "no such parameter", "table 8"),
        ("17", "not now", "table 8"),
    ]
    assert (sheet.acknowledge, sheet.missing) == ("bit 7 of CW", {"warnings": "it has none"})
    assert [one.name for one in sheet.outputs] == ["parameter channel", "CW (control word)", "setpoint"]
    assert sheet.words[0].name == "CW"


def test_the_steps_are_those_of_address_telegram_and_options(tmp_path: Path) -> None:
    sheet = read(tmp_path, TEXT).describe(110, "PPO3", {"shaft": "right"})
    assert [one.what for one in sheet.steps] == ["by parameter: 110", "p922 = 3, then off", "p922 = 3"]


def test_core_and_simulated_drive_have_the_facts_of_the_file(tmp_path: Path) -> None:
    profile = read(tmp_path, TEXT)
    core, device = profile.core("it", "PPO1"), profile.device("PPO1", {"ready": True})
    assert core.scan_ns == 20_000_000
    assert core.dialect.errors == {0: "no such parameter", 17: "not now"}
    assert device.parameter_errors == {17: "not now"}
    assert device.store.value("p922") == 3
    assert profile.telegram_setting is not None
    assert profile.telegram_setting.values == {"PPO1": 1, "PPO3": 3}


@pytest.mark.parametrize(
    ("status", "obstacle"),
    [("02 40", "it stays in S1"), ("00 40", "bit 9 is 0"), ("02 31", None)],
)
def test_a_state_is_an_obstacle(tmp_path: Path, status: str, obstacle: str | None) -> None:
    bench = PluginBench(read(tmp_path, TEXT).core("it", "PPO3", {"check_settings": False}), f"{status} 00 00")
    assert bench.core.obstacle() == obstacle


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("{tens}, S2", "{tenz}, S2", "another place than {address}"),
        ("{tens}, S2", "{tens:9999}, S2", "another place than {address}"),
        ("{tens}, S2", "{tens.real}, S2", "another place than {address}"),
        ("when = { shaft", "when = { shafts", "'shafts' is no option"),
        ("missing = { warnings", "missing = { warning", "'warning' is no part of the sheet"),
        ("switch_on_inhibited = { state", "inhibited = { state", "'inhibited' is no state of the status word"),
        ('text = "earth fault", ', "", "7 has no text"),
        ("1 = [1], 2", "1 = 1, 2", "write 1 = [1, 2]"),
        ('only = ["PPO1"', 'only = ["PPO9"', "only has 'PPO9', which is no telegram of this file"),
        ('telegram_parameter = "p922"', 'telegram_parameter = "p1"', "'p1' is no parameter of this file"),
    ],
)
def test_mistakes_of_the_sheet_are_reported(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert TEXT.count(old) == 1
    with pytest.raises(ConfigError) as error:
        read(tmp_path, TEXT.replace(old, new))
    assert says in str(error.value)


def test_a_file_on_the_file_of_a_drive_has_its_python(tmp_path: Path) -> None:
    """The Python of the base gets the file that stands on it: another title, one parameter more."""
    profile = read(
        tmp_path, 'base = "fuji-frenic"\ntitle = "ours"\n[parameters]\nF42 = { number = 0x104, index = 42 }\n'
    )
    core = profile.core("fan", "PPO1")
    assert type(core) is type(find("fuji-frenic").core("fan", "PPO1"))
    assert core.parameter_table is not None
    assert core.parameter_table.named("F42") is not None
    assert fuji.PARAMETERS.named("F42") is None


def test_a_list_of_drives_imports_no_python_of_theirs() -> None:
    program = (
        "import sys; from dpstack.devices.finding import known; found = known()\n"
        "print(found['fuji-frenic'].title, sorted(n for n in sys.modules if n.startswith('dpstack_drives.')))"
    )
    done = subprocess.run([sys.executable, "-P", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "Fuji FRENIC-Multi, OPC-E1-PDP []"
