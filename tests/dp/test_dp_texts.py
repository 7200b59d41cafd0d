"""Texts of the room dp in full, with the octets, tables and defaults beside them, and transcripts of its masters."""

from __future__ import annotations

import pytest
import said_dp
from said_texts import kept, lines_of


@pytest.mark.parametrize("name", said_dp.GROUPS)
def test_texts(name: str) -> None:
    assert lines_of({name: said_dp.GROUPS[name]}) == kept(said_dp.FILE, name)
