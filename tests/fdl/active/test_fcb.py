"""FCB and FCV by the letter, against literal FC octets."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.fdl.active.fcb import FrameCount

SRD_HIGH = 0x4D


def fc(count: FrameCount, address: int = 3) -> int:
    return SRD_HIGH | count.bits[address]


@pytest.mark.parametrize(
    ("steps", "fcs"),
    [
        (["answered"] * 4, [0x6D, 0x5D, 0x7D, 0x5D, 0x7D]),
        (["answered", "given_up"], [0x6D, 0x5D, 0x6D]),
        (["answered", "answered", "restart"], [0x6D, 0x5D, 0x7D, 0x6D]),
        (["given_up"] * 11, [0x6D, 0x6D, 0x6D, 0x5D, 0x6D, 0x6D, 0x6D, 0x7D, 0x6D, 0x6D, 0x6D, 0x5D]),
        (["restart", "given_up"] * 3 + ["restart"], [0x6D] * 6 + [0x5D, 0x5D]),
    ],
    ids=[
        "FCB toggles after the first request",
        "a station given up begins anew",
        "a restarted station begins anew",
        "three silent requests, then one probe",
        "a restart does not hinder the probe",
    ],
)
def test_fc_of_the_next_request(steps: list[str], fcs: list[int]) -> None:
    count = FrameCount()
    seen = [fc(count)]
    for step in steps:
        getattr(count, step)(3)
        seen.append(fc(count))
    assert seen == fcs


def test_stations_are_counted_apart() -> None:
    count = FrameCount()
    count.answered(3)
    assert count.operational[3]
    assert not count.operational[4]
    assert fc(count, 3) == 0x5D
    assert fc(count, 4) == 0x6D
    count.given_up(3)
    assert not count.operational[3]


def test_a_station_found_by_the_probe_is_named_once_and_probed_first_later() -> None:
    count = FrameCount()
    for _ in range(3):
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
