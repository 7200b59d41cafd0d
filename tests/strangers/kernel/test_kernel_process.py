"""The bus process over the kernel's own driver, in real time with two processors."""

from __future__ import annotations

import pytest
from vm_machine import boot

pytestmark = [pytest.mark.strangers, pytest.mark.kernel]


def test_a_run_in_its_bus_process() -> None:
    (row,) = boot("job_process", icount=False).of("process")
    assert row["driver"] == "process"
    assert row["states"] == dict.fromkeys(("8", "9", "10"), "data_exchange"), row["text"]
    assert min(row["exchanges"].values()) > 3
