"""Fuji: telegrams (F1), words (F2, F4, F12), PCD (F5), PNUs (F7), address (F11), errors (F13, F14), supply (F15).

Each end against literal octets.
"""

from __future__ import annotations

from typing import Any

import pytest
from drive_bench import DeviceBench, PluginBench, S, as_mapping

from dpstack.errors import ConfigError
from dpstack.profile import State
from dpstack_drives.fuji import DRIVE
from dpstack_drives.fuji.simulator import FujiDevice

ZERO = "00 00 00 00 00 00 00 00 "
IDLE = ZERO + "02 40 00 00"
#: PPO2: PCV, two words, PCD1 to PCD4
WIDE = " 00 00 00 00 00 00 00 00"


def device(telegram: str = "PPO1", **presets: Any) -> FujiDevice:
    found = DRIVE.device(telegram, presets)
    assert isinstance(found, FujiDevice)
    return found


def sim(telegram: str = "PPO1", **presets: Any) -> DeviceBench:
    found = device(telegram, **presets)
    return DeviceBench(found, found.own.config.hex())


def again(bench: DeviceBench, seconds: float = 0.1, **presets: Any) -> DeviceBench:
    """Power off and on."""
    after = device("PPO2", **presets)
    after.inherit(bench.device)
    other = DeviceBench.__new__(DeviceBench)
    other.device, other.rotation = after, bench.rotation
    other.now = bench.now + round(seconds * S)
    after.enter(after.own.config, other.now)
    return other


def pkw(bench: DeviceBench, order: str) -> str:
    rest = "00 00 00 00" + (WIDE if bench.device.telegram.name == "PPO2" else "")
    bench.send(ZERO + rest, 10)
    return bench.send(f"{order} {rest}", 10)[:23]


def plugin(telegram: str = "PPO1", inputs: str = IDLE, **options: object) -> PluginBench:
    return PluginBench(DRIVE.core("fan", telegram, options), inputs)


# -- F1, F2, F4, F12 ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("telegram", "inputs", "safe"),
    [
        ("PPO1", IDLE, ZERO + "04 7E 00 00"),
        ("PPO2", IDLE + WIDE, ZERO + "04 7E 00 00" + WIDE),
        ("PPO3", "02 40 00 00", "04 7E 00 00"),
        ("PPO4", "02 40 00 00" + WIDE, "04 7E 00 00" + WIDE),
    ],
)
def test_f1_telegrams_of_the_plugin(telegram: str, inputs: str, safe: str) -> None:
    bench = plugin(telegram, inputs)
    assert bench.out() == safe
    assert bench.core.status().state is State.SWITCH_ON_INHIBITED
    assert len(sim(telegram).send(safe)) == len(inputs)


@pytest.mark.parametrize(
    ("stw", "state"),
    [
        ("02 40", State.SWITCH_ON_INHIBITED),
        ("02 31", State.READY_TO_SWITCH_ON),
        ("02 33", State.STOPPING),
        ("03 37", State.STOPPING),
        ("07 37", State.STOPPING),
        ("02 78", State.FAULT),
    ],
)
def test_f2_states_of_the_plugin(stw: str, state: State) -> None:
    """Its own CTW is 047E: S3 and S4 are on their way to S2."""
    assert plugin("PPO3", stw + " 00 00").core.status().state is state


def test_f2_bit_6_of_the_drive_is_not_bit_0_of_ctw_state() -> None:
    bench = sim("PPO3", E31=30)
    assert bench.send("00 00 00 00") == "02 40 00 00"
    assert bench.send("04 7E 40 00") == "02 31 00 00"
    bench.until("04 7F 40 00", "07 37 40 00", 3000)  # 10: the output is at E31 and above
    assert bench.send("04 77 40 00")[:5] == "02 33"  # b3 = 0: S3


@pytest.mark.parametrize(("speed", "mrv"), [(1.0, "40 00"), (-1.0, "C0 00"), (0.5, "20 00"), (-0.25, "F0 00")])
def test_f4_mrv_of_the_plugin(speed: float, mrv: str) -> None:
    """4000 is F03; MAV likewise."""
    bench = plugin("PPO3", "03 37 " + mrv, reference_hz=60)
    bench.order("speed", value=speed)
    assert bench.out() == "04 7E " + mrv
    assert bench.core.status().frequency_hz == 60 * speed


