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


def test_a_motor_that_has_settled_does_the_same_as_one_that_integrates_each_step() -> None:
    # loads, set points and the power stage change while it is at rest to the last bit, and shortly before
    settling, integrating = started(setpoint=0.5), started(setpoint=0.5)
    changes: list[dict[str, float]] = [
        {},
        {"load": 0.7},
        {"setpoint": -0.3},
        {"load": 0.0},
        {"setpoint": 0.0},
        {"limit": 0.6},
    ]
    now, skipped = 0, 0
    for number, change in enumerate(changes * 3):
        for motor in (settling, integrating):
            for name, value in change.items():
                setattr(motor, name, value)
            if number == 9:
                motor.brake()
            elif number == 10:
                motor.switch(False)
            elif number == 12:
                motor.switch(True)
        for _ in range(400 + 700 * (number % 2)):
            now += 3 * MS
            integrating._settled = None
            skipped += settling._settled is not None
            settling.advance(now)
            integrating.advance(now)
            assert (settling.speed, settling.frequency, settling.torque, settling.limited) == (
                integrating.speed,
                integrating.frequency,
                integrating.torque,
                integrating.limited,
            )
    assert skipped > 1_000
