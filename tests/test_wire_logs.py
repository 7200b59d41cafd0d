"""Wire logs of fixed seeds are those of commit 364aac1 byte for byte, where no mend changed them."""

from __future__ import annotations

import json

import pytest
from wire_logs import CHANGED, RUNS, SNAPSHOT, Scenario, line

LINES = SNAPSHOT.read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize(
    ("number", "scenario", "seed"),
    [pytest.param(n, *run, id=f"{run[0].__name__}-{run[1]}") for n, run in enumerate(RUNS)],
)
def test_the_wire_log_is_the_one_of_the_snapshot(number: int, scenario: Scenario, seed: int) -> None:
    show = f"tests/kits/wire_logs.py --show {scenario.__name__} {seed}"
    assert line(scenario, seed) == LINES[number], f"compare the output of {show} with that of the commit before"


def test_the_snapshot_has_every_run_and_the_list_of_changes_only_known_ones() -> None:
    assert [json.loads(one)[:2] for one in LINES] == [[scenario.__name__, seed] for scenario, seed in RUNS]
    assert CHANGED.keys() <= {(scenario.__name__, seed) for scenario, seed in RUNS}
