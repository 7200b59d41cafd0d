"""``python -m bench compare NAME --commit OLD``: an old commit and the working tree, each with its own benchmark.

Figures that both own benchmarks have are compared as they give them. Figures of ``startup`` and of
``application`` that the old one lacks are measured on both sides by bench/commit_probe.py and bench/application.py.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from bench import application, commit_probe, loop_clock
from bench.calibration import Speeds, speeds
from bench.commits import Side, clean, commit_side, packages, tree_side
from bench.machine import load
from bench.paired import (
    PairedComparison,
    Reading,
    Round,
    Run,
    between,
    pairs_of,
    readings_of,
    readings_of_probe,
    take_rounds,
    together,
)
from bench.report import report_of

#: benchmark -> the script that measures its figures from outside
_PROBES: Final = {"startup": Path(commit_probe.__file__), "application": Path(application.__file__)}
_LOOP_CLOCK: Final = Path(loop_clock.__file__)
_RUN_S: Final = 600
_WRONG_USE: Final = 2
_LEAST_ROUNDS: Final = 10
#: at the run that is not judged: on a busy computer slaves may be lost
_ATTEMPTS: Final = 3
#: characters of a complaint at most
_LONGEST_COMPLAINT: Final = 300
#: a load average from which on other programs are worth a note
_BUSY: Final = 1.5


class Plan(NamedTuple):
    """Options of one run of a benchmark, as commits of all ages know them, and the number of rounds
    (1: all figures are exact).

    ``cpu``: all that it measures is CPU time of its own process, so that it can be run on the clock of loops.
    """

    words: str
    rounds: int = 12
    cpu: bool = False


PLANS: Final[Mapping[str, Plan]] = {
    "acyclic": Plan("--bauds 500000 1500000 --pty-bauds", 1),
    "application": Plan("--rounds 1"),
    "codec": Plan("--rounds 3", cpu=True),
    "cycle": Plan("--rounds 1 --slaves 1 16 --kinds asyncio process --seconds 0.5"),
    "connectors": Plan("--rounds 1"),
    "fleet": Plan("--seconds 10 --losses 10 --restarts 1 --recorded 20"),
    "jitter": Plan("--rounds 1 --seconds 2 --cycles 10"),
    "listen": Plan("--rounds 2 --telegrams 4000", cpu=True),
    "live": Plan("--rounds 1"),
    "parameters": Plan("", 1),
    "peers": Plan("--rounds 1 --seconds 1"),
    "ring": Plan("--rounds 1 --seconds 1"),
    "rotation": Plan("--rounds 1 --bauds 500000 1500000 --kinds bare asyncio process"),
    "scale": Plan("--rounds 7 --exchanges 2000 --seconds 0", cpu=True),
    "startup": Plan("--rounds 1"),
    "usb": Plan("--rounds 1 --bauds 500000 --seconds 1"),
    "virtual": Plan("--rounds 5", cpu=True),
}


class LacksError(Exception):
    """A commit has no such benchmark, does not know its options, or prints no JSON; the text says which."""


def compare_with_commit(name: str, commit: str, rounds: int | None = None) -> PairedComparison:
    """Raises ValueError for an unknown commit or too few rounds, RuntimeError when the comparison cannot be made."""
    plan = PLANS[name]
    count = plan.rounds if rounds is None else rounds
    if count < min(plan.rounds, _LEAST_ROUNDS):
        raise ValueError(f"--rounds {count}: a verdict needs {_LEAST_ROUNDS} at least")
    with both_sides(commit) as (sides, notes):
        taken = rounds_of(Commands(name, plan), sides, count, notes)
    pairs = pairs_of(taken)
    titles = (sides[0].title, sides[1].title)
    return PairedComparison(name, titles, taken, [*pairs, *together(taken, pairs)], notes)


@contextlib.contextmanager
def both_sides(commit: str) -> Iterator[tuple[tuple[Side, Side], list[str]]]:
    """The environments of a commit and of the tree, and notes on what may spoil a comparison.

    Raises ValueError for an unknown commit, RuntimeError when an environment cannot be made.
    """
    average = load()
    notes = [] if average is None or average < _BUSY else [f"other programs were running: load average {average}"]
    tell(f"making the environments of {commit} and of the tree, where they are not there yet")
    with commit_side(commit) as old, tree_side() as new:
        if differing := sorted(packages(old) ^ packages(new)):
            notes.append(f"packages that are not the same on both sides: {', '.join(differing)}")
        yield (old, new), notes


def rounds_of(commands: Commands, sides: tuple[Side, Side], count: int, notes: list[str]) -> list[Round]:
    """``count`` rounds of both sides. Raises RuntimeError."""
    measured = Measured(commands, sides, notes)
    taken = []
    for both in take_rounds(count, measured.round, notes):
        taken.append(both)
        tell(f"{commands.name}: {len(taken)} of {count} rounds")
    return taken


class Commands:
    """Commands of one benchmark: each side's own bench, and the probe. Several sides take turns."""

    def __init__(self, name: str, plan: Plan) -> None:
        self.name = name
        self._plan = plan
        #: whether sides can take turns within a run of their own bench
        self.in_turn = plan.cpu
        #: runs of own benches, and those of them in which other programs had the processors for a good part of the time
        self.runs = self.busy_runs = 0

    def own(self, *sides: Side) -> list[dict[str, Reading]]:
        """Of the sides' own benches. Raises LacksError, RuntimeError when one fails."""
        way = ["-P", str(_LOOP_CLOCK)] if self._plan.cpu else ["-m", "bench"]
        return list(map(self._own, sides, run_in_turn(sides, [*way, self.name, "--json", *self._plan.words.split()])))

    def _own(self, side: Side, ended: Ended) -> dict[str, Reading]:
        if ended.code == _WRONG_USE or "No module named" in ended.complaint:
            raise LacksError(ended.complaint)
        if ended.code:
            raise RuntimeError(f"{side.title}: {ended.complaint}")
        try:
            report = report_of(json.loads(ended.output.splitlines()[-1]))
        except (ValueError, IndexError):
            raise LacksError("it prints no JSON that can be read") from None
        self.runs += 1
        self.busy_runs += report.busy
        return readings_of(report, on_loop_clock=self._plan.cpu)

    def probe(self, *sides: Side) -> list[dict[str, Reading]]:
        """Of the benchmark's probe in the sides' environments, if it has one. Raises RuntimeError when it fails."""
        if self.name not in _PROBES:
            return [{} for _ in sides]
        found = []
        for side, ended in zip(sides, run_in_turn(sides, ["-P", str(_PROBES[self.name])]), strict=True):
            if ended.code:
                raise RuntimeError(f"{side.title}, probe: {ended.complaint}")
            found.append(readings_of_probe(json.loads(ended.output)))
        return found


