"""IMO's process data by P15, the plugin's end against literal octets
(docs/reference/drives/imo-hd2.md#process-data)."""

from __future__ import annotations

import re

import pytest

from tests.drives.imo_kit import READY, RUNS, Card

# -- PZD -----------------------------------------------------------------------------------------------------------


def test_i4_the_rpm_of_the_manual() -> None:
    """P15.14 = 8: 00 0A in PZD3 is 10 rpm."""
    bench = Card({14: 8}, reference_rpm=1000)
    bench.show(READY, "FF FF 00 0A" + " 00" * 18)
    assert bench.ok("inputs") == {"rpm": 10}
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
    assert bench.ok("inputs") == {name: value}


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
    bench.ok("output", number=name, value=value)
    assert bench.show(READY, rotations=1) == "00 05" + " 00" * 20 + " " + octets
    assert f"is outside {limits}" in bench.misuse("output", number=name, value=beyond)
    assert bench.show(READY, rotations=1)[-5:] == octets


def test_i4_set_points_beyond_the_maximum_frequency() -> None:
    text = str(Card(RUNS).do("speed", value=1.2)["text"])
    assert "set_frequency 60 Hz is outside 0..50 Hz (the maximum frequency, option max_hz)" in text
    bench = Card(RUNS, max_hz=60)
    bench.ok("speed", value=1.2)
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
    assert says in bench.misuse("write_map", **args)
    assert bench.seen == ["00 00 00 00 00 00 00 00"]


def test_i4_a_map_is_read_and_only_what_differs_is_written() -> None:
    bench = Card({2: 1, 13: 1, 22: 7})
    reads = [int(request[9:11], 16) for request in bench.seen if re.match("00 01 0F", request)]
    assert reads == list(range(2, 24))  # P15.22 too, which is missing in print
    assert bench.ok("read_map") == {
        "inputs": "frequency - - - - - - - - power",
        "outputs": "set_frequency",
    }
    bench.seen.clear()
    bench.ok("write_map", outputs="set_frequency torque", inputs="frequency rpm - - - - - - - power")
    writes = [request for request in bench.seen if request.startswith("00 04")]
    assert writes == ["00 04 0F 0E 00 00 00 08", "00 04 0F 03 00 00 00 04"]
    assert "not in the output map (set_frequency torque)" in bench.misuse("output", number="ao1", value=0)
    assert "written by speed" in bench.misuse("output", number="set_frequency", value=0)
