"""Paired ratios: two sides measured in turn, the interval of the median ratio, and a verdict in words.

A round measures each side once, the sides in alternating order, the calibration loops before and after. A duration
counts as a multiple of the loops beside it, if it is not in loops already; the ratio of a figure is that of one round,
the median where a run repeated it.
The interval is that of the sign test, which supposes nothing about how the ratios are spread: with ten rounds from the
least to the greatest.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from math import comb, exp, inf, isfinite, log
from statistics import mean, median
from typing import Final, NamedTuple

from bench.calibration import PIPE, PYTHON, Speeds
from bench.report import Figure, Report, duration_text

#: how sure the interval is that the median ratio lies in it: one benchmark has dozens of figures
_CONFIDENCE: Final = 0.99
#: a median nearer to 1 than this is no difference, however still the rounds were
_LEAST: Final = 0.01
#: old and new
SIDES: Final = (0, 1)
#: so many rounds may fail for each that is wanted; they are taken again
_MAY_FAIL: Final = 0.5
_US: Final[Mapping[str, float]] = {"ns": 1e-3, "us": 1.0, "ms": 1e3, "s": 1e6}
#: other people's programs, measured beside ours
_OTHERS: Final = (", construct", ", pyprofibus", "bare, ", "pyprofibus, ")


class Verdict(Enum):
    """Verdict of an interval; for a count, "slower" is more of it."""

    SLOWER = "slower"
    FASTER = "faster"
    NONE = "no difference seen"


class Reading(NamedTuple):
    """A figure of one run. ``beside``: the unit of the calibration that it is judged in, or ``""``.

    ``repeats``: what the run took the median of. ``goal``: the bound that the run's report judged it by, if any.
    """

    value: float
    unit: str
    beside: str = ""
    more: bool = False
    exact: bool = False
    repeats: tuple[float, ...] = ()
    goal: float | None = None


Readings = Mapping[str, Reading]


class Run(NamedTuple):
    """Readings of one side in one round, and the calibration loops beside them."""

    readings: Readings
    speeds: Speeds


Round = tuple[Run, Run]


@dataclass(frozen=True, slots=True)
class Pair:
    """One figure of both sides: medians, the ratio new to old (median, in calibration loops) with its interval."""

    name: str
    unit: str
    beside: str
    old: float
    new: float
    ratio: float
    low: float
    high: float
    verdict: Verdict
    ratios: tuple[float, ...]


# --- what a run says ---


def readings_of(report: Report, *, on_loop_clock: bool = False) -> dict[str, Reading]:
    """The figures of a report, durations in microseconds, without those of other people's programs.

    ``on_loop_clock``: it was made on the clock of bench/loop_clock.py, its microseconds are Python loops.
    """
    readings = {figure.name: _reading(figure) for figure in report.figures if not _ignored(figure.name)}
    if on_loop_clock:
        for name, reading in readings.items():
            if reading.unit == "us":
                readings[name] = reading._replace(unit=PYTHON, beside=PYTHON)
    return readings


def _ignored(name: str) -> bool:
    return name.endswith("calibration") or any(other in name for other in _OTHERS)


def _reading(figure: Figure) -> Reading:
    unit = figure.unit
    reading = Reading(figure.value, unit, "", figure.more, figure.exact, figure.rounds, figure.goal)
    if figure.raw_us:
        return reading._replace(value=median(figure.raw_us), unit="us", beside=unit, repeats=figure.raw_us)
    if unit in _US:
        repeats = tuple(value * _US[unit] for value in figure.rounds)
        return reading._replace(value=figure.value * _US[unit], unit="us", repeats=repeats)
    return reading


def readings_of_probe(figures: Mapping[str, float]) -> dict[str, Reading]:
    """Readings from the output of bench/commit_probe.py: memory, and else Python loops."""
    return {
        name: Reading(value, "KiB") if name.endswith("in KiB") else Reading(value, PYTHON, PYTHON)
        for name, value in figures.items()
    }


# --- rounds ---


def order(number: int) -> tuple[int, int]:
    """Order of the two sides in a round: the old one is first in every second round."""
    return (1, 0) if number % 2 else (0, 1)


def take_rounds(count: int, measure: Callable[[tuple[int, int]], Round], notes: list[str]) -> Iterator[Round]:
    """``count`` rounds; ``measure`` gets the order of the sides. One that fails is taken again and noted.

    Raises RuntimeError when too many fail.
    """
    done, failed = 0, 0
    while done < count:
        try:
            taken = measure(order(done))
        except RuntimeError as error:
            failed += 1
            notes.append(f"round {done + 1} was taken again: {error}")
            if failed > count * _MAY_FAIL:
                raise RuntimeError(f"too many rounds failed, the last one so: {error}") from None
            continue
        done += 1
        yield taken


# --- ratios and verdicts ---


def pairs_of(rounds: Sequence[Round]) -> list[Pair]:
    """Every figure that both sides have in all rounds."""
    common = [name for name in rounds[0][1].readings if all(name in run.readings for both in rounds for run in both)]
    return [_pair(name, rounds) for name in common]


def _pair(name: str, rounds: Sequence[Round]) -> Pair:
    readings = [(old.readings[name], new.readings[name]) for old, new in rounds]
    old, new = readings[0]
    beside = new.beside or old.beside
    ratios = [_ratio(both, name, beside if new.unit == "us" else "") for both in rounds]
    sure = old.exact and new.exact
    low, high = (min(ratios), max(ratios)) if sure else interval(ratios)
    if old.unit != new.unit:
        raise RuntimeError(f"{name} is in {old.unit} on one side and in {new.unit} on the other")
    before, after = (median(reading.value for reading in side) for side in zip(*readings, strict=True))
    verdict = judged(low, median(ratios), high, more=new.more, least=0.0 if sure else _LEAST)
    return Pair(name, new.unit, beside, before, after, median(ratios), low, high, verdict, tuple(ratios))


def _ratio(both: Round, name: str, beside: str) -> float:
    (old, old_loop), (new, new_loop) = ((run.readings[name], _loop(run.speeds, beside)) for run in both)
    pairs = list(zip(old.repeats, new.repeats, strict=False))
    if not pairs or len(old.repeats) != len(new.repeats):
        pairs = [(old.value, new.value)]
    return median(_over(after / new_loop, before / old_loop) for before, after in pairs)


def _over(new: float, old: float) -> float:
    return new / old if old else 1.0 if new == old else inf


def between(before: Speeds, after: Speeds) -> Speeds:
    """The speed of what was measured between two calibrations."""
    return Speeds(*map(mean, zip(before, after, strict=True)))


def _loop(speeds: Speeds, beside: str) -> float:
    return speeds.python if beside == PYTHON else speeds.pipe if beside == PIPE else 1.0


def together(rounds: Sequence[Round], pairs: Sequence[Pair]) -> list[Pair]:
    """For each calibration all figures that are judged in it as one, round by round: the geometric mean of ratios."""
    result = []
    for beside in (PYTHON, PIPE):
        of_it = [p for p in pairs if p.beside == beside and all(isfinite(r) and r > 0 for r in p.ratios)]
        if len(of_it) > 1:
            ratios = [exp(mean(log(p.ratios[n]) for p in of_it)) for n in range(len(rounds))]
            low, high = interval(ratios)
            middle = median(ratios)
            name = f"all {len(of_it)} figures in {beside} together"
            verdict = judged(low, middle, high)
            result.append(Pair(name, "", beside, 1.0, middle, middle, low, high, verdict, tuple(ratios)))
    return result


def interval(values: Sequence[float]) -> tuple[float, float]:
    """Between which the median lies by the sign test; everything when there are too few values to be sure."""
    ordered = sorted(values)
    rank = _rank(len(ordered))
    return (ordered[rank - 1], ordered[-rank]) if rank else (0.0, inf)


def _rank(count: int) -> int:
    """Distance of the interval's bounds from either end; 1: least and greatest value, 0: too few rounds."""
    rank, tail = 0, 1
    while 2 * tail <= (1 - _CONFIDENCE) * 2**count:
        rank += 1
        tail += comb(count, rank)
    return rank


