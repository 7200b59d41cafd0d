"""IMO's plugin against literal octets (I1 to I5): codes of CW and SW, the PKW zone, process data by P15."""

from __future__ import annotations

import re
from typing import Any

import pytest
from drive_bench import PluginBench, as_mapping

from dpstack.errors import ConfigError
from dpstack.profile import State
from dpstack_drives.imo import DRIVE

NOTHING = "00 " * 22
#: SW: stopped, bus voltage up, the bus commands
READY = "41 03 "


class Card(PluginBench):
    """Answers reads of P15 as table 2-9 says, and writes with what was written; SW and PZD are what the test says."""

    def __init__(self, p15: dict[int, int], sw: str = READY, pzd: str = NOTHING, **options: Any) -> None:
        self.p15 = p15
        self.seen: list[str] = []
        self.mute = False
        super().__init__(DRIVE.core("pump", options=options), "00 " * 8 + sw + pzd)
        self.show(sw, pzd)

    def show(self, sw: str, pzd: str = NOTHING, rotations: int = 120) -> str:
        """SW and PZD2 to PZD12 from now on; CW and PZD sent in the end, in hex."""
        self._process = bytes.fromhex(sw + pzd)
        for _ in range(rotations):
            out = self.run()
            request = out[:8].hex(" ").upper()
            if not self.seen or self.seen[-1] != request:
                self.seen.append(request)
            reply = bytes(8)
            if not self.mute and out[1] in (1, 4):
                assert out[2] == 15
                if out[1] == 4:
                    assert out[8] & 1, "CW bit 8"
                    self.p15[out[3]] = out[7]
                reply = bytes([0, 1, 15, out[3], 0, 0, 0, self.p15.get(out[3], 0)])
            self.inputs = reply + self._process
        return out[8:].hex(" ").upper()

    def ask(self, op: str, **args: object) -> dict[str, object]:
        """An order and its result."""
        token = self.order(op, **args)
        self.show(self._process[:2].hex(), self._process[2:].hex())
        return dict(as_mapping(self.result(token)))


RUNS = {2: 1, 13: 1, 14: 5, 15: 6, 16: 11}


def test_i1_one_frame_of_sixteen_words() -> None:
    spec = DRIVE.telegram()
    assert (spec.name, spec.config.hex(), spec.output_octets, spec.input_octets) == ("PKW+12", "f37b", 32, 32)
    assert spec.made_up
    assert DRIVE.core("pump").safe_outputs.hex(" ") == "00 " * 8 + "00 05" + " 00" * 22


def test_i2_i4_forward_reverse_stop_coast_reset() -> None:
    bench = Card(RUNS, rated_current=20, fault_names="11=OL1")
    assert bench.show(READY) == "00 05" + " 00" * 22
    bench.order("frequency", value=25.0)
    start = bench.order("start")
    assert bench.show(READY, rotations=40) == "00 01 09 C4" + " 00" * 20
    assert bench.result(start) is None
    # forward, 20.00 Hz, 10.0 A, 30.0 %, no fault
    bench.show("41 01 ", "07 D0 00 64 01 2C 00 00" + " 00" * 14)
    assert as_mapping(bench.result(start))["value"] == "running"
    status = bench.core.status()
    assert (status.frequency_hz, status.current, status.torque) == (20.0, 0.5, 0.3)
    bench.order("speed", value=-0.5)
    assert bench.show("41 01 ", rotations=2) == "00 02 09 C4" + " 00" * 20
    bench.show("41 02 ", "09 C4" + " 00" * 20)
    assert bench.core.status().speed == -0.5
    bench.order("stop")
    assert bench.show("41 02 ", "07 D0" + " 00" * 20, 2)[:5] == "00 05"
    assert bench.core.status().state is State.STOPPING
    bench.show(READY)
    assert bench.core.status().state is State.READY
    bench.order("coast")
    assert bench.show(READY, rotations=2)[:5] == "00 06"
    bench.show("41 04 ", "00 00 00 00 00 00 00 0B" + " 00" * 14)
    assert bench.core.status().faults == ("OL1 (code 11)",)
    assert "OL1 (code 11); acknowledge it first" in str(bench.ask("start")["text"])
    bench.order("acknowledge")
    assert bench.show("41 04 ", rotations=2)[:5] == "00 07"
    assert bench.show(READY, rotations=200)[:5] == "00 05"


