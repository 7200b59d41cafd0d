"""Reports of benchmarks: kept, read again, compared; the table of the goals: made-up rounds of an old and a new
side, ratios worked out by hand."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from bench import __main__ as cli
from bench import goals
from bench.calibration import PYTHON, Speeds
from bench.commits import Side
from bench.goals import SUITES, Goal, GoalTable, Suite, rows_of
from bench.paired import Reading, Round, Run
from bench.report import Report, Table, report_of
from bench.rig import Taken, note_disturbance
from bench.rounds import Commands

#: what every report says of the machine
MACHINE = {
    "python",
    "system",
    "processor",
    "processors",
    "usable_processors",
    "governor",
    "load",
    "load_at_end",
    "realtime",
    "versions",
}


def made(**figures: list[float]) -> Report:
    """A report of the benchmark "scale" with the figures' rounds; names with "per_s" are better when they are more."""
    report = Report("scale")
    for name, rounds in figures.items():
        report.measured(name, rounds, "1/s" if "per_s" in name else "us", more="per_s" in name)
    return report


def test_a_report_says_what_it_was_taken_on_and_comes_back_from_its_json() -> None:
    report = Report("scale", notes=["a note"])
    report.add("one", 1.5, "us", 2.0)
    report.measured("rate", [9.0, 10.0, 14.0], "1/s", 12.0, more=True)
    report.measured("nothing", [], "us")
    data = json.loads(report.finished().as_json())
    assert set(data["machine"]) == MACHINE
    assert {"dpstack", "construct", "pyprofibus"} <= set(data["machine"]["versions"])
    assert data["figures"] == {
        "one": {"value": 1.5, "unit": "us", "goal": 2.0, "met": True, "more": False, "rounds": []},
        "rate": {"value": 10.0, "unit": "1/s", "goal": 12.0, "met": False, "more": True, "rounds": [9.0, 10.0, 14.0]},
    }
    again = report_of(data)
    assert again.as_dict() == report.as_dict()
    text = report.as_text()
    assert "goal at most 2: met" in text
    assert "goal at least 12: MISSED" in text
    assert "+-25%" in text  # half of (14 - 9) / 10


def test_on_a_busy_machine_no_goal_is_judged() -> None:
    report = Report("scale")
    report.add("one", 1.5, "us", 2.0)
    note_disturbance(report, [Taken(1.0, 1, 1, waited, [], 0, [], []) for waited in (0.0, 0.01, 0.6)])
    assert (report.busy, report.notes) == (False, [])
    note_disturbance(report, [Taken(1.0, 1, 1, waited, [], 0, [], []) for waited in (0.0, 0.3, 0.6)], "at 3 Mbit/s")
    assert report.notes == [
        "at 3 Mbit/s: other programs had the processors 30% of the time (median): these figures are theirs too"
    ]
    assert "goal at most 2: not judged" in report.as_text()
    again = report_of(json.loads(report.as_json()))
    assert again.busy


def test_figures_of_a_table_stand_in_it_and_not_on_lines_of_their_own() -> None:
    report = Report("jitter")
    report.add("alone", 1.0, "us")
    report.add("3 Mbit/s, bare: read", 1.25, "us")
    report.add("3 Mbit/s, asyncio: read", 12.5, "us")
    report.tables.append(Table("3 Mbit/s", ("read", "pump"), ("bare", "asyncio")))
    head, *lines = report.as_text().splitlines()[1:]
    assert "Python" not in head
    assert lines == [
        "  alone        1.00 us",
        "",
        "  3 Mbit/s   read  pump",
        "  bare       1.25     -",
        "  asyncio   12.50     -",
    ]


STILL = Speeds(500.0, 800.0)
SIDES = (Side("old", Path("old"), Path("old/python")), Side("new", Path("new"), Path("new/python")))


def rounds_with(old: Sequence[dict[str, float]], new: Sequence[dict[str, float]], unit: str = "") -> list[Round]:
    """Rounds of figures of this unit."""
    readings = [[{n: Reading(v, unit, goal=1.0) for n, v in values.items()} for values in side] for side in (old, new)]
    return [(Run(before, STILL), Run(after, STILL)) for before, after in zip(*readings, strict=True)]