class Measured:
    """Rounds of two sides. Which figures come from the own benches and which from the probe, a run that is not judged
    decides: the own ones where both have them, so that both sides of a figure are measured in the same way.

    Raises RuntimeError when the two have no figure in common.
    """

    def __init__(
        self,
        commands: Commands,
        sides: tuple[Side, Side],
        notes: list[str],
        calibrate: Callable[[], Speeds] = speeds,
    ) -> None:
        self._commands = commands
        self._sides = sides
        self._calibrate = calibrate
        lacking: list[str] = []
        owns = [self._own(side, lacking) for side in sides]
        probes = commands.probe(*sides)
        own, probed = (both[0].keys() & both[1].keys() for both in (owns, probes))
        self._uses_own = bool(own)
        self._of_probe = probed - own
        if not own and not probed:
            raise RuntimeError(
                f"{sides[0].title} and {sides[1].title} have no figure in common; {'; '.join([*notes, *lacking])}"
            )
        if (owns[0].keys() ^ owns[1].keys()) - probed:  # the probe does not replace all of them
            notes += lacking
        for side, readings in zip(sides, owns, strict=True):
            if alone := readings.keys() - own - probed:
                notes.append(f"only {side.title} has: {'; '.join(name for name in readings if name in alone)}")

    def round(self, order: tuple[int, int]) -> Round:
        """One round, the sides in this order (0: old, 1: new). Raises RuntimeError."""
        runs: dict[int, Run] = {}
        before = self._calibrate()
        for numbers in [order] if self._commands.in_turn else [(number,) for number in order]:
            found = self._readings(numbers)
            after = self._calibrate()
            runs |= {number: Run(found[number], between(before, after)) for number in numbers}
            before = after
        if self._of_probe:
            for number, readings in zip(order, self._commands.probe(*map(self._sides.__getitem__, order)), strict=True):
                wanted = {name: reading for name, reading in readings.items() if name in self._of_probe}
                runs[number] = Run({**runs[number].readings, **wanted}, runs[number].speeds)
        return runs[0], runs[1]

    def _readings(self, numbers: tuple[int, ...]) -> dict[int, dict[str, Reading]]:
        if not self._uses_own:
            return {number: {} for number in numbers}
        try:
            return dict(zip(numbers, self._commands.own(*map(self._sides.__getitem__, numbers)), strict=True))
        except LacksError as error:
            raise RuntimeError(f"a benchmark that ran before does not run: {error}") from None

    def _own(self, side: Side, lacking: list[str]) -> dict[str, Reading]:
        """The figures of its own bench; none, and the reason in ``lacking``, if it cannot measure them."""
        for attempts_left in reversed(range(_ATTEMPTS)):
            try:
                return self._commands.own(side)[0]
            except LacksError as error:
                lacking.append(f"the own bench of {side.title} cannot do this: {error}")
                break
            except RuntimeError:
                if not attempts_left:
                    raise
        return {}


