"""Reports of benchmarks: kept, read again, compared; what the command line says of them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from bench import compare as comparing
from bench.__main__ import BENCHMARKS, main
from bench.compare import Verdict, compare, load_report, save
from bench.plot import PlotError, plot
from bench.report import Report, quantile, report_of
from bench.rig import Taken, note_disturbance

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
    """A report of the benchmark "gsd" with the figures' rounds; names with "per_s" are better when they are more."""
    report = Report("gsd")
    for name, rounds in figures.items():
        report.measured(name, rounds, "1/s" if "per_s" in name else "us", more="per_s" in name)
    return report


def test_a_report_says_what_it_was_taken_on_and_comes_back_from_its_json() -> None:
    report = Report("gsd", notes=["a note"])
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


def test_compare_marks_what_is_beyond_the_noise_of_the_rounds() -> None:
    still = [100.0, 101.0, 99.0]
    old = made(
        slower=still, noisy=[100.0, 140.0, 80.0], same=still, faster=still, per_s=still, gone=still, once=[100.0]
    )
    new = made(
        slower=[120.0, 121.0, 119.0],
        noisy=[120.0, 150.0, 90.0],
        same=[101.0, 102.0, 100.0],
        faster=[80.0, 81.0, 79.0],
        per_s=[80.0, 81.0, 79.0],
        once=[200.0],
        new=still,
    )
    result = compare(old, new)
    assert {c.name: c.verdict for c in result.changes} == {
        "slower": Verdict.WORSE,
        "noisy": Verdict.SAME,
        "same": Verdict.SAME,
        "faster": Verdict.BETTER,
        "per_s": Verdict.WORSE,
        "gone": Verdict.GONE,
        "once": Verdict.UNKNOWN,
        "new": Verdict.NEW,
    }
    assert result.worse == ("slower", "per_s", "gone")
    by_name = {c.name: c for c in result.changes}
    assert by_name["slower"].ratio == pytest.approx(1.2)
    assert by_name["slower"].noise == pytest.approx(0.02 + 2 / 120)
    assert json.loads(result.as_json())["worse"] == ["slower", "per_s", "gone"]
    assert [line.split()[-1] for line in result.as_text().splitlines() if "slower" in line] == ["WORSE"]


def test_figures_of_another_machine_or_benchmark_are_not_silently_compared() -> None:
    old, new = made(a=[1.0, 1.0]), made(a=[1.0, 1.0])
    new.about["processor"] = "another one"
    new.busy = True
    different, busy = compare(old, new).warnings
    assert different.startswith("not the same: processor")
    assert busy == f"taken on a busy machine: {new.taken}"
    with pytest.raises(ValueError, match="one report is of gsd, the other of usb"):
        compare(old, Report("usb"))


def test_on_a_busy_machine_no_goal_is_judged() -> None:
    report = Report("gsd")
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


def test_one_bad_round_of_many_is_no_noise() -> None:
    (figure,) = made(a=[10.0] * 8 + [50.0]).figures
    assert figure.spread == 0
    assert figure.value == 10


def test_the_command_line_compares_with_the_reference_and_two_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(comparing, "REFERENCE", tmp_path)
    worse = tmp_path / "worse.json"
    save(made(a=[10.0, 10.0]), comparing.reference_of("gsd"))
    save(made(a=[20.0, 20.0]), worse)
    assert main(["compare", "gsd", str(worse)]) == 1
    assert "WORSE" in capsys.readouterr().out
    assert main(["compare", "gsd", str(worse), str(worse)]) == 0
    assert main(["compare", "gsd", str(worse), str(comparing.reference_of("gsd")), "--json"]) == 0
    assert "better" in capsys.readouterr().out
    assert load_report(worse).figures[0].rounds == (20.0, 20.0)


@pytest.mark.parametrize(
    "words",
    [
        "steps --rounds 0",
        "jitter --rounds -1",
        "rotation --seconds nan",
        "virtual --slaves 0",
        "ring --slaves 101",
        "fleet --gateways 0",
        "goals --rounds 0",
    ],
)
def test_an_impossible_number_is_refused_with_one_line(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    name, option, value = words.split()
    with pytest.raises(SystemExit) as caught:
        main([name, f"{option}={value}"])
    assert caught.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith(f"python -m bench {name}: error: argument {option}: '{value}' is no ")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nothing"], "; and the commands compare, goals"),
        (["compare", "nothing"], "no benchmark 'nothing'"),
        (["compare", "gsd", "/nowhere.json"], "no stored reference of gsd yet: python -m bench gsd --save takes one"),
        (["compare", "gsd", "/nowhere.json", "/nowhere.json"], "/nowhere.json cannot be read as a benchmark's JSON"),
        (["compare", "gsd", "a", "b", "c"], "at most two files"),
    ],
)
def test_wrong_use_is_one_line(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(comparing, "REFERENCE", tmp_path)
    assert main(words) == 2
    assert said in capsys.readouterr().err


def test_a_file_that_is_no_report_is_named(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    no_figures = '{"benchmark": "gsd", "machine": {}, "notes": [], "taken": "", "figures": 3}'
    for text in ("[]", "{}", "nonsense", no_figures, "[" * 100_000, "9" * 5000):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"x\.json cannot be read"):
            load_report(path)


def test_without_a_name_they_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(BENCHMARKS)


def test_stored_references_can_be_read() -> None:
    for path in comparing.REFERENCE.glob("*.json"):
        assert load_report(path).name == path.stem


def test_without_matplotlib_a_plot_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(PlotError, match=r"pip install -e '\.\[plot\]'"):
        plot(made(a=[1.0, 2.0]), tmp_path / "x.svg")


def test_a_plot_has_a_bar_for_every_figure_and_a_panel_for_every_unit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[str, Any, Any]] = []

    class Recorder:
        """Takes every call of a panel or a picture."""

        def __init__(self, **_keys: object) -> None: ...

        def __getattr__(self, name: str) -> Any:
            return lambda *args, **keys: calls.append((name, args, keys))

        def subplots(self, rows: int, _columns: int, **_keys: object) -> Any:
            class Panels(list[Any]):
                def __getitem__(self, _place: Any) -> Any:
                    return list(self)

            return Panels(Recorder() for _ in range(rows))

    fake, figure = ModuleType("matplotlib"), ModuleType("matplotlib.figure")
    vars(fake).update(rcParams={}, figure=figure)
    vars(figure).update(Figure=Recorder)
    monkeypatch.setitem(sys.modules, "matplotlib", fake)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", figure)
    report = made(a=[1.0, 2.0], b=[3.0, 3.0], per_s=[5.0, 5.0])
    plot(report, tmp_path / "x.svg")
    assert [args[:2] for name, args, _ in calls if name == "barh"] == [(["a", "b"], [1.5, 3.0]), (["per_s"], [5.0])]
    assert [args for name, args, _ in calls if name == "savefig"] == [(tmp_path / "x.svg",)]


def test_a_round_without_values_is_told() -> None:
    with pytest.raises(ValueError, match="too busy; measure again"):
        quantile([], 0.5)
