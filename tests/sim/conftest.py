"""Stations that send by a script."""

from __future__ import annotations

import pytest
from referee_kit import Script
from support import WorldFactory


@pytest.fixture
def script(world: WorldFactory) -> Script:
    return Script(world)
