"""Positions of encoders: counts, turns, degrees, where they wrap, and the scaling by the user parameters."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.api.commissioning.sheet import make_sheets
from dpstack.api.config.config import make_config, slave_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.devices.finding import find, read
from dpstack.devices.reader import DeviceFileError
from dpstack.dp.counter import Counter
from dpstack.dp.process_image import Value
from dpstack.errors import ConfigError

SENSOR: dict[str, object] = {"name": "spindle", "address": 5, "device": "simodrive-sensor"}
WHEEL = """
format = 1
name = "wheel"
base = "encoder"
[bus]
ident = 0x1234
user_prm = "00 0A 00 00 10 00 00 01 FA 40"
[telegrams]
one = { config = "F1", out = ["preset"], in = ["position"] }
[position]
counts_per_turn = "u16@4"
range = "u32@6"
"""


def configured(**more: object) -> SlaveConfig:
    return slave_config({**SENSOR, **more})


def wheel(folder: Path, text: str = WHEEL, **more: object) -> SlaveConfig:
    path = folder / "wheel.toml"
    path.write_text(text)
    return slave_config({"name": "wheel", "address": 5, "device": str(path), **more})


def values(slave: SlaveConfig, octets: str) -> dict[str, Value]:
    return slave.input_fields.values(bytes.fromhex(octets))


def test_class_2_multiturn_as_its_gsd_file_delivers_it() -> None:
    """BEI 03/10, page 15: a double word, most significant octet first; SIEM0024.GSD: F1, 4096 counts and 16777216."""
    slave = configured()
    assert (slave.params.ident, slave.params.config.hex()) == (0x0024, "f1")
    assert slave.params.user_prm.hex(" ") == "00 0a 00 00 10 00 01 00 00 00 00 00 00 00 00 00 00 00"
    assert values(slave, "00 00 18 00") == {"position": 6144, "turns": 1.5, "degrees": 180.0}
    assert values(slave, "00 ff ff ff") == {"position": 16777215, "turns": 4096 - 1 / 4096, "degrees": 360 - 360 / 4096}


def test_the_range_stands_in_a_high_and_a_low_word() -> None:
    """BEI 03/10, page 35: 129600 counts are 0001 FA40h, high word 1 and low word 64064."""
    words = {
        "Total measuring range (high)": 1,
        "Total measuring range (low)": 64064,
        "Measuring units per revolution": 3600,
    }
    slave = configured(parameters=words, options={"signed": True})
    assert slave.params.user_prm.hex(" ").startswith("00 0a 00 00 0e 10 00 01 fa 40")
    assert values(slave, "00 01 fa 3f") == {"position": -1, "turns": -1 / 3600, "degrees": 359.9}
    assert values(slave, "00 00 fd 1f")["position"] == 64799  # the last of the lower half
    assert values(slave, "00 00 fd 20")["position"] == -64800


def test_version_2_2_has_25_bits_status_bits_above_and_a_velocity() -> None:
    """BEI 03/10, pages 20, 26; the unit of the velocity by SIEM0024.GSD."""
    slave = configured(telegram="2.2")
    assert slave.params.config.hex(" ") == "f1 d0"
    found = values(slave, "88 00 10 00 ff f6")
    assert found == {
        "position": 4096,
        "turns": 1.0,
        "degrees": 0.0,
        "position_limit_switch": True,
        "position_preset_confirmed": True,
        "velocity": -10,
    }
    for chosen, velocity, unit in (("Steps/10 ms", -1000, "counts/s"), ("Revolutions per minute", -10, "rpm")):
        other = configured(telegram="2.2", parameters={"Velocity output unit": chosen})
        assert values(other, "88 00 10 00 ff f6")["velocity"] == velocity
        assert other.input_fields.units["velocity"] == unit


def test_the_other_direction() -> None:
    slave = configured(telegram="2.2", options={"backwards": True, "signed": True})
    found = values(slave, "00 00 10 00 00 0a")
    assert (found["position"], found["turns"], found["velocity"]) == (-4096, -1.0, -10)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"telegram": "class1"}, ""),
        ({"parameters": {"Scaling function control": 0}}, "Scaling function control = 0"),
        ({"telegram": "2.1", "parameters": {"Desired measuring units per": 2}}, "Desired measuring units per = 2"),
    ],
)
def test_without_scaling_it_has_a_position_and_says_why_no_turns(more: dict[str, object], why: str) -> None:
    slave = configured(**more)
    assert "position" in slave.input_fields
    assert "turns" not in slave.input_fields
    (note,) = [note for note in slave.notes if "neither turns nor degrees" in note]
    assert why in note
    known = configured(**more, options={"counts_per_turn": 100, "range": 1000})
    assert values(known, "00 00 01 2c") | {"position": 300, "turns": 3.0, "degrees": 0.0} == values(
        known, "00 00 01 2c"
    )


def test_places_in_user_parameters_without_a_gsd_file(tmp_path: Path) -> None:
    assert values(wheel(tmp_path), "00 00 08 00") == {"position": 2048, "turns": 0.5, "degrees": 180.0}
    other = wheel(tmp_path, user_prm="00 0A 00 00 01 00 00 00 02 00")
    assert values(other, "00 00 00 80") == {"position": 128, "turns": 0.5, "degrees": 180.0}


def test_other_words_constants_and_a_turn_that_is_no_whole_number(tmp_path: Path) -> None:
    text = WHEEL.replace('config = "F1"', 'config = "C0 C1 C3"').replace('"position"]', '0, "position", "load"]')
    text = text.replace("[position]", '[words]\nload = { type = "i16", full = 1000, unit = "%" }\n[position]')
    slave = wheel(tmp_path, text.replace('"u16@4"', "360"), options={"counts_per_turn": 4.5})
    assert values(slave, "ff ff 00 00 00 0c ff 9c") == {
        "position": 12,
        "turns": pytest.approx(12 / 4.5),
        "degrees": pytest.approx(240),
        "load": -10.0,
    }
    whole = values(wheel(tmp_path, text.replace('"u16@4"', "360")), "ff ff 00 00 02 1c ff 9c")
    assert (whole["degrees"], type(whole["degrees"])) == (180, int)


def test_counts_beyond_the_range_have_no_angle(tmp_path: Path) -> None:
    """Nothing damaged is shown as good: the number stays what it is, the angle is none."""
    found = values(wheel(tmp_path), "00 01 fa 40")
    assert found["position"] == 129600
    assert found["turns"] != found["turns"]
    assert found["degrees"] != found["degrees"]


def test_the_commissioning_sheet_has_file_and_gsd_file() -> None:
    plant = make_config("virtual", 500_000, slaves=[SENSOR, {"name": "tr", "address": 6, "device": "tr-58"}])
    spindle, wheel = (one.device for one in make_sheets(plant))
    assert spindle.title == "Siemens SIMODRIVE sensor 6FX2001-5.P.."
    assert spindle.manual.startswith("device file simodrive-sensor.toml, GSD file ")
    assert wheel.manual == "device file tr-58.toml"
    assert "from the manual, not tried at the device" in spindle.notes
    codes = {one.code: one.text for one in spindle.faults}
    assert codes["alarm 8.4"] == "memory error"  # Unit_Diag_Bit(4) of the GSD file has the same text
    assert "bit 4" not in codes
    assert codes["warning 21.4"] == "operating time exceeded"


def test_names_of_the_plant_file_go_before() -> None:
    slave = configured(inputs={"position": "u16@2", "high": "u16@0"})
    assert values(slave, "00 01 10 00") == {"position": 4096, "turns": 17.0, "degrees": 0.0, "high": 1}


@given(st.integers(1, 1 << 32), st.booleans(), st.booleans(), st.data())
def test_counters_turn_over(range_: int, backwards: bool, signed: bool, data: st.DataObject) -> None:
    """Each count has one number, and one count further is the next number but at the end of the range."""
    counter = Counter(range_, backwards, signed)
    counts, other = (data.draw(st.integers(0, range_ - 1)) for _ in range(2))
    shown = counter.shown(counts)
    assert counter.counts(shown) == counts
    low = -(range_ // 2) if signed else 0
    assert low <= shown < low + range_
    step = counter.shown((counts + 1) % range_) - shown
    assert step in ((-1, range_ - 1) if backwards else (1, 1 - range_)) or range_ == 1
    distance = counter.distance(counts, other)
    assert distance == counter.distance(other, counts) == min(abs(counts - other), range_ - abs(counts - other))
    with pytest.raises(ValueError, match="is outside"):
        counter.counts(low + range_)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ('counts_per_turn = "prm:"', None),
        ("counts_per_turn = 0", 'counts_per_turn = 0; give a number above 0, "prm:NAME" or "u16@4"'),
        ('range = "f32@4"', "range = 'f32@4'; give a number above 0"),
        ('only_if = { a = "x" }', "a = 'x'"),
        ("[preset]\ndone = \"ready\"", "done = 'ready'; it must be position, time"),
        ("[velocity]\nby = \"prm:x\"", "by and units go together"),
        ("[velocity]\nby = \"prm:x\"\nunits = { 1 = [0, \"rpm\"] }", "scale = 0"),
        ("[velocity]\nunit = \"m/s\"", "velocity: unknown unit 'm/s'"),
        ("[diagnosis]\nalarms = { \"7.0\" = \"x\" }", "'7.0' is no bit of the diagnosis"),
        ("[diagnosis]\noctets = 20", "octets = 20; its bits reach to octet 21"),
        ("[control]\nsafe = 1", "control is for drives; leave control out"),
        ("[words]\nsmall = { type = \"u16\", width = 20 }", "small: width = 20; u16 has 16 bits"),
    ],
)  # fmt: skip
def test_mistakes_in_a_file_by_line(tmp_path: Path, line: str, text: str | None) -> None:
    path = tmp_path / "wheel.toml"
    path.write_text(WHEEL.replace('range = "u32@6"\n', "").replace('counts_per_turn = "u16@4"\n', line + "\n"))
    if text is None:
        read(path)
        return
    with pytest.raises(DeviceFileError) as caught:
        read(path)
    assert text in str(caught.value)
    assert "wheel.toml:" in str(caught.value)


def test_telegrams_need_a_position(tmp_path: Path) -> None:
    path = tmp_path / "wheel.toml"
    path.write_text(WHEEL.replace('"F1", out = ["preset"], in = ["position"]', '"D0", in = ["velocity"]'))
    with pytest.raises(DeviceFileError, match=r"telegram one has no position; write in = \[\"position\"\]"):
        read(path)


def test_telegrams_need_identifiers(tmp_path: Path) -> None:
    path = tmp_path / "wheel.toml"
    path.write_text(WHEEL.replace('config = "F1", out = ["preset"], ', ""))
    with pytest.raises(DeviceFileError, match="telegram one has no identifiers; add config, or gsd and modules"):
        read(path)


def test_drives_and_devices_have_keys_of_their_own(tmp_path: Path) -> None:
    for table, text in (
        ({"drive": "simodrive-sensor"}, "describes no drive; write device = "),
        ({"device": "fuji-frenic"}, "'fuji-frenic' is a drive; write drive = "),
        (
            {"device": "simodrive-sensr"},
            "no device is called 'simodrive-sensr'; known: pa, pa-flow, ",
        ),
        ({"device": "tr-58", "drive": "fuji-frenic"}, "drive beside device"),
        ({"device": "tr-58", "reference_hz": 50}, "reference_hz is for drives"),
        ({"device": "tr-58", "outputs": {"x": "u8@0"}}, "outputs beside device"),
        ({"device": "tr-58", "config": "F1"}, "config beside device"),
        ({"device": "tr-58", "after_return": "resume"}, "after_return beside device"),
        ({"device": "tr-58", "options": {"turns": 3}}, "there is no option 'turns'"),
        ({"device": "tr-58", "simulated": {"rmp": 3}}, "there is no option 'rmp'"),
        ({"device": "tr-58", "simulate": {"recording": "x.csv"}}, "simulate beside"),
    ):
        with pytest.raises(ConfigError) as caught:
            slave_config({"name": "a", "address": 5, **table})
        assert text in str(caught.value)
    with pytest.raises(ConfigError, match="describes no drive"):
        find("tr-58")


def test_each_mistake_is_reported_once(tmp_path: Path) -> None:
    path = tmp_path / "wheel.toml"
    path.write_text(WHEEL.replace("[position]", "[velocity]\nunit = 3\nscale = 0\n[preset]\nhold_ms = -1\n[position]"))
    with pytest.raises(DeviceFileError) as caught:
        read(path)
    assert [error.line for error in caught.value.errors] == [11, 14]
