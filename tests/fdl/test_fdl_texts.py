"""The texts and defaults of the room fdl in full, one line each in a snapshot."""

from __future__ import annotations

import pytest
import said_fdl
from said_texts import kept, lines_of


@pytest.mark.parametrize("name", [name for name in said_fdl.GROUPS if name != "interface_phy"])
def test_texts(name: str) -> None:
    assert lines_of({name: said_fdl.GROUPS[name]}) == kept(said_fdl.FILE, name)
