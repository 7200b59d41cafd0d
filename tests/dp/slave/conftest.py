"""A slave of ours in data exchange, and the requests of its master."""

from __future__ import annotations

import pytest
from slave_kit import Bench


@pytest.fixture
def bench() -> Bench:
    return Bench().up()
