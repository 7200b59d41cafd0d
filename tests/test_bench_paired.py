"""A commit and the tree measured in turn: ratios, intervals, verdicts, order, what is measured how, environments."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import inf
from pathlib import Path

import pytest

from bench import __main__ as cli
from bench import commits, rounds
from bench.calibration import PIPE, PYTHON, Beside, Speeds, calibrate_python
from bench.commits import Side
from bench.loop_clock import LoopClock
from bench.paired import (
    Reading,
    Round,
    Run,
    Verdict,
    interval,
    judged,
    order,
    pairs_of,
    readings_of,
    readings_of_probe,
    take_rounds,
    together,
)
from bench.report import Report
from bench.rounds import PLANS, Commands, Ended, LacksError, Measured, Plan, run_in_turn

OLD = Side("0123456789ab", Path("old"), Path("old/python"))
NEW = Side("the tree as it stands", Path("new"), Path("new/python"))
STILL = Speeds(500.0, 800.0)


def round_of(old: dict[str, Reading], new: dict[str, Reading], *speeds: Speeds) -> Round:
    return Run(old, speeds[0] if speeds else STILL), Run(new, speeds[-1] if speeds else STILL)


def rounds_of(values: Sequence[tuple[float, float]], reading: Reading) -> list[Round]:
    return [round_of({"a": reading._replace(value=old)}, {"a": reading._replace(value=new)}) for old, new in values]


# --- arithmetic ---


@pytest.mark.parametrize(
    ("count", "low", "high"),
    [(7, 0.0, inf), (8, 1, 8), (10, 1, 10), (11, 1, 11), (12, 2, 11), (16, 3, 14), (20, 4, 17)],
)
def test_the_interval_is_that_of_the_sign_test_with_99_percent(count: int, low: float, high: float) -> None:
    assert interval([float(n) for n in range(count, 0, -1)]) == (low, high)


@pytest.mark.parametrize(
    ("low", "middle", "high", "more", "verdict"),
    [
        (1.02, 1.05, 1.08, False, Verdict.SLOWER),
        (0.92, 0.95, 0.98, False, Verdict.FASTER),
        (1.02, 1.05, 1.08, True, Verdict.FASTER),
        (0.92, 0.95, 0.98, True, Verdict.SLOWER),
        (0.98, 1.05, 1.08, False, Verdict.NONE),
        (1.001, 1.005, 1.02, False, Verdict.NONE),  # sure, and too little to matter
        (1.0, 1.2, inf, False, Verdict.NONE),
    ],
)
def test_a_verdict_needs_the_whole_interval_on_one_side(
    low: float, middle: float, high: float, more: bool, verdict: Verdict
) -> None:
    assert judged(low, middle, high, more=more) is verdict


def test_a_computer_that_becomes_slower_meets_both_sides() -> None:
    """The new side needs a tenth more in every round, while the computer's speed halves again and again."""
    taken = []
    for n in range(10):
        pace = 1.0 + n % 2
        old, new = (Reading(10 * pace * more, "us", PYTHON) for more in (1.0, 1.1))
        taken.append(round_of({"a": old}, {"a": new}, Speeds(500 * pace, 800.0)))
    (pair,) = pairs_of(taken)
    assert pair.ratios == pytest.approx([1.1] * 10)
    assert (pair.low, pair.ratio, pair.high) == pytest.approx((1.1, 1.1, 1.1))
    assert (pair.old, pair.new) == pytest.approx((15.0, 16.5))
    assert pair.verdict is Verdict.SLOWER