def suite(*of: Goal) -> Suite:
    return Suite("gsd", "--files 60", of)


def test_a_goal_to_today_is_judged_by_the_ratio_of_pairs() -> None:
    rounds = rounds_with([{"cpu": 10.0}, {"cpu": 20.0}, {"cpu": 11.0}], [{"cpu": 5.0}, {"cpu": 12.0}, {"cpu": 6.05}])
    for limit, verdict in ((0.6, "met"), (0.5, "MISSED")):
        (row,) = rows_of("files", suite(Goal("CPU", "cpu", limit, to_today=True)), rounds)
        assert (row.old, row.new, row.verdict) == ("11.000", "6.050", verdict)
        assert (row.low, row.ratio, row.high) == pytest.approx((0.5, 0.55, 0.6))


def test_a_figure_that_is_a_ratio_is_judged_itself_and_that_of_today_stands_beside_it() -> None:
    rounds = rounds_with([{"to": 0.4}] * 3, [{"to": 0.2}, {"to": 0.3}, {"to": 0.24}])
    (row,) = rows_of("files", suite(Goal("CPU to another's", "to", 0.25)), rounds)
    assert row.cells == (
        "CPU to another's: at most 0.25",
        "0.4",
        "0.24",
        "0.24",
        "0.20 to 0.30",
        "met",
        "python -m bench goals --only files",
    )


def test_where_an_old_bench_lacks_the_ratio_it_is_the_quotient_of_two_figures_of_its_run() -> None:
    goal = Goal("efficiency", "to bare", 0.9, more=True, quotient=("own", "bare"))
    old = {"own": 0.6, "bare": 0.8}
    (row,) = rows_of("files", suite(goal), rounds_with([old] * 2, [old | {"to bare": 0.95}] * 2))
    assert (row.old, row.new, row.verdict) == ("0.75", "0.95", "met")
    # a duration in microseconds and one in Python loops, of which one takes half a microsecond
    own, other = Reading(60.0, "us", PYTHON), Reading(100.0, PYTHON, PYTHON)
    new = Reading(1.0, "ratio", goal=0.9)
    (row,) = rows_of("files", suite(goal), [(Run({"own": own, "bare": other}, STILL), Run({"to bare": new}, STILL))])
    assert row.old == "1.2"


def test_what_the_benchmark_does_not_judge_in_most_rounds_has_no_verdict() -> None:
    readings = [Reading(0.5, "ratio", goal=goal) for goal in (0.9, None, None)]
    rounds = [(Run({}, STILL), Run({"to bare": reading}, STILL)) for reading in readings]
    goal = Goal("efficiency", "to bare", 0.9, more=True)
    assert [row.verdict for row in rows_of("files", suite(goal), rounds)] == ["no verdict"]
    assert [row.verdict for row in rows_of("files", suite(goal), rounds[:2])] == ["MISSED"]


def test_where_other_programs_had_the_processors_no_goal_is_judged() -> None:
    goals_of = (Goal("ratio", "to", 1.0), Goal("shown", "to", None), Goal("CPU", "cpu", 1.0, to_today=True))
    rounds = rounds_with([{"cpu": 1.0}], [{"cpu": 2.0, "to": 2.0}])
    assert [row.verdict for row in rows_of("files", suite(*goals_of), rounds)] == ["MISSED", "", "MISSED"]
    rows = rows_of("files", suite(*goals_of), rounds, judged=False)
    assert [row.verdict for row in rows] == ["not judged", "", "not judged"]
    assert rows[1].cells[0] == "shown"


def test_a_run_of_the_tree_alone_has_rounds_of_its_own() -> None:
    reading = Reading(0.6, "", repeats=(0.4, 0.5, 0.9), goal=1.0)  # it has summed them up in its own way
    rounds = [(Run({}, STILL), Run({"to": reading}, STILL))]
    goal = Goal("ratio", "to", 1.0)
    (row,) = rows_of("files", Suite("gsd", "", [goal], alone=True), rounds)
    assert (row.old, row.low, row.ratio, row.high) == ("-", 0.4, 0.6, 0.9)
    (row,) = rows_of("files", suite(goal), rounds)
    assert (row.low, row.ratio, row.high) == (0.6, 0.6, 0.6)


