"""Demag: OUT-PZD and IN-PZD, the trace of the manual's lines (docs/reference/drives/demag.md). Both ends alone, literal
octets."""

from __future__ import annotations

import pytest
from demag_kit import ZERO, pkw, plugin, sim
from drive_bench import as_mapping

from dpstack.errors import ConfigError
from dpstack_drives.demag import DRIVE

# -- docs/reference/drives/demag.md#out-pzd ----------------------------------------------------------------------------

VALUES = [
    ("bool", 1, "FF FF"),
    ("bool", 0, "00 00"),
    ("percent", 30, "0B B8"),
    ("percent", -55.36, "EA 60"),
    ("percent", -300, "8A D0"),
    ("percent", 300, "75 30"),
    ("current", 10, "20 00"),
    ("torque", -5, "F0 00"),
    ("frequency", 30, "20 00"),
    ("frequency", -60, "C0 00"),
]


@pytest.mark.parametrize(("kind", "value", "word"), VALUES)
def test_d14_the_words_of_the_plugin(kind: str, value: float, word: str) -> None:
    """390 = 60 Hz, scaling current 10 A; PZD5."""
    options = {"reference_hz": 60, "scaling_current": 10, "map_outputs": f"- - {kind}"}
    bench = plugin("02 40" + " 00" * 10, "PPO4", **options)
    bench.ok("output", number="pzd5", value=value)
    assert bench.out() == f"00 00 00 00 00 00 00 00 {word} 00 00"
    bench.core.lost(bench.now)
    assert bench.core.cyclic(b"", bench.now).hex(" ").upper() == "00 00 00 00 00 00 00 00 00 00 00 00"


def test_d12_the_additional_reference_of_the_plugin() -> None:
    bench = plugin("02 40" + " 00" * 10, "PPO4", reference_hz=60, map_outputs="reference")
    bench.order("output", number="PZD3", value=-15)
    assert bench.out_after("speed", value=0.5) == "00 00 20 00 F0 00 00 00 00 00 00 00"


@pytest.mark.parametrize(
    ("telegram", "text", "says"),
    [
        ("PPO1", "bool", "PPO1 has no PZD3 to PZD6; take PPO2 or PPO4"),
        ("PPO4", "- reference", "only PZD3 is the additional reference"),
        ("PPO4", "speed", "'speed' is no meaning of PZD3"),
        ("PPO4", "- - - - bool", "5 words, there are 4"),
    ],
)
def test_d14_maps_that_cannot_be(telegram: str, text: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        DRIVE.core("hoist", telegram, {"map_outputs": text})


@pytest.mark.parametrize(
    ("number", "value", "says"),
    [
        ("pzd3", 2, "pzd3 (bool) is 0 or 1, not 2"),
        ("pzd4", 300.5, "outside -300..300 %"),
        ("pzd5", 121, "pzd5 (frequency) 121 Hz is outside -100..99.997 Hz"),
        ("pzd6", 1, "needs the option scaling_current"),
        ("pzd2", 1, "'pzd2' is not in the output map (bool percent frequency current)"),
    ],
)
def test_d14_values_that_cannot_be_are_refused_before_anything_is_sent(number: str, value: float, says: str) -> None:
    bench = plugin("02 40" + " 00" * 10, "PPO4", map_outputs="bool percent frequency current")
    assert says in bench.misuse("output", number=number, value=value)
    assert bench.out() == "00 00 00 00 00 00 00 00 00 00 00 00"


@pytest.mark.parametrize(
    ("words", "number", "value"),
    [
        ("FF FF 00 00 00 00 00 00", 750, True),
        ("FF FF 00 00 00 00 00 00", 753, False),
        ("00 00 0B B8 00 00 00 00", 755, 30.0),
        ("00 00 00 00 EA 60 00 00", 756, -55.36),
        ("00 00 00 00 20 00 00 00", 760, 30.0),
        ("00 00 00 00 00 00 C0 00", 761, -60.0),
    ],
)
def test_d14_the_sources_of_the_drive(words: str, number: int, value: bool | float) -> None:
    """390 = 60 Hz; the table's numbers: PZD5 as long is 760, not 759."""
    bench = sim("PPO4", {"390": 60})
    bench.send("00 00 00 00 " + words)
    assert bench.device.source(number) == pytest.approx(value)


def test_d14_sources_are_there_in_ppo2_and_ppo4_only() -> None:
    bench = sim("PPO3")
    with pytest.raises(ValueError, match="PPO2 and PPO4 only"):
        bench.device.source(750)
    with pytest.raises(ValueError, match="none of 750 to 761"):
        sim("PPO4").device.source(762)


# -- docs/reference/drives/demag.md#trace-lines ------------------------------------------------------------------------


def test_d16_the_lines_of_the_manual_from_live_data() -> None:
    """The order that was answered is idle again, its last transmission is what the lines show."""
    wide = " 06 A7 20 00 11 47 0C CC 08 00 00 00"
    bench = plugin(ZERO.strip() + wide, "PPO2")
    bench.order("speed", value=0.5)
    bench.order_and_run(2, "start")
    for reply in ("10 F9 00 00 00 00 00 01", "41 9C 01 00 00 00 00 01"):  # 249, and 412 in data set 1
        bench.see(reply + wide, 2)
        bench.see(ZERO.strip() + wide, 3)
    bench.order_and_run(2, "read", number=480, data_set=3)
    bench.see("51 E0 03 00 FF FF EA 84" + wide, 3)
    bench.see(ZERO.strip() + wide, 3)
    lines = as_mapping(bench.ok("trace"))
    assert bench.out() == ZERO + "00 0F 20 00 00 00 00 00 00 00 00 00"
    assert lines["in"] == ("PKE: 5 480 IND: 03 00 PWE: -005500 STA: 06A7 VAL: 2000 3: 1147 4: 0CCC 5: 0800 6: 0000")
    assert lines["out"] == ("PKE: 6 480 IND: 03 00 PWE: +000000 CTR: 000F STP: 2000 3: 0000 4: 0000 5: 0000 6: 0000")


def test_d16_a_write_shows_its_value_and_narrow_telegrams_their_part() -> None:
    bench = plugin(ZERO + "02 40 00 00", "PPO1")
    bench.order_and_run(2, "write", number=480, data_set=3, value=-55)
    bench.see("51 E0 03 00 FF FF EA 84 02 40 00 00", 3)
    lines = as_mapping(bench.ok("trace"))
    assert lines["out"] == "PKE: 8 480 IND: 03 00 PWE: -005500 CTR: 0000 STP: 0000"
    assert lines["in"] == "PKE: 5 480 IND: 03 00 PWE: -005500 STA: 0240 VAL: 0000"
    narrow = plugin("02 40 00 00")
    assert as_mapping(narrow.ok("trace"))["in"] == "STA: 0240 VAL: 0000"


def test_d16_the_texts_281_and_284_cannot_be_read_over_the_channel() -> None:
    bench = sim("PPO1")
    assert pkw(bench, "11 19 00 00 00 00 00 00") == "71 19 00 00 00 00 00 65"
    assert pkw(bench, "11 1C 00 00 00 00 00 00") == "71 1C 00 00 00 00 00 65"
