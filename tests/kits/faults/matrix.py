"""The fault matrix: baud rate x stations x fault in virtual time, one line of figures for each cell.

``tests/snapshots/fault_matrix.json`` keeps the lines, so that a change of behaviour is a diff to read. One command
writes them: ``python tests/kits/faults`` (``TEXT ...`` after it: only the lines of faults with such a text in
their names, ``--quick``: only those of ``make test``). ``--table`` prints the table of docs/development/reliability.md.
All is decided by the seed, so each line is exact.

A fault is a function that begins it at a plant and returns the function that ends it. A cell brings the plant up, lets
the fault act for some rotations, measures how long the plant takes to be well again, then lets the fault act once more
and ends the bus in order meanwhile. The keys of a line:

- ``exchanges``: inputs that reached the application while the fault acted, each of them new
- ``retries``: repeated requests on the wire in that time
- ``wrong data``: inputs at the application and outputs at devices that the other end had not put on the wire for this
  exchange, over the whole cell
- ``back after``: planned rotations from the end of the fault until everything is well and stays so
- ``dropped``: slaves that left data exchange; ``dropped wrongly``: those without a reason on the wire
  (:meth:`~faults.plant.Plant.dropped_wrongly`)
- ``stalls (after_stall = ...)``: by what blocked the bus, where the master found a stall
- ``last octets``: by slaves, the last outputs on the wire and Clear after an ordered end while the fault acts
- ``made safe by``: what made the outputs of the slaves safe then, where it was not the master
- ``given up``, ``late or wrong``, ``tokens lost``, ``tokens repeated``, ``withdrawn``, ``bad frames``, ``referee``:
  counters of all masters, and findings of the simulation's referee; left out where they are 0
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from faults.plant import Plant, Plug
from faults.truth import NEVER_LIVE, Application
from support import S

from dpstack.phy.patience import EXACT, Patience

SNAPSHOT = Path(__file__).parents[2] / "snapshots" / "fault_matrix.json"
RATES: tuple[int, ...] = (9_600, 45_450, 500_000, 1_500_000, 12_000_000)
STATIONS: tuple[int, ...] = (1, 8, 32)
#: how many rotations a fault acts, by stations
ROTATIONS = {1: 200, 3: 100, 8: 60, 32: 25}
#: rotations of the ordered end before the order, in which the fault acts again
BEFORE_END = 3
#: in a line: outputs stayed live after everything
NOTHING = "nothing"
#: the longest recovery that is waited for
RECOVERS_WITHIN_NS, RECOVERS_WITHIN = 60 * S, 200

End = Callable[[], None]
Begin = Callable[[Plant], End]
Row = dict[str, int | str]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault by name. ``begin`` begins it at a plant and returns what ends it; ``measure``: measures a cell at another
    plant, by rate, stations and seed.

    ``rotations``: a factor on the usual number of rotations in which it acts; ``least_ns``: and so long at least.
    ``settings``: of the master; ``plug`` and ``patience``: of its station. ``masters``: 1, or as many as slaves.
    ``quick``: (rate, stations) of the cells that ``make test`` repeats. ``not_back``: the reason why the plant is not
    well again, empty where it is.
    """

    name: str
    begin: Begin = lambda _plant: lambda: None
    measure: Callable[[int, int, int], Row] | None = None
    rotations: float = 1
    least_ns: int = 0
    settings: Mapping[str, Any] = field(default_factory=dict)
    plug: Plug | None = None
    patience: Patience = EXACT
    masters: int = 1
    rates: Collection[int] = RATES
    stations: Collection[int] = STATIONS
    quick: Collection[tuple[int, int]] = ()
    seeds: Collection[int] = (1,)
    not_back: str = ""


@dataclass(frozen=True)
class Cell:
    """One line of the matrix."""

    fault: Fault
    baud: int
    stations: int
    seed: int

    @property
    def title(self) -> str:
        fault = self.fault
        who = f"{self.stations} slave{'s' * (self.stations > 1)}"
        ring = f"{fault.masters} masters, " if fault.masters > 1 else ""
        resumes = "" if fault.settings.get("safe_after_stall", True) else ' (after_stall = "resume")'
        return f"{fault.name}{resumes}, {self.baud} bit/s, {ring}{who}, seed {self.seed}"

    @property
    def quick(self) -> bool:
        return (self.baud, self.stations) in self.fault.quick


def cells(faults: Iterable[Fault]) -> Iterator[Cell]:
    """All cells of ``faults``, in the order of the snapshot."""
    for fault in faults:
        missing = set(fault.quick) - {(baud, stations) for baud in fault.rates for stations in fault.stations}
        assert not missing, f"{fault.name}: {missing} are no cells"
        for baud in fault.rates:
            for stations in fault.stations:
                for seed in fault.seeds:
                    yield Cell(fault, baud, stations, seed)


def plant_of(cell: Cell) -> Plant:
    """The plant of a cell, all well."""
    fault = cell.fault
    plant = Plant(
        cell.baud,
        cell.stations,
        cell.seed,
        masters=fault.masters,
        plug=fault.plug,
        patience=fault.patience,
        settings=fault.settings,
    )
    assert plant.until_well(600 * S) is not None, f"{cell.title}: no bring-up without a fault"
    return plant


