"""[map] of a device file, parameters in a row, options of both ends: fields by literal octets, mistakes by line."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from dpstack.devices.finding import base_of, find
from dpstack.devices.model import DeviceFile
from dpstack.devices.reader import DeviceFileError, Reader
from dpstack.errors import ConfigError
from dpstack.profile import process_data_map

HEAD = """format = 1
name = "it"
base = "profidrive"
python = "imo-hd2"
[telegrams]
A = { out = ["control", 0], in = ["status", 0] }
# the states are those
# of the base
[parameters]
"P1.08" = { number = 0x0108, times = 3, first = 2, title = "Word {}", factories = [7, 1], use = "map" }
count = { number = 5 }
"""
MAP = """[map]
places = "PZD2 to PZD4"
twice = "the last one counts"
[map.outputs]
codes = ["P1.08", "P1.09", "P1.10"]
place = "PZD{}"
first = 2
[map.outputs.fields]
"""
FIELDS = """torque = { code = 4, type = "i16", unit = "%", per_unit = 10, low = -300, high = 300 }
limit = { code = 5, unit = "Hz", per_unit = 100, high = 50, limit = "the highest one", neutral = false }
place = { code = 6, type = "i32" }
flag = { code = 7, high = 1 }
"""


def read(folder: Path, text: str) -> DeviceFile:
    path = folder / "it.toml"
    path.write_text(HEAD + text)
    found = Reader(path, base_of).read()
    assert isinstance(found, DeviceFile)
    return found


def outputs_of(folder: Path) -> process_data_map.FieldTable:
    maps = read(folder, MAP + FIELDS).maps
    assert maps is not None
    return maps[1].fields


@pytest.mark.parametrize(
    ("text", "values", "octets"),
    [
        ("torque limit flag", {4: -300, 5: 49.99, 7: 1}, struct.pack(">hHHH", -3000, 4999, 1, 0)),
        ("- 6 torque", {6: -2, 4: 0.1}, struct.pack(">Hih", 0, -2, 1)),
        ("", {}, bytes(8)),
    ],
)
def test_the_octets_of_a_map(tmp_path: Path, text: str, values: dict[int, float], octets: bytes) -> None:
    own = outputs_of(tmp_path).parse(text)
    raws = {one.key: one.encode(values[one.key]) for one in own.fields if one is not None}
    words = process_data_map.pack(own.fields, raws, 4)
    assert b"".join(word.to_bytes(2, "big") for word in words) == octets
    found = process_data_map.decoded(own.fields, words)
    assert list(found.values()) == pytest.approx([values[one.key] for one in own.fields if one is not None])
    assert len(own.codes) == 3, "the drive has three places, empty ones are 0"
    assert outputs_of(tmp_path).parse(str(own)) == own


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("torqe", r"'torqe' is no process data of the drive; did you mean torque\?"),
        ("8", "'8' is no process data of the drive; there are torque, limit, place, flag"),
        ("torque flag 4", "torque twice: the last one counts"),
        ("- - - torque", r"4 process data, there are 3 \(PZD2 to PZD4\)"),
    ],
)
def test_a_map_that_cannot_be(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(ValueError, match=f"^{says}$"):
        outputs_of(tmp_path).parse(text)


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("limit", 50.01, r"limit 50.01 Hz is outside 0..50 Hz \(the highest one\)"),
        ("torque", float("nan"), "torque nan % is outside -300..300 %"),
        ("flag", 0.5, "flag takes whole numbers, not 0.5"),
        ("place", 2.0**31, "place 2.14748e\\+09 is outside -2.14748e\\+09..2147483647"),
    ],
)
def test_a_value_that_cannot_be(tmp_path: Path, name: str, value: float, says: str) -> None:
    (field, *_) = outputs_of(tmp_path).parse(name).fields
    assert field is not None
    with pytest.raises(ValueError, match=f"^{says}$"):
        field.encode(value)


def test_codes_of_the_drive_become_a_map_and_unknown_ones_stay(tmp_path: Path) -> None:
    own = outputs_of(tmp_path).of((5, 0, 99))
    assert (str(own), own.codes, own.place(99)) == ("limit - 99", (5, 0, 99), 2)


def test_parameters_in_a_row_have_the_next_numbers_names_titles_and_values(tmp_path: Path) -> None:
    found = [(one.number, one.name, one.title, one.factory) for one in read(tmp_path, "").parameters][:3]
    assert found == [(0x108, "P1.08", "Word 2", 7), (0x109, "P1.09", "Word 3", 1), (0x10A, "P1.10", "Word 4", 0)]


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        (MAP + "a = { code = 1 }\nb = { code = 1 }\n", 21, "b and a have one code"),
        (MAP + "a = { unit = 'V' }\n", 20, "the field a has no code"),
        (MAP + "a = { code = 1, per_unit = 0 }\n", 20, "per_unit = 0: a scale of zero"),
        (MAP.replace('"P1.10"', '"P1.11"'), 16, "'P1.11' is no parameter of this file"),
        ('[map.inputs]\ncount = "counts"\n', 12, "'counts' is no parameter of this file"),
        ("[map.inputs.fields]\na = { code = 1, type = 'f32' }\n", 13, "'f32'"),
        ('[parameters."P1.09"]\nnumber = 8\n', 12, "P1.09 is declared twice"),
    ],
)
def test_mistakes_have_their_line(tmp_path: Path, text: str, line: int, says: str) -> None:
    with pytest.raises(DeviceFileError) as caught:
        read(tmp_path, text)
    assert any(says in str(one) for one in caught.value.errors), caught.value.errors
    assert line in {one.line for one in caught.value.errors}, caught.value.errors


def test_a_map_without_python_is_a_mistake(tmp_path: Path) -> None:
    (tmp_path / "it.toml").write_text(HEAD.replace('python = "imo-hd2"\n', "") + MAP + FIELDS)
    with pytest.raises(ConfigError, match="only Python reads and writes a map; name it: python = "):
        find(str(tmp_path / "it.toml"))


def test_an_option_of_both_ends(tmp_path: Path) -> None:
    file = read(
        tmp_path,
        """[options]
        amps = { default = 0, high = 10, text = "of the motor", simulated = { default = 4, low = 1 } }
        rate = { default = 6, simulated = {} }
        load = { default = 0.2, simulated = true }
        [bus]
        rate_option = "rate"
        rate_numbers = { 6 = 500000, 7 = 1500000 }
        """,
    )
    assert list(file.options) == ["amps", "rate"]
    assert list(file.device_options) == ["amps", "rate", "load"]
    assert (file.options["amps"].default, file.device_options["amps"].default) == (0, 4)
    assert (file.device_options["amps"].low, file.device_options["amps"].high) == (1, 10)
    assert file.bus.rates == (500_000, 1_500_000)
    profile = find(str(tmp_path / "it.toml"))
    assert profile.rates({"rate": 7.0}) == (1_500_000,)
