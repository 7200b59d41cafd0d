"""``python -m bench goals --commit OLD``: the goals of speed in one table, an old commit and the tree in turn.

A goal bounds either the ratio of a figure to that of the old commit, in pairs, or a figure that is a ratio itself
(to another program, or to a bare loop, in the same round). The benchmarks that hold the figures run as in
``compare NAME --commit OLD``, in short runs of the options given here.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Final, NamedTuple

from bench import application
from bench.calibration import PYTHON, Speeds, speeds
from bench.commit_probe import COMMANDS
from bench.commits import Side
from bench.masters import DRIVERS
from bench.options import count
from bench.paired import SIDES, Pair, Reading, Round, Run, between, interval, pairs_of
from bench.report import duration_text
from bench.rounds import Commands, LacksError, Plan, both_sides, rounds_of, tell

#: the commit that the goals were set against
TODAY: Final = "0b0e17eb"
_UP: Final = "process, 32 slaves behind a pty in data exchange"
_ROUNDS: Final = 8
#: with fewer rounds the table gives the least and the greatest ratio
_ENOUGH: Final = 8
_MET: Final = "met"
_MISSED: Final = "MISSED"
#: other programs had the processors
_NOT_JUDGED: Final = "not judged"


class Goal(NamedTuple):
    """A bound of a figure; None: the figure is only shown. ``to_today``: a bound of its ratio to the old commit's.

    ``quotient``: two figures of a run whose ratio stands for the figure where the old commit's benchmark lacks that.
    """

    text: str
    figure: str
    limit: float | None
    to_today: bool = False
    more: bool = False
    quotient: tuple[str, str] | None = None


class Suite(NamedTuple):
    """Goals whose figures come from one run of a benchmark with these options; ``cpu``: as in :class:`Plan`.
    ``alone``: the old commit has no such figures, and the tree is measured in one run with rounds of its own."""

    benchmark: str
    words: str
    goals: Sequence[Goal]
    cpu: bool = False
    alone: bool = False

    @property
    def command(self) -> str:
        """One run of it."""
        return f"python -m bench {self.benchmark} {self.words}".rstrip()


def _efficiency(rate: str, limit: float) -> list[Goal]:
    return [
        Goal(
            f"efficiency at {rate} to a bare loop's, {kind}",
            f"{rate}, {kind}: efficiency to the bare loop's",
            limit,
            more=True,
            quotient=(f"{rate}, {kind}: efficiency p50", f"{rate}, bare: efficiency p50"),
        )
        for kind in DRIVERS
    ]


#: name -> what is run, in the order of the table
SUITES: Final[Mapping[str, Suite]] = {
    "alone": Suite(
        "scale",
        "--rounds 3 --exchanges 1500 --seconds 0 --slaves 10",
        [Goal("CPU per exchange, master alone", "no medium, 10 slaves: CPU time per exchange", 0.80, to_today=True)],
        cpu=True,
    ),
    "paced": Suite(
        "rotation",
        "--rounds 1 --bauds 500000 --kinds bare asyncio process",
        [
            Goal(
                f"CPU per exchange at 500 kbit/s to a bare loop's, {kind}",
                f"500 kbit/s, {kind}: CPU time per exchange to the bare loop's",
                1.15,
                quotient=(f"500 kbit/s, {kind}: CPU time per exchange", "500 kbit/s, bare: CPU time per exchange"),
            )
            for kind in DRIVERS
        ],
    ),
    **{
        f"virtual{rate}": Suite(
            "virtual",
            f"--rounds 3 --slaves 10 --baud {rate}",
            [
                Goal(
                    f"CPU of an exchange in virtual time, {plant}, {rate} bit/s",
                    f"{plant}: CPU per exchange, both ends and the wire",
                    0.6,
                    to_today=True,
                )
                for plant in ("10 mirrors", "10 demag-dedrive, PPO1")
            ],
            cpu=True,
        )
        for rate in (1_500_000, 12_000_000)
    },
    "application": Suite(
        "application",
        "--rounds 1",
        [Goal("CPU of a cycle of an application in virtual time", application.FIGURE, 0.33, to_today=True)],
    ),
    "captures": Suite(
        "listen",
        "--rounds 2 --telegrams 20000",
        [
            Goal(f"CPU of a telegram, {words}", f"{words}, to the codec's decode", 0.5, to_today=True)
            for words in ("monitor FILE", "decode --json FILE")
        ],
        cpu=True,
    ),
    "start": Suite(
        "startup",
        "--rounds 1",
        [
            *(
                Goal(
                    f"CPU of dpstack {words} to that of python -c 'import argparse, json, socket'",
                    f"dpstack {words}: CPU time beside python -c 'import argparse, json, socket'",
                    1.6,
                    quotient=(f"dpstack {words}: CPU time", "python -c 'import argparse, json, socket': CPU time"),
                )
                for words in ("--version", "ctl status")
            ),
            *(
                Goal(title, figure, most, to_today=True)
                for title, figure, most in (
                    ("CPU of opening, process", "open_bus, process, until the first octet: CPU time", 0.5),
                    ("CPU until 32 slaves are in data exchange, process", f"{_UP}: CPU time", 0.6),
                    ("PSS of application and bus process with 32 slaves", f"{_UP}: PSS in KiB", 0.7),
                    *(
                        (f"CPU of dpstack {words}", f"dpstack {words}: CPU time", most)
                        for words, most in zip(COMMANDS, (0.5, 0.5, None, 0.7, 0.7), strict=True)
                    ),
                )
            ),
        ],
    ),
    "rates": Suite(
        "rotation",
        "--rounds 1 --seconds 0.5 --bauds 1500000 3000000 12000000 --kinds bare asyncio process",
        [*_efficiency("1.5 Mbit/s", 0.95), *_efficiency("3 Mbit/s", 0.90), *_efficiency("12 Mbit/s", 0.80)],
    ),
    "ring": Suite(
        "ring",
        "--rounds 4 --seconds 1 --bauds 3000000 6000000 12000000",
        [
            goal
            for kind in DRIVERS
            for goal in (
                Goal(f"ring of two masters, {kind}: tokens lost", f"two masters, {kind}: tokens lost", 0.0),
                Goal(
                    f"ring of two masters, {kind}: efficiency to two bare loops'",
                    f"two masters, {kind}: efficiency to two bare loops'",
                    None,
                ),
            )
        ],
        alone=True,
    ),
}


@dataclass(frozen=True, slots=True)
class Row:
    """A goal and its figures: texts of the old and the new side, the ratio with its spread (None: not measured)."""

    goal: Goal
    old: str
    new: str
    ratio: float | None
    low: float | None
    high: float | None
    ratios: Sequence[float]
    verdict: str
    command: str

    @property
    def cells(self) -> tuple[str, ...]:
        """Words of the table."""
        bound = self.goal.text
        if self.goal.limit is not None:
            bound += f": {'at least' if self.goal.more else 'at most'} {self.goal.limit:g}"
            bound += " of today's" if self.goal.to_today else ""
        spread = f"{self.low:.2f} to {self.high:.2f}" if self.low is not None else "-"
        ratio = f"{self.ratio:.2f}" if self.ratio is not None else "-"
        return bound, self.old, self.new, ratio, spread, self.verdict, self.command


_HEAD: Final = ("goal", "today", "now", "ratio", "spread", "", "command")


@dataclass(frozen=True, slots=True)
class GoalTable:
    """All rows. ``titles``: the old side and the new one."""

    titles: tuple[str, str]
    rounds: int
    rows: Sequence[Row]
    notes: Sequence[str]

    def as_text(self) -> str:
        lines = [self._head(), *_aligned([_HEAD[:-1], *(row.cells[:-1] for row in self.rows)])]
        commands = dict.fromkeys(row.command for row in self.rows)
        return "\n".join([*lines, *(f"  {note}" for note in (*commands, *self.notes))])

    def as_markdown(self) -> str:
        """The table for a page."""
        lines = [_HEAD, ("---",) * len(_HEAD), *((*row.cells[:-1], f"`{row.command}`") for row in self.rows)]
        table = [f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |" for cells in lines]
        return "\n".join([self._head(), "", *table, "", *(f"- {note}" for note in self.notes)])

    def as_json(self) -> str:
        rows = [
            {
                "goal": row.goal.text,
                "figure": row.goal.figure,
                "limit": row.goal.limit,
                "more": row.goal.more,
                "to_today": row.goal.to_today,
                "today": row.old,
                "now": row.new,
                "ratio": row.ratio,
                "low": row.low,
                "high": row.high,
                "ratios": list(row.ratios),
                "verdict": row.verdict,
                "command": row.command,
            }
            for row in self.rows
        ]
        return json.dumps(
            {"today": self.titles[0], "now": self.titles[1], "rounds": self.rounds, "rows": rows, "notes": self.notes}
        )

    def _head(self) -> str:
        spread = "spread: 99 % interval of the median, of less than 8 rounds the least and the greatest"
        return f"today: {self.titles[0]}, now: {self.titles[1]}, {self.rounds} rounds in turn; {spread}"


def _aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  " + "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()


def rows_of(name: str, suite: Suite, rounds: Sequence[Round], *, judged: bool = True) -> list[Row]:
    """The rows of the suite ``name`` from its rounds, each the old side's run and the new one's.

    ``judged``: False where other programs had the processors, so that there is no verdict.
    """
    pairs = {pair.name: pair for pair in pairs_of(rounds)} if rounds else {}
    command = f"python -m bench goals --only {name}"
    rows = [
        _to_today(goal, rounds, pairs, command) if goal.to_today else _itself(goal, suite, rounds, command)
        for goal in suite.goals
    ]
    if judged:
        return rows
    return [replace(row, verdict=_NOT_JUDGED) if row.verdict in (_MET, _MISSED) else row for row in rows]


def _to_today(goal: Goal, rounds: Sequence[Round], pairs: Mapping[str, Pair], command: str) -> Row:
    pair = pairs.get(goal.figure)
    if pair is None:
        new = [run.readings[goal.figure].value for _, run in rounds if goal.figure in run.readings]
        verdict = "no figure of today" if new else "not measured"
        return Row(goal, "-", f"{median(new):.3g}" if new else "-", None, None, None, (), verdict, command)
    low, high = _spread(pair.ratios)
    old, new_text = (_text(value, pair.unit) for value in (pair.old, pair.new))
    verdict = _verdict(goal, pair.ratio, rounds)
    return Row(goal, old, new_text, pair.ratio, low, high, pair.ratios, verdict, command)


def _itself(goal: Goal, suite: Suite, rounds: Sequence[Round], command: str) -> Row:
    old, new = ([v for both in rounds for v in _values(goal, both[side], suite)] for side in SIDES)
    before = f"{median(old):.3g}" if old else "-"
    if not new:
        return Row(goal, before, "-", None, None, None, (), "not measured", command)
    # a run of the tree alone has summed up its rounds itself
    ratio = rounds[0][1].readings[goal.figure].value if suite.alone else median(new)
    low, high = _spread(new)
    return Row(goal, before, f"{ratio:.3g}", ratio, low, high, new, _verdict(goal, ratio, rounds), command)


def _values(goal: Goal, run: Run, suite: Suite) -> Sequence[float]:
    """The figure in a run, its rounds where the run has such; none where neither it nor its quotient is there."""
    readings = run.readings
    if goal.figure in readings:
        reading = readings[goal.figure]
        return reading.repeats if suite.alone and reading.repeats else (reading.value,)
    if goal.quotient is None or not all(name in readings for name in goal.quotient):
        return ()
    over, under = (_in_us(readings[name], run.speeds) for name in goal.quotient)
    return (over / under,) if under else ()


def _in_us(reading: Reading, speeds: Speeds) -> float:
    """A duration in microseconds, whichever of the two units it was read in; anything else as it is."""
    return reading.value * speeds.python / 1000 if reading.unit == PYTHON else reading.value


def _verdict(goal: Goal, ratio: float, rounds: Sequence[Round]) -> str:
    if goal.limit is None:
        return ""
    of_reports = [run.readings[goal.figure].goal for _, run in rounds if goal.figure in run.readings]
    if not goal.to_today and 2 * of_reports.count(None) > len(of_reports):
        return "no verdict"  # the benchmark judged most of its rounds so
    return _MET if (ratio >= goal.limit if goal.more else ratio <= goal.limit) else _MISSED


def _spread(ratios: Sequence[float]) -> tuple[float, float]:
    return interval(ratios) if len(ratios) >= _ENOUGH else (min(ratios), max(ratios))


def _text(value: float, unit: str) -> str:
    number = f"{value:.3f}" if value < 1000 else f"{value:.0f}"
    return (
        duration_text(value) if unit == "us" else f"{number} loops" if unit == PYTHON else f"{number} {unit}".rstrip()
    )


def _alone(commands: Commands, side: Side) -> list[Round]:
    """One run of a side, as a round in which the other has nothing. Raises LacksError, RuntimeError."""
    before = speeds()
    (readings,) = commands.own(side)
    between_both = between(before, speeds())
    return [(Run({}, between_both), Run(readings, between_both))]


def _tell_rows(rows: Sequence[Row], notes: Sequence[str]) -> None:
    """The rows of one part as progress: a run that is cut off has told those of the parts that were over."""
    for line in (*_aligned([_HEAD[:-1], *(row.cells[:-1] for row in rows)]), *(f"  {note}" for note in notes)):
        tell(line)


def measure(names: Sequence[str], commit: str, rounds: int) -> GoalTable:
    """The table. Raises ValueError for an unknown commit, RuntimeError when an environment cannot be made.

    A benchmark that fails is a note, and its goals are rows without figures. The rows of each part are told as soon as
    it is over.
    """
    rows: list[Row] = []
    with both_sides(commit) as (sides, notes):
        for name in names:
            suite = SUITES[name]
            tell(f"{name}: {suite.command}")
            commands = Commands(suite.benchmark, Plan(suite.words, rounds, suite.cpu))
            of_suite: list[str] = []
            taken: list[Round] = []
            try:
                taken = _alone(commands, sides[1]) if suite.alone else rounds_of(commands, sides, rounds, of_suite)
            except (RuntimeError, LacksError) as error:
                of_suite.append(str(error))
            busy = 2 * commands.busy_runs > commands.runs
            if busy:
                of_suite.append(f"other programs had the processors in {commands.busy_runs} of {commands.runs} runs")
            measured = rows_of(name, suite, taken, judged=not busy)
            # figures that only one side has are no loss: the goals name those that count
            noted = [f"{name}: {note}" for note in of_suite if not note.startswith("only ")]
            _tell_rows(measured, noted)
            rows += measured
            notes += noted
        return GoalTable((sides[0].title, sides[1].title), rounds, rows, list(dict.fromkeys(notes)))


def main(argv: list[str], *, as_json: bool) -> int:
    """The command; 1: a goal is missed or could not be measured."""
    parser = argparse.ArgumentParser(prog="python -m bench goals", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--commit", default=TODAY, metavar="OLD", help="the old commit (default: %(default)s)")
    parser.add_argument("--only", nargs="+", choices=SUITES, default=list(SUITES), help="these goals only")
    parser.add_argument("--rounds", type=count, default=_ROUNDS, help="of each (default: %(default)s)")
    parser.add_argument("--markdown", action="store_true", help="a table for a page")
    parser.add_argument("--list", action="store_true", help="what would be run, and the goals")
    args = parser.parse_args(argv)
    if args.list:
        for name in args.only:
            print(f"{name:<8} {SUITES[name].command}")
            for goal in SUITES[name].goals:
                print(f"{'':<8} {Row(goal, '', '', None, None, None, (), '', '').cells[0]}")
        return 0
    table = measure(args.only, args.commit, args.rounds)
    print(table.as_json() if as_json else table.as_markdown() if args.markdown else table.as_text())
    return int(any(row.ratio is None or row.verdict == _MISSED for row in table.rows))