@pytest.mark.parametrize(
    ("sw", "state", "remote"),
    [
        ("41 01 ", State.STOPPING, True),  # runs, but not by our command
        ("41 03 ", State.READY, True),
        ("40 03 ", State.NOT_READY, True),
        ("41 04 ", State.FAULT, True),
        ("40 05 ", State.NOT_READY, True),
        ("41 06 ", State.READY, True),
        ("01 03 ", State.READY, False),
        ("21 03 ", State.READY, False),
        ("41 00 ", State.UNKNOWN, True),
        ("41 07 ", State.UNKNOWN, True),
    ],
)
def test_i2_states(sw: str, state: State, remote: bool) -> None:
    bench = Card({}, sw)
    status = bench.core.status()
    assert (status.state, status.remote) == (state, remote)


def test_i2_bits() -> None:
    bench = Card(RUNS, "DB 03 ", motor="2", heartbeat=True)
    status = bench.core.status()
    assert status.bits == ("bus_voltage", "motor_2", "synchronous", "overload", "remote", "heartbeat")
    assert status.warnings == ("overload pre-alarm",)
    assert bench.show("DB 03 ", rotations=1)[:5] == "82 05"
    bench.show("4B 03 ")
    assert bench.core.status().warnings == ("heartbeat not echoed (SW bit 15)",)
    for name, cw in (("torque_control", "8A"), ("clear_energy", "92"), ("pre_excitation", "A2"), ("dc_brake", "C2")):
        assert bench.ask("control", number=name, value=1)["ok"]
        assert bench.show("CB 03 ", rotations=1)[:5] == f"{cw} 05"
        bench.ask("control", number=name, value=0)
    assert "torque_control, clear_energy" in str(bench.ask("control", number="motor", value=1)["text"])


def test_i2_inching_and_pre_excitation_last_until_another_command() -> None:
    bench = Card(RUNS)
    for direction, cw in (("forward", "00 03"), ("reverse", "00 04"), ("stop", "00 08")):
        assert bench.ask("inch", direction=direction)["ok"]
        assert bench.show(READY, rotations=1)[:5] == cw
    bench.ask("inch", direction="forward")
    bench.show("41 01 ")
    assert bench.core.status().state is State.RUNNING
    bench.order("stop")
    assert bench.show("41 01 ", rotations=1)[:5] == "00 05"
    bench.show(READY)
    assert bench.ask("pre_excite")["ok"]
    assert bench.show(READY, rotations=1)[:5] == "00 09"
    bench.show("41 04 ")  # a fault ends it: not again after its reset
    assert bench.show(READY)[:5] == "00 05"
    bench.order("start")
    bench.show(READY)
    bench.show("41 01 ")
    assert "stop() it first" in str(bench.ask("inch", direction="forward")["text"])
    assert "forward, reverse, stop" in str(bench.ask("inch", direction="up")["text"])


def test_i2_no_quick_stop_is_said_by_name() -> None:
    bench = Card(RUNS)
    assert "no quick stop ramp: its emergency stop (6) coasts" in str(bench.ask("quick_stop")["text"])


@pytest.mark.parametrize(
    ("sw", "says"),
    [
        ("01 03 ", "SW bits 13-14 are 0: its keypad commands the drive"),
        ("21 03 ", "SW bits 13-14 are 1: its terminals commands the drive"),
        ("61 03 ", "SW bits 13-14 are 3"),
        ("40 03 ", "SW bit 8 is 0: the bus voltage is not established"),
        ("40 05 ", "POFF"),
    ],
)
def test_i2_start_says_what_keeps_it(sw: str, says: str) -> None:
    bench = Card(RUNS, sw)
    result = bench.ask("start")
    assert result["error"] == "fault"
    assert says in str(result["text"])
    assert bench.show(sw, rotations=1)[:5] == "00 05"


def test_i4_start_without_a_set_frequency_names_the_parameter() -> None:
    text = str(Card({3: 4}).ask("start")["text"])
    assert "of P15.02 to P15.12 none is 1; set P15.02 to 1" in text


def test_i4_set_map_lets_start_write_it() -> None:
    bench = Card({}, set_map=True)
    bench.order("speed", value=0.5)
    bench.order("start")
    assert bench.show(READY)[:11] == "00 01 09 C4"
    assert bench.p15 == RUNS
    assert "00 04 0F 02 00 00 00 01" in bench.seen
    assert any("takes a limited number" in text for text in bench.notices())


# -- PKW -----------------------------------------------------------------------------------------------------------


