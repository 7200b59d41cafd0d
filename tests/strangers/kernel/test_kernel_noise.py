"""The residual error of a noisy line with a seed, by class of driver: measured beside the formula of the docs."""

from __future__ import annotations

import pytest
from vm_machine import Result, boot

from dpstack.ports.kernel_drivers import kernel_driver

pytestmark = [pytest.mark.strangers, pytest.mark.kernel]

PER_BIT, SEED, COUNT = 0.01, 7, 1_000
FULL = {"ft232r": "ftdi_sio", "cp2102n": "cp210x"}
WEAK = {"ch340": "ch341-uart", "pl2303hx": "pl2303", "cdcacm": "cdc_acm"}
#: pairs of inverted bits in an answer with twelve octets that keep its sum (tests/fdl/test_residual_errors.py)
PATTERNS, BITS = 540, 21 * 9


@pytest.fixture(scope="module")
def result() -> Result:
    return boot(f"job_noise {PER_BIT} {SEED} {COUNT} {' '.join({**FULL, **WEAK})}")


def test_wrong_answers_pass_as_often_as_the_class_says(result: Result) -> None:
    rows = {row["chip"]: row for row in result.of("noise")}
    assert all(row["sent"] == COUNT and 700 < row["damaged"] < 950 for row in rows.values())  # 1 - 0.99^(21 x 11)
    for chip, driver in FULL.items():
        assert kernel_driver(driver, usb=True).distance == 4
        assert rows[chip]["wrong"] == 0
    # without parity: P^2 (1 - P)^(bits that must stay) for each pattern
    expected = COUNT * PATTERNS * PER_BIT**2 * (1 - PER_BIT) ** (BITS - 2 - 21)
    assert 0.3 * expected < rows["ch340"]["wrong"] < 2 * expected
    # marks and counts that come in time drop damaged answers
    assert rows["pl2303hx"]["wrong"] == 0
    assert rows["cdcacm"]["wrong"] == 0
