"""Texts of the room dpv1 in full, with the octets, tables and defaults beside them, and transcripts of its masters."""

from __future__ import annotations

import pytest
import said_dpv1
from said_texts import kept, lines_of


@pytest.mark.parametrize("name", said_dpv1.GROUPS)
def test_texts(name: str) -> None:
    assert lines_of({name: said_dpv1.GROUPS[name]}) == kept(said_dpv1.FILE, name)
