"""Endurance runs, whose figures are in docs/development/reliability.md; ``make soak`` runs a short part of each.

    python -m tools.soak --slices 0-99      10^8 telegrams in virtual time, a slice of 10^6 after the other
    python -m tools.soak --ptys 60          an hour on ptys with both drivers, side by side
    python -m tools.soak --exchanges 10**6  so many exchanges in virtual time under tracemalloc
    python -m tools.soak --report           all results so far, as tables

Each slice, driver or run is a line of the results file. A run of slices that was stopped goes on with those that
are not in the file.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "kits"))

from process_kit import DRIVERS  # noqa: E402
from soak import results  # noqa: E402
from soak.ptys import start  # noqa: E402
from soak.slice import SLICE, SLICES, run_slice  # noqa: E402
from soak.traced import run_traced  # noqa: E402


def keep(path: Path, line: results.Line) -> bool:
    """Append ``line`` and print its problems; whether there are any."""
    results.append(path, line)
    found = results.problems(line)
    print(results.title(line), *found, sep="\n  ", flush=True)
    return bool(found)


def run_slices(wanted: list[int], telegrams: int, path: Path) -> int:
    """Run the slices that ``path`` does not have yet; returns how many had a fault."""
    done = {line["slice"] for line in results.read(path) if "slice" in line}
    commit, bad = results.commit(), 0
    for before, number in enumerate(number for number in wanted if number not in done):
        bad += keep(path, {"commit": commit, "before": before, **run_slice(number, telegrams)})
    return bad


def run_ptys(minutes: float, path: Path) -> int:
    """Run both drivers side by side for ``minutes``; returns how many had a fault."""
    commit = results.commit()
    runs = [start(driver, minutes) for driver in DRIVERS]
    return sum(keep(path, {"commit": commit, **run.result()}) for run in runs)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.soak", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--slices", metavar="FIRST-LAST", help=f"of 0 to {SLICES - 1}")
    parser.add_argument("--telegrams", type=int, default=SLICE, help="of one slice")
    parser.add_argument("--ptys", type=float, metavar="MINUTES", help="with each driver")
    parser.add_argument("--exchanges", metavar="COUNT", help="under tracemalloc, for instance 10**6")
    parser.add_argument("--report", action="store_true", help="all results so far")
    parser.add_argument("--results", type=Path, default=ROOT / "build" / "soak.jsonl", help="the results file")
    args = parser.parse_args()
    bad = 0
    if args.slices:
        bad += run_slices(results.slices_of(args.slices), args.telegrams, args.results)
    if args.ptys:
        bad += run_ptys(args.ptys, args.results)
    if args.exchanges:
        base, _, power = args.exchanges.partition("**")
        line = {"commit": results.commit(), **run_traced(int(base) ** int(power or 1))}
        bad += keep(args.results, line)
    if args.report:
        print(results.report(results.read(args.results)))
    if not (args.slices or args.ptys or args.exchanges or args.report):
        parser.print_help()
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
