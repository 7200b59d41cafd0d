"""Endurance runs, whose figures are in docs/reliability.md; ``make soak`` runs a short part of each.

    python -m tools.soak --slices 0-99      10^8 telegrams in virtual time, a slice of 10^6 after the other
    python -m tools.soak --report           the sum of all slices, as a table

Each slice is a line of the results file. A run that was stopped goes on with the slices that are not in it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "kits"))

import soak_results as results  # noqa: E402
from soak_slice import SLICE, SLICES, run_slice  # noqa: E402


def run_slices(wanted: list[int], telegrams: int, path: Path) -> int:
    """Run the slices that ``path`` does not have yet; returns how many had a fault."""
    done = {line["slice"] for line in results.read(path) if "slice" in line}
    commit, bad = results.commit(), 0
    for before, number in enumerate(number for number in wanted if number not in done):
        line = {"commit": commit, "before": before, **run_slice(number, telegrams)}
        results.append(path, line)
        found = results.problems(line)
        bad += bool(found)
        print(f"slice {number}: {line['telegrams']} telegrams in {line['cpu_s']} s", *found, sep="\n  ", flush=True)
    return bad


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.soak", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--slices", metavar="FIRST-LAST", help=f"of 0 to {SLICES - 1}")
    parser.add_argument("--telegrams", type=int, default=SLICE, help="of one slice")
    parser.add_argument("--report", action="store_true", help="the table of all results so far")
    parser.add_argument("--results", type=Path, default=ROOT / "build" / "soak.jsonl", help="the results file")
    args = parser.parse_args()
    bad = 0
    if args.slices:
        bad += run_slices(results.slices_of(args.slices), args.telegrams, args.results)
    if args.report:
        print(results.table(results.read(args.results)))
    if not (args.slices or args.report):
        parser.print_help()
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
