"""``python -m bench compare NAME --commit OLD``: an old commit and the working tree, each with its own benchmark.

Figures that both own benchmarks have are compared as they give them; what the old one lacks is measured on both sides
by bench/commit_probe.py.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from bench import commit_probe, loop_clock
from bench.calibration import speeds
from bench.commits import Side, clean, commit_side, tree_side
from bench.machine import load
from bench.paired import PairedComparison, Reading, pairs_of, readings_of, readings_of_probe, take_rounds, together
from bench.report import report_of

_PROBE: Final = Path(commit_probe.__file__)
_LOOP_CLOCK: Final = Path(loop_clock.__file__)
_RUN_S: Final = 600
_WRONG_USE: Final = 2
_LEAST_ROUNDS: Final = 10
#: at the run that is not judged: on a busy computer slaves may be lost
_ATTEMPTS: Final = 3
#: octets of a complaint
_TOLD: Final = 300
#: a load average from which on other programs are worth a note
_BUSY: Final = 1.5


class Plan(NamedTuple):
    """How one run of a benchmark is called, in options that commits of all ages know, and how many rounds there are.

    ``cpu``: all that it measures is CPU time of its own process, so that it can be run on the clock of loops.
    """

    words: str
    rounds: int = 12
    cpu: bool = False


PLANS: Final[Mapping[str, Plan]] = {
    "acyclic": Plan("--bauds 500000 1500000 --pty-bauds", 10),
    "codec": Plan("--rounds 3", 16, cpu=True),
    "cycle": Plan("--rounds 1 --slaves 1 16 --kinds asyncio process --seconds 0.5"),
    "gsd": Plan("--rounds 1 --files 60", 16, cpu=True),
    "jitter": Plan("--rounds 1 --seconds 2 --cycles 10"),
    "parameters": Plan("", 10),
    "rotation": Plan("--rounds 1 --bauds 500000 1500000 --kinds bare asyncio process"),
    "scale": Plan("--rounds 3 --exchanges 2000 --seconds 0.2 --pty-rounds 1", cpu=True),
    "startup": Plan("--rounds 1"),
    "usb": Plan("--rounds 1 --bauds 500000 --seconds 1"),
    "virtual": Plan("--rounds 3", 16, cpu=True),
}


class LacksError(Exception):
    """A commit has no such benchmark, does not know its options, or prints no JSON; the text says which."""


def compare_with_commit(name: str, commit: str, rounds: int | None = None) -> PairedComparison:
    """Raises ValueError for an unknown commit or too few rounds, RuntimeError when the comparison cannot be made."""
    plan = PLANS[name]
    count = plan.rounds if rounds is None else rounds
    if count < _LEAST_ROUNDS:
        raise ValueError(f"--rounds {count}: a verdict needs {_LEAST_ROUNDS} at least")
    average = load()
    notes = [] if average is None or average < _BUSY else [f"other programs were running: load average {average}"]
    _tell(f"making the environments of {commit} and of the tree, where they are not there yet")
    with commit_side(commit) as old, tree_side() as new:
        measured = Measured(Commands(name, plan), (old, new), notes)
        taken = []
        for both in take_rounds(count, measured, speeds, notes):
            taken.append(both)
            _tell(f"{name}: {len(taken)} of {count} rounds")
    pairs = pairs_of(taken)
    return PairedComparison(name, (old.title, new.title), taken, [*pairs, *together(taken, pairs)], notes)


class Commands:
    """What is started for one benchmark on a side: its own bench, and the probe."""

    def __init__(self, name: str, plan: Plan) -> None:
        self._name = name
        self._plan = plan

    def own(self, side: Side) -> dict[str, Reading]:
        """Of the side's own bench. Raises LacksError, RuntimeError when it fails."""
        way = ["-P", str(_LOOP_CLOCK)] if self._plan.cpu else ["-m", "bench"]
        code, out, error = _run(side, [str(side.python), *way, self._name, "--json", *self._plan.words.split()])
        if code == _WRONG_USE or "No module named" in error:
            raise LacksError(error)
        if code:
            raise RuntimeError(f"{side.title}: {error}")
        try:
            return readings_of(report_of(json.loads(out.splitlines()[-1])), on_loop_clock=self._plan.cpu)
        except (ValueError, IndexError):
            raise LacksError("it prints no JSON that can be read") from None

    def probe(self, side: Side) -> dict[str, Reading]:
        """Of the probe in the side's environment. Raises RuntimeError when it fails."""
        code, out, error = _run(side, [str(side.python), "-P", str(_PROBE), self._name])
        if code:
            raise RuntimeError(f"{side.title}, probe: {error}")
        return readings_of_probe(json.loads(out))


class Measured:
    """One run of a side. Which figures come from the own benches and which from the probe, a run that is not judged
    decides: the own ones where both have them, so that both sides of a figure are measured in the same way.

    Raises RuntimeError when the two have no figure in common.
    """

    def __init__(self, commands: Commands, sides: tuple[Side, Side], notes: list[str]) -> None:
        self._commands = commands
        self._sides = sides
        owns = [self._own(side, notes) for side in sides]
        probes = [commands.probe(side) for side in sides]
        own, probed = (both[0].keys() & both[1].keys() for both in (owns, probes))
        self._uses_own = bool(own)
        self._of_probe = probed - own
        if not own and not probed:
            raise RuntimeError(f"{sides[0].title} and {sides[1].title} have no figure in common; {'; '.join(notes)}")
        for side, readings in zip(sides, owns, strict=True):
            if alone := readings.keys() - own - probed:
                notes.append(f"only {side.title} has: {'; '.join(name for name in readings if name in alone)}")

    def __call__(self, number: int) -> dict[str, Reading]:
        """The readings of a side, 0: old, 1: new. Raises RuntimeError."""
        side = self._sides[number]
        readings: dict[str, Reading] = {}
        if self._uses_own:
            try:
                readings |= self._commands.own(side)
            except LacksError as error:
                raise RuntimeError(f"{side.title}: {error}") from None
        if self._of_probe:
            probed = self._commands.probe(side)
            readings |= {name: reading for name, reading in probed.items() if name in self._of_probe}
        return readings

    def _own(self, side: Side, notes: list[str]) -> dict[str, Reading]:
        for attempts_left in reversed(range(_ATTEMPTS)):
            try:
                return self._commands.own(side)
            except LacksError as error:
                notes.append(f"the own bench of {side.title} cannot do this: {error}")
                break
            except RuntimeError:
                if not attempts_left:
                    raise
        return {}


def _run(side: Side, words: Sequence[str]) -> tuple[int, str, str]:
    """Exit code, output, and the last line of what it complained about."""
    try:
        ended = subprocess.run(
            words, cwd=side.root, env=clean(), stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_RUN_S
        )
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"{side.title}: a run took longer than {_RUN_S} s") from None
    return ended.returncode, ended.stdout, (ended.stderr.strip().splitlines() or [""])[-1][:_TOLD]


def _tell(text: str) -> None:
    print(f"bench: {text}", file=sys.stderr)
