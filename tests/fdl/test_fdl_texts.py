"""The texts and defaults of the room fdl in full, one line each in a snapshot."""

from __future__ import annotations

import pytest
from texts import fdl as texts_fdl
from texts.snapshot import lines_of, snapshot_lines


@pytest.mark.parametrize("name", [name for name in texts_fdl.GROUPS if name != "interface_phy"])
def test_texts(name: str) -> None:
    assert lines_of({name: texts_fdl.GROUPS[name]}) == snapshot_lines(texts_fdl.FILE, name)