def test_each_figure_is_judged_in_its_own_calibration() -> None:
    slow_python, slow_pipe = Speeds(1000.0, 800.0), Speeds(500.0, 1600.0)
    figures = {
        "cpu": Reading(10.0, "us", PYTHON),
        "turn": Reading(10.0, "us", PIPE),
        "wall": Reading(10.0, "us"),
        "loops": Reading(10.0, PYTHON, PYTHON),
    }
    of_python = {p.name: p.ratio for p in pairs_of([round_of(figures, figures, STILL, slow_python)] * 10)}
    assert of_python == {"cpu": 0.5, "turn": 1.0, "wall": 1.0, "loops": 1.0}
    of_pipe = {p.name: p.ratio for p in pairs_of([round_of(figures, figures, STILL, slow_pipe)] * 10)}
    assert of_pipe == {"cpu": 1.0, "turn": 0.5, "wall": 1.0, "loops": 1.0}


def test_an_old_report_does_not_know_what_the_new_one_is_judged_in() -> None:
    old, new = Reading(10.0, "us", ""), Reading(20.0, "us", PYTHON)
    (pair,) = pairs_of([round_of({"a": old}, {"a": new}, STILL, Speeds(1000.0, 800.0))] * 10)
    assert (pair.beside, pair.ratio) == (PYTHON, 1.0)


NOISY = [(10.0, 10.0 + 0.2 * (-1) ** n) for n in range(11)]


@pytest.mark.parametrize(
    ("values", "exact", "ratio", "verdict"),
    [
        pytest.param([(10.0, 11.0)] * 11 + [(10.0, 5.0)], False, 1.1, Verdict.SLOWER, id="a bad round hides nothing"),
        pytest.param([*NOISY, (10.0, 30.0)], False, 1.02, Verdict.NONE, id="a bad round makes no difference"),
        pytest.param([(1000.0, 999.0)], True, 0.999, Verdict.FASTER, id="one round of an exact figure is enough"),
        pytest.param([(1000.0, 1001.0)] * 10, True, 1.001, Verdict.SLOWER, id="virtual time has no noise"),
        pytest.param([(0.0, 0.0)] * 10, True, 1.0, Verdict.NONE, id="zeros"),
        pytest.param([(0.0, 2.0)] * 10, True, inf, Verdict.SLOWER, id="zero before"),
    ],
)
def test_ratio_and_verdict(values: list[tuple[float, float]], exact: bool, ratio: float, verdict: Verdict) -> None:
    reading = Reading(0.0, "us", exact=True) if exact else Reading(0.0, "us", PYTHON)
    (pair,) = pairs_of(rounds_of(values, reading))
    assert pair.ratio == pytest.approx(ratio)
    assert pair.verdict is verdict


def test_only_what_both_sides_have_is_paired_and_units_must_be_the_same() -> None:
    one = Reading(1.0, "us", PYTHON)
    assert [p.name for p in pairs_of([round_of({"a": one, "old": one}, {"new": one, "a": one})] * 10)] == ["a"]
    with pytest.raises(RuntimeError, match="a is in us on one side and in ratio on the other"):
        pairs_of([round_of({"a": one}, {"a": Reading(1.0, "ratio")})] * 10)


def test_all_figures_of_a_calibration_together() -> None:
    taken = [
        round_of(
            {"a": Reading(10.0, "us", PYTHON), "b": Reading(10.0, "us", PYTHON), "c": Reading(1.0, "us", PIPE)},
            {"a": Reading(40.0, "us", PYTHON), "b": Reading(10.0, "us", PYTHON), "c": Reading(9.0, "us", PIPE)},
        )
    ] * 10
    (pair,) = together(taken, pairs_of(taken))
    assert pair.name == "all 2 figures in Python loops together"
    assert pair.ratio == pytest.approx(2.0)
    assert pair.verdict is Verdict.SLOWER


# --- rounds ---


def test_the_old_side_is_first_in_every_second_round() -> None:
    orders: list[tuple[int, int]] = []

    def measure(sides: tuple[int, int]) -> Round:
        orders.append(sides)
        return round_of({}, {})

    assert len(list(take_rounds(4, measure, []))) == 4
    assert orders == [order(n) for n in range(4)] == [(0, 1), (1, 0), (0, 1), (1, 0)]


