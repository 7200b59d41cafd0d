"""Reports of benchmarks: kept, read again, compared."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench import compare as comparing
from bench.__main__ import main
from bench.compare import Verdict, compare, load_report, save
from bench.report import Report, Table, report_of
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
    with pytest.raises(ValueError, match="one report is of scale, the other of usb"):
        compare(old, Report("usb"))


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


def test_one_bad_round_of_many_is_no_noise() -> None:
    (figure,) = made(a=[10.0] * 8 + [50.0]).figures
    assert figure.spread == 0
    assert figure.value == 10


def test_the_command_line_compares_with_the_reference_and_two_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(comparing, "REFERENCE", tmp_path)
    worse = tmp_path / "worse.json"
    save(made(a=[10.0, 10.0]), comparing.reference_of("scale"))
    save(made(a=[20.0, 20.0]), worse)
    assert main(["compare", "scale", str(worse)]) == 1
    assert "WORSE" in capsys.readouterr().out
    assert main(["compare", "scale", str(worse), str(worse)]) == 0
    assert main(["compare", "scale", str(worse), str(comparing.reference_of("scale")), "--json"]) == 0
    assert "better" in capsys.readouterr().out
    assert load_report(worse).figures[0].rounds == (20.0, 20.0)


def test_stored_references_can_be_read() -> None:
    for path in comparing.REFERENCE.glob("*.json"):
        assert load_report(path).name == path.stem


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
