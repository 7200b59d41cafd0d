"""The table of docs/explanation/hardware.md: what the kernel's own drivers do with emulated chips, by the kit.

The kit compares its result with the stored table; tests/test_hardware_page.py holds the page to it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from dpstack.ports.kernel_drivers import Marks
from dpstack.units import BAUD_RATES, baud_text

STORED: Final = Path(__file__).resolve().parent / "table.json"
#: names for people, and in which order
CHIPS: Final = {
    "ft232r": "FT232R",
    "ft232h": "FT232H",
    "cp2102n": "CP2102N",
    "cp2102": "CP2102",
    "cp2102clone": "CP2102, counterfeit",
    "ch340": "CH340",
    "pl2303hx": "PL2303 HX",
    "pl2303hxd": "PL2303 HXD",
    "pl2303ta": "PL2303 TA",
    "cdcacm": "microcontroller (STM32)",
    "uart": "UART of a PC (16550A, 1.8432 MHz)",
}
#: a chip's rate counts as the wished one within this share, as receivers take it (docs/explanation/hardware.md)
CLOSE: Final = 0.02
_MARKS: Final = {
    Marks.OCTET: "marked, each at its place",
    Marks.PACKET: "marked, with their USB packet",
    Marks.MISPLACED: "marked, perhaps on the next packet",
    Marks.COUNTED: "counted only, perhaps late",
    Marks.NONE: "**not passed on**",
}


def marks_of(seen: Mapping[str, Any]) -> Marks:
    """The class of the marks that came: for 68 11 22 33 with an error in the last octet, and for a1 a2 after it."""
    if seen["after_late"] != "a1a2":
        return Marks.MISPLACED
    if seen["bad"] == "681122ff0033":
        return Marks.OCTET
    if seen["bad"] == "ff0068ff0011ff0022ff0033":
        return Marks.PACKET
    return Marks.COUNTED if seen["counted"] == 2 else Marks.NONE  # both errors


def made(row: Mapping[str, Any]) -> list[int]:
    """The rates that the chip makes of the wish, by the formula of its data sheet."""
    return [one["baud"] for one in row["rates"] if one["made"] and abs(one["made"] / one["baud"] - 1) < CLOSE]


def table_of(linux: str, rows: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """The table of the rows ``adapter`` of a boot."""
    found = {}
    for row in rows:
        false = [
            one["baud"] for one in row["rates"] if one["read_back"] == one["baud"] and one["baud"] not in made(row)
        ]
        found[row["chip"]] = {
            "driver": row["driver"],
            "marks": marks_of(row["marks"]).value if "marks" in row else None,
            "made": made(row),
            "read_back_falsely": false,
            "low_latency": row["low_latency"] is True,
            "rs485": row["rs485"] == "set",
            "counters": row["counters"] is True,
            "drain_waits": row["drain"]["drained_ms"] > row["drain"]["left_ms"] - 5 if "drain" in row else None,
        }
    return {"linux": linux, "chips": {chip: found[chip] for chip in CHIPS if chip in found}}


def stored() -> dict[str, Any]:
    table: dict[str, Any] = json.loads(STORED.read_text(encoding="utf-8"))
    return table


def _rates(chip: Mapping[str, Any]) -> str:
    if chip["driver"] == "cdc_acm":
        return "the adapter's own affair: the driver passes every wish on"
    have = [rate for rate in BAUD_RATES if rate in chip["made"]]
    if have == list(BAUD_RATES[: len(have)]):
        return f"up to {baud_text(have[-1])}"
    return ", ".join(map(baud_text, have))


def page_block(table: Mapping[str, Any]) -> str:
    """The lines of the page between its marks."""
    yes = {True: "yes", False: "no", None: "-"}
    lines = [
        "| emulated chip | driver | damaged octets | PROFIBUS rates it makes | read back, but not made | "
        "low-latency mode | error counters | tcdrain waits |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, chip in table["chips"].items():
        marks = _MARKS[Marks(chip["marks"])] if chip["marks"] else "marked, each at its place (not run)"
        false = (
            ", ".join(baud_text(rate) for rate in chip["read_back_falsely"]) if chip["driver"] != "cdc_acm" else "all"
        )
        words = (CHIPS[name], f"`{chip['driver']}`", marks, _rates(chip), false or "none")
        more = (yes[chip[key]] for key in ("low_latency", "counters", "drain_waits"))
        lines.append(f"| {' | '.join((*words, *more))} |")
    lines += ["", f"Linux {table['linux']}. No driver of these has an RS-485 mode (TIOCSRS485)."]
    return "\n".join(lines) + "\n"