def test_figures_that_one_side_or_nobody_has_are_told_and_not_judged() -> None:
    new_only = rounds_with([{}] * 2, [{"to": 0.2, "cpu": 3.0}] * 2)
    (row,) = rows_of("files", suite(Goal("CPU to another's", "to", 0.25)), new_only)
    assert (row.old, row.new, row.verdict) == ("-", "0.2", "met")
    (row,) = rows_of("files", suite(Goal("CPU", "cpu", 0.6, to_today=True)), new_only)
    assert (row.old, row.new, row.ratio, row.verdict) == ("-", "3", None, "no figure of today")
    rows = rows_of("files", suite(Goal("CPU", "cpu", 0.6, to_today=True), Goal("ratio", "to", 1.0)), [])
    assert [row.verdict for row in rows] == ["not measured"] * 2


def test_the_spread_of_eight_rounds_is_the_interval_of_the_median() -> None:
    values = [{"to": float(n)} for n in range(20)]
    (row,) = rows_of("files", suite(Goal("ratio", "to", 100.0)), rounds_with(values, values))
    assert (row.low, row.high) == (3.0, 16.0)


def test_the_table_is_text_markdown_and_json() -> None:
    rows = rows_of(
        "files",
        suite(Goal("CPU", "cpu", 0.6, to_today=True), Goal("ratio", "to", 1.0)),
        rounds_with([{"cpu": 10.0}], [{"cpu": 5.0}], PYTHON),
    )
    table = GoalTable(("old", "new"), 1, rows, ["a note"])
    assert table.as_text().splitlines() == [
        "today: old, now: new, 1 rounds in turn; "
        "spread: 99 % interval of the median, of less than 8 rounds the least and the greatest",
        "  goal                         today         now          ratio  spread",
        "  CPU: at most 0.6 of today's  10.000 loops  5.000 loops  0.50   0.50 to 0.50  met",
        "  ratio: at most 1             -             -            -      -             not measured",
        "  python -m bench goals --only files",
        "  a note",
    ]
    cells = "CPU: at most 0.6 of today's | 10.000 loops | 5.000 loops | 0.50 | 0.50 to 0.50 | met"
    assert f"| {cells} | `python -m bench goals --only files` |" in table.as_markdown().splitlines()
    first, second = json.loads(table.as_json())["rows"]
    assert (first["ratio"], first["ratios"], first["verdict"]) == (0.5, [0.5], "met")
    assert second["ratio"] is None


class Sides:
    """Both sides without their environments."""

    def __enter__(self) -> tuple[tuple[Side, Side], list[str]]:
        return SIDES, []

    def __exit__(self, *_exc: object) -> None:
        pass


def test_a_benchmark_that_fails_is_a_note_and_its_goals_are_not_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*words: object, **_words: object) -> list[Round]:
        if isinstance(notes := words[-1], list):
            notes += ["only the tree as it stands has: another figure", "round 1 was taken again: slaves were lost"]
        raise RuntimeError("the wire did not start")

    monkeypatch.setattr(goals, "both_sides", lambda commit: Sides())
    monkeypatch.setattr(goals, "rounds_of", fails)
    monkeypatch.setattr(Commands, "own", fails)
    assert cli.main(["goals", "--only", "paced", "ring", "--json"]) == 1
    out, err = capsys.readouterr()
    assert err.count("not measured") == len(SUITES["paced"].goals) + len(SUITES["ring"].goals)
    assert "bench:   ring: the wire did not start\n" in err
    told = json.loads(out)
    assert told["notes"] == [
        "paced: round 1 was taken again: slaves were lost",
        "paced: the wire did not start",
        "ring: the wire did not start",
    ]
    assert {row["verdict"] for row in told["rows"]} == {"not measured"}


def test_every_goal_is_a_figure_of_a_benchmark_that_exists(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["goals", "--list"]) == 0
    listed = capsys.readouterr().out
    for name, each in SUITES.items():
        assert each.benchmark in cli.BENCHMARKS
        assert f"{name:<8} {each.command}" in listed
        assert all(goal.text in listed for goal in each.goals)
        assert each.goals