def test_a_round_that_fails_is_taken_again_and_too_many_end_it() -> None:
    def taken(failing: set[int], notes: list[str]) -> list[Round]:
        numbers = iter(range(100))

        def measure(sides: tuple[int, int]) -> Round:
            if next(numbers) in failing:
                raise RuntimeError("slaves were lost")
            return round_of({}, {})

        return list(take_rounds(10, measure, notes))

    notes: list[str] = []
    assert len(taken({1}, notes)) == 10
    assert notes == ["round 2 was taken again: slaves were lost"]
    with pytest.raises(RuntimeError, match="too many rounds failed, the last one so: slaves were lost"):
        taken(set(range(6)), [])


def test_repeats_of_a_run_are_paired_one_by_one() -> None:
    """Each piece of work of the new side follows one of the old side at once, and the speed changes in between."""
    old = Reading(20.0, PYTHON, PYTHON, repeats=(10.0, 20.0, 40.0))
    new = Reading(22.0, PYTHON, PYTHON, repeats=(11.0, 22.0, 44.0))
    (pair,) = pairs_of([round_of({"a": old}, {"a": new})] * 10)
    assert pair.ratios == pytest.approx([1.1] * 10)
    unequal = new._replace(repeats=(11.0, 22.0))
    (pair,) = pairs_of([round_of({"a": old}, {"a": unequal})] * 10)
    assert pair.ratios == pytest.approx([1.1] * 10)  # of the medians


# --- what reports say ---


def test_reports_give_durations_in_microseconds() -> None:
    old = Report("scale")
    old.measured("program", [2.0, 3.0, 4.0], "ms")
    old.measured("SD1: encode, construct", [15.0], "us")
    old.measured("rate", [7.0], "1/s", more=True)
    old.exact("services", 3, "")
    assert readings_of(old) == {
        "program": Reading(3000.0, "us", repeats=(2000.0, 3000.0, 4000.0)),
        "rate": Reading(7.0, "1/s", more=True, repeats=(7.0,)),
        "services": Reading(3, "", exact=True),
    }
    new = Report("scale")
    new.calibrated("Python", [500.0])
    new.in_loops("null: CPU time", [(8000.0, 500.0), (9000.0, 500.0), (10000.0, 400.0)])
    expected = Reading(9.0, "us", PYTHON, repeats=(8.0, 9.0, 10.0))
    assert readings_of(new) == {"null: CPU time": expected}
    assert readings_of(new, on_loop_clock=True) == {"null: CPU time": expected._replace(unit=PYTHON)}


def test_figures_in_loops_keep_their_durations_in_the_report() -> None:
    report = Report("virtual")
    report.in_loops("a", [(8000.0, 500.0), (9000.0, 500.0), (10000.0, 400.0)], 17.0)
    (figure,) = report.figures
    assert (figure.value, figure.unit, figure.rounds, figure.raw_us) == (18.0, PYTHON, (16, 18, 25), (8.0, 9.0, 10.0))
    assert "18.00 Python loops  +-25%  (9.00 us)   goal at most 17: MISSED" in report.as_text()
    assert json.loads(report.as_json())["figures"]["a"]["raw_us"] == [8.0, 9.0, 10.0]


def test_the_memory_that_a_probe_reads_is_not_in_loops() -> None:
    found = readings_of_probe({"up: CPU time": 2.0, "up: PSS in KiB": 3.0})
    assert found == {"up: CPU time": Reading(2.0, PYTHON, PYTHON), "up: PSS in KiB": Reading(3.0, "KiB")}


def test_a_reading_has_the_bound_that_its_report_judged_it_by() -> None:
    report = Report("rotation")
    report.measured("judged", [0.9], "ratio", 0.8, more=True)
    report.measured("no verdict", [0.3], "ratio", more=True)
    report.in_loops("in loops", [(900.0, 300.0)], 2.0)
    assert {name: reading.goal for name, reading in readings_of(report).items()} == {
        "judged": 0.8,
        "no verdict": None,
        "in loops": 2.0,
    }