@pytest.mark.parametrize(
    ("op", "ctw"), [("stop", "04 7E"), ("quick_stop", "04 7A"), ("coast", "04 7C"), ("start", "04 7F")]
)
def test_f12_words_of_the_plugin(op: str, ctw: str) -> None:
    """OFF1, OFF3, OFF2; bits 4 to 6 and 10 always 1."""
    bench = plugin("PPO3", "02 31 00 00")
    bench.order(op)
    assert bench.out() == ctw + " 00 00"


# -- F5 ----------------------------------------------------------------------------------------------------------------


def test_f5_words_of_the_plugin() -> None:
    inputs = " 00 0F 00 23 00 00 12 34"
    bench = plugin("PPO2", IDLE + inputs, map_inputs="F26 M16 - W01", map_outputs="S06 F07=6 041A=2")
    bench.order("output", number="f07", value=2.5)
    bench.order("output", number="F26", value=15)
    bench.order("output", number="S06", value=0x0300)
    assert bench.out() == ZERO + "04 7E 00 00 03 00 00 19 00 0F 00 00"
    assert as_mapping(bench.result(bench.order("inputs")))["value"] == {"F26": 15, "M16": 35, "W01": 0x1234}
    for number, value, says in (
        ("F26", 16, "outside 0..15"),
        ("S06", 1, "bits 0 and 1"),
        ("F08", 1, "is not in the output map (S06 F07 F26)"),
    ):
        result = as_mapping(bench.result(bench.order("output", number=number, value=value)))
        assert (result["error"], says in str(result["text"])) == ("usage", True), result
    bench.core.lost(bench.now)
    assert bench.core.cyclic(b"", bench.now).hex(" ").upper() == ZERO + "04 7E 00 00 00 00 00 19 00 0F 00 00"


