"""``dpstack doctor`` and its set-up with the kernel's drivers and udev, for a member of dialout."""

from __future__ import annotations

import pytest
from vm_machine import Result, boot

pytestmark = [pytest.mark.strangers, pytest.mark.kernel]


@pytest.fixture(scope="module")
def result() -> Result:
    return boot("job_setup")


def test_a_latency_timer_that_the_low_latency_mode_sets_is_no_finding(result: Result) -> None:
    """TIOCSSERIAL gives 1 ms to a user who may not write to the file of the timer."""
    (row,) = result.of("before")
    assert (row["latency_ms"], row["mode"], row["group"]) == (16, "0o644", 0)
    assert row["latency"] == ["its latency timer is 16 ms; dpstack sets it to 1 ms while it runs"]
    assert row["findings"] == []


def test_the_set_up_reaches_an_adapter_that_is_plugged_in(result: Result) -> None:
    (row,) = result.of("after_fix")
    assert row["code"] == 0
    assert (row["latency_ms"], row["mode"], row["group"]) == (1, "0o664", 20)
    assert "plug the adapter in again" not in row["text"]


def test_the_rule_is_for_adapters_that_appear_later(result: Result) -> None:
    (row,) = result.of("plugged_in")
    assert (row["latency_ms"], row["mode"], row["group"]) == (1, "0o664", 20)
    assert row["findings"] == []
