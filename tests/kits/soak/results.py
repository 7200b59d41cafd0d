"""The results file of the long runs: JSON lines, the judgement of each, and the table for
docs/development/reliability.md."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[3]
#: memory may grow by so many octets after the warm-up
FLAT: Final = 1 << 20

Line = dict[str, Any]


def commit() -> str:
    """The commit of this checkout, with "+" where its files differ."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False)
        return done.stdout.strip()

    name = git("rev-parse", "--short=10", "HEAD") or "unknown"
    return name + ("+" if git("status", "--porcelain", "--untracked-files=no") else "")


def append(path: Path, line: Line) -> None:
    """Append one result, whole, so that a run that is stopped loses no other."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")


def read(path: Path) -> list[Line]:
    """All results; the last one of a run that was killed may be half a line, and is left out."""
    found: list[Line] = []
    if path.exists():
        for text in path.read_text(encoding="utf-8").splitlines():
            try:
                found.append(json.loads(text))
            except json.JSONDecodeError:
                continue
    return found


def problems(line: Line) -> list[str]:
    """Everything in a result that is a fault: counters, memory, drift, leftovers."""
    found = [*line["faults"], *(f"left: {name}" for name in line["leftovers"])]
    for name, grown in growth(line).items():
        if grown > (FLAT if "rss" in name or name == "octets" else 0):
            found.append(f"{name} grew by {grown} after the warm-up")
    if "slice" in line:
        grid = line["grid"]
        if grid is not None and (grid["earliest_ns"] < 0 or grid["drift_ns"]):
            found.append(f"the grid drifts: {grid}")
        if line["before"]:
            found += [f"left: {count} {name}" for name, count in line["objects_left"].items()]
    return found


def growth(line: Line) -> dict[str, int]:
    """The growth of each kind of memory after the warm-up."""
    if "slice" in line:
        return {"rss": line["rss_end"] - line["rss_warm"]}
    if "ptys" in line:
        return {name: grown for name, grown in line["growth"].items() if name != "objects"}
    return {"octets": line["octets"][-1] - line["octets"][0]}


def title(line: Line) -> str:
    """One line for people."""
    took = f"{line['cpu_s']} s of CPU time"
    if "slice" in line:
        return f"slice {line['slice']}: {line['telegrams']} telegrams, {took}"
    if "ptys" in line:
        return f"ptys, driver {line['ptys']}: {line['telegrams']} telegrams in {line['seconds']:g} s, {took}"
    return f"tracemalloc: {line['exchanges']} exchanges, {took}"


def slices_of(text: str) -> list[int]:
    """The numbers in "3-10" or "4"."""
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def report(lines: list[Line]) -> str:
    """All results as Markdown: the sum of the slices, the last run of each driver on ptys, the last under tracemalloc.
    The problems come last."""
    slices = {line["slice"]: line for line in lines if "slice" in line}
    ptys = {line["ptys"]: line for line in lines if "ptys" in line}
    traced = [line for line in lines if "traced" in line][-1:]
    parts = []
    if slices:
        parts.append(rows_of(("10^8 telegrams", "so far"), slice_rows(slices)))
    if ptys:
        parts.append(rows_of(("on ptys", *ptys), pty_rows(list(ptys.values()))))
    parts += [rows_of(("tracemalloc", ""), traced_rows(line)) for line in traced]
    bad = [
        f"- {title(line)}: {text}" for line in (*slices.values(), *ptys.values(), *traced) for text in problems(line)
    ]
    return "\n\n".join((*parts, "\n".join(bad) or "no problems"))


def rows_of(head: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> str:
    """A Markdown table. Whole numbers get a blank at each thousand."""
    texts = [[f"{cell:,}".replace(",", " ") if isinstance(cell, int) else str(cell) for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *texts))


def slice_rows(slices: dict[int, Line]) -> list[tuple[object, ...]]:
    """The sum of all slices."""
    done = list(slices.values())
    grids = [line["grid"] for line in done if line["grid"] is not None]
    ours = [line["ours"] for line in done]
    grown = [line["rss_end"] - line["rss_warm"] for line in done]
    return [
        ("slices", f"{len(done)} of 100, numbers {min(slices)} to {max(slices)}"),
        ("commit", ", ".join(sorted({line["commit"] for line in done}))),
        ("telegrams on the wire", sum(line["telegrams"] for line in done)),
        ("of them answered Data_Exchange requests", sum(mine["exchanges"] for mine in ours)),
        ("tokens", sum(mine["tokens"] for mine in ours)),
        ("requests of services beside the cycle", sum(line["services"] for line in done)),
        (
            "acts of the programs (speeds, parameters, services, faults)",
            sum(sum(line["acts"].values()) for line in done),
        ),
        ("bus time", f"{sum(line['bus_s'] for line in done) / 3600:.2f} h"),
        ("CPU time", f"{sum(line['cpu_s'] for line in done) / 3600:.2f} h"),
        ("rounds of a fixed cycle", sum(grid["rounds"] for grid in grids)),
        ("of them late by more than a tenth", sum(grid["late"] for grid in grids)),
        ("cycles left out", sum(grid["left_out"] for grid in grids)),
        ("largest deviation of a round from the grid", f"{max((g['latest_ns'] for g in grids), default=0) / 1e6:g} ms"),
        ("drift of a grid", f"{max((grid['drift_ns'] for grid in grids), default=0)} ns"),
        ("growth of memory after the warm-up of a slice", f"{min(grown) // 1024} to {max(grown) // 1024} KiB"),
        ("differences between our counters and the wire", sum(len(line["faults"]) for line in done)),
        ("leftovers", sum(len(line["leftovers"]) for line in done)),
    ]


def pty_rows(runs: list[Line]) -> list[tuple[object, ...]]:
    """The runs on ptys side by side."""

    def row(name: str, key: str) -> tuple[object, ...]:
        return (name, *(run[key] for run in runs))

    def grown(key: str) -> list[str]:
        return [f"{run['growth'][key] // 1024} KiB" if key in run["growth"] else "-" for run in runs]

    return [
        row("commit", "commit"),
        ("length", *(f"{run['seconds'] / 60:g} min" for run in runs)),
        row("telegrams both ways", "telegrams"),
        row("exchanges", "exchanges"),
        row("repeated requests", "repeats"),
        row("cycles of 20 ms begun", "cycles"),
        row("of the due ones late or left out", "missed"),
        ("latest round", *(f"{run['rounds_late_ms']} ms" for run in runs)),
        ("drift of the grid, first to last third", *(f"{run['drift_us']} us" for run in runs)),
        ("acts of the program", *(sum(run["acts"].values()) for run in runs)),
        ("growth of the application's memory", *grown("rss")),
        ("growth of the bus process's memory", *grown("bus_rss")),
        ("leftovers", *(len(run["leftovers"]) for run in runs)),
        ("differences to the far end, lost slaves", *(len(run["faults"]) for run in runs)),
    ]


def traced_rows(line: Line) -> list[tuple[object, ...]]:
    """The run under tracemalloc."""
    at = [f"{octets / 1024:.0f} KiB at {part:.0%}" for part, octets in zip(line["parts"], line["octets"], strict=True)]
    return [
        ("commit", line["commit"]),
        ("exchanges", line["exchanges"]),
        ("allocated after so much of the run", ", ".join(at)),
        ("peak after the warm-up", f"{max(line['peaks'][1:]) / 1024:.0f} KiB"),
        *((f"growth at {where}", f"{size} octets, {count} blocks") for where, size, count in line["grown"][:5]),
    ]
