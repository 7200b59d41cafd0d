"""``dpstack doctor --measure`` with the kernel's own drivers: turn-around, rates made, marks of damaged octets."""

from __future__ import annotations

import json

import pytest
from vm_machine import Result, boot

pytestmark = [pytest.mark.strangers, pytest.mark.kernel]


@pytest.fixture(scope="module")
def result() -> Result:
    return boot("job_measure")


def test_an_echo_shows_turn_around_and_the_rate_that_is_made(result: Result) -> None:
    (row,) = result.of("echo")
    found = row["found"]
    assert (found["driver"], found["loop"], found["latency_ms"]) == ("ftdi_sio", "echo", 1)
    (rate,) = found["rates"]
    assert rate["lost"] == 0
    # 21 octets at 187.5 kbit/s take 1.23 ms, and the latency timer up to 1 ms more
    assert 1_230 < rate["turn_around_us"]["p50"] < 3_500
    assert abs(rate["octets_per_s"] / rate["wanted_octets_per_s"] - 1) < 0.03


def test_nothing_is_sent_unasked(result: Result) -> None:
    (row,) = result.of("unasked")
    code, text = row["refused"]
    assert code == 2
    assert "say so with --yes" in text
    code, text = row["passive"]
    assert code == 0
    found = json.loads(text.splitlines()[-1])
    assert [one["baud"] for one in found["rates"]][-1] == 3_000_000
    assert row["sent"] == 0


def test_a_second_port_shows_which_damage_is_dropped(result: Result) -> None:
    """Also of a counterfeit CP2102, whose driver and number are those of a genuine one."""
    marks = {row["chip"]: row["found"]["marks"] for row in result.of("second")}
    assert {chip: one["sent"] for chip, one in marks.items()} == dict.fromkeys(marks, 21)
    passed = {chip: one["passed_as_good"] for chip, one in marks.items()}
    assert passed == {"ft232r": 0, "cp2102n": 0, "cp2102clone": 21, "ch340": 21}
    assert all(row["found"]["rates"][0]["lost"] == 0 for row in result.of("second"))
