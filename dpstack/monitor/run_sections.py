"""Sections of the report of a run on what its master knows beside the octets: modules, standing diagnoses, I&M0."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from dpstack.monitor.markup import html_section, html_table, text

#: columns of the inventory: keys of I&M0 and headings
_IM0: Final = {
    "manufacturer_id": "MANUFAC\xadTURER_ID",
    "order_id": "Order number",
    "serial_number": "Serial number",
    "hardware_revision": "Hardware",
    "software_revision": "Software",
    "revision_counter": "Changes",
}
#: keys of the plant and headings
_DEVICE: Final = {"ident": "Ident", "vendor": "Vendor", "model": "Model"}


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSlave:
    """A slave of the bus that the program runs.

    ``plant``: as the live stream has it. ``quality``, ``doubts``: those of the stream at the end of the run. ``im0``:
    its I&M0 by the names of the fields, None without; then ``no_im`` says why.
    """

    address: int
    name: str
    plant: Mapping[str, Any] = field(default_factory=dict)
    quality: Mapping[str, Any] | None = None
    doubts: Sequence[Mapping[str, Any]] = ()
    im0: Mapping[str, Any] | None = None
    no_im: str = ""

    @property
    def standing(self) -> Sequence[Mapping[str, Any]]:
        """What stood against its values at the end: the places, else the reason for all of them."""
        return self.doubts or ([] if self.quality is None else [self.quality])


def count_of_standing(slaves: Sequence[RunSlave]) -> int:
    """The number of standing diagnoses of all slaves."""
    return sum(len(slave.standing) for slave in slaves)


def modules_section(slaves: Sequence[RunSlave]) -> str:
    """The slots of all slaves, with their octets."""
    rows = [
        (slave.address, slave.name, *row) for slave in slaves for row in map(_slot, slave.plant.get("modules") or ())
    ]
    columns = ("Address", "Name", "Slot", "Module", "Identifier (hex)", "Input octets", "Output octets")
    table = html_table("Slots of each slave", columns, rows, numbers=(2,))
    note = "As the slaves are configured; a slave in data exchange has accepted it (Chk_Cfg). Octets count from 0."
    return html_section("Modules", f"<p>{text(note)}</p>{table}")


def _slot(module: Mapping[str, Any]) -> tuple[object, ...]:
    octets = bytes.fromhex(module["config"]).hex(" ").upper()
    return (module["slot"], module["name"], octets, *(_octets(module, side) for side in ("input", "output")))


def _octets(module: Mapping[str, Any], side: str) -> str:
    count, first = module[f"{side}s"], module[f"{side}_at"]
    return "" if not count else str(first) if count == 1 else f"{first} to {first + count - 1}"


def standing_section(slaves: Sequence[RunSlave]) -> str:
    """The diagnoses that stood at the end of the run."""
    rows = [row for slave in slaves for row in _standing(slave)]
    columns = ("Address", "Name", "Slot", "Channel", "Values", "Quality", "Diagnosis", "Since (s after the start)")
    table = html_table("Diagnoses that stood at the end of the run", columns, rows, numbers=(2, 3, 7))
    return html_section("Standing diagnoses", table if rows else "<p>No slave had one at the end of the run.</p>")


def _standing(slave: RunSlave) -> Iterator[tuple[object, ...]]:
    for one in slave.standing:
        is_place = one.get("slot") is not None
        side = one.get("direction")
        values = f"{side}s" if side else "of the slot" if is_place else "all"
        slot = one["slot"] if is_place else ""
        channel = "" if one.get("channel") is None else one["channel"]
        since = "" if one.get("since") is None else one["since"]
        yield (slave.address, slave.name, slot, channel, values, one["quality"], one["text"], since)


def inventory_section(slaves: Sequence[RunSlave]) -> str:
    """What each slave is, by its GSD file and by its own I&M0."""
    rows = []
    for slave in slaves:
        about = (slave.plant.get(key) or "" for key in _DEVICE)
        found = ("" if slave.im0 is None else slave.im0[key] for key in _IM0)
        rows.append((slave.address, slave.name, *about, *found, slave.no_im))
    columns = ("Address", "Name", *_DEVICE.values(), *_IM0.values(), "No I&M0, because")
    table = html_table("Inventory", columns, rows, numbers=(5, 8, 10))
    note = (
        "Ident, vendor and model: of the configuration and its GSD files. The others: I&M0 of slot 0, read once from "
        "each slave with DP-V1 while the bus ran."
    )
    return html_section("Inventory (I&M)", f"<p>{text(note)}</p>{table}")
