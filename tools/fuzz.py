"""``make fuzz``: feeds the targets of ``tests/fuzz/targets``, each in a process of its own, and prints a line for each.

atheris (the extra ``fuzz`` of pyproject.toml) counts the coverage and searches by it. Where it is not installed,
mutation by hand takes its place, without coverage. Inputs that a target fails on become files of ``build/fuzz``.

::

    python -m tools.fuzz --minutes 10                        all targets, the minutes shared among them
    python -m tools.fuzz decoder gsd --executions 1000000 --seed 7
    python -m tools.fuzz decoder --replay build/fuzz/decoder-ValueError-0123456789
    python -m tools.fuzz decoder --minimise FOLDER           writes the corpus of a target anew, by coverage

The exit code is 1 where a target failed.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import importlib.util
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from dataclasses import asdict, replace
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any, Final, cast

from tests.fuzz.frame import CORPUS, Finds, Report, Target, by_hand, corpus, judged, load, names

ROOT: Final = Path(__file__).resolve().parent.parent
FINDS: Final = ROOT / "build" / "fuzz"
INSTALL: Final = "python -m pip install -e '.[fuzz]'"
#: an input that takes so many seconds of the clock ends the target's run
_HANGS_S: Final = 60
#: MB of memory that end the target's run
_MEMORY_MB: Final = 2048
_MOST: Final = (1 << 31) - 1
_PROGRESS: Final = re.compile(r"^#(\d+)\s+\w+\s+cov: (\d+)")
_EXECUTED: Final = re.compile(r"^stat::number_of_executed_units:\s+(\d+)")
#: files of one corpus, and octets of one file, that ``--minimise`` keeps
_FILES: Final = 24
_FILE_OCTETS: Final = 1_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parser().parse_args(arguments)
    if options.child:
        return _child(options.targets[0], json.loads(options.child.read_text()))
    try:
        chosen = {name: _shortened(load(name), options.longest) for name in options.targets or names()}
    except LookupError as error:
        print(error, file=sys.stderr)
        return 2
    if options.replay or options.minimise:
        work = replay if options.replay else minimise
        return max(work(name, target, options.replay or options.minimise) for name, target in chosen.items())
    if not has_atheris():
        print(f"atheris is not installed: mutation by hand, coverage is not counted ({INSTALL})")
    print(f"seed {options.seed}; finds are written into {_short(FINDS)}")
    print(f"{'target':<16}{'executions':>12}{'a second':>10}{'edges':>8}  {'in the last tenth':<18}finds", flush=True)
    seconds = 60 * options.minutes / len(chosen) if options.minutes else None
    failed = [name for name, target in chosen.items() if not _fuzz(name, target, options, seconds)]
    return 1 if failed else 0


def _shortened(target: Target, longest: int | None) -> Target:
    return target if longest is None else replace(target, max_len=min(longest, target.max_len))


def _short(path: Path) -> Path:
    return path.relative_to(ROOT) if path.is_relative_to(ROOT) else path


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tools.fuzz", description="Fuzz the parsers and machines of dpstack."
    )
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="; ".join(names()))
    parser.add_argument("--minutes", type=float, help="shared among the targets")
    parser.add_argument("--executions", type=int, help="of each target; default: its own number, without --minutes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--longest", type=int, metavar="OCTETS", help="no longer inputs: more of them in the same time")
    parser.add_argument("--work", type=Path, help="folder that keeps inputs with new coverage, to begin with next time")
    parser.add_argument("--replay", type=Path, nargs="+", metavar="FILE", help="run the target once for each FILE")
    parser.add_argument(
        "--minimise", type=Path, nargs="+", metavar="FOLDER", help="choose the corpus from FOLDER and the present one"
    )
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    return parser


def has_atheris() -> bool:
    """Whether atheris can be imported."""
    return importlib.util.find_spec("atheris") is not None


# --- one target in a process of its own ------------------------------------------------------------------------------
def _fuzz(name: str, target: Target, options: argparse.Namespace, seconds: float | None) -> bool:
    """Run one target and print its line; False where it failed."""
    executions = options.executions or (_MOST if seconds else target.executions)
    begun = time.time()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder) if options.work is None else options.work / name
        work.mkdir(parents=True, exist_ok=True)
        report, ended = _run(name, target, executions, seconds, options.seed, work)
    rate = report.executions / report.seconds if report.seconds else 0
    edges = "-" if report.edges is None else str(report.edges)
    found = sorted(path for path in FINDS.glob(f"{name}-*") if path.stat().st_mtime >= begun)
    print(f"{name:<16}{report.executions:>12}{rate:>10.0f}{edges:>8}  {_growth(report):<18}{len(found)}", flush=True)
    for path in found:
        print(f"  replay: python -m tools.fuzz {name} --replay {_short(path)}", flush=True)
    if ended and not found:
        print(f"  the process ended with {ended}", flush=True)
    return not found and not ended


def _growth(report: Report) -> str:
    if report.grown_at is None:
        return "not counted"
    return "grew" if report.grown_at > 0.9 * report.executions else "unchanged"


def _run(
    name: str, target: Target, executions: int, seconds: float | None, seed: int, work: Path
) -> tuple[Report, int]:
    """Run one target in a process of its own; also its exit code."""
    most = _MOST if seconds is None else max(1, int(seconds))
    job = work.parent / f".{work.name}.json"
    limits = {"executions": executions, "seconds": most, "seed": seed}
    of_target = {"covers": target.covers, "compares": target.compares, "longest": target.max_len}
    job.write_text(json.dumps({**limits, "work": str(work), **of_target}))
    command = [sys.executable, "-m", "tools.fuzz", name, "--child", str(job)]
    environment = dict(os.environ, PYTHONHASHSEED="0")
    report = Report(0, 0.0)
    begun = time.monotonic()
    with subprocess.Popen(
        command,
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            _read(line, report)
        ended = process.wait()
    job.unlink()
    report.seconds = report.seconds or time.monotonic() - begun
    return report, ended


def _read(line: str, report: Report) -> None:
    """Take what one line of the process says into ``report``; print lines of its own, as tracebacks of finds."""
    if (match := _PROGRESS.match(line)) is not None:
        report.executions, edges = int(match[1]), int(match[2])
        if edges > (report.edges or 0):
            report.edges, report.grown_at = edges, report.executions
    elif (match := _EXECUTED.match(line)) is not None:
        report.executions = int(match[1])
    elif line.startswith("report "):
        for key, value in json.loads(line.removeprefix("report ")).items():
            setattr(report, key, value)
    elif not _CHATTER.match(line):
        print("  " + line.rstrip(), flush=True)


_CHATTER: Final = re.compile(
    r"INFO:|WARNING: |stat::|Done |#\d|\s+NEW_FUNC|Instrumenting|MERGE|$|######|\"|Dictionary|Re"
)


def _child(name: str, job: dict[str, Any]) -> int:
    """Run the target in this process."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    finds = Finds(name, FINDS)
    if has_atheris():
        _with_atheris(name, finds, job)
    target = _shortened(load(name), job["longest"])
    seeds = [path.read_bytes() for path in corpus(name)]
    limits = {key: job[key] for key in ("executions", "seconds", "seed")}
    print("report " + json.dumps(asdict(by_hand(target, finds, seeds, **limits))), flush=True)
    return 0


