"""Fuji: each end against literal octets (F1 to F4, F6, F8, F10, F12), the worked run of F3 in order at both ends."""

from __future__ import annotations

from typing import Any

import pytest
from drive_bench import MS, DeviceBench, PluginBench, S, as_mapping

from dpstack.errors import ConfigError
from dpstack.gsd.identifiers import io_lengths
from dpstack.profile import Leave, State
from dpstack_drives.fuji import DRIVE
from dpstack_drives.fuji import table as t
from dpstack_drives.fuji.simulator import FujiDevice

ZERO = "00 00 00 00 00 00 00 00 "


def sim(**presets: Any) -> DeviceBench:
    device = DRIVE.device("PPO3", presets)
    assert isinstance(device, FujiDevice)
    return DeviceBench(device, "71")


def sim1(**presets: Any) -> DeviceBench:
    return DeviceBench(DRIVE.device("PPO1", presets), "F3 71")


def plugin(inputs: str = "02 40 00 00", **options: object) -> PluginBench:
    return PluginBench(DRIVE.core("fan", "PPO3", options), inputs)


def pkw(bench: DeviceBench, order: str) -> str:
    bench.send(ZERO + "00 00 00 00")
    return bench.send(order + " 00 00 00 00")[:23]


# -- facts ---------------------------------------------------------------------------------------------------------


def test_facts_and_what_is_made_up() -> None:
    assert DRIVE.ident == 0xDD04
    assert DRIVE.ident_made_up
    assert DRIVE.user_prm == b""
    assert not DRIVE.max_tsdr
    for name, octets in (("PPO1", 12), ("PPO2", 20), ("PPO3", 4), ("PPO4", 12)):
        spec = DRIVE.telegram(name)
        assert spec.made_up
        assert io_lengths(spec.config) == (octets, octets)
        assert (spec.output_octets, spec.input_octets) == (octets, octets)
    assert DRIVE.core("fan", "PPO3").safe_outputs.hex() == "047e0000"
    assert DRIVE.core("fan", "PPO1").safe_outputs.hex() == "0000000000000000047e0000"


@pytest.mark.parametrize(
    ("o30", "name"),
    [(0, "PPO1"), (1, "PPO1"), (6, "PPO1"), (255, "PPO1"), (2, "PPO2"), (5, "PPO2"), (3, "PPO3"), (4, "PPO4")],
)
def test_f1_o30_chooses_and_another_telegram_is_a_configuration_fault(o30: int, name: str) -> None:
    device = DRIVE.device("PPO3", {"o30": o30})
    for other in DRIVE.telegrams.values():
        assert (device.check_cfg(other.config) is None) == (other.name == name)
    assert device.configs[0] == DRIVE.telegrams[name].config


def test_f1_the_reason_names_o30() -> None:
    assert "o30 is 3" in str(DRIVE.device("PPO3").check_cfg(b"\xf3\x71"))


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x0240, State.SWITCH_ON_INHIBITED),
        (0x0270, State.SWITCH_ON_INHIBITED),
        (0x0231, State.READY_TO_SWITCH_ON),
        (0x0233, State.READY),
        (0x0237, State.RUNNING),
        (0x0737, State.RUNNING),
        (0x0278, State.FAULT),
        (0x0248, State.FAULT),
        (0x0000, State.UNKNOWN),
    ],
)
def test_f2_states(word: int, state: State) -> None:
    assert t.TABLE.states.decode(word) is state


def test_f2_s5_is_told_apart_by_ones_own_command() -> None:
    assert t.TABLE.state(0x0233, 0x047E) is State.STOPPING
    assert t.TABLE.state(0x0233, 0x047F) is State.READY
    assert t.TABLE.state(0x0237, 0x047E) is State.STOPPING


def test_f9_alarm_names() -> None:
    assert t.alarm_text(0x7511) == "Er5 field bus communications error"
    assert "OH1" in t.alarm_text(0x4310)
    assert "OH4" in t.alarm_text(0x4310)
    assert "Er2" in t.alarm_text(0x7520)
    assert "ErP" in t.alarm_text(0x7520)
    assert t.alarm_text(0x1234) == "1234"


def test_f13_addresses() -> None:
    assert t.address("F26") == (0x104, 0x1A)
    assert t.address("y98") == (0x10F, 0x62)
    assert t.address("o30") == (0x10A, 30)
    assert t.address("H03") == (0x108, 3)
    assert t.address("Q1") is None
    assert t.address("F999") is None
    assert t.address("412") is None