def judged(low: float, middle: float, high: float, *, more: bool = False, least: float = _LEAST) -> Verdict:
    """A verdict from the ratio new to old and its interval; ``more``: more is better."""
    if low <= 1 <= high or (1 - least <= middle <= 1 + least and least):
        return Verdict.NONE
    return Verdict.SLOWER if (middle > 1) is not more else Verdict.FASTER


# --- told ---


@dataclass(frozen=True, slots=True)
class PairedComparison:
    """All that two sides gave. ``titles``: the old one and the new one."""

    name: str
    titles: tuple[str, str]
    rounds: Sequence[Round]
    pairs: Sequence[Pair]
    notes: Sequence[str]

    @property
    def slower(self) -> list[str]:
        """Names of the figures that are slower."""
        return [p.name for p in self.pairs if p.verdict is Verdict.SLOWER]

    def as_json(self) -> str:
        figures = {
            p.name: {
                "old": _plain(p.old),
                "new": _plain(p.new),
                "unit": p.unit,
                "judged_in": p.beside,
                "ratio": _plain(p.ratio),
                "low": _plain(p.low),
                "high": _plain(p.high),
                "verdict": p.verdict.value,
                "ratios": [_plain(r) for r in p.ratios],
            }
            for p in self.pairs
        }
        data = {
            "benchmark": self.name,
            "old": self.titles[0],
            "new": self.titles[1],
            "rounds": len(self.rounds),
            "calibrations": {
                "python_us": [_plain(run.speeds.python / 1000) for both in self.rounds for run in both],
                "pipe_us": [_plain(run.speeds.pipe / 1000) for both in self.rounds for run in both],
            },
            "figures": figures,
            "slower": self.slower,
            "notes": list(self.notes),
        }
        return json.dumps(data)

    def as_text(self) -> str:
        width = max((len(p.name) for p in self.pairs), default=0)
        lines = [f"{self.name}: {self.titles[0]} (old) and {self.titles[1]} (new), {len(self.rounds)} rounds"]
        for title, number in (("Python", 0), ("pipe", 1)):
            loops = [run.speeds[number] / 1000 for both in self.rounds for run in both]
            lines.append(f"  {title} calibration {median(loops):.2f} us, from {min(loops):.2f} to {max(loops):.2f}")
        lines.append(f"  {'':<{width}} {'old':>12} {'new':>12} {'new/old':>8}  {'99 % sure':<14}")
        for p in self.pairs:
            old, new = (_value(v, p.unit) for v in (p.old, p.new))
            sure = f"{p.low:.3f} to {p.high:.3f}"
            lines.append(f"  {p.name:<{width}} {old:>12} {new:>12} {p.ratio:>8.3f}  {sure:<14}  {p.verdict.value}")
        return "\n".join(lines + [f"  {note}" for note in self.notes])


def _value(value: float, unit: str) -> str:
    number = f"{value:.3f}" if value < 1000 else f"{value:.0f}"
    return duration_text(value) if unit == "us" else f"{number} loops" if unit == PYTHON else number


def _plain(value: float) -> float | None:
    return float(f"{value:.6g}") if isfinite(value) else None