def pkw(bench: PluginBench, reply: str) -> str:
    """The request under way while the drive shows ``reply``."""
    return bench.see(reply + " " + READY + NOTHING, 2)[:23]


def quiet() -> PluginBench:
    return Card(RUNS)


def test_i3_the_read_of_the_manual() -> None:
    bench = quiet()
    token = bench.order("read", number="P00.10")
    assert pkw(bench, "00 00 00 00 00 00 00 00") == "00 01 00 0A 00 00 00 00"
    assert pkw(bench, "00 01 00 0A 00 00 13 88") == "00 00 00 00 00 00 00 00"
    result = as_mapping(bench.result(token))
    assert (result["value"], result["raw"], result["unit"]) == (50.0, 0x1388, "Hz")
    by_number = bench.order("read", number=10)
    bench.run(60)
    pkw(bench, "00 00 00 00 00 00 00 00")
    pkw(bench, "00 01 00 0A 00 00 00 64")
    assert as_mapping(bench.result(by_number))["value"] == 1.0


def test_i3_a_long_response() -> None:
    bench = quiet()
    token = bench.order("read", number="P07.20")
    assert pkw(bench, "00 00 00 00 00 00 00 00") == "00 01 07 14 00 00 00 00"
    pkw(bench, "00 02 07 14 00 01 E2 40")
    assert as_mapping(bench.result(token))["value"] == 123456


def test_i3_a_write_is_request_4_with_cw_bit_8() -> None:
    bench = quiet()
    bench.order("write", number="P00.10", value=12.5)
    assert bench.see("00 00 00 00 00 00 00 00 " + READY + NOTHING, 2)[:29] == "00 04 00 0A 00 00 04 E2 01 05"
    assert bench.see("00 01 00 0A 00 00 04 E2 " + READY + NOTHING, 2)[:29] == "00 00 00 00 00 00 00 00 00 05"
    assert any("request 4" in text for text in bench.notices())


@pytest.mark.parametrize(
    ("reply", "says", "number"),
    [
        ("00 03 00 0A 00 01 00 00", "error 1, invalid command", 1),
        ("00 03 00 0A 00 02 00 00", "error 2, invalid data address", 2),
        ("00 03 00 0A 00 03 00 00", "error 3, invalid data value", 3),
        ("00 03 00 0A 00 04 00 00", "error 4, operation failure", 4),
        ("00 03 00 0A 00 05 00 00", "error 5, password error", 5),
        ("00 03 00 0A 00 06 00 00", "error 6, data frame error", 6),
        ("00 03 00 0A 00 07 00 00", "error 7, the parameter is read only", 7),
        ("00 03 00 0A 00 08 00 00", "error 8, the parameter cannot be changed while the drive runs", 8),
        ("00 03 00 0A 00 09 00 00", "error 9, protected by password", 9),
        ("00 03 00 0A 00 63 00 00", "error 99, error without a text", 99),
        ("00 04 00 0A 00 00 00 00", "no right to change parameters (response 4)", None),
    ],
)
def test_i3_refusals(reply: str, says: str, number: int | None) -> None:
    bench = quiet()
    token = bench.order("write", number="P00.10", value=1)
    pkw(bench, "00 00 00 00 00 00 00 00")
    pkw(bench, reply)
    result = as_mapping(bench.result(token))
    assert (result["error"], result["number"]) == ("parameter", number)
    assert says in str(result["text"])


@pytest.mark.parametrize(
    ("op", "args", "says"),
    [
        ("write", {"number": "P00.10", "value": 1, "ram": True}, "does not support writes to RAM only (request 2)"),
        ("write", {"number": "P07.20", "value": 70_000}, "does not write parameters of two words, request 5"),
        ("write", {"number": "P15.01", "value": 126}, "outside 0..125"),
        ("write", {"number": "P15.02", "value": 19}, "outside 0..18"),
        ("write", {"number": "P15.13", "value": 27}, "outside 0..26"),
        ("write", {"number": "P15.00", "value": 1}, "read only"),
        ("read", {"number": "412.1"}, "neither a function code such as P15.02 nor an address"),
        ("read", {"number": 65_536}, "0..65535"),
        ("read", {"number": "P15.02", "index": 1}, "neither data sets nor indexes"),
    ],
)
def test_i3_i5_misuse_is_refused_before_anything_is_sent(op: str, args: dict[str, object], says: str) -> None:
    bench = Card(RUNS)
    bench.seen.clear()
    result = bench.ask(op, **args)
    assert result["error"] == "usage"
    assert says in str(result["text"])
    assert bench.seen == ["00 00 00 00 00 00 00 00"]