def row(cell: Cell) -> Row:
    """The figures of a cell."""
    if cell.fault.measure is not None:
        return cell.fault.measure(cell.baud, cell.stations, cell.seed)
    fault, plant = cell.fault, plant_of(cell)
    world, before = plant.world, plant.trouble()
    events = {number: len(end.events) for number, end in enumerate(plant.masters)}
    calls = {application.address: len(application.calls) for application in _applications(plant)}
    begun = world.now

    end_fault = fault.begin(plant)
    plant.at_least(fault.rotations * ROTATIONS[cell.stations], fault.least_ns)
    end_fault()
    plant.over_ns = world.now
    found: Row = {
        "exchanges": sum(_new_inputs(a.calls[calls[a.address] :]) for a in _applications(plant)),
        "retries": plant.truth.retries(begun),
    }
    back = plant.until_well(max(RECOVERS_WITHIN_NS, RECOVERS_WITHIN * plant.rotation_ns))
    trouble = {name: value - before[name] for name, value in plant.trouble().items() if value != before[name]}
    drops = plant.drops(events)

    end_fault = fault.begin(plant)
    plant.rotations(BEFORE_END)
    plant.end()
    end_fault()
    last = Counter(plant.truth.last_octets(address) for address in plant.devices)
    world.run_for(plant.watchdog_ns + S)

    found["wrong data"] = wrong_data(plant)
    found["back after"] = "never" if back is None else back
    if drops:
        found["dropped"] = len(drops)
        found["dropped wrongly"] = sum(plant.dropped_wrongly(*drop) for drop in drops)
    stalls = Counter("unknown" if s.blocked is None else s.blocked.value for s in plant.stalls())
    if stalls:
        rule = "safe" if fault.settings.get("safe_after_stall", True) else "resume"
        found[f"stalls (after_stall = {rule})"] = _counted(stalls)
    found["last octets"] = _counted(last)
    others = Counter(
        device.safe_by or NOTHING
        for devices in plant.devices.values()
        for device in devices
        if device.safe_by not in ("zeros", "Clear", NEVER_LIVE)
    )
    if others:
        found["made safe by"] = _counted(others)
    return found | trouble


def wrong_data(plant: Plant) -> int:
    """Wrong outputs at devices and wrong inputs at applications, over the life of the plant."""
    truth = plant.truth
    outputs = sum(truth.wrong_outputs(d, address) for address, devices in plant.devices.items() for d in devices)
    return outputs + sum(truth.wrong_inputs(a, plant.devices[a.address]) for a in _applications(plant))


def _applications(plant: Plant) -> list[Application]:
    return [application for end in plant.masters for application in end.applications.values()]


def _new_inputs(calls: list[tuple[int, bytes, bytes]]) -> int:
    seen = [inputs for _, inputs, _ in calls if inputs]
    return sum(one != other for one, other in pairwise(seen)) + bool(seen)


def _counted(counts: Counter[str]) -> str:
    """``3 this, 1 that``; the bare name where there is only one kind."""
    return "; ".join(f"{count} x {name}" for name, count in counts.most_common())


# --- the snapshot -----------------------------------------------------------------------------------------------------


def line(cell: Cell, figures: Row | None = None) -> str:
    """The line of a cell; ``figures`` None: measured now."""
    return f"  {json.dumps(cell.title)}: {json.dumps(row(cell) if figures is None else figures)}"


def kept() -> dict[str, Row]:
    """The lines of the snapshot by title."""
    found: dict[str, Row] = json.loads(SNAPSHOT.read_text())
    return found


def write(faults: Iterable[Fault], texts: Collection[str], *, quick: bool) -> None:
    """Write the lines anew whose faults have one of ``texts`` in their names; the others stay."""
    old = kept() if SNAPSHOT.exists() else {}
    lines = []
    for cell in cells(faults):
        chosen = (not texts or any(text in cell.fault.name for text in texts)) and (cell.quick or not quick)
        if chosen:
            lines.append(line(cell))
        elif cell.title in old:
            lines.append(line(cell, old[cell.title]))
    SNAPSHOT.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def table(faults: Iterable[Fault]) -> str:
    """The matrix summed up by fault, for docs/development/reliability.md. Numbers of its lines are added up; of
    rotations to recovery the median and the most."""
    lines = kept()
    rows = [
        "| fault | cells | exchanges | retries | slaves dropped | wrong data | rotations to recovery: median, most |"
    ]
    rows.append("|---|---|---|---|---|---|---|")
    by_name: dict[str, list[Row]] = {}
    for cell in cells(faults):
        by_name.setdefault(cell.fault.name.split(",")[0], []).append(lines[cell.title])
    for name, found in by_name.items():
        sums = [sum(int(row.get(key, 0)) for row in found) for key in ("exchanges", "retries", "dropped", "wrong data")]
        back = sorted(int(row["back after"]) for row in found if row["back after"] != "never")
        figures = " | ".join(map(str, sums))
        rows.append(f"| {name} | {len(found)} | {figures} | {back[len(back) // 2]}, {back[-1]} |")
    return "\n".join(rows)