# --- own benches and the probe ---


class MadeUp(Commands):
    """Figures instead of programs: an exception is raised."""

    def __init__(
        self,
        own: Sequence[dict[str, float] | Exception],
        probe: Sequence[dict[str, float]],
        *,
        in_turn: bool = False,
    ) -> None:
        super().__init__("virtual", Plan("", cpu=in_turn))
        self._made = {NEW: own[1], OLD: own[0]}
        self._probed = {NEW: probe[1], OLD: probe[0]}
        self.called: list[str] = []

    def own(self, *sides: Side) -> list[dict[str, Reading]]:
        self.called.append(f"own {' '.join(str(side.root) for side in sides)}")
        found = []
        for side in sides:
            made = self._made[side]
            if isinstance(made, Exception):
                raise made
            found.append({name: Reading(value, "us") for name, value in made.items()})
        return found

    def probe(self, *sides: Side) -> list[dict[str, Reading]]:
        self.called.append(f"probe {' '.join(str(side.root) for side in sides)}")
        return [{name: Reading(value, "us") for name, value in self._probed[side].items()} for side in sides]


def measured_with(commands: MadeUp, notes: list[str]) -> Measured:
    """After the run that is not judged; the Python calibration counts up."""
    paces = iter(range(100))

    def calibrate() -> Speeds:
        commands.called.append("calibrate")
        return Speeds(float(next(paces)), 0.0)

    measured = Measured(commands, (OLD, NEW), notes, calibrate)
    commands.called.clear()
    return measured


def values(both: Round) -> list[dict[str, float]]:
    return [{name: reading.value for name, reading in run.readings.items()} for run in both]


def test_figures_of_both_own_benches_are_theirs_and_the_rest_is_probed_on_both_sides() -> None:
    notes: list[str] = []
    commands = MadeUp(
        [{"both": 1, "gone": 1}, {"both": 2, "version": 2, "added": 2}],
        [{"both": 11, "version": 11}, {"both": 12, "version": 12}],
    )
    measured = measured_with(commands, notes)
    old = {"both": 1, "gone": 1, "version": 11}
    assert values(measured.round((0, 1))) == [old, {"both": 2, "version": 12, "added": 2}]
    assert values(measured.round((1, 0)))[0] == old
    assert notes == ["only 0123456789ab has: gone", "only the tree as it stands has: added"]


def test_calibrations_lie_between_the_runs_and_without_need_nothing_is_probed() -> None:
    commands = MadeUp([{"a": 1}, {"a": 2}], [{"a": 11}, {"a": 12}])
    measured = measured_with(commands, [])
    old, new = measured.round((0, 1))
    assert values((old, new)) == [{"a": 1}, {"a": 2}]
    assert commands.called == ["calibrate", "own old", "calibrate", "own new", "calibrate"]
    assert (old.speeds.python, new.speeds.python) == (0.5, 1.5)
    commands.called.clear()
    old, new = measured.round((1, 0))
    assert commands.called == ["calibrate", "own new", "calibrate", "own old", "calibrate"]
    assert (old.speeds.python, new.speeds.python) == (4.5, 3.5)


def test_runs_of_cpu_benchmarks_take_turns() -> None:
    commands = MadeUp([{"a": 1}, {"a": 2}], [{"a": 11}, {"a": 12}], in_turn=True)
    measured = measured_with(commands, [])
    old, new = measured.round((1, 0))
    assert values((old, new)) == [{"a": 1}, {"a": 2}]
    assert commands.called == ["calibrate", "own new old", "calibrate"]
    assert old.speeds == new.speeds == Speeds(0.5, 0.0)


def test_a_commit_without_the_benchmark_is_probed_alone() -> None:
    notes: list[str] = []
    commands = MadeUp([LacksError("no benchmark 'virtual'"), {"b": 2}], [{"a": 11}, {"a": 12}])
    measured = measured_with(commands, notes)
    assert values(measured.round((1, 0))) == [{"a": 11}, {"a": 12}]
    assert [called for called in commands.called if called != "calibrate"] == ["probe new old"]
    assert notes[0] == "the own bench of 0123456789ab cannot do this: no benchmark 'virtual'"


