"""Demag, the master's end alone: fed with literal octets of the manual (docs/reference/drives/demag.md)."""

from __future__ import annotations

import pytest
from demag_kit import ZERO, ppo1, ppo3
from drive_bench import MS, PluginBench, S, as_mapping

from dpstack.profile import State
from dpstack_drives.demag import DRIVE


def running() -> PluginBench:
    bench = ppo3()
    token = bench.order("start")
    for word in ("02 21 00 00", "02 23 00 00", "02 27 00 00"):
        bench.see(word, 2)
    assert bench.value(token) == "running"
    return bench


def test_before_any_order_it_sends_zeros() -> None:
    bench = ppo3()
    assert bench.out() == "00 00 00 00"
    assert bench.core.safe_outputs == bytes(4)
    assert bench.core.status().state is State.SWITCH_ON_INHIBITED


def test_d7_the_way_to_operation_enabled_word_by_word() -> None:
    bench = ppo3()
    token = bench.order("start")
    assert bench.out() == "00 06 00 00"  # transition 2
    assert bench.see("02 21 00 00") == "00 07 00 00"  # 3
    assert bench.see("02 23 00 00") == "00 0F 00 00"  # 4
    assert bench.result(token) is None
    assert bench.see("06 27 00 00") == "00 0F 00 00"
    assert bench.done(token)["ok"] is True


def test_d11_set_point_of_the_example() -> None:
    """60 Hz reference, 30 Hz wanted: 0x2000."""
    bench = PluginBench(DRIVE.core("hoist", "PPO3", {"reference_hz": 60}), "02 40 00 00")
    assert bench.out_after("frequency", value=30.0) == "00 00 20 00"
    assert bench.out_after("speed", value=-2.0) == "00 00 80 00"
    token = bench.order("speed", value=2.0)
    assert bench.out() == "00 00 80 00"
    assert "-2..1.9999" in bench.text(token, "usage")


def test_d11_field_weakening_of_the_example() -> None:
    """375 = 50 Hz and 390 = 100 Hz: up to +-200 Hz."""
    bench = PluginBench(DRIVE.core("hoist", "PPO3", {"reference_hz": 100}), "02 40 00 00")
    assert bench.out_after("frequency", value=-200) == "00 00 80 00"
    assert bench.out_after("frequency", value=199.994) == "00 00 7F FF"
    bench.see("02 27 7F FF")
    assert bench.core.status().frequency_hz == pytest.approx(199.99, abs=0.01)


@pytest.fixture
def bench() -> PluginBench:
    return running()


def test_actual_value(bench: PluginBench) -> None:
    bench.see("06 27 20 00")
    status = bench.core.status()
    assert (status.speed, status.frequency_hz, status.reached, status.remote) == (0.5, 25.0, True, True)
    bench.see("02 27 C0 00")
    assert bench.core.status().speed == -1.0


@pytest.mark.parametrize(
    ("op", "control", "answers", "state"),
    [
        ("stop", "00 07", ["02 27 10 00", "02 27 00 00", "02 23 00 00"], "ready"),
        ("quick_stop", "00 02", ["02 07 10 00", "02 40 00 00"], "switch_on_inhibited"),
        ("coast", "00 00", ["02 40 00 00"], "switch_on_inhibited"),
    ],
)
def test_d8_ways_to_stop(bench: PluginBench, op: str, control: str, answers: list[str], state: str) -> None:
    token = bench.order(op)
    assert bench.out() == control + " 00 00"
    for answer in answers[:-1]:
        bench.see(answer, 60)
        assert bench.result(token) is None
    assert bench.value(token, answers[-1], 60) == state


def test_own_command_tells_stopping_from_running(bench: PluginBench) -> None:
    bench.order("stop")
    bench.see("02 27 10 00")
    assert bench.core.status().state is State.STOPPING
    assert not bench.core.status().running
    bench.order_and_run(1, "start")
    assert bench.core.status().state is State.RUNNING


def test_reached_needs_the_bit_and_fresh_inputs(bench: PluginBench) -> None:
    bench.see("06 27 00 00")
    bench.order("speed", value=0.5)
    token = bench.order_and_run(3, "reached")
    assert bench.result(token) is None  # the bit belongs to the old set point
    bench.see("02 27 10 00", 40)
    assert bench.result(token) is None
    assert bench.value(token, "06 27 20 00") == 0.5