def test_i3_a_drive_that_is_silent_or_answers_for_another_address() -> None:
    bench = quiet()
    token = bench.order("read", number="P00.10", timeout_s=0.1)
    pkw(bench, "00 01 00 0B 00 00 00 00")
    bench.run(60)
    assert "answered for P00.11 (response 1) instead" in str(as_mapping(bench.result(token))["text"])
    bench = quiet()
    token = bench.order("read", number="P00.10", timeout_s=0.1)
    pkw(bench, "00 00 00 00 00 00 00 00")
    bench.run(60)
    assert "did not answer in its parameter channel in time" in str(as_mapping(bench.result(token))["text"])


# -- PZD -----------------------------------------------------------------------------------------------------------


def test_i4_the_rpm_of_the_manual() -> None:
    """P15.14 = 8: 00 0A in PZD3 is 10 rpm."""
    bench = Card({14: 8}, reference_rpm=1000)
    bench.show(READY, "FF FF 00 0A" + " 00" * 18)
    assert bench.ask("inputs")["value"] == {"rpm": 10}
    assert bench.core.status().speed == 0.01


TRANSMITTED = [
    (1, "frequency", "13 88", 50.0),
    (2, "set_frequency", "09 C4", 25.0),
    (3, "bus_voltage", "15 18", 540.0),
    (4, "output_voltage", "01 90", 400),
    (5, "current", "00 7D", 12.5),
    (6, "torque", "FF 9C", -10.0),
    (7, "power", "01 F4", 50.0),
    (8, "rpm", "05 DC", 1500),
    (9, "linear_speed", "00 03", 3),
    (10, "ramp_frequency", "00 64", 1.0),
    (11, "fault_code", "00 0B", 11),
    (12, "ai1", "03 E8", 10.0),
    (13, "ai2", "FC 18", -10.0),
    (14, "ai3", "00 01", 0.01),
    (15, "hdia_frequency", "13 88", 50.0),
    (16, "input_terminals", "02 01", 0x201),
    (17, "output_terminals", "00 0F", 15),
    (18, "pid_reference", "27 10", 100.0),
    (19, "pid_feedback", "00 64", 1.0),
    (20, "rated_torque", "00 41", 65),
    (21, "position_reference_high", "FF FF", -1),
    (22, "position_reference_low", "FF FF", 65535),
    (23, "position_feedback_high", "80 00", -32768),
    (24, "position_feedback_low", "80 00", 32768),
    (25, "state_word", "41 03", 0x4103),
    (26, "hdib_frequency", "00 0A", 0.1),
]


@pytest.mark.parametrize(("number", "name", "octets", "value"), TRANSMITTED)
def test_i4_transmitted(number: int, name: str, octets: str, value: float) -> None:
    bench = Card({23: number})
    bench.show(READY, "00 " * 20 + octets)
    assert bench.ask("inputs")["value"] == {name: value}


RECEIVED = [
    (2, "pid_reference", 50, "01 F4", 100.1, "0..100 %"),
    (3, "pid_feedback", 100, "03 E8", -0.1, "0..100 %"),
    (4, "torque", -300, "F4 48", 300.1, "-300..300 %"),
    (5, "forward_limit", 50, "13 88", 50.01, "0..50 Hz"),
    (6, "reverse_limit", 0.01, "00 01", -1, "0..50 Hz"),
    (7, "motoring_torque_limit", 300, "0B B8", 301, "0..300 %"),
    (8, "braking_torque_limit", 12.5, "00 7D", -1, "0..300 %"),
    (9, "input_terminals", 0x3FF, "03 FF", 0x400, "0..1023"),
    (10, "output_terminals", 0x0F, "00 0F", 0x10, "0..15"),
    (11, "voltage", 100, "03 E8", 101, "0..100 %"),
    (12, "ao1", -100, "FC 18", 101, "-100..100 %"),
    (13, "ao2", 1, "00 0A", -101, "-100..100 %"),
    (14, "position_reference_high", -1, "FF FF", 32768, "-32768..32767"),
    (15, "position_reference_low", 65535, "FF FF", -1, "0..65535"),
    (16, "position_feedback_high", -32768, "80 00", 40_000, "-32768..32767"),
    (17, "position_feedback_low", 1, "00 01", 65536, "0..65535"),
    (18, "position_feedback_flag", 1, "00 01", 2, "0..1"),
]


