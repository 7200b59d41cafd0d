"""KEB's plugin against literal octets: words and bits that the user names
(docs/reference/drives/keb-f5.md#default-map), orders that cannot be without them."""

from __future__ import annotations

from typing import Any

import pytest
from drive_bench import ALONE, PluginBench

from dpstack.profile import State
from dpstack_drives.keb import DRIVE
from tests.drives import keb_kit

#: bits of nobody's manual: what a user might have found in his
BITS = {
    "control_bits": "enable=1 run=4 reset=7 reverse=9 quick_stop=12",
    "status_bits": "fault=3, run=5 reached=6 brake_open=11",
    "rpm_per_count": 0.5,
    "reference_rpm": 3000,
}


def plugin(inputs: str = "00 00 00 00", telegram: str = "4/4", **options: Any) -> PluginBench:
    return keb_kit.plugin(inputs, telegram, **{**BITS, **options})


@pytest.mark.parametrize(
    ("inputs", "state"),
    [("00 00 00 00", State.NOT_READY), ("00 10 00 00", State.READY), ("00 20 00 00", State.STOPPING)],
)
def test_a_ready_bit_of_the_user_tells_ready_from_not_ready(inputs: str, state: State) -> None:
    bench = plugin(inputs, status_bits="fault=3 run=5 ready=4")
    assert bench.core.status().state is state


def test_k8_the_words_by_the_users_bits() -> None:
    bench = plugin()
    assert bench.out() == "00 00 00 00"
    bench.order("speed", value=0.25)  # 750 rpm, 0.5 rpm a count: 1500
    start = bench.order("start")
    assert bench.out() == "00 12 05 DC"
    assert bench.result(start) is None
    bench.see("00 20 00 64", 60)
    assert bench.done(start)["ok"]
    status = bench.core.status()
    assert (status.state, status.running, status.reached) == (State.RUNNING, True, False)
    assert status.speed == pytest.approx(100 * 0.5 / 3000)
    bench.see("08 60 05 DC")
    status = bench.core.status()
    assert status.reached
    assert status.bits == ("run", "reached", "brake_open")
    assert status.frequency_hz == pytest.approx(12.5)
    assert status.words == (0x0860, 0x05DC)
    assert status.remote is None, "no bit of the F5 tells it"
    assert bench.out_after("stop") == "00 02 05 DC"
    assert bench.core.status().state is State.STOPPING
    bench.see("00 00 00 00", 60)
    assert bench.core.status().state is State.READY
    bench.order("start")
    bench.see("00 20 00 00", 60)
    assert bench.out_after("quick_stop") == "10 02 05 DC"
    assert bench.out_after("coast") == "00 00 05 DC"


def test_k8_reverse_by_its_bit_or_by_the_sign() -> None:
    bench = plugin("00 20 00 00")
    bench.order("speed", value=-0.25)
    assert bench.out_after("start") == "02 12 05 DC"
    bench = plugin("00 20 00 00", direction="sign")
    bench.order("speed", value=-0.25)
    assert bench.out_after("start") == "00 12 FA 24"


def test_k8_a_fault_and_its_edge() -> None:
    bench = plugin("00 08 00 00", "PCH+4/4")  # wrong length: not valid
    bench.see("00 " * 8 + "00 08 00 00")
    assert bench.core.status().state is State.FAULT
    assert bench.out() == "71 01 22 00 00 00 00 00 00 00 00 00"  # it asks ru.00
    bench.see("41 01 22 00 00 00 00 1F 00 08 00 00")
    assert bench.core.status().faults == ("inverter state ru.00 = 31",)
    token = bench.order("acknowledge")
    assert bench.out()[24:] == "00 80 00 00"
    bench.see("41 01 22 00 00 00 00 1F 00 00 00 00", 100)
    assert bench.done(token)["ok"]


def test_k8_a_fault_whose_number_was_lost_is_asked_again() -> None:
    bench = plugin("00 " * 8 + "00 08 00 00", "PCH+4/4")
    assert bench.out()[:23] == "71 01 22 00 00 00 00 00"
    bench.core.lost(bench.now)
    assert bench.see("00 " * 8 + "00 08 00 01", 3)[:23] == "71 01 22 00 00 00 00 00"
    bench.see("41 01 22 00 00 00 00 1F 00 08 00 01", 2)
    assert bench.core.status().faults == ("inverter state ru.00 = 31",)


def test_without_a_channel_the_fault_has_no_name() -> None:
    bench = plugin("00 08 00 00")
    assert bench.core.status().faults == ("without a name: only the parameter channel (PCH+...) gives ru.00",)


@pytest.mark.parametrize(
    ("options", "op", "says"),
    [
        ({"control_bits": ""}, "start", "start needs the bit 'run': the bits of sy.50 and sy.51 are not in the manual"),
        ({"control_bits": ""}, "stop", "option control_bits, e.g. control_bits = 'run=<bit> ...'"),
        ({"status_bits": ""}, "start", "start needs the bit 'run'"),
        ({"status_bits": "run=5"}, "acknowledge", "acknowledge needs the bit 'fault'"),
        ({"control_bits": "run=4"}, "quick_stop", "quick_stop needs the bit 'quick_stop'"),
        ({"control_bits": "run=4"}, "coast", "coast needs the bit 'enable'"),
        ({"control_bits": "run=4"}, "acknowledge", "acknowledge needs the bit 'reset'"),
        ({"map_outputs": "2034"}, "start", "sy.50 (2032h, control word) is not in the output map"),
        ({"map_inputs": "2035"}, "start", "sy.51 (2033h, status word) is not in the input map"),
    ],
)
def test_k8_what_cannot_be_done_is_said_by_name_and_at_once(options: dict[str, Any], op: str, says: str) -> None:
    bench = plugin(**options)
    assert says in bench.misuse(op)
    assert bench.out() == "00 00 00 00"


