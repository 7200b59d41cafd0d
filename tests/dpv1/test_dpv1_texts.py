"""Every text of the room dpv1 that needs no bus, in full: what a person reads, and the octets and tables beside it."""

from __future__ import annotations

import pytest
import said_dpv1
from said_texts import kept, lines_of


@pytest.mark.parametrize("name", said_dpv1.GROUPS)
def test_texts(name: str) -> None:
    assert lines_of({name: said_dpv1.GROUPS[name]}) == kept(said_dpv1.FILE, name)