# -- the worked run of F3 ------------------------------------------------------------------------------------------


def test_f3_worked_run_of_the_drive() -> None:
    bench = sim()
    assert bench.send("00 00 00 00") == "02 40 00 00"  # 1
    assert bench.send("04 7E 40 00") == "02 31 00 00"  # 2
    seen = bench.until("04 7F 40 00", "03 37 40 00", 3000)  # 3
    speeding = [inputs for inputs in seen if not inputs.startswith("03 37")]
    assert speeding[0] == "02 31 00 00"
    assert {inputs[:5] for inputs in speeding[1:]} == {"02 37"}
    seen = bench.until("04 7E 40 00", "02 31 00 00", 3000)  # 4
    assert seen[0] == "03 37 40 00"
    assert {inputs[:5] for inputs in seen[1:-1]} == {"02 33"}
    bench.until("0C 7F 20 00", "03 37 E0 00", 3000)  # 5, reverse by bit 11
    bench.until("04 7E 20 00", "02 31 00 00", 3000)
    bench.until("04 7F E0 00", "03 37 E0 00", 3000)  # 6, reverse by the sign
    bench.device.trip("OC1")
    assert bench.send("04 7F E0 00") == "02 78 00 00"
    assert bench.send("04 80 10 00") == "02 40 00 00"  # 7
    assert bench.send("04 00 10 00") == "02 40 00 00"
    assert bench.send("04 7E 10 00") == "02 31 00 00"


def test_f3_worked_run_of_the_master() -> None:
    bench = plugin("02 40 00 00", reverse="bit")
    bench.order("speed", value=1.0)
    assert bench.out() == "04 7E 40 00"  # 2
    start = bench.order("start")
    assert bench.see("02 31 00 00") == "04 7F 40 00"  # 3
    bench.see("02 37 00 10", 3)
    assert as_mapping(bench.result(start))["value"] == "running"
    reached = bench.order("reached")
    bench.see("02 37 20 00", 100)
    assert bench.result(reached) is None
    bench.see("07 37 40 00")  # FDT (bit 10) does not matter
    assert as_mapping(bench.result(reached))["value"] == 1.0
    stop = bench.order("stop")
    assert bench.out() == "04 7E 40 00"  # 4
    bench.see("02 33 20 00", 60)
    assert bench.core.status().state is State.STOPPING
    assert bench.result(stop) is None
    bench.see("02 31 00 00", 60)
    assert as_mapping(bench.result(stop))["value"] == "ready_to_switch_on"
    bench.order("speed", value=-0.5)
    start = bench.order("start")
    assert bench.out() == "0C 7F 20 00"  # 5
    bench.see("03 37 E0 00", 3)
    status = bench.core.status()
    assert (status.speed, status.frequency_hz, status.reached) == (-0.5, -30.0, True)
    assert bench.see("02 78 00 00") == "0C 7E 20 00"  # a trip: the goal is gone
    bench.run(3)
    assert any("left the running state" in text for text in bench.notices())
    bench.order("speed", value=0.25)
    token = bench.order("acknowledge")
    assert bench.out() == "04 80 10 00"  # 7
    assert bench.see("02 40 00 00", 60) == "04 00 10 00"
    assert bench.see("02 40 00 00", 60) == "04 7E 10 00"
    assert as_mapping(bench.result(token))["value"] == "switch_on_inhibited"


def test_f3_reverse_by_the_sign() -> None:
    bench = plugin("02 31 00 00")
    bench.order("speed", value=-0.5)
    bench.order("start")
    assert bench.out() == "04 7F E0 00"  # 6
    assert bench.see("03 37 E0 00", 3) == "04 7F E0 00"
    assert bench.core.status().speed == -0.5


def test_f3_start_goes_through_s2() -> None:
    bench = plugin("02 40 00 00")
    bench.order("start")
    assert bench.out() == "04 7E 00 00"
    assert bench.see("02 31 00 00") == "04 7F 00 00"


def test_straight_047f_from_s1_stays_in_s1() -> None:
    assert sim().send("04 7F 40 00", 200) == "02 70 00 00"


def test_fdt_by_e31() -> None:
    bench = sim(E31=60.0)
    bench.send("04 7E 40 00")
    bench.until("04 7F 40 00", "07 37 40 00", 3000)


