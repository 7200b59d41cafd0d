"""Texts of the room dpv1 in full, with the octets, tables and defaults beside them."""

from __future__ import annotations

import pytest
from texts import dpv1 as texts_dpv1
from texts.snapshot import lines_of, snapshot_lines


@pytest.mark.parametrize("name", texts_dpv1.PLAIN)
def test_texts(name: str) -> None:
    assert lines_of({name: texts_dpv1.PLAIN[name]}) == snapshot_lines(texts_dpv1.FILE, name)