def test_a_benchmark_that_the_probe_replaces_as_a_whole_is_not_missed() -> None:
    notes: list[str] = []
    commands = MadeUp([LacksError("no benchmark 'application'"), {"a": 2}], [{"a": 11}, {"a": 12}])
    assert values(measured_with(commands, notes).round((0, 1))) == [{"a": 11}, {"a": 12}]
    assert notes == []


def test_sides_without_a_common_figure_are_reported_with_the_reason() -> None:
    with pytest.raises(
        RuntimeError, match="have no figure in common; the own bench of 0123456789ab cannot do this: why"
    ):
        Measured(MadeUp([LacksError("why"), {"b": 2}], [{}, {}]), (OLD, NEW), [])


def test_cpu_benchmarks_run_on_the_clock_of_loops_and_others_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    report = Report("virtual")
    report.measured("a", [3.0], "us")
    called: list[Sequence[str]] = []

    def run(sides: Sequence[Side], words: Sequence[str]) -> list[Ended]:
        called.append(words)
        return [Ended(0, report.as_json() + "\n", "") for _ in sides]

    monkeypatch.setattr(rounds, "run_in_turn", run)
    of_loops, of_us = Reading(3.0, PYTHON, PYTHON, repeats=(3.0,)), Reading(3.0, "us", repeats=(3.0,))
    assert Commands("virtual", Plan("--rounds 3", cpu=True)).own(OLD, NEW) == [{"a": of_loops}] * 2
    assert Commands("cycle", Plan("--rounds 1")).own(OLD) == [{"a": of_us}]
    (first, second) = called
    assert first[0] == "-P"
    assert Path(first[1]).name == "loop_clock.py"
    assert first[2:] == ["virtual", "--json", "--rounds", "3"]
    assert second == ["-m", "bench", "cycle", "--json", "--rounds", "1"]


def test_programs_work_piece_by_piece_in_turn(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import os, sys\n"
        "from pathlib import Path\n"
        "from bench.loop_clock import LoopClock\n"
        "clock = LoopClock(lambda: 0, lambda: 1.0)\n"
        "name = Path.cwd().name\n"
        "for n in range(3 if name == 'old' else 2):\n"
        "    clock()\n"
        "    with open('../pieces', 'a') as pieces:\n"
        "        print(name, n, file=pieces)\n"
        "    clock()\n"
        "print('done')\n"
        "sys.exit('one line\\nand another' if name == 'old' else 0)\n"
    )
    root = str(Path(rounds.__file__).parent.parent)
    sides = []
    for name in ("new", "old"):
        (tmp_path / name).mkdir()
        sides.append(Side(name, tmp_path / name, Path(sys.executable)))
    start = f"import sys; sys.path.insert(0, {root!r}); exec(open({str(script)!r}).read())"
    assert run_in_turn(sides, ["-c", start]) == [Ended(0, "done\n", ""), Ended(1, "done\n", "and another")]
    pieces = (tmp_path / "pieces").read_text().splitlines()
    assert pieces == ["new 0", "old 0", "new 1", "old 1", "old 2"]


def test_every_benchmark_has_a_plan() -> None:
    assert PLANS.keys() == cli.BENCHMARKS.keys()
    exact = {"acyclic", "parameters"}
    assert all(plan.rounds >= 10 for name, plan in PLANS.items() if name not in exact)
    assert {PLANS[name].rounds for name in exact} == {1}


# --- clocks ---