# -- the drive -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("control", "word"),
    [("04 7C 40 00", "02 60"), ("04 3F 40 00", "02 33"), ("04 77 40 00", "02 33"), ("00 7E 40 00", "03 37")],
)
def test_f12_bits(control: str, word: str) -> None:
    """OFF2 coasts to S1; b6 = 0 disables b0; b3 = 0 blocks; b10 = 0: the whole frame is ignored."""
    bench = sim()
    bench.send("04 7E 40 00")
    bench.until("04 7F 40 00", "03 37 40 00", 3000)
    assert bench.send(control)[:5] == word


def test_f12_off3_stops_with_h56_to_s1() -> None:
    bench = sim(H56=0.5, F08=5)
    bench.send("04 7E 40 00")
    bench.until("04 7F 40 00", "03 37 40 00", 3000)
    start = bench.now
    bench.until("04 7A 40 00", "02 50 00 00", 1000)
    assert 490 * MS < bench.now - start < 600 * MS


def test_f12_ramp_bits() -> None:
    bench = sim()
    bench.send("04 7E 40 00")
    bench.send("04 7F 40 00", 300)
    frozen = bench.send("04 5F 40 00", 100)  # b5 = 0
    assert bench.send("04 5F 40 00", 300) == frozen
    assert bench.send("04 6F 40 00", 300) == "02 37 00 00"  # b4 = 0
    bench.until("04 7F 40 00", "03 37 40 00", 3000)


def test_047f_during_the_ramp_takes_it_back() -> None:
    bench = sim()
    bench.send("04 7E 40 00")
    bench.until("04 7F 40 00", "03 37 40 00", 3000)
    assert bench.send("04 7E 40 00", 300)[:5] == "02 33"
    bench.until("04 7F 40 00", "03 37 40 00", 3000)


def test_f4_bit_11_and_the_sign_multiply() -> None:
    bench = sim()
    bench.send("04 7E 00 00")
    bench.until("0C 7F E0 00", "03 37 20 00", 3000)


@pytest.mark.parametrize(("y98", "word"), [(0, "00 40 00 00"), (1, "02 40 00 00"), (3, "02 31 00 00")])
def test_f10_command_source(y98: int, word: str) -> None:
    assert sim(y98=y98).send("04 7E 40 00") == word


def test_f10_run_from_the_bus_frequency_from_the_inverter() -> None:
    bench = sim(y98=2)
    bench.send("04 7E 40 00")
    assert bench.send("04 7F 40 00", 500) == "03 37 00 00"


def lost(reason: Leave, **presets: Any) -> tuple[DeviceBench, int]:
    bench = sim(**presets)
    bench.send("04 7E 40 00")
    bench.until("04 7F 40 00", "03 37 40 00", 3000)
    bench.device.leave(reason, bench.now)
    return bench, bench.now


def back(bench: DeviceBench, ms: float, outputs: str = "00 00 00 00") -> str:
    """The master returns after some time; the first inputs that come of a scan."""
    bench.now += round(ms * MS)
    bench.device.enter(b"\x71", bench.now)
    return bench.send(outputs, 6)


@pytest.mark.parametrize(
    ("o27", "o28", "ms", "word"),
    [
        (0, 0, 20, "02 78"),
        (4, 9, 20, "02 78"),
        (1, 1.0, 500, "03 37"),
        (1, 1.0, 1100, "02 78"),
        (3, 0, 5000, "03 37"),
        (13, 0, 5000, "03 37"),
        (10, 0, 300, "02 37"),
        (10, 0, 2000, "02 78"),
        (11, 1.0, 500, "03 37"),
        (11, 1.0, 3000, "02 78"),
        (12, 1.0, 3000, "02 78"),
    ],
)
def test_f8_lost_communication(o27: int, o28: float, ms: float, word: str) -> None:
    bench, _ = lost(Leave.WATCHDOG, o27=o27, o28=o28)
    assert back(bench, ms)[:5] == word


@pytest.mark.parametrize(("o27", "word"), [(1, "02 78"), (2, "03 37"), (11, "02 78"), (12, "03 37")])
def test_f8_data_that_return_in_time(o27: int, word: str) -> None:
    bench, _ = lost(Leave.WATCHDOG, o27=o27, o28=1.0)
    assert back(bench, 500)[:5] == "03 37"
    assert bench.send("00 00 00 00", 5000)[:5] == word


