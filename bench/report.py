"""Report of a benchmark: figures with their unit, the rounds they come from, goals as ratios of one run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from statistics import median
from typing import cast

from bench.calibration import PYTHON
from bench.machine import load, machine


@dataclass
class Figure:
    """One figure; ``goal`` is a bound where the project has set one: an upper, where ``more`` is better a lower one.

    ``rounds`` are the values of the single rounds that ``value`` sums up, empty where there was one only. ``exact``: it
    is the same on every machine, however busy. ``raw_us``: of a figure in calibration loops, its rounds in us.
    """

    name: str
    value: float
    unit: str
    goal: float | None = None
    more: bool = False
    rounds: tuple[float, ...] = ()
    exact: bool = False
    raw_us: tuple[float, ...] = ()

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; None without a goal."""
        if self.goal is None:
            return None
        return self.value >= self.goal if self.more else self.value <= self.goal

    @property
    def spread(self) -> float | None:
        """Spread of the rounds as a share of their median: between the quartiles, of few rounds all of them.

        None with less than two rounds: then nothing is known.
        """
        if self.exact:
            return 0.0
        middle = abs(median(self.rounds)) if len(self.rounds) > 1 else 0.0
        if not middle:
            return None
        low, high = (0.25, 0.75) if len(self.rounds) >= 8 else (0.0, 1.0)
        return (quantile(self.rounds, high) - quantile(self.rounds, low)) / middle


