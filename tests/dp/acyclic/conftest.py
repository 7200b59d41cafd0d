"""A class 2 master on a bus of octets."""

from __future__ import annotations

import pytest
from class2_kit import Class2Bus


@pytest.fixture
def kit() -> Class2Bus:
    return Class2Bus()
