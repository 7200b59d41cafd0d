"""The benchmark of acyclic traffic: what of it is exact holds its goals, and what it gives is what it documents."""

from __future__ import annotations

import json

import pytest

from bench import acyclic
from bench.acyclic_plant import LENGTHS, Answers, Load, Plant
from bench.records import Record, fetched, rotations
from bench.report import Report, report_of


def values(report: Report) -> dict[str, float]:
    return {figure.name: figure.value for figure in report.figures}


@pytest.mark.parametrize("baud", [500_000, pytest.param(3_000_000, marks=pytest.mark.soak)])
def test_the_rotation_beside_records_of_64_octets(baud: int) -> None:
    report = acyclic.run(["--bauds", str(baud), "--lengths", "64", "--rotations", "40", "--cycles", "0", "--pty-bauds"])
    ratios = [figure for figure in report.figures if figure.name.endswith("rotation p99 to that without")]
    assert len(ratios) == 6  # Read and Write, answered in three ways
    assert all(figure.goal == 1.3 and figure.met for figure in ratios), ratios
    (longer,) = [figure for figure in report.figures if "longest rotation longer" in figure.name]
    assert longer.goal == 1
    assert 0.2 < longer.value <= 1


@pytest.mark.parametrize(
    "answers", [Answers.AT_ONCE, *(pytest.param(each, marks=pytest.mark.soak) for each in list(Answers)[1:])]
)
def test_any_length_costs_the_plans_acyclic_service_at_most(answers: Answers) -> None:
    plant = Plant(1_500_000, answers, t_sdr=150)  # as slow as they may be
    ns = 200_000_000 * (2 if answers is Answers.SLOW else 1)  # one Global_Control in each
    quiet = plant.look(ns)
    longer = {}
    for octets in LENGTHS:
        for write in (False, True):
            seen = plant.look(ns, Load(write, octets, answers))
            assert seen.done > 3
            assert not seen.failed
            longer[octets, write] = seen.rotation.max_ns - quiet.rotation.max_ns
    assert min(longer.values()) > 0
    assert max(longer.values()) <= plant.service_ns
    if answers is Answers.AT_ONCE:
        assert max(longer.values()) > 0.99 * plant.service_ns  # and the plan does not exaggerate
    plant.check()


@pytest.mark.parametrize("baud", [500_000, pytest.param(3_000_000, marks=pytest.mark.soak)])
def test_no_cycle_is_missed_where_a_service_fits(baud: int) -> None:
    report = acyclic.run(["--bauds", str(baud), "--lengths", "64", "--rotations", "6", "--cycles", "8", "--pty-bauds"])
    missed = [figure for figure in report.figures if "cycles missed" in figure.name]
    assert len(missed) == 12  # four cycles: without, Read of 64, Write of 240
    kept = [figure for figure in missed if "undisturbed" in figure.name or "always" in figure.name]
    assert len(kept) == 6
    assert all(figure.goal == 0 and figure.met for figure in kept)
    tight = [figure for figure in missed if figure not in kept]
    assert all(figure.goal is not None and figure.goal > 0 and figure.met for figure in tight)
    assert sum(value for name, value in values(report).items() if "cycle_ms" in name and "services" in name) > 0


def test_exact_figures_are_judged_on_a_busy_machine_too() -> None:
    report = Report("acyclic")
    report.exact("exact", 1.0, "ratio", 1.3)
    report.add("measured", 1.0, "ratio", 1.3)
    report.busy = True
    data = json.loads(report.finished().as_json())
    assert [data["figures"][name]["met"] for name in ("exact", "measured")] == [True, None]
    assert "1.00 ratio   goal at most 1.3: met" in report.as_text()
    assert report_of(data).as_dict() == report.as_dict()


def record(at: int, to: int, octets: int, answer: int) -> Record:
    return Record(at, at, at, at, at, at, 0x68, to, octets, answer)


def test_rotations_with_services_and_the_records_fetched() -> None:
    """One round with the poll that fetches 64 octets (11 and 79), one without, cut at the first slave's exchanges."""
    begin = record(0, 3, 21, 21)
    taken = [record(-5, 3, 11, 79), begin, record(1_000, 4, 11, 79), begin._replace(read=5_000)]
    taken.append(begin._replace(read=8_000))
    assert [r.took for r in rotations(taken, 500_000, services=True)] == [5_000, 3_000]
    assert [r.took for r in rotations(taken, 500_000)] == [3_000]
    assert (fetched(taken, 64), fetched(taken, 16)) == (2, 0)


def test_over_a_pty() -> None:
    words = ["--bauds", "--pty-bauds", "3000000", "--rounds", "1", "--seconds", "0.2", "--kinds", "asyncio"]
    found = values(acyclic.run(words))
    assert found["3 Mbit/s, pty, asyncio, Read of 64: services"] > 0
    assert found["3 Mbit/s, pty, asyncio, Read of 64: rotation p50 to that without"] > 0