@pytest.mark.parametrize(("number", "name", "value", "octets", "beyond", "limits"), RECEIVED)
def test_i4_received(number: int, name: str, value: float, octets: str, beyond: float, limits: str) -> None:
    bench = Card({12: number})
    assert bench.ask("output", number=name, value=value)["ok"]
    assert bench.show(READY, rotations=1) == "00 05" + " 00" * 20 + " " + octets
    result = bench.ask("output", number=name, value=beyond)
    assert result["error"] == "usage"
    assert f"is outside {limits}" in str(result["text"])
    assert bench.show(READY, rotations=1)[-5:] == octets


def test_i4_set_points_beyond_the_maximum_frequency() -> None:
    text = str(Card(RUNS).ask("speed", value=1.2)["text"])
    assert "set_frequency 60 Hz is outside 0..50 Hz (the maximum frequency, option max_hz)" in text
    bench = Card(RUNS, max_hz=60)
    assert bench.ask("speed", value=1.2)["ok"]
    assert bench.show(READY, rotations=1)[:11] == "00 05 17 70"


@pytest.mark.parametrize(
    ("args", "says"),
    [
        ({"outputs": "set_freqency"}, "did you mean set_frequency?"),
        ({"outputs": "19"}, "no process data of the drive"),
        ({"inputs": "27"}, "no process data of the drive"),
        ({"outputs": "torque - torque"}, "torque twice"),
        ({"outputs": "- " * 12}, "12 process data, there are 11"),
    ],
)
def test_i4_maps_are_checked_before_anything_is_sent(args: dict[str, object], says: str) -> None:
    bench = Card(RUNS)
    bench.seen.clear()
    result = bench.ask("write_map", **args)
    assert result["error"] == "usage"
    assert says in str(result["text"])
    assert bench.seen == ["00 00 00 00 00 00 00 00"]


def test_i4_a_map_is_read_and_only_what_differs_is_written() -> None:
    bench = Card({2: 1, 13: 1, 22: 7})
    reads = [int(request[9:11], 16) for request in bench.seen if re.match("00 01 0F", request)]
    assert reads == list(range(2, 24))  # P15.22 too, which is missing in print
    assert bench.ask("read_map")["value"] == {
        "inputs": "frequency - - - - - - - - power",
        "outputs": "set_frequency",
    }
    bench.seen.clear()
    assert bench.ask("write_map", outputs="set_frequency torque", inputs="frequency rpm - - - - - - - power")["ok"]
    writes = [request for request in bench.seen if request.startswith("00 04")]
    assert writes == ["00 04 0F 03 00 00 00 04", "00 04 0F 0E 00 00 00 08"]
    assert "not in the output map (set_frequency torque)" in str(bench.ask("output", number="ao1", value=0)["text"])
    assert "written by speed" in str(bench.ask("output", number="set_frequency", value=0)["text"])


def test_a_fault_without_a_fault_code_in_the_map_says_where_to_look() -> None:
    bench = Card({2: 1, 13: 1}, "41 04 ")
    assert "no transmitted PZD (P15.13 to P15.23) is 11, fault_code" in str(bench.core.status().fault)


def test_a_drive_that_never_tells_its_map_is_a_time_out_with_a_reason() -> None:
    bench = PluginBench(DRIVE.core("pump"), "00 " * 8 + READY + NOTHING)
    token = bench.order("start", timeout_s=0.5)
    bench.run(400)
    result = as_mapping(bench.result(token))
    assert result["error"] == "timeout"
    assert "not yet told what its process data are (P15.02 to P15.23)" in str(result["text"])


def test_what_was_given_does_not_come_back_with_the_drive() -> None:
    bench = Card({2: 4})
    bench.ask("output", number="torque", value=50)
    bench.ask("control", number="dc_brake", value=1)
    assert bench.show(READY, rotations=1)[:11] == "40 05 01 F4"
    bench.core.lost(bench.now)
    assert bench.show(READY)[:11] == "00 05 00 00"


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"baud_index": 9}, "9 Mbit/s in the card's table, a rate that PROFIBUS does not have"),
        ({"baud_index": 6.5}, "must be a whole number"),
        ({"fault_names": "OC1"}, "write each code once with its name"),
        ({"map_outputs": "speed"}, "no process data of the drive"),
    ],
)
def test_i5_options_that_cannot_be(options: dict[str, object], says: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(says)):
        DRIVE.core("pump", options=options)
