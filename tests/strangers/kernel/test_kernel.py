"""The kernel's own serial drivers: each job is one boot of the machine, and its rows are read here."""

from __future__ import annotations

import functools
import json
import re
from itertools import pairwise
from typing import Any

import pytest
from vm_machine import ROOT, boot

from dpstack.ports.kernel_drivers import kernel_driver

pytestmark = [pytest.mark.strangers, pytest.mark.kernel]
#: the rows of a boot are read by several tests
booted = functools.cache(boot)


def row_of(job: str, kind: str) -> dict[str, Any]:
    """The only row of this kind."""
    (row,) = booted(job).of(kind)
    return row


# --- Runs, scan, baud and monitor; the cost of an adapter's latency ---

BUS_CHIPS = ("ft232h", "cp2102n", "ch340", "pl2303hx", "cdcacm")
BUS = f"job_bus {' '.join(BUS_CHIPS)}"


@pytest.fixture
def runs() -> dict[str, dict[str, Any]]:
    return {f"{row['name']} {row['chip']}": row for row in booted(BUS).of("run")}


def test_every_adapter_carries_a_bus_without_a_repetition(runs: dict[str, dict[str, Any]]) -> None:
    assert {row["chip"] for row in runs.values()} >= {"ft232r", *BUS_CHIPS}
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


def test_scan_baud_and_monitor() -> None:
    scan = row_of(BUS, "scan")
    found = json.loads(scan["text"].splitlines()[-1])
    assert [one["address"] for one in found["stations"]] == [8, 9, 10]
    baud = row_of(BUS, "baud")
    assert json.loads(baud["text"].splitlines()[-1])["baud"] == 187_500
    monitor = row_of(BUS, "monitor")
    assert json.loads(monitor["text"].splitlines()[-1])["baud"] == 187_500


# --- A pulled plug, other programs at the port of a run, a port that others hold ---


def test_a_pulled_plug_is_called_so_and_the_adapter_is_found_under_its_new_name() -> None:
    row = row_of("job_life", "unplugged")
    assert row["after"] != row["before"]
    assert "vanished (the adapter is gone: its plug was pulled, or it lost its power)" in row["text"]
    assert "hung up" not in row["text"]
    assert row["text"].count("slave 8 (a): data_exchange") == 2


def test_settings_of_another_program_are_set_again_and_reported() -> None:
    row = row_of("job_life", "stty")
    assert row["stty"] == 0
    assert row["rates"] == [9600.0, 187_500.0]
    assert "another program has set it to 9.6 kbit/s, another frame than 8E1; it is set to 187.5 kbit/s" in row["text"]
    assert row["code"] == 0
    assert row["text"].count("): data_exchange") > 3  # those that were lost are back


def test_a_second_reader_is_kept_out_or_named() -> None:
    row = row_of("job_life", "reader")
    assert "busy" in row["user"]  # one of a user: TIOCEXCL
    assert "cat (pid" in row["text"]
    assert "has it open, too, and takes octets away: end that program" in row["text"]
    assert row["text"].count("1. another_program (88 %)") == 3  # the summary tells why, for each slave
    assert "raise t_sl" not in row["text"]
    assert "takes octets away from `dpstack run " in row["doctor"]


def test_a_holder_that_opens_adapters_by_itself_is_named_with_its_udev_line() -> None:
    row = row_of("job_life", "held")
    assert "is held by ModemManager (pid" in row["doctor"]
    assert 'ATTRS{idVendor}=="0403", ATTRS{idProduct}=="6001", ENV{ID_MM_PORT_IGNORE}="1"' in row["doctor"]
    assert "dpstack ctl" not in row["doctor"]


def test_space_parity_of_another_program_is_made_even_again() -> None:
    row = row_of("job_life", "parity")
    assert (row["left"], row["taken"], row["error"]) == ("S", "E", None)


# --- RTS and DTR: a converter that RTS switches must not drive the bus when nobody runs it ---

LINE_CHIPS = ("ft232r", "cp2102n", "ch340", "pl2303hx", "cdcacm")
LINES = f"job_lines {' '.join(LINE_CHIPS)}"


UP, DOWN = {"dtr": 1, "rts": 1}, {"dtr": 0, "rts": 0}


def test_both_are_down_after_the_end_and_after_a_kill() -> None:
    rows = {row["chip"]: row for row in booted(LINES).of("lines")}
    assert {chip: row["opened"] for chip, row in rows.items()} == dict.fromkeys(LINE_CHIPS, UP)
    assert {chip: row["closed"] for chip, row in rows.items()} == dict.fromkeys(LINE_CHIPS, DOWN)
    assert {chip: row["killed"] for chip, row in rows.items()} == dict.fromkeys(LINE_CHIPS, DOWN)
    assert row_of(LINES, "killed_run")["lines"] == DOWN


