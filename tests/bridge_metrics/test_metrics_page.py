"""docs/reference/metrics.md has the table of the metrics as they are scraped."""

from __future__ import annotations

import asyncio
import re

from metrics_kit import FINE, Bench, plant, scrape, snapshot

from tools.make_metrics_docs import TARGET, render


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