def test_f8_no_watchdog_no_reaction_and_nothing_before_data() -> None:
    bench, _ = lost(Leave.UNLOCK)
    assert back(bench, 500)[:5] == "03 37"
    device = DRIVE.device("PPO3")
    device.enter(b"\x71", 5 * S)
    device.leave(Leave.WATCHDOG, 6 * S)
    device.enter(b"\x71", 7 * S)
    assert device.exchange(bytes(4), 7 * S + 100 * MS).hex() == "02400000"


def test_clear_is_ignored_by_bit_10() -> None:
    bench = sim()
    bench.send("04 7E 40 00")
    bench.until("04 7F 40 00", "03 37 40 00", 3000)
    bench.device.clear(bench.now)
    bench.now += 500 * MS
    assert bench.device.exchange(bytes(4), bench.now).hex() == "03374000"


def test_safe_outputs_of_one_frame_count_although_clear_follows_at_once() -> None:
    bench = sim()
    bench.send("04 7E 40 00")
    bench.until("04 7F 40 00", "03 37 40 00", 3000)
    bench.device.exchange(DRIVE.core("fan", "PPO3").safe_outputs, bench.now + 10_000)
    bench.device.clear(bench.now + 20_000)
    bench.now += 3 * S
    bench.device.advance(bench.now)
    assert bench.device.exchange(bytes(4), bench.now).hex() == "02310000"


# -- parameters ----------------------------------------------------------------------------------------------------

REPLIES = [
    ("21 04 1A 00 00 00 00 0F", "11 04 1A 00 00 00 00 0F"),
    ("21 04 1A 00 00 00 00 10", "71 04 1A 00 00 00 00 02"),
    ("11 0F 62 00 00 00 00 00", "11 0F 62 00 00 00 00 03"),
    ("11 0F 64 00 00 00 00 00", "71 0F 64 00 00 00 00 00"),
    ("61 0F 62 00 00 00 00 00", "71 0F 62 00 00 00 00 04"),
    ("13 B3 01 00 00 00 00 00", "73 B3 01 00 00 00 00 03"),
    ("93 B3 00 00 00 00 00 00", "63 B3 00 00 00 00 00 20"),
    ("13 C5 00 00 00 00 00 00", "13 C5 00 00 00 00 00 02"),
    ("23 C5 00 00 00 00 00 01", "73 C5 00 00 00 00 00 01"),
    ("13 C8 00 00 00 00 00 00", "13 C8 00 00 00 00 02 40"),
]


@pytest.mark.parametrize(("order", "reply"), REPLIES)
def test_f6_orders_and_replies(order: str, reply: str) -> None:
    assert pkw(sim1(), order) == reply


def test_f6_f7_f9_malfunction_history() -> None:
    bench = sim1()
    bench.device.trip("OC1")
    bench.send(ZERO + "04 00 00 00")
    bench.send(ZERO + "04 80 00 00")
    bench.device.trip("Er5")
    assert pkw(bench, "63 B3 01 00 00 00 00 00") == "43 B3 01 00 00 00 75 11"
    assert pkw(bench, "63 B3 09 00 00 00 00 00") == "43 B3 09 00 00 00 23 01"
    assert pkw(bench, "63 B3 02 00 00 00 00 00") == "43 B3 02 00 00 00 00 00"
    assert pkw(bench, "63 B3 11 00 00 00 00 00") == "43 B3 11 00 00 00 00 00"


def test_f7_927_forbids_every_other_write() -> None:
    bench = sim1()
    assert pkw(bench, "23 9F 00 00 00 00 00 00") == "13 9F 00 00 00 00 00 00"
    assert pkw(bench, "21 04 1A 00 00 00 00 0F") == "71 04 1A 00 00 00 00 01"
    assert pkw(bench, "23 9F 00 00 00 00 00 01") == "13 9F 00 00 00 00 00 01"
    assert pkw(bench, "21 04 1A 00 00 00 00 0F") == "11 04 1A 00 00 00 00 0F"


