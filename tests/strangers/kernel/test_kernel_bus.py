"""Runs, scan, baud and monitor over the kernel's own drivers; the cost of an adapter's latency."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from vm_machine import ROOT, Result, boot

pytestmark = [pytest.mark.strangers, pytest.mark.kernel]

CHIPS = ("ft232h", "cp2102n", "ch340", "pl2303hx", "cdcacm")


@pytest.fixture(scope="module")
def result() -> Result:
    return boot(f"job_bus {' '.join(CHIPS)}")


@pytest.fixture
def runs(result: Result) -> dict[str, dict[str, Any]]:
    return {f"{row['name']} {row['chip']}": row for row in result.of("run")}


def test_every_adapter_carries_a_bus_without_a_repetition(runs: dict[str, dict[str, Any]]) -> None:
    assert {row["chip"] for row in runs.values()} >= {"ft232r", *CHIPS}
    for row in runs.values():
        assert (row["code"], row["retries"], row["timeouts"]) == (0, 0, 0), row
        assert min(row["exchanges"].values()) > 5


def test_the_latency_timer_costs_its_time(runs: dict[str, dict[str, Any]]) -> None:
    quick, slow = runs["1 ms ft232r"]["host_us"]["p50"], runs["16 ms ft232r"]["host_us"]["p50"]
    assert quick < 2_000 < 10_000 < slow < 17_000
    assert runs["16 ms, event character ft232r"]["host_us"]["p50"] < 2_000
    assert runs["1 ms ft232r"]["latency_ms"][-2:] == [1, 16]  # set, and restored


def test_the_page_about_usb_has_these_figures(runs: dict[str, dict[str, Any]]) -> None:
    """Beside the simulated adapter of ``bench usb``: docs/explanation/usb.md."""
    page = (ROOT / "docs/explanation/usb.md").read_text(encoding="utf-8")
    block = page.partition("<!-- table: usb -->")[2].partition("\n\n")[0]
    told = {row[1]: float(row[2]) for row in re.finditer(r"^\| (\d+ ms).*\| ([\d.]+) ms \|$", block, re.MULTILINE)}
    measured = {name: runs[f"{name} ft232r"]["host_us"]["p50"] / 1000 for name in ("16 ms", "1 ms")}
    assert told == pytest.approx(measured, rel=0.2)


def test_long_telegrams(runs: dict[str, dict[str, Any]]) -> None:
    for chip in ("ft232r", "cp2102n"):
        assert len(bytes.fromhex(runs[f"long {chip}"]["inputs"]["8"])) == 192


def test_scan_baud_and_monitor(result: Result) -> None:
    (scan,) = result.of("scan")
    found = json.loads(scan["text"].splitlines()[-1])
    assert [one["address"] for one in found["stations"]] == [8, 9, 10]
    (baud,) = result.of("baud")
    assert json.loads(baud["text"].splitlines()[-1])["baud"] == 187_500
    (monitor,) = result.of("monitor")
    assert json.loads(monitor["text"].splitlines()[-1])["baud"] == 187_500
