"""The other end of a tty for all tests of ports."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from far_ends import PtyFarEnd


@pytest.fixture
def far() -> Iterator[PtyFarEnd]:
    """A pty whose other end is the port under test (``far.path``)."""
    end = PtyFarEnd()
    yield end
    end.hang_up()
