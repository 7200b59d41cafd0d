"""The kernel's own drivers: what `dpstack doctor` says equals what the chip was sent; damaged octets are no data."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from vm_machine import ROOT, Result, boot
from vm_table import STORED, made, marks_of, stored, table_of

from dpstack.ports.kernel_drivers import Marks, kernel_driver
from dpstack.units import BAUD_RATES, baud_text

pytestmark = pytest.mark.strangers

CHIPS = ("ft232r", "ft232h", "cp2102n", "cp2102", "cp2102clone", "ch340", "pl2303hx", "pl2303hxd", "pl2303ta", "cdcacm")
_BY_TEXT = {baud_text(rate): rate for rate in BAUD_RATES}


@pytest.fixture(scope="module")
def result() -> Result:
    return boot(f"job_doctor {' '.join(CHIPS)}", "job_damage ft232r ch340 cdcacm cdcacm@5 pl2303hx")


@pytest.fixture
def adapters(result: Result) -> dict[str, dict[str, Any]]:
    return {row["chip"]: row for row in result.of("adapter")}


def texts(row: dict[str, Any]) -> list[str]:
    return [check["text"] for check in row["doctor"]]


def taken(row: dict[str, Any]) -> set[int] | None:
    """The rates that the port takes, as doctor says; None where it says that nobody can know."""
    (text,) = [text for text in texts(row) if re.match(r"takes |accepts every rate", text)]
    if text == "takes every rate of PROFIBUS":
        return set(BAUD_RATES)
    if text.startswith("accepts every rate, and its driver cdc_acm does not say"):
        return None
    return {_BY_TEXT[name] for name in text.removeprefix("takes ").partition("; not ")[0].split(", ")}


def is_there(row: dict[str, Any], name: str) -> bool:
    return f"{name}: there" in texts(row)


def test_what_doctor_says_equals_what_the_chip_was_sent(adapters: dict[str, dict[str, Any]]) -> None:
    assert set(adapters) == {*CHIPS, "uart"}
    said = {
        chip: (
            taken(row),
            is_there(row, "low-latency mode"),
            is_there(row, "RS-485 mode"),
            is_there(row, "error counters"),
        )
        for chip, row in adapters.items()
    }
    true = {
        chip: (
            None if row["driver"] == "cdc_acm" else set(made(row)),
            row["low_latency"] is True,
            row["rs485"] == "set",
            row["counters"] is True,
        )
        for chip, row in adapters.items()
    }
    assert said == true


def test_a_port_opens_at_exactly_the_rates_that_its_chip_makes(adapters: dict[str, dict[str, Any]]) -> None:
    opens = {chip: {one["baud"] for one in row["rates"] if one["opens"]} for chip, row in adapters.items()}
    assert opens == {chip: set(made(row)) for chip, row in adapters.items()}
    refusals = [one["refusal"] for row in adapters.values() for one in row["rates"] if not one["opens"]]
    assert all("choose another rate or adapter" in refusal for refusal in refusals)
    at = {one["baud"]: one.get("refusal", "") for one in adapters["uart"]["rates"]}
    assert "makes 28.8 kbit/s of it" in at[31_250]
    assert "makes 115.2 kbit/s of it" in at[187_500]
    assert all(one["notices"] == [] for one in adapters["ft232r"]["rates"] if one["opens"])


def test_marks_are_of_the_class_that_dpstack_says(adapters: dict[str, dict[str, Any]]) -> None:
    usb = {chip: row for chip, row in adapters.items() if chip not in ("uart", "cp2102clone")}
    assert all(row["marks"]["clean"] == "100203ffff04ec05" for row in usb.values())
    assert {chip: row["listed"]["marks"] for chip, row in usb.items()} == {
        chip: marks_of(row["marks"]).value for chip, row in usb.items()
    }
    for row in usb.values():
        assert kernel_driver(row["driver"], usb=True).protection in texts(row)
    assert (
        marks_of(adapters["cp2102clone"]["marks"]) is Marks.NONE
    )  # the driver leaves its event mode off: hardware.md says so


def test_the_stored_table_is_that_of_this_run(result: Result) -> None:
    """The kernel may be a newer one: what it does must be the same."""
    table = table_of(result.linux, result.of("adapter"))
    new = ROOT / "build" / "kernel_table.json"
    new.parent.mkdir(exist_ok=True)
    new.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    print(f"Linux {result.linux}")
    assert table["chips"] == stored()["chips"], f"read {new}; if it is right copy it to {STORED}"


def test_damaged_octets_are_not_delivered_where_the_port_says_so(adapters: dict[str, dict[str, Any]]) -> None:
    delivered = {chip: row["port"]["delivered"] for chip, row in adapters.items() if chip != "uart"}
    assert delivered == {
        **dict.fromkeys(("ft232r", "ft232h", "pl2303hx", "pl2303hxd", "pl2303ta", "cdcacm"), ""),
        **dict.fromkeys(("cp2102n", "cp2102"), "681122"),
        **dict.fromkeys(("ch340", "cp2102clone"), "68112233"),
    }
    assert adapters["ft232r"]["port"]["says"] == "the port drops octets with a parity or framing error"
    assert "(Hamming distance 2)" in adapters["ch340"]["port"]["says"]


def test_a_driver_that_calls_its_queue_empty_too_early_is_known(adapters: dict[str, dict[str, Any]]) -> None:
    """tcdrain returns at once on these; dpstack asks no driver when the last octet has left."""
    early = {
        chip
        for chip, row in adapters.items()
        if chip != "uart" and row["drain"]["drained_ms"] < row["drain"]["left_ms"] - 5
    }
    assert early == {"ch340", "pl2303hx", "pl2303hxd", "pl2303ta", "cdcacm"}
    assert all(100 < row["drain"]["left_ms"] < 120 for chip, row in adapters.items() if chip != "uart")


def test_damage_that_only_parity_shows(result: Result) -> None:
    rows = {row["chip"]: row for row in result.of("damage")}
    assert all(row["damaged"] for row in rows.values())
    for chip in ("ft232r", "cdcacm", "pl2303hx"):  # dropped, and the slave is lost
        # it is taken up again and again: its state at the end is chance, and not the exit code, if it was lost twice
        exchanging = rows[chip]["slave"]["state"] == "data_exchange"
        flaps = "flaps: it is in data exchange at this moment" in rows[chip]["text"]
        assert rows[chip]["code"] == (0 if exchanging and not flaps else 1)
        assert rows[chip]["slave"]["inputs_valid"] is False
        # cdc_acm counts damage, now and then behind the octets: those that came so are not valid
        assert rows[chip]["slave"]["inputs"] == "00000000" or chip == "cdcacm"
        assert "offline" in rows[chip]["states"]
        # the cause is looked for at each fault and at the end; one that is healthy again by then has none
        assert (exchanging and not flaps) or "noise_on_stub" in rows[chip]["text"]
        assert "likely not_there" not in rows[chip]["text"]
    # nothing shows the damage to dpstack: it says beforehand that this can happen
    assert rows["ch340"]["slave"]["inputs"] == "00010000"
    assert any("two may pass as good data (Hamming distance 2)" in notice for notice in rows["ch340"]["notices"])
    # counted after the octets were delivered: the inputs are not valid
    assert "its inputs are not valid until its next exchange" in rows["cdcacm@5"]["text"]
