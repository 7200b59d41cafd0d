"""Texts of the room dp in full, with the octets, tables and defaults beside them, and transcripts of its masters."""

from __future__ import annotations

import pytest
import texts_dp
from texts_snapshot import lines_of, snapshot_lines


@pytest.mark.parametrize("name", texts_dp.GROUPS)
def test_texts(name: str) -> None:
    assert lines_of({name: texts_dp.GROUPS[name]}) == snapshot_lines(texts_dp.FILE, name)