def test_capture_sends_nothing_and_drops_rts_at_once() -> None:
    for row in booted(LINES).of("lines"):
        assert (row["capture_code"], row["capture_sent"]) == (0, 0)
        rts = [change["rts"] for change in row["capture"] if "rts" in change]
        assert rts[-1] == 0
        assert sum(before == 0 and after == 1 for before, after in pairwise(rts)) <= 1


# --- ``dpstack doctor --measure``: turn-around, rates made, marks of damaged octets ---


def test_an_echo_shows_turn_around_and_the_rate_that_is_made() -> None:
    row = row_of("job_measure", "echo")
    found = row["found"]
    assert (found["driver"], found["loop"], found["latency_ms"]) == ("ftdi_sio", "echo", 1)
    (rate,) = found["rates"]
    assert rate["lost"] == 0
    # 21 octets at 187.5 kbit/s take 1.23 ms, and the latency timer up to 1 ms more
    assert 1_230 < rate["turn_around_us"]["p50"] < 3_500
    assert abs(rate["octets_per_s"] / rate["wanted_octets_per_s"] - 1) < 0.03


def test_nothing_is_sent_unasked() -> None:
    row = row_of("job_measure", "unasked")
    code, text = row["refused"]
    assert code == 2
    assert "say so with --yes" in text
    code, text = row["passive"]
    assert code == 0
    found = json.loads(text.splitlines()[-1])
    assert [one["baud"] for one in found["rates"]][-1] == 3_000_000
    assert row["sent"] == 0


def test_a_second_port_shows_which_damage_is_dropped() -> None:
    """Also of a counterfeit CP2102, whose driver and number are those of a genuine one."""
    marks = {row["chip"]: row["found"]["marks"] for row in booted("job_measure").of("second")}
    assert {chip: one["sent"] for chip, one in marks.items()} == dict.fromkeys(marks, 21)
    passed = {chip: one["passed_as_good"] for chip, one in marks.items()}
    assert passed == {"ft232r": 0, "cp2102n": 0, "cp2102clone": 21, "ch340": 21}
    assert all(row["found"]["rates"][0]["lost"] == 0 for row in booted("job_measure").of("second"))


# --- The residual error of a noisy line with a seed, by class of driver: measured beside the formula of the docs ---

PER_BIT, SEED, COUNT = 0.01, 7, 1_000


FULL = {"ft232r": "ftdi_sio", "cp2102n": "cp210x"}


WEAK = {"ch340": "ch341-uart", "pl2303hx": "pl2303", "cdcacm": "cdc_acm"}


#: pairs of inverted bits in an answer with twelve octets that keep its sum (tests/fdl/test_residual_errors.py)
PATTERNS, BITS = 540, 21 * 9
NOISE = f"job_noise {PER_BIT} {SEED} {COUNT} {' '.join({**FULL, **WEAK})}"


def test_wrong_answers_pass_as_often_as_the_class_says() -> None:
    rows = {row["chip"]: row for row in booted(NOISE).of("noise")}
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


# --- The bus process, in real time with two processors ---


def test_a_run_in_its_bus_process() -> None:
    (row,) = boot("job_process", icount=False).of("process")
    assert row["driver"] == "process"
    assert row["states"] == dict.fromkeys(("8", "9", "10"), "data_exchange"), row["text"]
    assert min(row["exchanges"].values()) > 3


# --- ``dpstack doctor`` and its set-up with udev, for a member of dialout ---


def test_a_latency_timer_that_the_low_latency_mode_sets_is_no_finding() -> None:
    """TIOCSSERIAL gives 1 ms to a user who may not write to the file of the timer."""
    row = row_of("job_setup", "before")
    assert (row["latency_ms"], row["mode"], row["group"]) == (16, "0o644", 0)
    assert row["latency"] == ["its latency timer is 16 ms; dpstack sets it to 1 ms while it runs"]
    assert row["findings"] == []


def test_the_set_up_reaches_an_adapter_that_is_plugged_in() -> None:
    row = row_of("job_setup", "after_fix")
    assert row["code"] == 0
    assert (row["latency_ms"], row["mode"], row["group"]) == (1, "0o664", 20)
    assert "plug the adapter in again" not in row["text"]


def test_the_rule_is_for_adapters_that_appear_later() -> None:
    row = row_of("job_setup", "plugged_in")
    assert (row["latency_ms"], row["mode"], row["group"]) == (1, "0o664", 20)
    assert row["findings"] == []
