"""The long run under tracemalloc, in short."""

from __future__ import annotations

import pytest
from soak import results
from soak.traced import run_traced


@pytest.mark.soak
def test_nothing_grows_in_100_000_exchanges() -> None:
    line = run_traced(100_000)
    assert results.problems(line) == []
    assert line["exchanges"] >= 100_000
