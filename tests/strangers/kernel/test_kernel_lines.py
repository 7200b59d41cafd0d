"""RTS and DTR by the kernel's own drivers: a converter that RTS switches must not drive the bus when nobody runs it."""

from __future__ import annotations

from itertools import pairwise

import pytest
from vm_machine import Result, boot

pytestmark = [pytest.mark.strangers, pytest.mark.kernel]

CHIPS = ("ft232r", "cp2102n", "ch340", "pl2303hx", "cdcacm")
UP, DOWN = {"dtr": 1, "rts": 1}, {"dtr": 0, "rts": 0}


@pytest.fixture(scope="module")
def result() -> Result:
    return boot(f"job_lines {' '.join(CHIPS)}")


def test_both_are_down_after_the_end_and_after_a_kill(result: Result) -> None:
    rows = {row["chip"]: row for row in result.of("lines")}
    assert {chip: row["opened"] for chip, row in rows.items()} == dict.fromkeys(CHIPS, UP)
    assert {chip: row["closed"] for chip, row in rows.items()} == dict.fromkeys(CHIPS, DOWN)
    assert {chip: row["killed"] for chip, row in rows.items()} == dict.fromkeys(CHIPS, DOWN)
    (killed,) = result.of("killed_run")
    assert killed["lines"] == DOWN


def test_capture_sends_nothing_and_drops_rts_at_once(result: Result) -> None:
    for row in result.of("lines"):
        assert (row["capture_code"], row["capture_sent"]) == (0, 0)
        rts = [change["rts"] for change in row["capture"] if "rts" in change]
        assert rts[-1] == 0
        assert sum(before == 0 and after == 1 for before, after in pairwise(rts)) <= 1
