"""``python -m tools.mutants --sample 400 --seed 1``: whether the tests notice small changes of the protocol machines.

mutmut's operators make the mutants (``[tool.mutmut]`` in pyproject.toml has the rooms and the tests). A random sample
of them, by seed over all rooms, is tried: each mutant against the tests that execute its line, the room's own first,
then the quickest, until one fails. It is *killed* if one fails, *timeout* if a test takes ten times as long as usual
(counts as killed), *no tests* if no test executes its line, else it *survived*. tools/mutants/equivalent.toml explains
those that change nothing; they are counted as *explained*, not as killed.

* ``--rooms fdl,phy`` and ``--only dpstack/fdl/active/exchange.py`` try only those mutants of the sample that are there.
* ``--sample 0``: all mutants.
* ``--out FILE``: JSON lines. A run with the same file tries only those mutants that it does not have.
* ``--report FILE...``: no mutants; the table of such files together.
* ``--tests tests/fdl,tests/phy``: only these tests, in place of those in pyproject.toml.
* ``--also tests/sim,tests/test_uart_level.py``: afterwards those that survived are tried against these tests, too, and
  against those that ``--seconds`` left out, for four times as long. The table then has both figures: mutants that the
  first tests notice, and mutants that any test notices.
* ``--survivors FILE``: print the survivors of such a file and try them again.
* ``--branch``: no mutants; branch coverage of each room by the room's own tests.

The first run measures which tests execute which lines (some minutes, kept in ~/.cache/dpstack-mutants); later runs
measure only files of tests that changed. ``--measure`` measures all again (tests/kits changed much).
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import hashlib
import io
import itertools
import json
import os
import random
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

try:
    import coverage  # noqa: F401
    import mutmut  # noqa: F401
except ImportError:
    sys.exit("tools.mutants needs mutmut and coverage: pip install -e '.[test,mutation]'")

from mutmut.configuration import config

from tools.mutants import seen_by, trial
from tools.mutants.made import ROOT, Mutant, SourceFile, source_paths

ROOMS: Final = ("fdl", "dp", "dpv1", "phy")
EQUIVALENT: Final = Path(__file__).with_name("equivalent.toml")
_NOTICED: Final = ("killed", "timeout")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tools.mutants", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--sample", type=int, default=400, help="number of mutants, 0: all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", default=",".join(ROOMS), help="comma-separated rooms")
    parser.add_argument("--only", default="", help="path of a file or folder")
    parser.add_argument(
        "--seconds", type=float, default=8.0, help="tests for one mutant, in seconds of their usual time"
    )
    parser.add_argument("--out", type=Path, help="JSON lines of the results; a run goes on where the file ends")
    parser.add_argument("--tests", help="comma-separated folders or files of tests in place of pyproject.toml's")
    parser.add_argument("--also", help="further ones, which only those see that survived")
    parser.add_argument("--survivors", type=Path, help="try the survivors of such a file again")
    parser.add_argument("--report", type=Path, nargs="+", help="print the table of such files")
    parser.add_argument("--measure", action="store_true", help="measure anew which tests execute which lines")
    parser.add_argument("--branch", action="store_true", help="branch coverage of each room instead of mutants")
    given = parser.parse_args()
    os.chdir(ROOT)
    sys.path[:0] = [str(ROOT)]
    options = config().pytest_add_cli_args
    selection = given.tests.split(",") if given.tests else config().pytest_add_cli_args_test_selection
    rooms = given.rooms.split(",")
    if given.report:
        report({key: row for file in given.report for key, row in _read(file).items()})
        return
    if given.branch:
        branch_coverage(rooms, options)
        return
    trial.prepare_cold()
    seen = seen_by.load(selection, options, anew=given.measure)
    part = given.only.removesuffix(".py").replace("/", "-") or "-".join(rooms)
    out = given.out or seen_by.CACHE / f"{part}-sample-{given.sample}-seed-{given.seed}.jsonl"
    if given.survivors:
        before = [json.loads(line) for line in given.survivors.read_text(encoding="utf-8").splitlines()]
        wanted = [row for row in before if row["result"] in ("survived", "no tests")]
        mutants = _same_again(wanted)
        out = given.out or given.survivors.with_suffix(".again.jsonl")
        out.unlink(missing_ok=True)
    else:
        mutants = _drawn(rooms, given.only, given.sample, given.seed)
    done = _read(out)
    print(f"commit {_commit()}, seed {given.seed}, results in {out}", flush=True)
    _try_all(mutants, done, out, [*options, *selection], seen, given.seconds)
    if given.also:
        further = [*selection, *given.also.split(",")]
        left = {
            key: row
            for key, row in _read(out).items()
            if row["result"] in ("survived", "no tests") and row.get("also") != given.also
        }
        seen = seen_by.load(further, options, anew=given.measure)
        again = (file.mutant(number) for file, number in _places(left))
        _try_all(again, {}, out, [*options, *further], seen, 4 * given.seconds, also=given.also, before=left)
    report(_read(out))


def _drawn(rooms: Sequence[str], only: str, sample: int, seed: int) -> Iterator[Mutant]:
    """A random sample of the mutants of all rooms, without repetition: those in ``rooms`` and in the path ``only``."""
    paths = source_paths(ROOMS)
    counts = _counts(paths)
    places = [(path, number) for path in paths for number in range(counts[path])]
    drawn = sorted(random.Random(seed).sample(places, sample)) if 0 < sample < len(places) else places
    chosen = [place for place in drawn if place[0].split("/")[1] in rooms and place[0].startswith(only)]
    print(f"{len(drawn)} of {len(places)} mutants are drawn, {len(chosen)} of them are tried", flush=True)
    for file, number in _places(chosen):
        yield file.mutant(number)


def _places(keys: Iterable[tuple[str, int]]) -> Iterator[tuple[SourceFile, int]]:
    for path, numbers in itertools.groupby(sorted(keys), key=lambda place: place[0]):
        file = SourceFile(path)
        yield from ((file, number) for _, number in numbers)


def _counts(paths: Sequence[str]) -> dict[str, int]:
    """The number of mutants of each file; kept, because it takes half a minute to count them all."""
    kept = seen_by.CACHE / "counts.json"
    counts: dict[str, int] = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else {}
    digests = {path: hashlib.sha256((ROOT / path).read_bytes()).hexdigest() for path in paths}
    for digest, path in ((digest, path) for path, digest in digests.items() if digest not in counts):
        counts[digest] = len(SourceFile(path))
    kept.write_text(json.dumps(counts), encoding="utf-8")
    return {path: counts[digest] for path, digest in digests.items()}


def _same_again(rows: Sequence[dict[str, Any]]) -> Iterator[Mutant]:
    """The mutants of the present sources with the same function and the same difference."""
    for path in sorted({row["path"] for row in rows}):
        file = SourceFile(path)
        differences = collections.Counter((row["function"], tuple(row["diff"])) for row in rows if row["path"] == path)
        for number in range(len(file)):
            mutant = file.mutant(number)
            key = (mutant.function, tuple(mutant.diff()))
            if differences[key]:
                differences[key] -= 1
                yield mutant


def _try_all(
    mutants: Iterator[Mutant],
    done: dict[tuple[str, int], dict[str, Any]],
    out: Path,
    arguments: Sequence[str],
    seen: seen_by.SeenBy,
    seconds: float,
    also: str = "",
    before: Mapping[tuple[str, int], dict[str, Any]] = {},
) -> None:
    warm, known = trial.start_warm(arguments)
    explained = _explained()
    sound: dict[tuple[bool, str], bool] = {}

    def ask(order: trial.Order, cold: bool) -> trial.Outcome:
        if cold:
            return trial.cold_trial(order)
        warm.send(order)
        answer: trial.Outcome = warm.recv()
        return answer

    def order_of(mutant: Mutant, numbers: Sequence[int], source: str) -> trial.Order:
        place = mutant.place
        tests = [seen.tests[number] for number in numbers]
        return trial.Order(
            mutant.path,
            source,
            place.qualname,
            place.function_line,
            tests,
            [seen.seconds[number] for number in numbers],
        )

    def outcome_of(mutant: Mutant) -> trial.Outcome:
        numbers = [n for n in seen.of_mutant(mutant) if seen.tests[n] in known]
        cold = seen.runs_at_import(mutant)
        while True:
            chosen = _within(seen, numbers, seconds, files=6 if cold else 0)
            if not chosen:
                return trial.Outcome("no tests")
            outcome = ask(order_of(mutant, chosen, mutant.after), cold)
            if outcome.result == "broken" and not cold:
                cold = True
                continue
            if outcome.result not in ("killed", "timeout") or not outcome.test:
                return outcome
            # a test that fails without the mutant too, in such a process, shows nothing
            key = (cold, outcome.test)
            number = seen.tests.index(outcome.test)
            if key not in sound:
                sound[key] = ask(order_of(mutant, [number], ""), cold).result == "survived"
            if sound[key]:
                return outcome
            print(f"left out, fails without a mutant: {outcome.test}", flush=True)
            numbers.remove(number)

    with out.open("a", encoding="utf-8") as file:
        for mutant in mutants:
            if (mutant.path, mutant.number) in done:
                continue
            began = time.monotonic()
            outcome = outcome_of(mutant)
            diff = mutant.diff()
            result = outcome.result
            if result == "no tests" and (mutant.path, mutant.number) in before:
                result = before[mutant.path, mutant.number]["result"]  # the further tests do not execute it
            if result in ("survived", "no tests") and (mutant.function, tuple(diff)) in explained:
                result = "explained"
            row = {
                "path": mutant.path,
                "number": mutant.number,
                "function": mutant.function,
                "result": result,
                "test": outcome.test,
                "seconds": round(time.monotonic() - began, 2),
                "diff": diff,
            }
            if also:
                row["also"] = also
            file.write(json.dumps(row) + "\n")
            file.flush()
    warm.send(None)


def _within(seen: seen_by.SeenBy, numbers: Sequence[int], seconds: float, *, files: int) -> list[int]:
    """The first tests, as many as take ``seconds``; of ``files`` files at most (0: any number)."""
    chosen: list[int] = []
    total = 0.0
    used: set[str] = set()
    for number in numbers:
        file = seen.tests[number].split("::")[0]
        if files and file not in used and len(used) == files:
            continue
        used.add(file)
        if chosen and total + seen.seconds[number] > seconds:
            break
        total += seen.seconds[number]
        chosen.append(number)
    return chosen


def _explained() -> set[tuple[str, tuple[str, ...]]]:
    if not EQUIVALENT.exists():
        return set()
    rows = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")).get("mutant", [])
    return {(row["function"], tuple(row["diff"].strip("\n").split("\n"))) for row in rows}


def _read(out: Path) -> dict[tuple[str, int], dict[str, Any]]:
    if not out.exists():
        return {}
    rows = [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]
    return {(row["path"], row["number"]): row for row in rows}


def report(rows: dict[tuple[str, int], dict[str, Any]]) -> None:
    """Print the survivors and a table of the rooms."""
    counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    explained = _explained()
    for row in rows.values():
        result = row["result"]
        if result in ("survived", "no tests") and (row["function"], tuple(row["diff"])) in explained:
            result = "explained"
        count = counts[row["path"].split("/")[1]]
        count[result] += 1
        if result not in _NOTICED:
            if result != "explained":
                print(f"\n{result}: {row['function']}")
                print("\n".join(row["diff"]))
        elif "also" not in row:
            count["by the first tests"] += 1
    results = ("killed", "timeout", "survived", "no tests", "explained", "broken")
    print("\n| room | mutants | " + " | ".join(results) + " | by the first tests | by any test |")
    print("|---" * (len(results) + 4) + "|")
    total: collections.Counter[str] = collections.Counter()
    for room, count in counts.items():
        total += count
        _print_row(room, count, results)
    _print_row("all", total, results)


def _print_row(room: str, count: collections.Counter[str], results: Sequence[str]) -> None:
    mutants = sum(count[result] for result in results)
    noticed = (count["by the first tests"], sum(count[result] for result in _NOTICED))
    cells = [str(count[result]) for result in results] + [f"{100 * n / max(1, mutants):.1f} %" for n in noticed]
    print(f"| {room} | {mutants} | {' | '.join(cells)} |")


def _commit() -> str:
    return subprocess.run(
        ["git", "rev-parse", "--short=10", "HEAD"], capture_output=True, text=True, check=False
    ).stdout.strip()


def branch_coverage(rooms: Sequence[str], options: Sequence[str]) -> None:
    """Print the statements and branches of each room that the room's own tests execute."""
    print("| room | statements | executed | branches | taken |\n|---|---|---|---|---|", flush=True)
    for room in rooms:
        child = os.fork()  # each room is measured in a process that has imported nothing of it yet
        if not child:
            code = 1
            try:
                print(_branch_coverage_of(room, options), flush=True)
                code = 0
            finally:
                os._exit(code)
        if os.waitpid(child, 0)[1]:
            raise SystemExit(f"the tests of {room} could not be measured")


def _branch_coverage_of(room: str, options: Sequence[str]) -> str:
    import coverage
    import pytest

    folder = f"{ROOT}/dpstack/{room}"
    measured: Any = coverage.Coverage(data_file=None, branch=True, config_file=False, source=[folder])
    measured.start()
    with contextlib.redirect_stdout(io.StringIO()) as told:
        code = pytest.main([*options, *trial.OPTIONS, f"tests/{room}"])
    measured.stop()
    if code:
        raise SystemExit(told.getvalue())
    count: collections.Counter[str] = collections.Counter()
    for path in sorted(Path(folder).rglob("*.py")):
        numbers = measured._analyze(str(path)).numbers
        for name in ("n_statements", "n_executed", "n_branches", "n_executed_branches"):
            count[name] += getattr(numbers, name)
    lines = 100 * count["n_executed"] / count["n_statements"]
    branches = 100 * count["n_executed_branches"] / count["n_branches"]
    return f"| {room} | {count['n_statements']} | {lines:.1f} % | {count['n_branches']} | {branches:.1f} % |"


if __name__ == "__main__":
    main()