@pytest.mark.parametrize(
    ("telegram", "options", "says"),
    [
        ("PPO1", {"map_inputs": "F26"}, "PPO1 has no PCD1 to PCD4; take PPO2 or PPO4"),
        ("PPO4", {"map_outputs": "S01"}, "S01 can only be read"),
        ("PPO4", {"map_outputs": "- S05"}, "S05 can only be read"),
        ("PPO4", {"map_outputs": "F26 041A"}, "F26 twice: only the first one would count"),
        ("PPO4", {"map_inputs": "Q9"}, "'Q9' is no function code"),
        ("PPO4", {"map_inputs": "- - - - F26"}, "5 words, there are 4"),
    ],
)
def test_f5_maps_that_cannot_be(telegram: str, options: dict[str, object], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        DRIVE.core("fan", telegram, options)


def test_f5_write_map_on_the_wire() -> None:
    """PNU 916, then 915, indexes 1 to 4."""
    bench = plugin("PPO2", IDLE + WIDE)
    token = bench.order("write_map", inputs="M16", outputs="S06 F26")
    seen: list[str] = []
    for _ in range(120):
        order = bench.out()[:23]
        if order != ZERO.strip() and (not seen or seen[-1] != order):
            seen.append(order)
            bench.inputs = bytes.fromhex("4" + order[1:] + " 02 40 00 00" + WIDE)
        elif order == ZERO.strip():
            bench.inputs = bytes.fromhex(IDLE + WIDE)
    assert seen == [
        "73 94 01 00 00 00 03 10",
        "73 94 02 00 00 00 00 00",
        "73 94 03 00 00 00 00 00",
        "73 94 04 00 00 00 00 00",
        "73 93 01 00 00 00 02 06",
        "73 93 02 00 00 00 04 1A",
        "73 93 03 00 00 00 00 00",
        "73 93 04 00 00 00 00 00",
    ]
    result = as_mapping(bench.result(token))
    assert (result["value"], result["acts"]) == ({"inputs": "M16", "outputs": "S06 F26"}, "after power-on")
    refused = as_mapping(bench.result(bench.order("write_map", outputs="S01")))
    assert "write_map: S01 can only be read" in str(refused["text"])


def test_f5_the_drive_takes_them_at_power_on() -> None:
    bench = sim("PPO2")
    for order, reply in (
        ("73 93 01 00 00 00 04 1A", "43 93 01 00 00 00 04 1A"),  # PCD1 writes F26
        ("63 93 01 00 00 00 00 00", "43 93 01 00 00 00 04 1A"),
        ("11 0A 28 00 00 00 00 00", "11 0A 28 00 00 00 04 1A"),  # which is o40
        ("73 93 02 00 00 00 04 1A", "43 93 02 00 00 00 04 1A"),  # doubled: PCD1 wins
        ("73 93 03 00 00 00 02 01", "43 93 03 00 00 00 02 01"),  # S01 is ignored
        ("73 93 04 00 00 00 02 06", "43 93 04 00 00 00 02 06"),
        ("21 0A 30 00 00 00 04 1A", "11 0A 30 00 00 00 04 1A"),  # o48: PCD1 reads F26
        ("73 94 02 00 00 00 02 06", "43 94 02 00 00 00 02 06"),
        ("63 93 05 00 00 00 00 00", "73 93 05 00 00 00 00 03"),
    ):
        assert pkw(bench, order) == reply
    assert bench.send(IDLE.replace("02 40", "04 7E") + " 00 05 00 06 00 07 FF FF")[36:] == "00 00 00 00 00 00 00 00"
    bench = again(bench)
    words = bench.send(ZERO + "04 7E 00 00 00 05 00 06 00 07 FF FF")
    assert words == ZERO + "02 31 00 00 00 05 FF FC 00 00 00 00"  # bits 0 and 1 of S06 are ignored
    assert bench.send(ZERO + "04 7E 00 00 00 10 00 06 00 07 FF FF")[36:41] == "00 05"  # beyond F26's range


# -- F7, F8, F11, F13, F14 ---------------------------------------------------------------------------------------------

READS = [
    ({"number": 918}, "13 96 00 00 00 00 00 00", "13 96 00 00 00 00 00 1B", 27),
    ({"number": 963}, "13 C3 00 00 00 00 00 00", "13 C3 00 00 00 00 00 06", 6),
    ({"number": 915, "index": 2}, "63 93 02 00 00 00 00 00", "43 93 02 00 00 00 04 1A", 0x41A),
    ({"number": "o27"}, "11 0A 1B 00 00 00 00 00", "11 0A 1B 00 00 00 00 0A", 10),
    ({"number": "o28"}, "11 0A 1C 00 00 00 00 00", "11 0A 1C 00 00 00 02 58", 60.0),
    ({"number": "o31"}, "11 0A 1F 00 00 00 00 00", "11 0A 1F 00 00 00 00 7D", 125),
    ({"number": "S06"}, "11 02 06 00 00 00 00 00", "11 02 06 00 00 00 00 00", 0),
    ({"number": "M16"}, "11 03 10 00 00 00 00 00", "11 03 10 00 00 00 00 23", 35),
    ({"number": "E31"}, "11 05 1F 00 00 00 00 00", "11 05 1F 00 00 00 00 00", 0),
    ({"number": "C05"}, "11 06 05 00 00 00 00 00", "11 06 05 00 00 00 00 01", 1),
    ({"number": "P01"}, "11 07 01 00 00 00 00 00", "11 07 01 00 00 00 00 04", 4),
    ({"number": "H03"}, "11 08 03 00 00 00 00 00", "11 08 03 00 00 00 00 00", 0),
    ({"number": "J01"}, "11 0E 01 00 00 00 00 00", "11 0E 01 00 00 00 00 00", 0),
    ({"number": "W90"}, "11 10 5A 00 00 00 00 00", "11 10 5A 00 00 00 00 7B", 123),
    ({"number": "X00"}, "11 11 00 00 00 00 00 00", "11 11 00 00 00 00 00 00", 0),
    ({"number": "Z01"}, "11 12 01 00 00 00 00 00", "11 12 01 00 00 00 00 00", 0),
]


@pytest.mark.parametrize(("args", "order", "reply", "value"), READS)
def test_f7_f8_f11_f13_reads_of_the_plugin(args: dict[str, object], order: str, reply: str, value: float) -> None:
    bench = plugin()
    token = bench.order("read", **args)
    bench.run()
    assert bench.out().startswith(order)
    bench.see(reply + " 02 40 00 00", 2)
    assert as_mapping(bench.result(token))["value"] == value


@pytest.mark.parametrize(
    ("args", "order"),
    [
        ({"number": 927, "value": 0}, "23 9F 00 00 00 00 00 00"),
        ({"number": 970, "value": 1}, "23 CA 00 00 00 00 00 01"),
        ({"number": "o27", "value": 3}, "21 0A 1B 00 00 00 00 03"),
        ({"number": "o28", "value": 10}, "21 0A 1C 00 00 00 00 64"),
        ({"number": "o31", "value": 99}, "21 0A 1F 00 00 00 00 63"),
        ({"number": 916, "index": 4, "value": 0x310}, "73 94 04 00 00 00 03 10"),
    ],
)
def test_f7_f8_f11_writes_of_the_plugin(args: dict[str, object], order: str) -> None:
    bench = plugin()
    bench.order("write", **args)
    bench.run()
    assert bench.out().startswith(order)


@pytest.mark.parametrize(
    ("number", "text"),
    [
        ("00 00", "nonexistent parameter"),
        ("00 01", "writing inhibited"),
        ("00 02", "out of range"),
        ("00 03", "invalid subindex"),
        ("00 04", "no array"),
        ("00 0B", "while running"),
        ("00 11", "cannot be read"),
        ("00 65", "link priority"),
        ("00 68", "busy"),
    ],
)
def test_f14_errors_by_their_text(number: str, text: str) -> None:
    bench = plugin()
    token = bench.order("write", number="F26", value=1)
    bench.run(2)
    bench.see(f"71 04 1A 00 00 00 {number} 02 40 00 00", 2)
    result = as_mapping(bench.result(token))
    assert result["number"] == int(number.replace(" ", ""), 16)
    assert text in str(result["text"])


def test_f13_f14_errors_and_groups_of_the_drive() -> None:
    bench = sim()
    for order, reply in (
        ("11 03 10 00 00 00 00 00", "11 03 10 00 00 00 00 00"),  # M16
        ("11 10 5A 00 00 00 00 00", "11 10 5A 00 00 00 00 7B"),  # W90
        ("11 0A 1B 00 00 00 00 00", "11 0A 1B 00 00 00 00 00"),  # o27
        ("11 0F 62 00 00 00 00 00", "11 0F 62 00 00 00 00 03"),  # y98
        ("11 0F 64 00 00 00 00 00", "71 0F 64 00 00 00 00 00"),
        ("21 02 01 00 00 00 00 01", "71 02 01 00 00 00 00 01"),  # S01
        ("21 0A 1B 00 00 00 00 10", "71 0A 1B 00 00 00 00 02"),
        ("63 B3 00 00 00 00 00 00", "73 B3 00 00 00 00 00 03"),
        ("61 0A 1B 00 00 00 00 00", "71 0A 1B 00 00 00 00 04"),
    ):
        assert pkw(bench, order) == reply
    bench.send(ZERO + "04 7E 40 00")
    bench.send(ZERO + "04 7F 40 00", 200)
    assert bench.send("21 08 03 00 00 00 00 01 04 7F 40 00")[:23] == "71 08 03 00 00 00 00 0B"  # H03 while running


def test_f7_970_initialises_when_it_falls() -> None:
    bench = sim(F26=15)
    assert pkw(bench, "23 CA 00 00 00 00 00 00") == "13 CA 00 00 00 00 00 00"
    assert pkw(bench, "11 04 1A 00 00 00 00 00") == "11 04 1A 00 00 00 00 0F"
    assert pkw(bench, "23 CA 00 00 00 00 00 01") == "13 CA 00 00 00 00 00 01"
    assert pkw(bench, "11 04 1A 00 00 00 00 00") == "11 04 1A 00 00 00 00 0F"
    assert pkw(bench, "13 CA 00 00 00 00 00 00") == "13 CA 00 00 00 00 00 01"
    assert pkw(bench, "23 CA 00 00 00 00 00 00") == "13 CA 00 00 00 00 00 00"
    assert pkw(bench, "11 04 1A 00 00 00 00 00") == "11 04 1A 00 00 00 00 02"
    assert pkw(bench, "11 0F 62 00 00 00 00 00") == "11 0F 62 00 00 00 00 00"  # y98 as delivered


@pytest.mark.parametrize(
    ("baud", "index"),
    [(None, "00"), (9_600, "01"), (45_450, "03"), (93_750, "04"), (1_500_000, "07"), (12_000_000, "0A")],
)
def test_f7_963_and_918_tell_rate_and_address(baud: int | None, index: str) -> None:
    bench = sim()
    bench.device.installed(27, baud)
    assert pkw(bench, "13 C3 00 00 00 00 00 00") == f"13 C3 00 00 00 00 00 {index}"
    assert pkw(bench, "13 96 00 00 00 00 00 00") == "13 96 00 00 00 00 00 1B"


def test_f11_switches_and_o31() -> None:
    bench = sim("PPO2")
    bench.device.installed(27, None)
    assert pkw(bench, "21 0A 1F 00 00 00 00 05") == "11 0A 1F 00 00 00 00 05"
    assert again(bench).device.own_address == 27  # the switches stand at 27
    bench = sim("PPO2")
    bench.device.installed(125, None)  # beyond the switches: o31
    assert pkw(bench, "11 0A 1F 00 00 00 00 00") == "11 0A 1F 00 00 00 00 7D"
    assert pkw(bench, "21 0A 1F 00 00 00 00 05") == "11 0A 1F 00 00 00 00 05"
    assert pkw(bench, "13 96 00 00 00 00 00 00") == "13 96 00 00 00 00 00 7D"  # until power-on
    assert again(bench).device.own_address == 5
    assert pkw(bench, "21 0A 1F 00 00 00 00 7E") == "11 0A 1F 00 00 00 00 7E"
    tripped = again(bench)
    assert tripped.device.own_address is None
    assert pkw(tripped, "63 B3 01 00 00 00 00 00") == "43 B3 01 00 00 00 75 11"  # Er5
    with pytest.raises(ConfigError, match="whole number"):
        DRIVE.device("PPO1", {"switches": 1.5})


# -- F15 ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("supply", ["24v", "inverter"])
def test_f15_on_the_bus_without_the_inverter(supply: str) -> None:
    bench = sim(supply=supply)
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


def test_f15_the_plugin_says_that_the_inverter_has_no_power() -> None:
    bench = plugin("PPO1", ZERO + "00 00 00 00")
    token = bench.order("start")
    bench.run(100)
    result = as_mapping(bench.result(token))
    assert result["error"] == "fault"
    assert "the inverter has no power" in str(result["text"])


# -- a name that was asked for while the bus was lost ------------------------------------------------------------------


def test_f9_an_alarm_whose_name_was_lost_is_asked_again() -> None:
    bench = plugin("PPO1", ZERO + "02 78 00 00")
    bench.run(2)
    assert bench.out().startswith("63 B3 01 00")
    bench.core.lost(bench.now)
    assert bench.see(ZERO + "02 78 00 01", 3).startswith("63 B3 01 00")
    bench.see("43 B3 01 00 00 00 75 11 02 78 00 01", 2)
    assert bench.core.status().faults == ("Er5 field bus communications error",)
    bench.core.lost(bench.now)  # it may be another one when the drive returns
    bench.see(ZERO + "02 78 00 00")
    assert bench.core.status().faults == ("not yet named",)


def test_f9_an_answer_does_not_name_the_next_alarm() -> None:
    """Acknowledged and tripped again while the question was under way."""
    bench = plugin("PPO1", ZERO + "02 78 00 00")
    bench.run(2)
    bench.see(ZERO + "02 40 00 00")
    bench.see(ZERO + "02 78 00 00")
    bench.see("43 B3 01 00 00 00 75 11 02 78 00 00", 2)
    assert bench.core.status().faults == ("not yet named",)
    bench.see(ZERO + "02 78 00 00", 2)
    assert bench.out().startswith("63 B3 01 00")
    bench.see("43 B3 01 00 00 00 23 01 02 78 00 00", 2)
    assert bench.core.status().faults == ("OC1 overcurrent during acceleration",)


def test_f9_a_question_without_an_answer_is_asked_again() -> None:
    bench = plugin("PPO1", ZERO + "02 78 00 00")
    bench.run(700)
    assert bench.core.status().faults == ("not yet named",)
    bench.see(ZERO + "02 78 00 01", 60)
    assert bench.out().startswith("63 B3 01 00")