def test_reached_with_a_tolerance_is_judged_by_the_speed(bench: PluginBench) -> None:
    bench.order("speed", value=0.5)
    token = bench.order("reached", tolerance=0.01)
    bench.see("06 27 00 00", 100)
    assert bench.result(token) is None
    bench.see("02 27 1F F0")
    assert bench.done(token)["ok"] is True


def test_reached_of_a_drive_that_does_not_run() -> None:
    bench = ppo3()
    assert "start it first" in bench.misuse("reached")


def test_d13_d15_a_trip_drops_the_goal_and_is_named_through_the_selector(bench: PluginBench) -> None:
    # fault: bits 12-14 ask for the fault word, the goal is gone
    assert bench.see("02 08 00 00") == "60 00 00 00"
    assert bench.core.status().faults == ("not yet named",)
    assert bench.see("62 08 21 00") == "00 00 00 00"
    assert bench.core.status().faults == ("F2100 fieldbus toggle bit OFF",)
    bench.run(2)
    assert any("F2100" in text and "until the next start" in text for text in bench.notices())
    token = bench.order("start")
    bench.see("02 08 00 00", 200)
    text = bench.text(token, "fault")
    assert "F2100" in text
    assert "acknowledge" in text


def test_d9_acknowledge_is_repeated_edges_of_bit_7() -> None:
    bench = ppo3("62 08 20 62")
    token = bench.order("acknowledge")
    words: list[str] = []
    for _ in range(200):
        word = bench.out()[:5]
        if not words or words[-1] != word:
            words.append(word)
    assert words[:4] == ["00 80", "00 00", "00 80", "00 00"]
    assert bench.value(token, "02 40 00 00", 200) == "switch_on_inhibited"
    assert bench.out() == "00 00 00 00"


def test_d9_a_fault_that_stays_is_an_error_that_says_why() -> None:
    bench = ppo3("62 08 20 62")
    token = bench.order_and_run(800, "acknowledge", timeout_s=1)
    text = bench.text(token)
    assert "F2062 Profibus OFF, the DP master failed" in text
    assert "15 s" in text


def test_d13_d21_a_warning_is_fetched_and_the_frequency_kept(bench: PluginBench) -> None:
    bench.see("06 27 20 00")
    assert bench.see("86 A7 20 00") == "50 0F 00 00"
    assert bench.see("D6 A7 00 80") == "00 0F 00 00"
    status = bench.core.status()
    assert status.warnings == ("motor temperature",)
    assert status.speed == 0.5
    bench.see("06 27 20 00")
    assert bench.core.status().warnings == ()


def test_d18_ppo3_start_without_remote_says_412() -> None:
    bench = ppo3("00 23 00 00")
    token = bench.order_and_run(200, "start")
    text = bench.text(token, "fault")
    for part in ("PPO3 has no parameter channel", "412", "44", "S1 and one of S2 and S3"):
        assert part in text
    assert bench.out() == "00 00 00 00"


def test_d18_ppo1_start_reads_412_and_tells() -> None:
    bench = ppo1(ZERO + "00 23 00 00")
    token = bench.order_and_run(60, "start")
    assert bench.out() == "10 F9 00 00 00 00 00 00 00 00 00 00"  # 249, the active data set
    assert bench.see("10 F9 00 00 00 00 00 02 00 23 00 00", 2) == "00 00 00 00 00 00 00 00 00 00 00 00"
    assert bench.see(ZERO + "00 23 00 00", 2) == "61 9C 02 00 00 00 00 00 00 00 00 00"  # 412 in data set 2
    bench.see("41 9C 02 00 00 00 00 2C 00 23 00 00", 2)
    assert bench.text(token, "fault").startswith(
        "412 is 44: control not by the bus; write 412 = 1 in the active data set (2)"
    )


def test_set_412_writes_ram_and_goes_on() -> None:
    bench = ppo1(ZERO + "00 23 00 00", set_412=True)
    token = bench.order_and_run(60, "start")
    bench.see("10 F9 00 00 00 00 00 01 00 23 00 00", 2)
    bench.see(ZERO + "00 23 00 00", 2)
    bench.see("41 9C 01 00 00 00 00 2C 00 23 00 00", 2)
    assert bench.see(ZERO + "00 23 00 00", 2) == "71 9C 06 00 00 00 00 01 00 00 00 00"  # data set 1 + 5
    bench.see("41 9C 06 00 00 00 00 01 00 23 00 00", 2)
    assert bench.see(ZERO + "02 40 00 00", 2).endswith("00 06 00 00")
    for word in ("02 21", "02 23", "02 27"):
        bench.see(ZERO + word + " 00 00", 60)
    assert bench.value(token) == "running"
    assert any("412 was 44" in text for text in bench.notices())