@pytest.mark.parametrize(
    ("options", "value", "says"),
    [
        ({"rpm_per_count": 0}, 0.5, "the unit of sy.52 is not in the manual: give the option rpm_per_count"),
        ({"control_bits": "run=4"}, -0.5, "a negative speed needs the bit 'reverse'"),
        ({"map_outputs": "2032"}, 0.5, "sy.52 (2034h, set speed) is not in the output map"),
        ({}, 6.0, "speed 6 is outside"),
    ],
)
def test_k8_set_points_that_cannot_be(options: dict[str, Any], value: float, says: str) -> None:
    bench = plugin(**options)
    assert says in bench.misuse("speed", value=value)


def test_a_real_drive_gets_no_bits_that_are_made_up() -> None:
    """Without options nothing can be started; for the simulated drive its own bits are known."""
    bench = PluginBench(DRIVE.core("hoist", options=ALONE), "00 " * 12)
    assert "not in the manual" in bench.misuse("start")
    bench = PluginBench(DRIVE.core("hoist", options=ALONE, simulated=True), "00 " * 12)
    assert bench.out_after("start")[24:] == "00 05 00 00"
    bench = PluginBench(DRIVE.core("hoist", options={**ALONE, "control_bits": "run=9"}, simulated=True), "00 " * 12)
    assert bench.out_after("start")[24:] == "02 00 00 00"


def test_k8_the_words_as_they_stand_where_nothing_is_named() -> None:
    """Words exposed: the user's program makes them; they do not come back by themselves."""
    bench = PluginBench(DRIVE.core("hoist", "4/4"), "12 34 56 78")
    assert bench.core.status().words == (0x1234, 0x5678)
    assert bench.core.status().state is State.UNKNOWN
    bench.order("output", number="sy.50", value=0xABCD)
    assert bench.out_after("output", number="sy.52", value=-2) == "AB CD FF FE"
    bench.core.lost(bench.now)
    assert bench.out() == "00 00 00 00"
    named = plugin()
    assert "is written by start" in named.misuse("output", number="sy.50", value=1)


def test_a_start_that_does_not_come_true_shows_the_recipe() -> None:
    bench = plugin()
    token = bench.order_and_run(150, "start", timeout_s=0.2)
    assert "the drive reports ready, not running; does it obey the control word? ud.01 = 440" in bench.text(token)
    assert bench.out() == "00 00 00 00"


def test_reached_by_the_speed_where_no_bit_is_named() -> None:
    bench = plugin("00 20 00 00", status_bits="run=5 fault=3")
    bench.order("speed", value=0.25)
    bench.order_and_run(60, "start")
    token = bench.order("reached")
    bench.see("00 20 05 78", 60)
    assert bench.result(token) is None
    assert not bench.core.status().reached
    bench.see("00 20 05 B0", 2)
    assert bench.result(token) is not None
    assert bench.core.status().reached
    blind = plugin("00 20 00 00", status_bits="run=5 fault=3", rpm_per_count=0)
    assert "does not report its speed" in blind.misuse("reached")


@pytest.mark.parametrize(("telegram", "out"), [("1/4", "00"), ("3/4", "00 12 00"), ("8/4", "00 12 05 DC 00 00 00 00")])
def test_k2_odd_lengths(telegram: str, out: str) -> None:
    """The default map is cut to what the telegram takes."""
    bench = plugin("00 00 00 00", telegram)
    bench.order("speed", value=0.25)
    assert bench.out_after("start") == out


@pytest.mark.parametrize(("cycle", "early", "late"), [(25, 90, 100), (100, 310, 330)])
def test_k9_the_plugin_reckons_with_pd_in_cycle(cycle: int, early: int, late: int) -> None:
    """Inputs are read every PD_In_Cycle: a standstill shown before three of them may be an old one."""
    bench = plugin("00 00 00 00", pd_in_cycle_ms=cycle)
    token = bench.order_and_run(early // 2, "coast")
    assert bench.result(token) is None
    bench.run((late - early) // 2)
    assert bench.done(token)["ok"]


@pytest.mark.parametrize(
    ("number", "value", "request_octets"),
    [
        (0x5F27, 1, "72 00 5F 27 00 00 00 01"),  # Fb39, activation
        (0x5F28, 4, "72 00 5F 28 00 00 00 04"),  # Fb40, what keeps it alive
        (0x2009, 50, "72 01 20 09 00 00 00 32"),  # sy.09
    ],
)
def test_k10_the_plugin_sets_the_watchdog(number: int, value: int, request_octets: str) -> None:
    bench = plugin("00 " * 12, "PCH+4/4")
    assert bench.out_after("write", number=number, value=value)[:23] == request_octets


def test_unknown_orders_name_those_of_this_drive() -> None:
    bench = plugin()
    assert "read, write, read_map, write_map, inputs, output" in bench.misuse("dance")