@dataclass(frozen=True, slots=True)
class Table:
    """A part of a report's figures as a table for people: figures are named "TITLE, ROW: COLUMN"."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[str, ...]

    def name(self, row: str, column: str) -> str:
        return f"{self.title}, {row}: {column}"

    def lines(self, figures: Mapping[str, Figure]) -> list[str]:
        cells = [
            [f"{figures[name].value:.2f}" if (name := self.name(row, column)) in figures else "-" for row in self.rows]
            for column in self.columns
        ]
        of_columns = zip(self.columns, cells, strict=True)
        widths = [max(map(len, (column, *below))) for column, below in of_columns]
        first = max(map(len, (self.title, *self.rows)))
        head = [f"{column:>{width}}" for column, width in zip(self.columns, widths, strict=True)]
        lines = ["  ".join([f"{self.title:<{first}}", *head])]
        for row, values in zip(self.rows, zip(*cells, strict=True), strict=True):
            right = [f"{value:>{width}}" for value, width in zip(values, widths, strict=True)]
            lines.append("  ".join([f"{row:<{first}}", *right]))
        return lines


@dataclass
class Report:
    """All figures of one benchmark. ``about`` is the machine as it was at the start. ``tables``: figures in them stand
    there, not on lines of their own."""

    name: str
    figures: list[Figure] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    about: dict[str, object] = field(default_factory=machine)
    taken: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    load_at_end: float | None = None
    #: other programs had the processors for a good part of the time: goals are not judged
    busy: bool = False
    tables: list[Table] = field(default_factory=list)

    def add(
        self,
        name: str,
        value: float,
        unit: str,
        goal: float | None = None,
        *,
        more: bool = False,
        rounds: Sequence[float] = (),
    ) -> None:
        """One more figure; ``more``: more of it is better."""
        self.figures.append(Figure(name, value, unit, goal, more, tuple(rounds)))

    def measured(
        self, name: str, rounds: Sequence[float], unit: str, goal: float | None = None, *, more: bool = False
    ) -> None:
        """One more figure, the median of ``rounds``; nothing where there are none."""
        if rounds:
            self.add(name, median(rounds), unit, goal, more=more, rounds=rounds)

    def in_loops(
        self,
        name: str,
        times_ns: Sequence[tuple[float, float]],
        goal: float | None = None,
        *,
        unit: str = PYTHON,
    ) -> None:
        """One more figure: ``times_ns`` are durations, each with the calibration loop of its round."""
        if times_ns:
            rounds = [ns / loop for ns, loop in times_ns]
            raw_us = tuple(ns / 1000 for ns, _ in times_ns)
            self.figures.append(Figure(name, median(rounds), unit, goal, rounds=tuple(rounds), raw_us=raw_us))

    def calibrated(self, name: str, loops_ns: Sequence[float]) -> None:
        """The calibration loop ``name`` itself, in microseconds."""
        self.measured(f"{name} calibration", [ns / 1000 for ns in loops_ns], "us")

    def exact(self, name: str, value: float, unit: str, goal: float | None = None, *, more: bool = False) -> None:
        """One more figure of virtual time."""
        self.figures.append(Figure(name, value, unit, goal, more, exact=True))

    def finished(self) -> Report:
        """This report, with the load average at the end in it."""
        self.load_at_end = load()
        return self

    def as_dict(self) -> dict[str, object]:
        """Plain JSON data: machine, versions, figures and notes."""
        return {
            "benchmark": self.name,
            "taken": self.taken,
            "machine": self.about | {"load_at_end": self.load_at_end},
            "figures": {
                f.name: {
                    "value": _rounded(f.value),
                    "unit": f.unit,
                    "goal": f.goal,
                    "met": f.met if self._judged(f) else None,
                    "more": f.more,
                    "rounds": [_rounded(v) for v in f.rounds],
                }
                | ({"exact": True} if f.exact else {})
                | ({"raw_us": [_rounded(v) for v in f.raw_us]} if f.raw_us else {})
                for f in self.figures
            },
            "busy": self.busy,
            "notes": self.notes,
        }

    def _judged(self, figure: Figure) -> bool:
        return figure.exact or not self.busy

    def as_json(self) -> str:
        """:meth:`as_dict` as one line."""
        return json.dumps(self.as_dict())

    def as_markdown(self) -> str:
        """The table of all figures for a page, below the machine; notes behind it."""
        about = self.about
        head = (
            f"{about.get('processors')} x {about.get('processor')}, {about.get('system')}, "
            f"Python {about.get('python')}, "
            f"load {about.get('load')} at the start, {self.load_at_end} at the end, {self.taken[:10]}"
        )
        rows = [f"| {f.name} | {f.value:.2f} | {f.unit} |" for f in self.figures]
        return "\n".join([head, "", "| figure | value | unit |", "|---|---|---|", *rows, "", *self.notes])

    def as_text(self) -> str:
        about = self.about
        realtime = cast(Mapping[str, object], about.get("realtime", {}))
        lines = [
            f"{self.name}: Python {about.get('python')}, {about.get('processors')} x {about.get('processor')}",
            f"  {about.get('system')}, governor {about.get('governor')}, load {about.get('load')} at the start, "
            f"{self.load_at_end} at the end, real-time priority {realtime.get('priority') or 'not permitted'}",
        ]
        tabled = {table.name(row, column) for table in self.tables for row in table.rows for column in table.columns}
        listed = [f for f in self.figures if f.name not in tabled]
        width = max((len(f.name) for f in listed), default=0)
        for f in listed:
            spread = "" if f.spread is None or f.exact else f"  +-{f.spread / 2:.0%}"
            bound = "" if f.goal is None else f"   goal {'at least' if f.more else 'at most'} {f.goal:g}: "
            verdict = "" if f.goal is None else "not judged" if not self._judged(f) else "met" if f.met else "MISSED"
            lines.append(f"  {f.name:<{width}}  {f.value:>10.2f} {f.unit}{spread}{_raw(f)}{bound}{verdict}")
        by_name = {f.name: f for f in self.figures}
        for table in self.tables:
            lines += ["", *(f"  {line}" for line in table.lines(by_name))]
        return "\n".join(lines + [f"  {note}" for note in self.notes])


def report_of(data: Mapping[str, object]) -> Report:
    """A report from what :meth:`Report.as_dict` gave. Raises ValueError for anything else."""
    try:
        about = dict(cast(Mapping[str, object], data["machine"]))
        report = Report(
            str(data["benchmark"]),
            notes=list(cast(list[str], data["notes"])),
            about=about,
            taken=str(data["taken"]),
            load_at_end=cast("float | None", about.pop("load_at_end", None)),
            busy=bool(data.get("busy", False)),
        )
        for name, each in cast(Mapping[str, Mapping[str, object]], data["figures"]).items():
            report.figures.append(
                Figure(
                    name,
                    cast(float, each["value"]),
                    cast(str, each["unit"]),
                    cast("float | None", each["goal"]),
                    bool(each["more"]),
                    tuple(cast(list[float], each["rounds"])),
                    bool(each.get("exact", False)),
                    tuple(cast(list[float], each.get("raw_us", []))),
                )
            )
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"no report of a benchmark: {error!r}") from None
    return report


def _raw(figure: Figure) -> str:
    return f"  ({duration_text(median(figure.raw_us))})" if figure.raw_us else ""


def duration_text(us: float) -> str:
    """Microseconds in the unit that people would use."""
    return f"{us:.2f} us" if us < 1e4 else f"{us / 1e3:.1f} ms" if us < 1e7 else f"{us / 1e6:.1f} s"


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def quantile(values: Sequence[float], q: float) -> float:
    """The value at or above which a share ``q`` of ``values`` lies (nearest rank). Raises ValueError without values."""
    ordered = sorted(values)
    if not ordered:
        raise ValueError("a round has no values: this computer was too busy; measure again, or in longer rounds")
    return ordered[min(len(ordered) - 1, max(0, round(q * len(ordered)) - 1))]
