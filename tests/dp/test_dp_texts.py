"""Texts of the room dp in full, with the octets, tables and defaults beside them."""

from __future__ import annotations

import pytest
from texts import dp as texts_dp
from texts.snapshot import lines_of, snapshot_lines


@pytest.mark.parametrize("name", texts_dp.PLAIN)
def test_texts(name: str) -> None:
    assert lines_of({name: texts_dp.PLAIN[name]}) == snapshot_lines(texts_dp.FILE, name)
