"""FCB and FCV by the letter, against literal FC octets."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from dpstack.fdl.active.fcb import FrameCount

SRD_HIGH = 0x4D


def fc(count: FrameCount, address: int = 3) -> int:
    return SRD_HIGH | count.bits[address]


def test_first_request_then_toggling() -> None:
    count = FrameCount()
    seen = []
    for _ in range(5):
        seen.append(fc(count))
        count.answered(3)
    assert seen == [0x6D, 0x5D, 0x7D, 0x5D, 0x7D]


def test_stations_are_counted_apart() -> None:
    count = FrameCount()
    count.answered(3)
    assert fc(count, 3) == 0x5D
    assert fc(count, 4) == 0x6D


def test_given_up_means_fresh() -> None:
    count = FrameCount()
    count.answered(3)
    count.given_up(3)
    assert not count.operational[3]
    assert fc(count) == 0x6D


def test_restart_means_fresh() -> None:
    count = FrameCount()
    count.answered(3)
    count.answered(3)
    count.restart(3)
    assert fc(count) == 0x6D


def test_three_silent_rounds_then_one_probe() -> None:
    count = FrameCount()
    seen = []
    for _ in range(12):
        seen.append(fc(count))
        count.given_up(3)
    assert seen == [0x6D, 0x6D, 0x6D, 0x5D, 0x6D, 0x6D, 0x6D, 0x7D, 0x6D, 0x6D, 0x6D, 0x5D]


def test_restart_does_not_hinder_the_probe() -> None:
    count = FrameCount()
    for _ in range(3):
        count.restart(3)
        count.given_up(3)
    count.restart(3)
    assert fc(count) == 0x5D


def test_a_station_found_by_the_probe_is_named_once_and_probed_first_later() -> None:
    count = FrameCount()
    for _ in range(3):
        assert count.answered is not None
        count.given_up(3)
    assert fc(count) == 0x5D
    assert count.answered(3) is True
    assert fc(count) == 0x7D
    assert count.answered(3) is False
    count.given_up(3)
    assert fc(count) in (0x5D, 0x7D)
    assert count.answered(3) is False
    assert count.fcv_only == {3}


def test_a_station_that_learned_the_standard_is_no_longer_named() -> None:
    count = FrameCount()
    for _ in range(3):
        count.given_up(3)
    count.answered(3)
    count.given_up(3)  # operational: the probe comes first
    count.given_up(3)  # the probe was silent
    assert fc(count) == 0x6D
    count.answered(3)
    assert count.fcv_only == set()


@given(st.lists(st.sampled_from(["answered", "given_up", "restart"])))
def test_fcb_toggles_between_answers_of_an_operational_station(steps: list[str]) -> None:
    count = FrameCount()
    last: int | None = None  # FCB of the last request answered, while operational
    for step in steps:
        bits = count.bits[3]
        assert bits in (0x20, 0x10, 0x30)
        if last is not None:
            assert bits & 0x10
            assert bits & 0x20 != last
        getattr(count, step)(3)
        last = bits & 0x20 if step == "answered" else None
        assert count.operational[3] is (last is not None)
