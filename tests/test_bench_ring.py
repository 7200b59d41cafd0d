"""The ring of two masters without its segment: counts made up, ratios worked out by hand; without a compiler."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bench import __main__ as cli
from bench import ring
from bench.masters import RING_KIND
from bench.report import Report
from bench.ring import Ring, compared, compiled, ring_of, words_of
from dpstack.params import BusParams


def counts(**other: Any) -> dict[str, Any]:
    """As the segment gives them: ten rotations in a millisecond, 0.4 ms of them on the wire."""
    usual = {
        "took_ns": 1_000_000,
        "ruled_ns": 400_000,
        "telegrams": 40,
        "exchanges": 20,
        "tokens": 20,
        "token_repeats": 0,
        "claims": 0,
        "repeats": 0,
        "collisions": 0,
        "held": 0,
        "dropped": 0,
        "late_tokens": 1,
        "rotations_ns": [100_000] * 10,
        "answers_ns": [30_000] * 19 + [90_000],
    }
    return usual | other


def test_a_ring_holds_when_no_token_is_lost_and_half_of_them_are_answered_in_time() -> None:
    assert ring_of(counts()).holds
    assert ring_of(counts(late_tokens=10)).holds
    assert not ring_of(counts(late_tokens=11)).holds
    assert not ring_of(counts(token_repeats=1)).holds
    assert not ring_of(counts(claims=1)).holds
    assert not ring_of(counts(rotations_ns=[])).holds


def test_efficiency_and_rotations_a_second() -> None:
    taken = ring_of(counts())
    assert taken.efficiency == pytest.approx(0.4)
    assert taken.per_second == pytest.approx(10_000)


def test_masters_are_judged_by_two_bare_loops_of_the_same_round() -> None:
    report = Report("ring")
    bare = [ring_of(counts(ruled_ns=ns)) for ns in (400_000, 500_000, 100_000)]
    ours = [ring_of(counts(ruled_ns=ns, token_repeats=n)) for ns, n in ((300_000, 0), (400_000, 2), (90_000, 1))]
    compared(report, {RING_KIND: bare, "process": ours}, 12_000_000)
    figures = {figure.name: figure for figure in report.figures}
    assert figures["two masters, process: efficiency to two bare loops'"].rounds == pytest.approx([0.75, 0.8, 0.9])
    lost = figures["two masters, process: tokens lost"]
    assert (lost.value, lost.met) == (3, False)
    assert figures["ring at 12 Mbit/s, two bare loops: efficiency"].value == pytest.approx(0.4)
    assert figures["ring at 12 Mbit/s, process: after T_SL"].value == pytest.approx(0.05)
    assert any("83 us at 12 Mbit/s" in note for note in report.notes)
    assert [line.split()[:3] for line in report.as_text().splitlines() if line.startswith("  process")] == [
        ["process", "10000.00", "0.30"]
    ]


def test_where_two_bare_loops_lose_tokens_nobody_is_judged() -> None:
    report = Report("ring")
    bare = [ring_of(counts()), ring_of(counts(claims=2))]
    compared(report, {RING_KIND: bare, "process": [ring_of(counts(claims=1))] * 2}, 12_000_000)
    (lost,) = (figure for figure in report.figures if figure.name == "two masters, process: tokens lost")
    assert (lost.value, lost.met) == (2, None)
    assert report.notes[0] == "no verdict: two bare loops lost 2 tokens in the same rounds"


def test_on_a_busy_computer_nobody_is_judged() -> None:
    report = Report("ring")
    taken = [ring_of(counts(), waited=0.3)]
    compared(report, {RING_KIND: taken, "process": taken}, 12_000_000)
    assert report.busy


def test_the_highest_rate_is_that_of_two_bare_loops_and_masters_run_there(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = []

    def measure(program: Path, kind: str, baud: int, *_: object) -> Ring:
        measured.append((kind, baud))
        return ring_of(counts(late_tokens=20 if baud == 12_000_000 else 0))

    monkeypatch.setattr(ring, "compiled", lambda folder: folder)
    monkeypatch.setattr(ring, "measure", measure)
    words = ["--bauds", "12000000", "500000", "3000000", "--kinds", "asyncio", "--rounds", "2"]
    report = ring.run(words)
    assert measured == [
        (RING_KIND, 500_000),
        (RING_KIND, 3_000_000),
        (RING_KIND, 12_000_000),
        *((RING_KIND, 3_000_000), ("asyncio", 3_000_000)) * 2,
    ]
    assert {f.name: f.value for f in report.figures}["highest rate that two bare loops hold"] == 3.0
    monkeypatch.setattr(ring, "measure", lambda *_: ring_of(counts(claims=1)))
    assert "hold the ring at no rate" in ring.run(words).notes[-1]


def test_the_segment_gets_the_times_of_the_rate_in_bit_times() -> None:
    assert words_of(BusParams.preset(12_000_000), 2, ["3:0696:f371:12:12"]) == [
        *("12000000", "76", "800", "11", "1000", "22", "2"),
        "3:0696:f371:12:12",
    ]
    assert words_of(BusParams.preset(500_000), 1, [])[5] == "4"


def test_without_a_compiler_it_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with pytest.raises(RuntimeError, match=r"needs a C compiler \(no-such-cc\): apt install gcc"):
        compiled(tmp_path, ["no-such-cc"])
    monkeypatch.setattr(ring, "_COMPILERS", ())
    monkeypatch.setenv("PATH", "/nowhere")
    assert cli.main(["ring", "--rounds", "1"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("bench: the segment of this benchmark needs a C compiler (cc, gcc, clang)")