class Ended(NamedTuple):
    """A program that has ended; ``complaint`` is the last line of its error output."""

    code: int
    output: str
    complaint: str


class _Running:
    """A program of a side that waits at the gate of bench/loop_clock.py before each piece of work, if it has such."""

    def __init__(self, side: Side, words: Sequence[str], stack: contextlib.ExitStack) -> None:
        self._title = side.title
        self._out, self._errors = (stack.enter_context(tempfile.TemporaryFile("w+")) for _ in range(2))  # noqa: SIM115
        go, self._go = os.pipe()
        self._ready, ready = os.pipe()
        stack.callback(os.close, self._go)
        stack.callback(os.close, self._ready)
        try:
            self._process = subprocess.Popen(
                [str(side.python), *words],
                cwd=side.root,
                env=clean() | {"BENCH_GATE": f"{go},{ready}"},
                stdin=subprocess.DEVNULL,
                stdout=self._out,
                stderr=self._errors,
                pass_fds=(go, ready),
            )
        finally:
            os.close(go)
            os.close(ready)
        stack.callback(self._process.wait)
        stack.callback(self._process.kill)

    def pin(self, processor: int) -> None:
        """Let it run on this processor only."""
        with contextlib.suppress(OSError):  # it may have ended
            os.sched_setaffinity(self._process.pid, {processor})

    def waits(self) -> bool:
        """Let it work until it waits at its gate; False when it has ended. Raises RuntimeError when neither comes."""
        if not select.select([self._ready], (), (), _RUN_S)[0]:
            raise RuntimeError(f"{self._title}: a run took longer than {_RUN_S} s")
        return bool(os.read(self._ready, 1))

    def go(self) -> bool:
        """Open its gate once; False when it has ended."""
        with contextlib.suppress(BrokenPipeError):
            os.write(self._go, b"g")
        return self.waits()

    def ended(self) -> Ended:
        """Once it has closed its end of the gate."""
        code = self._process.wait(_RUN_S)
        for file in (self._out, self._errors):
            file.seek(0)
        output, errors = self._out.read(), self._errors.read()
        return Ended(code, output, (errors.strip().splitlines() or [""])[-1][:_LONGEST_COMPLAINT])


def run_in_turn(sides: Sequence[Side], words: Sequence[str]) -> list[Ended]:
    """The same words on each side, their pieces of work in turn. Raises RuntimeError when that takes too long."""
    with contextlib.ExitStack() as stack:
        programs = [_Running(side, words, stack) for side in sides]
        if len(programs) > 1 and hasattr(os, "sched_getaffinity"):
            processor = min(os.sched_getaffinity(0))
            for program in programs:  # a processor with a busy neighbour shall meet both of them
                program.pin(processor)
        waiting = [program for program in programs if program.waits()]
        while waiting:
            waiting = [program for program in waiting if program.go()]
        return [program.ended() for program in programs]


def tell(text: str) -> None:
    """Progress, for the one who waits."""
    print(f"bench: {text}", file=sys.stderr, flush=True)