def test_f6_the_plugin_to_the_byte() -> None:
    bench = PluginBench(DRIVE.core("fan", "PPO1"), ZERO + "02 40 00 00")
    token = bench.order("write", number="F26", value=15)
    bench.run()
    assert bench.out() == "21 04 1A 00 00 00 00 0F 04 7E 00 00"
    bench.see("11 04 1A 00 00 00 00 0F 02 31 00 00")
    assert as_mapping(bench.result(token))["value"] == 15
    token = bench.order("read", number="y98")
    assert bench.see(ZERO + "02 31 00 00", 2).startswith("11 0F 62 00 00 00 00 00")
    bench.see("11 0F 62 00 00 00 00 03 02 31 00 00", 2)
    assert as_mapping(bench.result(token))["value"] == 3
    token = bench.order("read", number="y100")
    assert bench.see(ZERO + "02 31 00 00", 2).startswith("11 0F 64 00 00 00 00 00")
    bench.see("71 0F 64 00 00 00 00 00 02 31 00 00", 2)
    result = as_mapping(bench.result(token))
    assert (result["error"], result["number"]) == ("parameter", 0)
    assert "nonexistent" in str(result["text"])
    token = bench.order("read", number=947, index=1)
    assert bench.see(ZERO + "02 31 00 00", 2).startswith("63 B3 01 00 00 00 00 00")
    bench.see("43 B3 01 00 00 00 75 11 02 31 00 00", 2)
    assert as_mapping(bench.result(token))["value"] == 0x7511


@pytest.mark.parametrize(
    ("args", "text"),
    [
        ({"number": "F26", "index": 2}, "no index"),
        ({"number": "Q26"}, "neither a function code"),
        ({"number": 2048}, "2047"),
        ({"number": 947, "index": 256}, "0..255"),
    ],
)
def test_misuse_of_parameters(args: dict[str, object], text: str) -> None:
    bench = PluginBench(DRIVE.core("fan", "PPO1"), ZERO + "02 40 00 00")
    result = as_mapping(bench.result(bench.order("read", **args)))
    assert result["error"] == "usage"
    assert text in str(result["text"])


def test_misuse_of_writes() -> None:
    bench = PluginBench(DRIVE.core("fan", "PPO1"), ZERO + "02 40 00 00")
    for args, text in (
        ({"number": "F26", "value": 1, "ram": True}, "RAM"),
        ({"number": "F26", "value": 16}, "0..15"),
        ({"number": 965, "value": 1}, "read only"),
    ):
        assert text in str(as_mapping(bench.result(bench.order("write", **args)))["text"])


# -- what a start tells --------------------------------------------------------------------------------------------


def test_f10_start_without_bit_9_says_y98() -> None:
    bench = plugin("00 40 00 00")
    token = bench.order("start")
    bench.run(100)
    result = as_mapping(bench.result(token))
    assert result["error"] == "fault"
    assert "set y98 to 3" in str(result["text"])


def test_f10_start_reads_y98_where_it_can() -> None:
    bench = PluginBench(DRIVE.core("fan", "PPO1"), ZERO + "00 40 00 00")
    token = bench.order("start")
    bench.run(60)
    assert bench.out().startswith("11 0F 62 00")
    bench.see("11 0F 62 00 00 00 00 00 00 40 00 00", 2)
    assert str(as_mapping(bench.result(token))["text"]).startswith("y98 is 0")


def test_a_drive_that_stays_in_s1_is_told_with_what_to_look_at() -> None:
    bench = plugin("02 40 00 00")
    token = bench.order("start", timeout_s=1)
    bench.run(600)
    result = as_mapping(bench.result(token))
    assert result["error"] == "timeout"
    for part in ("S1", "y98", "LE", "LOC", "y99"):
        assert part in str(result["text"])


def test_f9_alarm_is_named_through_the_parameter_channel() -> None:
    bench = PluginBench(DRIVE.core("fan", "PPO1"), ZERO + "02 31 00 00")
    bench.see(ZERO + "02 78 00 00", 2)
    assert bench.out().startswith("63 B3 01 00")
    bench.see("43 B3 01 00 00 00 75 11 02 78 00 00", 2)
    assert bench.core.status().faults == ("Er5 field bus communications error",)


def test_unknown_alarms_and_options_are_refused() -> None:
    with pytest.raises(ValueError, match="Er5"):
        DRIVE.device("PPO3").trip("F2100")
    DRIVE.device("PPO3").trip("35")
    with pytest.raises(ConfigError, match="'sign' or 'bit'"):
        DRIVE.core("fan", "PPO3", {"reverse": "left"})
    with pytest.raises(ConfigError, match=r"0\.\.3"):
        DRIVE.device("PPO3", {"y98": 4})
