"""Alert rules and dashboards: each metric and label of their expressions is in the table of the metrics, which
docs/reference/metrics.md has as they are scraped."""

from __future__ import annotations

import asyncio
import json
import re

import pytest
from metrics_kit import FINE, Bench, plant, scrape, snapshot
from prometheus_expressions import BOARDS, ROOT, Expression, expressions

from dpstack.bridge.metrics.table import COUNTER, HISTOGRAM, METRICS
from tools.make_metrics_docs import TARGET, render

ALL = expressions()
#: those that Prometheus adds to each series
OF_TARGET = {"instance", "job"}
SERIES = {
    name: {*metric.labels, *OF_TARGET, *({"le"} if name.endswith("_bucket") else ())}
    for metric in METRICS
    for name in (
        [f"{metric.name}_{part}" for part in ("bucket", "sum", "count")] if metric.kind == HISTOGRAM else [metric.name]
    )
}
COUNTERS = {metric.name for metric in METRICS if metric.kind == COUNTER}


@pytest.mark.parametrize("one", ALL, ids=lambda one: f"{one.where}-{one.text}"[:80])
def test_metrics_and_labels_of_an_expression_are_in_the_table(one: Expression) -> None:
    used = one.series()
    assert used
    for name, labels in used.items():
        if name == "up":
            assert labels <= OF_TARGET
            continue
        assert labels <= SERIES[name], f"{one.where}: {name} has no such label"
        if name in COUNTERS:
            assert re.search(rf"(rate|increase)\({name}\b", one.text), f"{one.where}: {name} is a counter"
    common = set[str].intersection(*(SERIES.get(name, OF_TARGET) for name in used))
    grouped = {
        label for group in re.findall(r"\b(?:on|by) \(([^)]*)\)", one.text) for label in re.findall(r"\w+", group)
    }
    assert grouped <= common
    if "sum by" not in one.text:
        shown = set(re.findall(r"{{ ?(?:\$labels\.)?(\w+) ?}}", one.legend))
        assert shown <= set[str].union(*(SERIES.get(name, OF_TARGET) for name in used))


def test_the_share_of_repetitions_is_one_of_requests() -> None:
    [alert] = [one.text for one in ALL if one.where == "alert DpstackSlaveRetries"]

    def fires(*, requests: int, repeated: int, unanswered: int = 0, late: int = 0, wrong: int = 0) -> bool:
        answers = requests - unanswered
        counts = {
            "telegrams": requests + repeated + answers + late + wrong,
            "retries": repeated,
            "timeouts": unanswered,
            "late": late,
            "wrong": wrong,
        }
        text = re.sub(r"rate\(dpstack_slave_(\w+)_total\[5m\]\)", lambda found: str(counts[found[1]]), alert)
        assert re.fullmatch(r"[-\d\s.*/()+>]+", text)
        return bool(eval(text))

    assert not fires(requests=10_000, repeated=90)
    assert fires(requests=10_000, repeated=110)
    assert not fires(requests=10_000, repeated=90, unanswered=5000, late=900, wrong=900)
    assert fires(requests=10_000, repeated=110, unanswered=5000, late=900, wrong=900)


#: the choices at the top of each dashboard, and its first panels
GLANCE = {
    "dpstack.dashboard.json": ({"datasource", "instance"}, ["Verdict", "Buses that run"]),
    "dpstack-values.dashboard.json": (
        {"datasource", "instance", "slave", "value"},
        ["Worst quality", "Values that are bad"],
    ),
}


def test_dashboards_have_ids_of_their_own() -> None:
    assert BOARDS.keys() == GLANCE.keys()
    assert len({board["uid"] for board in BOARDS.values()}) == len({board["title"] for board in BOARDS.values()}) == 2


@pytest.mark.parametrize("name", GLANCE)
def test_a_dashboard_can_be_read_at_a_glance(name: str) -> None:
    """Each panel has a place of its own, a unit, a text for people, legends, and follows the choices at the top."""
    board, (choices, first) = BOARDS[name], GLANCE[name]
    assert {one["name"] for one in board["templating"]["list"]} == choices
    used = set(re.findall(r"\$(\w+)", json.dumps(board["panels"]))) | {"datasource"}
    assert used == choices
    panels = board["panels"]
    assert len({one["id"] for one in panels}) == len({one["title"] for one in panels}) == len(panels)
    taken: set[tuple[int, int]] = set()
    for panel in panels:
        place = panel["gridPos"]
        assert place["x"] + place["w"] <= 24
        cells = {(place["x"] + x, place["y"] + y) for x in range(place["w"]) for y in range(place["h"])}
        assert not cells & taken, panel["title"]
        taken |= cells
        assert panel["description"].endswith(".")
        assert panel["fieldConfig"]["defaults"]["unit"] in ("none", "s", "ops", "percentunit", "bytes")
        assert panel["type"] in ("stat", "table", "timeseries")
        assert len({one["refId"] for one in panel["targets"]}) == len(panel["targets"]) > 0
        for target in panel["targets"]:
            assert target["datasource"] == panel["datasource"] == {"type": "prometheus", "uid": "${datasource}"}
            assert len(re.findall(r"dpstack_\w+", target["expr"])) == target["expr"].count('instance=~"$instance"')
            assert "{{instance}}" in target["legendFormat"]
    # no hole: the rows are full
    assert len(taken) == 24 * (1 + max(y for _, y in taken))
    assert [one["title"] for one in panels][:2] == first


def test_there_are_expressions_of_both_files_and_alerts_have_a_severity_and_a_summary() -> None:
    assert len([one for one in ALL if one.where.startswith("alert ")]) >= 15
    assert len([one for one in ALL if one.where.startswith("panel ")]) >= 30
    assert all("summary" in one.legend and "severity" in one.legend for one in ALL if one.where.startswith("alert "))


def test_the_page_names_every_alert() -> None:
    page = (ROOT / "docs" / "how-to" / "prometheus.md").read_text(encoding="utf-8")
    alerts = {one.where.removeprefix("alert ") for one in ALL if one.where.startswith("alert ")}
    assert set(re.findall(r"\bDpstack[A-Z]\w+", page)) == alerts


def test_the_table_of_the_page_is_that_of_a_scrape() -> None:
    page = TARGET.read_text(encoding="utf-8")
    assert render(page) == page
    written = {
        name: (kind, frozenset(re.findall(r"`(\w+)`", labels)))
        for name, kind, labels in re.findall(r"^\| `(dpstack_\w+)` \| (\w+) \| ([^|]*) \|", page, re.MULTILINE)
    }
    bench = Bench(plant("valves"), snapshot(1.0, FINE))
    bench.connector.collector.requests[200] += 1
    seen = asyncio.run(scrape(bench.connector))
    assert written == {name: (kind, *seen.labels[name]) for name, kind in seen.kinds.items()}
    assert len(written) > 40
