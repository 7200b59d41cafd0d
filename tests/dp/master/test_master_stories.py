"""Stories of a DP master by seed (:mod:`stories.master`): every request and event as in the snapshot."""

from __future__ import annotations

import pytest
from stories.master import SNAPSHOT, STORIES, lines

_TOGETHER = 4


@pytest.mark.parametrize("first", range(0, STORIES, _TOGETHER))
def test_stories(first: int) -> None:
    kept = SNAPSHOT.read_text(encoding="utf-8").splitlines()[first : first + _TOGETHER]
    assert lines(range(first, first + _TOGETHER)) == kept