def _with_atheris(name: str, finds: Finds, job: dict[str, Any]) -> None:
    """Hand the target to atheris, which ends this process."""
    import atheris

    class Loader(SourceFileLoader):
        """Loads a module of the product with the instructions that count its edges."""

        def get_code(self, fullname: str) -> CodeType | None:
            code = super().get_code(fullname)
            return None if code is None else cast(CodeType, atheris.patch_code(code, job["compares"]))

    class Finder(MetaPathFinder):
        """Finds the modules that the target covers."""

        def find_spec(
            self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
        ) -> ModuleSpec | None:
            if not any(f"{fullname}.".startswith(f"{one}.") for one in job["covers"]):
                return None
            spec = PathFinder.find_spec(fullname, path)
            if spec is not None and isinstance(spec.loader, SourceFileLoader):
                spec.loader = Loader(spec.loader.name, spec.loader.path)
            return spec

    sys.meta_path.insert(0, Finder())
    target = _shortened(load(name), job["longest"])

    def mutate(octets: bytes, most: int, seed: int) -> bytes:
        return target.mended(bytes(atheris.Mutate(octets, min(most, target.max_len))), random.Random(seed))[:most]

    arguments = [
        sys.argv[0],
        f"-runs={job['executions']}",
        f"-max_total_time={job['seconds']}",
        f"-seed={job['seed']}",
        f"-max_len={target.max_len}",
        f"-timeout={_HANGS_S}",
        f"-rss_limit_mb={_MEMORY_MB}",
        f"-artifact_prefix={FINDS}/{name}-",
        "-len_control=0",
        "-print_final_stats=1",
        *_dictionary(target, Path(job["work"]).with_suffix(".dict")),
        job["work"],
        *([str(CORPUS / name)] if corpus(name) else []),
    ]
    FINDS.mkdir(parents=True, exist_ok=True)
    judge = judged(target, finds)
    atheris.Setup(arguments, judge, custom_mutator=mutate) if target.repair else atheris.Setup(arguments, judge)
    atheris.Fuzz()