def test_the_clock_of_loops_goes_as_fast_as_the_computer() -> None:
    times = iter([0, 0, 1000, 9000, 9000, 9000, 13_000, 13_000])
    loops = iter([500.0, 500.0, 500.0, 1500.0])
    waited: list[int] = []
    clock = LoopClock(lambda: next(times), lambda: next(loops), lambda: waited.append(0))
    assert clock() == 0
    assert clock() == 2000  # 1000 ns at 500 ns a loop, in thousandths
    assert clock() == 2000  # what lies between two pieces of work does not count
    assert clock() == 2000 + 4000  # 4000 ns at 1000 ns a loop, the mean of before and after
    assert len(waited) == 2  # before each piece


def test_work_stands_beside_the_loops_before_and_after_it() -> None:
    assert calibrate_python(1, 10, iter([0, 5000]).__next__) == 500
    beside = Beside(iter([400.0, 600.0, 800.0]).__next__)
    assert beside(lambda: "first") == ("first", 500.0)
    assert beside(lambda: "second") == ("second", 700.0)
    assert beside.loops == [400.0, 600.0, 800.0]


# --- environments and the command line ---


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "dpstack-bench"


def git_of(answers: dict[str, bytes | Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*words: str) -> bytes:
        answer = answers[words[0]]
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(commits, "_git", git)


def test_an_environment_is_made_once_for_a_commit(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def extract(number: str, tree: Path) -> None:
        made.append(f"files {number}")
        (tree / "pyproject.toml").write_text("[project]")

    git_of({"rev-parse": b"0123456789abcdef\n"}, monkeypatch)
    monkeypatch.setattr(commits, "_extract", extract)
    monkeypatch.setattr(commits, "_install", lambda tree, venv: made.append(f"packages {tree.parent.name[:12]}"))
    for _ in range(2):
        with commits.commit_side("main~3") as side:
            assert side.title == "0123456789ab"
            assert side.root.parent.parent == cache
            assert side.python == side.root.parent / "venv" / "bin" / "python"
    assert made == ["files 0123456789abcdef", "packages 0123456789ab"]


def test_the_tree_is_copied_each_time_and_installed_when_its_packages_change(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "checkout"
    (root / "dpstack").mkdir(parents=True)
    (root / "pyproject.toml").write_text("[project]")
    (root / "dpstack" / "a.py").write_text("a = 1")
    installed: list[Path] = []
    git_of({"ls-files": b"pyproject.toml\0dpstack/a.py\0removed.py\0"}, monkeypatch)
    monkeypatch.setattr(commits, "_ROOT", root)
    monkeypatch.setattr(commits, "_install", lambda tree, venv: installed.append(tree))
    with commits.tree_side() as side:
        assert (side.root / "dpstack" / "a.py").read_text() == "a = 1"
    (root / "dpstack" / "a.py").write_text("a = 2")
    with commits.tree_side() as side:
        assert (side.root / "dpstack" / "a.py").read_text() == "a = 2"
    assert len(installed) == 1
    (root / "pyproject.toml").write_text("[project] # more")
    with commits.tree_side():
        assert len(installed) == 2
    assert sorted(path.name for path in root.iterdir()) == ["dpstack", "pyproject.toml"]  # nothing is left there


def test_the_command_line_says_by_its_exit_code_whether_something_is_slower(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    @contextmanager
    def side(*_: str) -> Iterator[Side]:
        yield OLD if _ else NEW

    cost = {OLD: 10.0, NEW: 10.0}
    monkeypatch.setattr(rounds, "commit_side", side)
    monkeypatch.setattr(rounds, "tree_side", side)
    monkeypatch.setattr(Measured.__init__, "__defaults__", (lambda: STILL,))
    monkeypatch.setattr(Commands, "own", lambda _, *sides: [{"a": Reading(cost[s], "us", PYTHON)} for s in sides])
    monkeypatch.setattr(Commands, "probe", lambda _, *sides: [{} for _ in sides])
    assert cli.main(["compare", "virtual", "--commit", "HEAD"]) == 0
    assert "no difference seen" in capsys.readouterr().out
    cost[NEW] = 12.0
    assert cli.main(["compare", "virtual", "--commit", "HEAD", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["slower"] == ["a"]
