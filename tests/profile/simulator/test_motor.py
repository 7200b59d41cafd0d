"""The simulated motor: exact on its grid, whoever looks."""

from __future__ import annotations

import pytest
from drive_bench import MS, S
from hypothesis import given
from hypothesis import strategies as st

from dpstack.profile import Motor


def started(**more: float) -> Motor:
    motor = Motor(**more)
    motor.advance(0)
    motor.switch(True)
    motor.setpoint = 1.0
    return motor


def limited(motor: Motor) -> bool:
    return motor.limited


@given(st.lists(st.integers(1, 400 * MS), min_size=1, max_size=30))
def test_results_do_not_depend_on_how_often_it_is_asked(pauses: list[int]) -> None:
    often, once = started(), started()
    now = 0
    for pause in pauses:
        now += pause
        often.advance(now)
    once.advance(now)
    assert often.frequency == once.frequency
    assert often.speed == pytest.approx(once.speed, abs=1e-7)
    assert often.torque == pytest.approx(once.torque, abs=1e-6)


def test_ramp_takes_its_time_and_the_speed_follows_with_slip() -> None:
    motor = started(accel=2.0, load=0.5, slip=0.04)
    motor.advance(250 * MS)
    assert motor.frequency == pytest.approx(0.5)
    motor.advance(500 * MS)
    assert motor.frequency == pytest.approx(1.0)
    motor.advance(2 * S)
    assert motor.speed == pytest.approx(1 - 0.04 * 0.5)
    assert motor.torque == pytest.approx(0.5)
    assert motor.current == pytest.approx((0.5**2 + 0.4**2) ** 0.5)


def test_current_rises_while_accelerating() -> None:
    motor = started(load=0.2, inertia=0.5)
    motor.advance(500 * MS)
    assert motor.torque == pytest.approx(0.2 + 0.5, abs=0.02)


def test_the_limit_holds_the_ramp_back() -> None:
    motor = started(accel=10, load=0.2, inertia=1.0, limit=1.2)
    motor.advance(200 * MS)
    assert limited(motor)
    assert motor.frequency < 0.5
    motor.advance(5 * S)
    assert not limited(motor)
    assert motor.frequency == 1.0


def test_through_zero_the_other_ramp_takes_over() -> None:
    motor = started(accel=1.0, decel=2.0)
    motor.advance(2 * S)
    motor.setpoint = -0.5
    motor.advance(2 * S + 500 * MS)
    assert motor.frequency == pytest.approx(0.0, abs=1e-9)
    motor.advance(2 * S + 750 * MS)
    assert motor.frequency == pytest.approx(-0.25)


def test_coasting_comes_to_rest_and_stays() -> None:
    motor = started()
    motor.advance(3 * S)
    motor.switch(False)
    motor.advance(3 * S + 50 * MS)
    assert 0 < motor.speed < 1
    assert motor.current == motor.frequency == motor.torque == 0
    motor.advance(60 * S)
    assert motor.speed == 0


def test_switched_on_while_turning_it_starts_near_the_speed() -> None:
    motor = started()
    motor.advance(3 * S)
    motor.switch(False)
    motor.advance(3 * S + 10 * MS)
    turning = motor.speed
    motor.switch(True)
    motor.advance(3 * S + 12 * MS)
    assert abs(motor.frequency - turning) < 0.1
