"""Stories of a DP slave by seed (:mod:`stories.slave`): answers, calls of the device and events as in the snapshot."""

from __future__ import annotations

import pytest
from stories.slave import SNAPSHOT, STORIES, lines

_TOGETHER = 10


@pytest.mark.parametrize("first", range(0, STORIES, _TOGETHER))
def test_stories(first: int) -> None:
    kept = SNAPSHOT.read_text(encoding="utf-8").splitlines()[first : first + _TOGETHER]
    assert lines(range(first, first + _TOGETHER)) == kept
