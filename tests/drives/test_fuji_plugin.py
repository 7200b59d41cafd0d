"""Fuji's plugin against literal octets, the worked run of the manual in order (docs/reference/drives/fuji.md)."""

from __future__ import annotations

import pytest

from dpstack.profile import State
from tests.drives.fuji_kit import IDLE, WIDE, ZERO, plugin, sim


def test_f3_worked_run_of_the_master() -> None:
    bench = plugin(reverse="bit")
    assert bench.out_after("speed", value=1.0) == "04 7E 40 00"  # 2
    start = bench.order("start")
    assert bench.see("02 31 00 00") == "04 7F 40 00"  # 3
    assert bench.value(start, "02 37 00 10", 3) == "running"
    reached = bench.order("reached")
    bench.see("02 37 20 00", 100)
    assert bench.result(reached) is None
    assert bench.value(reached, "07 37 40 00") == 1.0  # FDT (bit 10) does not matter
    stop = bench.order("stop")
    assert bench.out() == "04 7E 40 00"  # 4
    bench.see("02 33 20 00", 60)
    assert bench.core.status().state is State.STOPPING
    assert bench.result(stop) is None
    assert bench.value(stop, "02 31 00 00", 60) == "ready_to_switch_on"
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
    assert bench.value(token) == "switch_on_inhibited"


def test_f3_reverse_by_the_sign() -> None:
    bench = plugin(inputs="02 31 00 00")
    bench.order("speed", value=-0.5)
    assert bench.out_after("start") == "04 7F E0 00"  # 6
    assert bench.see("03 37 E0 00", 3) == "04 7F E0 00"
    assert bench.core.status().speed == -0.5


def test_f3_start_goes_through_s2() -> None:
    bench = plugin()
    assert bench.out_after("start") == "04 7E 00 00"
    assert bench.see("02 31 00 00") == "04 7F 00 00"


def test_f10_start_without_bit_9_says_y98() -> None:
    bench = plugin(inputs="00 40 00 00")
    token = bench.order_and_run(100, "start")
    assert "set y98 to 3" in bench.text(token, "fault")


def test_f10_start_reads_y98_where_it_can() -> None:
    bench = plugin("PPO1", ZERO + "00 40 00 00")
    token = bench.order_and_run(60, "start")
    assert bench.out().startswith("11 0F 62 00")
    bench.see("11 0F 62 00 00 00 00 00 00 40 00 00", 2)
    assert bench.text(token).startswith("y98 is 0")


def test_a_drive_that_stays_in_s1_is_told_with_what_to_look_at() -> None:
    bench = plugin()
    token = bench.order_and_run(600, "start", timeout_s=1)
    text = bench.text(token, "timeout")
    for part in ("S1", "y98", "LE", "LOC", "y99"):
        assert part in text


def test_f9_alarm_is_named_through_the_parameter_channel() -> None:
    bench = plugin("PPO1", ZERO + "02 31 00 00")
    assert bench.see(ZERO + "02 78 00 00", 3).startswith("63 B3 01 00")
    bench.see("43 B3 01 00 00 00 75 11 02 78 00 00", 2)
    assert bench.core.status().faults == ("Er5 field bus communications error",)


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


@pytest.mark.parametrize(("speed", "mrv"), [(1.0, "40 00"), (-1.0, "C0 00"), (0.5, "20 00"), (-0.25, "F0 00")])
def test_f4_mrv_of_the_plugin(speed: float, mrv: str) -> None:
    """4000 is F03; MAV likewise."""
    bench = plugin("PPO3", "03 37 " + mrv, reference_hz=60)
    assert bench.out_after("speed", value=speed) == "04 7E " + mrv
    assert bench.core.status().frequency_hz == 60 * speed


@pytest.mark.parametrize(
    ("op", "ctw"), [("stop", "04 7E"), ("quick_stop", "04 7A"), ("coast", "04 7C"), ("start", "04 7F")]
)
def test_f12_words_of_the_plugin(op: str, ctw: str) -> None:
    """OFF1, OFF3, OFF2; bits 4 to 6 and 10 always 1."""
    bench = plugin("PPO3", "02 31 00 00")
    assert bench.out_after(op) == ctw + " 00 00"


def test_f15_the_plugin_says_that_the_inverter_has_no_power() -> None:
    bench = plugin("PPO1", ZERO + "00 00 00 00")
    token = bench.order_and_run(100, "start")
    assert "the inverter has no power" in bench.text(token, "fault")


def test_f9_an_alarm_whose_name_was_lost_is_asked_again() -> None:
    bench = plugin("PPO1", ZERO + "02 78 00 00")
    assert bench.out(3).startswith("63 B3 01 00")
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
    assert bench.see(ZERO + "02 78 00 00", 3).startswith("63 B3 01 00")
    bench.see("43 B3 01 00 00 00 23 01 02 78 00 00", 2)
    assert bench.core.status().faults == ("OC1 overcurrent during acceleration",)


def test_f9_a_question_without_an_answer_is_asked_again() -> None:
    bench = plugin("PPO1", ZERO + "02 78 00 00")
    bench.run(700)
    assert bench.core.status().faults == ("not yet named",)
    assert bench.see(ZERO + "02 78 00 01", 61).startswith("63 B3 01 00")