def test_412_is_1_but_no_release() -> None:
    bench = ppo1(ZERO + "00 40 00 00")
    token = bench.order_and_run(60, "start")
    bench.see("10 F9 00 00 00 00 00 01 00 40 00 00", 2)
    bench.see(ZERO + "00 40 00 00", 2)
    bench.see("41 9C 01 00 00 00 00 01 00 40 00 00", 2)
    bench.see(ZERO + "00 40 00 00", 60)
    assert "no hardware release" in bench.text(token)


def test_lost_ends_what_is_pending_and_forgets_the_goal(bench: PluginBench) -> None:
    reading = ppo1()
    token = bench.order("reached")
    bench.core.lost(bench.now)
    bench.events += bench.core.take_events()
    assert bench.done(token)["error"] == "lost"
    assert bench.core.status().state is State.OFFLINE
    # taken up again: the first call has no inputs, those of before are not ours any more
    bench.inputs = b""
    assert bench.out() == "00 00 00 00"
    assert bench.core.status().state is State.OFFLINE
    assert bench.see("02 40 00 00", 3) == "00 00 00 00"
    assert bench.core.status().state is State.SWITCH_ON_INHIBITED

    token = reading.order("read", number=400)
    reading.run(3)
    reading.core.lost(reading.now)
    reading.events += reading.core.take_events()
    assert reading.done(token)["error"] == "lost"
    assert reading.out() == ZERO + "00 00 00 00"


def test_an_order_before_data_exchange_waits_for_it() -> None:
    core = DRIVE.core("hoist", "PPO3")
    core.command("start", {"timeout_s": 1}, 7, 5 * S)
    core.command("read", {"number": 400}, 8, 5 * S)
    events = core.take_events()
    assert [event["token"] for event in events] == [8]
    now = 5 * S
    for _ in range(3):
        now += MS
        out = core.cyclic(bytes.fromhex("02400000"), now)
    assert out.hex() == "00060000"


def test_an_order_for_a_drive_that_never_comes_ends_with_lost() -> None:
    core = DRIVE.core("hoist", "PPO3")
    core.command("start", {"timeout_s": 0}, 7, 5 * S)
    assert as_mapping(core.take_events()[0])["error"] == "lost"


def test_a_new_motion_order_supersedes_the_last_one() -> None:
    bench = ppo3()
    start = bench.order("start")
    bench.order("coast")
    assert "superseded by coast" in bench.text(start, "usage")
    assert bench.out() == "00 00 00 00"


def test_a_start_that_fails_leaves_no_command_behind() -> None:
    bench = ppo3()
    token = bench.order("start", timeout_s=0.1)
    bench.see("02 21 00 00", 100)
    assert "ready_to_switch_on" in bench.text(token, "timeout")
    assert bench.out() == "00 00 00 00"


def test_inputs_of_a_wrong_length_are_not_looked_at(bench: PluginBench) -> None:
    assert bench.see("08") == "00 0F 00 00"
    assert bench.core.status().state is State.RUNNING


def test_status_events_only_on_changes(bench: PluginBench) -> None:
    bench.events.clear()
    for value in range(0x1000, 0x1040):
        bench.see(f"02 27 {value:04X}")
    assert bench.events == []
    bench.see("06 27 20 00")
    assert [event["type"] for event in bench.events] == ["status"]
    assert as_mapping(bench.events[0])["reached"] is True


def test_d2_d13_d15_wide_telegrams_carry_everything() -> None:
    bench = PluginBench(DRIVE.core("hoist", "PPO4"), "86 A7 20 00 11 47 0C CC 08 00 00 00")
    status = bench.core.status()
    assert status.speed == 0.5
    assert round(status.current or 0, 2) == 0.27
    assert round(status.torque or 0, 2) == 0.2
    assert status.warnings == ("analog input MFI1A",)
    assert bench.out() == "00 00 00 00 00 00 00 00 00 00 00 00"
    bench.see("02 08 00 00 00 00 00 00 00 00 20 65")
    assert bench.core.status().fault == "F2065 Profibus configuration fault"