def _dictionary(target: Target, path: Path) -> list[str]:
    """Write the words of ``target`` as libFuzzer reads them; returns its argument."""
    if not target.words:
        return []
    lines = ('"' + "".join(f"\\x{octet:02X}" for octet in word) + '"' for word in target.words)
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return [f"-dict={path}"]


# --- files of a target -----------------------------------------------------------------------------------------------
def replay(name: str, target: Target, files: Sequence[Path]) -> int:
    """Run ``target`` once for each file; 1 where one of them fails."""
    bad = 0
    for path in files:
        try:
            target.once(path.read_bytes())
        except Exception as error:
            bad += 1
            print(f"{name}: {path} fails\n{_traceback(error)}")
        else:
            print(f"{name}: {path} passes")
    return 1 if bad else 0


def _traceback(error: Exception) -> str:
    """The traceback of ``error``, as ASCII: an input may hold controls of a terminal."""
    return "".join(traceback.format_exception(error)).encode("ascii", "backslashreplace").decode()


def minimise(name: str, target: Target, folders: Sequence[Path]) -> int:
    """Choose the corpus of ``target`` from ``folders`` and the present corpus: few small files reach most lines."""
    files = [*corpus(name), *(path for folder in folders for path in folder.rglob("*") if path.is_file())]
    inputs = {octets for octets in (path.read_bytes() for path in files) if len(octets) <= _FILE_OCTETS}
    lines = {octets: reached(target, octets) for octets in sorted(inputs, key=lambda octets: (len(octets), octets))}
    kept: list[bytes] = []
    left = set[tuple[str, int, int]]().union(*lines.values())
    while left and len(kept) < _FILES:
        best = max(lines, key=lambda octets: len(lines[octets] & left))
        kept.append(best)
        left -= lines[best]
    folder = CORPUS / name
    folder.mkdir(parents=True, exist_ok=True)
    for path in corpus(name):
        if re.fullmatch(r"[0-9a-f]{10}", path.name):
            path.unlink()
    for octets in kept:
        (folder / hashlib.sha1(octets, usedforsecurity=False).hexdigest()[:10]).write_bytes(octets)
    print(f"{name}: {len(kept)} of {len(inputs)} inputs kept; {len(left)} steps that only others take are left out")
    return 0


def reached(target: Target, octets: bytes) -> set[tuple[str, int, int]]:
    """The steps that ``octets`` take in modules that ``target`` covers: file, line, and the line before it."""
    rooms = tuple(str(ROOT / one.replace(".", "/")) for one in target.covers)
    found: set[tuple[str, int, int]] = set()
    mine: dict[CodeType, bool] = {}

    def call(frame: FrameType, event: str, argument: object) -> Any:
        code = frame.f_code
        if code not in mine:
            mine[code] = code.co_filename.startswith(rooms)
        if not mine[code]:
            return None
        name, before = code.co_filename, 0

        def line(frame: FrameType, event: str, argument: object) -> Any:
            nonlocal before
            if event == "line":
                found.add((name, frame.f_lineno, before))
                before = frame.f_lineno
            return line

        return line

    sys.settrace(call)
    try:
        with contextlib.suppress(Exception):
            target.once(octets)
    finally:
        sys.settrace(None)
    return found


if __name__ == "__main__":
    sys.exit(main())
