"""Stories of a token ring by seed (:mod:`stories.ring`): each transmission, event and end as in the snapshot."""

from __future__ import annotations

import pytest
from stories.ring import SNAPSHOT, STORIES, lines

_TOGETHER = 4


@pytest.mark.parametrize("first", range(0, STORIES, _TOGETHER))
def test_stories(first: int) -> None:
    kept = SNAPSHOT.read_text(encoding="utf-8").splitlines()[first : first + _TOGETHER]
    assert lines(range(first, first + _TOGETHER)) == kept
