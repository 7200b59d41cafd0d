"""The results file of the long runs: JSON lines, the judgement of each, and the table for docs/reliability.md."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[2]
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
    """Everything in the result of a slice that is a fault: counters, memory, drift, leftovers."""
    found = [*line["faults"], *(f"left: {name}" for name in line["leftovers"])]
    grown = line["rss_end"] - line["rss_warm"]
    if grown > FLAT:
        found.append(f"memory grew by {grown} octets after the warm-up")
    grid = line["grid"]
    if grid is not None and (grid["earliest_ns"] < 0 or grid["drift_ns"]):
        found.append(f"the grid drifts: {grid}")
    if line["before"]:
        found += [f"left: {count} {name}" for name, count in line["objects_left"].items()]
    return found


def slices_of(text: str) -> list[int]:
    """The numbers in "3-10" or "4"."""
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def table(lines: Iterable[Line]) -> str:
    """The sum of all slices as Markdown, and every problem below it."""
    by_number = {line["slice"]: line for line in lines if "slice" in line}
    if not by_number:
        return "no slices yet"
    done = list(by_number.values())
    grids = [line["grid"] for line in done if line["grid"] is not None]
    ours = [line["ours"] for line in done]
    acts = sum(sum(line["acts"].values()) for line in done)
    growth = [line["rss_end"] - line["rss_warm"] for line in done]
    bad = [f"- slice {line['slice']}: {text}" for line in done for text in problems(line)]
    rows = [
        ("slices", f"{len(done)}, numbers {min(by_number)} to {max(by_number)}"),
        ("commits", ", ".join(sorted({line["commit"] for line in done}))),
        ("telegrams on the wire", f"{sum(line['telegrams'] for line in done):_}"),
        ("of them Data_Exchange, answered", f"{sum(mine['exchanges'] for mine in ours):_}"),
        ("tokens", f"{sum(mine['tokens'] for mine in ours):_}"),
        ("services beside the cycle", f"{sum(line['services'] for line in done):_}"),
        ("acts of the programs", f"{acts:_}"),
        ("bus time", f"{sum(line['bus_s'] for line in done) / 3600:.2f} h"),
        ("CPU time", f"{sum(line['cpu_s'] for line in done) / 3600:.2f} h"),
        ("rounds of a fixed cycle", f"{sum(grid['rounds'] for grid in grids):_}"),
        ("of them late, left out", f"{sum(g['late'] for g in grids):_}, {sum(g['left_out'] for g in grids):_}"),
        ("largest deviation from the grid", f"{max((grid['latest_ns'] for grid in grids), default=0) / 1e6:g} ms"),
        ("largest drift at the end of a slice", f"{max((grid['drift_ns'] for grid in grids), default=0)} ns"),
        ("growth of memory after the warm-up", f"{min(growth) // 1024} to {max(growth) // 1024} KiB"),
        ("slices with a fault", f"{len({line['slice'] for line in done if problems(line)})}"),
    ]
    text = "\n".join(("| | |", "|---|---|", *(f"| {name} | {value.replace('_', ' ')} |" for name, value in rows)))
    return "\n".join((text, *bad))
