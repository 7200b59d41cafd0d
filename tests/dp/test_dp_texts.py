"""Every text of the room dp that needs no bus, in full: what a person reads, and the octets and tables beside it."""

from __future__ import annotations

import pytest
import said_dp
from said_texts import kept, lines_of


@pytest.mark.parametrize("name", said_dp.GROUPS)
def test_texts(name: str) -> None:
    assert lines_of({name: said_dp.GROUPS[name]}) == kept(said_dp.FILE, name)
